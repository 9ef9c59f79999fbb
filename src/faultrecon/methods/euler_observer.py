# SPDX-License-Identifier: BSD-3-Clause
"""The baseline that decouples nothing: the same observer and inequality with J = I, H = 0 [Jia et al. 2015].

What euler-pi would decouple is attenuated like every other disturbance.  It is stronger than the Euler-approximate
observer of the literature, which has no level for disturbances at all.
"""

from __future__ import annotations

from dataclasses import replace

from faultrecon.finding import Finding
from faultrecon.methods.base import Scaling, Theorem
from faultrecon.methods.euler_pi import EulerPi
from faultrecon.plant.plant import Plant


class EulerObserver(EulerPi):
    """euler-pi for the plant in which nothing is to be decoupled."""

    name = "euler-observer"
    summary = "baseline: euler-pi without decoupling (J = I, H = 0), every disturbance attenuated"
    baseline = True

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of euler-pi, but for what concerns decoupling."""
        return super().assumptions(attenuating(plant))

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """The reduced inequality, which then is the whole one."""
        return self.theorem_reduced(attenuating(plant), scaling)


def attenuating(plant: Plant) -> Plant:
    """The same plant, which asks that every counted disturbance be attenuated."""
    kept = [replace(d, role="attenuate") if d.role == "decouple" else d for d in plant.disturbances]
    return replace(plant, disturbances=tuple(kept))
