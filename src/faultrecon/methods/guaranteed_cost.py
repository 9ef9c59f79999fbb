# SPDX-License-Identifier: BSD-3-Clause
"""Multiplicative sensor faults with one constant gain and a bound on the error's variance, over the vertices of a box.

The published inequality [Bezzaoucha 2013, theorem 1] throws the dependence of the innovation on the fault error into an
uncertainty, and its best fault gain is zero.  Here the innovation keeps the block diag(ĥ) F, and the cost is the trace
of a covariance: an L2 gain from fault rate and noise to the error has no minimiser, since the algebraic inverse of the
sensor attains it with a gain without bound.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.observer import Observer
from faultrecon.methods.base import Assumed
from faultrecon.methods.guaranteed_variance import GuaranteedVariance, agreement, bounds
from faultrecon.methods.papers import BEZZAOUCHA_2013
from faultrecon.methods.scaled_sensors import innovation, observer_of
from faultrecon.plant.plant import Plant
from faultrecon.plant.sector import Sector

Array = NDArray[np.float64]


class TsGuaranteedCost(GuaranteedVariance):
    """R1: the vertices of A(z) with the premise frozen at its estimate, and diag(ĥ) F in the innovation."""

    name = "ts-guaranteed-cost"
    summary = "multiplicative sensor faults: constant gain of least guaranteed variance over the vertices of A(z)"
    paper = BEZZAOUCHA_2013

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """ẋ̂ = f(x̂, u) + G_x ν, f̂' = G_f ν with ν the innovation."""
        import casadi as ca

        G = ca.DM(gains["G"])
        return observer_of(plant, lambda x, f, y, u: G @ innovation(plant, x, f, y, u, divided=self.divided))


class TsMeanValue(TsGuaranteedCost):
    """C: f(x, u) - f(x̂, u) = J̄ e_x with J̄ in the hull of ∂f/∂x over the box; the innovation divided by ĥ."""

    name = "ts-mean-value"
    summary = "multiplicative sensor faults: constant gain of least guaranteed variance over the vertices of df/dx"
    divided = True
    covered = "the nonlinear error system by the mean value theorem"

    def sector(self, plant: Plant) -> Sector:
        """∂f/∂x."""
        return Sector.slope_of(plant)

    def premises(self, plant: Plant) -> list[Assumed]:
        """What the vertices rest on."""
        sector = self.sector(plant)
        return [agreement(sector, "J(z) = ∂f/∂x"), bounds(sector)]
