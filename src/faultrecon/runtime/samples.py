# SPDX-License-Identifier: BSD-3-Clause
"""What goes into the estimator and what comes out: samples, logs, states, estimates and traces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class State:
    """Where the estimator stands after a sample.

    z: observer states (nz,).  t: time of the last sample, s.  v: its input [u - u0; y - y0], gaps filled (m+p,).
    missing: channels that sample lacked (p,).  guess: state to start from, until the first sample (n,).
    samples, gaps: how many samples were taken, and how many of them lacked something.
    """

    z: Array
    t: float
    v: Array
    missing: Mask
    guess: Array | None
    samples: int
    gaps: int


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """What is known at one sample: fault (q,), state (n,), corrected measurement (p,), ok (p,) per channel; t in s."""

    t: float
    fault: Array
    state: Array
    corrected: Array
    ok: Mask


@dataclass(frozen=True, eq=False, slots=True)
class Trace:
    """The estimates over N samples: t (N,), fault (N, q), state (N, n), corrected (N, p), ok (N, p).

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


def checked_log(t: ArrayLike, u: ArrayLike, y: ArrayLike, m: int, p: int) -> tuple[Array, Array, Array]:
    """A log as float arrays t (N,), u (N, m), y (N, p); a single channel may come as (N,).  Raises InputError."""
    t, u, y = (np.array(a, dtype=float) for a in (t, u, y))
    N = t.size
    u, y = (a.reshape(N, k) if a.ndim == 1 and k <= 1 and a.size == N * k else a for a, k in ((u, m), (y, p)))
    wanted = {"t": (N,), "u": (N, m), "y": (N, p)}
    for (name, shape), given in zip(wanted.items(), (t, u, y), strict=True):
        if given.shape != shape:
            raise InputError(f"{name} is {given.shape}", why=f"this observer and {N} times ask for {shape}")
    wrong = np.flatnonzero(~(np.diff(t) > 0)) if np.isfinite(t).all() else np.flatnonzero(~np.isfinite(t)) - 1
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


def last_known(values: Array, lost: Mask) -> Array:
    """Each lost entry replaced by the last one that was not; zero (the operating point) before the first."""
    if not lost.any():
        return values
    rows = np.where(lost, -1, np.arange(len(values))[:, None])
    last = np.maximum.accumulate(rows, axis=0)
    return np.where(last < 0, 0.0, np.take_along_axis(values, np.maximum(last, 0), axis=0))
