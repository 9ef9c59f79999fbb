# SPDX-License-Identifier: BSD-3-Clause
"""Read an expression graph as program text: one Python assignment per instruction, every number a literal.

Nothing a user wrote reaches the text.  Operations are looked up in the table below, operands are integers, numbers are
floats written with all their bits, and the names of inputs and results are chosen by the caller in this package.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from faultrecon.finding import InputError
from faultrecon.graph.walk import Node

#: What each operation is in scalar Python, for a compiler that treats division by zero as IEEE does.  `min` and `max`
#: are C's fmin and fmax: a NaN loses.  {0} and {1} are operands that may be evaluated twice.
PYTHON: Mapping[str, str] = MappingProxyType(
    {
        "add": "({0} + {1})", "sub": "({0} - {1})", "mul": "({0} * {1})", "div": "({0} / {1})", "neg": "(-{0})",
        "sq": "({0} * {0})", "pow": "({0} ** {1})", "abs": "abs({0})",
        "min": "({0} if {0} <= {1} or {1} != {1} else {1})", "max": "({0} if {0} >= {1} or {1} != {1} else {1})",
        "lt": "(1.0 if {0} < {1} else 0.0)", "le": "(1.0 if {0} <= {1} else 0.0)",
        "eq": "(1.0 if {0} == {1} else 0.0)", "ne": "(1.0 if {0} != {1} else 0.0)",
        "logical_and": "(1.0 if {0} != 0.0 and {1} != 0.0 else 0.0)",
        "logical_or": "(1.0 if {0} != 0.0 or {1} != 0.0 else 0.0)",
        "logical_not": "(1.0 if {0} == 0.0 else 0.0)",
        "if_else_zero": "({1} if {0} != 0.0 else 0.0)",
        "sign": "(1.0 if {0} > 0.0 else (-1.0 if {0} < 0.0 else {0}))",
    }
    | {
        name: f"math.{name}({{0}})"
        for name in ["sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
                     "asinh", "acosh", "atanh", "log1p", "expm1"]
    }
    | {"floor": "np.floor({0})", "ceil": "np.ceil({0})"}
    | {name: f"math.{name}({{0}}, {{1}})" for name in ("atan2", "hypot")}
)  # fmt: skip

_ONCE = frozenset(name for name, text in PYTHON.items() if text.count("{0}") < 2 and text.count("{1}") < 2)


def literal(value: float) -> str:
    """A float as text that reads back to the same bits; inf and nan are names the program must know."""
    value = float(value)
    text = "nan" if math.isnan(value) else repr(value)  # repr gives inf as inf, and every float its shortest digits
    return f"({text})" if text.startswith("-") else text


def statements(
    nodes: Sequence[Node],
    outputs: Sequence[int],
    inputs: Sequence[Sequence[str]],
    results: Sequence[str],
    prefix: str,
) -> list[str]:
    """The assignments that compute `results` from `inputs`, in the order of the instructions.

    inputs: the text of every component, by input group; results: one target per output; prefix: begins the names of
    intermediate values.  A value used once is written where it is used: the compiler then has fewer names to carry.
    Raises InputError for an operation that is not in `PYTHON`.
    """
    uses = Counter(int(i) for kind, *operands in nodes if kind in PYTHON for i in operands) + Counter(outputs)
    doubled = {int(i) for kind, *operands in nodes if kind in PYTHON and kind not in _ONCE for i in operands}
    lines: list[str] = []
    value: list[str] = []
    for k, (kind, *operands) in enumerate(nodes):
        if kind == "input":
            value.append(inputs[int(operands[0])][int(operands[1])])
        elif kind == "const":
            value.append(literal(float.fromhex(str(operands[0]))))
        elif kind in PYTHON:
            text = PYTHON[str(kind)].format(*(value[int(i)] for i in operands))
            if uses[k] > 1 or k in doubled or len(text) > _LONG:
                lines.append(f"{prefix}{k} = {text}")
                text = f"{prefix}{k}"
            value.append(text)
        else:
            raise InputError(f"the operation '{kind}' has no program text")
    return lines + [f"{name} = {value[i]}" for name, i in zip(results, outputs, strict=True)]


_LONG = 120  # characters in one expression: longer ones nest too deep to read, and compile no faster
