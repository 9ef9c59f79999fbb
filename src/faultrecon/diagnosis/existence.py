# SPDX-License-Identifier: BSD-3-Clause
"""Whether the faults of a plant can be reconstructed at all, and if not, why not."""

from __future__ import annotations

import numpy as np

from faultrecon.finding import Finding
from faultrecon.numerics.annihilator import annihilator, column_rank
from faultrecon.numerics.pencil import Mode, detectability_margin, undetectable_modes
from faultrecon.plant.plant import Plant

HAIR = 1e-6
"""Distance to undetectability, relative to the model, below which model errors of a part in a million decide."""


def fault_findings(plant: Plant) -> list[Finding]:
    """What the fault channels alone rule out: none declared, or indistinguishable from each other."""
    if not plant.faults:
        return [Finding(f"{plant.name} declares no fault", remedies=("add a [[fault]] table to the plant file",))]
    sensor = [f for f in plant.faults if f.site == "sensor"]
    F = plant.F_f[:, [f.site == "sensor" for f in plant.faults]]
    rank = column_rank(F)
    if rank == len(sensor):
        return []
    weights = np.abs(np.linalg.svd(F / np.linalg.norm(F, axis=0))[2][-1])
    names = [f.name for f, weight in zip(sensor, weights, strict=True) if weight > 1e-6]
    return [
        Finding(
            f"the fault matrix F has rank {rank} for {len(sensor)} sensor faults",
            why=f"{' and '.join(names)} move the measurements in one direction, so their sizes cannot be told apart",
            evidence={"rank": rank, "faults": len(sensor), "sensors": plant.p},
            remedies=(
                "reconstruct one of them at a time (faults=[...] or --fault)",
                "add a sensor that only one of them reaches",
            ),
            see="Khosrowjerdi 2011, (2.2): F of full column rank",
        )
    ]


def additive_sensor_findings(plant: Plant) -> list[Finding]:
    """What takes a plant out of the scope of observers for additive sensor faults in continuous time."""
    see = "Khosrowjerdi 2011, (2.1)"
    if plant.sample_time is not None:
        return [Finding("the plant is sampled", why="the method is stated for continuous time", see=see)]
    for f in plant.faults:
        if f.site == "actuator" or f.effect == "multiplicative":
            return [
                Finding(
                    f"fault '{f.name}' is {f.effect} on a{'n' if f.site[0] == 'a' else ''} {f.site}",
                    why="the method reconstructs additive sensor faults",
                    remedies=("declare it additive: the waveform of (gain - 1) times the signal is then reconstructed",)
                    if f.site == "sensor"
                    else (),
                    see=see,
                )
            ]
    reached = [name for name in _read_by_known_term(plant) if any(f.on.get(name) for f in plant.faults)]
    if not reached:
        return []
    return [
        Finding(
            f"g reads {reached[0]}, which may be faulty",
            why="the fault would enter the observer through the known term",
            remedies=("write g with healthy sensors, or move the term into phi with the state it stands for",),
            see="Khosrowjerdi 2011, (2.5)",
        )
    ]


def _read_by_known_term(plant: Plant) -> list[str]:
    """The sensors that g depends on: read off its instructions, since a traced g has no text."""
    if plant.known is None or "y" not in plant.known.g.inputs:
        return []
    group = list(plant.known.g.inputs).index("y")
    found = {int(node[2]) for node in plant.known.g.nodes if node[0] == "input" and node[1] == group}
    return [plant.signals.y.names[i] for i in sorted(found)]


def disturbance_findings(plant: Plant) -> list[Finding]:
    """A level needs something to be measured against."""
    if plant.attenuated:
        return []
    return [
        Finding(
            f"{plant.name} declares no disturbance to attenuate",
            why="a guaranteed level compares the reconstruction error with disturbances, and every gain would do",
            remedies=("declare what disturbs the plant and the noise of its sensors as [[disturbance]] tables",),
        )
    ]


def detectability_findings(plant: Plant) -> list[Finding]:
    """Whether the sensors that stay healthy see every mode that does not decay by itself."""
    N = annihilator(plant.F_f)
    C1 = N @ plant.C
    modes = undetectable_modes(plant.A, C1, sampled=plant.sample_time is not None)
    if modes:
        return [_undetectable(plant, mode, N.shape[0]) for mode in modes if mode.value.imag >= 0]
    margin = detectability_margin(plant.A, C1, sampled=plant.sample_time is not None) if C1.shape[0] else np.inf
    if margin < HAIR:
        return [
            Finding(
                f"the healthy sensors detect every mode of {plant.name} by a hair",
                why=f"a relative change of {margin:.1e} in A and C would hide one",
                evidence={"distance": margin},
                remedies=("add a sensor", "check the model where it is weakest"),
                severity="warning",
            )
        ]
    return []


def _undetectable(plant: Plant, mode: Mode, healthy: int) -> Finding:
    weight = np.abs(mode.direction)
    states = [plant.signals.x.names[i] for i in np.argsort(-weight) if weight[i] > 0.1 * weight.max()][:3]
    s = f"{mode.value.real:.4g}" + (f" ± {mode.value.imag:.4g}j" if mode.value.imag else "")
    if healthy == 0:
        what = "no sensor stays healthy and the plant does not settle by itself"
        why = f"its mode at s = {s} does not decay"
    else:
        what = f"the healthy sensors do not see the mode at s = {s}, which does not decay"
        why = f"(A, C1) is not detectable; the mode lives in {', '.join(states)}"
    return Finding(
        what,
        why=why,
        evidence={"mode": [mode.value.real, mode.value.imag], "states": states},
        remedies=(
            f"add a healthy sensor that reads {states[0]}",
            "declare fewer faults at a time (faults=[...] or --fault)",
        ),
        see="assumption (A, C1) detectable, Khosrowjerdi 2011, section 2",
    )
