# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories exact enough to measure other integrators against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import Inconclusive, InputError

Array = NDArray[Any]


def reference_solution(
    rhs: Callable[[float, Array], ArrayLike],
    x0: ArrayLike,
    t_grid: ArrayLike,
    *,
    breakpoints: Sequence[float] = (),
    rtol: float = 1e-10,
    atol: float = 1e-12,
) -> Array:
    """The solution of x' = rhs(t, x) at every time of a grid: (len(t_grid), n).

    By DOP853 (Hairer, Norsett, Wanner 1993).  t_grid: strictly increasing, x0 (n,) belongs to its first entry.
    breakpoints: times at which rhs jumps or kinks
    (a step, the end of a sample); the integration restarts there, so that no step straddles one.  On the piece that
    ends at a breakpoint rhs is evaluated just before it, on the next one at and after it.  Raises InputError for a bad
    grid, Inconclusive when the solution leaves the finite numbers or the integrator gives up.
    """
    t = np.asarray(t_grid, dtype=float)
    x = np.atleast_1d(np.asarray(x0, dtype=float))
    if t.ndim != 1 or t.size == 0 or not np.isfinite(t).all() or np.any(np.diff(t) <= 0):
        raise InputError("the time grid is not strictly increasing", remedies=("sort it and drop repeated times",))
    if t.size == 1:
        return x[None, :].copy()
    inner = sorted({float(s) for s in breakpoints if t[0] < s < t[-1]})
    edges = [float(t[0]), *inner, float(t[-1])]
    X = np.empty((t.size, x.size))
    X[0] = x
    for left, right in pairwise(edges):
        inside = (t > left) & (t <= right)
        values, x = _piece(rhs, x, left, right, t[inside], rtol, atol)
        X[inside] = values
    return X


def _piece(
    rhs: Callable[[float, Array], ArrayLike], x: Array, left: float, right: float, t: Array, rtol: float, atol: float
) -> tuple[Array, Array]:
    """Values at the times t in (left, right], and at right, for a right-hand side smooth in between."""
    from scipy.integrate import solve_ivp

    last = np.nextafter(right, left)  # the value at `right` itself belongs to the next piece

    def before(s: float, y: Array) -> Array:
        return np.asarray(rhs(min(s, last), y), dtype=float)

    with np.errstate(over="ignore", invalid="ignore"):
        try:
            asked = np.unique(np.append(t, right))
            found = solve_ivp(before, (left, right), x, method="DOP853", t_eval=asked, rtol=rtol, atol=atol)
        except (FloatingPointError, OverflowError, ValueError) as error:
            raise _lost(left, right, str(error)) from error
    if not found.success or not np.isfinite(found.y).all():
        raise _lost(left, right, found.message if not found.success else "a value is not finite")
    Y = found.y.T
    return Y[np.searchsorted(asked, t)], Y[-1]


def _lost(left: float, right: float, why: str) -> Inconclusive:
    return Inconclusive(
        f"no reference solution between t = {left:g} and {right:g}",
        why=why,
        remedies=("shorten the time span", "check that the trajectory stays bounded"),
        evidence={"from": left, "to": right},
    )
