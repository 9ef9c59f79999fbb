# SPDX-License-Identifier: BSD-3-Clause
"""How far the model of a sampled observer is off: x(t + T) = Φ_T(x, u, f) + T m, with |m| bounded on the declared domain.

Between two samples u, faults and disturbances are held, and x moves as the plant says, with ψ = [φ; g] and K = [G M]:

    ẋ = A x + B u + E f + E_w w + K ψ        ẍ = A ẋ + K ψ'        ψ' = ∂ψ/∂x ẋ + ∂ψ/∂t

Euler's step is the first two terms of x(t + T) = x + T ẋ + ∫ (T - s) ẍ ds, so that |m| <= T/2 sup |ẍ|.  The held step is
exact but for what ψ changes by, at most s sup |ψ'| after s seconds: |m| <= (1/T) ∫ (T - s) |e^(As) K| ds sup |ψ'|.
A Runge-Kutta step has no such bound in closed form.

Both suprema are over the declared domain: that x stays in it is an assumption, and is what declaring it means.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product as grid

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.interval import Interval, IntervalAlgebra
from faultrecon.graph.motion import enclose_motion, kept_by, magnitude, product
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

_BOXES = 1024
"""Into which the domain is cut at most: what φ reads is cut evenly, which halves a bound that is not sharp per doubling."""


@dataclass(frozen=True, eq=False)
class Mismatch:
    """|m| <= size, per state and second (n,), proved on the declared domain; None without a proof, and why there is none.

    missing: signals whose ranges would have to be declared.
    """

    size: Array | None
    why: str = ""
    missing: tuple[str, ...] = ()


def euler_mismatch(plant: Plant, T: float) -> Mismatch:
    """T/2 sup |ẍ|: what Euler's step leaves out."""

    def size(domain: _Domain) -> Array:
        _, ψ, dψ = domain.motion()
        ẍ = _sum(
            product(_times(plant.A, domain.M), domain.ξ),
            product(_times(plant.A, domain.K), ψ),
            product(_point(domain.K), dψ),
        )
        return _scaled(magnitude(ẍ), 0.5 * T)

    return _bounded(plant, size)


def held_mismatch(plant: Plant, T: float) -> Mismatch:
    """(1/T) ∫ (T - s) |e^(As) K| ds sup |ψ'|: nothing for a linear plant, which the held step moves exactly."""

    def size(domain: _Domain) -> Array:
        _, _, dψ = domain.motion()
        rates = np.reshape(magnitude(dψ), (-1, 1))
        return product(_point(kept_by(plant.A, T, domain.K)), _point(rates)).hi[:, 0]

    return _bounded(plant, size)


def seen_mismatch(plant: Plant, Φ1: Array, t: Array, u: Array, x: Array, f: Array) -> Array:
    """m (N-1, n) along a run without disturbances, sampled at t (N,): what a simulation shows, checked at most.

    Φ1 (n, n): the model's, the identity for Euler's.  u (N, m) and x (N, n): absolute.  f (N, q).
    """
    from faultrecon.plant.derive import drift

    moves = np.array([drift(plant, x[k], u[k], t=float(t[k])) for k in range(len(t) - 1)]) + f[:-1] @ plant.E_f.T
    return np.diff(x, axis=0) / np.diff(t)[:, None] - moves @ Φ1.T


# ---------------------------------------------------------------- the declared domain


@dataclass(frozen=True, eq=False)
class _Domain:
    """Boxes (k, N) of ξ = [x - x0; u - u0; f; w], ẋ = M ξ + K ψ, y - y0 = Y ξ."""

    plant: Plant
    ξ: Interval
    M: Array
    K: Array
    Y: Array

    def motion(self) -> tuple[Interval, Interval, Interval]:
        """ẋ, ψ and ψ' on every box."""
        plant, of, n = self.plant, IntervalAlgebra(), self.plant.n
        wide = self.ξ.lo.shape[1]
        everywhen = Interval(np.full((1, wide), -np.inf), np.full((1, wide), np.inf))
        u = of.add(_rows(self.ξ, slice(n, n + len(plant.point.u))), _column(plant.point.u))
        x = of.add(_rows(self.ξ, slice(n)), _column(plant.point.x))
        y = of.add(product(_point(self.Y), self.ξ), _column(plant.point.y))
        read = [] if plant.nonlinearity is None else [plant.signals.x.index(name) for name in plant.nonlinearity.reads]
        terms = [] if plant.nonlinearity is None else [(plant.nonlinearity.phi, {"x": _rows(x, read)})]
        terms += [] if plant.known is None else [(plant.known.g, {"y": y})]
        still = {"u": u, "t": everywhen}
        at_rest = [enclose_motion(graph, {**own, **still}, {})[0] for graph, own in terms]
        ẋ = _sum(product(_point(self.M), self.ξ), product(_point(self.K), _stack(at_rest, wide)))
        velocity = {"x": _rows(ẋ, read), "y": product(_point(plant.C), ẋ), "t": Interval.point(np.ones((1, wide)))}
        both = [enclose_motion(graph, {**own, **still}, {k: velocity[k] for k in (*own, "t")}) for graph, own in terms]
        return ẋ, _stack([ψ for ψ, _ in both], wide), _stack([dψ for _, dψ in both], wide)


