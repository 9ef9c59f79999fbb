# SPDX-License-Identifier: BSD-3-Clause
"""Whether the faults of a plant can be reconstructed at all, and if not, why not."""

from __future__ import annotations

import math

import numpy as np

from faultrecon.diagnosis import conditions
from faultrecon.diagnosis.conditions import Condition
from faultrecon.diagnosis.limits import Floor
from faultrecon.diagnosis.model import certain_distance, healthy, sensor_rank, unseen
from faultrecon.finding import Finding
from faultrecon.numerics.pencil import Mode
from faultrecon.plant.plant import Plant

HAIR = 1e-6
"""Distance to undetectability, relative to the model, below which model errors of a part in a million decide."""


def fault_findings(plant: Plant) -> list[Finding]:
    """What the fault channels alone rule out: none declared, or indistinguishable from each other."""
    if not plant.faults:
        return [
            Finding(
                f"{plant.name} declares no fault",
                why="there is nothing to reconstruct",
                remedies=("add a [[fault]] table to the plant file",),
            )
        ]
    sensor = [f for f in plant.faults if f.site == "sensor"]
    rank = sensor_rank(plant)
    if rank == len(sensor):
        return []
    F = plant.F_f[:, [f.site == "sensor" for f in plant.faults]]
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


def sampled_findings(plant: Plant, see: str) -> list[Finding]:
    """A finding where the plant is sampled, for methods stated for continuous time."""
    if plant.sample_time is None:
        return []
    return [
        Finding(
            f"the plant is sampled every {plant.sample_time:g} s",
            why="the method is stated for continuous time",
            evidence={"sample_time": plant.sample_time},
            remedies=("write the plant in continuous time, without sample_time",),
            see=see,
        )
    ]


