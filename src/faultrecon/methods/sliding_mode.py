# SPDX-License-Identifier: BSD-3-Clause
"""Sliding-mode reconstruction of incipient sensor faults, for stable and unstable plants [Alwi, Edwards, Tan 2009].

Read it with the paper: H. Alwi, C. Edwards, C. P. Tan, "Sliding mode estimation schemes for incipient sensor faults",
Automatica 45, 2009, 1679-1685.  The fault is one more state, x_a = [x; f], its rate ξ = f' the unknown input:

    paper            here                         plant
    A_a, F_a, C_a    T_c [A 0; 0 0] T_c⁻¹, ...    A, C, F_f     coordinates in which C_a = [0 I], time in units of 1/U
    M_a              T_c [E_w W; 0]               E_w, W        ψ: disturbances of the states, in declared sizes
    y                S y                          y             healthy outputs first, then the faults' own, in their sizes
    D1               w_y D1 D1ᵀ = (ranges)²       y ranges      what an error of each sensor counts
    L, G_n           L, [-L; I]                                 sliding motion e1' = (A11 + L A21) e1 - L2 ξ - (M1 + L M2) ψ

Signs are those of the error equation: C_e = [0 -I] and -L2 ξ (both are turned in print, which cancels in the norm but
not in the inequality), and (54) contains M, which the printed one leaves out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis import conditions
from faultrecon.diagnosis.existence import additive_sensor_findings, fault_findings
from faultrecon.diagnosis.limits import Floor, hidden_floor
from faultrecon.finding import Finding
from faultrecon.graph.observer import CopiedTerm, Injection, Observer
from faultrecon.lmi.expr import Expr, I, Inequality, __, given, let, sym, unknown, zeros
from faultrecon.methods.base import Identity, Method, Reproduction, Scaling, Theorem, deviations
from faultrecon.methods.papers import ALWI_2009
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
WEAK = 1e-3
"""Relative distance to undetectability below which the exact design (L2 = 0) needs gains that amplify noise by thousands:
modes that are nearly hidden are then treated as hidden."""
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


class SlidingMode(Method):
    """Inequalities (46) and (54), corrected, with P >= p_min I; the least level, then the mildest P at the shipped one."""

    name = "sliding-mode"
    summary = "sliding-mode observer of the fault as a state; additive incipient sensor faults, unstable plants too"
    paper = ALWI_2009
    exact: ClassVar[bool | None] = None
    """Whether L2 = 0 is demanded; None: where the healthy sensors see enough."""
    printed: ClassVar[bool] = False
    """Whether (54) leaves M out, as it does in print."""
    injects: ClassVar[bool] = True
    """Whether the injection is applied; without it the observer is linear and its level is that of (46)."""

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Additive faults on fewer sensors than there are, C of full row rank, a linear plant, no hidden equilibrium."""
        found = additive_sensor_findings(plant) or fault_findings(plant) or _structure(plant) or _constant_fault(plant)
        if found:
            return found
        seen = conditions.detectable(plant)
        if self.exact and seen.distance < WEAK:
            return [_not_exact(plant, seen)]
        if self.exact is None and seen.holds and seen.distance < WEAK:
            return [_nearly_hidden(seen)]
        return []

    def floor(self, plant: Plant) -> Floor | None:
        """What hidden modes cost, in seconds, against which the level of the sliding motion stands."""
        return None if self._is_exact(plant) or not self.injects else hidden_floor(plant)

    def _is_exact(self, plant: Plant) -> bool:
        return bool(self.exact) if self.exact is not None else conditions.detectable(plant).distance >= WEAK

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """The sliding motion at level γ, and a linear part that is stable at level γ₀."""
        exact = self._is_exact(plant)
        return self.theorem_46(plant) if exact and not plant.attenuated else self.theorem_54(plant, exact)

    # fmt: off
    def theorem_54(self, plant: Plant, exact: bool = False) -> Theorem:
        """Inequalities (46), with (63) for ψ, and (54) with M in it: the least level of the sliding motion.

        P, shared by both, has the blocks P11, P12 and P22 of the sliding motion and the outputs.  G_l is eliminated from
        (46) as in (47); the proof puts the gains that ship back.  For L2 = 0 the fault's rate leaves (54) altogether.
        """
        m = _letters(plant)
        P, P12, P11 = _multiplier(m, exact)
        γ0, γ  = m.U*unknown("γ₀"), unknown("γ_U")
        X11    = let("X11", (m.J1.T@P)@m.A@m.J1 + m.J1.T@m.A.T@(m.J1.T@P).T)
        B2, M2 = let("P11 L2", (m.J1.T@P)@m.F), let("B_ψ", (m.J1.T@P)@m.M)
        if self.printed:
            M2 = zeros(m.n1, 0)
        Ce     = m.E@m.J1
        first  = [[ X11, -B2               , -M2                 ,  Ce.T      ],
                  [ __ , -γ*I(B2.shape[1]) ,  0                  ,  0         ],
                  [ __ , __                , -γ*I(M2.shape[1])   ,  0         ],
                  [ __ , __                ,  __                 , -γ*I(m.q)  ]]
        if exact:
            first = [[row[k] for k in (0, 2, 3)] for row in (first[0], first[2], first[3])]
        lmi_54 = sym(first) < 0                                                                            # (54'), M added
        linear, gains, back, Y = self._linear_part(m, P, P12, P11, (γ0, γ0), exact)
        decay = [(X11 + 2*m.Ui*unknown("decay")*(m.J1.T@P@m.J1) < 0).tagged("decay")] if exact else []
        level = unknown("γ")
        return Theorem(
            "54",
            [linear, lmi_54.tagged("(54)"), *decay, (P - unknown("p_min")*I(m.N) > 0).tagged("P > p_min I")],
            minimise=γ, power=1, unit=1 / m.pace, mildest=P,
            gains=gains, prove_with=back | {γ: m.U*level},
            lyapunov=P, drift=m.U*(P@m.A - Y@m.C), readout=m.E, noise=m.U*Y@m.noise,
            identities=[*m.identities(), *_no_direct(m, exact)],
            claim=self._claim(plant, exact), scope=_scope(plant),
            fixed=_fixed(plant) | ({"decay": _decay(plant)} if exact else {}), bases=m.bases,
        )

    def theorem_46(self, plant: Plant) -> Theorem:
        """Inequality (46) with L2 = 0 where every mode is seen: the sliding motion is exact, so the level is the linear part's.

        (54) would then hold at every level and says nothing about how fast; a decay rate of the sliding motion stands
        in its place.
        """
        m = _letters(plant)
        P, P12, P11 = _multiplier(m, True)
        γ0, γ  = unknown("γ_U"), m.U*unknown("γ")
        X11    = let("X11", (m.J1.T@P)@m.A@m.J1 + m.J1.T@m.A.T@(m.J1.T@P).T)
        linear, gains, back, Y = self._linear_part(m, P, P12, P11, (γ0, γ), True)
        decay  = X11 + 2*m.Ui*unknown("decay")*(m.J1.T@P@m.J1) < 0
        fixed  = _fixed(plant) | {"decay": _decay(plant)}
        return Theorem(
            "46",
            [linear, decay.tagged("decay"), (P - unknown("p_min")*I(m.N) > 0).tagged("P > p_min I")],
            minimise=γ0, power=1, unit=1 / m.pace, mildest=P,
            gains=gains, prove_with=back | {γ0: γ},
            lyapunov=P, drift=m.U*(P@m.A - Y@m.C), readout=m.E, noise=m.U*Y@m.noise,
            identities=[*m.identities(), *_no_direct(m, True)],
            claim=self._claim(plant, True), scope=_scope(plant),
            fixed={k: v for k, v in fixed.items() if k != "γ₀"}, bases=m.bases,
        )

    def _linear_part(self, m: _Letters, P: Expr, P12: Expr, P11: Expr, levels: tuple[Expr, Expr], exact: bool) -> tuple[Inequality, dict[Expr, Expr], dict[Expr, Expr], Expr]:
        """(46) with (63) as it stands in the proof, for any Y = P G_l; the program holds Y at γ₀ w_y Cᵀ (S D1 D1ᵀ Sᵀ)⁻¹.

        levels: γ₀ in the program, and as the gains that ship are to be read.
        """
        γ0, γ0_ships = levels
        ΔY, w_y = unknown("ΔY", m.N, m.p), unknown("w_y")
        W = let("W", w_y*m.Ui**2*(m.Si.T@m.Ri@m.Ri@m.Si))                                       # (S D1 D1ᵀ Sᵀ)⁻¹
        Y = let("Y", γ0*(m.J2@W) + ΔY)                                                          # P G_l: (47) when ΔY = 0
        X = let("X", P@m.A + m.A.T@P - Y@m.C - m.C.T@Y.T)
        lmi_46 = sym([[ X , -P@m.F            , -P@m.M             ,  Y      ,  m.E.T      ],
                      [ __, -γ0*I(m.q)        ,  0                 ,  0      ,  0          ],
                      [ __, __                , -γ0*I(m.M.shape[1]),  0      ,  0          ],
                      [ __, __                ,  __                , -γ0*W   ,  0          ],
                      [ __, __                ,  __                ,  __     , -γ0*I(m.q)  ]]) < 0
        L, G_l, P0 = m.L, unknown("G_l", m.N, m.p), unknown("P0", m.p, m.p)
        schur = m.J2.T@P@m.J2 - P12.T@P11.inv()@P12
        gains = {
            L: P11.inv()@P12,
            G_l: m.U*(m.Ti@P.inv()@Y@m.S),                                                                  # (47)
            P0: 0.5*(schur + schur.T),
        }
        P22, half = unknown("P22", m.p, m.p, symmetric=True), unknown("P12", m.n1, m.p - m.q if exact else m.p)
        P_L = let("P_L", sym([[P11, P11@L], [__, P0 + L.T@P11@L]]))                     # P in the gains that ship
        back = {
            half: P11@L@m.healthy if exact else P11@L,
            P22: P0 + L.T@P11@L,
            ΔY: m.Ui*(P_L@m.T@G_l@m.Si) - γ0_ships*(m.J2@W),
        }
        return lmi_46.tagged("(46)"), gains, back, Y
    # fmt: on

    def _claim(self, plant: Plant, exact: bool) -> str:
        counted = "|f'|²" + (" + |ψ|²" if plant.attenuated else "")
        if exact and not plant.attenuated:
            return (
                "while it slides, |f̂ - f| ≤ c exp(-decay t) whatever the fault does; without the injection"
                " ∫|f̂ - f|² dt ≤ γ² ∫(|f'|² + w_y |n|²) dt + V(e(0)), n the errors of the sensors in declared ranges"
            )
        counted = "|ψ|²" if exact else f"({counted})" if plant.attenuated else counted
        return f"while it slides, ∫|f̂ - f|² dt ≤ γ² ∫{counted} dt + V(e1(0)) on every horizon, in declared sizes and seconds"

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """(25) to (27) in the plant's own coordinates: z = [x̂; f̂], innovation S (C x̂ + F f̂ + D u - y)."""
        base, own = deviations(plant), coordinates(plant)
        n, q, (p, m) = plant.n, len(plant.faults), plant.D.shape
        A = np.block([[plant.A, np.zeros((n, q))], [np.zeros((q, n + q))]])
        C = np.hstack([plant.C, plant.F_f])
        G_l, L = gains["G_l"], gains["L"]
        copied = base["copied"]
        if copied is not None:
            base["copied"] = CopiedTerm(np.vstack([copied.into, np.zeros((q, copied.into.shape[1]))]), copied.g)
        injection = Injection(
            linear=G_l @ own.Si,
            into=own.Ti @ np.vstack([-L, np.eye(p)]),
            reads=own.S @ C,
            direct=own.S @ np.hstack([plant.D, -np.eye(p)]),
            weight=gains["P0"],
            bound=suggested_bound(plant, L),
        )
        return Observer(
            A=A - G_l @ C,
            B=np.hstack([np.vstack([plant.B, np.zeros((q, m))]) - G_l @ plant.D, G_l]),
            Cx=np.eye(n, n + q),
            Dx=np.zeros((n, m + p)),
            Cf=np.eye(q, n + q, n),
            Df=np.zeros((q, m + p)),
            F=plant.F_f,
            injections=(injection,) if self.injects else (),
            **base,
        )

    def notes(self, plant: Plant, gains: Mapping[str, Array]) -> tuple[str, ...]:
        """The sliding motion's poles, its gains, the injection's bound, and what the linear part alone would do."""
        own, L = coordinates(plant), gains["L"]
        Ac, Bc, Cc = sliding_motion(own.form, L)
        q = len(plant.faults)
        level = hinf_norm(Ac, Bc[:, :q], Cc, np.zeros((q, q))).value
        poles = _listed(np.linalg.eigvals(Ac))
        noise = float(np.linalg.norm(high_frequency_gain(own.form, L), 2))
        alone = _linear_level(plant, self.observer(plant, gains))
        return (
            f"sliding poles {poles} 1/s; error at most {level:.6g} s times the rate of the fault (worst frequency)",
            f"noise of a faulty sensor reaches f̂ with gain {noise:.4g} at high frequency",
            f"injection ν bounded by ρ = {suggested_bound(plant, L):.4g} declared sizes per second; "
            f"checked in simulation, not proved: that sliding is reached, and the sampled loop",
            f"without the injection (ν = 0) the same gains give {alone:.6g} s",
        )


