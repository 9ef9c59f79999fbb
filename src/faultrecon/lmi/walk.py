# SPDX-License-Identifier: BSD-3-Clause
"""Reading an expression: with an algebra, for its letters, or with some of its unknowns replaced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol

import numpy as np

from faultrecon.finding import InputError
from faultrecon.lmi.expr import Expr, ShapeError


class Algebra(Protocol):
    """What a reading of an expression has to provide; `leaf` answers for given matrices and unknowns."""

    def leaf(self, node: Expr) -> Any: ...
    def number(self, value: float) -> Any: ...
    def eye(self, n: int) -> Any: ...
    def zero(self, rows: int, columns: int) -> Any: ...
    def add(self, a: Any, b: Any) -> Any: ...
    def neg(self, a: Any) -> Any: ...
    def matmul(self, a: Any, b: Any) -> Any: ...
    def scale(self, s: Any, a: Any) -> Any: ...
    def transpose(self, a: Any) -> Any: ...
    def inv(self, a: Any) -> Any: ...
    def block(self, rows: list[list[Any]]) -> Any: ...


def evaluate(expr: Expr, algebra: Algebra, memo: dict[int, Any] | None = None) -> Any:
    """Read `expr` with `algebra`; shared subexpressions are read once (pass one `memo` to share across calls)."""
    memo = {} if memo is None else memo
    if id(expr) in memo:
        return memo[id(expr)][1]

    def go(node: Expr) -> Any:
        return evaluate(node, algebra, memo)

    match expr.op:
        case "given" | "unknown":
            value = algebra.leaf(expr)
        case "let":
            value = go(expr.args[1])
        case "number":
            value = algebra.number(expr.args[0])
        case "eye":
            value = algebra.eye(expr.args[0])
        case "zero":
            value = algebra.zero(*expr.shape)
        case "add":
            value = algebra.add(go(expr.args[0]), go(expr.args[1]))
        case "neg":
            value = algebra.neg(go(expr.args[0]))
        case "matmul":
            value = algebra.matmul(go(expr.args[0]), go(expr.args[1]))
        case "scale":
            value = algebra.scale(go(expr.args[0]), go(expr.args[1]))
        case "T":
            value = algebra.transpose(go(expr.args[0]))
        case "inv":
            value = algebra.inv(go(expr.args[0]))
        case "block":
            value = algebra.block([[go(b) for b in row] for row in expr.args[0]])
    memo[id(expr)] = (expr, value)  # the node is kept alive so that its id cannot be reused
    return value


class FloatAlgebra:
    """Reads an expression in floating point, unknowns from a mapping of name to array."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.values = values

    def leaf(self, node: Expr) -> np.ndarray:
        """The array of a given matrix or of an unknown."""
        if node.op == "given":
            return node.args[1]
        if node.name not in self.values:
            raise InputError(f"no value is given for the unknown {node.name}")
        return np.asarray(self.values[node.name], dtype=float).reshape(node.shape)

    def number(self, value: float) -> np.ndarray:
        return np.array([[value]])

    def eye(self, n: int) -> np.ndarray:
        return np.eye(n)

    def zero(self, rows: int, columns: int) -> np.ndarray:
        return np.zeros((rows, columns))

    def add(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a + b

    def neg(self, a: np.ndarray) -> np.ndarray:
        return -a

    def matmul(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a @ b

    def scale(self, s: np.ndarray, a: np.ndarray) -> np.ndarray:
        return s[0, 0] * a

    def transpose(self, a: np.ndarray) -> np.ndarray:
        return a.T

    def inv(self, a: np.ndarray) -> np.ndarray:
        return np.linalg.inv(a)

    def block(self, rows: list[list[np.ndarray]]) -> np.ndarray:
        return np.block(rows)


def value_of(expr: Expr, values: Mapping[str, Any]) -> np.ndarray:
    """The floating-point value of `expr` with its unknowns taken from `values` (name to array)."""
    return evaluate(expr, FloatAlgebra(values))


def leaves(exprs: Sequence[Expr], op: Literal["given", "unknown", "let"]) -> dict[str, Expr]:
    """Every leaf (or named expression, innermost first) of one kind in `exprs`, by name.

    Raises ShapeError when one letter stands for two different things.
    """
    found: dict[str, Expr] = {}
    seen: set[int] = set()

    def visit(node: Expr) -> None:
        if id(node) in seen:
            return
        seen.add(id(node))
        for child in children(node):
            visit(child)
        if node.op == op:
            known = found.setdefault(node.name, node)
            same_value = op == "given" and np.array_equal(known.args[1], node.args[1])
            if known is not node and not same_value:
                raise ShapeError(f"the letter {node.name} stands for two things in one statement")

    for expr in exprs:
        visit(expr)
    return found


def children(node: Expr) -> list[Expr]:
    """The direct subexpressions of a node."""
    if node.op == "block":
        return [b for row in node.args[0] for b in row]
    return [a for a in node.args if isinstance(a, Expr)]


def substitute(exprs: Sequence[Expr], by: Mapping[str, Expr]) -> list[Expr]:
    """`exprs` with unknowns replaced by expressions of their shape, `Z := P L` say; named parts keep their letters.

    What contains none of them comes back as the same node, so that a substitute may speak of it too.
    """
    memo: dict[int, tuple[Expr, Expr]] = {}

    def go(node: Expr) -> Expr:
        if id(node) not in memo:
            memo[id(node)] = (node, rebuilt(node))  # the node is kept alive so that its id cannot be reused
        return memo[id(node)][1]

    def rebuilt(node: Expr) -> Expr:
        if node.op == "unknown":
            new = by.get(node.name, node)
            if new.shape != node.shape:
                raise ShapeError(f"{node.name} is {node.shape}, its substitute {new} is {new.shape}")
            return new
        if node.op == "block":
            rows = tuple(tuple(go(b) for b in row) for row in node.args[0])
            same = all(map(_same, rows, node.args[0]))
            return node if same else Expr("block", (rows,), node.shape)
        args = tuple(go(a) if isinstance(a, Expr) else a for a in node.args)
        return node if _same(args, node.args) else Expr(node.op, args, node.shape)

    return [go(expr) for expr in exprs]


def _same(left: Sequence[Any], right: Sequence[Any]) -> bool:
    """Whether two rows hold the very same objects."""
    return all(a is b for a, b in zip(left, right, strict=True))
