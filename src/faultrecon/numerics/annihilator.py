# SPDX-License-Identifier: BSD-3-Clause
"""Outputs that a fault direction cannot reach, and the left inverse that reads the fault: exact where floats allow."""

from __future__ import annotations

import operator
from fractions import Fraction
from math import gcd, lcm

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
    """Rows N (p - r, p) with N F = 0, for F (p, q) of rank r: all that the faults cannot reach.

    When each fault sits on a sensor of its own, the rows that pick the other sensors.  Otherwise a rational null space,
    N F = 0 without rounding where its entries fit in 53 bits.  The rank is the exact one: columns that floats hold as
    dependent count once, those that rounding has made independent count each.
    """
    F = np.asarray(F, dtype=float)
    F = F[:, np.any(F != 0, axis=0)]  # a fault that reaches no output costs none
    p, q = F.shape
    reached = np.any(F != 0, axis=1)
    touched = np.flatnonzero(reached)
    pick = np.eye(p)[~reached]
    if len(touched) == q == np.count_nonzero(F):
        return pick
    inner = _rational_null(F[touched])
    mixed = np.zeros((inner.shape[0], p))
    mixed[:, touched] = inner
    return np.vstack([pick, mixed])


def _rational_null(F: Array) -> Array:
    """Rows N with N F = 0: exact where their entries fit in 53 bits, else each entry rounded once.

    Rational elimination, not a singular value decomposition: every platform gets the same bits, and stored designs
    refer to this basis.
    """
    p, q = F.shape
    rows = [[Fraction(v) for v in row] + [Fraction(int(i == j)) for j in range(p)] for i, row in enumerate(F)]
    rank = 0
    for j in range(q):
        pivot = max(range(rank, p), key=lambda i: abs(rows[i][j]), default=rank)
        if rank == p or rows[pivot][j] == 0:
            continue  # a column that depends on those before it reaches nothing more
        rows[rank], rows[pivot] = rows[pivot], rows[rank]
        for i in range(rank + 1, p):
            factor = rows[i][j] / rows[rank][j]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[rank], strict=True)]
        rank += 1
    return np.array([_row(row[q:]) for row in rows[rank:]]).reshape(p - rank, p)


def _row(values: list[Fraction]) -> list[float]:
    """A multiple of a rational row with entries near one: integers over a power of two where 53 bits hold them."""
    whole = lcm(*(v.denominator for v in values))
    ints = [int(v * whole) for v in values]
    divisor = gcd(*ints)
    ints = [v // divisor for v in ints]
    top = max(abs(v) for v in ints)
    if top < 2**53:
        return [float(v) / 2.0 ** top.bit_length() for v in ints]
    return [float(Fraction(v, top)) for v in ints]


def left_inverse(F: ArrayLike) -> Array:
    """F⁺ (q, p) with F⁺ F = I, for F of full column rank: (F'F)⁻¹ F' in rational arithmetic, entries rounded once."""
    F = np.asarray(F, dtype=float)
    p, q = F.shape
    columns = [[Fraction(v) for v in column] for column in F.T]
    gram = [[sum(map(operator.mul, a, b), Fraction(0)) for b in columns] for a in columns]
    rows = [g + column for g, column in zip(gram, columns, strict=True)]
    for j in range(q):
        pivot = max(range(j, q), key=lambda i: abs(rows[i][j]))
        if rows[pivot][j] == 0:
            raise np.linalg.LinAlgError("F has dependent columns")
        rows[j], rows[pivot] = rows[pivot], rows[j]
        rows[j] = [v / rows[j][j] for v in rows[j]]
        for i in range(q):
            if i != j and rows[i][j]:
                rows[i] = [a - rows[i][j] * b for a, b in zip(rows[i], rows[j], strict=True)]
    return np.array([[float(v) for v in row[q:]] for row in rows]).reshape(q, p)