def _bounded(plant: Plant, size: Callable[[_Domain], Array]) -> Mismatch:
    """The bound, or which ranges it lacks."""
    names, low, high = _ends(plant)
    unknown = [i for i in range(len(names)) if not (np.isfinite(low[i]) and np.isfinite(high[i]))]
    if np.any(low > high):
        i = int(np.argmax(low > high))
        return Mismatch(None, f"the range of {names[i]} and the domain of φ have nothing in common")

    def bound(open_ones: Sequence[int]) -> tuple[Array | None, str]:
        pinned = [i for i in unknown if i not in open_ones]
        a, b = low.copy(), high.copy()
        a[pinned], b[pinned] = -1.0, 1.0
        try:
            with np.errstate(invalid="ignore"):  # of infinite ends
                found = size(_domain(plant, a, b))
        except InputError as error:
            return None, str(error)
        return (found, "") if np.isfinite(found).all() else (None, "its bound overflows")

    found, why = bound(unknown)
    if found is not None or not unknown:
        return Mismatch(found, why)
    harmful = [i for i in unknown if bound([i])[0] is None] or unknown
    return Mismatch(None, "no range is declared", tuple(names[i] for i in harmful))


def _ends(plant: Plant) -> tuple[list[str], Array, Array]:
    """Names and ends of ξ: ranges, cut to the domain of φ, and declared sizes; infinite where nothing is declared."""
    x, u = plant.signals.x, plant.signals.u
    sizes = [*x.ranges, *u.ranges, *(f.size for f in plant.faults), *(d.size for d in plant.attenuated)]
    reach = np.where(np.isnan(sizes), np.inf, sizes)
    low, high = -reach, reach
    if plant.nonlinearity is not None:
        for name, (a, b) in plant.nonlinearity.domain.items():
            i = x.index(name)
            box = IntervalAlgebra().sub(Interval(np.array(a), np.array(b)), Interval.point(plant.point.x[i]))
            low[i], high[i] = max(low[i], float(box.lo)), min(high[i], float(box.hi))
    return [*x, *u, *(f.name for f in plant.faults), *(d.name for d in plant.attenuated)], low, high


def _domain(plant: Plant, low: Array, high: Array) -> _Domain:
    """The box cut along what ψ reads."""
    into = [plant.G] if plant.known is None else [plant.G, plant.known.into]
    M = np.hstack([plant.A, plant.B, plant.E_f, plant.E_w])
    Y = np.hstack([plant.C, plant.D, plant.F_f, plant.F_w])
    axes = [i for i in _read(plant, Y) if np.isfinite(high[i] - low[i]) and high[i] > low[i]]
    per = int(_BOXES ** (1.0 / max(len(axes), 1)) + 1e-9)  # 1024 is 32², and its root a hair below
    edges = [np.linspace(low[i], high[i], per + 1) for i in axes]
    cells = list(grid(range(per), repeat=len(axes)))
    lows, highs = (np.repeat(end[:, None], len(cells), axis=1) for end in (low, high))
    for k, (axis, edge) in enumerate(zip(axes, edges, strict=True)):
        at = np.array([cell[k] for cell in cells])
        lows[axis], highs[axis] = edge[at], edge[at + 1]
    return _Domain(plant, Interval(lows, highs), M, np.hstack(into), Y)


def _read(plant: Plant, Y: Array) -> list[int]:
    """Which entries of ξ the terms φ and g read."""
    n, found = plant.n, set()
    if plant.nonlinearity is not None:
        states = [plant.signals.x.index(name) for name in plant.nonlinearity.reads]
        found |= {states[i] for i in _used(plant.nonlinearity.phi, "x")}
        found |= {n + i for i in _used(plant.nonlinearity.phi, "u")}
    if plant.known is not None:
        found |= {int(i) for j in _used(plant.known.g, "y") for i in np.flatnonzero(Y[j])}
        found |= {n + i for i in _used(plant.known.g, "u")}
    return sorted(found)


def _used(graph: Graph, group: str) -> list[int]:
    at = list(graph.inputs).index(group)
    return [int(node[2]) for node in graph.nodes if node[0] == "input" and node[1] == at]


# ---------------------------------------------------------------- intervals


def _point(M: Array) -> Interval:
    return Interval.point(np.asarray(M, dtype=float))


def _column(values: Sequence[float]) -> Interval:
    return Interval.point(np.array(values, dtype=float).reshape(-1, 1))


def _rows(x: Interval, which: slice | list[int]) -> Interval:
    return Interval(x.lo[which], x.hi[which])


def _times(A: Array, B: Array) -> Interval:
    return product(_point(A), _point(B))


def _sum(*terms: Interval) -> Interval:
    total = terms[0]
    for term in terms[1:]:
        total = IntervalAlgebra().add(total, term)
    return total


def _stack(parts: Sequence[Interval], wide: int) -> Interval:
    empty = np.zeros((0, wide))
    return Interval(np.vstack([empty, *(p.lo for p in parts)]), np.vstack([empty, *(p.hi for p in parts)]))


def _scaled(values: Array, by: float) -> Array:
    return IntervalAlgebra().mul(Interval.point(values), Interval.point(by)).hi
