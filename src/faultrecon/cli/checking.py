# SPDX-License-Identifier: BSD-3-Clause
"""The verb `check`: whether the faults can be reconstructed, by which methods, and which sensor would help."""

from __future__ import annotations

from typing import Any

from faultrecon.plant.plant import Plant


def examined(plant: Plant, with_sensors: bool) -> tuple[bool, dict[str, Any], str]:
    """Whether the faults can be reconstructed together, the answer as plain values, and as text."""
    from faultrecon.advise.recommendation import recommend
    from faultrecon.diagnosis.diagnosis import diagnose

    found, advice = diagnose(plant), recommend(plant)
    data = {**found.as_dict(), "possible": found.possible, "recommendation": advice.as_dict()}
    text = f"{found}\n{advice}"
    if with_sensors and plant.faults:
        rows, more = _sensors(plant)
        data, text = data | rows, f"{text}\n{more}"
    return found.possible, data, text


def _sensors(plant: Plant) -> tuple[dict[str, Any], str]:
    """What one sensor more, or one kept healthy, would do; which faults can be had at once."""
    from faultrecon.diagnosis.sensors import fault_sets, rank_sensors

    options, sets = rank_sensors(plant), fault_sets(plant)
    lines = ["one change of sensors (an added one without noise), the best first"]
    lines += [f"  {option}" for option in options]
    lines.append("faults at once")
    for one in sets:
        answer = "reconstructible" if one.reconstructible else f"not reconstructible: {one.why}"
        apart = "isolable" if one.isolable else "not isolable"
        lines.append(f"  {' and '.join(one.faults)}: {answer}; {apart}")
    data = {
        "sensors": [
            {"change": o.kind, "sensor": o.name, "possible": o.possible, "floor": o.floor and o.floor.value}
            for o in options
        ],
        "fault_sets": [
            {"faults": s.faults, "reconstructible": s.reconstructible, "isolable": s.isolable, "why": s.why}
            for s in sets
        ],
    }
    return data, "\n".join(lines)
