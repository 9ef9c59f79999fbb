# SPDX-License-Identifier: BSD-3-Clause
"""Which methods apply to a plant and its faults, why the others do not, and which one to ship."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from faultrecon.advise.comparison import Entry, SideBySide, compare
from faultrecon.finding import Finding, Impossible
from faultrecon.methods.registry import list_methods, method
from faultrecon.plant.plant import Plant
from faultrecon.simulation.scenario import Scenario
from faultrecon.synthesis.pipeline import design
from faultrecon.synthesis.result import Design

SOUND = ("proved", "checked", "assumed")
RULE = (
    "of the designs that carry a certificate, the one with the smallest simulated error (RMSE over the RMS of the"
    " fault, averaged over the faults); the lower guaranteed level decides between those within 5 % of it"
)
FIRST = "lipschitz-hinf"
"""Of the methods that apply, the one to try first: no fault enters its level, which holds for any waveform."""
EQUAL = 1.05
"""Errors of one scenario that differ by less than a part in twenty are no reason to prefer one method."""


@dataclass(frozen=True)
class Suitability:
    """One method: whether the plant meets its assumptions, and the findings that say where it does not."""

    method: str
    summary: str
    baseline: bool
    findings: tuple[Finding, ...]

    @property
    def applies(self) -> bool:
        """True when no assumption fails; whether the method then reaches a level, a design has to show."""
        return not any(f.severity == "fatal" for f in self.findings)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        findings = [f.as_dict() for f in self.findings]
        return {"method": self.method, "applies": self.applies, "baseline": self.baseline, "findings": findings}


@dataclass(frozen=True)
class Recommendation:
    """The table of methods for one plant: those that apply first, baselines last among them."""

    plant: str
    faults: tuple[str, ...]
    table: tuple[Suitability, ...]

    @property
    def applicable(self) -> tuple[str, ...]:
        """Names of the methods whose assumptions hold, in the order of preference."""
        return tuple(row.method for row in self.table if row.applies)

    def __getitem__(self, name: str) -> Suitability:
        return next(row for row in self.table if row.method == name)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {"applicable": list(self.applicable), "methods": [row.as_dict() for row in self.table]}

    def __str__(self) -> str:
        width = max([6, *(len(row.method) for row in self.table)])
        lines = ["methods for these faults"]
        for row in self.table:
            lines.append(f"  {row.method:{width}}  {'applies' if row.applies else 'does not apply'}: {row.summary}")
            lines += [f"  {'':{width}}    {f.what}" + (f": {f.why}" if f.why else "") for f in row.findings]
        if self.applicable:
            lines.append(
                f"  next: faultrecon design PLANT --method {self.applicable[0]}, or --method best to compare them"
            )
        return "\n".join(lines)


def recommend(plant: Plant) -> Recommendation:
    """Which methods apply to this plant and its declared faults, and why the others do not.

    Asks each method for the assumptions that fail; solves nothing.  Variants of methods are left out.
    """
    rows = [
        Suitability(name, found.summary, found.baseline, tuple(found.assumptions(plant)))
        for name, found in ((name, method(name)) for name in list_methods())
    ]
    rows.sort(key=lambda row: (not row.applies, row.baseline, row.method != FIRST))
    return Recommendation(plant.name, tuple(f.name for f in plant.faults), tuple(rows))


@dataclass(frozen=True, eq=False)
class Best:
    """The method that a comparison picked, the comparison, and the rule by which it was picked."""

    method: str
    table: SideBySide
    rule: str
    plant: Plant

    def design(self, **options: Any) -> Design:
        """The design of the method that was picked; options are those of `design`."""
        return design(self.plant, self.method, **options)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {"method": self.method, "rule": self.rule, "comparison": self.table.as_dict()}

    def __str__(self) -> str:
        return f"{self.table}\n\npicked: {self.method}\nrule: {self.rule}"


def best(plant: Plant, scenario: Scenario | None = None, *, progress: Callable[[float], None] | None = None) -> Best:
    """Design with every method that applies, compare them on a scenario, and pick one by `RULE`.

    scenario: each fault in turn by default.  Raises Impossible when no method applies or none gives a certificate.
    """
    advice = recommend(plant)
    if not advice.applicable:
        first = next((f for f in advice.table[0].findings if f.severity == "fatal"), None)
        raise Impossible(_nothing(plant, advice, first))
    table = compare(plant, advice.applicable, scenario, progress=progress)
    certified = [e for e in table.entries if e.verdict in SOUND and e.level is not None and e.scores]
    if not certified:
        raise Impossible(_uncertified(plant, table))
    least = min(map(error_of, certified))
    near = [e for e in certified if error_of(e) <= EQUAL * least]
    chosen = min(near, key=lambda e: (e.level or 0.0, error_of(e)))
    return Best(chosen.method, table, RULE, plant)


def error_of(entry: Entry) -> float:
    """Simulated RMSE over the RMS of the fault, averaged over the faults of a scenario."""
    values = [score.nrmse for score in (entry.scores or {}).values()]
    return sum(values) / len(values) if values else float("inf")


def _nothing(plant: Plant, advice: Recommendation, first: Finding | None) -> Finding:
    return Finding(
        f"none of {len(advice.table)} methods applies to {plant.name}",
        why="" if first is None else str(first),
        evidence={row.method: [f.what for f in row.findings] for row in advice.table},
        remedies=("run `faultrecon check PLANT`, which says of each method what stands against it",),
        see="docs: know why there is no design",
    )


def _uncertified(plant: Plant, table: SideBySide) -> Finding:
    return Finding(
        f"none of {len(table.entries)} methods that apply to {plant.name} gives a design with a certificate",
        why="; ".join(f"{e.method}: {e.note or e.verdict}" for e in table.entries),
        evidence={e.method: e.verdict for e in table.entries},
        remedies=(
            "run `faultrecon design PLANT --method NAME` for one of them: it says what would help, with numbers",
        ),
        see="docs: know why there is no design",
    )
