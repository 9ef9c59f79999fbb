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
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.existence import additive_sensor_findings, fault_findings
from faultrecon.diagnosis.limits import Floor, hidden_floor
from faultrecon.diagnosis.sliding import (
    WEAK,
    blind,
    constant_fault,
    nearly_hidden,
    not_exact,
    structure,
    visibility,
    with_hidden_mode,
)
from faultrecon.finding import Finding
from faultrecon.graph.observer import Injection, Observer
from faultrecon.lmi.expr import Expr, I, Inequality, __, let, sym, unknown, zeros
from faultrecon.methods.base import ClosedForm, Method, Reproduction, Scaling, Theorem
from faultrecon.methods.fault_state import fault_state_observer, with_fault_state
from faultrecon.methods.papers import ALWI_2009
from faultrecon.methods.sliding_letters import (
    AugmentedLetters,
    augmented_letters,
    coordinates,
    decay_rate,
    held_fixed,
    into_states,
    multiplier,
    no_direct,
    said_of_sliding,
    shipped,
    sliding_gain,
    suggested_bound,
)
from faultrecon.numerics.sliding import (
    linear_gain,
    reduced_riccati,
    smallest_level,
)
from faultrecon.plant.fault import Disturbance
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

FICTITIOUS = (0.1, 0.01)  # noises of healthy outputs and states that make the reduced Riccati equation regular
LEEWAY = 1e-3  # how far below the level its gains are computed, so that multipliers prove it strictly
LINEAR_LEVEL = "γ is the level without the injection; while it slides the error does not depend on the fault at all"
BOUNDS = {"p_min": "nothing keeps P from losing rank near the optimum, and the gains from growing without bound"}
OUTPUTS_FASTER = 3.0  # times the sliding motion: how errors of the outputs decay without the injection


