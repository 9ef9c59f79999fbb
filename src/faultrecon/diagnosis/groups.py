# SPDX-License-Identifier: BSD-3-Clause
"""Which faults look like each other, whatever observer is made: found from pairs, reported as groups.

Two faults that can act together and show nothing at all look like each other: what one of them shows, the other shows
with its sign changed.  Where that takes a disturbance, it matters if the faults may be large while it stays within its
declared size.  For which constant faults a bank is certain to name the right one is a narrower question, which its
report answers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from faultrecon.diagnosis.existence import detectability_findings, fault_findings
from faultrecon.diagnosis.limits import reconstruction_floors
from faultrecon.finding import Finding
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.plant import Plant

OWN = 0.5  # of the level of a pair: more than that each alone shows that it is one fault nobody can see, not a mix-up


@dataclass(frozen=True)
class _Pair:
    """Two faults that look like each other, and up to which level, in declared sizes; inf without any disturbance."""

    names: tuple[str, str]
    level: float


def look_alikes(plant: Plant) -> list[Finding]:
    """A note for each group of additive sensor faults that look like each other within their ranges.

    Of three faults one may look like the second, and that like the third: groups are sets that are connected.
    """
    faults = [f for f in plant.faults if f.site == "sensor" and f.effect == "additive"]
    if len(faults) < 2 or plant.known is not None or not _any(plant, faults):
        return []
    possible = [f for f in faults if not _hidden(plant.with_faults([f.name]))]
    two = list(combinations(possible, 2))
    plants = [plant.with_faults([f.name for f in pair]) for pair in two]
    alone = {f.name: _level(plant.with_faults([f.name])) for f in possible}
    floors = reconstruction_floors(plants)
    pairs = []
    for (a, b), both, floor in zip(two, plants, floors, strict=True):
        if _hidden(both):
            pairs.append(_Pair((a.name, b.name), math.inf))
        elif floor is not None and floor.kind == "disturbance":
            own = max(alone[a.name], alone[b.name]) / OWN
            if floor.value > max(own, _largest(plant, (a, b))):
                pairs.append(_Pair((a.name, b.name), floor.value))
    return [_said(plant, group, pairs) for group in _connected(pairs)]


def _any(plant: Plant, faults: Sequence[FaultChannel]) -> bool:
    """Whether a pair may be found: no pair is harder to tell apart than all faults at once."""
    every = plant.with_faults([f.name for f in faults])
    return _hidden(every) or _level(every) > min(_largest(plant, pair) for pair in combinations(faults, 2))


def _hidden(plant: Plant) -> bool:
    """Whether the faults can act and show nothing, without any disturbance."""
    return any(f.severity == "fatal" for f in fault_findings(plant) or detectability_findings(plant))


def _level(plant: Plant) -> float:
    floor = reconstruction_floors([plant])[0]
    return 0.0 if floor is None or floor.kind != "disturbance" else floor.value


def _largest(plant: Plant, pair: Sequence[FaultChannel]) -> float:
    """The largest that two faults get, in declared sizes: by the ranges of their sensors, where those are declared."""
    return math.hypot(*(_reach(plant, f) / f.size for f in pair))


def _reach(plant: Plant, fault: FaultChannel) -> float:
    y = plant.signals.y
    moved = [abs(y.ranges[y.index(name)] / c) for name, c in fault.on.items() if c]
    return max([fault.size, *(size for size in moved if math.isfinite(size))])


def _connected(pairs: Sequence[_Pair]) -> list[tuple[str, ...]]:
    groups: list[list[str]] = []
    for pair in pairs:
        touched = [group for group in groups if set(group) & set(pair.names)]
        merged = list(dict.fromkeys([name for group in touched for name in group] + list(pair.names)))
        groups = [*(group for group in groups if group not in touched), merged]
    return [tuple(group) for group in groups]


def _said(plant: Plant, group: Sequence[str], pairs: Sequence[_Pair]) -> Finding:
    own = [pair for pair in pairs if pair.names[0] in group]
    least = min(pair.level for pair in own)
    names = f"{', '.join(group[:-1])} and {group[-1]}"
    if math.isinf(least):
        why = "two of them can act together and show nothing at all, so one looks like the other"
    else:
        reach = max(_largest(plant, [f for f in plant.faults if f.name in pair.names]) for pair in own)
        why = (
            f"two of them can act together, {least:.4g} declared sizes strong, and a disturbance of declared size hides"
            f" it; their ranges allow {reach:.4g} at most, so one looks like the other"
        )
    return Finding(
        f"{names} cannot be told apart",
        why=why,
        evidence={
            "group": list(group),
            "pairs": [[*pair.names, pair.level if math.isfinite(pair.level) else None] for pair in own],
        },
        remedies=(
            "add a sensor that only one of them reaches (faultrecon check PLANT --sensors)",
            *(() if math.isinf(least) else ("declare smaller disturbances, if they are smaller",)),
        ),
        see="docs: which sensor is lying",
        severity="note",
    )
