# SPDX-License-Identifier: BSD-3-Clause
"""Proportional-integral observers for sampled Lipschitz plants, with disturbances decoupled [Jia et al. 2015].

Read it with the paper: Q. Jia, W. Chen, Y. Zhang, Y. Jiang, "Robust fault reconstruction in discrete-time Lipschitz
nonlinear systems via Euler-approximate proportional integral observers", Mathematical Problems in Engineering 2015,
741702.  The public text of the paper lacks its equations, so every formula is derived anew; the structure is the paper's.

    paper        here                         plant
    x            x_a = [x; f_s]               states, and sensor faults as further states
    D₁, D₂       E_w W, by role               "decouple" and "attenuate"
    J, H         J = I - H C, J Φ₁ D₁ = 0     oblique projector with kernel Φ₁ D₁ and no more
    Φ_T          x + T Φ₁ (A x + ...)         Φ₁ = I: Euler; Φ₁ = (1/T) ∫ e^(As) ds: exact while φ and f are held
    L, F         T L, T F                     gains per second, so that they hardly depend on T
    γ₁, γ₂, γ₃   of d₂, η, f'                 in declared sizes, standard deviations, declared rates

    x̂_k = J z_k + H (y_k - D u_k),  r_k = y_k - C x̂_k - D u_k,  z_{k+1} = Φ_T(x̂_k, u_k, f̂_k) + T L r_k,  f̂_{k+1} = f̂_k + T F r_k

z is the whole prediction, so that J z + H y is the paper's "z + H y", and a sample that never came is z itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.limits import Floor
from faultrecon.finding import Finding, InputError
from faultrecon.graph.observer import Observer
from faultrecon.lmi.expr import Expr, __, let, sym, unknown
from faultrecon.methods.base import Assumed, Identity, Method, Scaling, Theorem, lipschitz_premises
from faultrecon.methods.papers import JIA_2015
from faultrecon.methods.sampled_conditions import each_premises, sampled_findings, unstructured
from faultrecon.methods.sampled_letters import (
    Channels,
    SampledLetters,
    augmented,
    averaged,
    held_fixed,
    held_model,
    noise_weighted_inverse,
    sampled_letters,
    total,
)
from faultrecon.methods.sampled_mismatch import Mismatch, euler_mismatch, held_mismatch
from faultrecon.methods.sampled_plants import HAS_ITS_MAP, OWN_MAP, continuous_findings
from faultrecon.methods.sampled_prediction import Prediction, assembled, runge_kutta
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]


class EulerPi(Method):
    """The reduced inequality in delta form: multiplier and levels joint unknowns, one sample of noise per step."""

    name = "euler-pi"
    summary = (
        "sampled proportional-integral observer, disturbances decoupled; actuator and sensor faults, Lipschitz plants"
    )
    paper = JIA_2015
    sampled = True
    idempotent: ClassVar[bool] = True
    """Whether J² = J: an oblique projector, which loses nothing but what is decoupled."""

    def __init__(self, sample_time: float | None = None) -> None:
        self.sample_time = sample_time

    def counted(self, plant: Plant) -> None:
        """None: the level is a weighted sum of three levels, and no gain from disturbances to errors."""
        return

    def sampling(self, values: Mapping[str, Any]) -> Method:
        """The same method for the sample time T among `values`, where there is one."""
        if "T" not in values:
            return self
        try:
            T = float(np.asarray(values["T"], dtype=float).item())
        except (TypeError, ValueError):
            T = math.nan
        if not (math.isfinite(T) and T > 0):
            raise InputError(f"the sample time T is {values['T']!r:.40}", why="it is a positive number of seconds")
        return type(self)(T)

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Additive faults, rank(C D₁) = q₁, no zero outside the circle, a constant fault seen."""
        return sampled_findings(self.posed(plant), self.sample_time)

    def unsolvable(self, plant: Plant) -> Finding | None:
        """What to do about a Lipschitz bound that no observer can live with."""
        return unstructured(self, plant)

    def floor(self, plant: Plant) -> Floor | None:
        """None is known for the sampled error system."""
        return None

    def posed(self, plant: Plant) -> Plant:
        """The plant as the inequality sees it."""
        return plant

    # ------------------------------------------------------------ model and decoupling

    def time(self, plant: Plant) -> float:
        """T in s: that of a sampled plant, else as asked for, else the time for which a noise sample is held."""
        own = plant.sample_time or self.sample_time
        if own is not None:
            return own
        assert plant.noise is not None, "the assumptions ask for it"
        return plant.noise.hold

    def model(self, plant: Plant, T: float) -> Array:
        """Φ₁ (n, n): how everything that is held over a sample time moves the state."""
        return averaged(plant, T)

    def mismatch(self, plant: Plant, T: float) -> Mismatch:
        """How far that model is off the plant per second, on the declared domain: by nothing where it is the plant."""
        return held_mismatch(plant, T) if plant.sample_time is None else Mismatch(np.zeros(plant.n))

    def left_inverse(self, plant: Plant, CD: Array) -> Array:
        """M with M C D₁ = I."""
        return noise_weighted_inverse(plant, CD)

    def channels(self, plant: Plant) -> Channels:
        """Which faults are states of the augmented plant, and which are constant between their corrections."""
        return Channels.of(plant)

    def unit_rates(self, plant: Plant) -> Array:
        """What one unit of ḟ is, per fault: its declared rate, else its size in a second; of f̈, that in a second."""
        return np.array([f.rate if math.isfinite(f.rate) else f.size for f in plant.faults])

    def decoupling(self, plant: Plant, Φ1: Array) -> Array:
        """H (n+k, p) = D₁ M for the D₁ of the same model: J = I - H C then has kernel D₁ and loses nothing else."""
        D1, C = augmented(plant, self.channels(plant))
        D1[: plant.n] = Φ1 @ D1[: plant.n]
        return D1 @ self.left_inverse(plant, C @ D1) if D1.shape[1] else np.zeros((len(D1), plant.p))

    # ------------------------------------------------------------ the theorem

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """The reduced inequality for this plant."""
        return self.theorem_reduced(self.posed(plant), scaling)

    # fmt: off
    def theorem_reduced(self, plant: Plant, scaling: Scaling) -> Theorem:
        """V = ζ'Pζ shrinks by 1 - 2αT per sample, but for T (w'Γw - |z|²); its last row times √T, so that T is exact.

        Size 2 N + m_φ + n_w.  T enters through T (.)'P⁻¹(.) alone: what holds at T holds at every shorter T.
        """
        T0 = self.time(plant)
        Φ0 = self.model(plant, T0)
        H0 = self.decoupling(plant, Φ0)
        m = sampled_letters(plant, self.channels(plant), scaling, H0, self.unit_rates(plant), T0, idempotent=self.idempotent)
        T, α, c_x, Λ = m.gains["T"], unknown("α"), unknown("c_x"), m.Λ
        P, Y = unknown("P", m.nz, m.nz, symmetric=True), unknown("Y", m.nz, plant.p)
        level, γ = unknown("γ²"), unknown("γ")
        levels = [unknown(f"γ{k}²") for k in "₁₂₃"]
        Γ  = let("Γ", total([g*(J@J.T) for g, J in zip(levels, m.parts, strict=True) if J.shape[1]]))
        X, Z = let("X", P@m.A - Y@m.C), let("Z", P@m.Ew - Y@m.Fw)
        PB = let("P B_r", P@m.Bφ)
        Cz = let("C_z'C_z", m.faults.T@m.faults + c_x**2*(m.states.T@m.states))
        lmi = sym([[ X + X.T + 2*α*P + Cz + Λ.bound(m.R, m.R),  PB      , Z + Λ.bound(m.R, m.Rw)   ,  T*X.T  ],
                   [ __                                      ,  Λ.minus , 0                        ,  T*PB.T ],
                   [ __                                      ,  __      , -Γ + Λ.bound(m.Rw, m.Rw) ,  T*Z.T  ],
                   [ __                                      ,  __      ,  __                      , -T*P    ]]) < 0
        weighed = [unknown(f"c{k}")*g for k, g, J in zip("₁₂₃", levels, m.parts, strict=True) if J.shape[1]]
        return Theorem(
            "4.2",
            [lmi.tagged("(4.2)"), (P > 0).tagged("P > 0"), *([(λ > 0).tagged(f"{λ} > 0") for λ in Λ.unknowns] if PB.shape[1] else []),
             ((level - total(weighed)) > 0).tagged("γ² > c₁γ₁² + c₂γ₂² + c₃γ₃²")],
            minimise=level,
            gains=self.ships(m, P, Y) | {m.gains[k]: m.gains[k] for k in ("T", "H", "Φ₁")},
            prove_with={Y: P@m.K, level: γ**2},
            lyapunov=P, drift=X, readout=m.faults, noise=P@m.Ew@m.parts[1] - Y@m.Fw@m.parts[1], mildest=levels[1],
            criterion="of the gains at this level those with the least γ₂, that of the noise",
            identities=[*m.identities, *self.model_identities(plant, scaling, m.gains, T0)],
            premises=[*(each_premises(plant) or lipschitz_premises(plant)), *self.premises(plant)],
            claim=self.claim(plant), scope=self.scope(plant),
            fixed={"T": T0, "H": H0, "Φ₁": Φ0} | held_fixed(plant, m), bases=("S", "S⁻¹", "S_f", "S_f⁻¹", "W", "T⁻¹", *BASES),
        )

    def ships(self, m: SampledLetters, P: Expr, Y: Expr) -> dict[Expr, Expr]:
        """L and F per second in canonical form K (I - C H): the direction that never acts is taken out."""
        state, fault, back = m.ship
        return {m.gains["L"]: state@P.inv()@Y@back, m.gains["F"]: fault@P.inv()@Y@back}
    # fmt: on

    def model_identities(
        self, plant: Plant, scaling: Scaling, gains: Mapping[str, Expr], T: float
    ) -> tuple[Identity, ...]:
        """That Φ₁ is what it is said to be."""
        return held_model(plant, scaling, gains, T)

    def premises(self, plant: Plant) -> list[Assumed]:
        """What else is taken for granted; nothing here."""
        return []

    def claim(self, plant: Plant) -> str:
        """What is guaranteed, in the letters of the certificate."""
        counted = ["γ₁² |d|²"] if any(d.role == "attenuate" for d in plant.attenuated) else []
        counted += ["γ₂² |η|²", f"γ₃² |{self.derivative}|²"]
        return (
            f"T Σ (|f - f̂|² + c_x² |x - x̂ - H ν|²) ≤ T Σ ({' + '.join(counted)}) + V(ζ(0)) on every horizon, where"
            " c₁ γ₁² + c₂ γ₂² + c₃ γ₃² < γ², in declared sizes, standard deviations of the noise and declared rates;"
            " V falls by 2 α T per sample without them; decoupled disturbances do not enter"
        )

    derivative: ClassVar[str] = "f'"
    """What of the fault is an unknown input."""

    def scope(self, plant: Plant) -> str:
        """What the guarantee covers, and what it does not."""
        covers = self.covers if plant.sample_time is None else OWN_MAP
        return f"covers the sampled loop {covers} in exact arithmetic with these gains{_for_which_phi(plant)}"

    covers: ClassVar[str] = (
        "at the sample time T, for the plant that is exact while u, φ, f and the disturbances are held over a sample time:"
        " it does not cover how φ, f and they move in between;"
    )

    # ------------------------------------------------------------ the observer

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """The equations above; the observer's state is [z; f̂_a]."""
        return assembled(plant, self.channels(plant), gains, Prediction(gains["Φ₁"]), idempotent=self.idempotent)

    def notes(self, plant: Plant, gains: Mapping[str, Array]) -> tuple[str, ...]:
        """The sample time, how fast the error falls where the nonlinearity adds nothing, and how far the model is off."""
        from faultrecon.methods.sampled_limits import practical_notes

        radius = np.abs(self.observer(plant, gains).poles).max()
        said = f"made for a sample every {gains['T'].item():g} s; spectral radius {radius:.6g} per sample (φ' = 0)"
        return said, *practical_notes(self, self.posed(plant), gains)


