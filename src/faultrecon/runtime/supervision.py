# SPDX-License-Identifier: BSD-3-Clause
"""Raw samples in, decisions out: an intake in front of a monitor, as one processor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.runtime.general import FARTHEST
from faultrecon.runtime.intake import Intake, IntakeState, Taken
from faultrecon.runtime.intake_counts import Counts, Flag
from faultrecon.runtime.intake_order import Fate
from faultrecon.runtime.monitor import Monitor, MonitorState
from faultrecon.runtime.processing import Answers, Columns
from faultrecon.runtime.words import Words, spelled
from faultrecon.storage.hashing import canonical_digest

Array = NDArray[Any]

ASIDE = {
    Fate.MERGED: "merged: its values are in the row of the sample of the same time that came first",
    Fate.DUPLICATE: "duplicate: it brings nothing new to its time",
    Fate.LATE: "late: this time or a later one has been passed on; a larger reorder lets samples wait",
    Fate.BAD_TIME: "no time: it is absent, infinite or far ahead of all others",
}
"""Why a sample has no row of its own."""


@dataclass(frozen=True, eq=False)
class SupervisionState:
    """Between two pieces of samples."""

    intake: IntakeState
    monitor: MonitorState

    @property
    def counts(self) -> Counts:
        """What became of the rows so far."""
        return self.intake.counts


@dataclass(frozen=True, eq=False)
class Supervision:
    """An intake and a monitor of the same plant: samples as they come, one row out for each that is passed on."""

    intake: Intake
    monitor: Monitor

    @property
    def columns(self) -> tuple[str, ...]:
        """Those of the monitor."""
        return self.monitor.columns

    @property
    def identity(self) -> str:
        """A content hash of all that decides what comes out."""
        return canonical_digest({"monitor": self.monitor.identity, "intake": repr(self.intake)})

    def start(self) -> SupervisionState:
        """Before the first sample."""
        return SupervisionState(self.intake.init(), self.monitor.start())

    def take(self, state: SupervisionState, t: Array, u: Array, y: Array) -> tuple[SupervisionState, Columns]:
        """Rows in the order in which they arrived; those that wait come out later."""
        after, taken = self.intake.take(state.intake, t, u, y)
        return self._on(state, after, taken)

    def finish(self, state: SupervisionState) -> Columns:
        """The rows that were waiting for later ones."""
        return self.end(state)[1]

    def end(self, state: SupervisionState) -> tuple[SupervisionState, Columns]:
        """The same, with the state after them."""
        after, taken = self.intake.flush(state.intake)
        return self._on(state, after, taken)

    def answer(self, state: SupervisionState, t: Array, u: Array, y: Array) -> tuple[SupervisionState, Answers]:
        """The same as `take`, with what became of each sample."""
        after, taken = self.intake.take(state.intake, t, u, y)
        first = state.counts.received
        aside = {first + int(k): ASIDE[Fate(taken.fates[k])] for k in np.flatnonzero(taken.fates)}
        there, rows = self._on(state, after, taken)
        return there, Answers(rows, taken.arrival, first, aside)

    def rest(self, state: SupervisionState) -> tuple[SupervisionState, Answers]:
        """The same as `end`, with the samples that the rows are of."""
        after, taken = self.intake.flush(state.intake)
        there, rows = self._on(state, after, taken)
        return there, Answers(rows, taken.arrival, state.counts.received)

    def _on(self, state: SupervisionState, after: IntakeState, taken: Taken) -> tuple[SupervisionState, Columns]:
        """The monitor over what the intake passes on; after an interval longer than estimators cross they begin anew.

        What was decided stays, and of the row after it the monitor knows that rows are missing.
        """
        monitor, parts, frozen = state.monitor, [], taken.flags_y == Flag.FROZEN
        with np.errstate(over="ignore"):  # two finite times may be infinitely far apart
            waits = np.diff(taken.t, prepend=monitor.t)  # not a number before the first of all
        far = np.flatnonzero(waits > FARTHEST * self.monitor.sample_time).tolist()
        for a, b in pairwise(sorted({0, *far, len(waits)}) if len(waits) else (0, 0)):
            monitor = self._anew(monitor) if a in far else monitor
            monitor, rows = self.monitor.take(monitor, taken.t[a:b], taken.u[a:b], taken.y[a:b], frozen[a:b])
            parts.append(rows)
        return SupervisionState(after, monitor), parts[0] if len(parts) == 1 else _joined(parts)

    def _anew(self, state: MonitorState) -> MonitorState:
        watches = [h.watch for h in self.monitor.hypotheses]
        return replace(
            state, estimators=tuple(w.estimator.init() for w in watches), live=tuple(w.init() for w in watches)
        )

    def pack(self, state: SupervisionState) -> dict[str, Any]:
        """The state as plain values and arrays, for a checkpoint."""
        return {"intake": state.intake.pack(), "monitor": self.monitor.pack(state.monitor)}

    def unpack(self, packed: Mapping[str, Any]) -> SupervisionState:
        """The state that was packed, every bit of it.  Raises InputError on one of another shape."""
        try:
            return SupervisionState(IntakeState.unpack(packed["intake"]), self.monitor.unpack(packed["monitor"]))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError("the stored state is none of a monitor", why=str(error)) from error


def whole(supervision: Supervision, t: Array, u: Array, y: Array) -> tuple[SupervisionState, dict[str, NDArray[Any]]]:
    """A whole log at once, words as text."""
    state, rows = supervision.take(supervision.start(), t, u, y)
    state, rest = supervision.end(state)
    return state, spelled(_joined([rows, rest]))


def _joined(pieces: Sequence[Columns]) -> Columns:
    return {name: _one_after_the_other([piece[name] for piece in pieces]) for name in pieces[0]}


def _one_after_the_other(parts: Sequence[NDArray[Any] | Words]) -> NDArray[Any] | Words:
    words = [part for part in parts if isinstance(part, Words)]
    return Words.joined(words) if words else np.concatenate([np.asarray(part) for part in parts])
