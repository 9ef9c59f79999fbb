# SPDX-License-Identifier: BSD-3-Clause
"""The verb `check`: whether the faults can be reconstructed, by which methods, and which sensor would help."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from faultrecon.plant.plant import Plant

UNDECLARED = "  or leave them undeclared: faultrecon design PLANT --bank takes every sensor for one that may fail"
TOLD_APART = (
    "  which of these faults can be told from which, and from which size on, says faultrecon design PLANT --bank"
)


def examined(
    plant: Plant, with_sensors: bool, candidates: Sequence[str] = (), *, as_json: bool = True, log: str = ""
) -> tuple[bool, dict[str, Any], str]:
    """Whether the faults can be reconstructed together, the answer as plain values, and as text.

    candidates: sensors that could be added, as text; they are ranked beside those that read a single state.  as_json:
    without it the plain values stay empty, and the distances that only they show are not computed.  log: a recording
    along which faults that multiply are looked at.
    """
    from faultrecon.advise.recommendation import recommend
    from faultrecon.diagnosis.diagnosis import diagnose
    from faultrecon.diagnosis.sensors import Candidate

    extra = [Candidate.from_text(text, plant) for text in candidates]
    found = diagnose(plant, _trajectory(plant, log)) if log else diagnose(plant)
    advice = recommend(plant)
    data = {**found.as_dict(), "possible": found.possible, "recommendation": advice.as_dict()} if as_json else {}
    lines = [str(found), str(advice) if plant.faults else UNDECLARED]
    additive = all(f.effect == "additive" for f in plant.faults)
    lines += [TOLD_APART] if len(plant.faults) > 1 and additive and found.possible else []
    if plant.faults and (with_sensors or extra):
        rows, more = _changes(plant, extra)
        data, lines = data | rows, [*lines, more]
    if plant.faults and with_sensors:
        rows, more = _sets(plant)
        data, lines = data | rows, [*lines, more]
    return found.possible, data, "\n".join(lines)


def _trajectory(plant: Plant, log: str) -> tuple[Any, ...]:
    """Where a recording went: its states where it has columns of their names, else those of the model by itself."""
    import numpy as np

    from faultrecon.io.logs import read_log

    read = read_log(log, plant.signals)
    columns = [read.extra.get(name) for name in plant.signals.x]
    known = [c for c in columns if c is not None]
    return (read.t, read.u, np.column_stack(known)) if len(known) == plant.n else (read.t, read.u)


def _changes(plant: Plant, extra: Sequence[Any]) -> tuple[dict[str, Any], str]:
    """What one sensor more, or one kept healthy, would do."""
    from faultrecon.diagnosis.sensors import rank_sensors

    options = rank_sensors(plant, [*extra, *plant.signals.x.names])
    lines = ["one change of sensors (an added one counts as free of noise unless said otherwise), the best first"]
    lines += [f"  {option}" for option in options]
    rows = [
        {"change": o.kind, "sensor": o.name, "possible": o.possible, "floor": o.floor and o.floor.value}
        | ({} if o.reads is None else {"reads": dict(o.reads.reads), "noise": o.reads.noise})
        for o in options
    ]
    return {"sensors": rows}, "\n".join(lines)


def _sets(plant: Plant) -> tuple[dict[str, Any], str]:
    """Which faults can be had at once."""
    from faultrecon.diagnosis.sensors import fault_sets

    sets = fault_sets(plant)
    lines = ["faults at once"]
    for one in sets:
        answer = "reconstructible" if one.reconstructible else f"not reconstructible: {one.why}"
        apart = "isolable" if one.isolable else "not isolable"
        lines.append(f"  {' and '.join(one.faults)}: {answer}; {apart}")
    rows = [
        {"faults": s.faults, "reconstructible": s.reconstructible, "isolable": s.isolable, "why": s.why} for s in sets
    ]
    return {"fault_sets": rows}, "\n".join(lines)