BASES = tuple(f"Φ_{2**j}" for j in range(1, 40))


class EulerPiEuler(EulerPi):
    """The paper's own mode: Φ₁ = I and M = (C D₁)⁺.  One proof at T covers every shorter T, for Euler's model."""

    name = "euler-pi-euler"
    summary = "euler-pi with the paper's Euler model; one certificate for every shorter sample time"
    variant_of = "euler-pi"
    covers = (
        "at every sample time up to T, for Euler's model of the plant: it does not cover the difference between that"
        " model and the plant, which is of the order of T;"
    )

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of euler-pi, and a continuous plant."""
        return continuous_findings(plant, HAS_ITS_MAP) or super().assumptions(plant)

    def model(self, plant: Plant, T: float) -> Array:
        """The identity."""
        return np.eye(plant.n)

    def mismatch(self, plant: Plant, T: float) -> Mismatch:
        """Half a sample time of ẍ."""
        return euler_mismatch(plant, T)

    def left_inverse(self, plant: Plant, CD: Array) -> Array:
        """That of least norm, in the units of the sensors."""
        return np.asarray(np.linalg.pinv(CD), dtype=float)

    def model_identities(
        self, plant: Plant, scaling: Scaling, gains: Mapping[str, Expr], T: float
    ) -> tuple[Identity, ...]:
        """There is nothing to show."""
        return ()


class EulerPiRk4(EulerPi):
    """Gains, decoupling and certificate of euler-pi; the prediction is a Runge-Kutta step in which φ moves with x."""

    name = "euler-pi-rk4"
    summary = "euler-pi with a Runge-Kutta prediction, for strong nonlinearities; its increment is checked, not proved"
    variant_of = "euler-pi"

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of euler-pi, and a continuous plant."""
        return continuous_findings(plant, HAS_ITS_MAP) or super().assumptions(plant)

    def mismatch(self, plant: Plant, T: float) -> Mismatch:
        """There is no bound in closed form."""
        return Mismatch(None, "the error of a Runge-Kutta step, O(T⁴) per second, has no bound in closed form")

    def premises(self, plant: Plant) -> list[Assumed]:
        """What the inequality does not see."""
        text = (
            "the prediction is a classical Runge-Kutta step, in which φ moves with x; the inequality is that of the step in"
            " which it is held, from which it differs by O(T²) per sample: checked in simulation"
        )
        return [Assumed("Runge-Kutta increment", text, "checked")]

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """The equations with Φ_T a Runge-Kutta step."""
        return assembled(plant, self.channels(plant), gains, runge_kutta(plant, float(gains["T"].item())))


