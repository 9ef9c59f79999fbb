# SPDX-License-Identifier: BSD-3-Clause
"""The augmented plant of sliding-mode observers in canonical coordinates and declared units, as numbers and as letters.

The fault is one more state, x_a = [x; f].  Barred coordinates T_c x_a end with the outputs S y, the healthy ones first;
states and sensors count in their declared ranges (powers of two), faults in their declared sizes [Alwi 2009, section 2].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.sliding import pace
from faultrecon.graph.observer import Observer
from faultrecon.lmi.expr import Expr, I, __, given, let, sym, unknown
from faultrecon.methods.base import Identity
from faultrecon.numerics.hinf import hinf_norm
from faultrecon.numerics.pencil import unobservable_modes
from faultrecon.numerics.sliding import (
    Canonical,
    canonical,
    high_frequency_gain,
    minimal_gamma0,
    peak_injection,
    sliding_motion,
)
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

ROUNDING = 2.0**-40
"""T_c T_c⁻¹ = I and S C_a T_c⁻¹ = [0 I] hold exactly where sensors read single states, else to rounding far below this."""


LEAST_P = 0.01
"""Default of p_min in P >= p_min I: without it the optimum is approached by P that lose rank and gains without bound."""
TRUST = 10.0
"""Default γ₀ of the linear part, in units of the time in which a fault grows to its size: the paper's."""
LOOSENESS = 2.5
"""Least default of γ₀ over the smallest that (46) allows: next to that one the gains run away."""
SURE = 2.0
"""The injection's bound over what the sliding motion needs at most: the rest is for the way to the sliding surface."""


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Canonical coordinates in declared units: barred state T_c [x; f], barred outputs S y.

    form: of the plant in declared ranges and sizes, real time.  T, Ti (N, N), S, Si (p, p): from the plant's own units.
    pace: a power of two near the plant's time constants, s.
    """

    form: Canonical
    T: Array
    Ti: Array
    S: Array
    Si: Array
    ranges: Array
    pace: float


@lru_cache(maxsize=32)
def coordinates(plant: Plant) -> Coordinates:
    """The canonical coordinates of a plant that meets the method's assumptions."""
    ranges = [np.array(group.ranges, float) for group in (plant.signals.x, plant.signals.y)]
    usual = max(f.size for f in plant.faults)  # where no range is declared: a signal is as large as its fault
    x, y = (np.where(np.isfinite(values), values, usual) for values in ranges)
    t, r = _powers(x), _powers(y)
    size = np.array([f.size for f in plant.faults])
    weights = plant.letters()
    form = canonical(
        plant.A * t / t[:, None],
        plant.B / t[:, None],
        plant.C * t / r[:, None],
        plant.F_f * size / r[:, None],
        (plant.E_w @ weights["W"] / t[:, None])[:, into_states(plant)],
    )
    units = np.concatenate([t, size])
    return Coordinates(
        form, form.T / units, units[:, None] * form.T_inverse, form.S / r, r[:, None] * form.S_inverse, y, pace(plant)
    )


def _powers(ranges: Array) -> Array:
    """The nearest powers of two, so that units come and go without rounding."""
    return np.exp2(np.rint(np.log2(ranges)))


def into_states(plant: Plant) -> list[int]:
    """Which of the counted disturbances act on the states: ψ."""
    return [k for k, d in enumerate(plant.attenuated) if any(d.into.values())]


def growth_time(plant: Plant) -> float:
    """The time in which the slowest declared fault grows to its size, s; the plant's own pace where no rate is declared."""
    times = [f.size / f.rate for f in plant.faults if np.isfinite(f.rate)]
    return max(times, default=pace(plant))


@dataclass(frozen=True, eq=False)
class AugmentedLetters:
    """The augmented plant of the paper as expressions, in canonical coordinates and units of time 1/U."""

    n1: int
    p: int
    q: int
    pace: float
    A: Expr
    C: Expr
    F: Expr
    M: Expr
    E: Expr
    T: Expr
    Ti: Expr
    S: Expr
    Si: Expr
    U: Expr
    Ui: Expr
    Ri: Expr
    J1: Expr
    J2: Expr
    noise: Expr
    G_n: Expr
    bases: tuple[str, ...] = ("T_c", "T_c⁻¹", "S", "S⁻¹")

    @property
    def N(self) -> int:
        return self.n1 + self.p

    @property
    def healthy(self) -> Expr:
        """[I; 0], (p, p-q): the healthy ones among the barred outputs."""
        return given("[I; 0]", np.eye(self.p, self.p - self.q))

    @property
    def L(self) -> Expr:
        """L (n1, p) of the G_n that ships: G_n = T_c⁻¹ [-L; I]."""
        return -(self.J1.T @ self.T @ self.G_n)

    def identities(self) -> list[Identity]:
        below = given("[0 I]", np.eye(self.p, self.N, self.n1))
        return [
            Identity("T_c T_c⁻¹ = I", self.T @ self.Ti - I(self.N), ROUNDING),
            Identity("S S⁻¹ = I", self.S @ self.Si - I(self.p), ROUNDING),
            Identity("U U⁻¹ = 1", self.U * self.Ui - I(1)),
            Identity("C_a = [0 I]: the outputs are the last states", self.C - below, ROUNDING),
            Identity(
                "[0 I] G_n = I: the injection acts on the outputs", self.J2.T @ self.T @ self.G_n - I(self.p), ROUNDING
            ),
        ]


