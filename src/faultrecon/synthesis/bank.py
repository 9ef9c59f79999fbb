# SPDX-License-Identifier: BSD-3-Clause
"""One design per thing that may be wrong, from one plant: the bank that a monitor decides with."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from faultrecon.finding import FaultreconError, Finding, Impossible, InputError, did_you_mean
from faultrecon.methods.registry import method as method_named
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.storage.hashing import canonical_digest
from faultrecon.synthesis.pipeline import design
from faultrecon.synthesis.result import Design

if TYPE_CHECKING:
    from faultrecon.runtime.apart import Apart
    from faultrecon.runtime.monitor import Monitor

SENSORS = "lipschitz-hinf"
FOLLOWING = "euler-pi"  # takes actuators, and sampled plants, whose own map it predicts with; it follows faults


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

    @cached_property
    def apart(self) -> Apart | Finding:
        """Which faults its monitor tells from which, and from which size on; why that is not known, where it is not."""
        from faultrecon.runtime.apart import apart

        try:
            return apart(self)
        except FaultreconError as error:
            return error.finding

    def report(self) -> str:
        """The hypotheses, a line each, and which of them are not told apart."""
        count = f"{len(self.designs)} hypothes{'is' if len(self.designs) == 1 else 'es'}"
        lines = [f"bank for {self.plant.name}: {count} besides 'all healthy'"]
        for name, made in self.designs.items():
            level = "no certificate" if made.level is None else f"γ {made.level:.4g}"
            found = made.verification
            lines.append(f"  {name}: {made.method}, {level}" + ("" if found is None else f", {found.verdict}"))
        reasons: dict[str, list[str]] = {}
        for name, finding in self.refused.items():
            reasons.setdefault(str(finding), []).append(name)
        lines += [f"  {', '.join(names)}: no design; {why}" for why, names in reasons.items()]
        apart = f"not known what it tells apart: {self.apart}" if isinstance(self.apart, Finding) else str(self.apart)
        return "\n".join([*lines, *(f"  {line}" for line in apart.splitlines())])

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for `--json`."""
        return {
            "plant": self.plant.name,
            "hypotheses": {name: made.as_dict() for name, made in self.designs.items()},
            "refused": {name: finding.as_dict() for name, finding in self.refused.items()},
            "apart": self.apart.as_dict(),
        }

    def __repr__(self) -> str:
        return f"Bank({self.plant.name!r}: {', '.join(self.designs)})"


def bank(
    plant: Plant,
    *,
    faults: Sequence[str] | None = None,
    sensors: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
    together: Sequence[Sequence[str]] = (),
    method: str = "",
    backoff: float | None = None,
    pole_bound: float | str | None = "auto",
    progress: Callable[[str], None] | None = None,
) -> Bank:
    """A design for each sensor that may fail, each actuator, and each set of faults named `together`.

    sensors: names; all of them by default.  actuators: names of inputs; by default those with a declared fault.
    faults: names of declared faults, sensors and inputs: these alone, and what the other arguments name.  together:
    sets of names that may act at once, of the same kinds.  A fault that the plant declares on a signal keeps its name,
    size and rate; any other takes the signal's name and range.
    method: for sensors, "lipschitz-hinf" by default; what that method cannot take for its actuators, and by default
    everything on a sampled plant, takes "euler-pi", which follows a fault: its rate has to be declared.
    backoff, pole_bound: of every design, as in `design`.  Hypotheses without a design are listed with the reason.
    Raises InputError on unknown names, Impossible when no hypothesis has a design.
    """
    say = progress or (lambda name: None)
    if method:
        method_named(method)  # raises on a name that there is not
    sets = _hypotheses(plant, faults, sensors, actuators, together)
    made: dict[str, Design] = {}
    refused: dict[str, Finding] = {}
    wrong: InputError | None = None
    for name, members in sets.items():
        say(name)
        try:
            chosen = replace(plant, faults=members)
            _demand_rates(chosen)
            made[name] = _designed(chosen, method, backoff=backoff, pole_bound=pole_bound)
        except FaultreconError as error:
            refused[name] = error.finding
            wrong = wrong or (error if isinstance(error, InputError) else None)
    if not made:
        if wrong is not None:
            raise wrong
        raise _nothing(plant, refused)
    every = {f.name: f for d in made.values() for f in d.plant.faults}
    return Bank(replace(plant, faults=tuple(every.values())), made, refused)


