# SPDX-License-Identifier: BSD-3-Clause
"""Real functions of frequency as sums over poles: cheap to evaluate, to minimise, and to bound from below everywhere.

f(w) = Re(d - sum_k r_k / (jw - s_k)), even in w, for several f with the same poles.  On |t| <= h about c each term is a
geometric series, so f(c + t) = f0 + f1 t + f2 t^2 with a remainder of at most K |t|^3, K = sum |r_k| / (D^3 (D - h)),
D = |jc - s_k|: that says how far down f can go between two frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Complex = NDArray[np.complexfloating[Any, Any]]

ROUNDS = 40
"""Halvings of an interval after which no bound is expected of it."""

MANY = 2000
"""Intervals at once after which the search is given up."""

QUIET = np.errstate(divide="ignore", over="ignore", invalid="ignore")
"""A pole on the axis, or residues beyond any float: what comes out is not finite, and no bound is shown."""


@dataclass(frozen=True, eq=False)
class PartialFractions:
    """poles (m,), residues (m, q), direct (q,): q functions of the same poles."""

    poles: Complex
    residues: Complex
    direct: Array

    @QUIET
    def values(self, w: Array) -> Array:
        """f at every frequency (k, q); w may be inf."""
        finite = np.isfinite(w)
        terms = np.where(finite[:, None], 1.0 / (1j * np.where(finite, w, 0.0)[:, None] - self.poles), 0.0)
        return self.direct - (terms @ self.residues).real

    @QUIET
    def lowest(self, w: Array, values: Array) -> Array:
        """For each f the frequency (q,) of a minimum: from the best of its values on a grid (k,), by Newton steps that
        go down."""
        k = np.argmin(values, axis=0)
        at = w[k].astype(float)
        q = np.flatnonzero((at > 0) & np.isfinite(at))
        trial = x = start = at[q]
        best = values[k[q], q]
        for _ in range(5):
            f0, f1, f2, _ = self._taylor(trial, np.zeros(q.size), q)
            x, best = np.where(f0 <= best, trial, x), np.minimum(best, f0)
            step = np.where(f2 > 0, -0.5 * f1 / np.where(f2 > 0, f2, 1.0), -np.sign(f1) * 0.1 * start)
            trial = np.clip(trial + step, 0.5 * start, 2.0 * start)
        at[q] = x
        return at

    @QUIET
    def never_below(self, level: Array, at: Array, doubt: Array) -> NDArray[np.bool_]:
        """Whether f > level at every frequency, for each f; False where this way does not show it.

        level (q,): a little below the minimum.  at (q,): where that is.  doubt (q,): relative error of f.
        """
        level = level / (1.0 - doubt)
        high = 4.0 * max(
            float(np.abs(self.poles).max(initial=0.0)), float(at[np.isfinite(at)].max(initial=0.0)), 1e-300
        )
        shown = self._from_infinity(high) > level
        lowest = min(float(np.abs(self.poles).min(initial=high)), 0.25 * high)
        edges = np.concatenate([[0.0], np.geomspace(0.25 * lowest + 1e-9 * high, high, 40)])
        c, h = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
        k, q = np.nonzero(~(_least(*self._taylor(c, h), h[:, None]) > level))
        below, above = self._about(at)
        a = np.concatenate([edges[k], np.maximum(edges[k], above[q])])
        b = np.concatenate([np.minimum(edges[k + 1], below[q]), edges[k + 1]])
        q = np.concatenate([q, q])
        c, h = 0.5 * (below + above), 0.5 * (above - below)
        shown &= ~np.isfinite(at) | (_least(*self._taylor(c, h, np.arange(at.size)), h) > level)
        for _ in range(ROUNDS):
            todo = (a < b) & shown[q]
            a, b, q = a[todo], b[todo], q[todo]
            if not 0 < q.size <= MANY:
                break
            c, h = 0.5 * (a + b), 0.5 * (b - a)
            open_ = ~(_least(*self._taylor(c, h, q), h) > level[q])
            a, c, b, q = a[open_], c[open_], b[open_], q[open_]
            a, b, q = np.concatenate([a, c]), np.concatenate([c, b]), np.concatenate([q, q])
        shown[q] = False
        return shown

    def _about(self, at: Array) -> tuple[Array, Array]:
        """Ends of an interval about each minimum in which f certainly bends upwards; empty for one at infinity."""
        finite = np.isfinite(at)
        c = np.where(finite, at, 0.0)
        half = 0.5 * np.abs(1j * c[:, None] - self.poles).min(axis=1, initial=np.inf)
        _, _, f2, K = self._taylor(c, half, np.arange(c.size))
        half = np.where(finite & (f2 > 0), np.minimum(half, 0.5 * f2 / np.maximum(K, 1e-300)), 0.0)
        return c - half, c + half

    def _taylor(self, c: Array, h: Array, q: NDArray[np.intp] | None = None) -> tuple[Array, Array, Array, Array]:
        """f0, f1, f2, K about every c (k,), for every f (k, q), or for one f each where q (k,) says which."""
        reach = 1j * c[:, None] - self.poles
        room = np.abs(reach) - h[:, None]
        free = room > 0
        inverse = 1.0 / np.where(free, reach, 1.0)
        square = inverse * inverse
        rest = np.where(free, np.abs(square * inverse) / np.where(free, room, 1.0), np.inf)

        def total(terms: Array, residues: Array) -> Array:
            return np.asarray(terms @ residues if q is None else np.einsum("km,mk->k", terms, residues[:, q]))

        r = self.residues
        f0 = (self.direct if q is None else self.direct[q]) - np.real(total(inverse, r))
        f1, f2 = -np.imag(total(square, r)), np.real(total(square * inverse, r))
        return f0, f1, f2, total(rest, np.abs(r) + 1e-300)

    def _from_infinity(self, high: float) -> Array:
        """A lower bound (q,) of f beyond a frequency of at least twice the size of every pole: the same in 1/w."""
        v, size = 1.0 / high, np.abs(self.poles)[:, None]
        bend = np.sum(self.poles[:, None] * self.residues, axis=0).real
        rest = np.sum(np.abs(self.residues) * size**2 / (1.0 - size * v), axis=0)
        return self.direct + np.minimum(bend - rest * v, 0.0) * v**2


def partial_fractions(H: Array, into: Array, out: Array, through: Array) -> tuple[Complex, Complex, Complex] | None:
    """Poles (m,), X^-1 into (m, p) and out X (p, m) of through - out (s - H)^-1 into; None where H has no basis X of
    eigenvectors that computes."""
    try:
        poles, X = np.linalg.eig(H)
        poles, X = poles.astype(np.complex128), X.astype(np.complex128)
        return poles, np.linalg.solve(X, into.astype(np.complex128)), out @ X
    except np.linalg.LinAlgError:
        return None


def _least(f0: Array, f1: Array, f2: Array, K: Array, h: Array) -> Array:
    """A lower bound of f0 + f1 t + f2 t^2 - K |t|^3 for |t| <= h; -inf where K is infinite."""
    known = np.isfinite(K)
    bend = f2 - np.where(known, K, 0.0) * h
    inner = (bend > 0) & (np.abs(f1) < 2.0 * bend * h)
    ends = f0 - np.abs(f1) * h + bend * h**2
    return np.where(known, np.where(inner, f0 - f1**2 / (4.0 * np.where(inner, bend, 1.0)), ends), -np.inf)
