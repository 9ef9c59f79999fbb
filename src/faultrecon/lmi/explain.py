# SPDX-License-Identifier: BSD-3-Clause
"""Why a set of inequalities has no solution: which diagonal block fails alone, and which blocks carry the obstruction.

A principal block of a definite matrix is definite, so a diagonal block that has no solution by itself (beside the other
inequalities) is a complete reason.  When none fails alone, the solver's dual certificate says how much each block takes
part in the contradiction.  Both are answers of a solver, checked in floating point, and are called that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from faultrecon.lmi.expr import Expr, Inequality, show
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.solve import Outcome, solve
from faultrecon.lmi.walk import leaves

STRICT = 1e-6
"""How far inside its scaled inequality a block has to get: else P = 0 would pass for P > 0."""
NAMED = 3
"""How many blocks a sentence names; all of them are in `shares`."""


@dataclass(frozen=True)
class Obstruction:
    """Why there is no solution.

    alone: labels of blocks that have no solution by themselves.  shares: part of the dual certificate per block, as
    (label, share), largest first.
    """

    alone: tuple[str, ...]
    shares: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        if self.alone:
            return f"{' and '.join(self.alone)} cannot be satisfied even alone"
        carried = ", ".join(f"{label} {100 * share:.0f} %" for label, share in self.shares[:NAMED])
        return f"only the whole fails; the contradiction rests on {carried}" if carried else "only the whole fails"


def explain(problem: Problem, outcome: Outcome) -> Obstruction:
    """The obstruction behind an infeasible outcome of `problem`."""
    alone: list[str] = []
    for k, inequality in enumerate(problem.inequalities):
        for label, block in diagonal_blocks(inequality):
            rest = [other for j, other in enumerate(problem.inequalities) if j != k]
            part = Problem([Inequality(block, inequality.sense), *rest], None, _known(problem, [block, *_exprs(rest)]))
            if solve(part, margin=STRICT).status == "infeasible":
                alone.append(label)
    return Obstruction(tuple(alone), _shares(problem.inequalities, outcome.duals))


def diagonal_blocks(inequality: Inequality) -> list[tuple[str, Expr]]:
    """The diagonal blocks of an inequality, labelled 'block (2,2) = -β I of (3.1)'; none if it has no blocks."""
    if inequality.expr.op != "block":
        return []
    rows = inequality.expr.args[0]
    owner = f" of {inequality.label}" if inequality.label else ""
    return [
        (f"block ({k + 1},{k + 1}) = {show(row[k])}{owner}", row[k])
        for k, row in enumerate(rows)
        if row[k].shape[0] > 0
    ]


def _exprs(inequalities: Sequence[Inequality]) -> list[Expr]:
    return [i.expr for i in inequalities]


def _known(problem: Problem, exprs: Sequence[Expr]) -> dict:
    present = leaves(exprs, "unknown")
    return {name: value for name, value in (problem.fixed or {}).items() if name in present}


def _shares(inequalities: Sequence[Inequality], duals: Sequence[np.ndarray]) -> tuple[tuple[str, float], ...]:
    weights: list[tuple[str, float]] = []
    for inequality, dual in zip(inequalities, duals, strict=False):
        at = 0
        blocks = diagonal_blocks(inequality) or [(inequality.label or show(inequality.expr), inequality.expr)]
        for label, block in blocks:
            n = block.shape[0]
            weights.append((label, float(np.trace(dual[at : at + n, at : at + n]))))
            at += n
    total = sum(w for _, w in weights)
    if not total > 0:
        return ()
    return tuple(sorted(((label, w / total) for label, w in weights), key=lambda pair: -pair[1]))
