# SPDX-License-Identifier: BSD-3-Clause
"""How fast functions change along motions known to within boxes, enclosed; and what a linear system keeps of it.

An end that is not known is infinite.  Infinite times zero is zero here, an end being a bound only, so that what is not
known does no harm where it does not act.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.interval import Array, Interval, IntervalAlgebra, require_ieee
from faultrecon.graph.slopes import Slope, SlopeAlgebra
from faultrecon.graph.walk import walk

_PIECES = 32
"""Into which a sample time is cut: the bound of what a linear system keeps is then within some 3 % of the integral."""


def enclose_motion(
    graph: Graph, values: Mapping[str, Interval], rates: Mapping[str, Interval]
) -> tuple[Interval, Interval]:
    """Values and time derivatives (m, N) of m outputs while inputs (k, N), by group, stay in boxes and move at rates.

    A group without rates stands still; each component moves at any rates within its own.  Where an output has a kink,
    the derivative is that of either side.  Raises InputError where an output is undefined or jumps in some box.
    """
    require_ieee()
    algebra, inputs = SlopeAlgebra(), []
    wide = max((np.shape(v.lo)[1] for v in values.values() if len(v.lo)), default=1)
    for group, components in graph.inputs.items():
        x, v = values[group], rates.get(group)
        cells = [Interval(x.lo[i], x.hi[i]) for i in range(len(components))]
        moves = [None if v is None else Interval(v.lo[[i]], v.hi[[i]]) for i in range(len(components))]
        inputs.append([Slope(cell, by) for cell, by in zip(cells, moves, strict=True)])
    with np.errstate(all="ignore"):
        outputs = walk(graph, algebra, *inputs)
    zero = Interval.point(np.zeros(wide))
    y, dy = _stacked([o.value for o in outputs], wide), _stacked([o.by or zero for o in outputs], wide)
    # A condition may have ruled out where an operation failed; what comes out says whether it mattered.
    spoilt = np.isnan(y.lo) | np.isnan(dy.lo) | np.isinf(dy.lo) | np.isinf(dy.hi)
    if spoilt.any() and algebra.of.failures:
        failure = algebra.of.failures[0]
        ends = float(np.min(failure.argument.lo)), float(np.max(failure.argument.hi))
        raise InputError(
            f"no bound on how fast {'; '.join(graph.texts) or 'a term'} changes",
            why=f"{failure.what} (its argument is somewhere in [{ends[0]:.6g}, {ends[1]:.6g}])",
            remedies=("shrink the ranges", "write the formula so that it is defined and Lipschitz there"),
        )
    return y, dy


def _stacked(rows: list[Interval], wide: int) -> Interval:
    """Intervals of a single number or of N, as (m, N)."""
    ends = [[np.broadcast_to(np.ravel(end), wide) for end in (row.lo, row.hi)] for row in rows]
    both = np.array(ends, dtype=float).reshape(len(rows), 2, wide)
    return Interval(both[:, 0], both[:, 1])


def product(M: Interval, x: Interval) -> Interval:
    """M x for M (r, k) and x (k, N), rounded outwards."""
    of = IntervalAlgebra()
    r, wide = M.lo.shape[0], x.lo.shape[1]
    total = Interval.point(np.zeros((r, wide)))
    with np.errstate(all="ignore"):
        for j in range(M.lo.shape[1]):
            total = of.add(total, of.mul(Interval(M.lo[:, [j]], M.hi[:, [j]]), Interval(x.lo[[j]], x.hi[[j]])))
    return total


def magnitude(x: Interval) -> Array:
    """The largest absolute value in each row of x (r, N): (r,)."""
    return np.maximum(np.abs(x.lo), np.abs(x.hi)).max(axis=1, initial=0.0)


def kept_by(A: Array, T: float, B: Array) -> Array:
    """(1/T) ∫₀ᵀ (T - s) |e^(As) B| ds (n, k) from above, entry by entry; T/2 |B| for short T.

    It bounds |x(T)| / T of ẋ = A x + B v, x(0) = 0, v(0) = 0, |v'| <= 1.  By ball arithmetic on pieces of [0, T].
    """
    import flint

    n, k = B.shape
    if not k:
        return np.zeros((n, 0))
    with flint.ctx.workprec(128):
        h, columns = flint.arb(T) / _PIECES, _balls(B)
        within = (_balls(A) * flint.arb(0.5, 0.5) * h).exp()  # e^(As) for every s of one piece
        step, at = (_balls(A) * h).exp(), columns
        total = [[flint.arb(0)] * k for _ in range(n)]
        for piece in range(_PIECES):
            share = h * (flint.arb(T) - h * (piece + flint.arb(0.5))) / flint.arb(T)
            over = within * at
            for i in range(n):
                for j in range(k):
                    total[i][j] += share * over[i, j].abs_upper()
            at = step * at
        ends = np.array([[float(entry.upper()) for entry in row] for row in total])
        nothing = np.array([[bool(entry == 0) for entry in row] for row in total])
    return np.where(nothing, 0.0, np.nextafter(ends, np.inf))  # float() rounds to nearest


def _balls(M: Array) -> Any:
    import flint

    return flint.arb_mat([[flint.arb(float(v)) for v in row] for row in M])
