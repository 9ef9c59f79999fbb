# SPDX-License-Identifier: BSD-3-Clause
"""A semidefinite program in matrix letters, and its affine data.

Every inequality becomes a matrix that is affine in the scalar unknowns, F(v) = F0 + v1 F1 + ... + vN FN > 0.
The coefficients are collected by reading the expression with an algebra of affine forms: no modelling layer is
between the paper's block matrix and the solver's arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from faultrecon.finding import InputError
from faultrecon.lmi.expr import Expr, Inequality, ShapeError
from faultrecon.lmi.walk import evaluate, leaves


class NotAffineError(ShapeError):
    """A product of two unknowns, or an inverse: no linear matrix inequality."""


@dataclass(frozen=True)
class Form:
    """An affine matrix, row by row: `constant` (r, c) plus `slope` (r*c, N) sparse times the unknowns; None is zero."""

    constant: np.ndarray
    slope: Any | None


@dataclass(frozen=True)
class Problem:
    """Minimise an affine scalar subject to strict matrix inequalities, some unknowns held at given values.

    minimise: (1, 1) Expr or None for a feasibility problem.  fixed: name to number or array.
    """

    inequalities: Sequence[Inequality]
    minimise: Expr | None = None
    fixed: Mapping[str, Any] | None = None

    @cached_property
    def unknowns(self) -> dict[str, Expr]:
        """The unknowns that are free, by name, in a fixed order."""
        return {name: leaf for name, leaf in self._letters.items() if name not in self.held}

    @cached_property
    def held(self) -> dict[str, np.ndarray]:
        """The unknowns that are held fixed, as matrices.  Raises on a wrong name, a wrong shape, a value not finite."""
        found = self._letters
        held: dict[str, np.ndarray] = {}
        for name, given in (self.fixed or {}).items():
            if name not in found:
                raise InputError(f"{name} is held fixed", why=f"the unknowns are {', '.join(found)}")
            value = np.asarray(given, dtype=float)
            if value.ndim and value.shape != found[name].shape:
                raise ShapeError(f"{name} is held at a {value.shape} value", why=f"it is {found[name].shape}")
            if not np.all(np.isfinite(value)):
                raise InputError(f"{name} is held at a value that is not finite")
            held[name] = np.broadcast_to(value, found[name].shape)
        return held

    @cached_property
    def _letters(self) -> dict[str, Expr]:
        stated = [i.expr for i in self.inequalities]
        return leaves(stated if self.minimise is None else [*stated, self.minimise], "unknown")

    @cached_property
    def offsets(self) -> dict[str, int]:
        """Where each unknown begins in the vector of scalar unknowns."""
        starts, at = {}, 0
        for name, leaf in self.unknowns.items():
            starts[name] = at
            at += freedom(leaf)
        return starts

    @cached_property
    def size(self) -> int:
        """Number of scalar unknowns."""
        return sum(freedom(leaf) for leaf in self.unknowns.values())

    @cached_property
    def forms(self) -> list[Form]:
        """The positive side of each inequality as an affine form; slopes are arrays when `dense`, else sparse."""
        return [evaluate(i.positive, self._algebra, self._memo) for i in self.inequalities]

    @cached_property
    def objective(self) -> Form | None:
        """The objective as an affine form (1, 1)."""
        return None if self.minimise is None else evaluate(self.minimise, self._algebra, self._memo)

    @cached_property
    def dense(self) -> bool:
        """Whether the problem is small enough for plain arrays."""
        blocks = [i.expr.shape[0] ** 2 * self.size for i in self.inequalities]
        return max(blocks, default=0) <= DENSE and sum(blocks) <= DENSE_IN_ALL

    @cached_property
    def _algebra(self) -> AffineAlgebra:
        return DenseAffineAlgebra(self) if self.dense else AffineAlgebra(self)

    @cached_property
    def _memo(self) -> dict[int, Any]:
        return {}

    def pack(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """The vector of scalar unknowns (N,) of a point given as matrices; ones for an unknown without a value."""
        v = np.ones(self.size)
        for name, leaf in self.unknowns.items():
            if name not in values:
                continue
            value = np.asarray(values[name], dtype=float).reshape(leaf.shape)
            part = value[np.tril_indices(leaf.shape[0])] if leaf.args[1] else value.ravel()
            v[self.offsets[name] : self.offsets[name] + part.size] = part
        return v

    def unpack(self, v: np.ndarray) -> dict[str, np.ndarray]:
        """The unknowns as matrices, the fixed ones among them, from the vector of scalar unknowns (N,)."""
        values = {}
        for name, leaf in self.unknowns.items():
            part = v[self.offsets[name] : self.offsets[name] + freedom(leaf)]
            values[name] = part[_index(leaf)].reshape(leaf.shape)
        return values | {name: value.copy() for name, value in self.held.items()}


def freedom(leaf: Expr) -> int:
    """Number of scalars in an unknown."""
    rows, columns = leaf.shape
    return rows * (rows + 1) // 2 if leaf.args[1] else rows * columns


def _index(leaf: Expr) -> np.ndarray:
    """Which scalar of an unknown each of its entries is, row by row (r*c,)."""
    rows, columns = leaf.shape
    if not leaf.args[1]:
        return np.arange(rows * columns)
    i, j = np.indices((rows, columns))
    high, low = np.maximum(i, j), np.minimum(i, j)
    return (high * (high + 1) // 2 + low).ravel()


def places(leaf: Expr) -> np.ndarray:
    """The entries (r*c, k) of an unknown as multiples of its k scalars, row by row."""
    index = _index(leaf)
    slope = np.zeros((index.size, freedom(leaf)))
    slope[np.arange(index.size), index] = 1.0
    return slope


class AffineAlgebra:
    """Reads an expression as affine forms in the unknowns of a problem."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def leaf(self, node: Expr) -> Form:
        if node.op == "given":
            return Form(node.args[1], None)
        held = self.problem.held
        if node.name in held:
            return Form(held[node.name], None)
        return Form(np.zeros(node.shape), self.unknown(node))

    def unknown(self, node: Expr) -> Any:
        """The slope (r*c, N) of an unknown: one entry per row."""
        from scipy import sparse

        index = _index(node)
        where = (np.arange(index.size), self.problem.offsets[node.name] + index)
        return sparse.csr_array((np.ones(index.size), where), shape=(index.size, self.problem.size))

    def number(self, value: float) -> Form:
        return Form(np.array([[value]]), None)

    def eye(self, n: int) -> Form:
        return Form(np.eye(n), None)

    def zero(self, rows: int, columns: int) -> Form:
        return Form(np.zeros((rows, columns)), None)

    def add(self, a: Form, b: Form) -> Form:
        if a.slope is None or b.slope is None:
            return Form(a.constant + b.constant, a.slope if b.slope is None else b.slope)
        return Form(a.constant + b.constant, a.slope + b.slope)

    def neg(self, a: Form) -> Form:
        return Form(-a.constant, None if a.slope is None else -a.slope)

    def matmul(self, a: Form, b: Form) -> Form:
        from scipy import sparse

        constant = a.constant @ b.constant
        if a.slope is not None and b.slope is not None:
            raise NotAffineError("a product of two unknowns", why="the inequality is not linear in them")
        if b.slope is not None:
            return Form(constant, sparse.kron(a.constant, np.eye(b.constant.shape[1]), "csr") @ b.slope)
        if a.slope is not None:
            return Form(constant, sparse.kron(np.eye(a.constant.shape[0]), b.constant.T, "csr") @ a.slope)
        return Form(constant, None)

    def scale(self, s: Form, a: Form) -> Form:
        from scipy import sparse

        constant = s.constant[0, 0] * a.constant
        if s.slope is not None and a.slope is not None:
            raise NotAffineError("a product of two unknowns", why="the inequality is not linear in them")
        if a.slope is not None:
            return Form(constant, s.constant[0, 0] * a.slope)
        if s.slope is not None:
            return Form(constant, sparse.csr_array(a.constant.reshape(-1, 1)) @ s.slope)
        return Form(constant, None)

    def transpose(self, a: Form) -> Form:
        if a.slope is None:
            return Form(a.constant.T, None)
        order = np.arange(a.constant.size).reshape(a.constant.shape).T.ravel()
        return Form(a.constant.T, a.slope[order])

    def inv(self, a: Form) -> Form:
        if a.slope is not None:
            raise NotAffineError("an inverse of an unknown", why="the inequality is not linear in it")
        return Form(np.linalg.inv(a.constant), None)

    def block(self, rows: list[list[Form]]) -> Form:
        from scipy import sparse

        constant = np.block([[b.constant for b in row] for row in rows])
        parts, at = [], 0
        index = np.arange(constant.size).reshape(constant.shape)
        for row in rows:
            left = 0
            for b in row:
                r, c = b.constant.shape
                if b.slope is not None:
                    local = b.slope.tocoo()
                    parts.append((index[at : at + r, left : left + c].ravel()[local.row], local.col, local.data))
                left += c
            at += row[0].constant.shape[0]
        if not parts:
            return Form(constant, None)
        i, j, data = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Form(constant, sparse.csr_array((data, (i, j)), shape=(constant.size, self.problem.size)))


