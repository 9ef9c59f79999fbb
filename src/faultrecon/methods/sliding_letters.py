# SPDX-License-Identifier: BSD-3-Clause
"""The augmented plant of sliding-mode observers in canonical coordinates and declared units, as numbers and as letters.

The fault is one more state, x_a = [x; f].  Barred coordinates T_c x_a end with the outputs S y, the healthy ones first;
states and sensors count in their declared ranges (powers of two), faults in their declared sizes [Alwi 2009, section 2].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.lmi.expr import Expr, I, __, given, let, sym, unknown
from faultrecon.methods.base import Identity
from faultrecon.numerics.pencil import unobservable_modes
from faultrecon.numerics.sliding import Canonical, canonical, minimal_gamma0, peak_injection
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

ROUNDING = 2.0**-40
"""T_c T_c⁻¹ = I and S C_a T_c⁻¹ = [0 I] hold exactly where sensors read single states, else to rounding far below this."""


LEAST_P = 0.01
"""Default of p_min in P >= p_min I: without it the optimum is approached by P that lose rank and gains without bound."""
TRUST = 10.0
"""Default γ₀ of the linear part, in units of the time in which a fault grows to its size: the paper's."""
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
    t, r = (_powers(np.array(group.ranges, float)) for group in (plant.signals.x, plant.signals.y))
    size = np.array([f.size for f in plant.faults])
    weights = plant.letters()
    form = canonical(
        plant.A * t / t[:, None],
        plant.B / t[:, None],
        plant.C * t / r[:, None],
        plant.F_f * size / r[:, None],
        plant.E_w @ weights["W"] / t[:, None],
    )
    units = np.concatenate([t, size])
    return Coordinates(
        form, form.T / units, units[:, None] * form.T_inverse, form.S / r, r[:, None] * form.S_inverse, r, _pace(plant)
    )


def _powers(ranges: Array) -> Array:
    """The nearest powers of two, so that units come and go without rounding; one where no range is declared."""
    return np.exp2(np.rint(np.log2(np.where(np.isfinite(ranges), ranges, 1.0))))


def _pace(plant: Plant) -> float:
    rates = np.abs(np.linalg.eigvals(plant.A))
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    return float(np.exp2(np.rint(-np.mean(np.log2(rates))))) if rates.size else 1.0


def growth_time(plant: Plant) -> float:
    """The time in which the slowest declared fault grows to its size, s; 1 where no rate is declared."""
    times = [f.size / f.rate for f in plant.faults if np.isfinite(f.rate)]
    return max(times, default=1.0)


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
    L: Expr
    bases: tuple[str, ...] = ("T_c", "T_c⁻¹", "S", "S⁻¹")

    @property
    def N(self) -> int:
        return self.n1 + self.p

    @property
    def healthy(self) -> Expr:
        """[I; 0], (p, p-q): the healthy ones among the barred outputs."""
        return given("[I; 0]", np.eye(self.p, self.p - self.q))

    def identities(self) -> list[Identity]:
        below = given("[0 I]", np.eye(self.p, self.N, self.n1))
        return [
            Identity("T_c T_c⁻¹ = I", self.T @ self.Ti - I(self.N), ROUNDING),
            Identity("S S⁻¹ = I", self.S @ self.Si - I(self.p), ROUNDING),
            Identity("U U⁻¹ = 1", self.U * self.Ui - I(1)),
            Identity("C_a = [0 I]: the outputs are the last states", self.C - below, ROUNDING),
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
    sd = np.zeros((p, 0)) if plant.noise is None else np.diag(np.sqrt(plant.noise.hold) * np.array(plant.noise.sd))
    return AugmentedLetters(
        n1, p, q, own.pace,
        A=let("A_a", Ui * (T @ Jx @ s["A"] @ Jx.T @ Ti)),
        C=let("C_a", S @ (s["C"] @ Jx.T + s["F_f"] @ Jf.T) @ Ti),
        F=let("F_a", T @ Jf @ Vi),
        M=let("M_a", T @ Jx @ s["E_w"] @ s["W"]),
        E=let("C_f", V @ Jf.T @ Ti),
        T=T, Ti=Ti, S=S, Si=Si, U=U, Ui=Ui, Ri=given("(ranges)⁻¹", np.diag(1.0 / own.ranges)),
        J1=given("J_1", np.eye(N, n1)), J2=given("J_2", np.eye(N, p, -n1)),
        noise=S @ given("noise", sd),
        L=unknown("L", n1, p),
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
    L, G_l, P0 = m.L, unknown("G_l", m.N, m.p), unknown("P0", m.p, m.p)
    schur = m.J2.T@whole@m.J2 - P12.T@P11.inv()@P12
    gains = {
        L: P11.inv()@P12,
        G_l: m.U*(m.Ti@whole.inv()@Y@m.S),                                                                      # (47)
        P0: 0.5*(schur + schur.T),
    }
    P22, half = unknown("P22", m.p, m.p, symmetric=True), unknown("P12", m.n1, m.p - m.q if exact else m.p)
    P_L = let("P_L", sym([[P11, P11@L], [__, P0 + L.T@P11@L]]))                         # P in the gains that ship
    back = {
        half: P11@L@m.healthy if exact else P11@L,
        P22: P0 + L.T@P11@L,
        unknown("ΔY", m.N, m.p): m.Ui*(P_L@m.T@G_l@m.Si) - given_Y,
    }
    return gains, back
# fmt: on


def no_direct(m: AugmentedLetters, exact: bool) -> list[Identity]:
    """L2 = 0, when that is what the proof has put in."""
    if not exact:
        return []
    faulty = given("[0; I]", np.eye(m.p, m.q, -(m.p - m.q)))
    return [Identity("L2 = 0: the rate of the fault does not enter", m.L @ faulty)]


def suggested_bound(plant: Plant, L: Array) -> float:
    """ρ in declared units per second: twice the largest equivalent injection that faults of the declared rate ask for."""
    rates = np.array([f.rate / f.size if np.isfinite(f.rate) else 1.0 / growth_time(plant) for f in plant.faults])
    return SURE * peak_injection(coordinates(plant).form, L).value * float(np.linalg.norm(rates))


def held_fixed(plant: Plant) -> dict[str, Any]:
    """What is chosen before the program: the trust in the model and the sensors, p_min, and (47)."""
    own, τ = coordinates(plant), growth_time(plant)
    noise = own.form.S * own.ranges[:, None].T * τ  # S in declared ranges, times d = τ
    least = minimal_gamma0(own.form, noise @ noise.T)
    return {"γ₀": max(TRUST * τ, 0.5 * TRUST * least), "w_y": 1.0 / τ**2, "p_min": LEAST_P, "ΔY": 0.0}


def decay_rate(plant: Plant) -> float:
    """A decay rate for the sliding motion that every plant allows: slower than what is fixed, a quarter of its slowest."""
    own = coordinates(plant)
    fixed = [-mode.value.real for mode in unobservable_modes(own.form.A11, own.form.A211)]
    rates = np.abs(np.linalg.eigvals(plant.A))
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    slowest = 0.25 * float(rates.min()) if rates.size else 0.25 / own.pace
    return min([slowest, *(0.5 * rate for rate in fixed)])
