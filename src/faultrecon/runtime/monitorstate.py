# SPDX-License-Identifier: BSD-3-Clause
"""All that a monitor remembers between two samples, as a value that can be kept and taken up again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.runtime.correction import Held
from faultrecon.runtime.decision import Counts, Rules, Standing
from faultrecon.runtime.events import Event, Open
from faultrecon.runtime.samples import Layout, State

Array = NDArray[Any]

KEPT = 1000  # events that are over and still told: a fault that comes and goes for months must not fill the memory


@dataclass(frozen=True, eq=False)
class MonitorState:
    """Between two samples; never changed.

    recent (window - 1, hypotheses, 3): how badly each fitted, how large its fault was, in bounds, and its NIS.
    events: the last of those that are over, in order; over: how many there were.
    """

    t: float
    samples: int
    estimators: tuple[State, ...]
    live: tuple[Array, ...]
    recent: Array
    counts: Counts
    standing: Standing
    held: Held
    open: Open | None
    events: tuple[Event, ...]
    over: int

    @staticmethod
    def begin(rules: Rules, sensors: int, estimators: tuple[State, ...], live: tuple[Array, ...]) -> MonitorState:
        """Before the first sample."""
        recent = np.zeros((rules.window - 1, len(estimators), 3))
        counts = Counts.none(rules, len(estimators))
        return MonitorState(
            math.nan, 0, estimators, live, recent, counts, Standing(), Held.nothing(sensors), None, (), 0
        )

    def pack(self) -> dict[str, Any]:
        """Plain values and arrays, for a checkpoint."""
        return {
            "t": self.t,
            "samples": self.samples,
            "estimators": [one._row.copy() for one in self.estimators],
            "live": [one.copy() for one in self.live],
            "recent": self.recent.copy(),
            "counts": {name: value.astype(float) for name, value in vars(self.counts).items()},
            "standing": {**vars(self.standing), "candidates": list(self.standing.candidates)},
            "held": self.held.pack(),
            "open": None if self.open is None else self.open.pack(),
            "events": [event.as_dict() for event in self.events],
            "over": self.over,
        }

    @staticmethod
    def unpack(packed: Mapping[str, Any], layouts: Sequence[Layout]) -> MonitorState:
        """The state that was packed, every bit of it; layouts: of the estimators.

        Raises InputError on one of another monitor.
        """
        try:
            rows = [np.array(row, dtype=float) for row in packed["estimators"]]
            if [len(r) for r in rows] != [lay.width for lay in layouts]:
                raise InputError("the stored state belongs to another monitor")
            standing = dict(packed["standing"])
            standing["candidates"] = tuple(int(c) for c in standing["candidates"])
            return MonitorState(
                float(packed["t"]),
                int(packed["samples"]),
                tuple(State(r, lay) for r, lay in zip(rows, layouts, strict=True)),
                tuple(np.array(one, dtype=float) for one in packed["live"]),
                np.array(packed["recent"], dtype=float),
                Counts(**{name: np.array(v).astype(np.int8) for name, v in packed["counts"].items()}),
                Standing(**standing),
                Held.unpack(packed["held"]),
                None if packed["open"] is None else Open.unpack(packed["open"]),
                tuple(Event.from_dict(one) for one in packed["events"]),
                int(packed["over"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError("the stored state is none of a monitor", why=str(error)) from error
