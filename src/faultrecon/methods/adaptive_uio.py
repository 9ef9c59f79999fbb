# SPDX-License-Identifier: BSD-3-Clause
"""Adaptive unknown-input observer for sensor faults, linear and Lipschitz plants [Huang 2024].

Read it with the paper: J. Huang, Z. Gao and Y. Liu, Sensors 24, 2024, 3224.  What can be decoupled is decoupled, the rest
is attenuated, and an adaptive law f̂' = Γ F (y - C x̂ - D f̂) follows the fault.  From the paper's letters to the plant's:

    paper        here                  plant
    T            J = I - M C           E_d            J E_d = 0 for what has role = "decouple"; T is a unit here
    Bd2, d2      E₂, w                 E_w, F_w, W    the other counted disturbances, in declared sizes
    C, D         C, D                  C, F_f         every output takes part, in units S; faults in units Φ
    psi(x)       G φ(H x)              G, H, α        the structure is kept where the paper takes theta |x|
    F            F, F_a                               F in the inequality, F_a as it ships
    I, I         W_x' W_x, V' V        V              weights of the errors; a fault error counts in its declared size

A disturbance on the sensors reaches x̂ through M, and the derivative of the error through M F₂ w'.  The error is therefore
counted from e = x - x̂ + M F₂ w, in which no derivative occurs, and such a disturbance is priced like any other.
What a level is measured against is the derivative of the fault: a step has none of finite energy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.conditions import living_in
from faultrecon.diagnosis.decoupling import (
    invariant_zero_notes,
    partition,
    unknown_input_findings,
    unknown_input_gain,
    with_advice,
)
from faultrecon.diagnosis.limits import Floor, hidden_floor
from faultrecon.finding import Finding
from faultrecon.graph.observer import Observer
from faultrecon.lmi.expr import Expr, I, Inequality, __, blocks, given, let, sym, unknown, zeros
from faultrecon.methods.base import Method, Reproduction, Scaling, Theorem, lipschitz_premises
from faultrecon.methods.errors_uio import (
    BASES,
    ErrorLetters,
    InjectionErrors,
    error_letters,
    fastest,
    injection_inequality,
    scope,
    times_identity,
    unknown_input_observer,
    within_reach,
)
from faultrecon.methods.papers import HUANG_2024
from faultrecon.numerics.annihilator import annihilator
from faultrecon.numerics.pencil import undetectable_modes
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

LEARNING = 10.0
"""Γ of the paper's examples, for faults in units of their declared sizes."""


