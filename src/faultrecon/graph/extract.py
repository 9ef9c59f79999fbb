# SPDX-License-Identifier: BSD-3-Clause
"""The road between CasADi's expressions and our list of instructions, in both directions."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

from faultrecon.finding import InputError
from faultrecon.graph.walk import OPERATIONS, Node


def instructions(function: Any) -> tuple[tuple[Node, ...], tuple[int, ...]]:
    """Nodes and outputs of a CasADi function: equal sub-expressions once, nothing unused."""
    import casadi as ca

    nodes: list[Node] = []
    numbers: dict[Node, int] = {}

    def number(node: Node) -> int:
        if node not in numbers:
            numbers[node] = len(nodes)
            nodes.append(node)
        return numbers[node]

    register: dict[int, int] = {}
    outputs: dict[int, int] = {}
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        operands, results = function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            outputs[results[1]] = register[operands[0]]
            continue
        if op == ca.OP_INPUT:
            node = number(("input", int(operands[0]), int(operands[1])))
        elif op == ca.OP_CONST:
            node = number(("const", float(function.instruction_constant(k)).hex()))
        else:
            node = _operation(op, [register[i] for i in operands], number)
        register[results[0]] = node
    return used(nodes, [outputs[i] for i in sorted(outputs)])


def _operation(op: int, operands: list[int], number: Callable[[Node], int]) -> int:
    """One arithmetic instruction; the few that CasADi has beside ours become the same bits in ours."""
    names, twice, inverse, copy = _casadi_names()
    if op == copy:
        return operands[0]
    if op == twice:
        return number(("mul", number(("const", (2.0).hex())), operands[0]))
    if op == inverse:
        return number(("div", number(("const", (1.0).hex())), operands[0]))
    if op not in names:
        raise InputError(f"CasADi operation {op} has no place in an expression graph; known: {', '.join(OPERATIONS)}")
    return number((names[op], *operands))


def used(nodes: Sequence[Node], outputs: Sequence[int]) -> tuple[tuple[Node, ...], tuple[int, ...]]:
    """The nodes that some output needs, renumbered in order."""
    wanted = set(outputs)
    for i in reversed(range(len(nodes))):
        if i in wanted and nodes[i][0] in OPERATIONS:
            wanted.update(int(j) for j in nodes[i][1:])
    new = {old: i for i, old in enumerate(sorted(wanted))}
    kept = [
        (nodes[old][0], *(new[int(j)] for j in nodes[old][1:])) if nodes[old][0] in OPERATIONS else nodes[old]
        for old in sorted(wanted)
    ]
    return tuple(kept), tuple(new[i] for i in outputs)


@cache
def _casadi_names() -> tuple[dict[int, str], int, int, int]:
    """Our name of each CasADi instruction, and the three that are rewritten."""
    import casadi as ca

    other = {"abs": "FABS", "min": "FMIN", "max": "FMAX"} | {f"logical_{w}": w.upper() for w in ("and", "or", "not")}
    names = {getattr(ca, f"OP_{other.get(name, name.upper())}"): name for name in OPERATIONS}
    return names | {ca.OP_CONSTPOW: "pow"}, ca.OP_TWICE, ca.OP_INV, ca.OP_ASSIGN


@cache
def casadi_algebra() -> dict[str, Callable[..., Any]]:
    """CasADi scalars as an algebra: what rebuilds a function from a graph."""
    import casadi as ca

    named = "sqrt exp log sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh log1p expm1 sign floor ceil"
    signs = {w: getattr(operator, w) for w in ["add", "sub", "mul", "neg", "pow", "lt", "le", "eq", "ne"]}
    return (
        signs
        | {name: getattr(ca, name) for name in f"{named} atan2 hypot".split()}
        | {"const": ca.SX, "div": operator.truediv, "sq": lambda x: x**2}
        | {"abs": ca.fabs, "min": ca.fmin, "max": ca.fmax, "if_else_zero": lambda c, x: ca.if_else(c, x, 0.0)}
        | {"logical_and": ca.logic_and, "logical_or": ca.logic_or, "logical_not": ca.logic_not}
    )


def scalars(result: Any) -> list[Any]:
    """What traced code returned, as scalar expressions."""
    import casadi as ca

    try:
        parts = (
            result
            if isinstance(result, list | tuple)
            else list(np.ravel(result))
            if isinstance(result, np.ndarray)
            else [result]
        )
        column = ca.densify(ca.vertcat(*[ca.SX(part) for part in parts]))
    except (NotImplementedError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(
            f"a traced function must return a vector of expressions, not {type(result).__name__}"
        ) from error
    if column.shape[1] != 1:
        raise InputError(f"a traced function must return one vector, not a matrix of shape {column.shape}")
    return [column[i] for i in range(column.shape[0])]


@contextmanager
def array_semantics() -> Iterator[None]:
    """NumPy functions keep CasADi's columns as they are, whatever this process has set, and its setting comes back.

    A constant vector (n,) times a column (n, 1) is then element by element, as it is for two NumPy vectors; the other
    mode would broadcast it to a matrix.
    """
    import casadi as ca

    before = ca.GlobalOptions.getNumpyMode()
    ca.GlobalOptions.setNumpyMode(-1)
    try:
        yield
    finally:
        ca.GlobalOptions.setNumpyMode(before)
