# SPDX-License-Identifier: BSD-3-Clause
"""The descriptor-system observer that takes noise and faults of every output for states [Khosrowjerdi 2011, section 4].

With s = F f + F_w w as further states, of which nothing is known but y = C x + s, the plant is a descriptor system, and
an observer with gains Λ, K_1, K_2 has the output error ε = y - C x̂ - ŝ.  Its error system splits, whatever the gains:

    ε' = -Λ⁻¹ (I + K_2) ε,    e' = A e - K_1 ε + G δφ + E_w w

ε decays by itself and is zero when the observer starts with ŝ = y - C x̂.  Nothing measured ever corrects x̂: the state
estimate is the open loop's, f̂ = F⁺ ŝ = F⁺ (y - C x̂), and what can be certified is what holds for L = 0.
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


class Descriptor(Method):
    """Its equations after the split, started at ε = 0; its level is the necessary one of any inequality of this form."""

    name = "descriptor"
    summary = "baseline: descriptor observer with outputs' disturbances as states; its state estimate is open loop"
    baseline = True
    paper = KHOSROWJERDI_2011

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of the open loop: a stable plant that outweighs its nonlinearity."""
        return parallel_findings(plant)

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """The bounded-real inequality of the error system that is left, e' = A e + G δφ + E_w w."""
        return parallel_theorem(plant, scaling, "bounded real, descriptor with ε = 0")

    def gains_without_proof(self, plant: Plant) -> dict[str, NDArray[np.float64]] | None:
        """There is nothing to choose: no gain reaches the fault estimate once ε is zero."""
        return {}

    def observer(self, plant: Plant, gains: Mapping[str, NDArray[np.float64]]) -> Observer:
        """x̂ follows the model; f̂ = F⁺ ŝ = F⁺ (y - C x̂ - D u)."""
        return parallel_observer(plant)

    def notes(self, plant: Plant, gains: Mapping[str, NDArray[np.float64]]) -> tuple[str, ...]:
        """What its structure costs."""
        return ("no gain of a descriptor observer corrects the state: its estimate is the open loop's",)
