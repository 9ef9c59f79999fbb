# SPDX-License-Identifier: BSD-3-Clause
"""The answer to the first question: which of these faults can be reconstructed, and how well at best?"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from faultrecon.diagnosis.conditions import Condition
from faultrecon.diagnosis.existence import (
    additive_sensor_findings,
    assumptions,
    decoupling_findings,
    detectability_findings,
    disturbance_findings,
    fault_findings,
)
from faultrecon.diagnosis.limits import Floor, reconstruction_floor
from faultrecon.finding import Finding
from faultrecon.plant.plant import Plant


@dataclass(frozen=True)
class FaultDiagnosis:
    """One set of faults taken together: what stands against it, and the floor of any estimator's gain.

    floor: smallest gain from disturbances to errors when nothing fatal was found.  limit: the floor that applies
    whether or not it was, for faults that hide an unstable mode in seconds of the faults' rate.  conditions: the
    assumptions of the literature one by one, with their distances.
    """

    faults: tuple[str, ...]
    findings: tuple[Finding, ...]
    floor: float | None
    limit: Floor | None = None
    conditions: tuple[Condition, ...] = ()

    @property
    def possible(self) -> bool:
        """True when nothing fatal was found."""
        return not any(f.severity == "fatal" for f in self.findings)


@dataclass(frozen=True)
class Diagnosis:
    """Findings for all declared faults together and for each alone."""

    plant: str
    together: FaultDiagnosis
    alone: tuple[FaultDiagnosis, ...]

    @property
    def possible(self) -> bool:
        """True when all declared faults can be reconstructed at the same time."""
        return self.together.possible

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""

        def plain(d: FaultDiagnosis) -> dict[str, Any]:
            findings = [f.as_dict() for f in d.findings]
            limit = None if d.limit is None else {"value": d.limit.value, "kind": d.limit.kind}
            return {
                "faults": list(d.faults),
                "possible": d.possible,
                "floor": d.floor,
                "limit": limit,
                "findings": findings,
                "conditions": [c.as_dict() for c in d.conditions],
            }

        return {"plant": self.plant, "together": plain(self.together), "alone": [plain(d) for d in self.alone]}

    def __str__(self) -> str:
        lines = [f"{self.plant}"]
        for label, d in [("all faults together", self.together), *((f.faults[0], f) for f in self.alone)]:
            answer = "can be reconstructed" if d.possible else "cannot be reconstructed"
            floor = "" if d.floor is None else f"; no estimator can guarantee less than γ = {d.floor:.6g}"
            lines.append(f"  {label}: {answer}{floor if d.possible else ''}")
            lines += [f"    {f}" for f in d.findings]
            if not d.possible and d.limit is not None and d.limit.kind == "hidden mode":
                lines.append(f"    what is left to methods that trade exactness for it: {d.limit}")
        return "\n".join(lines)


def diagnose(plant: Plant) -> Diagnosis:
    """Whether the declared faults can be reconstructed, together and each alone, with reasons and the floor.

    Additive sensor faults of any waveform; sampled plants alike; with an actuator fault all faults are taken as slowly
    varying, because nothing else is observable in general.  Raises nothing: every obstacle is a Finding.
    """
    names = tuple(f.name for f in plant.faults)
    together = _of(plant)
    alone = tuple(_of(plant.with_faults([name])) for name in names) if len(names) > 1 else ()
    return Diagnosis(plant.name, together, alone)


def _of(plant: Plant) -> FaultDiagnosis:
    names = tuple(f.name for f in plant.faults)
    findings = _scope(plant) or fault_findings(plant)
    if findings:
        return FaultDiagnosis(names, tuple(findings), None)
    if any(f.site == "actuator" for f in plant.faults):
        return FaultDiagnosis(names, tuple(decoupling_findings(plant)), None, None, assumptions(plant))
    if plant.sample_time is None:
        findings = disturbance_findings(plant)
    if not findings:
        findings = detectability_findings(plant)
        if any(d.role == "decouple" for d in plant.attenuated):
            # Decoupling is a wish: what cannot be decoupled can still be attenuated.
            findings += [replace(f, severity="warning") for f in decoupling_findings(plant)]
    limit = reconstruction_floor(plant)
    found = FaultDiagnosis(names, tuple(findings), None, limit, assumptions(plant))
    if not found.possible or limit is None or limit.kind != "disturbance":
        return found
    return replace(found, floor=limit.value)


def _scope(plant: Plant) -> list[Finding]:
    """Multiplicative faults, and a known term that reads a faulty sensor: outside every statement made here."""
    sensors = tuple(f for f in plant.faults if f.site == "sensor" or f.effect == "multiplicative")
    return additive_sensor_findings(replace(plant, faults=sensors, sample_time=None))
