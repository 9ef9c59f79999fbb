# SPDX-License-Identifier: BSD-3-Clause
"""Turn the text of a formula into a symbolic expression without ever evaluating the text.

The text is parsed by `ast` and walked over the whitelist below; whatever is not on it is refused with its place.
Every function here raises InputError and nothing else, whatever the text.
"""

from __future__ import annotations

import ast
import math
import operator
import unicodedata
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NoReturn

from faultrecon.finding import InputError, did_you_mean

if TYPE_CHECKING:
    import casadi

# The whitelist: numbers, declared names and constants, these operators, these functions (least and most arguments).
OPERATORS: Mapping[type[ast.operator], tuple[str, Callable[..., Any]]] = {
    ast.Add: ("+", operator.add),
    ast.Sub: ("-", operator.sub),
    ast.Mult: ("*", operator.mul),
    ast.Div: ("/", operator.truediv),
    ast.Pow: ("**", operator.pow),
}
FUNCTIONS: Mapping[str, tuple[int, float]] = {
    **dict.fromkeys(["sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"], (1, 1)),
    **dict.fromkeys(["exp", "log", "sqrt", "abs", "sign", "sat"], (1, 1)),
    **dict.fromkeys(["atan2", "pow"], (2, 2)),
    **dict.fromkeys(["min", "max"], (2, math.inf)),
}
# Bounds that keep Python's own parser and this walk far from their limits on every platform.
LONGEST = 10_000
DEEPEST = 100


def parse(
    text: str,
    names: Mapping[str, casadi.SX],
    *,
    constants: Mapping[str, float] | None = None,
    where: str = "",
) -> casadi.SX:
    """The expression a formula stands for, a (1, 1) SX.

    names: what each signal name stands for; constants: numbers by name; where: the place of the text, for messages
    ('plant.toml:12  nonlinearity.phi[0]'). Raises InputError for anything off the whitelist, with place and column.
    """
    if not isinstance(text, str):
        raise InputError(_at(where, f"a formula is text, not {type(text).__name__}"), remedies=("put it in quotes",))
    if len(text) > LONGEST:
        raise InputError(_at(where, f"a formula of {len(text)} characters, {LONGEST} at most"))
    # One line of single blanks for tabs and line ends: a column in a message is then a position in the text.
    line = "".join(" " if c in "\t\n\r\f\v" else c for c in text)
    reader = _Reader(
        line,
        {unicodedata.normalize("NFKC", name): value for name, value in names.items()},
        {unicodedata.normalize("NFKC", name): float(value) for name, value in (constants or {}).items()},
        where,
    )
    return reader.read()


def _at(where: str, what: str) -> str:
    return f"{where}: {what}" if where else what


@cache
def _functions() -> Mapping[str, Callable[..., Any]]:
    """What each function name builds."""
    import casadi as ca

    return {name: getattr(ca, name) for name in FUNCTIONS if hasattr(ca, name)} | {
        "abs": ca.fabs,
        "pow": lambda x, y: x**y,
        "min": ca.fmin,
        "max": ca.fmax,
        "sat": lambda x: ca.fmin(ca.fmax(x, -1.0), 1.0),
    }


