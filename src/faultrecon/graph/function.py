# SPDX-License-Identifier: BSD-3-Clause
"""A nonlinear function written once, and then evaluated, differentiated, embedded, stored and compared.

`Graph` is the frozen value; CasADi traces it and evaluates it, but what is stored, hashed and compared is a plain list
of instructions that needs no library to read.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError
from faultrecon.graph.extract import array_semantics, casadi_algebra, instructions, scalars, used
from faultrecon.graph.parse import parse
from faultrecon.graph.walk import OPERATIONS, Node, walk

if TYPE_CHECKING:
    import casadi

_ROWS = 1024  # rows per mapped call: long enough to hide the 10 microseconds of a call, short enough to build in 0.3 ms


@dataclass(frozen=True, eq=False, repr=False)
class Graph:
    """A vector-valued function of named groups of numbers, as a list of instructions.

    inputs: the names of the components, by group, in the order of the arguments; nodes: the instructions; outputs:
    which node each output is. texts and constants are the source it was built from, if any, and no part of equality.
    """

    inputs: Mapping[str, tuple[str, ...]]
    nodes: tuple[Node, ...]
    outputs: tuple[int, ...]
    texts: tuple[str, ...] = ()
    constants: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        groups = {str(name): tuple(components) for name, components in self.inputs.items()}
        object.__setattr__(self, "inputs", MappingProxyType(groups))
        object.__setattr__(self, "constants", MappingProxyType(dict(self.constants)))
        _check_nodes(self)

    @staticmethod
    def from_texts(
        texts: Sequence[str],
        inputs: Mapping[str, Sequence[str]],
        constants: Mapping[str, float] | None = None,
        where: str = "",
    ) -> Graph:
        """The function whose outputs are these formulas in the named components; see `parse` for what they may hold."""
        import casadi as ca

        constants = dict(constants or {})
        groups = {name: tuple(components) for name, components in inputs.items()}
        _check_names(groups, constants, where)
        symbols = {name: ca.SX.sym(name, len(components)) for name, components in groups.items()}
        names = {c: symbols[g][i] for g, components in groups.items() for i, c in enumerate(components)}
        outputs = [parse(t, names, constants=constants, where=f"{where}[{i}]") for i, t in enumerate(texts)]
        return _extract(groups, list(symbols.values()), outputs, tuple(texts), constants)

    @staticmethod
    def trace(function: Callable[..., Any], inputs: Mapping[str, int]) -> Graph:
        """Run plain array code once on symbols and keep what it did.

        function takes one column of symbols per input, of the given sizes, and returns one vector: a CasADi expression,
        or a list or array of scalars. Raises InputError when it returns something else.
        """
        import casadi as ca

        # x[0] of a group x is called x1, as in the papers.
        groups = {name: tuple(f"{name}{i + 1}" for i in range(size)) for name, size in inputs.items()}
        symbols = [ca.SX.sym(name, size) for name, size in inputs.items()]
        with array_semantics():
            outputs = scalars(function(*symbols))
        return _extract(groups, symbols, outputs)

    @staticmethod
    def from_dict(stored: Mapping[str, Any]) -> Graph:
        """The graph that `to_dict` wrote; every instruction is checked. Raises InputError."""
        try:
            return Graph(
                {str(name): tuple(str(c) for c in components) for name, components in stored["inputs"]},
                tuple(tuple(node) for node in stored["nodes"]),
                tuple(stored["outputs"]),
                tuple(str(text) for text in stored.get("texts", ())),
                {str(k): float.fromhex(v) for k, v in dict(stored.get("constants", {})).items()},
            )
        except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError("the stored expression graph is damaged", why=f"{type(error).__name__} {error}") from error

    def to_dict(self) -> dict[str, Any]:
        """Plain lists and strings, for JSON; numbers are hexadecimal, so nothing is rounded."""
        source: dict[str, Any] = {}
        if self.texts:
            constants = {name: float(value).hex() for name, value in self.constants.items()}
            source = {"texts": list(self.texts), "constants": constants}
        return self._canonical() | source

    def _canonical(self) -> dict[str, Any]:
        return {
            "inputs": [[name, list(components)] for name, components in self.inputs.items()],
            "nodes": [list(node) for node in self.nodes],
            "outputs": list(self.outputs),
        }

    def digest(self) -> str:
        """SHA-256 of the instructions: the same on every machine and in every process."""
        text = json.dumps(self._canonical(), sort_keys=True, separators=(",", ":"), ensure_ascii=True)
        return hashlib.sha256(text.encode("ascii")).hexdigest()

    def __eq__(self, other: object) -> bool:
        return self._canonical() == other._canonical() if isinstance(other, Graph) else NotImplemented

    def __hash__(self) -> int:
        return hash((tuple(self.inputs.items()), self.nodes, self.outputs))

    def __repr__(self) -> str:
        arguments = "; ".join(f"{name}: {', '.join(components)}" for name, components in self.inputs.items())
        body = ", ".join(self.texts) if self.texts else f"{len(self.outputs)} outputs, {len(self.nodes)} instructions"
        return f"Graph({arguments} -> {body})"

    def __reduce__(self) -> tuple[Any, ...]:
        return Graph.from_dict, (self.to_dict(),)

    @property
    def n_outputs(self) -> int:
        """How many numbers come out."""
        return len(self.outputs)

    @property
    def sizes(self) -> tuple[int, ...]:
        """How many numbers each input group holds."""
        return tuple(len(components) for components in self.inputs.values())

    def __call__(self, *arrays: ArrayLike) -> NDArray[np.float64]:
        """The value at one point: one vector per input group, a vector (m,) back."""
        points = [np.atleast_1d(np.asarray(a, dtype=float)) for a in arrays]
        self._check_shapes(points, [(size,) for size in self.sizes])
        return _evaluate(self.function, points, 1, self.n_outputs)[0]

    def many(self, *arrays: ArrayLike) -> NDArray[np.float64]:
        """The values at N points: one (N, k) array per input group, (N, m) back, the same bits as one by one."""
        points = [np.asarray(a, dtype=float) for a in arrays]
        rows = points[0].shape[0] if points and points[0].ndim == 2 else 0
        self._check_shapes(points, [(rows, size) for size in self.sizes])
        values = np.empty((rows, self.n_outputs))
        for start in range(0, rows, _ROWS):
            block = [p[start : start + _ROWS] for p in points]
            n = min(_ROWS, rows - start)
            mapped = self._mapped if n == _ROWS else self.function.map(n)
            values[start : start + n] = _evaluate(mapped, block, n, self.n_outputs)
        return values

    def symbolic(self, *arguments: Any) -> Any:
        """The same function of other symbols, to build a larger graph: one (k, 1) SX or MX per group, (m, 1) back."""
        import casadi as ca

        shapes = [argument.numel() if hasattr(argument, "numel") else np.size(argument) for argument in arguments]
        if shapes != list(self.sizes):
            raise InputError(f"inputs {', '.join(self.inputs)} have {list(self.sizes)} components, not {shapes}")
        result = self.function(*arguments)
        return ca.SX(result) if isinstance(result, ca.DM) else result

    def channel(self, i: int) -> Graph:
        """Output i alone."""
        nodes, outputs = used(self.nodes, [self.outputs[i]])
        return Graph(self.inputs, nodes, outputs, self.texts[i : i + 1], self.constants)

    def jacobian(self, wrt: str) -> Jacobian:
        """The derivative of every output by every component of one input group."""
        import casadi as ca

        if wrt not in self.inputs:
            raise InputError(f"no input '{wrt}' to differentiate by; known: {', '.join(self.inputs)}")
        symbols = [ca.SX.sym(name, len(components)) for name, components in self.inputs.items()]
        by = symbols[list(self.inputs).index(wrt)]
        matrix = ca.densify(ca.jacobian(self.function(*symbols), by))
        entries = [matrix[i, j] for i in range(matrix.shape[0]) for j in range(matrix.shape[1])]
        if not entries:
            raise InputError(f"the input '{wrt}' has no components to differentiate by")
        return Jacobian(_extract(self.inputs, symbols, entries), (int(matrix.shape[0]), int(matrix.shape[1])))

    @cached_property
    def function(self) -> casadi.Function:
        """The graph as a CasADi function, for whoever embeds or integrates it."""
        import casadi as ca

        symbols = [ca.SX.sym(name, len(components)) for name, components in self.inputs.items()]
        values = walk(self, casadi_algebra(), *([s[i] for i in range(s.numel())] for s in symbols))
        return ca.Function("graph", symbols, [ca.densify(ca.vertcat(*values))])

    @cached_property
    def _mapped(self) -> casadi.Function:
        return self.function.map(_ROWS)

    def _check_shapes(self, arrays: Sequence[NDArray[np.float64]], wanted: Sequence[tuple[int, ...]]) -> None:
        if [a.shape for a in arrays] != list(wanted):
            raise InputError(
                f"inputs {', '.join(self.inputs)} need shapes {list(wanted)}, not {[a.shape for a in arrays]}"
            )


@dataclass(frozen=True)
class Jacobian:
    """The matrix of first derivatives of a graph, of the given shape (m, k); `graph` holds its entries row by row."""

    graph: Graph
    shape: tuple[int, int]

    def __call__(self, *arrays: ArrayLike) -> NDArray[np.float64]:
        """The matrix (m, k) at one point."""
        return self.graph(*arrays).reshape(self.shape)

    def many(self, *arrays: ArrayLike) -> NDArray[np.float64]:
        """The matrices (N, m, k) at N points."""
        return self.graph.many(*arrays).reshape(-1, *self.shape)

    def symbolic(self, *arguments: Any) -> Any:
        """The matrix (m, k) in other symbols."""
        m, k = self.shape
        return self.graph.symbolic(*arguments).reshape((k, m)).T


def _evaluate(function: Any, arrays: Sequence[NDArray[np.float64]], rows: int, width: int) -> NDArray[np.float64]:
    """One call through CasADi's buffers, five times faster than through its matrices; a row is a column there."""
    kept = [np.ascontiguousarray(a) for a in arrays]
    result = np.empty((rows, width))
    buffer, evaluate = function.buffer()
    for i, array in enumerate(kept):
        if array.size:
            buffer.set_arg(i, array.data)
    buffer.set_res(0, result.data)
    evaluate()
    return result


