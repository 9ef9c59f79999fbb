# SPDX-License-Identifier: BSD-3-Clause
"""Matrix expressions in a paper's letters: written once, then solved, proved, evaluated and stored.

An `Expr` is a small immutable tree.  Leaves are given matrices (`given`), unknowns (`unknown`), identities (`I`) and
numbers; inner nodes are sums, products, transposes, scalings and blocks.  Shapes are checked as the tree grows, so a
mistake surfaces on the line that makes it.  Nothing here solves or rounds anything: `lmi.walk` reads a tree with any
algebra (floating point, exact integers, affine forms), which is how one inequality is read many ways.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np

from faultrecon.finding import InputError

Op = Literal["given", "unknown", "let", "number", "eye", "zero", "add", "neg", "matmul", "scale", "T", "inv", "block"]


class ShapeError(InputError):
    """Two matrices of a formula do not fit together."""


@dataclass(frozen=True, eq=False, repr=False)
class Expr:
    """One node: `op` with its arguments; `shape` is (rows, columns) and either may be zero."""

    op: Op
    args: tuple[Any, ...]
    shape: tuple[int, int]

    __array_ufunc__ = None  # a NumPy array on the left must not broadcast over an expression

    @property
    def name(self) -> str:
        """The letter of a leaf or of a named expression."""
        if self.op not in ("given", "unknown", "let"):
            raise TypeError(f"a {self.op} node has no name")
        return self.args[0]

    @property
    def T(self) -> Expr:
        """The transpose."""
        return self.args[0] if self.op == "T" else Expr("T", (self,), (self.shape[1], self.shape[0]))

    def inv(self) -> Expr:
        """The inverse, for gains alone: an inequality that contains it is not affine and cannot be solved."""
        if self.shape[0] != self.shape[1]:
            raise ShapeError(f"cannot invert a {self.shape} matrix", why="it is not square")
        return Expr("inv", (self,), self.shape)

    def __add__(self, other: Expr | float) -> Expr:
        other = as_expr(other, like=self)
        if self.shape != other.shape:
            raise ShapeError(f"cannot add {self} {self.shape} and {other} {other.shape}", why="the shapes differ")
        return Expr("add", (self, other), self.shape)

    __radd__ = __add__

    def __neg__(self) -> Expr:
        return self.args[0] if self.op == "neg" else Expr("neg", (self,), self.shape)

    def __sub__(self, other: Expr | float) -> Expr:
        return self + (-as_expr(other, like=self))

    def __rsub__(self, other: Expr | float) -> Expr:
        return as_expr(other, like=self) - self

    def __matmul__(self, other: Expr) -> Expr:
        if self.shape[1] != other.shape[0]:
            raise ShapeError(
                f"cannot multiply {self} {self.shape} by {other} {other.shape}",
                why=f"{self.shape[1]} columns meet {other.shape[0]} rows",
            )
        return Expr("matmul", (self, other), (self.shape[0], other.shape[1]))

    def __mul__(self, other: Expr | float) -> Expr:
        other = as_expr(other)
        if self.shape == (1, 1):
            return Expr("scale", (self, other), other.shape)
        if other.shape == (1, 1):
            return Expr("scale", (other, self), self.shape)
        raise ShapeError(f"'*' scales by a number; {self} is {self.shape}", remedies=("use '@' for matrix products",))

    __rmul__ = __mul__

    def __pow__(self, exponent: int) -> Expr:
        if exponent != 2 or self.shape != (1, 1):
            raise ShapeError(f"only the square of a scalar is meant here, not {self}**{exponent}")
        return self * self

    def __lt__(self, bound: int) -> Inequality:
        return Inequality(self, "<", bound)

    def __gt__(self, bound: int) -> Inequality:
        return Inequality(self, ">", bound)

    def __str__(self) -> str:
        return show(self)

    def __repr__(self) -> str:
        return f"<{show(self)} {self.shape[0]}x{self.shape[1]}>"


@dataclass(frozen=True, eq=False)
class Inequality:
    """A strict definiteness claim on a symmetric matrix, `expr < 0` or `expr > 0`, with an optional equation number."""

    expr: Expr
    sense: Literal["<", ">"]
    bound: int = 0
    label: str = ""

    def __post_init__(self) -> None:
        if self.bound != 0:
            raise ShapeError("an inequality compares with 0", remedies=("move the bound to the left side",))
        if self.expr.shape[0] != self.expr.shape[1]:
            raise ShapeError(f"{self.expr} {self.expr.shape} cannot be definite", why="it is not square")

    def tagged(self, label: str) -> Inequality:
        """The same inequality under an equation number, say '(3.1)'."""
        return Inequality(self.expr, self.sense, 0, label)

    @property
    def positive(self) -> Expr:
        """The side that is claimed positive definite."""
        return self.expr if self.sense == ">" else -self.expr

    def __str__(self) -> str:
        return f"{self.label + ' ' if self.label else ''}{self.expr} {self.sense} 0"

    def __bool__(self) -> bool:
        raise TypeError("an Inequality is a statement, not a truth value; prove it or evaluate it")


class _Below:
    """The mark `__` in a block matrix: this block is fixed by symmetry."""

    def __repr__(self) -> str:
        return "__"


__ = _Below()


def given(name: str, value: Any) -> Expr:
    """A matrix that is known, under its letter; value: (r, c) array or a number.  Copied, and must be finite."""
    array = np.array(value, dtype=float, ndmin=2)
    if array.ndim != 2:
        raise ShapeError(f"{name} has {array.ndim} dimensions", why="a matrix has two")
    if not np.all(np.isfinite(array)):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"{name}{list(where)} is {array[where]}", why="every entry must be a finite number")
    array.setflags(write=False)
    return Expr("given", (name, array), (array.shape[0], array.shape[1]))


def unknown(name: str, rows: int = 1, columns: int = 1, *, symmetric: bool = False) -> Expr:
    """A matrix to be found, (rows, columns); `symmetric` halves its freedom."""
    if symmetric and rows != columns:
        raise ShapeError(f"{name} ({rows}, {columns}) cannot be symmetric", why="it is not square")
    return Expr("unknown", (name, symmetric), (rows, columns))


def let(name: str, expr: Expr) -> Expr:
    """A named expression: it keeps its letter in print and in the certificate, and its meaning in every algebra."""
    return Expr("let", (name, expr), expr.shape)


def I(n: int) -> Expr:
    """The n by n identity."""
    return Expr("eye", (n,), (n, n))


@cache
def zeros(rows: int, columns: int) -> Expr:
    """The zero matrix: one node for each shape, since a vertex has dozens of them."""
    return Expr("zero", (), (rows, columns))


def as_expr(value: Expr | float, like: Expr | None = None) -> Expr:
    """A number becomes a 1 by 1 leaf; a zero takes the shape of its neighbour."""
    if isinstance(value, Expr):
        return value
    if isinstance(value, (int, float, np.integer, np.floating)):
        if value == 0 and like is not None:
            return zeros(*like.shape)
        return Expr("number", (float(value),), (1, 1))
    raise ShapeError(f"{type(value).__name__} stands in a formula", remedies=("name it: given('M', array)",))


def sym(rows: Sequence[Sequence[Any]]) -> Expr:
    """A symmetric block matrix of which the upper triangle is written; `__` below the diagonal, `0` for a zero block.

    Raises ShapeError that names the block: ``block (1,2) is (2, 2), the diagonal asks for (2, 1)``.
    """
    k = len(rows)
    for i, row in enumerate(rows):
        if len(row) != k:
            raise ShapeError(f"block row {i + 1} has {len(row)} blocks", why=f"the matrix has {k} block rows")
        if not isinstance(row[i], Expr):
            raise ShapeError(f"block ({i + 1},{i + 1}) is {row[i]!r}", why="diagonal blocks give the sizes")
        if row[i].shape[0] != row[i].shape[1]:
            raise ShapeError(f"block ({i + 1},{i + 1}) is {row[i].shape}", why="diagonal blocks are square")
    size = [rows[i][i].shape[0] for i in range(k)]
    full: list[list[Any]] = [[None] * k for _ in range(k)]
    for i in range(k):
        for j in range(k):
            block = rows[i][j]
            if j < i:
                if block is not __:
                    raise ShapeError(f"block ({i + 1},{j + 1}) is written", why="symmetry fixes it: write __")
                continue
            if block is __:
                raise ShapeError(f"block ({i + 1},{j + 1}) is __", why="the upper triangle has to be written")
            if not isinstance(block, Expr):
                if not (isinstance(block, (int, float)) and block == 0):
                    raise ShapeError(f"block ({i + 1},{j + 1}) is {block!r}", why="a block is an expression or 0")
                block = zeros(size[i], size[j])
            if block.shape != (size[i], size[j]):
                raise ShapeError(
                    f"block ({i + 1},{j + 1}) is {block.shape}, the diagonal asks for ({size[i]}, {size[j]})"
                )
            full[i][j] = block
            if j > i:
                full[j][i] = block.T
    return Expr("block", (tuple(tuple(row) for row in full),), (sum(size), sum(size)))


def blocks(rows: Sequence[Sequence[Expr]]) -> Expr:
    """A block matrix without symmetry, every block written; its shapes are checked like those of `sym`."""
    heights, widths = [row[0].shape[0] for row in rows], [block.shape[1] for block in rows[0]]
    for i, row in enumerate(rows):
        if [b.shape for b in row] != [(heights[i], w) for w in widths]:
            raise ShapeError(f"block row {i + 1} has {[b.shape for b in row]}", why=f"the columns are {widths} wide")
    return Expr("block", (tuple(tuple(row) for row in rows),), (sum(heights), sum(widths)))


def show(node: Expr, tight: bool = False) -> str:
    """The expression as one line of text in the paper's letters; named parts by their letter."""
    match node.op:
        case "given" | "unknown" | "let":
            return node.args[0]
        case "number":
            return f"{node.args[0]:g}"
        case "eye":
            return f"I{node.args[0]}"
        case "zero":
            return "0"
        case "T":
            return show(node.args[0], True) + "ᵀ"
        case "inv":
            return show(node.args[0], True) + "⁻¹"
        case "matmul":
            text = f"{show(node.args[0], True)} {show(node.args[1], True)}"
            return f"({text})" if tight else text
        case "scale":
            text = f"{show(node.args[0], True)}·{show(node.args[1], True)}"
            return f"({text})" if tight else text
        case "neg":
            text = f"-{show(node.args[0], True)}"
        case "add":
            left, right = node.args
            minus = right.op == "neg"
            text = f"{show(left)} {'-' if minus else '+'} {show(right.args[0] if minus else right, minus)}"
        case "block":
            return "[" + "; ".join(", ".join(show(b) for b in row) for row in node.args[0]) + "]"
    return f"({text})" if tight else text
