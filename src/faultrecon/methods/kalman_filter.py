# SPDX-License-Identifier: BSD-3-Clause
"""What the Kalman filters with faults as random walks share: sample time, tuning, gate, and what they refuse.

Sampled, tuned from what the plant declares and from nothing else (see `kalman_steps.tuned`), without any guarantee.
Disturbances with role "decouple" are further states too; all others are white noise.  The estimate shown at a sample is
the prediction for it, from the samples before it, as that of euler-pi is for faults.  A fault may add to sensors or
inputs, or take away the gain of sensors.

gate: fix={"gate": 16} takes an innovation of more than four standard deviations for a jump of the faults on its sensor,
and lets them follow at once; infinite means never.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.existence import constant_fault_findings
from faultrecon.finding import Finding, InputError
from faultrecon.graph.observer import Observer
from faultrecon.methods.base import Unproved
from faultrecon.methods.kalman_steps import Extended, Tuning, at_rest, filtering, scaled, scaling_faults, tuned
from faultrecon.methods.sampled_conditions import plain_findings
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]


class KalmanFilter(Unproved):
    """A filter of some kind; the kind says how a step is made."""

    criterion = "least variance for the declared noises, faults as random walks"
    sampled = True
    usual_gate: ClassVar[float] = math.inf

    def __init__(self, sample_time: float | None = None, gate: float | None = None) -> None:
        self.sample_time = sample_time
        self.gate = self.usual_gate if gate is None else gate

    @abstractmethod
    def steps(self, plant: Plant, T: float, tuning: Tuning) -> Extended:
        """The two halves of a step."""

    def sampling(self, values: Mapping[str, Any]) -> Self:
        """The same for the sample time T and the gate among `values`, where they are."""
        T, gate = self.sample_time, self.gate
        if "T" in values:
            T = float(np.asarray(values["T"], dtype=float).item())
            if not (math.isfinite(T) and T > 0):
                raise InputError(f"the sample time T is {T}", why="it is a positive number of seconds")
        if "gate" in values:
            gate = float(np.asarray(values["gate"], dtype=float).item())
            if not gate > 0:
                raise InputError(f"the gate is {gate}", why="it counts variances of an innovation; 16 is four sd")
        return type(self)(T, gate)

    def time(self, plant: Plant) -> float:
        """T in s: as asked for, else the time for which a noise sample is held."""
        if self.sample_time is not None:
            return self.sample_time
        assert plant.noise is not None, "the assumptions ask for it"
        return plant.noise.hold

    def assumptions(self, plant: Plant) -> list[Finding]:
        """A continuous plant with noise and sensors that show something; faults that show; a covariance that settles."""
        losing = scaling_faults(plant)
        added = (
            replace(plant, faults=tuple(replace(f, effect="additive") for f in plant.faults)) if losing.any() else plant
        )
        found = plain_findings(added, self.sample_time) or self.scale_findings(plant)
        if not found and not losing.any():  # what scales is looked at below, with the plant linearised
            found = constant_fault_findings(plant)
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

    def scale_findings(self, plant: Plant) -> list[Finding]:
        """A sensor that reads zero at the operating point shows nothing of its gain there."""
        actuators = [f.name for f in plant.faults if f.effect == "multiplicative" and f.site == "actuator"]
        if actuators:
            return [
                Finding(
                    f"fault '{actuators[0]}' multiplies an actuator",
                    why="the filter knows gains of sensors, and faults that add",
                    evidence={"faults": actuators},
                    remedies=('declare effect = "additive": (gain - 1) times the command is then reconstructed',),
                )
            ]
        for name, y, losing in zip(plant.signals.y.names, plant.point.y, scaled(plant), strict=True):
            if losing and y == 0.0:
                return [
                    Finding(
                        f"{name} reads zero at the operating point: there its gain cannot be seen",
                        why="a fault that multiplies moves zero by nothing",
                        evidence={"sensor": name, "reading": y},
                        remedies=(
                            "declare the operating point at which the plant is run",
                            'declare effect = "additive"',
                        ),
                    )
                ]
        return []

    def gains_without_proof(self, plant: Plant) -> dict[str, Array]:
        """The covariances that it is tuned with, R in a column; the gate where there is one."""
        T = self.time(plant)
        one = tuned(plant, T)
        found = {"T": np.array([[T]]), "Q": one.Q, "R": one.R[:, None], "P0": one.P0}
        return {**found, "gate": np.array([[self.gate]])} if math.isfinite(self.gate) else found

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """The filter as a map; its linear part is the filter at rest."""
        T = float(gains["T"].item())
        gate = float(gains["gate"].item()) if "gate" in gains else math.inf
        tuning = Tuning(gains["Q"], gains["R"][:, 0], gains["P0"], gate)
        steady = at_rest(plant, T, tuning)
        if steady is None:
            raise InputError(f"{self.name} with these covariances does not settle on {plant.name}")
        return filtering(self.steps(plant, T, tuning), steady)