def _extract(
    inputs: Mapping[str, Sequence[str]],
    symbols: Sequence[Any],
    outputs: Sequence[Any],
    texts: tuple[str, ...] = (),
    constants: Mapping[str, float] | None = None,
) -> Graph:
    """The canonical graph of a symbolic expression: rebuilt until CasADi finds nothing more to simplify."""
    import casadi as ca

    if not outputs:
        raise InputError("an expression graph needs at least one output")
    groups = {name: tuple(components) for name, components in inputs.items()}
    column = ca.densify(ca.vertcat(*outputs))
    try:
        function = ca.Function("graph", list(symbols), [column])
    except RuntimeError as error:
        raise InputError("the expression uses a symbol that is not one of its inputs") from error
    graph = Graph(groups, *instructions(function), texts, constants or {})
    for _ in range(4):  # two rounds settle every case met; each is the price of one trace
        again = Graph(groups, *instructions(graph.function), texts, constants or {})
        if again.nodes == graph.nodes:
            break
        graph = again
    return graph


def _check_names(
    inputs: Mapping[str, Sequence[str]], constants: Mapping[str, float] | None = None, where: str = ""
) -> None:
    """Each component and constant has a name of its own."""
    place = f"{where}: " if where else ""
    seen: set[str] = set()
    for name in [c for components in inputs.values() for c in components] + list(constants or {}):
        if name in seen:
            raise InputError(f"{place}the name '{name}' is declared twice among the inputs and constants")
        seen.add(name)
    for name, value in (constants or {}).items():
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"{place}the constant '{name}' is {value!r}, not a finite number")


def _check_nodes(graph: Graph) -> None:
    """Every instruction is one we know, with earlier nodes for operands; a file may hold anything."""
    sizes = graph.sizes
    for k, node in enumerate(graph.nodes):
        if not _sound(node, k, sizes):
            raise InputError(f"instruction {k} of the expression graph, {node!r:.80}, is not a valid one")
    if not graph.outputs or not all(_index(i, len(graph.nodes)) for i in graph.outputs):
        raise InputError("an expression graph needs at least one output, each an instruction of its own")


def _sound(node: Node, k: int, sizes: Sequence[int]) -> bool:
    match node:
        case ("input", group, component):
            return _index(group, len(sizes)) and _index(component, sizes[int(group)])
        case ("const", str(text)):
            try:
                return math.isfinite(float.fromhex(text))
            except (ValueError, OverflowError):
                return False
        case (str(op), *operands):
            return OPERATIONS.get(op) == len(operands) and all(_index(i, k) for i in operands)
    return False


def _index(value: Any, below: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < below
