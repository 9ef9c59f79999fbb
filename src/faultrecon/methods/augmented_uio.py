# SPDX-License-Identifier: BSD-3-Clause
"""The augmented unknown-input observer with which [Huang 2024] compares: fault and its rate as two more states.

    σ = [g; f],    g' = f'',    f' = g,    error system as in `errors_uio` with A_e = [J A, -M D, 0; 0, 0, 0; 0, I, 0]

The source theorem (Gao and co-authors, 2016) was not at hand; the inequality is derived again.  As printed, the model
leaves f'' out of what disturbs, so that its level promises nothing: the optimum is then zero.  Here f'' is an input, and
the level is a gain from f'' and w: it cannot be compared with a level of adaptive-uio, which is one from f'.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.decoupling import invariant_zero_notes, unknown_input_findings, with_advice
from faultrecon.diagnosis.limits import Floor
from faultrecon.finding import Finding
from faultrecon.graph.observer import Observer
from faultrecon.lmi.expr import I, blocks, given, let, unknown, zeros
from faultrecon.methods.base import Method, Scaling, Theorem, lipschitz_premises
from faultrecon.methods.errors_uio import (
    BASES,
    ErrorLetters,
    InjectionErrors,
    error_letters,
    fastest,
    injection_inequality,
    scope,
    slower,
    times_identity,
    unknown_input_observer,
)
from faultrecon.methods.papers import HUANG_2024
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]


class AugmentedUio(Method):
    """K1 = P⁻¹ Y for the augmented error, f'' and the attenuated disturbances counted."""

    name = "augmented-uio"
    summary = "baseline: unknown-input observer that takes the fault for a ramp (states x, f', f)"
    paper = HUANG_2024
    baseline = True
    drives: ClassVar[bool] = True

    def counted(self, plant: Plant) -> None:
        """None: the level counts the second derivative of the fault."""
        return

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of adaptive-uio: the second integrator of the fault model has its mode at s = 0 as well."""
        return with_advice(plant, unknown_input_findings(plant))

    # fmt: off
    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """The bounded real inequality of the augmented error [e_x; e_g; e_f], ε as in Theorem 2."""
        o = error_letters(plant, scaling)
        n, q, p, r = o.n, o.q, o.p, o.G.shape[1]
        sys = augmented_errors(o, driven=self.drives)
        P, Y = unknown("P_e", n + 2*q, n + 2*q, symmetric=True), unknown("Y_e", n + 2*q, p)
        ε, r2, γ = unknown("ε"), unknown("r²"), unknown("γ")
        K_x, K_g, K_f = unknown("K_x", n, p), unknown("K_g", q, p), unknown("K_f", q, p)
        eye, K, drift = np.eye(n + 2*q), P.inv()@Y@o.Si, P@sys.A - Y@sys.C
        E_x, E_g, E_f = given("E_x", eye[:, :n]), given("E_g", eye[:, n:n + q]), given("E_f", eye[:, n + q:])
        return Theorem(
            "augmented, re-derived",
            [injection_inequality(sys, P, Y, ε, r2).tagged("bounded real"), (P > 0).tagged("P_e > 0"),
             (ε > 0).tagged("ε > 0"), slower(drift, P)],
            minimise=r2,
            gains={K_x: o.T@E_x.T@K, K_g: o.Φ@E_g.T@K, K_f: o.Φ@E_f.T@K},
            prove_with={Y: P@(E_x@o.Ti@K_x + E_g@o.Φi@K_g + E_f@o.Φi@K_f)@o.S, r2: γ**2},
            lyapunov=P, drift=drift, readout=blocks([[zeros(q, n + q), o.V]]),
            noise=(Y@(I(p) - o.C@o.M) + P@E_x@o.J@o.A@o.M)@o.Si@o.noise,
            identities=o.identities, premises=lipschitz_premises(plant),
            claim=CLAIM if self.drives else CLAIM_PRINTED, scope=scope(plant),
            fixed=self.held(plant) | ({} if r else {"ε": 1.0}), bases=BASES,
        )
    # fmt: on

    def held(self, plant: Plant) -> dict[str, Any]:
        """Weights of the errors of state and fault rate, and the bound on the poles.

        The error of the rate counts by default: without it the optimum is nearly zero and its gains run away.
        """
        return {"W_x": 0.0, "W_g": times_identity(1.0, len(plant.faults)), "ρ": fastest(plant)}

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """z' = N z + L y + J B u - K_x D f̂ - M D ĝ + J G φ(H x̂), ĝ' = K_g ν, f̂' = ĝ + K_f ν, ν = y - C x̂ - D f̂."""
        q = len(plant.faults)
        zero, one = np.zeros((q, q)), np.eye(q)
        follow = np.vstack([gains["K_g"], gains["K_f"]])
        drives = np.block([[zero, zero], [one, zero]])
        return unknown_input_observer(plant, gains["K_x"], follow, drives, np.hstack([zero, one]))

    def floor(self, plant: Plant) -> Floor | None:
        """Nothing is known about a gain from f''."""
        return None

    def notes(self, plant: Plant, gains: Mapping[str, Array]) -> tuple[str, ...]:
        """Zeros that no gain moves."""
        return invariant_zero_notes(plant)


