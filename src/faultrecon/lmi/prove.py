# SPDX-License-Identifier: BSD-3-Clause
"""From an expression to a stored statement, and its proof with fast integers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from faultrecon.lmi.exact import Definite, Dyadic, DyadicAlgebra, IntMatrix, letters_from, prove_positive, read_tree
from faultrecon.lmi.expr import Expr, Inequality
from faultrecon.lmi.walk import leaves

Tree = Any  # a letter, or [operation, arguments...]: what JSON can hold


def tree(expr: Expr) -> Tree:
    """The expression as nested lists of letters and operations; given matrices and named parts by their letter."""
    match expr.op:
        case "given" | "unknown" | "let":
            return expr.name
        case "number":
            return ["number", float(expr.args[0]).hex()]
        case "eye":
            return ["eye", expr.args[0]]
        case "zero":
            return ["zero", *expr.shape]
        case "block":
            return ["block", [[tree(b) for b in row] for row in expr.args[0]]]
        case "inv":
            raise ValueError("an inverse is no statement about exact numbers; multiply it out")
    return [expr.op, *(tree(a) for a in expr.args)]


@dataclass(frozen=True)
class Statement:
    """An inequality ready to be stored: its tree, the definitions of its named parts, the data it is about."""

    tree: Tree
    lets: dict[str, Tree]
    data: dict[str, np.ndarray]

    def prove(self, algebra: DyadicAlgebra | None = None) -> Definite:
        """Decide whether the matrix is positive definite, exactly."""
        algebra = algebra or fast_algebra()
        data = {name: exact(value, algebra) for name, value in self.data.items()}
        letters = letters_from(data, self.lets, algebra)
        return prove_positive(read_tree(self.tree, letters.__getitem__, algebra), algebra)


def statement(inequality: Inequality, values: Mapping[str, Any]) -> Statement:
    """The claim `positive side > 0` with every unknown given its number."""
    expr = inequality.positive
    data = {name: leaf.args[1] for name, leaf in leaves([expr], "given").items()}
    for name, leaf in leaves([expr], "unknown").items():
        data[name] = np.asarray(values[name], dtype=float).reshape(leaf.shape)
    lets = {name: tree(node.args[1]) for name, node in leaves([expr], "let").items()}
    return Statement(tree(expr), lets, data)


def exact(value: Any, algebra: DyadicAlgebra) -> Dyadic:
    """A float array as an exact matrix."""
    array = np.atleast_2d(np.asarray(value, dtype=float))
    rows, columns = array.shape
    return algebra.from_floats(rows, columns, array.ravel().tolist())


def fast_algebra() -> DyadicAlgebra:
    """Exact algebra over python-flint's integer matrices where it is installed, else over Python's own."""
    try:
        from flint import fmpz_mat
    except ImportError:
        return DyadicAlgebra(IntMatrix)
    return DyadicAlgebra(lambda rows, columns, values: fmpz_mat(rows, columns, [v for row in values for v in row]))