def additive_sensor_findings(plant: Plant) -> list[Finding]:
    """What takes a plant out of the scope of observers for additive sensor faults in continuous time."""
    see = "Khosrowjerdi 2011, (2.1)"
    if plant.sample_time is not None:
        return sampled_findings(plant, see)
    for f in plant.faults:
        if f.site == "actuator" or f.effect == "multiplicative":
            return [
                Finding(
                    f"fault '{f.name}' is {f.effect} on a{'n' if f.site[0] == 'a' else ''} {f.site}",
                    why="the method reconstructs additive sensor faults",
                    evidence={"fault": f.name, "site": f.site, "effect": f.effect},
                    remedies=(
                        "declare it additive: the waveform of (gain - 1) times the signal is then reconstructed",
                        "use ts-mean-value, which reconstructs the gain itself",
                    )
                    if f.site == "sensor"
                    else ("reconstruct the sensor faults alone, with the actuator as a [[disturbance]]",),
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
            evidence={"sensors": reached},
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
    N = healthy(plant)
    modes = unseen(plant)
    if modes:
        return [_undetectable(plant, mode, N.shape[0]) for mode in modes if mode.value.imag >= 0]
    # A certain bound first: it leaves the search over all s to the few models that are anywhere near.
    if N.shape[0] == 0 or certain_distance(plant) > 10 * HAIR:
        return []
    margin = conditions.detectable(plant).distance
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


def assumptions(plant: Plant) -> tuple[Condition, ...]:
    """Every assumption of the literature that bears on the declared faults and disturbances, with its distance.

    The detectability of the healthy part for sensor faults; the constant fault model; and, where something is to be
    decoupled or an actuator may fail, the rank conditions and the zeros.
    """
    found = []
    if any(f.site == "sensor" for f in plant.faults):
        found.append(conditions.detectable(plant))
    if _unknown_inputs_declared(plant):
        found += _decoupling(plant)
    if plant.faults:
        found.append(conditions.constant_fault(plant))
    return tuple(found)


def decoupling_findings(plant: Plant) -> list[Finding]:
    """What forbids decoupling the disturbances with role "decouple" while faults are reconstructed as slowly varying.

    rank(C E_d) = rank(E_d), rank(J E_f) = q, (A, E_d, C) minimum phase, and the constant fault condition; the first
    that fails is fatal, and one that holds by a hair is a warning.  Sources: [Huang 2024], [Jia 2015], re-derived.
    """
    for condition in _decoupling(plant):
        if not condition.holds:
            return [_failed(plant, condition)]
    found = constant_fault_findings(plant)
    if any(f.severity == "fatal" for f in found):
        return found
    return [_by_a_hair(plant, c) for c in _decoupling(plant) if c.distance < HAIR] + found


def constant_fault_findings(plant: Plant) -> list[Finding]:
    """Whether a constant fault can be told from a plant at rest: the condition at s = 0, z = 1 when sampled."""
    condition = conditions.constant_fault(plant)
    if not condition.holds:
        return [_failed(plant, condition)]
    return [_by_a_hair(plant, condition)] if condition.distance < HAIR else []


def slow_fault_findings(plant: Plant, limit: Floor) -> list[Finding]:
    """What the floor of a set with actuator faults leaves out where their rate is not bounded."""
    unbounded = [f.name for f in plant.faults if f.site == "actuator" and not math.isfinite(f.rate)]
    if not unbounded:
        return []
    names = " and ".join(unbounded)
    return [
        Finding(
            f"this floor holds for {names} at rest; for one that moves none is known",
            why="an actuator fault reaches the sensors through the plant, which passes fast ones ever more weakly",
            evidence={"floor at rest": limit.value},
            remedies=(f"declare how fast {names} may change (rate = ... in its [[fault]] table)",),
            severity="note",
        )
    ]


def _unknown_inputs_declared(plant: Plant) -> bool:
    return any(f.site == "actuator" for f in plant.faults) or any(d.role == "decouple" for d in plant.attenuated)


def _decoupling(plant: Plant) -> list[Condition]:
    return [conditions.decouplable(plant), conditions.survives(plant), conditions.minimum_phase(plant)]


_MEANING = {
    "rank(C E_d) = rank(E_d)": "the measurements do not show at once what is to be decoupled, so no gain removes it",
    "rank(J E_f) = q": "an actuator fault enters the states exactly as what is decoupled, so both vanish together",
    "(A, E_d, C) minimum phase": "the plant can move along that mode with every measurement at zero",
}


def _failed(plant: Plant, condition: Condition) -> Finding:
    why = _MEANING.get(condition.name, "a constant fault, a constant unknown input or a drift cancel in every sensor")
    said = condition.where is None or condition.name.endswith((" = 0)", " = 1)"))
    at = "" if said or condition.where is None else f" at {_point(plant, condition.where)}"
    lives = f"; it lives in {', '.join(condition.states)}" if condition.states else ""
    names = [d.name for d in plant.attenuated if d.role == "decouple"]
    remedies = [f'attenuate {" and ".join(names)} instead of decoupling (role = "attenuate")'] if names else []
    remedies.append(f"add a sensor that reads {condition.states[0]}" if condition.states else "add a sensor")
    return Finding(
        f"{condition.name} fails{at}: rank {condition.rank} of {condition.needed}",
        why=why + lives,
        evidence={"condition": condition.as_dict(), "rank": condition.rank, "needed": condition.needed},
        remedies=tuple(remedies),
        see=condition.see,
    )


def _by_a_hair(plant: Plant, condition: Condition) -> Finding:
    return Finding(
        f"{condition.name} holds for {plant.name} by a hair",
        why=f"a relative change of {condition.distance:.1e} of the model would break it",
        evidence={"distance": condition.distance, "condition": condition.as_dict()},
        remedies=("add a sensor", "check the model where it is weakest"),
        see=condition.see,
        severity="warning",
    )


def _point(plant: Plant, s: complex) -> str:
    letter = "s" if plant.sample_time is None else "z"
    return f"{letter} = {s.real:.4g}" + (f" ± {abs(s.imag):.4g}j" if s.imag else "")


def _undetectable(plant: Plant, mode: Mode, healthy: int) -> Finding:
    states = list(conditions.living_in(plant, mode.direction))
    at = _point(plant, mode.value)
    if healthy == 0:
        what = "no sensor stays healthy and the plant does not settle by itself"
        why = f"its mode at {at} does not decay"
    else:
        what = f"the healthy sensors do not see the mode at {at}, which does not decay"
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
