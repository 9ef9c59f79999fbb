# SPDX-License-Identifier: BSD-3-Clause
"""Rows in the order of their times, from rows in the order in which they arrived.

A row leaves once a row has come that is `reorder` seconds newer, so what leaves depends on what had arrived until then
and not on how the arrivals were cut into pieces.  Rows of one time that meet while they wait become one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from faultrecon.runtime.intake_counts import Counts
from faultrecon.runtime.samples import Array

Index = NDArray[np.int64]
Fates = NDArray[np.int8]


class Fate(IntEnum):
    """What becomes of a row, known as soon as it has arrived."""

    PASSED = 0  # it is passed on: now, or when no older one is waited for any more
    MERGED = 1  # it brought something of a time that waits, whose row it is now part of
    DUPLICATE = 2  # it brought nothing new
    LATE = 3  # what is as new or newer has been passed on
    BAD_TIME = 4  # its time is not finite, or not believed


@dataclass(frozen=True, eq=False, slots=True)
class Waiting:
    """Where the ordering stands: rows that wait, sorted, t (k,), u (k, m), y (k, p), arrival (k,), and what is past.

    arrival: which row it was that brought the time, counted from 0.  newest: latest time seen; left: latest time that
    left, with its values last_u (m,), last_y (p,); doubted: the time that was not believed at last, NaN for none.
    """

    t: Array
    u: Array
    y: Array
    arrival: Index
    last_u: Array
    last_y: Array
    newest: float = -math.inf
    left: float = -math.inf
    doubted: float = math.nan
    received: int = 0

    @staticmethod
    def nothing(m: int, p: int) -> Waiting:
        """Before the first row."""
        empty = np.empty(0, dtype=np.int64)
        return Waiting(np.empty(0), np.empty((0, m)), np.empty((0, p)), empty, np.full(m, np.nan), np.full(p, np.nan))


@dataclass(frozen=True, eq=False, slots=True)
class Rows:
    """Rows in strictly increasing time: t (N,), u (N, m), y (N, p), arrival (N,)."""

    t: Array
    u: Array
    y: Array
    arrival: Index

    def __getitem__(self, part: slice | Index) -> Rows:
        return Rows(self.t[part], self.u[part], self.y[part], self.arrival[part])

    def after(self, first: Rows) -> Rows:
        """These rows behind others."""
        if not len(first.t):
            return self
        t, u, y = (np.concatenate(pair) for pair in ((first.t, self.t), (first.u, self.u), (first.y, self.y)))
        return Rows(t, u, y, np.concatenate((first.arrival, self.arrival)))


def arranged(before: Waiting, rows: Rows, reorder: float, leap: float) -> tuple[Waiting, Rows, Counts, Fates]:
    """What still waits now that `rows` (N,) have arrived, what leaves, and what becomes of each arrival, (N,)."""
    received = len(rows.t)
    m, p = rows.u.shape[1], rows.y.shape[1]
    counts, fates = replace(Counts.none(m + p), received=received), np.zeros(received, dtype=np.int8)
    before = replace(before, received=before.received + received)
    if received and _in_order(before.newest, rows.t, leap):
        waiting = Rows(before.t, before.u, before.y, before.arrival)
        before = replace(before, newest=float(rows.t[-1]), doubted=math.nan)
        return *_parted(before, rows.after(waiting), reorder, counts), fates
    believed, doubted = _believed(before.newest, before.doubted, rows.t, leap)
    rows = rows if believed.all() else rows[np.flatnonzero(believed)]
    counts = replace(counts, bad_time=received - len(rows.t))
    fates[~believed] = Fate.BAD_TIME
    before = replace(before, doubted=doubted)
    if not len(rows.t):
        return before, rows, counts, fates
    after, out, counts, fates[believed] = _sorted_in(before, rows, reorder, counts)
    return after, out, counts, fates


def flushed(before: Waiting) -> tuple[Waiting, Rows, Counts]:
    """All that waits leaves: nothing more is expected."""
    rows = Rows(before.t, before.u, before.y, before.arrival)
    return _parted(before, rows, -math.inf, Counts.none(rows.u.shape[1] + rows.y.shape[1]))


def _in_order(newest: float, t: Array, leap: float) -> bool:
    """Whether every time is finite and later than the one before, and none leaps."""
    if not (t[0] > newest and math.isfinite(t[-1])):
        return False
    with np.errstate(over="ignore", invalid="ignore"):  # an infinite step is a step; NaN is not less
        steps = np.diff(t)
    if steps.size and not steps.min() > 0:
        return False
    first = 0.0 if newest == -math.inf else float(t[0]) - newest
    return leap == math.inf or (first <= leap and (not steps.size or bool(steps.max() <= leap)))


def _believed(newest: float, doubted: float, t: Array, leap: float) -> tuple[NDArray[np.bool_], float]:
    """The rows (N,) whose time is finite and no leap ahead of the newest one, unless a second one in a row agrees."""
    believed = np.isfinite(t)
    finite = t[believed]
    if leap == math.inf or not finite.size:
        return believed, doubted
    start = float(finite[0]) if newest == -math.inf else newest
    with np.errstate(over="ignore"):
        ahead = np.diff(np.maximum.accumulate(finite), prepend=start)
    if ahead.max() <= leap:
        return believed, math.nan
    for k in np.flatnonzero(believed):
        now = float(t[k])
        if newest == -math.inf or now - newest <= leap or abs(now - doubted) <= leap:
            newest, doubted = max(newest, now), math.nan
        else:
            believed[k], doubted = False, now
    return believed, doubted


def _sorted_in(before: Waiting, rows: Rows, reorder: float, counts: Counts) -> tuple[Waiting, Rows, Counts, Fates]:
    """Rows of any order, with finite times, put among those that wait."""
    t, m = rows.t, rows.u.shape[1]
    newest = np.maximum.accumulate(np.concatenate(([before.newest], t)))
    left = _left(before, t, newest[1:] - reorder)
    punctual = t > left
    x = np.hstack([rows.u, rows.y])
    times = np.concatenate((before.t, t[punctual]))
    order = np.argsort(times, kind="stable")
    values = np.concatenate((np.hstack([before.u, before.y]), x[punctual]))[order]
    arrival = np.concatenate((before.arrival, rows.arrival[punctual]))[order]
    together, met, of_sorted = _met(times[order], values, arrival, m)
    counts += replace(met, reordered=int(np.count_nonzero(punctual & (t < newest[:-1]))))
    fates = np.empty(len(t), dtype=np.int8)
    unsorted = np.empty(len(order), dtype=np.int8)
    unsorted[order] = of_sorted
    fates[punctual] = unsorted[len(before.t) :]
    if not punctual.all():
        late = np.flatnonzero(~punctual)
        lost, fates[late] = _too_late(before, together, t[late], x[late], left[late], newest[:-1][late])
        counts += lost
    return *_parted(replace(before, newest=float(newest[-1])), together, reorder, counts), fates


def _left(before: Waiting, t: Array, leaves: Array) -> Array:
    """The latest time that had left when each row arrived, (N,).  leaves (N,): up to where rows leave at each arrival.

    A row leaves at the first arrival, not before its own, that lets it.  One that came too late would too, but is no
    later than what has left, so it changes nothing here.
    """
    count = len(t)
    times = np.concatenate((before.t, t))
    arrived = np.concatenate((np.zeros(len(before.t), dtype=np.intp), np.arange(count)))
    at = np.maximum(arrived, np.searchsorted(leaves, times))
    gone = np.full(count + 1, -math.inf)
    np.maximum.at(gone, at, times)  # those that stay are put at the end, which nobody reads
    return np.maximum.accumulate(np.concatenate(([before.left], gone[: count - 1])))


def _met(t: Array, x: Array, arrival: Index, m: int) -> tuple[Rows, Counts, Fates]:
    """Sorted rows with those of one time made one: the first value of every channel stays.  t (R,), x (R, m+p).

    Fates (R,), of the rows as they were given.
    """
    none = Counts.none(x.shape[1])
    heads = np.flatnonzero(np.concatenate((t[:1] == t[:1], t[1:] != t[:-1])))
    if len(heads) == len(t):
        return Rows(t, x[:, :m], x[:, m:], arrival), none, np.zeros(len(t), dtype=np.int8)
    rows, came = len(t), ~np.isnan(x)
    own = np.arange(rows)[:, None]
    first = np.minimum.reduceat(np.where(came, own, rows), heads, axis=0)  # which row of the group has it first
    filled = np.take_along_axis(x, np.minimum(first, rows - 1), axis=0)
    filled[first == rows] = math.nan
    group = np.repeat(np.arange(len(heads)), np.diff(heads, append=rows))
    other = came & (x != filled[group])
    brings = np.any(other | (first[group] == own), axis=1)
    brings[heads] = False
    merged = int(np.count_nonzero(brings))
    counts = replace(
        none,
        merged=merged,
        duplicates=rows - len(heads) - merged,
        conflicts=tuple(np.count_nonzero(other, axis=0).tolist()),
    )
    fates = np.where(brings, Fate.MERGED, Fate.DUPLICATE).astype(np.int8)
    fates[heads] = Fate.PASSED
    return Rows(t[heads], filled[:, :m], filled[:, m:], arrival[heads]), counts, fates


def _too_late(before: Waiting, together: Rows, t: Array, x: Array, left: Array, newest: Array) -> tuple[Counts, Fates]:
    """Rows (L,) that found their time gone; one that repeats what has just left is a duplicate, the others are lost."""
    gone = np.tile(np.concatenate((before.last_u, before.last_y)), (len(t), 1))
    where = np.searchsorted(together.t, t)
    mine = np.flatnonzero(np.append(together.t, math.nan)[where] == t)  # of this very piece, not what left before it
    gone[mine] = np.hstack([together.u, together.y])[where[mine]]
    echo, came = t == left, ~np.isnan(x)
    other = came & (x != gone)
    repeats = echo & ~other.any(axis=1)
    with np.errstate(over="ignore"):
        behind = (newest - t)[~repeats]
    counts = replace(
        Counts.none(x.shape[1]),
        duplicates=int(np.count_nonzero(repeats)),
        late=int(np.count_nonzero(~repeats)),
        lateness=float(np.max(behind, initial=0.0)),
        conflicts=tuple(np.count_nonzero(other & ~np.isnan(gone) & echo[:, None], axis=0).tolist()),
    )
    return counts, np.where(repeats, Fate.DUPLICATE, Fate.LATE).astype(np.int8)


def _parted(before: Waiting, rows: Rows, reorder: float, counts: Counts) -> tuple[Waiting, Rows, Counts]:
    """Sorted rows parted into those that leave and those that wait."""
    leaves = int(np.searchsorted(rows.t, before.newest - reorder, side="right"))
    out, stays = rows[:leaves], rows[leaves:]
    after = replace(before, t=stays.t.copy(), u=stays.u.copy(), y=stays.y.copy(), arrival=stays.arrival.copy())
    if leaves:
        after = replace(after, left=float(out.t[-1]), last_u=out.u[-1].copy(), last_y=out.y[-1].copy())
    return after, out, replace(counts, passed=leaves)
