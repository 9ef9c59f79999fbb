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
from faultrecon.lmi.expr import Expr, I, __, let, sym, unknown
from faultrecon.methods.base import Assumed, Identity, Method, Scaling, Theorem, lipschitz_premises
from faultrecon.methods.papers import JIA_2015
from faultrecon.methods.sampled_conditions import sampled_findings, unstructured
from faultrecon.methods.sampled_letters import (
    Channels,
    SampledLetters,
    augmented,
    averaged,
    held_model,
    noise_weighted_inverse,
    sampled_letters,
)
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
        """A continuous plant with additive faults, rank(C D₁) = q₁, no zero outside the circle, a constant fault seen."""
        return sampled_findings(plant, self.sample_time)

    def unsolvable(self, plant: Plant) -> Finding | None:
        """What to do about a Lipschitz bound that no observer can live with."""
        return unstructured(self, plant)

    def floor(self, plant: Plant) -> Floor | None:
        """None is known for the sampled error system."""
        return None

    # ------------------------------------------------------------ model and decoupling

    def time(self, plant: Plant) -> float:
        """T in s: as asked for, else the time for which a noise sample is held."""
        if self.sample_time is not None:
            return self.sample_time
        assert plant.noise is not None, "the assumptions ask for it"
        return plant.noise.hold

    def model(self, plant: Plant, T: float) -> Array:
        """Φ₁ (n, n): how everything that is held over a sample time moves the state."""
        return averaged(plant, T)

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
        return self.theorem_reduced(plant, scaling)

    # fmt: off
    def theorem_reduced(self, plant: Plant, scaling: Scaling) -> Theorem:
        """V = ζ'Pζ shrinks by 1 - 2αT per sample, but for T (w'Γw - |z|²); its last row times √T, so that T is exact.

        Size 2 N + m_φ + n_w.  T enters through T (.)'P⁻¹(.) alone: what holds at T holds at every shorter T.
        """
        T0 = self.time(plant)
        Φ0 = self.model(plant, T0)
        H0 = self.decoupling(plant, Φ0)
        m = sampled_letters(plant, self.channels(plant), scaling, H0, self.unit_rates(plant), T0, idempotent=self.idempotent)
        T, α, c_x, λ = m.gains["T"], unknown("α"), unknown("c_x"), unknown("λ")
        P, Y = unknown("P", m.nz, m.nz, symmetric=True), unknown("Y", m.nz, plant.p)
        level, γ = unknown("γ²"), unknown("γ")
        levels = [unknown(f"γ{k}²") for k in "₁₂₃"]
        Γ  = let("Γ", _sum([g*(J@J.T) for g, J in zip(levels, m.parts, strict=True) if J.shape[1]]))
        X, Z = let("X", P@m.A - Y@m.C), let("Z", P@m.Ew - Y@m.Fw)
        PB = let("P B_r", P@m.Bφ)
        Λ  = let("λℓ²", λ*m.α**2)
        Cz = let("C_z'C_z", m.faults.T@m.faults + c_x**2*(m.states.T@m.states))
        lmi = sym([[ X + X.T + 2*α*P + Cz + Λ*(m.R.T@m.R),  PB                , Z + Λ*(m.R.T@m.Rw)   ,  T*X.T  ],
                   [ __                                  , -λ*I(PB.shape[1])  , 0                    ,  T*PB.T ],
                   [ __                                  ,  __                , -Γ + Λ*(m.Rw.T@m.Rw) ,  T*Z.T  ],
                   [ __                                  ,  __                ,  __                  , -T*P    ]]) < 0
        weighed = [unknown(f"c{k}")*g for k, g, J in zip("₁₂₃", levels, m.parts, strict=True) if J.shape[1]]
        return Theorem(
            "4.2",
            [lmi.tagged("(4.2)"), (P > 0).tagged("P > 0"), *([(λ > 0).tagged("λ > 0")] if PB.shape[1] else []),
             ((level - _sum(weighed)) > 0).tagged("γ² > c₁γ₁² + c₂γ₂² + c₃γ₃²")],
            minimise=level,
            gains=self.ships(m, P, Y) | {m.gains[k]: m.gains[k] for k in ("T", "H", "Φ₁")},
            prove_with={Y: P@m.K, level: γ**2},
            lyapunov=P, drift=X, readout=m.faults, noise=P@m.Ew@m.parts[1] - Y@m.Fw@m.parts[1], mildest=levels[1],
            criterion="of the gains at this level those with the least γ₂, that of the noise",
            identities=[*m.identities, *self.model_identities(plant, scaling, m.gains, T0)],
            premises=[*lipschitz_premises(plant), *self.premises(plant)],
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
        return f"covers the sampled loop {self.covers} in exact arithmetic with these gains{_for_which_phi(plant)}"

    covers: ClassVar[str] = (
        "at the sample time T, for the plant that is exact while u, φ, f and the disturbances are held over a sample time:"
        " it does not cover how φ, f and they move in between;"
    )

    # ------------------------------------------------------------ the observer

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """The equations above; the observer's state is [z; f̂_a]."""
        return assembled(plant, self.channels(plant), gains, Prediction(gains["Φ₁"]), idempotent=self.idempotent)

    def notes(self, plant: Plant, gains: Mapping[str, Array]) -> tuple[str, ...]:
        """The sample time, and how fast the error falls where the nonlinearity adds nothing."""
        poles = np.abs(self.observer(plant, gains).poles)
        return (
            f"made for a sample every {gains['T'].item():g} s; spectral radius {poles.max():.6g} per sample (φ' = 0)",
        )


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

    def model(self, plant: Plant, T: float) -> Array:
        """The identity."""
        return np.eye(plant.n)

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

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of euler-pi, but for what concerns decoupling."""
        return super().assumptions(attenuating(plant))

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """The reduced inequality, which then is the whole one."""
        return self.theorem_reduced(attenuating(plant), scaling)


def attenuating(plant: Plant) -> Plant:
    """The same plant, which asks that every counted disturbance be attenuated."""
    kept = [replace(d, role="attenuate") if d.role == "decouple" else d for d in plant.disturbances]
    return replace(plant, disturbances=tuple(kept))


STATE_WEIGHT = 0.1
"""Of the state error, in declared ranges, against the fault error, in declared sizes: without it gains drift off."""
NOISE_WEIGHT = 10.0
"""c₂ over c₁ and c₃: a disturbance may sit at its worst frequency, noise never does.  On the flexible joint the errors
of reconstructed faults are least between 1 and 10."""


def held_fixed(plant: Plant, m: SampledLetters) -> dict[str, Any]:
    """What is chosen before the program: decay rate, weights, and λ where there is no nonlinearity."""
    fixed: dict[str, Any] = {"α": decay_rate(plant), "c_x": STATE_WEIGHT}
    fixed |= {f"c{k}": c for k, c, J in zip("₁₂₃", (1.0, NOISE_WEIGHT, 1.0), m.parts, strict=True) if J.shape[1]}
    return fixed if m.Bφ.shape[1] else fixed | {"λ": 1.0}


def decay_rate(plant: Plant) -> float:
    """α in 1/s that every plant allows: a quarter of its slowest mode that moves, half of the slowest fixed zero."""
    from faultrecon.diagnosis.conditions import minimum_phase

    rates = np.abs(np.linalg.eigvals(plant.A))
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    slowest = 0.25 * float(rates.min()) if rates.size else 0.25
    zero = minimum_phase(plant).where
    return slowest if zero is None else min(slowest, -0.5 * zero.real)


def _sum(terms: list[Expr]) -> Expr:
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total


def _for_which_phi(plant: Plant) -> str:
    text = ""
    if plant.nonlinearity is not None:
        text += f" for a Lipschitz constant up to {plant.nonlinearity.constant:.9g}"
        if plant.nonlinearity.domain:
            box = ", ".join(f"{k} in [{a:g}, {b:g}]" for k, (a, b) in plant.nonlinearity.domain.items())
            text += f" while the plant stays in {box}"
    return text + "; does not cover rounding at run time, missing samples, or a plant that differs from the model"
