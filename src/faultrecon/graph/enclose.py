# SPDX-License-Identifier: BSD-3-Clause
"""What a nonlinear function can do on a box, proved: the range of its values and its Lipschitz constant.

Bounds hold for the function in exact real arithmetic, at every point of the box; `interval` says what they rest on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.interval import Array, Failure, Interval, IntervalAlgebra, Mask, require_ieee
from faultrecon.graph.slopes import Slope, SlopeAlgebra
from faultrecon.graph.spectral import norm_above, norm_below
from faultrecon.graph.walk import walk

#: One (low, high) per component of an input group.
Box = Sequence[tuple[float, float]] | Array

_BATCH = 256  # boxes split at once: enough to hide NumPy's overhead, few enough not to split what need not be
_KINKS = 5  # so many abs, min and max open at once are worth trying all their pieces (2**5 evaluations)
_NARROWEST = 2.0**-40  # of the width asked for; a box this narrow that is still unbounded holds a true singularity


@dataclass(frozen=True)
class LipschitzBound:
    """A proved upper bound on a Lipschitz constant, and how tight it is.

    value: |phi(a) - phi(b)| <= value |a - b| on the box (Euclidean norms), proved. lower: the steepest slope met, at
    the point `at` (all inputs, in the order of the graph); floating point, so checked only. boxes: how many were
    examined. complete: whether value <= (1 + rtol) lower was reached within the budget.
    """

    value: float
    lower: float
    boxes: int
    complete: bool
    at: tuple[float, ...] = ()


def enclose(graph: Graph, boxes: Mapping[str, Box]) -> list[tuple[float, float]]:
    """For each output, two numbers it cannot leave while the inputs stay in their boxes.

    boxes: one (low, high) per component, by input group. Raises InputError where a function leaves its domain.
    """
    require_ieee()
    low, high = _bounds(graph, boxes)
    algebra = IntervalAlgebra()
    with np.errstate(all="ignore"):
        outputs = walk(graph, algebra, *_groups(graph, low, high))
    ends = [(float(np.ravel(y.lo)[0]), float(np.ravel(y.hi)[0])) for y in outputs]
    if any(math.isnan(a) for a, _ in ends):
        raise _undefined(graph, algebra.failures, 0, low[:, None], high[:, None], "no enclosure")
    return ends


def lipschitz_bound(
    graph: Graph,
    wrt: str,
    box: Box,
    *,
    others: Mapping[str, Box] | None = None,
    rtol: float = 0.01,
    budget: int = 20_000,
) -> LipschitzBound:
    """The Lipschitz constant of a graph in one input group over a box, proved from above by branch and bound.

    The spectral norm of every generalised Jacobian on a sub-box is bounded from enclosed derivatives; the sub-boxes
    with the largest bounds are halved until the bound is within rtol of a slope that occurs. others: boxes of the other
    input groups; the constant then holds for each fixed value of theirs. budget: boxes to examine at most; the bound is
    proved whenever it stops. Raises InputError where a function leaves its domain, jumps, or is infinitely steep.
    """
    require_ieee()
    if wrt not in graph.inputs:
        raise InputError(f"no input '{wrt}' in this graph; known: {', '.join(graph.inputs)}")
    low, high = _bounds(graph, {**(others or {}), wrt: box})
    search = _Search(graph, wrt, low, high)
    return search.run(rtol, budget)


def lipschitz_per_channel(
    graph: Graph,
    wrt: str,
    box: Box,
    *,
    others: Mapping[str, Box] | None = None,
    rtol: float = 0.01,
    budget: int = 20_000,
) -> tuple[LipschitzBound, ...]:
    """A Lipschitz constant for each output by itself, each with the budget; see `lipschitz_bound`."""
    return tuple(
        lipschitz_bound(graph.channel(i), wrt, box, others=others, rtol=rtol, budget=budget)
        for i in range(graph.n_outputs)
    )


class _Search:
    """Branch and bound over one box: the sub-boxes still open, and the best slope met so far."""

    def __init__(self, graph: Graph, wrt: str, low: Array, high: Array) -> None:
        self.graph, self.wrt, self.low, self.high = graph, wrt, low, high
        self.all_axes = [i for i in range(low.size) if high[i] > low[i]]
        self.axes = _curved(graph, wrt, self.all_axes)
        self.best, self.at, self.boxes = 0.0, tuple(map(float, (low + high) / 2.0)), 0

    def run(self, rtol: float, budget: int) -> LipschitzBound:
        """Halve the boxes with the largest bounds until the gap is closed or the budget spent."""
        low, high = self.low[:, None], self.high[:, None]
        self._sample(self._vertices())
        above = self._above(low, high)
        settled = 0.0
        while True:
            target = (1.0 + rtol) * self.best
            open_boxes = above > target
            settled = max(settled, float(above[~open_boxes].max(initial=0.0)))
            low, high, above = low[:, open_boxes], high[:, open_boxes], above[open_boxes]
            value = max(settled, float(above.max(initial=0.0)))
            axes = self.axes if math.isfinite(value) else self.all_axes
            if not above.size or not axes or self.boxes + 2 > budget:
                break
            chosen = np.zeros(above.size, dtype=bool)
            chosen[np.argsort(-above, kind="stable")[: min(_BATCH, (budget - self.boxes) // 2)]] = True
            new_low, new_high = self._halves(axes, low[:, chosen], high[:, chosen])
            new_above = np.minimum(self._above(new_low, new_high), np.tile(above[chosen], 2))
            low, high = np.hstack([low[:, ~chosen], new_low]), np.hstack([high[:, ~chosen], new_high])
            above = np.concatenate([above[~chosen], new_above])
        if not math.isfinite(value):
            worst = int(np.argmax(above))
            self._refuse(low[:, [worst]], high[:, [worst]])
        return LipschitzBound(value, self.best, self.boxes, value <= target, self.at)

    def _halves(self, axes: Sequence[int], low: Array, high: Array) -> tuple[Array, Array]:
        """Each box cut in two across the widest of these axes, sides being measured by those of the whole box."""
        width = (high - low)[axes] / (self.high - self.low)[axes, None]
        axis, columns = np.asarray(axes)[width.argmax(axis=0)], np.arange(low.shape[1])
        middle = low + 0.5 * (high - low)
        cut = middle[axis, columns]
        left, right = high.copy(), low.copy()
        left[axis, columns] = right[axis, columns] = cut
        return np.hstack([low, right]), np.hstack([left, high])

    def _slopes(
        self, low: Array, high: Array, choices: Mapping[int, bool] | None = None
    ) -> tuple[Interval, SlopeAlgebra]:
        """Enclosed Jacobians (N, m, k) over N boxes (d, N), and what the algebra noted on the way."""
        algebra = SlopeAlgebra(choices=choices or {})
        width = low.shape[1]
        unit = np.eye(len(self.graph.inputs[self.wrt]))[:, :, None]
        inputs: list[list[Slope]] = []
        start = 0
        for name, components in self.graph.inputs.items():
            values = [Interval(low[i], high[i]) for i in range(start, start + len(components))]
            moving = name == self.wrt
            inputs.append([Slope(v, Interval.point(unit[i]) if moving else None) for i, v in enumerate(values)])
            start += len(components)
        with np.errstate(all="ignore"):
            outputs = walk(self.graph, algebra, *inputs)
        shape = (len(unit), width)
        # An output whose value is undefined has no slope either, even where its slope alone would exist.
        ends = [
            [np.where(np.isnan(y.value.lo), np.nan, np.broadcast_to(end, shape)) for end in (by.lo, by.hi)]
            for y in outputs
            for by in [y.by or Interval.point(0.0)]
        ]
        stacked = np.array(ends).transpose(1, 3, 0, 2)
        return Interval(stacked[0], stacked[1]), algebra

    def _above(self, low: Array, high: Array) -> Array:
        """Upper bounds over N boxes; their midpoints are sampled on the way."""
        self.boxes += low.shape[1]
        slopes, algebra = self._slopes(low, high)
        above = self._by_pieces(low, high, norm_above(slopes), algebra.open)
        self._sample(low + 0.5 * (high - low))
        stuck = np.isinf(above) & (high - low <= _NARROWEST * (self.high - self.low)[:, None]).all(axis=0)
        if stuck.any():
            worst = int(np.argmax(stuck))
            self._refuse(low[:, [worst]], high[:, [worst]])
        return above

    def _by_pieces(self, low: Array, high: Array, above: Array, undecided: Sequence[Mask]) -> Array:
        """Better bounds for boxes that hold kinks: the worst over the pieces on either side, not over their hull."""
        kinks = [i for i, where in enumerate(undecided) if where.any()]
        if not 0 < len(kinks) <= _KINKS:
            return above
        some = np.logical_or.reduce([np.broadcast_to(undecided[i], above.shape) for i in kinks])
        worst = np.zeros(int(some.sum()))
        for sides in product((True, False), repeat=len(kinks)):
            slopes, _ = self._slopes(low[:, some], high[:, some], dict(zip(kinks, sides, strict=True)))
            worst = np.maximum(worst, norm_above(slopes))
        better = above.copy()
        better[some] = np.minimum(above[some], worst)
        return better

    def _sample(self, points: Array) -> None:
        """Slopes at points (d, N); where there is none at a point, no box around it can be bounded."""
        slopes, _ = self._slopes(points, points)
        steep = norm_below(slopes)
        broken = ~np.isfinite(slopes.lo).all(axis=(1, 2)) | ~np.isfinite(slopes.hi).all(axis=(1, 2))
        if broken.any():
            j = int(np.argmax(broken))
            self._refuse(points[:, [j]], points[:, [j]])
        j = int(np.argmax(steep))
        if steep[j] > self.best:
            self.best, self.at = float(steep[j]), tuple(map(float, points[:, j]))

    def _refuse(self, low: Array, high: Array) -> None:
        _, algebra = self._slopes(low, high)
        raise _undefined(self.graph, algebra.of.failures, 0, low, high, f"no Lipschitz constant in '{self.wrt}'")

    def _vertices(self) -> Array:
        """Corners of the box, 64 at most: slopes are often greatest there."""
        axes = self.axes[:6]
        points = np.repeat((self.low + 0.5 * (self.high - self.low))[:, None], 2 ** len(axes), axis=1)
        for j, corner in enumerate(product((0, 1), repeat=len(axes))):
            for axis, side in zip(axes, corner, strict=True):
                points[axis, j] = self.high[axis] if side else self.low[axis]
        return points


def _bounds(graph: Graph, boxes: Mapping[str, Box]) -> tuple[Array, Array]:
    """Low and high ends of every component, in the order of the graph."""
    needed = {name for name, components in graph.inputs.items() if components}
    if not needed <= set(boxes) <= set(graph.inputs):
        raise InputError(f"boxes are needed for {', '.join(graph.inputs)}; given: {', '.join(boxes) or 'none'}")
    ends: list[Array] = []
    for name, components in graph.inputs.items():
        box = np.asarray(boxes.get(name, ()), dtype=float).reshape(-1, 2) if components else np.empty((0, 2))
        if box.shape[0] != len(components):
            raise InputError(f"the box of '{name}' needs {len(components)} pairs (low, high), not {box.shape[0]}")
        for component, (a, b) in zip(components, box, strict=True):
            if not (math.isfinite(a) and math.isfinite(b) and a <= b):
                raise InputError(
                    f"the box of '{component}' is [{a:g}, {b:g}]; two finite numbers, low <= high, are needed"
                )
        ends.append(box)
    both = np.vstack(ends)
    return both[:, 0], both[:, 1]


def _groups(graph: Graph, low: Array, high: Array) -> list[list[Interval]]:
    """The box as one list of intervals per input group."""
    cells = iter([Interval(low[i : i + 1], high[i : i + 1]) for i in range(low.size)])
    return [[next(cells) for _ in components] for components in graph.inputs.values()]


def _undefined(graph: Graph, failures: Sequence[Failure], j: int, low: Array, high: Array, what: str) -> InputError:
    """Which function fails on box j, with its argument there and the box."""
    names = [c for components in graph.inputs.values() for c in components]
    box = ", ".join(_place(name, low[i, j], high[i, j]) for i, name in enumerate(names))
    for failure in failures:
        if np.broadcast_to(failure.boxes, low.shape[1:])[j]:
            ends = (np.broadcast_to(end, low.shape[1:])[j] for end in (failure.argument.lo, failure.argument.hi))
            return InputError(
                f"{what} on {box}",
                why=f"{failure.what} (its argument is in [{', '.join(f'{end:.6g}' for end in ends)}])",
                remedies=("shrink the box", "write the formula so that it is defined and Lipschitz there"),
            )
    return InputError(f"{what} on {box}", why="a derivative overflows", remedies=("shrink the box",))


def _place(name: str, low: float, high: float) -> str:
    a, b = f"{low:.9g}", f"{high:.9g}"
    return f"{name} = {a}" if a == b else f"{name} in [{a}, {b}]"


def _curved(graph: Graph, wrt: str, axes: Sequence[int]) -> list[int]:
    """Those axes on which some derivative depends; halving another would double the work for nothing."""
    try:
        nodes = graph.jacobian(wrt).graph.nodes
    except InputError:  # a derivative that cannot be written down, such as one with an infinite constant
        return list(axes)
    used = {node[1:] for node in nodes if node[0] == "input"}
    places = [(g, c) for g, size in enumerate(graph.sizes) for c in range(size)]
    return [i for i in axes if places[i] in used]
