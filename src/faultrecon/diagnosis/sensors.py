# SPDX-License-Identifier: BSD-3-Clause
"""Which sensor would help: one more, or one of those there kept healthy; and which faults can be had at once."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.conditions import constant_fault, living_in
from faultrecon.diagnosis.limits import Floor, reconstruction_floor, slow_fault_floor
from faultrecon.diagnosis.model import Matrices, slow_modes
from faultrecon.diagnosis.possibility_points import ranked, region_of
from faultrecon.finding import InputError, did_you_mean
from faultrecon.numerics.annihilator import annihilator, column_rank
from faultrecon.numerics.pencil import SlowModes
from faultrecon.plant.fault import Disturbance
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import NAME, UNLIMITED, Channels, Noise

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A sensor that could be added: what it reads, by state, and how large its own disturbance is assumed to be."""

    name: str
    reads: Mapping[str, float]
    noise: float = 0.0
    unit: str = ""

    @classmethod
    def from_text(cls, text: str, plant: Plant) -> Candidate:
        """From 'sonar on position=1 noise=0.01': states with coefficients (1 where none is given), then its noise.

        Raises InputError with the form and a suggestion.
        """
        words = re.sub(r"\s*=\s*", "=", text.strip()).split()
        form = f"it is written 'name on state=coefficient noise=size', for example '{_example(plant)}'"
        if len(words) < 3 or words[1] != "on":
            raise InputError(f"the sensor '{text}' cannot be read", why=form)
        name, reads, noise = words[0], {}, 0.0
        if not NAME.fullmatch(name):
            raise InputError(f"'{name}' is no signal name", remedies=("use letters, digits and _, a letter first",))
        if name in (*plant.signals.y.names, *plant.signals.u.names):
            raise InputError(f"the sensor '{name}' has the name of another signal", remedies=("choose another name",))
        for word in words[2:]:
            key, equals, value = word.partition("=")
            if key != "noise" and key not in plant.signals.x.names:
                known = did_you_mean(key, (*plant.signals.x.names, "noise"))
                raise InputError(f"the sensor '{name}' reads '{key}', which is no state", why=known)
            if key in reads:
                raise InputError(f"the sensor '{name}' names {key} twice", why=form)
            number = _number(value if equals or key == "noise" else "1")
            if number is None:
                raise InputError(f"the sensor '{name}' has {key}={value}", why=f"that is no finite number; {form}")
            if key == "noise":
                noise = number
            else:
                reads[key] = number
        single = len(reads) == 1 and next(iter(reads.values())) == 1.0
        unit = plant.signals.x.units[plant.signals.x.index(next(iter(reads)))] if single else ""
        return cls(name, reads, noise, unit)

    def __str__(self) -> str:
        parts = [name if value == 1.0 else f"{value:g} {name}" for name, value in self.reads.items()]
        noise = f", noise {self.noise:g}" + (f" {self.unit}" if self.unit else "") if self.noise else ""
        return f"{self.name} (reads {' + '.join(parts).replace('+ -', '- ')}{noise})"


@dataclass(frozen=True, slots=True)
class SensorOption:
    """What one change of sensors would do.

    kind "add": a new healthy sensor; "protect": a sensor that is there is kept from failing, so `faults` need no
    reconstruction.  possible: whether nothing fatal is left; floor: what limits any estimator then; gain: the floor
    now over the floor then (inf where an impossible case becomes possible).  reads: the candidate, where one was given.
    """

    kind: Literal["add", "protect"]
    name: str
    possible: bool
    floor: Floor | None
    gain: float
    faults: tuple[str, ...] = field(default=())
    reads: Candidate | None = None

    def __str__(self) -> str:
        verb = {"add": "add a healthy sensor", "protect": "keep healthy"}[self.kind]
        name = self.name if self.reads is None else str(self.reads)
        if not self.possible:
            return f"{verb} {name}: does not help"
        level = "" if self.floor is None else f", floor {self.floor.value:.6g}"
        return f"{verb} {name}: possible{level}"


