# SPDX-License-Identifier: BSD-3-Clause
"""Which sensor is lying, on recorded flights, without being told: the shipped airliner logs through one bank.

For each sensor in turn, in calm air and in gusts, and for healthy flights: was the right one named, when, how large
was it said to be, and what was said where nothing was wrong.

By default the bank holds a hypothesis for each of the three sensors that ever fail in these logs, so it is told that it
is one of three; with `every` it holds one for each of the eleven sensors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from faultrecon.advise.demonstration import made_folder, shipped_log
from faultrecon.io.bankfile import write_bank
from faultrecon.io.library import read_library
from faultrecon.io.logs import write_log
from faultrecon.io.watched import Watched, supervised, watched
from faultrecon.runtime.supervision import whole
from faultrecon.runtime.told import Episode, alarm_rate
from faultrecon.synthesis.bank import Bank, bank

FLIGHTS = tuple(
    f"{fault}_{air}" for fault in ("healthy", "pitch_rate", "pitch_angle", "roll_rate") for air in ("calm", "gust")
)
SHOWN = "pitch_angle_gust"


@dataclass(frozen=True, slots=True)
class Flight:
    """One flight: the true fault ("" for none), what was named in the end, and when.

    left: the explanations that were left at the end, the likeliest first.  noticed, named: s from the first beginning
    of the fault to the first word about it and to its name; NaN where that never came.  size_error: as in `Episode`, of
    the largest one.  inside: part of all samples in which the true fault was within its bound.
    false_alarms: faults named that were not there, of_nothing: while none was.  hours: of flight without a fault.
    """

    flight: str
    fault: str
    named_fault: str
    left: str
    noticed: float
    named: float
    size_error: float
    inside: float
    false_alarms: int
    of_nothing: int
    hours: float


@dataclass(frozen=True)
class WhichSensor:
    """The table, with the bank that made it."""

    bank: Bank
    rows: tuple[Flight, ...]
    written: tuple[Path, ...] = ()

    @property
    def unasked(self) -> tuple[str, ...]:
        """The sensors that no hypothesis calls faulty."""
        reached = np.any(self.bank.plant.F_f != 0, axis=1)
        return tuple(name for name, faulty in zip(self.bank.plant.signals.y.names, reached, strict=True) if not faulty)

    @property
    def healthy(self) -> tuple[int, float]:
        """Faults named while there was none, and hours of flight without a fault."""
        return sum(row.of_nothing for row in self.rows), sum(row.hours for row in self.rows)

    @property
    def false_alarms_per_hour(self) -> float:
        """Faults named while there was none, per hour of flight without a fault."""
        alarms, hours = self.healthy
        return alarms / hours if hours > 0 else math.nan

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {
            "hypotheses": list(self.bank.designs),
            "taken_for_healthy": list(self.unasked),
            "flights": [asdict(row) for row in self.rows],
            "false_alarms_per_hour": self.false_alarms_per_hour,
            "written": [str(path) for path in self.written],
        }

    def __str__(self) -> str:
        lines = [f"{len(self.bank.designs)} hypotheses: {', '.join(self.bank.designs)}"]
        lines += [f"taken for healthy, as they have none: {', '.join(self.unasked)}"] if self.unasked else []
        lines += [""]
        head: tuple[str, ...] = (
            "flight",
            "true fault",
            "named",
            "noticed",
            "named after",
            "size error",
            "within bound",
            "false alarms",
        )
        table: list[tuple[str, ...]] = [head]
        for r in self.rows:
            said = r.named_fault or (f"({r.left})" if r.left else "none")
            table.append(
                (r.flight, r.fault or "none", said, _s(r.noticed), _s(r.named), _part(r.size_error), _part(r.inside))
                + (str(r.false_alarms),)
            )
        widths = [max(len(row[i]) for row in table) for i in range(len(head))]
        lines += ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
        lines += ["", alarm_rate(*self.healthy)]
        lines += [f"wrote {path}" for path in self.written]
        return "\n".join(lines)


def which_sensor(every: bool = False, progress: Callable[[float], None] | None = None, **options: Any) -> WhichSensor:
    """One bank over the shipped flights of the airliner.

    every: a hypothesis for each of the eleven sensors, not only for the three that ever fail in these logs.  options:
    those of `Bank.monitor`.
    """
    made, done = _flights(every, progress, **options)
    return WhichSensor(made, tuple(flown(one, flight) for flight, one in done.items()))


def which_sensor_demo(
    out: Path, progress: Callable[[float], None] | None = None, *, every: bool = False
) -> WhichSensor:
    """The table, and the bank and one watched flight written to a folder.  every: as in `which_sensor`."""
    out = made_folder(out)
    made, done = _flights(every, progress)
    written = out / "bank.json", out / f"{SHOWN}_watched.csv"
    write_bank(made, written[0])
    write_log(written[1], done[SHOWN].columns())
    return WhichSensor(made, tuple(flown(one, flight) for flight, one in done.items()), written)


def _flights(
    every: bool, progress: Callable[[float], None] | None, sample_time: float | None = None, **options: Any
) -> tuple[Bank, dict[str, Watched]]:
    """The bank, and what one monitor made of each flight; its bounds, for all of them, take longer than the flights."""
    plant, tell = read_library("airliner"), progress or (lambda part: None)
    made = bank(plant, sensors=None if every else [next(iter(f.on)) for f in plant.faults])
    tell(0.3)
    supervision = supervised(made, sample_time, **options)  # the logs have the interval that the plant file declares
    tell(0.8)
    done = {}
    for k, flight in enumerate(FLIGHTS):
        log = shipped_log("airliner", flight, plant)
        state, table = whole(supervision, log.t, log.u, log.y)
        done[flight] = replace(watched(supervision, log.source, state, table), log=log)
        tell(0.8 + 0.2 * (1 + k) / len(FLIGHTS))
    return made, done


def flown(done: Watched, flight: str) -> Flight:
    """What was said about a log that holds its truth: at most one fault, that of a gain in an episode a manoeuvre."""
    found = done.scores()
    assert found is not None, "the shipped logs hold the truth"
    said, last, nan = str(done.table["fault"][-1]), done.events[-1], math.nan
    rest = found.false_alarms, found.of_nothing, found.healthy_hours
    if not found.episodes:
        return Flight(flight, "", said, "", nan, nan, nan, nan, *rest)
    first, largest = found.episodes[0], max(found.episodes, key=lambda one: one.size)
    return Flight(
        flight,
        first.fault,
        said if said == first.fault else "",
        last.fault if last.mode == "suspect" else "",
        _since(first, {one.begin: one.noticed for one in found.episodes}),
        _since(first, {one.begin: one.named for one in found.episodes}),
        largest.size_error,
        found.inside[first.fault],
        *rest,
    )


def _since(first: Episode, delays: Mapping[float, float]) -> float:
    """From the beginning of the first episode to the earliest of what came so long after the beginning of each, s."""
    came = [begin + delay - first.begin for begin, delay in delays.items() if not math.isnan(delay)]
    return min(came, default=math.nan)


def _s(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f} s"


def _part(value: float) -> str:
    return "-" if math.isnan(value) else f"{100 * value:.3g} %"
