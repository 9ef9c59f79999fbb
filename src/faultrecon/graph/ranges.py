# SPDX-License-Identifier: BSD-3-Clause
"""The range of a function over a box, by branch and bound: both ends proved from outside and met from inside."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from faultrecon.finding import InputError
from faultrecon.graph.enclose import Box, enclose
from faultrecon.graph.function import Graph
from faultrecon.graph.interval import Array, Interval, IntervalAlgebra, require_ieee
from faultrecon.graph.walk import walk

_BATCH = 256  # boxes halved at once
_NARROW = 1e-12  # of the spread of the values met: closer than this to an end of 0 nothing can be relative


@dataclass(frozen=True)
class Range:
    """Where one output can be: low and high are proved; least and most were met, in floating point.

    complete: whether both ends were closed to the tolerance within the budget; proved they are in any case.
    """

    low: float
    high: float
    least: float
    most: float
    boxes: int
    complete: bool


def ranges(graph: Graph, boxes: Mapping[str, Box], *, rtol: float = 1e-6, budget: int = 20_000) -> tuple[Range, ...]:
    """The range of each output while the inputs stay in their boxes; one (low, high) per component, by input group.

    Natural interval extension; sub-boxes with the lowest bounds are halved until the end is within rtol of a value that
    occurs.  budget: boxes per end.  Raises InputError where the function leaves its domain.
    """
    require_ieee()
    outside = enclose(graph, boxes)  # refuses what is not defined on the box, by name
    ends = [np.asarray(boxes.get(name, ()), dtype=float).reshape(-1, 2) for name in graph.inputs]
    low, high = np.vstack(ends)[:, 0], np.vstack(ends)[:, 1]
    found = []
    for i, (below, above) in enumerate(outside):
        one = graph.channel(i)
        least = _lowest(one, low, high, 1.0, (below, above), rtol, budget)
        most = _lowest(one, low, high, -1.0, (-above, -below), rtol, budget)
        complete = least.closed and most.closed
        found.append(Range(least.bound, -most.bound, least.met, -most.met, least.boxes + most.boxes, complete))
    return tuple(found)


@dataclass(frozen=True)
class _End:
    bound: float
    met: float
    boxes: int
    closed: bool


def _lowest(
    graph: Graph, low: Array, high: Array, sign: float, outside: tuple[float, float], rtol: float, budget: int
) -> _End:
    """The least value of sign times the function, from below and from above."""
    places = [("input", g, c) for g, size in enumerate(graph.sizes) for c in range(size)]
    axes = [i for i, place in enumerate(places) if high[i] > low[i] and place in graph.nodes]
    met = float(_values(graph, _corners(low, high, axes), sign).min())
    lows, highs = low[:, None], high[:, None]
    bounds, boxes, settled = np.array([outside[0]]), 1, math.inf
    while True:
        slack = rtol * max(abs(met), _NARROW * (outside[1] - outside[0]))
        keep = bounds < met - slack  # this threshold only falls, so what is good enough stays good enough
        settled = min(settled, float(bounds[~keep].min(initial=math.inf)))
        lows, highs, bounds = lows[:, keep], highs[:, keep], bounds[keep]
        if not bounds.size or not axes or boxes + 2 > budget:
            bound = min(settled, met, float(bounds.min(initial=math.inf)))
            return _End(bound, met, boxes, not bounds.size)
        chosen = np.zeros(bounds.size, dtype=bool)
        chosen[np.argsort(bounds, kind="stable")[: min(_BATCH, (budget - boxes) // 2)]] = True
        new_lows, new_highs = _halves(lows[:, chosen], highs[:, chosen], high - low, axes)
        new = np.maximum(_below(graph, new_lows, new_highs, sign), np.tile(bounds[chosen], 2))
        met = min(met, float(_values(graph, 0.5 * (new_lows + new_highs), sign).min()))
        boxes += new.size
        lows, highs = np.hstack([lows[:, ~chosen], new_lows]), np.hstack([highs[:, ~chosen], new_highs])
        bounds = np.concatenate([bounds[~chosen], new])


def _halves(lows: Array, highs: Array, width: Array, axes: Sequence[int]) -> tuple[Array, Array]:
    """Each box cut in two across its widest side, sides being measured by those of the whole box."""
    widest = np.asarray(axes)[((highs - lows)[axes] / width[axes, None]).argmax(axis=0)]
    columns = np.arange(lows.shape[1])
    cut = (lows + 0.5 * (highs - lows))[widest, columns]
    left, right = highs.copy(), lows.copy()
    left[widest, columns] = right[widest, columns] = cut
    return np.hstack([lows, right]), np.hstack([left, highs])


def _below(graph: Graph, lows: Array, highs: Array, sign: float) -> Array:
    """Proved lower bounds of sign times the function over N boxes."""
    cells = iter([Interval(lows[i], highs[i]) for i in range(lows.shape[0])])
    groups = [[next(cells) for _ in components] for components in graph.inputs.values()]
    with np.errstate(all="ignore"):
        (y,) = walk(graph, IntervalAlgebra(), *groups)
    bound = np.broadcast_to(y.lo if sign > 0 else -y.hi, lows.shape[1:])
    return np.where(np.isnan(bound), -np.inf, bound)


def _values(graph: Graph, points: Array, sign: float) -> Array:
    """Values at points (d, N), from above: the upper end of an enclosure is a value that is certainly not exceeded."""
    return -_below(graph, points, points, -sign)


def _corners(low: Array, high: Array, axes: Sequence[int]) -> Array:
    """The middle and, for up to six sides, every corner of the box: (d, N)."""
    middle = low + 0.5 * (high - low)
    few = list(axes)[:6]
    points = np.repeat(middle[:, None], 2 ** len(few) + 1, axis=1)
    for j, corner in enumerate(product((0, 1), repeat=len(few))):
        for axis, side in zip(few, corner, strict=True):
            points[axis, j] = high[axis] if side else low[axis]
    if not np.isfinite(points).all():
        raise InputError("a range needs a bounded box")
    return points
