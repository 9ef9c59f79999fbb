# SPDX-License-Identifier: BSD-3-Clause
"""A log through a bank: which sensor, since when, how large, and what may be read instead."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError, did_you_mean
from faultrecon.io.chunks import Survey
from faultrecon.io.logs import Log, read_log
from faultrecon.io.plausibility import unit_doubts
from faultrecon.io.running import Chosen, Make
from faultrecon.runtime.building import monitor_of
from faultrecon.runtime.decision import Rules
from faultrecon.runtime.events import Event
from faultrecon.runtime.intake import Intake
from faultrecon.runtime.intake_counts import Counts
from faultrecon.runtime.monitor import Monitor
from faultrecon.runtime.supervision import Supervision, SupervisionState, whole
from faultrecon.runtime.told import Told, aligned, scored
from faultrecon.synthesis.bank import Bank

Array = NDArray[Any]
TRUTH = "true_f_"  # and the name of a fault: the column of a log that holds what it really was

RULES = Rules()

UNDECIDED = (
    "  nothing could be decided: at no time was enough of the start or of a gap forgotten; a longer log, fewer gaps,"
    " or declared ranges of states and inputs would help"
)


@dataclass(frozen=True, eq=False)
class Watched:
    """What a monitor made of a log.  table: the columns of the monitor, a row for each sample that was passed on.

    log: what it was made of, where that was read whole.
    """

    supervision: Supervision
    source: str
    table: Mapping[str, NDArray[Any]]
    events: tuple[Event, ...]
    counts: Counts
    log: Log | None = None

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

    def scores(self, truth: Mapping[str, Array] | None = None) -> Told | None:
        """Delays, misses, errors and false alarms against the truth; None where the log does not hold it.

        truth: the waveform of each fault, a value for each row of the log; by default its columns `true_f_<fault>`.
        Raises InputError on names of nothing that may fail and on waveforms of another length.
        """
        times = self.table["t"] if self.log is None else self.log.t
        if truth is None:
            extra = {} if self.log is None else self.log.extra
            truth = {name.removeprefix(TRUTH): values for name, values in extra.items() if name.startswith(TRUTH)}
            if not truth:
                return None
        else:
            truth = {name: np.asarray(values, dtype=float) for name, values in truth.items()}
            _check_truth(truth, self.monitor, len(times))
        known = {name: aligned(self.table["t"], times, values) for name, values in truth.items()}
        return scored(self.monitor, self.table, self.events, known)

    def doubts(self) -> tuple[str, ...]:
        """A sentence for every sign of other units in the log as it came; none where that was not kept."""
        return () if self.log is None else unit_doubts(self.monitor.plant, self.log.t, self.log.u, self.log.y)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        told = self.scores()
        return {
            "rows": len(self.table["t"]),
            "modes": self.shares(),
            "events": [event.as_dict() for event in self.events],
            "counts": self.counts.as_dict(self.supervision.intake.names),
            "untested": {name: finding.as_dict() for name, finding in self.monitor.refused.items()},
            "notes": list(self.doubts()),
            "scores": None if told is None else told.as_dict(),
        }

    def __str__(self) -> str:
        t, c = self.table["t"], self.counts
        lines = [f"{self.source}: {c.received} rows in, {len(t)} out over {t[-1] - t[0]:g} s" if len(t) else "no rows"]
        lines += [f"  {finding}" for finding in self.supervision.intake.findings(c)]
        lines += [f"  not tested: {name}; {finding}" for name, finding in self.monitor.refused.items()]
        notes = [f"  note: {doubt}" for doubt in self.doubts()]
        told = [f"  {event}" for event in self.events if event.mode != "warming"]
        found = self.scores()
        against = (
            [] if found is None else ["  against the recorded truth:", *(f"    {x}" for x in str(found).split("\n"))]
        )
        return "\n".join([*lines, *(told or [UNDECIDED] * bool(len(t))), *against, *notes])


def _check_truth(truth: Mapping[str, Array], monitor: Monitor, rows: int) -> None:
    y, u = monitor.plant.signals.y.names, monitor.plant.signals.u.names
    may_fail = dict.fromkeys([*(f for h in monitor.hypotheses for f in h.faults), *monitor.refused, *y, *u])
    for name, values in truth.items():
        if name not in may_fail:
            raise InputError(f"there is no fault '{name}'", why=did_you_mean(name, may_fail))
        if values.shape != (rows,):
            raise InputError(
                f"the truth of {name} has the shape {values.shape}", why=f"the log has {rows} rows, one value for each"
            )


def watch(
    bank: Bank,
    log: Log | str | os.PathLike[str],
    *,
    sample_time: float | None = None,
    mapping: Mapping[str, str] | None = None,
    reorder: float = 0.0,
    leap: float = math.inf,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> Watched:
    """Run a bank over a log without being told what is wrong.

    log: a path to .csv or .parquet, or a Log.  sample_time in s: the median interval of the log by default.  reorder:
    s that rows wait for late ones.  leap: s by which one time may be ahead of the newest; a second one in a row that
    agrees is believed.  options: those of `Bank.monitor`, and patience, see `Rules`.
    Raises InputError on a bad log, Impossible when no hypothesis can be tested.
    """
    tell = progress or (lambda part: None)
    if not isinstance(log, Log):
        log = read_log(log, bank.plant.signals, mapping=mapping, as_it_came=True)
    step = median_interval(log) if sample_time is None else sample_time
    supervision = supervised(bank, step, reorder=reorder, leap=leap, **options)
    tell(0.5)
    supervision.monitor.expect(len(log.t))
    state, table = whole(supervision, log.t, log.u, log.y)
    tell(1.0)
    return replace(watched(supervision, log.source, state, table), log=log)


def supervised(
    bank: Bank,
    sample_time: float | None,
    *,
    reorder: float = 0.0,
    leap: float = math.inf,
    patience: int = RULES.patience,
    **options: Any,
) -> Supervision:
    """The monitor of a bank behind an intake.

    patience: windows without an explanation before that is said.  Raises InputError on an option that makes no sense.
    """
    if sample_time is not None and not 0 < sample_time < math.inf:
        raise InputError(f"the sample time is {sample_time:g}", why="it is a positive number of seconds")
    if patience < 1:
        raise InputError(f"the patience is {patience} windows", why="it takes one or more")
    monitor = monitor_of(bank, sample_time=sample_time, **options)
    monitor = replace(monitor, rules=replace(monitor.rules, patience=patience))
    return Supervision(Intake.of(bank.plant, monitor.sample_time, reorder=reorder, leap=leap), monitor)


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
    with np.errstate(over="ignore"):  # two finite times may be infinitely far apart
        found = float(np.median(np.diff(times)))
    if not 0 < found < math.inf:
        raise InputError(f"{log.source}: its rows have no common interval", remedies=("pass sample_time=...",))
    return found


def monitoring(bank: Bank, *, sample_time: float | None = None, **options: Any) -> Make:
    """How to make the monitor of a bank, once a recording was surveyed: for logs of any length, and for streams.

    sample_time in s: the median interval of the recording by default.  options: those of `supervised`.
    """

    def make(found: Survey, chosen: Chosen | None) -> tuple[Supervision, Chosen]:
        step = found.interval if sample_time is None else sample_time
        supervision = supervised(bank, step, **options)
        supervision.monitor.expect(found.rows)
        if not found.rows:  # a stream does not wait
            supervision.monitor.ready()
        return supervision, {} if chosen is None else chosen

    return make
