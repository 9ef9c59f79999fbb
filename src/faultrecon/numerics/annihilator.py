# SPDX-License-Identifier: BSD-3-Clause
"""Outputs that a fault direction cannot reach, and the left inverse that reads the fault: exact where floats allow."""

from __future__ import annotations

from fractions import Fraction
from math import frexp, gcd, lcm

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def column_rank(F: ArrayLike) -> int:
    """Numerical column rank of F (p, q), columns brought to unit length first so that units do not matter."""
    F = np.asarray(F, dtype=float)
    if 0 in F.shape:
        return 0
    norms = np.linalg.norm(F, axis=0)
    return int(np.linalg.matrix_rank(F / np.where(norms > 0, norms, 1.0)))


def annihilator(F: ArrayLike) -> Array:
    """Rows N (p - q, p) with N F = 0, for F (p, q) whose q columns that are not zero are independent.

    When each fault sits on sensors of its own, the rows that pick the other sensors.  Otherwise a rational null space
    whose entries are floats exactly, so that N F = 0 without rounding, if there is one; else an orthonormal one.
    """
    F = np.asarray(F, dtype=float)
    F = F[:, np.any(F != 0, axis=0)]  # a fault that reaches no output costs none
    p, q = F.shape
    touched = np.flatnonzero(np.any(F != 0, axis=1))
    healthy = np.setdiff1d(np.arange(p), touched)
    pick = np.eye(p)[healthy]
    if len(touched) == q:
        return pick
    inner = _rational_null(F[touched])
    if inner is None:
        u = np.linalg.svd(F[touched])[0]
        inner = u[:, q:].T
    mixed = np.zeros((inner.shape[0], p))
    mixed[:, touched] = inner
    return np.vstack([pick, mixed])


def _rational_null(F: Array) -> Array | None:
    """Rows N with N F = 0 exactly, or None when their entries need more than 53 bits."""
    p, q = F.shape
    rows = [[Fraction(v) for v in row] + [Fraction(int(i == j)) for j in range(p)] for i, row in enumerate(F)]
    for j in range(q):
        pivot = max(range(j, p), key=lambda i: abs(rows[i][j]))
        if rows[pivot][j] == 0:
            return None
        rows[j], rows[pivot] = rows[pivot], rows[j]
        for i in range(j + 1, p):
            factor = rows[i][j] / rows[j][j]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[j], strict=True)]
    out = np.zeros((p - q, p))
    for k, row in enumerate(rows[q:]):
        scale = lcm(*(v.denominator for v in row[q:]))
        ints = [int(v * scale) for v in row[q:]]
        divisor = gcd(*ints)
        ints = [v // divisor for v in ints]
        try:
            values = np.array([float(v) for v in ints])
        except OverflowError:
            return None
        if any(int(v) != i for v, i in zip(values, ints, strict=True)):
            return None
        out[k] = np.ldexp(values, -frexp(np.abs(values).max())[1])
    return out


def left_inverse(F: ArrayLike) -> Array:
    """F⁺ (q, p) with F⁺ F = I, for F of full column rank: reciprocals where each fault sits on one sensor alone."""
    F = np.asarray(F, dtype=float)
    p, q = F.shape
    if np.all(np.count_nonzero(F, axis=0) == 1) and np.all(np.count_nonzero(F, axis=1) <= 1):
        out = np.zeros((q, p))
        for j in range(q):
            i = int(np.flatnonzero(F[:, j])[0])
            out[j, i] = 1.0 / F[i, j]
        return out
    return np.linalg.pinv(F)
