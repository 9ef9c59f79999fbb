# SPDX-License-Identifier: BSD-3-Clause
"""How what is left of something fades, error by error: by a quick and by a slow part, in units of the steady bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.peaks import Outputs, fading, gains
from faultrecon.runtime.errors import ErrorSystem

Array = NDArray[Any]

QUICKEST = 1e-2  # rate per sample: below it an error is gone in any case
SUDDEN = 0.3  # the same for what counts from one sample before: at rate ρ it adds up to 1/ρ/(1 - ρ)


@dataclass(frozen=True, eq=False)
class Fades:
    """How every output and every ζ fades, in units (rows + nz,): rate (2, rows + nz), of a quick and of a slow part.

    outputs: those of the error system, and ζ.  What fades is fed on by φ(x̂) - φ(x), which goes back to what φ reads:
    by the small-gain argument for outputs that are weighed with rate^-k.  through (rows + nz,): what one unit of it
    adds then; back: what it makes of one unit; infinite where nothing fades for certain.
    """

    system: ErrorSystem
    outputs: Outputs
    units: Array
    rate: Array
    through: Array
    back: float

    @staticmethod
    def of(system: ErrorSystem, units: Array, box: Array) -> tuple[Fades, Array]:
        """At the pace of a box of ζ to begin with, and what is left of that at first, (2, rows + nz)."""
        outputs = Outputs(system.M, np.vstack([system.C, np.eye(len(system.M))]))
        rows, columns = len(units), [k for k, s in enumerate(system.sources) if s.kind == "nonlinearity"]
        if not columns or system.slope == 0.0:
            begins = fading(outputs, box, units)
            rate = np.maximum(begins.rate, QUICKEST)
            return Fades(system, outputs, units, rate, np.zeros(rows), 0.0), begins.first
        slowest, reads = outputs.slowest, slice(system.faults + system.sensors, len(system.C))
        for rate in 1.0 - (1.0 - slowest) * 0.5 ** np.arange(1, 12) if slowest < 1.0 else ():
            into, nothing = system.B[:, columns] / rate, np.zeros((rows, len(columns)))
            through = gains(system.M / rate, into, outputs.C, nothing).peak[0].sum(axis=1)
            gain = system.slope * float(np.linalg.norm(through[reads]))
            if gain < 1.0:
                rates = np.full((2, rows), max(rate, QUICKEST))
                fades = Fades(system, outputs, units, rates, through, system.slope / (1.0 - gain))
                return fades, fades.begin(box)
        never = Fades(system, outputs, units, np.ones((2, rows)), np.zeros(rows), math.inf)
        return never, never.begin(box)

    def afresh(self) -> Fades:
        """The same, with nothing kept of its outputs: what can be kept fills memory, and is soon computed again."""
        return replace(self, outputs=replace(self.outputs))

    def at_pace_of(self, box: Array) -> Fades:
        """The same at the pace of what another box, of which there may be no more than a little, leaves behind."""
        if self.back > 0.0:
            return self
        return replace(self, rate=np.maximum(fading(self.outputs, box, self.units).rate, SUDDEN))

    def begin(self, box: Array) -> Array:
        """What is left of a box of ζ at first, (2, rows + nz)."""
        return self.fed(self.alone(box))

    def alone(self, box: Array) -> Array:
        """The same without what the nonlinearity makes of it."""
        if math.isinf(self.back):
            return np.full(self.rate.shape, math.inf)
        return fading(self.outputs, box, self.units, self.rate).first

    def fed(self, first: Array) -> Array:
        """With what the nonlinearity makes of it; first (2, rows + nz)."""
        if self.back == 0.0 or math.isinf(self.back):
            return first
        reads = slice(self.system.faults + self.system.sensors, len(self.system.C))
        size = self.back * float(np.linalg.norm((first * self.units).sum(axis=0)[reads]))
        return first + np.vstack([np.zeros(len(self.units)), self.through * size / self.units])

    def errors(self, table: Array) -> Array:
        """The errors' columns, and as the last the largest of those of ζ and of what the nonlinearity reads."""
        rows = self.system.faults + self.system.sensors
        return np.column_stack([table[:, :rows], table[:, rows:].max(axis=1, initial=0.0)])


def taller(box: Array, height: int) -> Array:
    """Columns for the observer's own states as columns for all of ζ, (height, k)."""
    return np.vstack([box, np.zeros((height - len(box), box.shape[1]))])