def _listed(values: NDArray[Any]) -> str:
    """Eigenvalues in words: a conjugate pair once."""
    upper = sorted((s for s in values if s.imag >= 0), key=lambda s: s.real)
    return ", ".join(f"{s.real:.4g}" + (f" ± {s.imag:.4g}j" if s.imag else "") for s in upper)


def suggested_bound(plant: Plant, L: Array) -> float:
    """ρ in declared units per second: twice the largest equivalent injection that faults of the declared rate ask for."""
    rates = np.array([f.rate / f.size if np.isfinite(f.rate) else 1.0 / growth_time(plant) for f in plant.faults])
    return SURE * peak_injection(coordinates(plant).form, L).value * float(np.linalg.norm(rates))


class SlidingModeExact(SlidingMode):
    """The special case L2 = 0, refused where the healthy sensors miss a mode: the printed minimum-phase design."""

    name = "sliding-mode-exact"
    summary = "sliding-mode with L2 = 0 demanded: exact in sliding, possible only where healthy sensors see every mode"
    variant_of = "sliding-mode"
    exact = True


class SlidingModePrinted(SlidingMode):
    """The theorem with (54) as printed, which leaves M out: its level is not one for ψ; kept to compare."""

    name = "sliding-mode-printed"
    summary = "sliding-mode with the printed (54), whose level does not hold for disturbances; reference only"
    variant_of = "sliding-mode"
    printed = True
    reproductions = ()

    def _claim(self, plant: Plant, exact: bool) -> str:
        if not plant.attenuated:
            return super()._claim(plant, exact)
        return "while it slides, ∫|f̂ - f|² dt ≤ γ² ∫|f'|² dt + V(e1(0)) when ψ = 0; nothing for ψ ≠ 0, which (54) as printed omits"