def augmented_letters(plant: Plant) -> AugmentedLetters:
    """The letters of a plant that meets the method's assumptions."""
    own, s = coordinates(plant), {k: given(f"plant.{k}", v) for k, v in plant.letters().items()}
    n, p, q = plant.n, plant.p, len(plant.faults)
    N, n1 = n + q, n + q - p
    Jx, Jf = given("J_x", np.eye(N, n)), given("J_f", np.eye(N, q, -n))
    T, Ti = given("T_c", own.T), given("T_c⁻¹", own.Ti)
    S, Si = given("S", own.S), given("S⁻¹", own.Si)
    U, Ui = given("U", 1.0 / own.pace), given("U⁻¹", own.pace)
    V, Vi = s["V"], given("V⁻¹", np.diag([f.size for f in plant.faults]))
    chosen = given("J_ψ", np.eye(len(plant.attenuated))[:, into_states(plant)])
    sd = np.zeros((p, 0)) if plant.noise is None else np.diag(np.sqrt(plant.noise.hold) * np.array(plant.noise.sd))
    return AugmentedLetters(
        n1, p, q, own.pace,
        A=let("A_a", Ui * (T @ Jx @ s["A"] @ Jx.T @ Ti)),
        C=let("C_a", S @ (s["C"] @ Jx.T + s["F_f"] @ Jf.T) @ Ti),
        F=let("F_a", T @ Jf @ Vi),
        M=let("M_a", T @ Jx @ s["E_w"] @ s["W"] @ chosen),
        E=let("C_f", V @ Jf.T @ Ti),
        T=T, Ti=Ti, S=S, Si=Si, U=U, Ui=Ui, Ri=given("(ranges)⁻¹", np.diag(1.0 / own.ranges)),
        J1=given("J_1", np.eye(N, n1)), J2=given("J_2", np.eye(N, p, -n1)),
        noise=S @ given("noise", sd),
        G_n=unknown("G_n", N, p),
    )  # fmt: skip


def multiplier(m: AugmentedLetters, exact: bool) -> tuple[Expr, Expr, Expr]:
    """P by its blocks, its block P12 and P11; for L2 = 0 the columns of P12 that belong to faulty outputs are zero."""
    P11, P22 = unknown("P11", m.n1, m.n1, symmetric=True), unknown("P22", m.p, m.p, symmetric=True)
    free = unknown("P12", m.n1, m.p - m.q if exact else m.p)
    P12 = free @ m.healthy.T if exact else free
    return let("P", sym([[P11, P12], [__, P22]])), P12, P11


# fmt: off
def shipped(m: AugmentedLetters, P: tuple[Expr, Expr, Expr], Y: Expr, given_Y: Expr, exact: bool) -> tuple[dict[Expr, Expr], dict[Expr, Expr]]:
    """The gains that ship, and the program's unknowns in their terms; given_Y: the part of Y that is not ΔY."""
    whole, P12, P11 = P
    G_l, P0, L = unknown("G_l", m.N, m.p), unknown("P0", m.p, m.p), let("L", m.L)
    weight = m.S.T@(m.J2.T@whole@m.J2 - P12.T@P11.inv()@P12)@m.S
    gains = {
        m.G_n: m.Ti@(m.J2 - m.J1@P11.inv()@P12),
        G_l: m.U*(m.Ti@whole.inv()@Y@m.S),                                                                      # (47)
        P0: 0.5*(weight + weight.T),
    }
    P22, half = unknown("P22", m.p, m.p, symmetric=True), unknown("P12", m.n1, m.p - m.q if exact else m.p)
    below = m.Si.T@P0@m.Si + L.T@P11@L
    P_L = let("P_L", sym([[P11, P11@L], [__, below]]))                                  # P in the gains that ship
    back = {
        half: P11@L@m.healthy if exact else P11@L,
        P22: below,
        unknown("ΔY", m.N, m.p): m.Ui*(P_L@m.T@G_l@m.Si) - given_Y,
    }
    return gains, back
