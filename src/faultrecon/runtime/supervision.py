# SPDX-License-Identifier: BSD-3-Clause
"""Raw samples in, decisions out: an intake in front of a monitor, as one processor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.runtime.intake import Intake, IntakeState, Taken
from faultrecon.runtime.intake_counts import Counts
from faultrecon.runtime.monitor import Monitor, MonitorState
from faultrecon.storage.hashing import canonical_digest

Array = NDArray[Any]


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
        before, taken = self.intake.take(state.intake, t, u, y)
        return self._on(SupervisionState(before, state.monitor), taken)

    def finish(self, state: SupervisionState) -> dict[str, NDArray[Any]]:
        """The rows that were waiting for later ones."""
        return self.end(state)[1]

    def end(self, state: SupervisionState) -> tuple[SupervisionState, dict[str, NDArray[Any]]]:
        """The same, with the state after them."""
        after, taken = self.intake.flush(state.intake)
        return self._on(SupervisionState(after, state.monitor), taken)

    def _on(self, state: SupervisionState, taken: Taken) -> tuple[SupervisionState, dict[str, NDArray[Any]]]:
        monitor, rows = self.monitor.take(state.monitor, taken.t, taken.u, taken.y)
        return SupervisionState(state.intake, monitor), rows

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
    return state, {name: np.concatenate([rows[name], rest[name]]) for name in rows}