class AdaptiveUio(Method):
    """Theorems 1 and 2 with P, P L1, F, r² and ε joint unknowns; the level is about the fault error alone."""

    name = "adaptive-uio"
    summary = (
        "unknown-input observer with an adaptive fault estimate; Lipschitz or linear plants, additive sensor faults"
    )
    paper = HUANG_2024
    counts_rates = True
    noise_counts: ClassVar[bool] = False

    def assumptions(self, plant: Plant) -> list[Finding]:
        """What is to be decoupled can be, no mode hides behind it or behind the faults, a constant fault shows at rest."""
        found = with_advice(plant, unknown_input_findings(plant))
        return found if any(f.severity == "fatal" for f in found) else self.seen(plant) + found

    def seen(self, plant: Plant) -> list[Finding]:
        """Modes of J A that the healthy outputs miss: necessary for V = diag(P, Γ⁻¹), though not for an observer."""
        return unseen_findings(plant)

    # fmt: off
    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """Theorems 1 (linear) and 2: V = e_x' P e_x + e_s' W e_s, W = Γ⁻¹.  The f' column stays: f' enters e_s itself."""
        o = error_letters(plant, scaling, noise_counts=self.noise_counts)
        n, q, p, l, r = o.n, o.q, o.p, o.E2.shape[1], o.G.shape[1]
        J, A, C, D, M, E2, F2, MD, G, H = o.J, o.A, o.C, o.D, o.M, o.E2, o.F2, o.MD, o.G, o.H
        P, Y  = unknown("P", n, n, symmetric=True), unknown("Y", n, p)
        F, r2 = unknown("F", q, p), unknown("r²")
        ε     = unknown("ε")
        Γi    = o.Φ@o.V_plant@unknown("W", q, q, symmetric=True)@o.V_plant@o.Φ
        W     = let("W_Φ", Γi)                                                             # Γ⁻¹, in units Φ
        PN    = let("P_N", P@J@A - Y@C)
        HM    = let("H_M", H@M@F2)
        t     = ε*o.α**2
        Q     = let("Q_s", o.V.T@o.V)
        lmi = sym([
            [ PN + PN.T + t*(H.T@H), -(Y@D) - (F@C).T  , -(P@MD), P@J@E2 - (Y + PN@M)@F2 - t*(H.T@HM), P@J@G  , o.Wx.T         ],
            [ __                   , -(F@D) - (F@D).T + Q,  W@o.Ff, -(F@(I(p) - C@M)@F2)              , 0      , 0              ],
            [ __                   , __                , -r2*I(q), 0                                 , 0      , 0              ],
            [ __                   , __                , __      , -r2*I(l) + t*(HM.T@HM)            , 0      , -(o.Wx@M@F2).T ],
            [ __                   , __                , __      , __                                , -ε*I(r), 0              ],
            [ __                   , __                , __      , __                                , __     , -I(n)          ]]) < 0

        L1, Fa, Γ, γ = unknown("L1", n, p), unknown("F_a", q, p), unknown("Γ", q, q), unknown("γ")
        noise = o.Si@o.noise
        lyapunov = sym([[P, 0], [__, W]])
        drift = blocks([[PN, -(Y@D)], [-(F@C), -(F@D)]])
        return Theorem(
            "2" if r else "1",
            [lmi.tagged("bounded real"), (P > 0).tagged("P > 0"), (W > 0).tagged("Γ⁻¹ > 0"), (ε > 0).tagged("ε > 0"),
             *self.also(drift, lyapunov)],
            minimise=r2,
            gains={L1: o.T@P.inv()@Y@o.Si, Fa: o.Φi@F@o.Si, Γ: o.Φ@W.inv()@o.Φ},
            prove_with={Y: P@o.Ti@L1@o.S, F: Γi@o.Φi@Γ@Fa@o.S, r2: γ**2},
            lyapunov=lyapunov, drift=drift,
            readout=blocks([[zeros(q, n), o.V]]), noise=blocks([[(Y + PN@M)@noise], [F@(I(p) - C@M)@noise]]),
            identities=o.identities, premises=lipschitz_premises(plant), claim=CLAIM, scope=scope(plant),
            fixed=self.held(plant) | ({} if r else {"ε": 1.0}), bases=BASES,
        )
    # fmt: on

    def also(self, drift: Expr, lyapunov: Expr) -> list[Inequality]:
        """|λ| < ρ for the error dynamics, with the same V."""
        return [within_reach(drift, lyapunov)]

    def held(self, plant: Plant) -> dict[str, Any]:
        """Γ⁻¹, the weight of the state error, and the bound on the poles."""
        return {"W": times_identity(1 / LEARNING, len(plant.faults)), "W_x": 0.0, "ρ": fastest(plant)}

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """z' = N z + L y + J B u - L1 D f̂ + J G φ(H x̂), x̂ = z + M y, f̂' = Γ F_a (y - C x̂ - D f̂)."""
        q = len(plant.faults)
        return unknown_input_observer(plant, gains["L1"], gains["Γ"] @ gains["F_a"], np.zeros((q, q)), np.eye(q))

    def floor(self, plant: Plant) -> Floor | None:
        """Modes that only faulty sensors see bound the gain from f' to the error of f̂; nothing else is known to."""
        return hidden_floor(plant)

    def notes(self, plant: Plant, gains: Mapping[str, Array]) -> tuple[str, ...]:
        """Zeros that no gain moves, and disturbances that could be decoupled and are not."""
        could = set(partition(plant).decouple) - {d.name for d in plant.attenuated if d.role == "decouple"}
        more = (f'could be decoupled as well (role = "decouple"): {", ".join(sorted(could))}',) if could else ()
        return (*invariant_zero_notes(plant), *more)


