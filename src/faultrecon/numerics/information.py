# SPDX-License-Identifier: BSD-3-Clause
"""What measurements can tell about numbers they depend on: least deviations, biases, and what nothing can tell apart.

Everything is read off J, how every measurement changes with every number; columns are brought to unit length first, so
that units do not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAME = 1e-6
"""Change of the measurements, relative to what the numbers change alone, up to which two sets of numbers are the same:
sensitivities that are integrated to 1e-8 or so, and a difference in the sixth digit is far below any noise."""
CLOSE = 1e-3
"""Part of what f alone changes, beyond what J explains, that may be left over; and least part of a number in a set."""
MOST_TOGETHER = 3
"""Numbers that are searched for as one gauge together."""


def least_deviations(J: Array) -> Array:
    """The standard deviation below which no unbiased estimate of each number gets: (k,), inf where nothing is seen.

    J: (N, k), measurements with noise of deviation one.  The bound of Cramér and Rao, without any prior.
    """
    _, s, Vh, length = _decomposed(J)
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(Vh == 0.0, 0.0, Vh / s[:, None])
        return np.sqrt((terms**2).sum(axis=0)) / length


def biases(J: Array, S: Array) -> Array:
    """How far least-squares estimates are off per unit of what they take for known: (k, l) from J (N, k), S (N, l).

    S: how the measurements change with what is taken for known; the truth is one unit higher than what is assumed.
    """
    _, s, _, length = _decomposed(J)
    if s.size == 0 or s[-1] <= 0:
        return np.full((J.shape[1], S.shape[1]), np.nan)
    return np.linalg.lstsq(J / length, S, rcond=None)[0] / length[:, None]


def unexplained(J: Array, K: Array) -> Array:
    """K (N, l) with columns of unit length, less what J (N, k) explains of them: (N, l)."""
    own = _unit(K)
    if J.shape[1] == 0:
        return own
    U, s, _ = np.linalg.svd(_unit(J), full_matrices=False)
    U = U[:, s > 1e-13 * s.max(initial=0.0)]
    return own - U @ (U.T @ own)


def indistinguishable(J: Array, f: Array, K: Array, tolerance: float = SAME) -> list[dict[int, float]]:
    """The smallest sets of numbers whose change passes for a change of f while J is free: {column of K: its change}.

    J: (N, k) of numbers that nobody knows, f: (N,) of the one in question, K: (N, l) of others.  The changes of K's
    columns that a change of f by one cancels; sets of at most three, none of them part of another.
    """
    # R of Q R has the same lengths and angles in a few rows.
    rest: Array = np.asarray(np.linalg.qr(unexplained(J, np.column_stack([f, K])), mode="r"))
    size_f, size = np.linalg.norm(f), np.linalg.norm(K, axis=0)
    if size_f == 0 or np.linalg.norm(rest[:, 0]) <= tolerance:
        return []  # f is no better known without the others
    candidates = [j for j in _taking_part(rest, tolerance) if size[j] > 0]
    found: list[dict[int, float]] = []
    for count in range(1, MOST_TOGETHER + 1):
        for chosen in combinations(candidates, count):
            if any(set(one) <= set(chosen) for one in found):
                continue
            columns = rest[:, [1 + j for j in chosen]]
            weights, *_ = np.linalg.lstsq(columns, -rest[:, 0], rcond=1e-9)
            left = np.linalg.norm(rest[:, 0] + columns @ weights)
            allowed = min(tolerance * max(1.0, float(np.abs(weights).max())), CLOSE * float(np.linalg.norm(rest[:, 0])))
            if left <= allowed and np.abs(weights).min() > CLOSE:
                found.append({j: float(w * size_f / size[j]) for j, w in zip(chosen, weights, strict=True)})
    return found


def _taking_part(rest: Array, tolerance: float) -> list[int]:
    """Columns after the first that some combination without effect contains."""
    _, s, Vh = np.linalg.svd(rest, full_matrices=True)
    small = np.ones(Vh.shape[0], dtype=bool)
    small[: s.size] = s <= tolerance
    share = np.linalg.norm(Vh[small], axis=0)
    return [j - 1 for j in range(1, rest.shape[1]) if share[j] > 1e-3]


def _decomposed(J: Array) -> tuple[Array, Array, Array, Array]:
    length = np.linalg.norm(J, axis=0)
    length = np.where(length > 0, length, 1.0)
    k = J.shape[1]
    if J.shape[0] < k:
        J = np.vstack([J, np.zeros((k - J.shape[0], k))])
    U, s, Vh = np.linalg.svd(J / length, full_matrices=False)
    return U, s, Vh, length


def _unit(M: Array) -> Array:
    length = np.linalg.norm(M, axis=0)
    return M / np.where(length > 0, length, 1.0)


def norms_of_products(steps: Sequence[Array] | Array) -> Array:
    """|F_k ... F_1| for every k, from matrices (K, n, n): the logarithms, (K,), so that nothing under- or overflows."""
    found, scale = np.empty(len(steps)), 0.0
    product = np.eye(steps[0].shape[0]) if len(steps) else np.eye(0)
    for k, step in enumerate(steps):
        product = step @ product
        size = float(np.linalg.norm(product, 2))
        if size == 0.0:
            found[k:] = -np.inf
            break
        scale += float(np.log(size))
        product = product / size
        found[k] = scale
    return found
