# SPDX-License-Identifier: BSD-3-Clause
"""A nonlinear model as a matrix that is multi-affine in a few premises: the table [polytopic] of a plant file.

    ẋ = A(z) x + B(z) u,   z = z(x, u)              x and u absolute

Every entry of A and B is affine in each premise separately, so that inside the premises' bounds A(z) is the convex
combination of its values at the corners: the Takagi-Sugeno form, exact for every z.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.walk import walk

Array = NDArray[np.float64]
Ends = tuple[float, float]
MOST = 6
"""Premises in all; 2**6 = 64 vertices, each a block of every inequality."""
MANY = 5
"""Premises from which the number of vertices is worth a warning."""
RANGE_RTOL = 1e-6
"""How closely the bounds of a premise are pinned down: wider bounds cost conservatism, and this is none to speak of."""


@dataclass(frozen=True, slots=True)
class Premise:
    """One premise between its bounds, and who says so: "proved" from the box, or "assumed" as the file gives them."""

    name: str
    low: float
    high: float
    basis: Literal["proved", "assumed"]


@dataclass(frozen=True, eq=False)
class Family:
    """A matrix M(z) that is multi-affine in the premises z(x, u).

    premises: graph of x (n), u (m) with p outputs.  entries: graph of z (p), the entries of M row by row; shape of M.
    Raises InputError when an entry is not affine in a premise, naming both, and beyond six premises.
    """

    premises: Graph
    entries: Graph
    shape: tuple[int, int]
    letter: str = "M"

    def __post_init__(self) -> None:
        rows, columns = self.shape
        if self.entries.n_outputs != rows * columns:
            raise InputError(f"{self.letter} has {self.entries.n_outputs} entries, {rows} x {columns} are asked for")
        if list(self.premises.inputs) != ["x", "u"] or list(self.entries.inputs) != ["z"]:
            raise InputError("premises are functions of x and u, entries of the premises z")
        if self.premises.n_outputs != len(self.names):
            raise InputError(f"{len(self.names)} premises are named, {self.premises.n_outputs} formulas given")
        if len(self.names) > MOST:
            raise InputError(
                f"{self.letter} has {len(self.names)} premises",
                why=f"they make {2 ** len(self.names)} vertices, and {MOST} premises (64 vertices) are the most",
                remedies=("merge premises that vary together", "leave a small one at its value and call it noise"),
            )
        self._check_affine()

    def _check_affine(self) -> None:
        degrees = walk(self.entries, _Degrees(len(self.names)), np.eye(len(self.names)))
        for k, degree in enumerate(degrees):
            for name, power in zip(self.names, degree, strict=True):
                if power > 1:
                    row, column = divmod(k, self.shape[1])
                    how = f"of degree {power:g} in" if math.isfinite(power) else "not a polynomial in"
                    text = f" = {self.entries.texts[k]!r}" if self.entries.texts else ""
                    raise InputError(
                        f"{self.letter}[{row}][{column}]{text} is {how} the premise '{name}'",
                        why="the corners say all only where every entry is affine in each premise by itself",
                        remedies=("make the whole nonlinear expression a premise of its own", "expand the product"),
                        evidence={"entry": [row, column], "premise": name},
                    )

    @property
    def names(self) -> tuple[str, ...]:
        """The premises."""
        return self.entries.inputs["z"]

    def at(self, z: ArrayLike) -> Array:
        """M at premises (..., p): (..., rows, columns)."""
        z = np.asarray(z, dtype=float)
        flat = self.entries.many(z.reshape(-1, len(self.names)))
        return flat.reshape(*z.shape[:-1], *self.shape)

    def symbolic(self, x: Any, u: Any) -> tuple[Any, Any]:
        """The premises and M in other symbols: (p, 1) and (rows, columns)."""
        z = self.premises.symbolic(x, u)
        return z, self.entries.symbolic(z).reshape((self.shape[1], self.shape[0])).T


class _Degrees:
    """Reads a graph for the degree of every output in each input: arrays (p,); infinite where it is no polynomial."""

    def __init__(self, p: int) -> None:
        self.p = p

    def const(self, value: float) -> Array:
        return np.zeros(self.p)

    def add(self, a: Array, b: Array) -> Array:
        return np.maximum(a, b)

    sub = add

    def neg(self, a: Array) -> Array:
        return a

    def mul(self, a: Array, b: Array) -> Array:
        return a + b

    def sq(self, a: Array) -> Array:
        return 2.0 * a

    def div(self, a: Array, b: Array) -> Array:
        return np.where(b > 0, np.inf, a)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return lambda *parts: np.where(np.max(parts, axis=0) > 0, np.inf, 0.0)


@dataclass(frozen=True, eq=False)
class Polytopic:
    """The exact polytopic form of a plant, the box it is meant for, and the intervals of its multiplicative faults.

    sector: [A B] (n, n+m).  slope: ∂f/∂x (n, n) in premises of its own; None: its entries one by one.  box: interval of
    every state and input, absolute.  bounds: of premises, given by the user; the others are proved over the box.
    faults: interval per fault by name.
    """

    sector: Family
    box: Mapping[str, Ends]
    slope: Family | None = None
    bounds: Mapping[str, Ends] = field(default_factory=dict)
    faults: Mapping[str, Ends] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [*self.sector.premises.inputs["x"], *self.sector.premises.inputs["u"]]
        for name in names:
            if name not in self.box:
                raise InputError(f"the box has no interval for '{name}'", remedies=(f"add {name} = [low, high]",))
        for name in self.box:
            if name not in names:
                raise InputError(f"the box bounds '{name}', which is no state and no input")
        own = {n for family in (self.sector, self.slope) if family is not None for n in family.names}
        for name in self.bounds:
            if name not in own:
                raise InputError(f"bounds are given for '{name}'", why=f"the premises are {', '.join(sorted(own))}")
        for owner, table in (("box", self.box), ("bounds", self.bounds), ("faults", self.faults)):
            for name, (low, high) in table.items():
                if not (math.isfinite(low) and math.isfinite(high) and low < high):
                    raise InputError(f"{owner}.{name} is [{low:g}, {high:g}]", why="two finite numbers, low < high")

    @cached_property
    def boxes(self) -> dict[str, list[Ends]]:
        """The box by input group, in the order of the signals."""
        inputs = self.sector.premises.inputs
        return {group: [self.box[name] for name in inputs[group]] for group in ("x", "u")}

    def premises(self, family: Family) -> tuple[Premise, ...]:
        """The premises of a family between their bounds: the user's where given, else proved over the box."""
        from faultrecon.graph.ranges import ranges

        wanted = [name for name in family.names if name not in self.bounds]
        found = {}
        if wanted:
            for name, one in zip(family.names, ranges(family.premises, self.boxes, rtol=RANGE_RTOL), strict=True):
                found[name] = Premise(name, one.low, one.high, "proved")
        given = {name: Premise(name, *self.bounds[name], "assumed") for name in family.names if name in self.bounds}
        return tuple({**found, **given}[name] for name in family.names)

    def left(self, **tracks: Mapping[str, Array]) -> tuple[str, ...]:
        """What leaves its interval, in words: each keyword is what is tracked, a table of signals (N,) by name.

        Names without an interval are left out.
        """
        known = {**self.faults, **self.box}
        found = []
        for what, signals in tracks.items():
            for name, values in signals.items():
                if name in known and bool(np.any((values < known[name][0]) | (values > known[name][1]))):
                    found.append(f"{what} of {name}")
        return tuple(found)

    def fault_interval(self, name: str, size: float) -> Ends:
        """The interval of a fault: as declared, else its size to either side."""
        return self.faults.get(name, (-size, size))

    def to_dict(self) -> dict[str, Any]:
        """Plain values; numbers as hexadecimal floats."""

        def table(ends: Mapping[str, Ends]) -> dict[str, list[str]]:
            return {name: [float(a).hex(), float(b).hex()] for name, (a, b) in ends.items()}

        def family(one: Family | None) -> dict[str, Any] | None:
            if one is None:
                return None
            return {"premises": one.premises.to_dict(), "entries": one.entries.to_dict(), "shape": list(one.shape)}

        return {
            "sector": family(self.sector),
            "slope": family(self.slope),
            "box": table(self.box),
            "bounds": table(self.bounds),
            "faults": table(self.faults),
        }

    @staticmethod
    def from_dict(stored: Mapping[str, Any]) -> Polytopic:
        """What `to_dict` wrote; raises what reading a damaged part raises."""

        def table(ends: Mapping[str, Any]) -> dict[str, Ends]:
            return {str(k): (float.fromhex(a), float.fromhex(b)) for k, (a, b) in ends.items()}

        def family(one: Mapping[str, Any], letter: str) -> Family:
            shape = (int(one["shape"][0]), int(one["shape"][1]))
            return Family(Graph.from_dict(one["premises"]), Graph.from_dict(one["entries"]), shape, letter)

        return Polytopic(
            family(stored["sector"], "[A B]"),
            table(stored["box"]),
            None if stored["slope"] is None else family(stored["slope"], "J"),
            table(stored["bounds"]),
            table(stored["faults"]),
        )


def corners(ends: Sequence[Ends]) -> Array:
    """Every combination of ends, (2**p, p): the first premise changes slowest, the upper end comes first."""
    return np.array(list(product(*((high, low) for low, high in ends))), dtype=float).reshape(-1, len(ends))


def weights(z: ArrayLike, ends: Sequence[Ends]) -> Array:
    """The weight of every corner, (..., 2**p) from premises (..., p): they sum to one for any z and are within [0, 1]
    inside the bounds.  They are not clipped: outside, the combination stays exact and is no longer convex.
    """
    z = np.asarray(z, dtype=float)
    total = np.ones((*z.shape[:-1], 1))
    for k, (low, high) in enumerate(ends):
        upper = (z[..., k] - low) / (high - low)
        pair = np.stack([upper, 1.0 - upper], axis=-1)
        total = (total[..., :, None] * pair[..., None, :]).reshape(*z.shape[:-1], -1)
    return total
