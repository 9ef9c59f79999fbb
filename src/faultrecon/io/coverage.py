# SPDX-License-Identifier: BSD-3-Clause
"""How much of a replayed log a certificate speaks about: samples in which the estimate left the box it was proved for.

A design over the vertices of a box claims nothing beyond them.  What can be watched are x̂, f̂ and the inputs; the true
x and f, of which the scope speaks too, nobody sees.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.methods.guaranteed_variance import GuaranteedVariance
from faultrecon.methods.registry import method
from faultrecon.methods.scaled_sensors import interval
from faultrecon.methods.takagi_sugeno import TsPublished
from faultrecon.plant.sector import Sector
from faultrecon.synthesis.result import Design

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Coverage:
    """covered (N,): the samples the certificate speaks about.  left: by state, input, fault or premise, in how many
    samples it was beyond the interval given with it.

    margin (N,): how far inside its bounds the nearest premise is, as a part of their distance.
    """

    covered: Mask
    margin: Array
    left: Mapping[str, tuple[int, tuple[float, float]]]

    @property
    def outside(self) -> int:
        """Number of samples it does not speak about."""
        return int(np.count_nonzero(~self.covered))

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {"outside": self.outside, "left": {name: count for name, (count, _) in self.left.items()}}

    def __str__(self) -> str:
        if not self.outside:
            return f"the estimate stays in the box of the certificate in all {len(self.covered)} samples"
        parts = [f"{name} not in [{low:g}, {high:g}] in {k}" for name, (k, (low, high)) in self.left.items()]
        told = f"the certificate does not cover {self.outside} of {len(self.covered)} samples"
        return f"{told}: the estimate left its box ({', '.join(parts)})"


def coverage(design: Design, x: Array, u: Array, f: Array) -> Coverage | None:
    """Where a certificate over a box holds; None for a design that has none, or whose certificate knows no box.

    x (N, n): the estimated states; u (N, m): the inputs as they were used; f (N, q): the estimated faults.
    """
    plant, chosen = design.plant, method(design.method)
    over_box = isinstance(chosen, GuaranteedVariance)
    if design.certificate is None or plant.polytopic is None or not (over_box or isinstance(chosen, TsPublished)):
        return None
    watched = [(one.name, f[:, j], interval(plant, one.name, one.size)) for j, one in enumerate(plant.faults)]
    if over_box:  # the published theorem asks for bounds of the premises, and nothing else of x and u
        names, boxes = (*plant.signals.x.names, *plant.signals.u.names), plant.polytopic.boxes
        values, ends = np.hstack([x, u]).T, [*boxes["x"], *boxes["u"]]
        watched = [*zip(names, values, ends, strict=True), *watched]
    sector = chosen.sector(plant) if isinstance(chosen, GuaranteedVariance) else Sector.of(plant)
    premises = zip(sector.family.names, sector.premise_values(x, u).T, sector.ends, strict=True)
    covered = np.ones(len(x), dtype=bool)
    left: dict[str, tuple[int, tuple[float, float]]] = {}
    for name, value, bounds in watched:
        beyond = _beyond(value, bounds)
        covered &= ~beyond
        if beyond.any():
            left[name] = int(np.count_nonzero(beyond)), bounds
    within_box = covered.copy()
    for name, value, bounds in premises:
        beyond = _beyond(value, bounds)
        covered &= ~beyond
        if alone := int(np.count_nonzero(beyond & within_box)):  # what left the box took its premises with it
            left[name] = alone, bounds
    return Coverage(covered, sector.membership_margin(x, u), left)


def _beyond(value: Array, ends: tuple[float, float]) -> Mask:
    """Where a value is not between its ends, or unknown; a rounding error at the end is not beyond it."""
    low, high = ends
    slack = np.spacing(max(abs(low), abs(high)))
    return ~((value >= low - slack) & (value <= high + slack))
