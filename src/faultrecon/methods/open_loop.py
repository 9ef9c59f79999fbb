# SPDX-License-Identifier: BSD-3-Clause
"""The baseline that corrects nothing: a copy of the plant runs beside it, f̂ is what the faulty sensor shows beyond it.

Every design should beat it, and under measurement noise not every design does.  It is also what the state estimate of a
descriptor observer amounts to when noise and faults reach all outputs [Khosrowjerdi 2011, section 4].
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Finding
from faultrecon.graph.observer import Observer
from faultrecon.methods.base import Method, Scaling, Theorem
from faultrecon.methods.papers import KHOSROWJERDI_2011
from faultrecon.methods.parallel_model import parallel_findings, parallel_observer, parallel_theorem
from faultrecon.plant.plant import Plant


class OpenLoop(Method):
    """L = 0 and K = F⁺: certified exactly when the plant itself forgets its state fast enough for its nonlinearity."""

    name = "open-loop"
    summary = "baseline: model in parallel, no correction (L = 0); certified for stable plants only"
    baseline = True
    paper = KHOSROWJERDI_2011

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Additive sensor faults with F of full column rank; a stable plant that outweighs its nonlinearity."""
        return parallel_findings(plant)

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """The bounded-real inequality of the error system with L = 0: the S-procedure term is that of (3.2)."""
        return parallel_theorem(plant, scaling, "bounded real, L = 0")

    def gains_without_proof(self, plant: Plant) -> dict[str, NDArray[np.float64]] | None:
        """There is nothing to choose."""
        return {}

    def observer(self, plant: Plant, gains: Mapping[str, NDArray[np.float64]]) -> Observer:
        """x̂ follows the model; f̂ = F⁺ (y - C x̂ - D u)."""
        return parallel_observer(plant)
