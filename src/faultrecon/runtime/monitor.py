# SPDX-License-Identifier: BSD-3-Clause
"""Which sensor is lying, how sure are we, and what should the controller read instead?

A monitor runs one estimator per hypothesis over the same samples, tests each against its bounds, decides, and hands on
measurements with a quality.  All that it remembers is in a value: cut the samples anywhere, the rows stay the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Finding, InputError
from faultrecon.plant.plant import Plant
from faultrecon.runtime.correction import QUALITIES, Correction
from faultrecon.runtime.decision import (
    MODES,
    NOBODY,
    STALE,
    UNOBSERVED,
    Change,
    Counts,
    Decider,
    Rules,
    Standing,
)
from faultrecon.runtime.events import Event, Evidence, Open, closed, opened
from faultrecon.runtime.isolation import Isolation
from faultrecon.runtime.monitorstate import KEPT, MonitorState
from faultrecon.runtime.processing import Columns
from faultrecon.runtime.samples import Trace, checked_log
from faultrecon.runtime.watch import Batch, Findings, Watch
from faultrecon.runtime.words import Words
from faultrecon.storage.hashing import canonical_digest

Array = NDArray[Any]

BLOCK = 4096  # samples that are looked at together: more would not fit the processor's cache, fewer cost more calls


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What may be wrong: its name, the names of its faults, and the watch over the estimator that assumes it.

    reached: the sensors its faults reach, by number.
    """

    name: str
    faults: tuple[str, ...]
    watch: Watch
    reached: tuple[int, ...]

    @staticmethod
    def of(name: str, watch: Watch) -> Hypothesis:
        """The hypothesis that the faults of the watch's plant, and no others, act."""
        reached = np.flatnonzero(np.any(watch.plant.F_f != 0, axis=1))
        return Hypothesis(name, tuple(f.name for f in watch.plant.faults), watch, tuple(reached.tolist()))


@dataclass(frozen=True, eq=False)
class _Looked:
    """What all hypotheses say about some samples; misfit, own, nis, faded (N, hypotheses), failed (N, 1)."""

    traces: list[Trace]
    live: tuple[Array, ...]
    failed: Array
    misfit: Array
    own: Array
    nis: Array
    faded: Array
    bounds: list[Array]


@dataclass(frozen=True, eq=False)
class _Recent:
    """Misfits, sizes of the own faults and NIS: what was kept of the samples before, and those at hand after them."""

    before: Array
    looked: _Looked

    def window(self, row: int, rows: int) -> Array:
        """So many rows from one on, (rows, hypotheses, 3), row 0 being the oldest that was kept."""
        kept, here = self.before[row : row + rows], slice(max(row - len(self.before), 0), row + rows - len(self.before))
        now = (table[here] for table in (self.looked.misfit, self.looked.own, self.looked.nis))
        return np.concatenate([kept, np.stack(list(now), axis=2)]) if here.stop > 0 else kept


