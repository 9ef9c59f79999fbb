# SPDX-License-Identifier: BSD-3-Clause
"""Multiplicative sensor faults as additive ones: a polytopic proportional-integral observer for a = f h.

    x̂' = A(ẑ) x̂ + B(ẑ) u + G_x(ẑ) ν,   â' = G_a(ẑ) ν,   ν = y - ĥ - â,   f̂ = â / ĥ

What a lost gain takes away from a sensor is a signal like any other, and with it the innovation has constant
coefficients: C e_x + e_a.  So each vertex of A(z) may have a gain of its own, nothing is multiplied with anything, and
the box may be as wide as the plant is stable.  The price: a moves whenever h does, for a constant gain too, and is
taken for a random walk all the same.  The observer's states are x̂ and f̂ = â/ĥ themselves, so f̂ moves at a rate
that grows as ĥ fades, and no step is short enough for a division by nearly nothing.  So below the smallest reading in
the box that reading stands for ĥ there, and where ĥ has faded f̂ holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Finding
from faultrecon.graph.observer import Observer
from faultrecon.methods.base import Assumed
from faultrecon.methods.guaranteed_variance import FROZEN, GuaranteedVariance
from faultrecon.methods.papers import BEZZAOUCHA_2013
from faultrecon.methods.scaled_conditions import direct_findings, shared_findings
from faultrecon.methods.scaled_sensors import (
    expected,
    faded,
    innovation,
    least_readings,
    memberships,
    model,
    observer_of,
    own_rows,
    readings,
)
from faultrecon.plant.plant import Plant
from faultrecon.plant.sector import Sector

Array = NDArray[np.float64]


class TsAdditive(GuaranteedVariance):
    """D: one gain per vertex of A(z), weighted by the memberships of x̂; what the fault adds to its sensor is a state."""

    name = "ts-additive"
    summary = "multiplicative sensor faults as additive ones: a gain of least guaranteed variance per vertex of A(z)"
    paper = BEZZAOUCHA_2013
    covered = FROZEN + " takes f h for a random walk of the declared rate, and holds"
    error = "e = (x - x̂, f h - f̂ ĥ) with h what the faulty sensors would show"

    def channel_findings(self, plant: Plant) -> list[Finding]:
        """Each fault on a sensor of its own, which no input reaches directly."""
        return shared_findings(plant) or direct_findings(plant)

    def gain_names(self, vertices: int) -> list[str]:
        """One for each: the innovation is the same at all of them."""
        return [f"G{i + 1}" for i in range(vertices)]

    def innovations(self, plant: Plant) -> list[Array]:
        """C e_x + e_a, whatever x and f are."""
        return [np.hstack([plant.C, (plant.F_f != 0).astype(float)])]

    def fault_scale(self, plant: Plant) -> Array:
        """The largest reading in the box, times the coefficient: what one unit of a fault adds to its sensor."""
        most = np.array([max(abs(low), abs(high)) for low, high in readings(plant)])
        return np.abs(most @ plant.F_f)

    def premises(self, plant: Plant) -> list[Assumed]:
        """What the vertices rest on."""
        text = "the rate of f h is taken for white noise of the declared rate of f times the largest h in the box"
        return [*super().premises(plant), Assumed("additive fault", text, "assumed")]

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """x̂' = f(x̂, u) + G_x ν and f̂' = (â' - f̂ ĥ')/ĥ with ĥ' = C x̂'; f̂ holds where ĥ has faded."""
        import casadi as ca

        sector, rows, n = Sector.of(plant), own_rows(plant), plant.n
        gone, least = faded(plant), least_readings(plant)
        names = self.gain_names(len(sector.vertices))

        def correction(x: Any, f: Any, y: Any, u: Any) -> Any:
            weights = memberships(sector, x, u)
            G = sum((w * ca.DM(gains[name]) for w, name in zip(weights, names, strict=True)), ca.SX(0))
            push = G @ innovation(plant, x, f, y, u, divided=False)
            h = expected(plant, x, u)
            rise = ca.DM(plant.C) @ (model(plant, x, u, ca.SX(0)) + push[:n])
            moves = []
            for j, i in enumerate(rows):
                by = ca.if_else(h[i] < 0, -1.0, 1.0) * ca.fmax(ca.fabs(h[i]), float(least[i]))
                slope = (push[n + j] / float(plant.F_f[i, j]) - f[j] * rise[i]) / by
                moves.append(ca.if_else(ca.fabs(h[i]) >= float(gone[i]), slope, 0.0))
            return ca.vertcat(push[:n], *moves)

        return observer_of(plant, correction)