@dataclass(frozen=True, slots=True)
class FaultSet:
    """One row of the table of combinations.

    reconstructible: all waveforms at the same time (actuator faults: constant ones).  isolable: no other declared fault
    moves the measurements within the span of these.  why: what stands against the first, '' when nothing does.
    """

    faults: tuple[str, ...]
    reconstructible: bool
    isolable: bool
    why: str = ""


def with_sensor(plant: Plant, extra: Candidate) -> Plant:
    """The plant with one more healthy sensor, its noise a counted disturbance.  InputError: unknown state."""
    row = np.zeros((1, plant.n))
    for name, coefficient in extra.reads.items():
        row[0, plant.signals.x.index(name)] = coefficient
    if not row.any():
        why = "its coefficients are zero" if extra.reads else "it names none"
        raise InputError(f"the sensor {extra.name} reads no state", why=why, remedies=("name at least one state",))
    if not (math.isfinite(extra.noise) and extra.noise >= 0):
        raise InputError(f"the sensor {extra.name} has noise {extra.noise:g}", why="it is finite and not negative")
    y = plant.signals.y
    channels = Channels((*y.names, extra.name), (*y.units, extra.unit), (*y.ranges, math.nan), (*y.limits, UNLIMITED))
    noise, disturbances = plant.noise, plant.disturbances
    if extra.noise:
        own = Disturbance(f"noise of {extra.name}", on={extra.name: 1.0}, size=extra.noise)
        disturbances = (*disturbances, own)
    if noise is not None:
        noise = Noise(noise.hold, (*noise.sd, extra.noise))
    return replace(
        plant,
        signals=replace(plant.signals, y=channels),
        C=np.vstack([plant.C, row]),
        D=np.vstack([plant.D, np.zeros((1, plant.D.shape[1]))]),
        noise=noise,
        disturbances=disturbances,
        operating_point=replace(plant.point, y=(*plant.point.y, float(row[0] @ np.array(plant.point.x)))),
    )


def rank_sensors(
    plant: Plant, candidates: Iterable[Candidate | str] | None = None, *, protect: bool = True
) -> tuple[SensorOption, ...]:
    """Single changes of sensors, the one with the lowest floor first; those that do not help come last.

    candidates: sensors, or names of states for noiseless ones that read them; by default every state.  protect: also
    try to keep healthy each sensor that a fault sits on alone (a fault less to reconstruct).  The floor is that of
    `reconstruction_floor`, of `slow_fault_floor` with an actuator fault; where only existence differs, the order is
    the one given.
    """
    wanted = plant.signals.x.names if candidates is None else tuple(candidates)
    now = _worth(plant)
    options = []
    for one in wanted:
        extra = one if isinstance(one, Candidate) else _reading(plant, one)
        given = one if isinstance(one, Candidate) else None
        options.append(replace(_option("add", extra.name, with_sensor(plant, extra), now), reads=given))
    for sensor, names in (_protectable(plant) if protect else {}).items():
        left = [f.name for f in plant.faults if f.name not in names]
        if left:
            options.append(_option("protect", sensor, plant.with_faults(left), now, names))
    return tuple(sorted(options, key=_order))


def what_would_help(plant: Plant, candidates: Iterable[Candidate | str] | None = None) -> tuple[SensorOption, ...]:
    """The single sensors, added or kept healthy, that would make an impossible reconstruction possible; else ()."""
    if _existence(plant, range(len(plant.faults)), _slow(plant))[0]:
        return ()
    return tuple(option for option in rank_sensors(plant, candidates) if option.possible)


def fault_sets(plant: Plant, largest: int = 2) -> tuple[FaultSet, ...]:
    """Which combinations of up to `largest` declared faults can be reconstructed and isolated, in order of size.

    One eigenvalue problem for all of them; a set that contains an impossible one is impossible for the same reason and
    is not computed: fewer healthy outputs never see more.
    """
    slow = _slow(plant)
    refused: dict[frozenset[int], str] = {}
    rows = []
    for size in range(1, min(largest, len(plant.faults)) + 1):
        for chosen in combinations(range(len(plant.faults)), size):
            why = next((r for s, r in refused.items() if s <= frozenset(chosen)), "")
            if not why:
                why = _existence(plant, chosen, slow)[1]
                if why:
                    refused[frozenset(chosen)] = why
            names = tuple(plant.faults[j].name for j in chosen)
            rows.append(FaultSet(names, not why, _isolable(plant, chosen), why))
    return tuple(rows)


