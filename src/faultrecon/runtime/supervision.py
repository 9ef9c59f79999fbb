# SPDX-License-Identifier: BSD-3-Clause
"""Raw samples in, decisions out: an intake in front of a monitor, as one processor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.runtime.intake import Intake, IntakeState, Taken
from faultrecon.runtime.intake_counts import Counts, Flag
from faultrecon.runtime.intake_order import Fate
from faultrecon.runtime.monitor import Monitor, MonitorState
from faultrecon.runtime.processing import Answers, Columns
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

    def take(
        self, state: SupervisionState, t: Array, u: Array, y: Array
    ) -> tuple[SupervisionState, dict[str, NDArray[Any]]]:
        """Rows in the order in which they arrived; those that wait come out later."""
        after, taken = self.intake.take(state.intake, t, u, y)
        return self._on(state, after, taken)

    def finish(self, state: SupervisionState) -> dict[str, NDArray[Any]]:
        """The rows that were waiting for later ones."""
        return self.end(state)[1]

    def end(self, state: SupervisionState) -> tuple[SupervisionState, dict[str, NDArray[Any]]]:
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
        """The same as `end`, with the samples that the rows are of; one that the monitor refuses is set aside."""
        after, taken = self.intake.flush(state.intake)
        first = state.counts.received
        try:
            there, rows = self._on(state, after, taken)
            return there, Answers(rows, taken.arrival, first)
        except InputError:  # one too far ahead of all others, say, which is no fault of theirs
            there, pieces, of, aside = state, [self.monitor.finish(state.monitor)], [], {}
        for k, arrival in enumerate(taken.arrival.tolist()):
            try:
                there, row = self._on(there, after, taken, slice(k, k + 1))
            except InputError as refused:
                aside[arrival] = f"refused: {refused}"
                continue
            pieces.append(row)
            of.append(arrival)
        there = SupervisionState(after, there.monitor)
        return there, Answers(_joined(pieces), np.array(of, dtype=np.int64), first, aside)

    def _on(
        self, state: SupervisionState, after: IntakeState, taken: Taken, part: slice = slice(None)
    ) -> tuple[SupervisionState, Columns]:
        """The monitor over what the intake passes on, or a part of it."""
        frozen = taken.flags_y[part] == Flag.FROZEN
        monitor, rows = self.monitor.take(state.monitor, taken.t[part], taken.u[part], taken.y[part], frozen)
        return SupervisionState(after, monitor), rows

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
    """A whole log at once."""
    state, rows = supervision.take(supervision.start(), t, u, y)
    state, rest = supervision.end(state)
    return state, _joined([rows, rest])


def _joined(pieces: Sequence[Columns]) -> Columns:
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
