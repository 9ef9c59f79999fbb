# SPDX-License-Identifier: BSD-3-Clause
"""Definiteness in floating point with rigorous error bounds: sub-millisecond, and sound on IEEE 754 arithmetic.

Every matrix is read as a midpoint with a componentwise radius that covers all rounding of its assembly; then Cholesky
of the midpoint, shifted down by a bound on its own rounding and on the radius, has to succeed [Rump 2006, "Verification
of positive definiteness"].  Needs round to nearest and a classical (not Strassen) matrix product; the exact proof
(`lmi.exact`) needs neither, and is the one that is stored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.lmi.expr import Expr, Inequality
from faultrecon.lmi.walk import evaluate

Array = NDArray[np.float64]

U = 2.0**-53  # unit roundoff
TINY = 2.0**-1022  # below it a product loses relative accuracy; added once per operation


def gamma(k: int) -> float:
    """k u / (1 - k u), doubled: it also covers the rounding of the bounds that it enters."""
    return 2.0 * k * U / (1.0 - k * U)


@dataclass(frozen=True)
class Ball:
    """A matrix known up to a componentwise radius."""

    mid: Array
    radius: Array


class BallAlgebra:
    """Reads an expression with midpoint and radius; letters are exact floats, unknowns come from `values`."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = values

    def leaf(self, node: Expr) -> Ball:
        if node.op == "given":
            return _exact(node.args[1])
        value = np.asarray(self.values[node.name], dtype=float).reshape(node.shape)
        return _exact(0.5 * (value + value.T) if node.args[1] else value)

    def number(self, value: float) -> Ball:
        return _exact(np.array([[value]]))

    def eye(self, n: int) -> Ball:
        return _exact(np.eye(n))

    def zero(self, rows: int, columns: int) -> Ball:
        return _exact(np.zeros((rows, columns)))

    def add(self, a: Ball, b: Ball) -> Ball:
        mid = a.mid + b.mid
        return Ball(mid, (a.radius + b.radius) * (1 + 4 * U) + U * np.abs(mid))

    def neg(self, a: Ball) -> Ball:
        return Ball(-a.mid, a.radius)

    def matmul(self, a: Ball, b: Ball) -> Ball:
        k = a.mid.shape[1]
        mid, size_a, size_b = a.mid @ b.mid, np.abs(a.mid), np.abs(b.mid)
        spread = a.radius @ (size_b + b.radius) + size_a @ b.radius
        rounding = gamma(k + 2) * (size_a @ size_b) + (k + 1) * TINY
        return Ball(mid, (spread + rounding) * (1 + gamma(k + 8)))

    def scale(self, s: Ball, a: Ball) -> Ball:
        mid, size = s.mid[0, 0] * a.mid, np.abs(s.mid[0, 0])
        spread = size * a.radius + s.radius[0, 0] * (np.abs(a.mid) + a.radius)
        return Ball(mid, (spread + U * np.abs(mid)) * (1 + 16 * U) + TINY)

    def transpose(self, a: Ball) -> Ball:
        return Ball(a.mid.T, a.radius.T)

    def inv(self, a: Ball) -> Ball:
        raise ValueError("an inverse is no part of an inequality")

    def block(self, rows: list[list[Ball]]) -> Ball:
        return Ball(
            np.block([[b.mid for b in row] for row in rows]), np.block([[b.radius for b in row] for row in rows])
        )


def _exact(value: Array) -> Ball:
    return Ball(value, np.zeros_like(value))


def positive_definite(ball: Ball) -> bool:
    """Whether every symmetric matrix within the ball is positive definite; False means 'not shown'."""
    n = ball.mid.shape[0]
    if n == 0:
        return True
    if not (np.all(np.isfinite(ball.mid)) and np.all(np.isfinite(ball.radius))):
        return False
    mid, radius = 0.5 * (ball.mid + ball.mid.T), np.maximum(ball.radius, ball.radius.T)
    radius = radius + np.abs(ball.mid - mid) + U * np.abs(mid)
    diagonal = np.diag(mid)
    if not np.all(diagonal > 0):
        return False
    # A diagonal congruence by powers of two is exact and brings the diagonal near one.
    d = np.exp2(-np.round(0.5 * np.log2(diagonal)))
    scaled, spread = mid * np.outer(d, d), radius * np.outer(d, d)
    rounding = gamma(n + 1) / (1 - gamma(n + 1)) * float(np.trace(scaled))
    shift = (float(spread.sum(axis=1).max()) + rounding) * (1 + gamma(n + 8)) + n * TINY
    shifted = scaled - (shift * (1 + 4 * U)) * np.eye(n)
    shifted -= np.diag(2 * U * np.abs(np.diag(shifted)))  # the subtraction above rounds too
    try:
        np.linalg.cholesky(shifted)
    except np.linalg.LinAlgError:
        return False
    return True


def quickly_proved(inequality: Inequality, values: Mapping[str, Any]) -> bool:
    """Whether the inequality holds for these numbers, by floating point with rigorous bounds; False: not shown."""
    return positive_definite(evaluate(inequality.positive, BallAlgebra(values)))
