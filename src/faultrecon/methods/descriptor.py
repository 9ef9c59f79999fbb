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
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from faultrecon.methods.base import Scaling, Theorem
from faultrecon.methods.open_loop import OpenLoop
from faultrecon.plant.plant import Plant


class Descriptor(OpenLoop):
    """Its equations after the split, started at ε = 0; its level is the necessary one of any inequality of this form."""

    name = "descriptor"
    summary = "baseline: descriptor observer with outputs' disturbances as states; its state estimate is open loop"

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """The bounded-real inequality of the error system that is left."""
        return replace(super().theorem(plant, scaling), number="bounded real, descriptor with ε = 0")

    def notes(self, plant: Plant, gains: Mapping[str, NDArray[np.float64]]) -> tuple[str, ...]:
        """What its structure costs."""
        return ("no gain of a descriptor observer corrects the state: its estimate is the open loop's",)
