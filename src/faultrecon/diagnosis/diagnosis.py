# SPDX-License-Identifier: BSD-3-Clause
"""The answer to the first question: which of these faults can be reconstructed, and how well at best?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from faultrecon.diagnosis.conditions import Condition
from faultrecon.diagnosis.existence import (
    additive_sensor_findings,
    assumptions,
    decoupling_findings,
    detectability_findings,
    fault_findings,
    slow_fault_findings,
)
from faultrecon.diagnosis.groups import look_alikes
from faultrecon.diagnosis.limits import Floor, reconstruction_floors, slow_fault_floor
from faultrecon.diagnosis.plausibility import oddities
from faultrecon.finding import Finding, InputError
from faultrecon.plant.plant import Plant

if TYPE_CHECKING:
    from faultrecon.diagnosis.possibility import Possibility


@dataclass(frozen=True)
class FaultDiagnosis:
    """One set of faults taken together: what stands against it, and the floor of any estimator's gain.

    floor: smallest gain from disturbances to errors when nothing fatal was found.  limit: the floor that applies
    whether or not it was, for faults that hide an unstable mode in seconds of the faults' rate.  subject: the plant
    with these faults.  possibility: what is known of a set in which a fault multiplies; None otherwise.
    """

    faults: tuple[str, ...]
    findings: tuple[Finding, ...]
    floor: float | None
    limit: Floor | None = None
    subject: Plant | None = field(default=None, repr=False, compare=False)
    possibility: Possibility | None = field(default=None, repr=False, compare=False)

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """The assumptions of the literature one by one, with their distances; () where none of them bears."""
        return () if self.subject is None else assumptions(self.subject)

    @property
    def possible(self) -> bool:
        """True when nothing fatal was found."""
        return not any(f.severity == "fatal" for f in self.findings)


@dataclass(frozen=True)
class Diagnosis:
    """Findings for all declared faults together and for each alone; notes: what looks odd in the plant itself."""

    plant: str
    together: FaultDiagnosis
    alone: tuple[FaultDiagnosis, ...]
    notes: tuple[Finding, ...] = ()

    @property
    def possible(self) -> bool:
        """True when all declared faults can be reconstructed at the same time."""
        return self.together.possible

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""

        def plain(d: FaultDiagnosis) -> dict[str, Any]:
            findings = [f.as_dict() for f in d.findings]
            keys = ("value", "kind", "frequency", "band")
            limit = None if d.limit is None else {k: getattr(d.limit, k) for k in keys}
            return {
                "faults": list(d.faults),
                "possible": d.possible,
                "floor": d.floor,
                "limit": limit,
                "findings": findings,
                "conditions": [c.as_dict() for c in d.conditions],
                **({} if d.possibility is None else {"possibility": d.possibility.as_dict()}),
            }

        sets = {"together": plain(self.together), "alone": [plain(d) for d in self.alone]}
        return {"plant": self.plant, **sets, "notes": [f.as_dict() for f in self.notes]}

    def __str__(self) -> str:
        lines = [f"{self.plant}"]
        if not self.together.faults:
            lines += [f"  {f}" for f in self.together.findings]
        else:
            for label, d in [("all faults together", self.together), *((f.faults[0], f) for f in self.alone)]:
                lines += _said(label if self.alone else d.faults[0], d)
        return "\n".join([*lines, *(f"  {f.severity}: {f}" for f in self.notes)])


def _said(label: str, d: FaultDiagnosis) -> list[str]:
    """What is found about one set of faults, in lines."""
    bounded = d.limit is not None and d.limit.kind == "hidden mode" and math.isfinite(d.limit.value)
    slow = "" if d.possibility is None or d.possibility.any_waveform else ", while slow"
    exactly = " exactly" if bounded else ""
    answer = f"can be reconstructed{slow}" if d.possible else f"cannot be reconstructed{exactly}"
    limit = f"; {d.limit}" if d.possible and d.limit is not None else ""
    lines = [f"  {label}: {answer}{limit}", *(f"    {f}" for f in d.findings)]
    if not d.possible and d.limit is not None and d.limit.kind == "hidden mode":
        lines.append(f"    what is left to methods that trade exactness for it: {d.limit}")
    return lines


def diagnose(plant: Plant, trajectory: Any = None) -> Diagnosis:
    """Whether the declared faults can be reconstructed, together and each alone, with reasons and the floor.

    Additive sensor faults of any waveform; sampled plants alike; with an actuator fault all faults are taken as slowly
    varying, because nothing else is observable in general.  A fault that multiplies its sensor is looked at where the
    plant works: see `possibility` of each set.  trajectory: a run, or (t, u, x) absolute, along which that is done;
    without it at points of the declared region and at the operating point.  Every obstacle is a Finding; raises
    InputError on a trajectory where no fault multiplies, or that is none of this plant.
    """
    names = tuple(f.name for f in plant.faults)
    if trajectory is not None and not _multiplies(plant):
        raise InputError(
            "a trajectory is given, and no fault multiplies its sensor",
            why="whether additive faults can be reconstructed does not depend on where the plant goes",
            remedies=("leave the trajectory out",),
        )
    sets = [plant, *(plant.with_faults([name]) for name in names if len(names) > 1)]
    begun = [_obstacles(one, trajectory) for one in sets]
    found = [_limited(d, limit) for d, limit in zip(begun, _limits(begun), strict=True)]
    # A level against disturbances, and sensors that count as exact in it, are no matter of faults that multiply.
    level = not names or any(f.effect == "additive" for f in plant.faults)
    notes = [*oddities(plant if level else replace(plant, faults=())), *look_alikes(plant)]
    return Diagnosis(plant.name, found[0], tuple(found[1:]), tuple(notes))


def _obstacles(plant: Plant, trajectory: Any) -> FaultDiagnosis:
    """What stands against these faults; no limit yet."""
    names = tuple(f.name for f in plant.faults)
    outside = _scope(plant) or fault_findings(plant)
    if outside:
        return FaultDiagnosis(names, tuple(outside), None)
    if _multiplies(plant):
        from faultrecon.diagnosis.possibility import possibility

        known = possibility(plant, trajectory)
        return FaultDiagnosis(names, known.findings, None, possibility=known)
    if _actuator(plant):
        return FaultDiagnosis(names, tuple(decoupling_findings(plant)), None, subject=plant)
    findings = detectability_findings(plant)
    if any(d.role == "decouple" for d in plant.attenuated):
        # Decoupling is a wish: what cannot be decoupled can still be attenuated.
        findings += [replace(f, severity="warning") for f in decoupling_findings(plant)]
    return FaultDiagnosis(names, tuple(findings), None, subject=plant)


def _limits(begun: Sequence[FaultDiagnosis]) -> list[Floor | None]:
    """The floor of each set, whatever stands against it; sets of sensor faults are asked together."""
    sensors = {j: d.subject for j, d in enumerate(begun) if d.subject is not None and not _actuator(d.subject)}
    floors = dict(zip(sensors, reconstruction_floors(list(sensors.values())), strict=True))
    for j, d in enumerate(begun):
        if d.subject is not None and j not in floors:
            floors[j] = slow_fault_floor(d.subject) if d.possible else None
    return [floors.get(j) for j in range(len(begun))]


def _limited(d: FaultDiagnosis, limit: Floor | None) -> FaultDiagnosis:
    """With its limit, and with what has to be said about one that covers slow faults only."""
    if limit is None:
        return d
    if limit.kind == "slow fault" and d.subject is not None:
        d = replace(d, findings=(*d.findings, *slow_fault_findings(d.subject, limit)))
    return replace(d, limit=limit, floor=limit.value if d.possible and limit.kind == "disturbance" else None)


def _actuator(plant: Plant) -> bool:
    return any(f.site == "actuator" for f in plant.faults)


def _multiplies(plant: Plant) -> bool:
    return any(f.effect == "multiplicative" for f in plant.faults)


def _scope(plant: Plant) -> list[Finding]:
    """A known term that reads a faulty sensor: outside every statement made here."""
    if plant.known is None:
        return []
    sensors = tuple(replace(f, effect="additive") for f in plant.faults if f.site == "sensor")
    return additive_sensor_findings(replace(plant, faults=sensors, sample_time=None))