class SlidingMode(Method):
    """Inequalities (46) and (54), corrected, with P >= p_min I; the least level, then the mildest P at the shipped one."""

    name = "sliding-mode"
    summary = "sliding-mode observer of the fault as a state; additive incipient sensor faults, unstable plants too"
    paper = ALWI_2009
    exact: ClassVar[bool | None] = None  # whether L2 = 0 is demanded; None: where the healthy sensors see enough
    counts_rates = True
    printed: ClassVar[bool] = False  # whether (54) leaves M out, as it does in print

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Additive faults on fewer sensors than there are, C of full row rank, a linear plant, no hidden equilibrium."""
        found = additive_sensor_findings(plant) or fault_findings(plant) or structure(plant)
        found = found or blind(plant) or constant_fault(plant)
        if found:
            return found
        seen = visibility(plant)
        if self.exact and seen.distance < WEAK:
            return [not_exact(plant, seen)]
        if self.exact is None and seen.holds and seen.distance < WEAK:
            return [nearly_hidden(seen)]
        return []

    def floor(self, plant: Plant) -> Floor | None:
        """What hidden modes cost, in seconds, against which the level of the sliding motion stands."""
        return None if self._is_exact(plant) else hidden_floor(plant)

    def stand_in(self, plant: Plant) -> Plant | None:
        """The plant with a nearly hidden mode hidden outright."""
        return with_hidden_mode(plant) if self.exact is None else None

    def counted(self, plant: Plant) -> tuple[Disturbance, ...] | None:
        """Disturbances of the states; None where the level is that of the linear part alone."""
        return None if self._linear_level_alone(plant) else tuple(plant.attenuated[k] for k in into_states(plant))

    def _linear_level_alone(self, plant: Plant) -> bool:
        return self._is_exact(plant) and not into_states(plant)

    def _is_exact(self, plant: Plant) -> bool:
        return bool(self.exact) if self.exact is not None else visibility(plant).distance >= WEAK

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """The sliding motion at level γ, and a linear part that is stable at level γ₀."""
        exact = self._is_exact(plant)
        return self.theorem_46(plant) if exact and not into_states(plant) else self.theorem_54(plant, exact)

    # fmt: off
    def theorem_54(self, plant: Plant, exact: bool = False) -> Theorem:
        """Inequalities (46), with (63) for ψ, and (54) with M in it: the least level of the sliding motion.

        P, shared by both, has the blocks P11, P12 and P22 of the sliding motion and the outputs.  G_l is eliminated from
        (46) as in (47); the proof puts the gains that ship back.  For L2 = 0 the fault's rate leaves (54) altogether.
        """
        m = augmented_letters(plant)
        P, P12, P11 = multiplier(m, exact)
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
            identities=[*m.identities(), *no_direct(m, exact)],
            claim=self._claim(plant, exact), scope=_scope(plant),
            fixed=held_fixed(plant) | ({"decay": decay_rate(plant)} if exact else {}), bases=m.bases,
            bounds=BOUNDS,
        )

    def theorem_46(self, plant: Plant) -> Theorem:
        """Inequality (46) with L2 = 0 where every mode is seen: the sliding motion is exact, so the level is the linear part's.

        (54) would then hold at every level and says nothing about how fast; a decay rate of the sliding motion stands
        in its place.
        """
        m = augmented_letters(plant)
        P, P12, P11 = multiplier(m, True)
        γ0, γ  = unknown("γ_U"), m.U*unknown("γ")
        X11    = let("X11", (m.J1.T@P)@m.A@m.J1 + m.J1.T@m.A.T@(m.J1.T@P).T)
        linear, gains, back, Y = self._linear_part(m, P, P12, P11, (γ0, γ), True)
        decay  = X11 + 2*m.Ui*unknown("decay")*(m.J1.T@P@m.J1) < 0
        fixed  = held_fixed(plant) | {"decay": decay_rate(plant)}
        return Theorem(
            "46",
            [linear, decay.tagged("decay"), (P - unknown("p_min")*I(m.N) > 0).tagged("P > p_min I")],
            minimise=γ0, power=1, unit=1 / m.pace, mildest=P,
            gains=gains, prove_with=back | {γ0: γ},
            lyapunov=P, drift=m.U*(P@m.A - Y@m.C), readout=m.E, noise=m.U*Y@m.noise,
            identities=[*m.identities(), *no_direct(m, True)],
            claim=self._claim(plant, True), scope=_scope(plant),
            fixed={k: v for k, v in fixed.items() if k != "γ₀"}, bases=m.bases, bounds=BOUNDS,
        )

    def _linear_part(self, m: AugmentedLetters, P: Expr, P12: Expr, P11: Expr, levels: tuple[Expr, Expr], exact: bool) -> tuple[Inequality, dict[Expr, Expr], dict[Expr, Expr], Expr]:
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
        gains, back = shipped(m, (P, P12, P11), Y, γ0_ships*(m.J2@W), exact)
        return lmi_46.tagged("(46)"), gains, back, Y
    # fmt: on

    def _claim(self, plant: Plant, exact: bool) -> str:
        names = ", ".join(plant.attenuated[k].name for k in into_states(plant))
        if exact and not names:
            return (
                "while it slides, |f̂ - f| ≤ c exp(-decay t) whatever the fault does; without the injection"
                " ∫|f̂ - f|² dt ≤ γ² ∫(|f'|² + w_y |n|²) dt + V(e(0)), n the errors of the sensors in declared ranges"
            )
        counted = "|ψ|²" if exact else "(|f'|² + |ψ|²)" if names else "|f'|²"
        return (
            f"while it slides, ∫|f̂ - f|² dt ≤ γ² ∫{counted} dt + V(e1(0)) on every horizon, in declared sizes and seconds"
            + (f"; ψ: {names}" if names else "")
        )

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """(25) to (27) in the plant's own coordinates: z = [x̂; f̂], innovation S (C x̂ + F f̂ + D u - y)."""
        own, (_, C) = coordinates(plant), with_fault_state(plant)
        G_l, L = gains["G_l"], sliding_gain(plant, gains)
        weight = own.Si.T @ gains["P0"] @ own.Si
        injection = Injection(
            linear=G_l @ own.Si,
            into=gains["G_n"],
            reads=own.S @ C,
            direct=own.S @ np.hstack([plant.D, -np.eye(plant.p)]),
            weight=0.5 * (weight + weight.T),
            bound=suggested_bound(plant, L),
        )
        return fault_state_observer(plant, G_l, (injection,))

    def notes(self, plant: Plant, gains: Mapping[str, Array]) -> tuple[str, ...]:
        """The sliding motion's poles, its gains, the injection's bound, and what the linear part alone would do."""
        said = said_of_sliding(plant, gains, self.observer(plant, gains))
        return (*said, LINEAR_LEVEL) if self._linear_level_alone(plant) else said


class SlidingModeExact(SlidingMode):
    """The special case L2 = 0, refused where the healthy sensors miss a mode: the printed minimum-phase design."""

    name = "sliding-mode-exact"
    summary = "sliding-mode with L2 = 0 demanded: exact in sliding, possible only where healthy sensors see every mode"
    variant_of = "sliding-mode"
    exact = True
    reproductions = ()