def _example(plant: Plant) -> str:
    return f"extra on {plant.signals.x.names[0]}=1 noise=0.01"


def _number(text: str) -> float | None:
    """A finite number, or None."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _reading(plant: Plant, state: str) -> Candidate:
    unit = plant.signals.x.units[plant.signals.x.index(state)]
    taken = {*plant.signals.y.names, *plant.signals.u.names}
    name = state if state not in taken else f"{state}_extra"
    while name in taken:
        name += "_"
    return Candidate(name, {state: 1.0}, 0.0, unit)


def _protectable(plant: Plant) -> dict[str, tuple[str, ...]]:
    """Sensors by the faults that would be gone with them: those that sit on that sensor alone."""
    found: dict[str, tuple[str, ...]] = {}
    for f in plant.faults:
        on = [name for name, value in f.on.items() if value]
        if f.site == "sensor" and len(on) == 1:
            found[on[0]] = (*found.get(on[0], ()), f.name)
    return found


def _worth(plant: Plant) -> tuple[bool, Floor | None]:
    possible = _existence(plant, range(len(plant.faults)), _slow(plant))[0]
    slow = possible and any(f.site == "actuator" for f in plant.faults)
    return possible, slow_fault_floor(plant) if slow else reconstruction_floor(plant)


def _option(
    kind: Literal["add", "protect"],
    name: str,
    changed: Plant,
    now: tuple[bool, Floor | None],
    faults: tuple[str, ...] = (),
) -> SensorOption:
    possible, floor = _worth(changed)
    before, gain = now[1], 1.0
    if possible and not now[0]:
        gain = math.inf
    elif before is not None and floor is not None and before.kind == floor.kind:
        gain = before.value / floor.value if floor.value > 0 else (math.inf if before.value > 0 else 1.0)
    return SensorOption(kind, name, possible, floor, gain, faults)


def _order(option: SensorOption) -> tuple[bool, float]:
    """By floor, in the six digits that are shown: rounding beyond them is no reason to prefer one sensor."""
    return not option.possible, math.inf if option.floor is None else float(f"{option.floor.value:.6g}")


def _slow(plant: Plant) -> SlowModes:
    return slow_modes(Matrices.of(plant))


def _existence(plant: Plant, chosen: Sequence[int], slow: SlowModes) -> tuple[bool, str]:
    """Whether the chosen faults, the others healthy, can be reconstructed, and what stands against it."""
    names = [plant.faults[j].name for j in chosen]
    sensor = [j for j in chosen if plant.faults[j].site == "sensor"]
    F = plant.F_f[:, sensor]
    if column_rank(F) < len(sensor):
        return False, f"{' and '.join(names)} move the measurements in dependent directions"
    if any(plant.faults[j].effect == "multiplicative" for j in chosen):
        rank = ranked(plant.with_faults(names), region_of(plant))
        why = f"the sensors do not tell them from the state in {rank.region}"
        return rank.separable > 0, "" if rank.separable else why
    if len(sensor) < len(chosen):
        condition = constant_fault(plant.with_faults(names))
        return condition.holds, "" if condition.holds else f"{condition.name} fails"
    modes = slow.undetectable(annihilator(F))
    if not modes:
        return True, ""
    s, states = modes[0].value, ", ".join(living_in(plant, modes[0].direction))
    at = f"{s.real:.4g}" + (f" ± {abs(s.imag):.4g}j" if s.imag else "")
    return False, f"the healthy sensors do not see the mode at {'z' if slow.sampled else 's'} = {at} ({states})"


def _isolable(plant: Plant, chosen: Sequence[int]) -> bool:
    """No other single fault lies in the span of the chosen ones, as directions into states and measurements."""
    M = np.vstack([plant.E_f, plant.F_f])
    own = M[:, list(chosen)]
    if column_rank(own) < len(chosen):
        return False
    others = (j for j in range(M.shape[1]) if j not in chosen)
    return all(column_rank(np.hstack([own, M[:, [j]]])) > len(chosen) for j in others)
