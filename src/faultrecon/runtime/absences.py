# SPDX-License-Identifier: BSD-3-Clause
"""What is added to the errors by rows, inputs and sensors that are missing, and how that fades."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.plant.plant import Plant
from faultrecon.runtime.absent import Absence, Sizes, absences, diverging
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.fades import Fades, taller
from faultrecon.runtime.missing import gaps, inputs_missing

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Absences:
    """What absences add, in units of the steady bounds, by error; the last entry is for ζ itself.

    It has a quick and a slow part: rate (2, q + p + 1), per sample.  Of each there are (each, 2, q + p + 1): `skipped`
    at the sample after 1, 2, ... missing rows, `unfed` and `lost` at a sample that lacks this input, or this sensor.
    `lost` counts so many times as 1 and what is left in ζ at the sample before; so does `skipped` if it `scales`.  A
    gap lies between samples that lack nothing, and no sensor is silent at, before or after a sample that lacks an
    input: of all else, and of what is infinite, nothing is known.
    diverges (p + 1,): 1 for each sensor without which the error grows, the last without several.
    """

    rate: Array
    skipped: Array
    unfed: Array
    lost: Array
    scales: bool
    diverges: Array

    @staticmethod
    def of(plant: Plant, estimator: Estimator, sizes: Sizes, fades: Fades) -> Absences:
        """While ζ is within its steady bound; fades: those of the start."""
        rows, inputs = gaps(plant, estimator, sizes), inputs_missing(plant, estimator)
        sensors = absences(plant, estimator, sizes)
        known = [one.later for one in (rows[0], *sensors) if _known(one)]
        usual = np.hstack([np.zeros((len(fades.system.M), 0)), *(taller(one, len(fades.system.M)) for one in known)])
        fades = fades.afresh().at_pace_of(usual)
        skipped = _table(fades, [_come(fades, one) for one in rows])
        unfed, lost = (_table(fades, [_follow(fades, one) for one in each]) for each in (inputs, sensors))
        sampled = estimator.scheme == "sampled"
        return Absences(fades.errors(fades.rate), skipped, unfed, lost, sampled, diverging(estimator))

    @property
    def said(self) -> tuple[str, ...]:
        """What is accounted for where something is missing, and what must be true of the rest, in sentences."""
        tables = self.skipped, self.unfed, self.lost
        rows, inputs, sensors = (int(np.isfinite(each).all(axis=(1, 2)).sum()) for each in tables)
        parts = [f"gaps of up to {rows} row{'s' * (rows > 1)}"] if rows else []
        parts += ["missing inputs"] if inputs and inputs == len(self.unfed) else []
        parts += ["silent sensors"] if sensors and sensors == len(self.lost) else []
        said = [f"{' and '.join(parts)} are accounted for where they do not meet each other"] if parts else []
        when = "beyond that" if parts else "where rows, inputs or sensors are missing"
        return (*said, f"{when} the error is no larger than that of an observer at rest")


def _known(absence: Absence) -> bool:
    return bool(np.isfinite(absence.later).all())


def _come(fades: Fades, absence: Absence) -> Array:
    """What is added at the sample at which ζ is another, (2, rows + nz)."""
    if not _known(absence):
        return np.full(fades.rate.shape, np.inf)
    return fades.begin(taller(absence.later, len(fades.system.M)))


def _follow(fades: Fades, absence: Absence) -> Array:
    """What is added at the sample before that, and lasts until then, (2, rows + nz)."""
    if not _known(absence):
        return np.full(fades.rate.shape, np.inf)
    at_once = np.zeros(len(fades.units))
    at_once[: len(absence.at_once)] = absence.at_once
    earlier = fades.alone(taller(absence.later, len(fades.system.M))) / fades.rate
    earlier[0] += np.maximum(at_once / fades.units - earlier.sum(axis=0), 0.0)
    return fades.fed(earlier)


def _table(fades: Fades, each: Sequence[Array]) -> Array:
    """The errors of several, (each, 2, q + p + 1)."""
    found = [fades.errors(one) for one in each]
    return np.array(found).reshape(len(found), 2, fades.system.faults + fades.system.sensors + 1)