@dataclass(frozen=True, eq=False)
class Monitor:
    """Hypotheses about one plant, all sampled alike.  stale: s without a sample after which the mode says so."""

    plant: Plant
    hypotheses: tuple[Hypothesis, ...]
    isolation: Isolation
    rules: Rules = field(default_factory=Rules)
    correction: Correction = field(default_factory=Correction)
    stale: float = 1.0
    origin: str = ""  # content hash of the designs
    refused: Mapping[str, Finding] = field(default_factory=dict)  # hypotheses that cannot be tested, and why

    def __post_init__(self) -> None:
        times = {h.watch.estimator.sample_time for h in self.hypotheses}
        if len(times) != 1:
            raise InputError("the hypotheses of a monitor have no common sample time", evidence={"times": len(times)})

    # ------------------------------------------------------------ what comes out

    @property
    def sample_time(self) -> float:
        """Seconds between samples."""
        return self.hypotheses[0].watch.estimator.sample_time

    @cached_property
    def singles(self) -> dict[str, int]:
        """The faults that have a hypothesis of their own, and its number."""
        return {h.faults[0]: i for i, h in enumerate(self.hypotheses) if len(h.faults) == 1}

    @property
    def columns(self) -> tuple[str, ...]:
        """t, mode, fault, f_<fault> and its bound for each single fault, <sensor>_corrected and _quality."""
        faults = [text for name in self.singles for text in (f"f_{name}", f"f_{name}_bound")]
        sensors = [text for name in self.plant.signals.y for text in (f"{name}_corrected", f"{name}_quality")]
        return ("t", "mode", "fault", *faults, *sensors)

    @cached_property
    def identity(self) -> str:
        """A content hash of all that decides what comes out."""
        parts = [self.origin, repr(self.rules), repr(self.correction), repr(self.stale), repr(self.sample_time)]
        for h in self.hypotheses:
            allowed = h.watch.bounds.allowance, h.watch.poles, h.watch.estimator.hold, h.watch.estimator.scheme
            parts += [h.name, repr(allowed)]
        return canonical_digest({"monitor": parts})

    # ------------------------------------------------------------ the work

    def expect(self, rows: int) -> None:
        """Have the estimators' kernels ready if that pays for so many rows, which may come in pieces."""
        for h in self.hypotheses:
            h.watch.estimator.expect(rows)

    def ready(self) -> None:
        """Find out now what gaps and silence do, for who cannot wait a second at the first of them."""
        for h in self.hypotheses:
            h.watch.ready()

    def start(self) -> MonitorState:
        """Before the first sample."""
        hypotheses = self.hypotheses
        estimators = tuple(h.watch.estimator.init() for h in hypotheses)
        return MonitorState.begin(self.rules, self.plant.p, estimators, tuple(h.watch.init() for h in hypotheses))

    def take(
        self, state: MonitorState, t: Array, u: Array, y: Array, doubt: NDArray[np.bool_] | None = None
    ) -> tuple[MonitorState, Columns]:
        """Samples t (N,), u (N, m), y (N, p), absolute, time increasing; one row out for each.

        doubt (N, p): readings that something else than a test speaks against, such as that they stand still.
        Columns of words are `Words`: arrays of text to whoever reads them, numbers until then.
        Raises InputError on shapes and times that do not fit; the state before is then as good as ever.
        """
        t, u, y = checked_log(t, u, y, self.plant.B.shape[1], self.plant.p)
        if state.samples and len(t) and not t[0] > state.t:
            raise InputError(f"the sample at {t[0]:g} s follows the one at {state.t:g} s", why="time must increase")
        rows = self._room(len(t))
        for k in range(0, max(len(t), 1), BLOCK):
            here = slice(k, k + BLOCK)
            into = {name: _numbers(column)[here] for name, column in rows.items()}
            doubted = None if doubt is None else doubt[here]
            state = self._block(state, t[here], u[here], y[here], doubted, into)
        return state, rows

    def _block(
        self,
        state: MonitorState,
        t: Array,
        u: Array,
        y: Array,
        doubt: NDArray[np.bool_] | None,
        into: Mapping[str, NDArray[Any]],
    ) -> MonitorState:
        """The same for a number of samples that fits the processor's cache; the rows are written into `into`."""
        before = state.t if state.samples else np.array([*t[:1], 0.0])[0] - self.sample_time
        with np.errstate(over="ignore"):  # two finite times may be infinitely far apart
            waits = np.diff(t, prepend=before)
            looked = self._look(state, t, u, y, waits / self.sample_time)
        now = Counts(looked.failed, looked.misfit > 1.0, looked.faded > 0.0, self._heard(y))
        counts, standing, changes, ready = self._decider.take(state.counts, state.standing, now)
        doubt = self._untested(ready, doubt)
        mode, named = _spread(state.standing, changes, len(t))
        reach = _reach(state.standing, changes, self.hypotheses)
        held, corrected, quality = self.correction.apply(state.held, t, y, mode, named, reach, looked.traces, doubt)
        recent = _Recent(state.recent, looked)
        over, now_open = self._events(state, t, changes, recent, looked.traces)
        shown = mode.copy()
        shown[waits > self.stale] = STALE
        shown[~np.isfinite(y).any(axis=1)] = UNOBSERVED
        after = MonitorState(
            float(t[-1]) if len(t) else state.t,
            state.samples + len(t),
            tuple(trace.end for trace in looked.traces),
            looked.live,
            recent.window(len(t), self.rules.window - 1),
            counts,
            standing,
            held,
            now_open,
            (*state.events, *over)[-KEPT:],
            state.over + len(over),
        )
        self._write(into, t, shown, named, looked, corrected, quality)
        return after

    def finish(self, state: MonitorState) -> Columns:
        """No row waits."""
        return self._room(0)

    def events(self, state: MonitorState) -> tuple[Event, ...]:
        """What has happened, what is still going on included; of what is over, the last `KEPT`."""
        return state.events if state.open is None else (*state.events, closed(state.open, None))

    @cached_property
    def _decider(self) -> Decider:
        return Decider(self.rules, tuple(len(h.faults) for h in self.hypotheses))

    def _look(self, state: MonitorState, t: Array, u: Array, y: Array, waits: Array) -> _Looked:
        """Every hypothesis over the samples: estimates, tests, and what is left of each explanation.

        waits (N,): sample times since the one before.
        """
        batch = Batch.of(u, y, waits)
        found, parts = Findings.room(len(t), [h.watch for h in self.hypotheses])
        traces, live = [], []
        for h, before, alive, part in zip(self.hypotheses, state.estimators, state.live, parts, strict=True):
            estimator = h.watch.estimator
            if before.samples == 0 and len(t):
                guess = h.watch.bounds.beginning.guess(u[0], y[0])
                alive = h.watch.init(blind=guess is None)
                before = estimator.init(x=guess)
            trace = estimator.go_on(before, t, u, y, lambda _: None)
            live.append(h.watch.look(alive, batch, trace, part))
            traces.append(trace)
        misfit, failed = self.isolation.ask(found, state.estimators[0].samples)
        bounds = [part.bound for part in parts]
        return _Looked(traces, tuple(live), failed, misfit, found.own, found.nis, found.faded, bounds)

    def _untested(self, ready: NDArray[np.bool_], doubt: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
        """Readings that are doubted, with those of sensors whose own hypothesis is not tested: who would tell?"""
        if ready.all():
            return doubt
        found = np.zeros((len(ready), self.plant.p), dtype=bool) if doubt is None else doubt.copy()
        for i in self.singles.values():
            for sensor in self.hypotheses[i].reached:
                found[:, sensor] |= ~ready[:, i]
        return found

    def _heard(self, y: Array) -> NDArray[np.bool_]:
        """Where the sensors that each hypothesis calls faulty say something, (N, hypotheses)."""
        there = np.isfinite(y)
        heard = np.ones((len(y), len(self.hypotheses)), dtype=bool)
        if not there.all():
            for i, h in enumerate(self.hypotheses):
                heard[:, i] = there[:, list(h.reached)].all(axis=1)
        return heard

    def _events(
        self,
        state: MonitorState,
        t: Array,
        changes: Sequence[Change],
        recent: _Recent,
        traces: Sequence[Trace],
    ) -> tuple[list[Event], Open | None]:
        """Events that end within these samples, and the one that is going on after them."""
        done, going = [], state.open
        row = 0
        for change in [*changes, None]:
            stop = len(t) if change is None else change.row
            if going is not None:
                going = going.seen(traces, row, stop)
            row = stop
            if change is None:
                break
            if going is not None and not going.goes_on(change.after):
                done.append(closed(going, float(t[change.row])))
                going = None
            frame = self._evidence(recent, change.row)
            if going is None:
                going = opened(change.after, float(t[change.row]), frame, self._faults_of(change.after))
            else:
                going = going.narrowed(change.after, frame)
        return done, going

    def _faults_of(self, now: Standing) -> tuple[str, ...]:
        return () if now.named == NOBODY else self.hypotheses[now.named].faults

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(h.name for h in self.hypotheses)

    def _evidence(self, recent: _Recent, row: int) -> tuple[Evidence, ...]:
        """The last window up to a row, by hypothesis."""
        window = recent.window(row, self.rules.window)
        return tuple(
            Evidence(
                name,
                int(np.sum(window[:, i, 0] > 1)),
                float(window[:, i, 0].max()),
                float(window[:, i, 1].max()),
                float(window[:, i, 2].mean()),
            )
            for i, name in enumerate(self._names)
        )

    def _room(self, rows: int) -> Columns:
        """Columns for so many rows, not yet written; those of words are `Words`, of which none named is the last."""
        words = {"mode": MODES, "fault": (*self._names, "")}
        words |= {f"{name}_quality": QUALITIES for name in self.plant.signals.y.names}
        return {name: Words.room(rows, words[name]) if name in words else np.empty(rows) for name in self.columns}

    def _write(
        self,
        into: Mapping[str, NDArray[Any]],
        t: Array,
        mode: Array,
        named: Array,
        looked: _Looked,
        corrected: Array,
        quality: Array,
    ) -> None:
        into["t"][:] = t
        into["mode"][:] = mode
        into["fault"][:] = np.where(named == NOBODY, len(self.hypotheses), named)
        for name, i in self.singles.items():
            into[f"f_{name}"][:] = looked.traces[i].fault[:, 0]
            into[f"f_{name}_bound"][:] = looked.bounds[i][:, 0]
        for i, name in enumerate(self.plant.signals.y.names):
            into[f"{name}_corrected"][:] = corrected[:, i]
            into[f"{name}_quality"][:] = quality[:, i]

    # ------------------------------------------------------------ to keep and to go on

    def pack(self, state: MonitorState) -> dict[str, Any]:
        """The state as plain values and arrays, for a checkpoint."""
        return state.pack()

    def unpack(self, packed: Mapping[str, Any]) -> MonitorState:
        """The state that was packed, every bit of it.  Raises InputError on one of another monitor."""
        return MonitorState.unpack(packed, [h.watch.estimator._layout for h in self.hypotheses])


def _numbers(column: NDArray[Any] | Words) -> NDArray[Any]:
    """What is written of a column."""
    return column.codes if isinstance(column, Words) else column


def _spread(before: Standing, changes: Sequence[Change], rows: int) -> tuple[Array, Array]:
    """Mode and named hypothesis, row by row."""
    mode, named = np.full(rows, before.mode), np.full(rows, before.named)
    for change in changes:
        mode[change.row :] = change.after.mode
        named[change.row :] = change.after.named
    return mode, named


def _reach(
    before: Standing, changes: Sequence[Change], hypotheses: Sequence[Hypothesis]
) -> list[tuple[int, tuple[int, ...], tuple[int, ...]]]:
    """From which row on which sensors are at fault, and which are under suspicion."""

    def sensors(now: Standing) -> tuple[tuple[int, ...], tuple[int, ...]]:
        faulty = () if now.named == NOBODY else hypotheses[now.named].reached
        doubted = {i for c in now.candidates for i in hypotheses[c].reached} - set(faulty)
        return faulty, tuple(sorted(doubted))

    return [(0, *sensors(before)), *((c.row, *sensors(c.after)) for c in changes)]
