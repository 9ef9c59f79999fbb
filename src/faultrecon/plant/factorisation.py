# SPDX-License-Identifier: BSD-3-Clause
"""Ways to write a nonlinear right-hand side as A(z) x + B(z) u, ranked by what the sensors see at the vertices.

The factorisation is not unique: the product a(x) x1 x2 is z x2 with z = a x1, or z x1 with z = a x2.  Both are exact;
the vertices (A_i, C) differ, and with them what an observer designed on them can do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.plant.plant import Plant
from faultrecon.plant.polytopic import MOST, Ends, Family, Polytopic
from faultrecon.plant.sector import Sector, right_side
from faultrecon.plant.signals import NAME

Array = NDArray[np.float64]

TRIED = 64
"""Factorisations looked at; each term with k factors among the states and inputs offers k."""
BLIND = 1e-12
"""Below it a singular value is rounding: the vertex does not see something at all."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One factorisation: the form, and how well the worst vertex is seen.

    observability: the smallest singular value of the observability matrix over the largest one, at the worst vertex; of
    two forms with the same vertices' worth the one with fewer premises comes first.
    """

    form: Polytopic
    observability: float

    @property
    def premises(self) -> dict[str, str]:
        """The premises and their formulas."""
        return dict(zip(self.form.sector.names, self.form.sector.premises.texts, strict=True))

    def __str__(self) -> str:
        said = ", ".join(f"{name} = {text}" for name, text in self.premises.items())
        return f"{said}: worst vertex seen with {self.observability:.3g}"


def factorisations(plant: Plant, box: dict[str, Ends]) -> list[Candidate]:
    """Every factorisation that pulls one state or input out of each product, best seen first.

    box: interval of every state and input.  Raises InputError where a term holds neither a state nor an input, or where
    every factorisation needs more than six premises.
    """
    names = [*plant.signals.x, *plant.signals.u]
    f = right_side(plant)
    rows = [_terms(f, output) for output in f.outputs]
    slots = [(i, term) for i, terms in enumerate(rows) for term in terms]
    choices = [[factor for factor in term.factors if factor in names] for _, term in slots]
    choices = [list(dict.fromkeys(chosen)) for chosen in choices]
    for (i, term), chosen in zip(slots, choices, strict=True):
        if not chosen:
            raise InputError(
                f"the term {term.text(names)} in the equation of {names[i]} has no state and no input for a factor",
                why="A(z) x + B(z) u vanishes at x = 0, u = 0",
                remedies=("shift the state to where the term vanishes", "write the form by hand in [polytopic]"),
            )
    found, over = [], 0
    for picked in islice(product(*choices), TRIED):
        made = _candidate(plant, names, [(i, t, by) for (i, t), by in zip(slots, picked, strict=True)], box)
        over += made is None
        found += [] if made is None else [made]
    if not found:
        raise InputError(
            f"{over} factorisations need more than {MOST} premises each",
            remedies=("merge terms that vary together into one premise by hand",),
        )
    return sorted(found, key=lambda c: (-c.observability, len(c.form.sector.names)))


@dataclass(frozen=True)
class _Term:
    """coefficient times factors over divisors, each a text."""

    coefficient: float
    factors: tuple[str, ...]
    divisors: tuple[str, ...]

    def without(self, factor: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """What is left of the product, apart from its coefficient, when one factor is pulled out."""
        rest = list(self.factors)
        rest.remove(factor)
        return tuple(sorted(rest)), tuple(sorted(self.divisors))

    def text(self, names: Sequence[str]) -> str:
        return _product(self.coefficient, (tuple(self.factors), tuple(self.divisors)))


def _product(coefficient: float, rest: tuple[tuple[str, ...], tuple[str, ...]]) -> str:
    factors, divisors = rest
    parts = [repr(float(coefficient))] if coefficient != 1.0 or not factors else []
    text = "*".join([*parts, *map(_grouped, factors)])
    return text + "".join(f"/{_grouped(one)}" for one in divisors)


def _grouped(text: str) -> str:
    return text if NAME.fullmatch(text) else f"({text})"


def _candidate(
    plant: Plant, names: Sequence[str], picked: Sequence[tuple[int, _Term, str]], box: dict[str, Ends]
) -> Candidate | None:
    """The form of one choice; None beyond six premises."""
    premises: dict[tuple[tuple[str, ...], tuple[str, ...]], str] = {}
    cells = [["0.0"] * len(names) for _ in range(plant.n)]
    for i, term, by in picked:
        rest = term.without(by)
        if any(rest):
            name = premises.setdefault(rest, f"z{len(premises) + 1}")
            entry = f"{float(term.coefficient)!r}*{name}"
        else:
            entry = repr(float(term.coefficient))
        j = list(names).index(by)
        cells[i][j] = entry if cells[i][j] == "0.0" else f"{cells[i][j]} + {entry}"
    if not 0 < len(premises) <= MOST:
        return None
    inputs = {"x": plant.signals.x.names, "u": plant.signals.u.names}
    z = Graph.from_texts([_product(1.0, rest) for rest in premises], inputs)
    entries = Graph.from_texts([c for row in cells for c in row], {"z": tuple(premises.values())})
    form = Polytopic(Family(z, entries, (plant.n, len(names)), "[A B]"), box)
    try:
        seen = _worst_seen(Sector.of(replace(plant, polytopic=form)))
    except InputError:  # a premise that is not defined on the box, x1/x2 with x2 through zero
        return None
    return Candidate(form, seen)


def _worst_seen(sector: Sector) -> float:
    """The relative smallest singular value of the observability matrix of (x, f) at the worst vertex.

    A multiplicative fault is a constant seen through the sensor's reading at the operating point.
    """
    plant = sector.plant
    scaling = [j for j, f in enumerate(plant.faults) if f.effect == "multiplicative" and f.site == "sensor"]
    C = np.hstack([plant.C, np.diag(plant.point.y) @ plant.F_f[:, scaling]])
    worst = np.inf
    for A in sector.A:
        whole = np.zeros((C.shape[1], C.shape[1]))
        # Relative to its fastest entry: a faster vertex is not better seen for its speed alone.
        whole[: plant.n, : plant.n] = A / max(float(np.abs(A).max()), 1e-300)
        rows = [C]
        for _ in range(len(whole) - 1):
            rows.append(rows[-1] @ whole)
        sizes = np.linalg.svd(np.vstack(rows), compute_uv=False)
        worst = min(worst, float(sizes[-1] / sizes[0]) if sizes[0] > 0 else 0.0)
    return 0.0 if worst < BLIND else worst


# ---------------------------------------------------------------- reading products off a graph


def _terms(graph: Graph, output: int) -> list[_Term]:
    """An output as a sum of products: sums and differences are taken apart, products multiplied out over sums."""
    names = [name for group in graph.inputs.values() for name in group]
    sizes = np.cumsum([0, *graph.sizes])
    memo: dict[int, list[_Term]] = {}

    def go(k: int) -> list[_Term]:
        if k not in memo:
            memo[k] = read(graph.nodes[k])
        return memo[k]

    def read(node: tuple[str | int, ...]) -> list[_Term]:
        op, *rest = node
        if op == "input":
            return [_Term(1.0, (names[int(sizes[int(rest[0])]) + int(rest[1])],), ())]
        if op == "const":
            value = float.fromhex(str(rest[0]))
            return [_Term(value, (), ())] if value else []
        parts = [int(i) for i in rest]
        if op in ("add", "sub"):
            right = go(parts[1])
            return go(parts[0]) + (right if op == "add" else [replace(t, coefficient=-t.coefficient) for t in right])
        if op == "neg":
            return [replace(t, coefficient=-t.coefficient) for t in go(parts[0])]
        if op in ("mul", "sq"):
            return [_times(a, b) for a in go(parts[0]) for b in go(parts[-1])]
        if op == "div":
            below = go(parts[1])
            if len(below) == 1:
                return [_over(t, below[0]) for t in go(parts[0])]
            return [replace(t, divisors=(*t.divisors, spelled(parts[1]))) for t in go(parts[0])]
        return [_Term(1.0, (f"{op}({', '.join(spelled(i) for i in parts)})",), ())]

    def spelled(k: int) -> str:
        return " + ".join(t.text(names) for t in go(k)) or "0.0"

    return go(output)


def _times(a: _Term, b: _Term) -> _Term:
    return _Term(a.coefficient * b.coefficient, (*a.factors, *b.factors), (*a.divisors, *b.divisors))


def _over(a: _Term, b: _Term) -> _Term:
    return _Term(a.coefficient / b.coefficient, (*a.factors, *b.divisors), (*a.divisors, *b.factors))