def _nothing(plant: Plant, refused: Mapping[str, Finding]) -> Impossible:
    """What is left to say where every hypothesis is refused."""
    if not refused:
        return Impossible(f"no hypothesis about {plant.name} is asked for", remedies=("name a sensor or an actuator",))
    why = {str(finding): finding for finding in refused.values()}
    remedies = dict.fromkeys(remedy for finding in why.values() for remedy in finding.remedies)
    return Impossible(
        f"no hypothesis about {plant.name} has a design",
        why="; ".join(f.what + (f": {f.why}" if f.why else "") for f in why.values()),
        evidence={name: finding.what for name, finding in refused.items()},
        remedies=tuple(remedies) or ("see `faultrecon check` for what stands against each fault",),
    )


def _hypotheses(
    plant: Plant,
    faults: Sequence[str] | None,
    sensors: Sequence[str] | None,
    actuators: Sequence[str] | None,
    together: Sequence[Sequence[str]],
) -> dict[str, tuple[FaultChannel, ...]]:
    """The faults of every hypothesis, by its name."""
    y, u = plant.signals.y, plant.signals.u
    for name in sensors or ():
        y.index(name)
    for name in actuators or ():
        u.index(name)
    if sensors is None:
        sensors = y.names if faults is None else ()
    channels = {name: _channel(plant, name, "sensor") for name in sensors}
    if actuators is not None:
        channels |= {name: _channel(plant, name, "actuator") for name in actuators}
    elif faults is None:
        channels |= {f.name: f for f in plant.faults if f.site == "actuator" and f.effect == "additive"}
    for name in faults or ():
        channels |= {f.name: f for f in _of_fault(plant, name)}
    sets: dict[str, tuple[FaultChannel, ...]] = {channel.name: (channel,) for channel in channels.values()}
    for names in together:
        members = tuple(channels.get(name) or _named(plant, name) for name in names)
        sets[" + ".join(f.name for f in members)] = members
    return sets


def _demand_rates(plant: Plant) -> None:
    """Raises Impossible where a fault has to be followed, and may go anywhere from one sample to the next."""
    sampled = plant.sample_time is not None
    missing = [f for f in plant.faults if math.isinf(f.rate) and (sampled or f.site == "actuator")]
    if not missing:
        return
    names = " and ".join(f.name for f in missing)
    kind = "a sampled plant" if sampled else "an actuator"
    f = missing[0]
    raise Impossible(
        f"no rate is declared for {names}",
        why=f"a fault of {kind} is followed by its observer; without a bound on its rate nothing bounds the error, and"
        " a log could never be tested against it",
        evidence={"without a rate": [f.name for f in missing]},
        remedies=(
            f'declare it: [[fault]] name = "{f.name}", {f.site} = "{next(iter(f.on))}", size = {f.size:g}, rate = ...'
            " (how much it changes in a second, at most)",
        ),
    )


def _designed(plant: Plant, method: str, **options: Any) -> Design:
    """With the method asked for, or with the one for such faults; with that too where the first takes no actuators."""
    actuators = any(f.site == "actuator" for f in plant.faults)
    own = FOLLOWING if actuators or plant.sample_time is not None else SENSORS
    if method and actuators and method != own:  # it was chosen for the sensors, and need not take actuators
        with suppress(FaultreconError):
            return design(plant, method, **options)
        return design(plant, own, **options)
    return design(plant, method or own, **options)


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


def _of_fault(plant: Plant, name: str) -> list[FaultChannel]:
    """A declared fault, a sensor or an input; one that multiplies counts as an additive one on each of its signals."""
    found = _named(plant, name)
    if found.effect == "additive":
        return [found]
    return [_channel(plant, on, found.site) for on in found.on]


def _named(plant: Plant, name: str) -> FaultChannel:
    """A declared fault, or the one on a sensor of this name."""
    for fault in plant.faults:
        if fault.name == name:
            return fault
    if name in plant.signals.y.names:
        return _channel(plant, name, "sensor")
    if name in plant.signals.u.names:
        return _channel(plant, name, "actuator")
    known = dict.fromkeys([*(f.name for f in plant.faults), *plant.signals.y.names, *plant.signals.u.names])
    raise InputError(f"there is no fault, no sensor and no input '{name}'", why=did_you_mean(name, known))