@dataclass(frozen=True)
class _Reader:
    """One formula being read: its line, and what its names stand for."""

    line: str
    names: Mapping[str, Any]
    constants: Mapping[str, float]
    where: str

    def read(self) -> Any:
        """The whole line as one expression."""
        self._check_nesting()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                tree = ast.parse(self.line.strip(" "), mode="eval")
        except SyntaxError as error:
            self.refuse(f"not a formula ({error.msg})", self._indent() + (error.offset or 1) - 1)
        except (RecursionError, MemoryError):
            self.refuse("nested too deeply")
        except ValueError:
            self.refuse("not a formula (a character that is not text)")
        return self.expression(tree.body, 0)

    def expression(self, node: ast.expr, depth: int) -> Any:
        """An expression of any kind on the whitelist."""
        if depth > DEEPEST:
            self.refuse(f"nested deeper than {DEEPEST} levels", node)
        match node:
            case ast.Constant():
                value = self._symbol(self.number(node))
            case ast.Name():
                value = self.name(node)
            case ast.UnaryOp(op=ast.USub()):
                value = -self.expression(node.operand, depth + 1)
            case ast.UnaryOp(op=ast.UAdd()):
                value = self.expression(node.operand, depth + 1)
            case ast.BinOp():
                value = self.chain(node, depth)
            case ast.Call():
                value = self.call(node, depth)
            case _:
                self.refuse(f"{_kind(node)} is not allowed in a formula", node)
        return value

    def chain(self, node: ast.BinOp, depth: int) -> Any:
        """a + b - c ... : the left spine in a loop, so that a long sum is not a deep one."""
        spine: list[ast.BinOp] = []
        left: ast.expr = node
        while isinstance(left, ast.BinOp) and not isinstance(left.op, ast.Pow):
            spine.append(left)
            left = left.left
        if isinstance(left, ast.BinOp):
            value = self._finite(self.expression(left.left, depth + 1) ** self.exponent(left.right), left)
        else:
            value = self.expression(left, depth + 1)
        for step in reversed(spine):
            value = self._finite(self._combine(step, value, self.expression(step.right, depth + 1)), step)
        return value

    def _combine(self, node: ast.BinOp, left: Any, right: Any) -> Any:
        if type(node.op) not in OPERATORS:
            allowed = " ".join(text for text, _ in OPERATORS.values())
            self.refuse(f"the operator {type(node.op).__name__} is not allowed (allowed: {allowed})", node.right)
        if isinstance(node.op, ast.Div) and right.is_zero():
            self.refuse("division by zero", node.right)
        return OPERATORS[type(node.op)][1](left, right)

    def exponent(self, node: ast.expr) -> float:
        """A number that is written down: a literal, signed or not, or a declared constant."""
        match node:
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                sign = -1.0
            case ast.UnaryOp(op=ast.UAdd(), operand=inner):
                sign = 1.0
            case inner:
                sign = 1.0
        if isinstance(inner, ast.Constant):
            return sign * self.number(inner)
        if isinstance(inner, ast.Name) and inner.id in self.constants:
            return sign * self.constants[inner.id]
        return self.refuse("an exponent must be a number or a constant; write pow(x, y) for a variable one", node)

    def number(self, node: ast.Constant) -> float:
        """A finite real number."""
        value = node.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(f"{_kind(node)} is not allowed in a formula", node)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.refuse("a number too large for a double", node)
        return number

    def name(self, node: ast.Name) -> Any:
        """A signal or a constant."""
        if node.id in self.names:
            return self.names[node.id]
        if node.id in self.constants:
            return self._finite(self._symbol(self.constants[node.id]), node)
        if node.id in FUNCTIONS:
            self.refuse(f"the function '{node.id}' needs its arguments in parentheses", node)
        return self.refuse(f"unknown name '{node.id}'", node, did_you_mean(node.id, [*self.names, *self.constants]))

    def call(self, node: ast.Call, depth: int) -> Any:
        """A function of the whitelist."""
        if not isinstance(node.func, ast.Name):
            self.refuse(f"{_kind(node.func)} cannot be called in a formula", node)
        function = node.func.id
        if function not in FUNCTIONS:
            self.refuse(f"unknown function '{function}'", node, did_you_mean(function, FUNCTIONS))
        if node.keywords:
            self.refuse(f"'{function}' takes no keywords", node)
        least, most = FUNCTIONS[function]
        if not least <= len(node.args) <= most:
            needs = f"{least}" if least == most else f"{least} or more"
            self.refuse(f"'{function}' takes {needs} arguments, not {len(node.args)}", node)
        values = [self.expression(argument, depth + 1) for argument in node.args]
        build = _functions()[function]
        value = build(*values[:2])
        for further in values[2:]:
            value = build(value, further)
        return self._finite(value, node)

    def refuse(self, what: str, at: ast.expr | int | None = None, remedy: str = "") -> NoReturn:
        """Stop, with the place, the offending text and the column."""
        column = 0
        if isinstance(at, int):
            column = at
        elif at is not None:
            # ast counts UTF-8 bytes; people count characters.
            stripped = self.line.strip(" ").encode("utf-8", "surrogatepass")
            column = self._indent() + len(stripped[: at.col_offset].decode("utf-8", "ignore"))
        start = max(0, column - 30)
        excerpt = self.line[start : start + 60]
        excerpt = ("..." if start else "") + excerpt + ("..." if start + 60 < len(self.line) else "")
        raise InputError(
            _at(self.where, f"{what} in {excerpt!r}, column {column + 1}"), remedies=(remedy,) if remedy else ()
        )

    def _indent(self) -> int:
        return len(self.line) - len(self.line.lstrip(" "))

    def _check_nesting(self) -> None:
        """Refuse deep nesting before Python's parser sees it: its own limit depends on the size of the stack."""
        depth = prefix = 0
        for column, c in enumerate(self.line):
            depth += (c in "([{") - (c in ")]}")
            # A run of prefix operators (- - - x) nests as deeply as parentheses do; so does a run of powers.
            prefix = prefix + 1 if c in "+-~*" else prefix * (c == " ")
            if max(depth, prefix) > DEEPEST:
                self.refuse(f"nested deeper than {DEEPEST} levels", column)
            if c in "#\\":
                self.refuse(f"{c!r} is not allowed in a formula", column)

    def _symbol(self, number: float) -> Any:
        import casadi as ca

        return ca.SX(number)

    def _finite(self, value: Any, node: ast.expr) -> Any:
        """The value, unless it is a constant that is no finite number (log(0), 9**9**9)."""
        if value.is_constant() and not math.isfinite(float(value)):
            self.refuse("a constant that is not a finite number", node)
        return value


def _kind(node: ast.expr) -> str:
    """What a piece of text is, in the reader's words."""
    if isinstance(node, ast.Constant):
        return f"the {type(node.value).__name__} {str(node.value)[:20]!r}"
    words = {"Attribute": "an attribute (a.b)", "Subscript": "an index (a[b])", "Compare": "a comparison"}
    return words.get(type(node).__name__, f"a Python {type(node).__name__}")
