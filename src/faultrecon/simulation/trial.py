# SPDX-License-Identifier: BSD-3-Clause
"""How small a fault does a monitor still find?  Each fault at many sizes, many times, in the plant's own noise.

Runs are as `proving_ground` says.  The fault goes upwards in every other run, downwards in the others, and lasts to the
end; all sizes of all faults meet the same runs.  False alarms are counted in runs without any fault.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError, did_you_mean
from faultrecon.numerics.counting import rate_interval, share_interval
from faultrecon.plant.fault import FaultChannel
from faultrecon.runtime.apart import separation
from faultrecon.runtime.building import monitor_of
from faultrecon.runtime.monitor import Monitor
from faultrecon.runtime.told import Episode, Told, alarm_rate
from faultrecon.simulation.proving_ground import Ground
from faultrecon.simulation.scenario import Signal
from faultrecon.simulation.shapes import Ramp, Step
from faultrecon.synthesis.bank import Bank

Array = NDArray[Any]

LADDER = tuple(2.0 ** (-k / 2) for k in range(6, -1, -1))
"""Of what is found for certain: the sizes that are tried where none are asked for."""
LASTS = 6.0
"""Longest time constants of the filters: how long a fault lasts by default; they then hold all but 0.3 % of it."""
WAVEFORMS = ("step", "ramp")
HEAD = ("fault", "waveform", "size", "of declared", "runs", "missed", "(between)", "named wrongly", "delay", "9 of 10")


@dataclass(frozen=True, slots=True)
class Found:
    """One fault of one size and waveform: how many of the runs missed it, or named something else meanwhile.

    part: of its declared size.  unnoticed: runs in which nothing was said at all.  delay, delay_90: s from where it is
    5 % of its size to its name, the median and what nine of ten runs keep; inf where too many missed it.
    """

    fault: str
    waveform: str
    size: float
    part: float
    runs: int
    missed: int
    unnoticed: int
    wrong: int
    delay: float
    delay_90: float

    @property
    def missed_rate(self) -> float:
        """The part of the runs that missed it."""
        return self.missed / self.runs

    @property
    def missed_between(self) -> tuple[float, float]:
        """Where the probability of a miss lies, as `share_interval` says."""
        return share_interval(self.missed, self.runs)

    @property
    def wrong_rate(self) -> float:
        """The part of the runs in which something was named that did not act."""
        return self.wrong / self.runs

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for `--json`."""
        rates = {"missed_rate": self.missed_rate, "missed_between": list(self.missed_between)}
        return {**asdict(self), **rates, "wrong_rate": self.wrong_rate}