class EulerPiRamp(EulerPi):
    """Faults that grow steadily: the fault is a state, its rate what the integrator holds, and γ₃ prices f''."""

    name = "euler-pi-ramp"
    summary = "euler-pi for faults that keep growing: a double integrator, which follows ramps without lag"
    variant_of = "euler-pi"
    derivative = "f''"

    def channels(self, plant: Plant) -> Channels:
        """Every fault is carried, and its rate drives it."""
        return Channels.of(plant, ramp=True)


class EulerPiMinimumNorm(EulerPi):
    """[J H] = [I 0] Θ⁺ with Θ = [I D₁; C 0], the literal reading of the paper's (12), (13).

    It uses the output beyond what decoupling asks for (J = (I + C'C)⁻¹ where nothing is to be decoupled).  With two
    samples of noise per step taken for independent, as a one-step inequality has them, its gains are four times as noisy;
    in the coordinates e + H ν one sample is enough, and L then takes back what H brought in: it is no better or worse.
    What holds at T need not hold at a shorter T.
    """

    name = "euler-pi-minimum-norm"
    summary = "euler-pi with the pseudo-inverse solution for J and H, actuator faults only; for comparison"
    variant_of = "euler-pi"
    idempotent = False

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of euler-pi, and no sensor fault: H would read it."""
        found = super().assumptions(plant)
        sensor = [f.name for f in plant.faults if f.site == "sensor"]
        if not sensor or any(f.severity == "fatal" for f in found):
            return found
        why = "the pseudo-inverse lets every output into x̂ at once, and a faulty one brings its fault along"
        return [
            Finding(f"'{sensor[0]}' is a fault of a sensor", why=why, remedies=("use euler-pi",), see="Jia 2015, (12)")
        ]

    def decoupling(self, plant: Plant, Φ1: Array) -> Array:
        """H of the solution of least norm of [J H] Θ = [I 0]."""
        D1, C = augmented(plant, self.channels(plant))
        D1[: plant.n] = Φ1 @ D1[: plant.n]
        (na, q1), p = D1.shape, plant.p
        Θ = np.block([[np.eye(na), D1], [C, np.zeros((p, q1))]])
        return np.asarray(np.linalg.pinv(Θ)[:na, na:], dtype=float)


class EulerObserver(EulerPi):
    """The same with J = I, H = 0: what euler-pi would decouple is attenuated like every other disturbance.

    It is stronger than the Euler-approximate observer of the literature, which has no level for disturbances at all.
    """

    name = "euler-observer"
    summary = "baseline: euler-pi without decoupling (J = I, H = 0), every disturbance attenuated"
    baseline = True

    def posed(self, plant: Plant) -> Plant:
        """The plant in which nothing is to be decoupled."""
        return attenuating(plant)


def attenuating(plant: Plant) -> Plant:
    """The same plant, which asks that every counted disturbance be attenuated."""
    kept = [replace(d, role="attenuate") if d.role == "decouple" else d for d in plant.disturbances]
    return replace(plant, disturbances=tuple(kept))


def _for_which_phi(plant: Plant) -> str:
    text = ""
    if plant.nonlinearity is not None:
        known = plant.nonlinearity.channels if plant.nonlinearity.separate else None
        text += (
            " for Lipschitz constants of the components of φ up to " if known else " for a Lipschitz constant up to "
        )
        text += ", ".join(f"{c:.9g}" for c in known or (plant.nonlinearity.constant,))
        if plant.nonlinearity.domain:
            box = ", ".join(f"{k} in [{a:g}, {b:g}]" for k, (a, b) in plant.nonlinearity.domain.items())
            text += f" while the plant stays in {box}"
    return text + "; does not cover rounding at run time, missing samples, or a plant that differs from the model"
