# SPDX-License-Identifier: BSD-3-Clause
"""One design per thing that may be wrong, from one plant: the bank that a monitor decides with."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from faultrecon.finding import FaultreconError, Finding, Impossible, InputError
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.storage.hashing import canonical_digest
from faultrecon.synthesis.pipeline import design
from faultrecon.synthesis.result import Design

if TYPE_CHECKING:
    from faultrecon.runtime.monitor import Monitor

SENSORS = "lipschitz-hinf"
ACTUATORS = ("adaptive-uio", "euler-pi")


@dataclass(frozen=True, eq=False)
class Bank:
    """Designs by hypothesis: one fault each, or several that act together.

    plant: with every fault that has a hypothesis.  refused: the hypotheses that have no design, and why.
    """

    plant: Plant
    designs: Mapping[str, Design]
    refused: Mapping[str, Finding] = field(default_factory=dict)

    @cached_property
    def digest(self) -> str:
        """A content hash of plant, methods and gains."""
        parts = {
            name: [made.method, made.plant.digest(), {k: v.tolist() for k, v in made.gains.items()}]
            for name, made in self.designs.items()
        }
        return canonical_digest({"bank": parts})

    def monitor(self, **options: Any) -> Monitor:
        """The bank at work on samples; options as in `runtime.building.monitor_of`."""
        from faultrecon.runtime.building import monitor_of

        return monitor_of(self, **options)

    def report(self) -> str:
        """The hypotheses, a line each."""
        lines = [f"bank for {self.plant.name}: {len(self.designs)} hypotheses besides 'all healthy'"]
        for name, made in self.designs.items():
            level = "no certificate" if made.level is None else f"γ {made.level:.4g}"
            found = made.verification
            lines.append(f"  {name}: {made.method}, {level}" + ("" if found is None else f", {found.verdict}"))
        lines += [f"  {name}: no design; {finding}" for name, finding in self.refused.items()]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for `--json`."""
        return {
            "plant": self.plant.name,
            "hypotheses": {name: made.as_dict() for name, made in self.designs.items()},
            "refused": {name: finding.as_dict() for name, finding in self.refused.items()},
        }

    def __repr__(self) -> str:
        return f"Bank({self.plant.name!r}: {', '.join(self.designs)})"


def bank(
    plant: Plant,
    *,
    sensors: Sequence[str] | None = None,
    actuators: Sequence[str] = (),
    together: Sequence[Sequence[str]] = (),
    method: str = "",
    progress: Callable[[str], None] | None = None,
) -> Bank:
    """A design for each sensor that may fail, each actuator, and each set of faults named `together`.

    sensors: names; all of them by default.  actuators: names of inputs.  together: sets of names that may act at once,
    of sensors and of declared faults.  A fault that the plant declares on a sensor keeps its name, size and rate; any
    other takes the sensor's name and range.  method: for sensors, "lipschitz-hinf" by default; actuators take the first
    of "adaptive-uio" and "euler-pi" that has a design.  Hypotheses without a design are listed with the reason.
    Raises InputError on unknown names, Impossible when no hypothesis has a design.
    """
    say = progress or (lambda name: None)
    y, u = plant.signals.y, plant.signals.u
    for name in sensors or ():
        y.index(name)
    for name in actuators:
        u.index(name)
    channels = {name: _channel(plant, name, "sensor") for name in (y.names if sensors is None else sensors)}
    channels |= {name: _channel(plant, name, "actuator") for name in actuators}
    sets: list[tuple[str, tuple[FaultChannel, ...]]] = [(channel.name, (channel,)) for channel in channels.values()]
    for names in together:
        members = tuple(channels.get(name) or _named(plant, name) for name in names)
        sets.append((" + ".join(f.name for f in members), members))
    made: dict[str, Design] = {}
    refused: dict[str, Finding] = {}
    for name, faults in sets:
        say(name)
        try:
            made[name] = _designed(replace(plant, faults=faults), method)
        except FaultreconError as error:
            refused[name] = error.finding
    if not made:
        first = next(iter(refused.values()), None)
        raise Impossible(
            f"no hypothesis about {plant.name} has a design",
            why="" if first is None else str(first),
            remedies=("see `faultrecon check` for what stands against each fault",),
        )
    every = {f.name: f for d in made.values() for f in d.plant.faults}
    return Bank(replace(plant, faults=tuple(every.values())), made, refused)


def _designed(plant: Plant, method: str) -> Design:
    """With the method asked for, or with the first that has a design."""
    sensors_only = all(f.site == "sensor" for f in plant.faults)
    names = (method,) if method else (SENSORS,) if sensors_only else ACTUATORS
    refusal: FaultreconError | None = None
    for name in names:
        try:
            return design(plant, name)
        except FaultreconError as error:
            refusal = refusal or error
    assert refusal is not None, "there is a method to try"
    raise refusal


def _channel(plant: Plant, name: str, site: str) -> FaultChannel:
    """The declared fault on this signal alone, or one of its name and range."""
    for fault in plant.faults:
        if fault.site == site and set(fault.on) == {name} and fault.effect == "additive":
            return fault
    group = plant.signals.y if site == "sensor" else plant.signals.u
    size = group.ranges[group.index(name)]
    if math.isnan(size):
        sd = 0.0 if plant.noise is None or site != "sensor" else plant.noise.sd[group.index(name)]
        size = 10.0 * sd if sd > 0 else 1.0
    taken = {d.name for d in plant.disturbances}
    return FaultChannel(
        name if name not in taken else f"{name} fault",
        {name: 1.0},
        "sensor" if site == "sensor" else "actuator",
        size=size,
    )


def _named(plant: Plant, name: str) -> FaultChannel:
    """A declared fault, or the one on a sensor of this name."""
    for fault in plant.faults:
        if fault.name == name:
            return fault
    if name in plant.signals.y.names:
        return _channel(plant, name, "sensor")
    if name in plant.signals.u.names:
        return _channel(plant, name, "actuator")
    known = (*(f.name for f in plant.faults), *plant.signals.y.names)
    raise InputError(f"there is no fault and no sensor '{name}'", why=f"there are {', '.join(known)}")