# ---------------------------------------------------------------- letters


@dataclass(frozen=True, eq=False)
class _Letters:
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


def _letters(plant: Plant) -> _Letters:
    own, s = coordinates(plant), {k: given(f"plant.{k}", v) for k, v in plant.letters().items()}
    n, p, q = plant.n, plant.p, len(plant.faults)
    N, n1 = n + q, n + q - p
    Jx, Jf = given("J_x", np.eye(N, n)), given("J_f", np.eye(N, q, -n))
    T, Ti = given("T_c", own.T), given("T_c⁻¹", own.Ti)
    S, Si = given("S", own.S), given("S⁻¹", own.Si)
    U, Ui = given("U", 1.0 / own.pace), given("U⁻¹", own.pace)
    V, Vi = s["V"], given("V⁻¹", np.diag([f.size for f in plant.faults]))
    sd = np.zeros((p, 0)) if plant.noise is None else np.diag(np.sqrt(plant.noise.hold) * np.array(plant.noise.sd))
    return _Letters(
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


def _multiplier(m: _Letters, exact: bool) -> tuple[Expr, Expr, Expr]:
    """P by its blocks, its block P12 and P11; for L2 = 0 the columns of P12 that belong to faulty outputs are zero."""
    P11, P22 = unknown("P11", m.n1, m.n1, symmetric=True), unknown("P22", m.p, m.p, symmetric=True)
    free = unknown("P12", m.n1, m.p - m.q if exact else m.p)
    P12 = free @ m.healthy.T if exact else free
    return let("P", sym([[P11, P12], [__, P22]])), P12, P11


def _no_direct(m: _Letters, exact: bool) -> list[Identity]:
    """L2 = 0, when that is what the proof has put in."""
    if not exact:
        return []
    faulty = given("[0; I]", np.eye(m.p, m.q, -(m.p - m.q)))
    return [Identity("L2 = 0: the rate of the fault does not enter", m.L @ faulty)]


def _fixed(plant: Plant) -> dict[str, Any]:
    """What is chosen before the program: the trust in the model and the sensors, p_min, and (47)."""
    own, τ = coordinates(plant), growth_time(plant)
    noise = own.form.S * own.ranges[:, None].T * τ  # S in declared ranges, times d = τ
    least = minimal_gamma0(own.form, noise @ noise.T)
    return {"γ₀": max(TRUST * τ, 0.5 * TRUST * least), "w_y": 1.0 / τ**2, "p_min": LEAST_P, "ΔY": 0.0}


def _decay(plant: Plant) -> float:
    """A decay rate for the sliding motion that every plant allows: slower than what is fixed, a quarter of its slowest."""
    own = coordinates(plant)
    fixed = [-mode.value.real for mode in unobservable_modes(own.form.A11, own.form.A211)]
    rates = np.abs(np.linalg.eigvals(plant.A))
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    slowest = 0.25 * float(rates.min()) if rates.size else 0.25 / own.pace
    return min([slowest, *(0.5 * rate for rate in fixed)])


def _scope(plant: Plant) -> str:
    text = (
        "covers the linear part (stable, level γ₀) and the sliding motion of the continuous-time error system in exact"
        " arithmetic with these gains"
    )
    if np.any(plant.F_w):
        text += "; disturbances count as far as they act on the states, not on the sensors"
    return (
        text + "; does not cover that sliding is reached and kept (it is while the injection's bound exceeds what the"
        " errors ask for: checked in simulation), measurement noise, sampling, rounding at run time, or a plant that"
        " differs from the model"
    )


def _linear_level(plant: Plant, observer: Observer) -> float:
    """The gain from the faults' rates to the errors with ν = 0, s, in declared sizes."""
    n, q = plant.n, len(plant.faults)
    size = np.array([f.size for f in plant.faults])
    into = np.vstack([np.zeros((n, q)), np.diag(size)])
    return hinf_norm(observer.A, into, observer.Cf / size[:, None], np.zeros((q, q))).value


# ---------------------------------------------------------------- why not


def _structure(plant: Plant) -> list[Finding]:
    """What the canonical form needs: fewer faults than sensors, no sensor that repeats others, a linear plant."""
    see = "Alwi 2009, section 2"
    if len(plant.faults) >= plant.p:
        return [
            Finding(
                f"{len(plant.faults)} faults are declared on {plant.p} sensors",
                why="at least one output has to be free of faults",
                evidence={"faults": len(plant.faults), "sensors": plant.p},
                remedies=("declare fewer faults at a time (faults=[...] or --fault)",),
                see=see + ": p > q",
            )
        ]
    if plant.nonlinearity is not None:
        return [
            Finding(
                f"{plant.name} is nonlinear",
                why="the sliding motion is analysed for a linear plant",
                evidence={"nonlinear terms": plant.G.shape[1]},
                remedies=("linearise it at its operating point (plant.linearised)", "use lipschitz-hinf"),
                see=see,
            )
        ]
    scale = np.linalg.norm(plant.C, axis=1)
    rows = plant.C / np.where(scale > 0, scale, 1.0)[:, None]
    singular = np.linalg.svd(rows, compute_uv=False)
    if plant.p > plant.n or singular.min() <= 1e-10 * singular.max():
        rank = int(np.sum(singular > 1e-10 * singular.max()))
        return [
            Finding(
                f"the {plant.p} sensors of {plant.name} measure only {rank} independent combinations of its states",
                why="the canonical form needs C of full row rank",
                evidence={"rank": rank, "sensors": plant.p, "smallest singular value": float(singular.min())},
                remedies=(
                    "leave a redundant sensor out of the plant",
                    "use lipschitz-hinf, which takes redundant sensors",
                ),
                see=see,
            )
        ]
    return []


def _constant_fault(plant: Plant) -> list[Finding]:
    """A mode at the origin that only the faulty sensors see looks like a constant fault; Lemma 2 as an equivalence."""
    floor = hidden_floor(plant)
    if floor is None or np.isfinite(floor.value):
        return []
    return [
        Finding(
            "a constant fault cannot be told from a drift of the plant",
            why="the healthy sensors miss a mode of A at the origin, which the faulty ones see",
            evidence={"mode": [floor.modes[0].real, floor.modes[0].imag]},
            remedies=("add a healthy sensor that sees this mode", "protect the sensor that sees it"),
            see="Alwi 2009, Lemma 2: (A_a, C_a) observable",
        )
    ]


def _not_exact(plant: Plant, seen: conditions.Condition) -> Finding:
    where = seen.where or 0j
    word = f"s = {where.real:.6g}" + (f" ± {abs(where.imag):.6g}j" if where.imag else "")
    return Finding(
        f"no design with L2 = 0: the healthy sensors do not see the mode at {word}"
        if not seen.holds
        else f"no design with L2 = 0: the healthy sensors hardly see the mode at {word}",
        why=f"relative distance to undetectability {seen.distance:.2g}, needed {WEAK:g}"
        + (f"; it lives in {', '.join(seen.states)}" if seen.states else ""),
        evidence={"mode": [where.real, where.imag], "distance": seen.distance, "states": list(seen.states)},
        remedies=("use sliding-mode, which lets L2 differ from zero", "add a healthy sensor that sees this mode"),
        see="Alwi 2009, Lemma 1 and section 3: (A, C_1) detectable",
    )


def _nearly_hidden(seen: conditions.Condition) -> Finding:
    where = seen.where or 0j
    return Finding(
        f"the healthy sensors hardly see the mode at {where.real:.4g}{where.imag:+.4g}j, so it is treated as hidden",
        why=f"a relative change of {seen.distance:.1e} in the model would hide it, and gains that rely on it amplify noise",
        evidence={"distance": seen.distance, "tolerance": WEAK},
        remedies=("use sliding-mode-exact after adding a sensor", "add a healthy sensor that sees this mode"),
        severity="warning",
        see="Alwi 2009, section 3",
    )


_NOT_ATTAINED = (
    "a backed-off point, not an optimum: the infimum {infimum} is not attained, and how far to stay from it is not printed;"
    " with P ≥ p_min I the printed level is reached at p_min = 0.0199"
)
SlidingMode.reproductions = (
    Reproduction(
        "Case study, γ at γ0 = 10, D1 = I, p_min = 0.001",
        "admire",
        1.2212,
        1.17529,
        5e-4,
        "not_as_printed",
        _NOT_ATTAINED.format(infimum="1.1725869"),
        {"fix": {"γ₀": 10.0, "w_y": 1.0, "p_min": 1e-3}},
    ),
    Reproduction(
        "Case study, γ at γ0 = 10, D1 = I, p_min = 0.0199",
        "admire",
        1.2212,
        1.2212,
        5e-3,
        "with_change",
        "the bound p_min = 0.0199 is ours: it is what makes the optimum the printed number",
        {"fix": {"γ₀": 10.0, "w_y": 1.0, "p_min": 0.0199}},
    ),
)
