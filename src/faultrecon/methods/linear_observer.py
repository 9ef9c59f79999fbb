# SPDX-License-Identifier: BSD-3-Clause
"""The baseline beside every sliding-mode observer: the fault as one more state, and a linear H-infinity filter for it.

It is inequality (42) of [Alwi 2009] alone, with the gain free: no sliding surface, no injection.  On the cases of that
paper it reconstructs as well, which the paper does not say; what the injection adds is an exact reduced-order response.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.existence import additive_sensor_findings, fault_findings
from faultrecon.diagnosis.limits import Floor, hidden_floor
from faultrecon.finding import Finding
from faultrecon.graph.observer import Observer
from faultrecon.lmi.expr import I, __, given, let, sym, unknown
from faultrecon.methods.base import Identity, Method, Scaling, Theorem, letters
from faultrecon.methods.fault_state import fault_state_observer, with_fault_state
from faultrecon.methods.papers import ALWI_2009
from faultrecon.numerics.pencil import undetectable_modes
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]


class LinearObserver(Method):
    """Every mode of [x; f] has to show in y; the filter then holds a level from f', disturbances and sensor errors to f̂ - f."""

    name = "linear-observer"
    summary = "baseline: linear H-infinity filter with the fault as a state, no injection; linear plants"
    baseline = True
    paper = ALWI_2009
    counts_rates = True

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Additive sensor faults on a linear plant, ([A 0; 0 0], [C F]) detectable."""
        found = additive_sensor_findings(plant) or fault_findings(plant)
        if found:
            return found
        if plant.nonlinearity is not None:
            return [
                Finding(
                    f"{plant.name} is nonlinear",
                    why="the filter is designed for a linear plant",
                    evidence={"nonlinear terms": plant.G.shape[1]},
                    remedies=("linearise it at its operating point", "use lipschitz-hinf"),
                    see="Alwi 2009, section 2",
                )
            ]
        A, C = with_fault_state(plant)
        modes = undetectable_modes(A, C)
        if not modes:
            return []
        s = modes[0].value
        what = "a constant fault cannot be told from a drift of the plant" if abs(s) < 1e-9 else "a mode is not seen"
        return [
            Finding(
                f"{what}: no sensor tells the mode at {s.real:.4g}{s.imag:+.4g}j of state and fault together",
                why="(A_a, C_a) is not detectable",
                evidence={"mode": [s.real, s.imag]},
                remedies=("add a sensor that sees this mode", "declare fewer faults at a time"),
                see="Alwi 2009, Lemma 2",
            )
        ]

    def floor(self, plant: Plant) -> Floor | None:
        """What hidden modes cost in seconds; the level counts sensor errors too, so it lies above."""
        return hidden_floor(plant)

    # fmt: off
    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """Inequality (42) with Y = P K free: bounded real from [w; f'; n] to f̂ - f."""
        n, q, p, own = plant.n, len(plant.faults), plant.p, letters(plant, scaling)
        s, T, Ti, N = own, own.T, own.Ti, plant.n + len(plant.faults)
        Jx, Jf = given("J_x", np.eye(N, n)), given("J_f", np.eye(N, q, -n))
        Vi, r  = given("V⁻¹", np.diag([f.size for f in plant.faults])), given("ranges", np.diag(_ranges(plant)))
        sd = np.zeros((p, 0)) if plant.noise is None else np.diag(np.sqrt(plant.noise.hold) * np.array(plant.noise.sd))
        back   = let("T_a⁻¹", Jx@Ti@Jx.T + Jf@s["V"]@Jf.T)
        A,  B  = let("A_a", Jx@Ti@s["A"]@T@Jx.T), let("B_w", Jx@Ti@s["E_w"]@s["W"])
        C,  E  = let("C_a", s["C"]@T@Jx.T + s["F_f"]@Vi@Jf.T), let("E", s["F_w"]@s["W"])
        P,  Y  = unknown("P", N, N, symmetric=True), unknown("Y", N, p)
        γ, K   = unknown("γ_U"), unknown("K", N, p)
        X      = let("X", P@A + A.T@P - Y@C - C.T@Y.T)
        lmi_42 = sym([[ X , Y@E - P@B        , -P@Jf   ,  Y@r    ,  Jf      ],
                      [ __, -γ*I(B.shape[1]) ,  0      ,  0      ,  0       ],
                      [ __, __               , -γ*I(q) ,  0      ,  0       ],
                      [ __, __               ,  __     , -γ*I(p) ,  0       ],
                      [ __, __               ,  __     ,  __     , -γ*I(q)  ]]) < 0
        return Theorem(
            "42",
            [lmi_42.tagged("(42)"), (P > 0).tagged("P > 0")],
            minimise=γ, power=1,
            gains={K: (Jx@T@Jx.T + Jf@Vi@Jf.T)@P.inv()@Y}, prove_with={Y: P@back@K, γ: 1.0*unknown("γ")},
            lyapunov=P, drift=P@A - Y@C, readout=Jf.T, noise=Y@given("noise", sd),
            identities=[Identity("T T⁻¹ = I", T@Ti - I(n)), Identity("V V⁻¹ = I", s["V"]@Vi - I(q), 2.0**-40)],
            claim="∫|f̂ - f|² dt ≤ γ² ∫(|f'|² + |w|² + |n|²) dt + V(e(0)) on every horizon, in declared sizes; n the errors of"
                  " the sensors in declared ranges",
            scope="covers the continuous-time error system in exact arithmetic with these gains; does not cover sampling,"
                  " rounding at run time, or a plant that differs from the model",
        )
    # fmt: on

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """z = [x̂; f̂], corrected by y - C x̂ - F f̂ - D u."""
        return fault_state_observer(plant, gains["K"])


def _ranges(plant: Plant) -> Array:
    """What an error of each sensor counts: its declared range, 1 where there is none."""
    ranges = np.array(plant.signals.y.ranges, float)
    return np.where(np.isfinite(ranges), ranges, 1.0)
