# SPDX-License-Identifier: BSD-3-Clause
"""What users pick today: a Kalman filter in which faults are further states that walk at random.

Sampled, tuned from what the plant declares and from nothing else (see `kalman_steps.tuned`), without any guarantee.
Disturbances with role "decouple" are further states too; all others are white noise.  The estimate shown at a sample is
the prediction for it, from the samples before it, as that of euler-pi is for faults.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.existence import constant_fault_findings
from faultrecon.finding import Finding, InputError
from faultrecon.graph.observer import Observer
from faultrecon.methods.base import Method, Unproved
from faultrecon.methods.kalman_steps import Kind, Tuning, at_rest, filtering, tuned
from faultrecon.methods.papers import JAZWINSKI_1970, JULIER_2004
from faultrecon.methods.sampled_conditions import plain_findings
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]


class AugmentedEkf(Unproved):
    """The extended filter: the covariance moves with the slope of one Runge-Kutta step at the estimate."""

    name = "augmented-ekf"
    summary = "baseline: extended Kalman filter, faults and decoupled disturbances as random walks; no guarantee"
    paper = JAZWINSKI_1970
    criterion = "least variance for the declared noises, faults as random walks"
    sampled = True
    kind: ClassVar[Kind] = "extended"

    def __init__(self, sample_time: float | None = None) -> None:
        self.sample_time = sample_time

    def sampling(self, values: Mapping[str, Any]) -> Method:
        """The same for the sample time T among `values`, where there is one."""
        if "T" not in values:
            return self
        T = float(np.asarray(values["T"], dtype=float).item())
        if not (math.isfinite(T) and T > 0):
            raise InputError(f"the sample time T is {T}", why="it is a positive number of seconds")
        return type(self)(T)

    def time(self, plant: Plant) -> float:
        """T in s: as asked for, else the time for which a noise sample is held."""
        if self.sample_time is not None:
            return self.sample_time
        assert plant.noise is not None, "the assumptions ask for it"
        return plant.noise.hold

    def assumptions(self, plant: Plant) -> list[Finding]:
        """A continuous plant with additive faults and noise, a constant fault that shows, a covariance that settles."""
        found = plain_findings(plant, self.sample_time) or constant_fault_findings(plant)
        if any(f.severity == "fatal" for f in found):
            return found
        T = self.time(plant)
        if at_rest(plant, T, tuned(plant, T)) is not None:
            return found
        return [
            Finding(
                f"the filter for {plant.name} does not settle",
                why="at the operating point some state that does not decay by itself is seen by no sensor",
                remedies=("add a sensor", "declare fewer faults at a time (faults=[...] or --fault)"),
                see="Jazwinski 1970, chapter 7",
            )
        ]

    def gains_without_proof(self, plant: Plant) -> dict[str, Array]:
        """The covariances that it is tuned with; R in a column."""
        T = self.time(plant)
        one = tuned(plant, T)
        return {"T": np.array([[T]]), "Q": one.Q, "R": one.R[:, None], "P0": one.P0}

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """The filter as a map; its linear part is the filter at rest."""
        T, tuning = float(gains["T"].item()), Tuning(gains["Q"], gains["R"][:, 0], gains["P0"])
        steady = at_rest(plant, T, tuning)
        if steady is None:
            raise InputError(f"{self.name} with these covariances does not settle on {plant.name}")
        return filtering(plant, T, tuning, steady, self.kind)


class AugmentedUkf(AugmentedEkf):
    """The unscented filter: mean and covariance of points that each take the Runge-Kutta step."""

    name = "augmented-ukf"
    summary = "baseline: unscented Kalman filter, faults and decoupled disturbances as random walks; no guarantee"
    paper = JULIER_2004
    kind = "unscented"
