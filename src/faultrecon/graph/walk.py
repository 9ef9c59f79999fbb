# SPDX-License-Identifier: BSD-3-Clause
"""Read one expression graph in many ways: as numbers, as intervals, as symbols, as program text.

A graph is a list of instructions; an algebra says what each operation means. `walk` plays the first through the second.
Evaluation on arrays, rigorous enclosure, rebuilding with CasADi and code generation are all algebras.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError

if TYPE_CHECKING:
    from faultrecon.graph.function import Graph

#: ("input", group, component), ("const", hexadecimal float) or (operation, operand, ...), operands being earlier nodes.
Node = tuple[str | int, ...]

# fmt: off
_UNARY = ["neg", "sq", "sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
          "asinh", "acosh", "atanh", "log1p", "expm1", "abs", "sign", "floor", "ceil", "logical_not"]
_BINARY = ["add", "sub", "mul", "div", "pow", "atan2", "hypot", "min", "max", "lt", "le", "eq", "ne", "logical_and",
           "logical_or", "if_else_zero"]
# fmt: on

#: Every operation a graph may hold, with the number of its operands. Truth values are the numbers 1 and 0;
#: `if_else_zero(c, x)` is x where c is true and 0 elsewhere, even if x is not a number there.
OPERATIONS: Mapping[str, int] = MappingProxyType({**dict.fromkeys(_UNARY, 1), **dict.fromkeys(_BINARY, 2)})


def walk(graph: Graph, algebra: Any, *inputs: Sequence[Any] | NDArray[Any]) -> list[Any]:
    """Play the instructions of a graph through an algebra; one value per output comes back.

    algebra: a mapping or an object that has `const(float)` and, by the names in `OPERATIONS`, every operation the graph
    uses (`sq` falls back on `mul`). inputs: one sequence of component values per input group, in the order of
    `graph.inputs`. Raises InputError when an operation is missing or the number of values is wrong.
    """
    sizes = [len(components) for components in graph.inputs.values()]
    if [len(values) for values in inputs] != sizes:
        raise InputError(
            f"this graph takes inputs of {sizes} components, {[len(v) for v in inputs]} were given",
            remedies=(f"give {', '.join(graph.inputs)} in this order",),
        )
    meaning = {op: _meaning(algebra, op) for op in {str(node[0]) for node in graph.nodes} - {"input"}}
    values: list[Any] = []
    for kind, *operands in graph.nodes:
        op = str(kind)
        if op == "input":
            group, component = operands
            values.append(inputs[int(group)][int(component)])
        elif op == "const":
            values.append(meaning[op](float.fromhex(str(operands[0]))))
        else:
            values.append(meaning[op](*(values[int(i)] for i in operands)))
    return [values[i] for i in graph.outputs]


def _meaning(algebra: Any, op: str) -> Callable[..., Any]:
    """What one operation is in this algebra."""
    found = algebra.get(op) if isinstance(algebra, Mapping) else getattr(algebra, op, None)
    if found is not None:
        return found
    if op == "sq":
        multiply = _meaning(algebra, "mul")
        return lambda x: multiply(x, x)
    raise InputError(f"the operation '{op}' has no meaning in {type(algebra).__name__}")


#: Arrays of any one shape, element by element. NaN handling of `min` and `max` is that of C's fmin and fmax.
NUMPY: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {
        "const": np.float64,
        "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative,
        "sq": np.square, "sqrt": np.sqrt, "pow": np.power, "exp": np.exp, "log": np.log,
        "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
        "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh,
        "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh, "log1p": np.log1p, "expm1": np.expm1,
        "abs": np.abs, "sign": np.sign, "floor": np.floor, "ceil": np.ceil, "hypot": np.hypot,
        "min": np.fmin, "max": np.fmax,
        "lt": lambda a, b: np.less(a, b) * 1.0,
        "le": lambda a, b: np.less_equal(a, b) * 1.0,
        "eq": lambda a, b: np.equal(a, b) * 1.0,
        "ne": lambda a, b: np.not_equal(a, b) * 1.0,
        "logical_and": lambda a, b: np.logical_and(a, b) * 1.0,
        "logical_or": lambda a, b: np.logical_or(a, b) * 1.0,
        "logical_not": lambda a: np.logical_not(a) * 1.0,
        "if_else_zero": lambda c, x: np.where(np.not_equal(c, 0.0), x, 0.0),
    }
)  # fmt: skip
