# SPDX-License-Identifier: BSD-3-Clause
"""What looks odd in a plant before any question is asked of it: allowed, but seldom meant."""

from __future__ import annotations

from dataclasses import replace

from faultrecon.diagnosis.existence import disturbance_findings
from faultrecon.finding import Finding
from faultrecon.plant.plant import Plant


def oddities(plant: Plant) -> list[Finding]:
    """Warnings and notes about units and noise; none is fatal."""
    if not plant.faults:
        return _units(plant)
    # Without a disturbance any level is reached; the faults can be reconstructed all the same.
    calm = [replace(f, severity="warning") for f in disturbance_findings(plant)]
    return _units(plant) + calm + _noiseless(plant)


def _units(plant: Plant) -> list[Finding]:
    """Sensors that read a state with a coefficient of exactly one although their units differ."""
    x, y = plant.signals.x, plant.signals.y
    found = [
        (i, j)
        for i in range(plant.p)
        for j in range(plant.n)
        if plant.C[i, j] == 1.0 and x.units[j] and y.units[i] and x.units[j] != y.units[i]
    ]
    if not found:
        return []
    said = [f"{y.names[i]} [{y.units[i]}] reads {x.names[j]} [{x.units[j]}]" for i, j in found]
    return [
        Finding(
            f"{' and '.join(said)} with a coefficient of exactly 1, though the units differ",
            why="a change of units is a factor, and 1 is seldom it",
            evidence={f"C[{y.names[i]}, {x.names[j]}]": 1.0 for i, j in found},
            remedies=(
                f"write into C how many {y.units[found[0][0]]} one {x.units[found[0][1]]} is",
                "mend the unit that is wrong",
            ),
            severity="warning",
        )
    ]


def _noiseless(plant: Plant) -> list[Finding]:
    """Sensors that count as exact: an optimum against the other disturbances is then too good to be true."""
    exact = [
        name
        for name, row in zip(plant.signals.y.names, plant.F_w, strict=True)
        if not row.any() and any(not f.on.get(name) or f.site == "actuator" for f in plant.faults)
    ]
    if not exact or not plant.attenuated:
        return []
    names, one = " and ".join(exact), len(exact) == 1
    return [
        Finding(
            f"no disturbance acts on {names}, so {'it counts' if one else 'they count'} as exact when healthy",
            why="optimum and floor come out lower, perhaps nearly zero, than the real "
            f"{'sensor allows' if one else 'sensors allow'}, with gains to match",
            evidence={"sensors without a disturbance": len(exact), "sensors": plant.p, "names": exact},
            remedies=(
                f"declare sensor noise as a disturbance ([[disturbance]] on = {{ {exact[0]} = 1.0 }}, size = ...)",
            ),
            severity="note",
        )
    ]
