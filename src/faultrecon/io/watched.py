# SPDX-License-Identifier: BSD-3-Clause
"""A log through a bank: which sensor, since when, how large, and what may be read instead."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.io.chunks import Survey
from faultrecon.io.logs import Log, read_log
from faultrecon.io.running import Chosen, Make
from faultrecon.runtime.building import monitor_of
from faultrecon.runtime.events import Event
from faultrecon.runtime.intake import Intake
from faultrecon.runtime.intake_counts import Counts
from faultrecon.runtime.monitor import Monitor
from faultrecon.runtime.supervision import Supervision, SupervisionState, whole
from faultrecon.synthesis.bank import Bank

Array = NDArray[Any]

UNDECIDED = (
    "  nothing could be decided: at no time was enough of the start or of a gap forgotten; a longer log, fewer gaps,"
    " or declared ranges of states and inputs would help"
)


@dataclass(frozen=True, eq=False)
class Watched:
    """What a monitor made of a log.  table: the columns of the monitor, a row for each sample that was passed on."""

    supervision: Supervision
    source: str
    table: Mapping[str, NDArray[Any]]
    events: tuple[Event, ...]
    counts: Counts

    @property
    def monitor(self) -> Monitor:
        """What decided."""
        return self.supervision.monitor

    def columns(self) -> dict[str, NDArray[Any]]:
        """The table, as `write_log` takes it."""
        return dict(self.table)

    def shares(self) -> dict[str, float]:
        """Which part of the rows each mode has."""
        modes, counts = np.unique(self.table["mode"], return_counts=True)
        return {str(mode): float(count) / len(self.table["mode"]) for mode, count in zip(modes, counts, strict=True)}

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {
            "rows": len(self.table["t"]),
            "modes": self.shares(),
            "events": [event.as_dict() for event in self.events],
            "counts": self.counts.as_dict(self.supervision.intake.names),
            "untested": {name: finding.as_dict() for name, finding in self.monitor.refused.items()},
        }

    def __str__(self) -> str:
        t, c = self.table["t"], self.counts
        lines = [f"{self.source}: {c.received} rows in, {len(t)} out over {t[-1] - t[0]:g} s" if len(t) else "no rows"]
        lines += [f"  {finding}" for finding in self.supervision.intake.findings(c)]
        lines += [f"  not tested: {name}; {finding}" for name, finding in self.monitor.refused.items()]
        told = [f"  {event}" for event in self.events if event.mode != "warming"]
        return "\n".join([*lines, *(told or [UNDECIDED] * bool(len(t)))])


def watch(
    bank: Bank,
    log: Log | str | os.PathLike[str],
    *,
    sample_time: float | None = None,
    mapping: Mapping[str, str] | None = None,
    reorder: float = 0.0,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> Watched:
    """Run a bank over a log without being told what is wrong.

    log: a path to .csv or .parquet, or a Log.  sample_time in s: the median interval of the log by default.  reorder:
    s that rows wait for late ones.  options: those of `Bank.monitor`.
    Raises InputError on a bad log, Impossible when no hypothesis can be tested.
    """
    tell = progress or (lambda part: None)
    if not isinstance(log, Log):
        log = read_log(log, bank.plant.signals, mapping=mapping, as_it_came=True)
    supervision = supervised(bank, sample_time or median_interval(log), reorder=reorder, **options)
    tell(0.5)
    state, table = whole(supervision, log.t, log.u, log.y)
    tell(1.0)
    return watched(supervision, log.source, state, table)


def supervised(bank: Bank, sample_time: float | None, *, reorder: float = 0.0, **options: Any) -> Supervision:
    """The monitor of a bank behind an intake."""
    monitor = monitor_of(bank, sample_time=sample_time, **options)
    return Supervision(Intake.of(bank.plant, monitor.sample_time, reorder=reorder), monitor)


def watched(
    supervision: Supervision, source: str, state: SupervisionState, table: Mapping[str, NDArray[Any]]
) -> Watched:
    """The result of a run that ended in `state`."""
    return Watched(supervision, source, table, supervision.monitor.events(state.monitor), state.counts)


def median_interval(log: Log) -> float | None:
    """The median interval of a log read as it came, s; None where it has none."""
    times = np.unique(log.t[np.isfinite(log.t)])
    if len(times) < 2:
        return None
    found = float(np.median(np.diff(times)))
    if not found > 0:
        raise InputError(f"{log.source}: its rows have no common interval", remedies=("pass sample_time=...",))
    return found


def monitoring(bank: Bank, *, sample_time: float | None = None, reorder: float = 0.0, **options: Any) -> Make:
    """How to make the monitor of a bank, once a recording was surveyed: for logs of any length, and for streams.

    sample_time in s: the median interval of the recording by default.  options: those of `Bank.monitor`.
    """

    def make(found: Survey, chosen: Chosen | None) -> tuple[Supervision, Chosen]:
        step = found.interval if sample_time is None else sample_time
        return supervised(bank, step, reorder=reorder, **options), {} if chosen is None else chosen

    return make
