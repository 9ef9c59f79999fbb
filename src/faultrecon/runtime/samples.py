# SPDX-License-Identifier: BSD-3-Clause
"""What goes into the estimator and what comes out: samples, logs, states, estimates and traces.

One sample leaves one row of numbers behind: where the observer stands and what it estimates.  `State` and `Estimate`
are two views of that row, which is never written again; their arrays are made, read-only, when they are asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Layout:
    """Where everything is in a row: [z, v, t, samples, gaps, fault, state, corrected, missing, ok, sample].

    nz observer states, m inputs, p sensors, n plant states, q faults.  v = [u - u0; y - y0], gaps filled; sample =
    [u; y] as it came.  Before the first sample the place of `state` holds the state to start from, or NaN.
    """

    nz: int
    m: int
    p: int
    n: int
    q: int

    def _place(self, name: str) -> slice:
        sizes = {"z": self.nz, "v": self.m + self.p, "clock": 3, "fault": self.q, "state": self.n}
        sizes |= {"corrected": self.p, "missing": self.p, "ok": self.p, "sample": self.m + self.p}
        start = sum(list(sizes.values())[: list(sizes).index(name)])
        return slice(start, start + sizes[name])

    @cached_property
    def z(self) -> slice:
        """Observer states."""
        return self._place("z")

    @cached_property
    def v(self) -> slice:
        """The last input, as deviation."""
        return self._place("v")

    @cached_property
    def carried(self) -> slice:
        """[z; v], which is what goes from one sample to the next."""
        return slice(0, self.v.stop)

    @cached_property
    def t(self) -> int:
        """The time; the numbers of samples and of samples with gaps follow it."""
        return self._place("clock").start

    @cached_property
    def fault(self) -> slice:
        """Estimated faults."""
        return self._place("fault")

    @cached_property
    def state(self) -> slice:
        """Estimated plant state."""
        return self._place("state")

    @cached_property
    def corrected(self) -> slice:
        """Corrected measurements."""
        return self._place("corrected")

    @cached_property
    def missing(self) -> slice:
        """1 where the sample lacked a measurement."""
        return self._place("missing")

    @cached_property
    def ok(self) -> slice:
        """1 where a channel is fully informed."""
        return self._place("ok")

    @cached_property
    def sample(self) -> slice:
        """The sample itself."""
        return self._place("sample")

    @cached_property
    def width(self) -> int:
        """Numbers in a row."""
        return self.sample.stop


class _Row:
    """A view of one row; the row itself stays private because the compiled kernel reads it where it is."""

    __slots__ = ("_layout", "_row")

    def __init__(self, row: Array, layout: Layout) -> None:
        self._row = row
        self._layout = layout

    def _part(self, place: slice) -> Array:
        part = self._row[place]
        part.setflags(write=False)
        return part

    @property
    def t(self) -> float:
        """Time of the sample, s; NaN before the first."""
        return float(self._row[self._layout.t])

    def __reduce__(self) -> tuple[type, tuple[Array, Layout]]:
        return type(self), (self._row, self._layout)


class State(_Row):
    """Where the estimator stands after a sample: all that `step` needs to go on.  Frozen."""

    __slots__ = ()

    @property
    def z(self) -> Array:
        """Observer states, (nz,)."""
        return self._part(self._layout.z)

    @property
    def v(self) -> Array:
        """The input of the last sample, [u - u0; y - y0] with gaps filled, (m+p,)."""
        return self._part(self._layout.v)

    @property
    def missing(self) -> Mask:
        """The channels that the last sample lacked, (p,)."""
        return self._row[self._layout.missing] != 0.0

    @property
    def samples(self) -> int:
        """How many samples were taken."""
        return int(self._row[self._layout.t + 1])

    @property
    def gaps(self) -> int:
        """How many of them lacked something."""
        return int(self._row[self._layout.t + 2])

    @property
    def guess(self) -> Array | None:
        """The plant state to start from, (n,), until the first sample; None where none was given."""
        guess = self._part(self._layout.state)
        return None if self.samples or np.isnan(guess).any() else guess

    def __repr__(self) -> str:
        if self.samples == 0:
            return "State(before the first sample)"
        return f"State(t = {self.t:g} s, {self.samples} samples, {self.gaps} with gaps, z = {self.z})"


class Estimate(_Row):
    """What is known at one sample.  Frozen."""

    __slots__ = ()

    @property
    def fault(self) -> Array:
        """The faults, (q,)."""
        return self._part(self._layout.fault)

    @property
    def state(self) -> Array:
        """The plant's state, (n,), absolute."""
        return self._part(self._layout.state)

    @property
    def corrected(self) -> Array:
        """The measurements with the faults taken out, (p,)."""
        return self._part(self._layout.corrected)

    @property
    def ok(self) -> Mask:
        """Per channel whether all that it needs was measured, (p,)."""
        return self._row[self._layout.ok] != 0.0

    def __repr__(self) -> str:
        return f"Estimate(t = {self.t:g} s, fault = {self.fault}, state = {self.state}, corrected = {self.corrected})"