# fmt: on


def no_direct(m: AugmentedLetters, exact: bool) -> list[Identity]:
    """[I L] F_a = 0, which is L2 = 0, when that is what the proof has put in."""
    if not exact:
        return []
    return [Identity("[I L] F_a = 0: the rate of the fault does not enter", (m.J1.T + m.L @ m.J2.T) @ m.F, ROUNDING)]


def sliding_gain(plant: Plant, gains: Mapping[str, Array]) -> Array:
    """L (n1, p) in canonical coordinates, from the injection's G_n that ships in the plant's units."""
    own = coordinates(plant)
    return -(own.T @ gains["G_n"])[: own.form.n1]


def injection_gain(plant: Plant, L: Array) -> Array:
    """G_n (N, p) in the plant's units, from L in canonical coordinates."""
    own = coordinates(plant)
    return own.Ti @ np.vstack([-L, np.eye(own.form.p)])


def suggested_bound(plant: Plant, L: Array) -> float:
    """ρ in declared units per second: twice the largest equivalent injection that declared rates and disturbances ask for."""
    form = coordinates(plant).form
    rates = np.array([f.rate / f.size if np.isfinite(f.rate) else 1.0 / growth_time(plant) for f in plant.faults])
    asked = peak_injection(form, L).value * float(np.linalg.norm(rates))
    ψ = len(into_states(plant))  # each of them within its declared size
    return SURE * (asked + peak_injection(form, L, of="disturbance").value * float(np.sqrt(ψ)))


def held_fixed(plant: Plant) -> dict[str, Any]:
    """What is chosen before the program: the trust in the model and the sensors, p_min, and (47)."""
    own, τ = coordinates(plant), growth_time(plant)
    noise = own.S * own.ranges * τ / own.pace  # S D1 with D1 = d (ranges), d = τ; all in the plant's own time
    least = own.pace * minimal_gamma0(replace(own.form, A_a=own.pace * own.form.A_a), noise @ noise.T)
    return {"γ₀": max(TRUST * τ, LOOSENESS * least), "w_y": 1.0 / τ**2, "p_min": LEAST_P, "ΔY": 0.0}


def decay_rate(plant: Plant) -> float:
    """A decay rate for the sliding motion that every plant allows: slower than what is fixed, a quarter of its slowest."""
    own = coordinates(plant)
    fixed = [-mode.value.real for mode in unobservable_modes(own.form.A11, own.form.A211)]
    rates = np.abs(np.linalg.eigvals(plant.A))
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    slowest = 0.25 * float(rates.min()) if rates.size else 0.25 / own.pace
    return min([slowest, *(0.5 * rate for rate in fixed)])


def said_of_sliding(plant: Plant, gains: Mapping[str, Array], observer: Observer) -> tuple[str, ...]:
    """The sliding motion's poles, its gains, the injection's bound, and what the linear part alone would do, in words."""
    own, L, q = coordinates(plant), sliding_gain(plant, gains), len(plant.faults)
    Ac, Bc, Cc = sliding_motion(own.form, L)
    level = hinf_norm(Ac, Bc[:, :q], Cc, np.zeros((q, q))).value
    noise = float(np.linalg.norm(high_frequency_gain(own.form, L), 2))
    return (
        f"sliding poles {_listed(np.linalg.eigvals(Ac))} 1/s; error at most {level:.6g} s times the rate of the fault"
        " (worst frequency)",
        f"noise of a faulty sensor reaches f̂ with gain {noise:.4g} at high frequency",
        f"injection ν bounded by ρ = {suggested_bound(plant, L):.4g} declared sizes per second; "
        "checked in simulation, not proved: that sliding is reached, and the sampled loop",
        f"without the injection (ν = 0) the same gains give {_linear_level(plant, observer):.6g} s",
    )


def _listed(values: NDArray[Any]) -> str:
    """Eigenvalues in words: a conjugate pair once."""
    upper = sorted((s for s in values if s.imag >= 0), key=lambda s: s.real)
    return ", ".join(f"{s.real:.4g}" + (f" ± {s.imag:.4g}j" if s.imag else "") for s in upper)


def _linear_level(plant: Plant, observer: Observer) -> float:
    """The gain from the faults' rates to the errors with ν = 0, s, in declared sizes."""
    size = np.array([f.size for f in plant.faults])
    into, q = np.vstack([np.zeros((plant.n, len(size))), np.diag(size)]), len(size)
    return hinf_norm(observer.A, into, observer.Cf / size[:, None], np.zeros((q, q))).value
