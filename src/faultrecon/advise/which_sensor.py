# SPDX-License-Identifier: BSD-3-Clause
"""Which sensor is lying, on recorded flights, without being told: the shipped airliner logs through one bank.

For each sensor in turn, in calm air and in gusts, and for healthy flights: was the right one named, when, how large
was it said to be, and what was said where nothing was wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.advise.demonstration import made_folder, shipped_log
from faultrecon.io.bankfile import write_bank
from faultrecon.io.library import read_library
from faultrecon.io.logs import write_log
from faultrecon.io.watched import Watched, watch
from faultrecon.synthesis.bank import Bank, bank

FLIGHTS = tuple(
    f"{fault}_{air}" for fault in ("healthy", "pitch_rate", "pitch_angle", "roll_rate") for air in ("calm", "gust")
)
SHOWN = "pitch_angle_gust"
ACTS = 0.05  # of its largest size: from where on a true fault counts as there


@dataclass(frozen=True, slots=True)
class Told:
    """One flight: the true fault ("" for none), what was named in the end, and when.

    noticed, named: s from the beginning of the fault to the first word about it and to its name; NaN where that never
    happened.  left: the explanations that were left at the end, the likeliest first.  size_error: RMS of f̂ - f from the
    naming on, relative to the largest true size.  inside: part of the samples of the fault within their bounds.
    false_alarms: faults named that were not there.  hours: of flight without a fault.
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
    hours: float


@dataclass(frozen=True)
class WhichSensor:
    """The table, with the bank that made it."""

    bank: Bank
    rows: tuple[Told, ...]
    written: tuple[Path, ...] = ()

    @property
    def false_alarms_per_hour(self) -> float:
        """Faults named that were not there, per hour of flight without a fault."""
        hours = sum(row.hours for row in self.rows)
        return sum(row.false_alarms for row in self.rows) / hours if hours > 0 else math.nan

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {
            "hypotheses": list(self.bank.designs),
            "flights": [asdict(row) for row in self.rows],
            "false_alarms_per_hour": self.false_alarms_per_hour,
            "written": [str(path) for path in self.written],
        }

    def __str__(self) -> str:
        lines = [f"{len(self.bank.designs)} hypotheses: {', '.join(self.bank.designs)}", ""]
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
        hours = sum(r.hours for r in self.rows)
        lines += ["", f"{hours * 60:.1f} minutes without a fault, {self.false_alarms_per_hour:g} false alarms per hour"]
        lines += [f"wrote {path}" for path in self.written]
        return "\n".join(lines)


def which_sensor(every: bool = False, progress: Callable[[float], None] | None = None, **options: Any) -> WhichSensor:
    """One bank over the shipped flights of the airliner.

    every: a hypothesis for each of the eleven sensors, not only for the three that ever fail in these logs.  options:
    those of `Bank.monitor`.
    """
    plant, tell = read_library("airliner"), progress or (lambda part: None)
    sensors = None if every else [next(iter(f.on)) for f in plant.faults]
    made = bank(plant, sensors=sensors)
    rows = []
    for k, flight in enumerate(FLIGHTS):
        tell((1 + k) / (1 + len(FLIGHTS)))
        log = shipped_log("airliner", flight, plant)
        rows.append(
            told(watch(made, log, **options), flight, {f.name: log.extra[f"true_f_{f.name}"] for f in plant.faults})
        )
    return WhichSensor(made, tuple(rows))


def which_sensor_demo(out: Path, progress: Callable[[float], None] | None = None) -> WhichSensor:
    """The table, and the bank and one watched flight written to a folder."""
    out = made_folder(out)
    found = which_sensor(progress=progress)
    shown = watch(found.bank, shipped_log("airliner", SHOWN, found.bank.plant))
    written = out / "bank.json", out / f"{SHOWN}_watched.csv"
    write_bank(found.bank, written[0])
    write_log(written[1], shown.columns())
    return replace(found, written=written)


def told(done: Watched, flight: str, truth: dict[str, NDArray[Any]]) -> Told:
    """What was said about a log with at most one true fault, against the truth."""
    t, said, mode = done.table["t"], done.table["fault"], done.table["mode"]
    fault = max(truth, key=lambda name: float(np.abs(truth[name]).max()))
    true = truth[fault]
    if not true.any():
        return _nothing_wrong(done, flight, said)
    acts = np.abs(true) >= ACTS * np.abs(true).max()
    begin = int(np.argmax(acts))
    aware = np.flatnonzero((t >= t[begin]) & np.isin(mode, ("suspect", "fault", "out_of_envelope")))
    right = np.flatnonzero((t >= t[begin]) & (said == fault))
    wrong = [e for e in done.events if e.mode == "fault" and e.fault != fault]
    last = done.events[-1]
    error, bound = done.table[f"f_{fault}"] - true, done.table[f"f_{fault}_bound"]
    size = math.nan
    if right.size:
        size = float(np.sqrt(np.mean(np.square(error[right]))) / np.abs(true).max())
    return Told(
        flight,
        fault,
        str(said[right[-1]]) if right.size and said[-1] == fault else "",
        last.fault if last.mode == "suspect" else "",
        float(t[aware[0]] - t[begin]) if aware.size else math.nan,
        float(t[right[0]] - t[begin]) if right.size else math.nan,
        size,
        float(np.mean(np.abs(error) <= bound)),
        len(wrong),
        float(t[begin] - t[0]) / 3600.0,
    )


def _nothing_wrong(done: Watched, flight: str, said: NDArray[Any]) -> Told:
    t = done.table["t"]
    alarms = sum(event.mode == "fault" for event in done.events)
    nan = math.nan
    return Told(flight, "", str(said[-1]), "", nan, nan, nan, nan, alarms, float(t[-1] - t[0]) / 3600.0)


def _s(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f} s"


def _part(value: float) -> str:
    return "-" if math.isnan(value) else f"{100 * value:.3g} %"