@dataclass(frozen=True)
class Trial:
    """Missed faults by size, and false alarms.  certain: the size from which each is found for sure, worst case.

    hours: of operation without a fault, in which `false_alarms` came.  lasts: s, each fault.  left: what left its
    declared range in some run: there, bounds promise nothing.
    """

    plant: str
    found: tuple[Found, ...]
    certain: Mapping[str, float]
    false_alarms: int
    hours: float
    lasts: float
    seed: int
    left: tuple[str, ...] = ()

    @property
    def false_alarms_per_hour(self) -> float:
        """Of operation without a fault; NaN where there was none."""
        return self.false_alarms / self.hours if self.hours > 0 else math.nan

    @property
    def false_alarms_between(self) -> tuple[float, float]:
        """Where the rate per hour lies; with no alarm in H hours the upper end is 3.0/H."""
        return rate_interval(self.false_alarms, self.hours)

    def columns(self) -> dict[str, Array]:
        """The table, as `write_log` takes it."""
        rows = [one.as_dict() for one in self.found]
        for row in rows:
            row["missed_at_least"], row["missed_at_most"] = row.pop("missed_between")
        return {name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {}

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for `--json`."""
        return {
            "plant": self.plant,
            "found": [one.as_dict() for one in self.found],
            "certain": dict(self.certain),
            "false_alarms": self.false_alarms,
            "healthy_hours": self.hours,
            "false_alarms_per_hour": self.false_alarms_per_hour,
            "false_alarms_between": list(self.false_alarms_between),
            "lasts": self.lasts,
            "seed": self.seed,
            "left_range": list(self.left),
        }

    def __str__(self) -> str:
        table: list[tuple[str, ...]] = [HEAD]
        for one in self.found:
            low, high = one.missed_between
            rates = _percent(one.missed_rate), f"{_percent(low)} to {_percent(high)}", _percent(one.wrong_rate)
            size = f"{one.size:.4g}", f"{one.part:.3g}", str(one.runs)
            table.append((one.fault, one.waveform, *size, *rates, _seconds(one.delay), _seconds(one.delay_90)))
        widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
        lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
        sure = [f"{name} {size:.4g}" for name, size in self.certain.items() if math.isfinite(size)]
        never = [name for name, size in self.certain.items() if math.isinf(size)]
        lines += ["", f"found for certain, in the worst case, once constant for long enough: {', '.join(sure) or '-'}"]
        lines += [f"no size is known from which they are: {', '.join(never)}"] if never else []
        lines += [alarm_rate(self.false_alarms, self.hours), "every end of an interval is right in 95 of 100 cases"]
        if self.left:
            lines.append(f"note: {', '.join(self.left)} left the declared range in some run, where bounds may not hold")
        return "\n".join(lines)


def trial(
    bank: Bank,
    *,
    faults: Sequence[str] | None = None,
    sizes: Sequence[float] | None = None,
    waveforms: Sequence[str] = WAVEFORMS,
    runs: int = 20,
    hours: float = 0.5,
    duration: float | None = None,
    inputs: Mapping[str, Signal] | None = None,
    disturbances: Mapping[str, Signal] | None = None,
    noise: bool = True,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> Trial:
    """Let a monitor find simulated faults: how many it misses, by size, and how many it makes up.

    faults: names, all that have a hypothesis of their own by default.  sizes: in declared sizes; by default from an
    eighth of what is found for certain (`separation`) up to that.  waveforms: "step", and "ramp" at the declared rate,
    or over half of the duration where none is declared.  runs: of each fault, size and waveform.  hours: of runs
    without a fault; a nonlinear plant may take as long as what is simulated.
    duration: s that a fault lasts.  inputs, disturbances, noise: as in `Scenario`; disturbances that are not given are
    drawn.  options: those of `Bank.monitor`.  Deterministic, given the seed.
    Raises InputError on what makes no sense, Impossible when no hypothesis can be tested.
    """
    _check(runs, hours, duration, sizes, waveforms)
    monitor = monitor_of(bank, **options)
    ground = Ground(monitor, dict(inputs or {}), dict(disturbances or {}), noise, seed)
    chosen, certain = _chosen(monitor, bank, faults), _certain(monitor)
    tried = {name: _sizes(ground.channel(name), certain.get(name, math.inf), sizes) for name in chosen}
    lasts = _lasting(ground, tried, waveforms, duration)
    cells = list(_cells(ground, tried, waveforms, lasts))
    pieces = math.ceil(hours * 3600.0 / (ground.begin + lasts))
    total, tell = runs * len(cells) + pieces, progress or (lambda part: None)
    seen: list[list[Episode]] = [[] for _ in cells]
    left: list[str] = []
    for run in range(runs):
        truth = ground.healthy(f"run {run}", ground.begin + lasts)
        left += ground.left(truth)
        for k, cell in enumerate(cells):
            shape = replace(cell.shape, size=-cell.size if run % 2 else cell.size)
            seen[k].append(ground.tried(truth, cell.channel, shape).episodes[0])
            tell((run * len(cells) + k + 1) / total)
    healthy: list[Told] = []
    for k in range(pieces):
        truth = ground.healthy(f"healthy {k}", ground.begin + lasts)
        left += ground.left(truth)
        healthy.append(ground.told(truth, truth.y, {}))
        tell((runs * len(cells) + k + 1) / total)
    found = tuple(_found(cell, of) for cell, of in zip(cells, seen, strict=True))
    alarms, operated = sum(one.of_nothing for one in healthy), sum(one.healthy_hours for one in healthy)
    sure = {name: certain.get(name, math.inf) for name in chosen}
    return Trial(bank.plant.name, found, sure, alarms, operated, lasts, seed, tuple(dict.fromkeys(left)))


# ---------------------------------------------------------------- what is tried


def _check(
    runs: int, hours: float, duration: float | None, sizes: Sequence[float] | None, waveforms: Sequence[str]
) -> None:
    if runs < 1:
        raise InputError(f"{runs} runs", why="a rate takes one or more", remedies=("ask for 20 to 100",))
    if not (math.isfinite(hours) and hours >= 0):
        raise InputError(f"{hours} hours without a fault", why="it is a number, zero or more")
    if duration is not None and not (math.isfinite(duration) and duration > 0):
        raise InputError(f"a fault that lasts {duration} s", why="it is a positive number of seconds")
    for size in () if sizes is None else sizes:
        if not (math.isfinite(size) and size > 0):
            raise InputError(
                f"a fault of size {size:g}",
                why="a size is a positive number, in declared sizes; faults of both signs are tried",
            )
    if (sizes is not None and not len(sizes)) or not len(waveforms):
        raise InputError("there is nothing to try", remedies=("give sizes and waveforms, or leave them out",))
    for word in waveforms:
        if word not in WAVEFORMS:
            raise InputError(f"there is no waveform '{word}' in a trial", why=did_you_mean(word, WAVEFORMS))


def _chosen(monitor: Monitor, bank: Bank, faults: Sequence[str] | None) -> list[str]:
    """Faults with a hypothesis of their own.  Raises InputError on others."""
    for name in faults or ():
        if name in monitor.refused or name in bank.refused:
            why = monitor.refused[name] if name in monitor.refused else bank.refused[name]
            raise InputError(f"{name} cannot be tried: no hypothesis tests it", why=str(why))
        if name not in monitor.singles:
            raise InputError(f"there is no fault '{name}' in the bank", why=did_you_mean(name, monitor.singles))
    chosen = list(dict.fromkeys(monitor.singles if faults is None else faults))
    if not chosen:
        raise InputError("there is no fault to try", why="no hypothesis of the bank has one fault alone")
    return chosen


def _certain(monitor: Monitor) -> dict[str, float]:
    """The constant size from which every other hypothesis is ruled out for certain; where there is none, no entry."""
    table = separation(monitor)
    return {fault: max(needed.values()) for fault, needed in table.items() if needed}


def _sizes(fault: FaultChannel, certain: float, sizes: Sequence[float] | None) -> list[float]:
    """Sizes in the unit of the fault, each once, the smallest first."""
    if sizes is not None:
        return sorted({size * fault.size for size in sizes})
    top = certain if math.isfinite(certain) else fault.size
    return [part * top for part in LADDER]


def _lasting(
    ground: Ground, tried: Mapping[str, Sequence[float]], waveforms: Sequence[str], duration: float | None
) -> float:
    """As asked; by default long enough for the slowest filter, and for every ramp and half as long again."""
    if duration is not None:
        window = ground.monitor.rules.window * ground.monitor.sample_time
        if duration < 2.0 * window:
            why = f"a name takes a window of {window:g} s to be earned and another to be said"
            raise InputError(f"a fault that lasts {duration:g} s cannot be named", why=why)
        return duration
    rises = [max(sizes) / ground.channel(name).rate for name, sizes in tried.items()] if "ramp" in waveforms else []
    return max([LASTS * ground.longest, *(1.5 * rise for rise in rises)])


@dataclass(frozen=True)
class _Cell:
    """A fault of one size and waveform."""

    channel: FaultChannel
    waveform: str
    size: float
    shape: Step | Ramp


def _cells(
    ground: Ground, tried: Mapping[str, Sequence[float]], waveforms: Sequence[str], lasts: float
) -> Iterator[_Cell]:
    for name, sizes in tried.items():
        channel = ground.channel(name)
        for word in dict.fromkeys(waveforms):
            for size in sizes:
                rise = size / channel.rate if math.isfinite(channel.rate) else lasts / 2.0
                if word == "ramp" and rise > lasts:
                    raise InputError(
                        f"a ramp of {name} to {size:.4g} takes {rise:.4g} s at its declared rate",
                        why=f"the fault lasts {lasts:.4g} s",
                        remedies=(f"pass a duration of {1.5 * rise:.4g} s", "try steps only", "try smaller sizes"),
                    )
                yield _Cell(channel, word, size, Step(size) if word == "step" else Ramp(size, rise))


def _found(cell: _Cell, episodes: Sequence[Episode]) -> Found:
    delays = np.array([math.inf if one.missed else one.named for one in episodes])
    median, most = (float(np.quantile(delays, q, method="higher")) for q in (0.5, 0.9))
    return Found(
        cell.channel.name,
        cell.waveform,
        cell.size,
        cell.size / cell.channel.size,
        len(episodes),
        sum(one.missed for one in episodes),
        sum(one.missed and math.isnan(one.noticed) for one in episodes),
        sum(bool(one.instead) for one in episodes),
        median,
        most,
    )


def _percent(value: float) -> str:
    return f"{100.0 * value:.3g} %"


def _seconds(value: float) -> str:
    return "never" if math.isinf(value) else f"{value:.2f} s"
