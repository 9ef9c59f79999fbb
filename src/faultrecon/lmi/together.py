# SPDX-License-Identifier: BSD-3-Clause
"""Many inequalities that share their letters, read block by block into the solver's arrays.

The vertices of a box differ in a few given matrices: most blocks of one inequality stand in all of them.  So a block is
read once wherever it stands, in the unknowns that occur in it and in no other, only the upper triangle is looked at,
and what it holds is put into its places in one pass over all inequalities.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.lmi.expr import Expr
from faultrecon.lmi.problem import NotAffineError, Problem, places
from faultrecon.lmi.walk import evaluate

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

KEPT = 4_000_000
"""Coefficients (32 MB) that are kept for the next inequality before reading begins anew."""


@dataclass(frozen=True, eq=False)
class Part:
    """An affine matrix (r, c): `constant`, and by unknown the slopes (r*c, k) in its k scalars."""

    constant: Array
    slopes: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Cell:
    """What a block brings, at rows g and columns h of the block on and above the diagonal of the whole.

    M[(g, h), column] = slope and b[(bg, bh)] = constant, before scaling.  rows, columns: how large the rows of the
    whole are by this block, None where it does not matter.
    """

    g: Integers
    h: Integers
    column: Integers
    slope: Array
    bg: Integers
    bh: Integers
    constant: Array
    rows: Array | None
    columns: Array | None


def rows_of(problem: Problem, margin: float, near: Array | None, units: Array) -> tuple[Any, Array, tuple[int, ...]]:
    """M (sparse, by columns), b and the size of each cone: `positive side >= margin * I`, as in `lmi.solve`."""
    from scipy import sparse

    reader = Reader(problem, near)
    cells, i, j, base = [], [], [], []
    factors, weights, sizes, at = [], [], [], 0
    for inequality in problem.inequalities:
        found, weight = reader.read(inequality.expr, inequality.sense == "<")
        for cell, row, column in found:
            cells.append(cell)
            i.append(row)
            j.append(column)
            base.append(at)
        n = len(weight)
        d = np.exp2(-np.round(0.5 * np.log2(np.where(weight > 0, weight, 1.0))))
        rows, columns, root = upper(n)
        factors.append(root * d[rows] * d[columns])
        weights.append(d)
        sizes.append(n)
        at += len(root)
    factor = np.concatenate([np.zeros(0), *factors])
    origin = np.array([base, i, j], dtype=np.intp)

    def where(g: list[Integers], h: list[Integers]) -> Integers:
        """Places in the stacked svecs."""
        start, row, column = np.repeat(origin, [len(part) for part in g], axis=1)
        row, column = row + _joined(g), column + _joined(h)
        return start + column * (column + 1) // 2 + row

    b = np.zeros(at)
    b[where([c.bg for c in cells], [c.bh for c in cells])] = np.concatenate([np.zeros(0), *(c.constant for c in cells)])
    if margin:
        ends = np.cumsum([0, *(n * (n + 1) // 2 for n in sizes)])
        for d, start in zip(weights, ends, strict=False):
            k = np.arange(len(d))
            b[start + k * (k + 3) // 2] -= margin * (1.0 / d**2)
    index = where([c.g for c in cells], [c.h for c in cells])
    column = _joined([c.column for c in cells])
    slope = np.concatenate([np.zeros(0), *(c.slope for c in cells)]) * factor[index] * units[column]
    M = sparse.csc_array((slope, (index, column)), shape=(at, problem.size))
    return M, b * factor, tuple(sizes)


def _joined(many: list[Integers]) -> Integers:
    return np.concatenate([np.zeros(0, dtype=np.intp), *many])


@cache
def upper(n: int) -> tuple[Integers, Integers, Array]:
    """Rows and columns of the upper triangle by columns, and √2 off the diagonal: shared, not to be written to."""
    j, i = np.tril_indices(n)
    return i, j, np.where(i == j, 1.0, np.sqrt(2.0))


class Reader:
    """Reads inequalities of one problem into cells; near: as in `lmi.solve`."""

    def __init__(self, problem: Problem, near: Array | None) -> None:
        self.problem, self.near = problem, None if near is None else np.abs(near)
        self._anew()

    def _anew(self) -> None:
        self.algebra, self.memo = Parts(self.problem), {}
        self.cells: dict[tuple[int, bool, bool], Cell | None] = {}

    def read(self, expr: Expr, negative: bool) -> tuple[list[tuple[Cell, int, int]], Array]:
        """The cells of an expression, or of its negative, with their first row and column; and how large its rows are.

        Sizes are those of the data alone or, near a point, of the diagonal there: (n,).
        """
        if self.algebra.kept > KEPT:
            self._anew()
        weight, found = np.zeros(expr.shape[0]), []
        grid = triangle(expr)
        starts = np.cumsum([0, *(row[k].shape[0] for k, row in enumerate(grid))]).tolist()
        for a, row in enumerate(grid):
            for b in range(a, len(grid)):
                if row[b].op == "zero":
                    continue
                cell = self.cell(row[b], a == b, negative)
                if cell is None:
                    continue
                found.append((cell, starts[a], starts[b]))
                if cell.rows is not None:
                    self.weigh(weight[starts[a] : starts[a + 1]], cell.rows)
                if cell.columns is not None:
                    self.weigh(weight[starts[b] : starts[b + 1]], cell.columns)
        return found, weight

    @staticmethod
    def weigh(weight: Array, by: Array) -> None:
        """The larger one."""
        np.maximum(weight, by, out=weight)

    def cell(self, node: Expr, diagonal: bool, negative: bool) -> Cell | None:
        """What a block brings; None where it is zero."""
        part = evaluate(node, self.algebra, self.memo)
        key = id(part), diagonal, negative  # the algebra and the memo keep parts alive
        if key not in self.cells:
            sign = -1.0 if negative else 1.0
            self.cells[key] = self.on_diagonal(part, sign) if diagonal else self.beside(part, sign)
        return self.cells[key]

    def on_diagonal(self, part: Part, sign: float) -> Cell:
        """The symmetric part of a block on the diagonal, its upper triangle."""
        n = part.constant.shape[0]
        i, j, _ = upper(n)
        diagonal = np.arange(n) * (n + 1)
        entries = []
        size = np.abs(part.constant).max(axis=1, initial=0) if self.near is None else np.abs(part.constant.diagonal())
        for name, slope in part.slopes.items():
            half = (-0.5 * sign) * (slope[i * n + j] + slope[j * n + i])
            entries.append((*self.listed(name, half),))
            own = np.abs(slope[diagonal])
            if self.near is None:
                size = np.maximum(size, own.max(axis=1, initial=0))
            else:
                at = self.problem.offsets[name]
                size = size + own @ self.near[at : at + slope.shape[1]]
        k, column, slope = _stacked(entries)
        constant = 0.5 * sign * (part.constant + part.constant.T)[i, j]
        known = np.flatnonzero(constant)
        return Cell(i[k], j[k], column, slope, i[known], j[known], constant[known], size, None)

    def beside(self, part: Part, sign: float) -> Cell | None:
        """A block above the diagonal, whose transpose stands below."""
        width = part.constant.shape[1]
        k, column, slope = _stacked([self.listed(name, -sign * slope) for name, slope in part.slopes.items()])
        known = np.flatnonzero(part.constant)
        if not k.size and not known.size:
            return None
        rows = columns = None
        if known.size and self.near is None:
            size = np.abs(part.constant)
            rows, columns = size.max(axis=1), size.max(axis=0)
        constant = sign * part.constant.ravel()[known]
        return Cell(k // width, k % width, column, slope, known // width, known % width, constant, rows, columns)

    def listed(self, name: str, slope: Array) -> tuple[Integers, Integers, Array]:
        """Row, column in the whole problem, and value of what is not zero."""
        row, column = np.nonzero(slope)
        return row, column + self.problem.offsets[name], slope[row, column]


def _stacked(entries: list[tuple[Integers, Integers, Array]]) -> tuple[Integers, Integers, Array]:
    if not entries:
        none = np.zeros(0, dtype=np.intp)
        return none, none, np.zeros(0)
    if len(entries) == 1:
        return entries[0]
    k, column, value = zip(*entries, strict=True)
    return np.concatenate(k), np.concatenate(column), np.concatenate(value)


def triangle(expr: Expr) -> list[tuple[Expr, ...]]:
    """Block rows of a symmetric block matrix; anything else is one block."""
    while expr.op == "let":
        expr = expr.args[1]
    if expr.op != "block":
        return [(expr,)]
    rows = expr.args[0]
    square = all(len(row) == len(rows) and row[k].shape[0] == row[k].shape[1] for k, row in enumerate(rows))
    mirrored = square and all(_mirrored(rows[a][b], rows[b][a]) for a in range(len(rows)) for b in range(a))
    return list(rows) if mirrored else [(expr,)]


def _mirrored(low: Expr, high: Expr) -> bool:
    """Whether one block is written as the transpose of the other."""
    return (low.op == "T" and low.args[0] is high) or (high.op == "T" and high.args[0] is low)


class Parts:
    """Reads expressions as parts; an operation on the very same parts is done once.  kept: coefficients so far."""

    def __init__(self, problem: Problem) -> None:
        self.held, self.kept = problem.held, 0
        self._done: dict[tuple[Any, ...], tuple[Part, tuple[Part, ...]]] = {}

    def _once(self, key: tuple[Any, ...], make: Callable[..., Part], *of: Part) -> Part:
        """The result of an operation, by its name and the identity of what it is done to, which is kept alive."""
        known = self._done.get(key)
        if known is None:
            part = make(*of)
            self.kept += part.constant.size + sum(slope.size for slope in part.slopes.values())
            known = self._done[key] = (part, of)
        return known[0]

    def leaf(self, node: Expr) -> Part:
        if node.op == "given":
            return Part(node.args[1], {})
        if node.name in self.held:
            return self._once(("held", node.name), lambda: Part(self.held[node.name], {}))
        return self._once(("leaf", node.name), lambda: Part(np.zeros(node.shape), {node.name: places(node)}))

    def number(self, value: float) -> Part:
        return self._once(("number", value), lambda: Part(np.array([[value]]), {}))

    def eye(self, n: int) -> Part:
        return self._once(("eye", n), lambda: Part(np.eye(n), {}))

    def zero(self, rows: int, columns: int) -> Part:
        return self._once(("zero", rows, columns), lambda: Part(np.zeros((rows, columns)), {}))

    def add(self, a: Part, b: Part) -> Part:
        return self._once(("add", id(a), id(b)), _sum, a, b)

    def neg(self, a: Part) -> Part:
        return self._once(("neg", id(a)), lambda a: _each(a, -a.constant, lambda s: -s), a)

    def matmul(self, a: Part, b: Part) -> Part:
        return self._once(("matmul", id(a), id(b)), _product, a, b)

    def scale(self, s: Part, a: Part) -> Part:
        return self._once(("scale", id(s), id(a)), _scaled, s, a)

    def transpose(self, a: Part) -> Part:
        return self._once(("T", id(a)), _transposed, a)

    def inv(self, a: Part) -> Part:
        if a.slopes:
            raise NotAffineError("an inverse of an unknown", why="the inequality is not linear in it")
        return Part(np.asarray(np.linalg.inv(a.constant), dtype=np.float64), {})

    def block(self, rows: list[list[Part]]) -> Part:
        constant = np.block([[b.constant for b in row] for row in rows])
        slopes: dict[str, Array] = {}
        at = 0
        for row in rows:
            left = 0
            for b in row:
                r, c = b.constant.shape
                for name, slope in b.slopes.items():
                    k = slope.shape[1]
                    whole = slopes.setdefault(name, np.zeros((constant.size, k)))
                    whole.reshape(*constant.shape, k)[at : at + r, left : left + c] = slope.reshape(r, c, k)
                left += c
            at += row[0].constant.shape[0]
        self.kept += sum(slope.size for slope in slopes.values())
        return Part(constant, slopes)


def _each(a: Part, constant: Array, change: Callable[[Array], Array]) -> Part:
    return Part(constant, {name: change(slope) for name, slope in a.slopes.items()})


def _sum(a: Part, b: Part) -> Part:
    slopes = dict(a.slopes)
    for name, slope in b.slopes.items():
        slopes[name] = slopes[name] + slope if name in slopes else slope
    return Part(a.constant + b.constant, slopes)


def _transposed(a: Part) -> Part:
    order = np.arange(a.constant.size).reshape(a.constant.shape).T.ravel()
    return _each(a, a.constant.T, lambda s: s[order])


def _product(a: Part, b: Part) -> Part:
    (r, k), c, constant = a.constant.shape, b.constant.shape[1], a.constant @ b.constant
    if a.slopes and b.slopes:
        raise NotAffineError("a product of two unknowns", why="the inequality is not linear in them")
    if b.slopes:
        return _each(b, constant, lambda s: (a.constant @ s.reshape(k, c * s.shape[1])).reshape(r * c, s.shape[1]))
    return _each(a, constant, lambda s: (b.constant.T @ s.reshape(r, k, s.shape[1])).reshape(r * c, s.shape[1]))


def _scaled(s: Part, a: Part) -> Part:
    constant = s.constant[0, 0] * a.constant
    if s.slopes and a.slopes:
        raise NotAffineError("a product of two unknowns", why="the inequality is not linear in them")
    if a.slopes:
        return _each(a, constant, lambda slope: s.constant[0, 0] * slope)
    return _each(s, constant, lambda slope: a.constant.reshape(-1, 1) * slope)
