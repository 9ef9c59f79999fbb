# SPDX-License-Identifier: BSD-3-Clause
"""The answer to the first question: which of these faults can be reconstructed, and how well at best?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from faultrecon.diagnosis.existence import (
    additive_sensor_findings,
    detectability_findings,
    disturbance_findings,
    fault_findings,
)
from faultrecon.diagnosis.limits import reconstruction_floor
from faultrecon.finding import Finding
from faultrecon.plant.plant import Plant


@dataclass(frozen=True)
class FaultDiagnosis:
    """One set of faults taken together: what stands against it, and the floor of any estimator's gain."""

    faults: tuple[str, ...]
    findings: tuple[Finding, ...]
    floor: float | None

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
            return {"faults": list(d.faults), "possible": d.possible, "floor": d.floor, "findings": findings}

        return {"plant": self.plant, "together": plain(self.together), "alone": [plain(d) for d in self.alone]}

    def __str__(self) -> str:
        lines = [f"{self.plant}"]
        for label, d in [("all faults together", self.together), *((f.faults[0], f) for f in self.alone)]:
            answer = "can be reconstructed" if d.possible else "cannot be reconstructed"
            floor = "" if d.floor is None else f"; no estimator can guarantee less than γ = {d.floor:.6g}"
            lines.append(f"  {label}: {answer}{floor if d.possible else ''}")
            lines += [f"    {f}" for f in d.findings]
        return "\n".join(lines)


def diagnose(plant: Plant) -> Diagnosis:
    """Whether the declared faults can be reconstructed, together and each alone, with reasons and the floor.

    Covers what the methods for additive sensor faults assume; raises nothing: every obstacle is a Finding.
    """
    names = tuple(f.name for f in plant.faults)
    together = _of(plant)
    alone = tuple(_of(plant.with_faults([name])) for name in names) if len(names) > 1 else ()
    return Diagnosis(plant.name, together, alone)


def _of(plant: Plant) -> FaultDiagnosis:
    findings = additive_sensor_findings(plant) or fault_findings(plant) or disturbance_findings(plant)
    floor = None
    if not findings:
        findings = detectability_findings(plant)
        if not any(f.severity == "fatal" for f in findings):
            peak = reconstruction_floor(plant)
            floor = None if peak is None else peak.value
    return FaultDiagnosis(tuple(f.name for f in plant.faults), tuple(findings), floor)