class SlidingModeRiccati(SlidingMode):
    """Without a semidefinite program: L from a Riccati equation of the hidden motion, G_l block triangular.

    Only ‖ξ → f̂ - f‖ is then optimised, and the linear part is claimed to be stable, at no level.  The implicit step is
    approximate with such a G_l.
    """

    name = "sliding-mode-riccati"
    summary = "sliding-mode with gains from one Riccati equation and no semidefinite program; hidden modes only"
    variant_of = "sliding-mode"
    backoff = 0.3  # the floor is approached by gains that amplify noise: under noise the best are a third above it
    reproductions = ()

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of sliding-mode; a hidden mode to trade against noise, and no disturbance of the states."""
        found = super().assumptions(plant)
        if any(f.severity == "fatal" for f in found):
            return found
        if hidden_floor(plant) is None:
            return [
                Finding(
                    "the healthy sensors see every mode, so nothing is to be traded",
                    why="L2 = 0 is exact in sliding",
                    evidence={"distance": visibility(plant).distance},
                    remedies=("use sliding-mode",),
                    see="Alwi 2009, section 3",
                )
            ]
        if into_states(plant):
            return [
                Finding(
                    f"{plant.name} declares disturbances of the states",
                    why="the Riccati equation of the hidden motion weighs the fault's rate alone",
                    evidence={"disturbances": len(plant.attenuated)},
                    remedies=("use sliding-mode, whose level counts them",),
                    see="Alwi 2009, (63)",
                )
            ]
        return found

    # fmt: off
    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """(54) for the sliding motion, and a Lyapunov inequality for the linear part."""
        m = augmented_letters(plant)
        P, P12, P11 = multiplier(m, False)
        γ, ΔY  = unknown("γ_U"), unknown("ΔY", m.N, m.p)
        X11    = let("X11", (m.J1.T@P)@m.A@m.J1 + m.J1.T@m.A.T@(m.J1.T@P).T)
        Ce     = m.E@m.J1
        lmi_54 = sym([[ X11, -(m.J1.T@P)@m.F,  Ce.T     ],
                      [ __ , -γ*I(m.q)      ,  0        ],
                      [ __ , __             , -γ*I(m.q) ]]) < 0                                                # (54)
        stable = P@m.A + m.A.T@P - ΔY@m.C - m.C.T@ΔY.T < 0
        gains, back = shipped(m, (P, P12, P11), ΔY, zeros(m.N, m.p), False)
        return Theorem(
            "54, Riccati",
            [stable.tagged("linear part stable"), lmi_54.tagged("(54)"), (P > 0).tagged("P > 0")],
            minimise=γ, power=1, unit=1 / m.pace, mildest=P,
            gains=gains, prove_with=back | {γ: m.U*unknown("γ")},
            lyapunov=P, drift=m.U*(P@m.A - ΔY@m.C), readout=m.E, noise=m.U*ΔY@m.noise,
            identities=m.identities(), claim=self._claim(plant, False), scope=_scope(plant).replace("stable, level γ₀", "stable"),
            bases=m.bases,
        )
    # fmt: on

    def closed_form(self, plant: Plant) -> ClosedForm:
        """The reduced Riccati equation with fictitious noises small enough to cost less than a part in a thousand."""
        own = coordinates(plant)
        noises = FICTITIOUS[0], FICTITIOUS[1] * np.sqrt(float(np.linalg.norm(own.form.A11, 2)) or 1.0)

        def at(level: float) -> dict[str, Array] | None:
            L = reduced_riccati(own.form, level / (1.0 + LEEWAY), *noises)
            if L is None:
                return None
            p, n1 = own.form.p, own.form.n1
            fastest = float(np.abs(np.linalg.eigvals(own.form.A11 + L @ own.form.A21)).max())
            Y = own.pace * linear_gain(own.form, L, -OUTPUTS_FASTER * fastest * np.eye(p))
            P = np.block([[np.eye(n1), L], [L.T, np.eye(p) + L.T @ L]])  # P11 = P0 = I: for the gains alone
            return {"P11": np.eye(n1), "P12": L, "P22": P[n1:, n1:], "ΔY": P @ Y, "γ_U": np.array([[level / own.pace]])}

        least = smallest_level(own.form, *noises) * (1.0 + LEEWAY)
        return ClosedForm(least, at, "Riccati equation of the hidden motion")


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


_NOT_ATTAINED = (
    "a backed-off point, not an optimum: the infimum 1.1725869 is not attained, and how far to stay from it is not printed;"
    " with P ≥ p_min I the printed number is the gain of the sliding motion at p_min = 0.0199"
)
SlidingMode.reproductions = (
    Reproduction(
        "Case study, γ at γ0 = 10, D1 = I, p_min = 0.001",
        "admire",
        1.2212,
        1.17529,
        5e-4,
        "not_as_printed",
        _NOT_ATTAINED,
        {"fix": {"γ₀": 10.0, "w_y": 1.0, "p_min": 1e-3}},
    ),
    Reproduction(
        "Case study, γ at γ0 = 10, D1 = I, p_min = 0.0199",
        "admire",
        1.2212,
        1.2255,
        1e-3,
        "with_change",
        "the bound p_min = 0.0199 is ours: the gain of the optimum's sliding motion is then the printed number",
        {"fix": {"γ₀": 10.0, "w_y": 1.0, "p_min": 0.0199}},
    ),
)