class Buffers:
    """One row that `Estimator.step_into` writes again and again, and the arrays that show it.

    fault (q,), state (n,), corrected (p,), read-only views that change with every step; ok (p,), and complete: whether
    ok is True throughout.  Copy what is to be kept.  One Buffers belongs to one stream of samples, and to one thread.
    """

    __slots__ = ("_layout", "_row", "complete", "corrected", "fault", "ok", "state")

    def __init__(self, state: State) -> None:
        start = Estimate(state._row.copy(), state._layout)
        self._row, self._layout = start._row, start._layout
        self.fault, self.state, self.corrected = start.fault, start.state, start.corrected
        self.ok = start.ok
        self.complete = bool(self.ok.all())

    @property
    def t(self) -> float:
        """Time of the last sample, s; NaN before the first."""
        return float(self._row[self._layout.t])

    def snapshot(self) -> State:
        """The state after the last sample, as a value: to store, or to go on from with `step`."""
        return State(self._row.copy(), self._layout)

    def refresh(self) -> None:
        """Make `ok` and `complete` say what the row says; after one complete sample they stay as they are."""
        np.not_equal(self._row[self._layout.ok], 0.0, out=self.ok)
        self.complete = bool(self.ok.all())


def before_the_first(layout: Layout, guess: Array | None) -> State:
    """The state from which the first sample starts."""
    row = np.zeros(layout.width)
    row[layout.t] = math.nan
    row[layout.state] = math.nan if guess is None else guess
    return State(row, layout)


@dataclass(frozen=True, eq=False, slots=True)
class Trace:
    """The estimates over N samples: t (N,), fault (N, q), state (N, n), corrected (N, p), ok (N, p).

    Every column lies in one piece in memory, as tables and figures want it.
    end: where the estimator stands after the last sample, to go on with `step`.
    """

    t: Array
    fault: Array
    state: Array
    corrected: Array
    ok: Mask
    end: State

    def __len__(self) -> int:
        return len(self.t)


def columns(rows: int, width: int, dtype: type = float) -> NDArray:
    """An uninitialised (rows, width) array whose columns lie in one piece."""
    return np.empty((width, rows), dtype=dtype).T


def checked_log(t: ArrayLike, u: ArrayLike, y: ArrayLike, m: int, p: int) -> tuple[Array, Array, Array]:
    """A log as float arrays t (N,), u (N, m), y (N, p); a single channel may come as (N,).  Raises InputError."""
    t, u, y = (np.asarray(a, dtype=float) for a in (t, u, y))
    N = t.size
    u, y = (a.reshape(N, k) if a.ndim == 1 and k <= 1 and a.size == N * k else a for a, k in ((u, m), (y, p)))
    wanted = {"t": (N,), "u": (N, m), "y": (N, p)}
    for (name, shape), given in zip(wanted.items(), (t, u, y), strict=True):
        if given.shape != shape:
            raise InputError(f"{name} is {given.shape}", why=f"this observer and {N} times ask for {shape}")
    wrong = np.flatnonzero(~(t[1:] > t[:-1])) if np.isfinite(t).all() else np.flatnonzero(~np.isfinite(t)) - 1
    if wrong.size:
        k = int(wrong[0]) + 1
        raise InputError(
            f"time does not increase at row {k}: {t[k]:g} s" + (f" follows {t[k - 1]:g} s" if k else ""),
            evidence={"rows": int(wrong.size)},
            remedies=("sort the log", "drop repeated rows"),
        )
    return t, u, y


def checked_row(value: ArrayLike, size: int, name: str) -> Array:
    """One sample of u or y as (size,) floats; a number will do for one channel.  Raises InputError."""
    row = np.array(value, dtype=float)
    row = row.reshape(1) if row.ndim == 0 and size == 1 else row
    if row.shape != (size,):
        raise InputError(f"{name} is {row.shape}", why=f"this observer takes ({size},)")
    return row


def last_known(values: Array, lost: Mask, before: Array) -> Array:
    """Each lost entry of values (N, m) replaced by the last one that was not, or by `before` (m,) the first row."""
    if not lost.any():
        return values
    rows = np.where(lost, -1, np.arange(len(values))[:, None])
    last = np.maximum.accumulate(rows, axis=0)
    return np.where(last < 0, before, np.take_along_axis(values, np.maximum(last, 0), axis=0))