class AdaptiveUioPrinted(AdaptiveUio):
    """The theorems as printed: the whole state error counts, in the plant's units, and nothing bounds the poles.

    Reproduction only: its gains grow without bound towards its infimum (2.6e6 rad/s on the paper's aircraft).
    """

    name = "adaptive-uio-printed"
    summary = "adaptive-uio as printed: the state error counts in full and no pole is bounded; reference only"
    variant_of = "adaptive-uio"
    reproductions = ()

    def also(self, drift: Expr, lyapunov: Expr) -> list[Inequality]:
        """Nothing."""
        return []

    def held(self, plant: Plant) -> dict[str, Any]:
        """Γ⁻¹; every state error has weight one."""
        return {"W": times_identity(1 / LEARNING, len(plant.faults)), "W_x": np.eye(plant.n)}


class AdaptiveUioFull(AdaptiveUio):
    """The same observer with a Lyapunov matrix that couples both errors: never worse, and Γ is no part of the search.

    K_e = [L1; Γ F] is an output injection on [x; f]; Γ ships as one (in declared sizes), F_a is what P_e⁻¹ Y_e asks for.
    """

    name = "adaptive-uio-full"
    summary = "adaptive-uio with a full Lyapunov matrix in place of diag(P, Γ⁻¹)"
    variant_of = "adaptive-uio"
    reproductions = ()

    # fmt: off
    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """V = e' P_e e on the whole error [e_x; e_s]."""
        o = error_letters(plant, scaling, noise_counts=self.noise_counts)
        n, q, p, r = o.n, o.q, o.p, o.G.shape[1]
        sys = full_errors(o)
        P, Y = unknown("P_e", n + q, n + q, symmetric=True), unknown("Y_e", n + q, p)
        ε, r2, γ = unknown("ε"), unknown("r²"), unknown("γ")
        L1, Fa, Γ = unknown("L1", n, p), unknown("F_a", q, p), unknown("Γ", q, q)
        K, drift = P.inv()@Y@o.Si, P@sys.A - Y@sys.C
        E_x, E_s = given("E_x", np.eye(n + q)[:, :n]), given("E_s", np.eye(n + q)[:, n:])
        return Theorem(
            "2, full Lyapunov matrix" if r else "1, full Lyapunov matrix",
            [injection_inequality(sys, P, Y, ε, r2).tagged("bounded real"), (P > 0).tagged("P_e > 0"),
             (ε > 0).tagged("ε > 0"), *self.also(drift, P)],
            minimise=r2,
            gains={L1: o.T@E_x.T@K, Fa: o.V_plant@o.V_plant@o.Φ@E_s.T@K, Γ: o.Vi_plant@o.Vi_plant},
            prove_with={Y: P@(E_x@o.Ti@L1@o.S + E_s@o.Φi@Γ@Fa@o.S), r2: γ**2},
            lyapunov=P, drift=drift, readout=blocks([[zeros(q, n), o.V]]),
            noise=(Y@(I(p) - o.C@o.M) + P@E_x@o.J@o.A@o.M)@o.Si@o.noise,
            identities=o.identities, premises=lipschitz_premises(plant), claim=CLAIM, scope=scope(plant),
            fixed=self.held(plant) | ({} if r else {"ε": 1.0}), bases=BASES,
        )
    # fmt: on

    def seen(self, plant: Plant) -> list[Finding]:
        """Nothing more: V couples both errors."""
        return []

    def held(self, plant: Plant) -> dict[str, Any]:
        """The weight of the state error and the bound on the poles; Γ⁻¹ is no unknown here."""
        return {k: v for k, v in super().held(plant).items() if k != "W"}