DENSE = 1_000_000
"""Coefficients up to which plain arrays are faster than sparse ones, whose every product costs 50 microseconds."""
DENSE_IN_ALL = 20_000_000
"""Coefficients of all inequalities together: 160 MB; hundreds of vertices are sparse in the unknowns of each."""


class DenseAffineAlgebra(AffineAlgebra):
    """The same for small problems: slopes are arrays (r*c, N)."""

    def unknown(self, node: Expr) -> Any:
        slope = np.zeros((node.shape[0] * node.shape[1], self.problem.size))
        slope[np.arange(len(slope)), self.problem.offsets[node.name] + _index(node)] = 1.0
        return slope

    def matmul(self, a: Form, b: Form) -> Form:
        (r, k), (_, c), N = a.constant.shape, b.constant.shape, self.problem.size
        constant = a.constant @ b.constant
        if a.slope is not None and b.slope is not None:
            raise NotAffineError("a product of two unknowns", why="the inequality is not linear in them")
        if b.slope is not None:
            return Form(constant, (a.constant @ b.slope.reshape(k, c * N)).reshape(r * c, N))
        if a.slope is not None:
            return Form(constant, (b.constant.T @ a.slope.reshape(r, k, N)).reshape(r * c, N))
        return Form(constant, None)

    def scale(self, s: Form, a: Form) -> Form:
        if s.slope is None or a.slope is not None:
            return super().scale(s, a)
        return Form(s.constant[0, 0] * a.constant, a.constant.reshape(-1, 1) * s.slope)

    def block(self, rows: list[list[Form]]) -> Form:
        heights = [row[0].constant.shape[0] for row in rows]
        shape = sum(heights), sum(b.constant.shape[1] for b in rows[0])
        constant, N = np.empty(shape), self.problem.size
        known = all(b.slope is None for row in rows for b in row)
        slope = None if known else np.zeros((*shape, N))  # known matrices side by side are a known matrix
        at = 0
        for row, r in zip(rows, heights, strict=True):
            left = 0
            for b in row:
                c = b.constant.shape[1]
                constant[at : at + r, left : left + c] = b.constant
                if slope is not None and b.slope is not None:
                    slope[at : at + r, left : left + c] = b.slope.reshape(r, c, N)
                left += c
            at += r
        return Form(constant, None if slope is None else slope.reshape(constant.size, N))
