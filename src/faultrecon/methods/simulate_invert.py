# SPDX-License-Identifier: BSD-3-Clause
"""The baseline for sensors that lose gain: a copy of the plant runs beside it, and f̂ = y / ĥ - 1.

An arbitrary gain that changes with time hides the state altogether: for any initial state there is a gain that explains
the measurement.  Decoupling the fault leaves this open loop, exact in the limit where the plant forgets its initial
state; it passes sensor noise on as it is, and a model error too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Finding, InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import Observer
from faultrecon.methods.base import Unproved
from faultrecon.methods.papers import BEZZAOUCHA_2013
from faultrecon.methods.scaled_conditions import SEE, direct_findings, scaling_findings
from faultrecon.methods.scaled_sensors import faded, observer_of
from faultrecon.plant.plant import Plant
from faultrecon.plant.sector import right_side

Array = NDArray[np.float64]


class SimulateInvert(Unproved):
    """No correction and no gain: it claims nothing, and without noise and model errors nothing beats it."""

    name = "simulate-invert"
    summary = "baseline: model in parallel, lost gain read off as y over what the model says; stable plants"
    paper = BEZZAOUCHA_2013

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Multiplicative sensor faults without direct input on their sensors; a plant that settles by itself."""
        found = scaling_findings(plant, form=plant.polytopic is not None)
        if found:
            return found
        if direct := direct_findings(plant):
            return direct
        try:
            slope = right_side(plant).jacobian("x")(plant.point.x, plant.point.u)
        except InputError as error:
            return [error.finding]
        slowest = float(np.linalg.eigvals(slope).real.max())
        return _unused(plant) if slowest < 0 else [_unstable(slowest)]

    def gains_without_proof(self, plant: Plant) -> dict[str, Array]:
        """There is nothing to choose."""
        return {}

    def notes(self, plant: Plant, gains: Mapping[str, Array]) -> tuple[str, ...]:
        """What the assumption was looked at for."""
        return ("that the plant forgets its initial state was looked at at the operating point, to first order",)

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """x̂' = f(x̂, u);  f̂ = F⁻¹ (y - ĥ)/ĥ over as many sensors as there are faults."""
        n, q, (p, m) = plant.n, len(plant.faults), plant.D.shape
        chosen = _sensors(plant.F_f)
        F, C = plant.F_f[chosen], plant.C[chosen]
        y0, x0 = np.array(plant.point.y)[chosen], np.array(plant.point.x)
        least = faded(plant)[chosen]

        def readout(f: Any, x: Any) -> Any:
            import casadi as ca

            h = ca.DM(y0) + ca.DM(C) @ (x - ca.DM(x0))
            parts = [f[i] * ca.if_else(ca.fabs(h[i]) > least[i], 1.0 / h[i], 0.0) for i in range(q)]
            return ca.DM(np.linalg.inv(F)) @ ca.vertcat(*parts)

        def still(x: Any, f: Any, y: Any, u: Any) -> Any:
            import casadi as ca

            return ca.vertcat(ca.SX.zeros(n, 1), -f)

        select = np.eye(p)[chosen]
        base = observer_of(plant, still)
        return replace(
            base,
            Cf=np.hstack([-C, np.zeros((q, q))]),
            Df=np.hstack([np.zeros((q, m)), select]),
            readout=Graph.trace(readout, {"f": q, "x": n}),
        )


def _sensors(F: Array) -> NDArray[np.intp]:
    """Rows of F (p, q) that make an invertible matrix, the best conditioned first."""
    from scipy.linalg import qr

    order = np.asarray(qr(F.T, pivoting=True)[-1], dtype=np.intp)
    return np.sort(order[: F.shape[1]])


def _unused(plant: Plant) -> list[Finding]:
    """Said where healthy sensors could correct the state: this baseline lets them be."""
    healthy = [name for name, row in zip(plant.signals.y.names, plant.F_f, strict=True) if not row.any()]
    if not healthy:
        return []
    return [
        Finding(
            f"{', '.join(healthy)} stays healthy and corrects nothing here"
            if len(healthy) == 1
            else f"{', '.join(healthy)} stay healthy and correct nothing here",
            why="the model runs by itself: that is what the baseline is",
            evidence={"healthy": healthy},
            remedies=("use ts-mean-value or augmented-ekf, which take them in",),
            see=SEE,
            severity="warning",
        )
    ]


def _unstable(slowest: float) -> Finding:
    return Finding(
        "the model that nothing corrects forgets nothing",
        why=f"∂f/∂x has an eigenvalue with real part {slowest:.3g} at the operating point",
        evidence={"real part": slowest},
        remedies=("use ts-mean-value", "add a healthy sensor"),
        see=SEE,
    )