# fmt: off
def full_errors(o: ErrorLetters) -> InjectionErrors:
    """The error system of the observer as an output injection on [x; f], ω = [f'; w]."""
    n, q, p, l, r, s = o.n, o.q, o.p, o.E2.shape[1], o.G.shape[1], o.H.shape[0]
    M, F2 = o.M, o.F2
    return InjectionErrors(
        A=let("A_e", blocks([[o.J@o.A, zeros(n, q)], [zeros(q, n), zeros(q, q)]])),
        C=let("C_e", blocks([[o.C, o.D]])),
        B=let("B_e", blocks([[-o.MD, o.J@o.E2 - o.J@o.A@M@F2], [o.Ff, zeros(q, l)]])),
        D=let("D_e", blocks([[zeros(p, q), (I(p) - o.C@M)@F2]])),
        G=let("G_e", blocks([[o.J@o.G], [zeros(q, r)]])),
        H=let("H_e", blocks([[o.H, zeros(s, q)]])), Hw=let("H_w", blocks([[zeros(s, q), o.H@M@F2]])),
        Z=let("Z_e", blocks([[o.Wx, zeros(n, q)], [zeros(q, n), o.V]])),
        Zw=let("Z_w", blocks([[zeros(n, q), o.Wx@M@F2], [zeros(q, q), zeros(q, l)]])), α=o.α,
    )
# fmt: on


class AdaptiveUioNoise(AdaptiveUio):
    """Sensor noise is one more disturbance of the level, in units of its standard deviation."""

    name = "adaptive-uio-noise"
    summary = "adaptive-uio with the declared sensor noise counted in the level"
    variant_of = "adaptive-uio"
    reproductions = ()
    noise_counts = True


def unseen_findings(plant: Plant) -> list[Finding]:
    """Where C x + D f = 0 nothing is corrected, so x' P J A x < 0 has to hold there, for every x with N C x = 0.

    A mode J A x = s x among them with Re s >= 0 forbids it.  The paper does not say so.
    """
    J = np.eye(plant.n) - unknown_input_gain(plant) @ plant.C
    modes = undetectable_modes(J @ plant.A, annihilator(plant.F_f) @ plant.C)
    if not modes:
        return []
    s, states = modes[0].value, living_in(plant, modes[0].direction)
    at = f"{s.real:.4g}" + (f" ± {abs(s.imag):.4g}j" if s.imag else "")
    return [
        Finding(
            f"the healthy sensors do not see the mode at s = {at}, which does not decay",
            why="no matrix diag(P, Γ⁻¹) shows that its error decays, since a fault can hide it at every instant",
            evidence={"mode": [s.real, s.imag], "states": list(states)},
            remedies=("use adaptive-uio-full, whose Lyapunov matrix couples state and fault",)
            + ((f"add a healthy sensor that reads {states[0]}",) if states else ()),
            see="Huang 2024, section 3, with x' P T A x < 0 wherever C x + D f = 0",
        )
    ]


CLAIM = (
    "∫|f - f̂|² + |W_x (x - x̂)|² dt ≤ γ² ∫|f'|² + |w|² dt + V(e(0)) on every horizon, faults and disturbances in units of"
    " their declared sizes and f' in sizes per second; the errors tend to zero when the fault is constant and w = 0"
)

_SLOW = (
    "the printed level needs poles no faster than about 10 rad/s, not the {fast} of the printed gains; without a bound"
    " the level has no smallest value that gains attain"
)
AdaptiveUio.reproductions = (
    Reproduction(
        "Aircraft, r with every error counted and poles to the right of -10",
        "civil_aircraft",
        0.12,
        0.1204025,
        1e-5,
        "with_change",
        _SLOW.format(fast="2.6e6"),
        {"pole_bound": 10.0, "fix": {"W_x": np.eye(4), "ρ": 1e4}},
    ),
    Reproduction(
        "Robot, r at ε = 40 with every error counted and poles to the right of -10",
        "flexible_joint",
        0.48,
        0.1586469,
        1e-5,
        "with_change",
        _SLOW.format(fast="2.6e4"),
        {"pole_bound": 10.0, "fix": {"W_x": np.eye(4), "ρ": 1e4, "ε": 40.0}, "all_states": True},
    ),
)