class AugmentedUioPrinted(AugmentedUio):
    """As printed: no f'' among what disturbs, all errors count in full.  Its level says nothing about a moving fault."""

    name = "augmented-uio-printed"
    summary = "augmented-uio as printed, without f'' as an input: its level is meaningless; reference only"
    variant_of = "augmented-uio"
    drives = False

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of augmented-uio, and something to measure against: f'' does not count here."""
        found = super().assumptions(plant)
        enters = any(d.role == "attenuate" and any(d.into.values()) for d in plant.attenuated)
        if enters or any(f.severity == "fatal" for f in found):
            return found
        return [
            Finding(
                f"nothing enters the states of {plant.name} but what is decoupled",
                why="the printed form leaves f'' out, so its level would be zero and say nothing",
                remedies=("use augmented-uio, which counts f''",),
                see="Huang 2024, comparison with the augmented observer",
            ),
            *found,
        ]

    def held(self, plant: Plant) -> dict[str, Any]:
        """Every error has weight one."""
        return super().held(plant) | {"W_x": np.eye(plant.n), "W_g": times_identity(1.0, len(plant.faults))}


# fmt: off
def augmented_errors(o: ErrorLetters, *, driven: bool) -> InjectionErrors:
    """The error system on [x; g; f], ω = [f''; w]; driven: whether f'' is an input at all."""
    n, q, p, l, r, s = o.n, o.q, o.p, o.E2.shape[1], o.G.shape[1], o.H.shape[0]
    M, F2, k = o.M, o.F2, q if driven else 0
    Wg = let("W_gV", unknown("W_g", q, q)@o.V)
    return InjectionErrors(
        A=let("A_e", blocks([[o.J@o.A, -(M@o.D), zeros(n, q)], [zeros(q, n), zeros(q, q), zeros(q, q)], [zeros(q, n), I(q), zeros(q, q)]])),
        C=let("C_e", blocks([[o.C, zeros(p, q), o.D]])),
        B=let("B_e", blocks([[zeros(n, k), o.J@o.E2 - o.J@o.A@M@F2], [o.Ff if driven else zeros(q, 0), zeros(q, l)], [zeros(q, k), zeros(q, l)]])),
        D=let("D_e", blocks([[zeros(p, k), (I(p) - o.C@M)@F2]])),
        G=let("G_e", blocks([[o.J@o.G], [zeros(q, r)], [zeros(q, r)]])),
        H=let("H_e", blocks([[o.H, zeros(s, q), zeros(s, q)]])), Hw=let("H_w", blocks([[zeros(s, k), o.H@M@F2]])),
        Z=let("Z_e", blocks([[o.Wx, zeros(n, q), zeros(n, q)], [zeros(q, n), Wg, zeros(q, q)], [zeros(q, n), zeros(q, q), o.V]])),
        Zw=let("Z_w", blocks([[zeros(n, k), o.Wx@M@F2], [zeros(q, k), zeros(q, l)], [zeros(q, k), zeros(q, l)]])), α=o.α,
    )
# fmt: on


_ERRORS = "∫|f - f̂|² + |W_x (x - x̂)|² + |W_g (f' - ĝ)|² dt"
_SIZES = "faults and disturbances in units of their declared sizes and derivatives in those per second"
CLAIM = f"{_ERRORS} ≤ γ² ∫|f''|² + |w|² dt + V(e(0)) on every horizon, {_SIZES}"
CLAIM_PRINTED = f"{_ERRORS} ≤ γ² ∫|w|² dt + V(e(0)) on every horizon for faults with f'' = 0, which are ramps, {_SIZES}"
