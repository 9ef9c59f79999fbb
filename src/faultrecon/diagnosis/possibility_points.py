# SPDX-License-Identifier: BSD-3-Clause
"""What the sensors and their rates of change tell about state and faults, point by point: the rank of (x, faults).

At each point y, ẏ, ÿ, ... are followed to first order in the state and the faults, inputs held: of a sensor that loses
gain the logarithm, in which the gain is a number added.  A plant of analytic formulas that passes at one point passes
at almost all of them.  For a sampled plant the next readings take the place of the derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.conditions import pencil_rank
from faultrecon.diagnosis.possibility_along import Trajectory
from faultrecon.diagnosis.possibility_model import Equations, units
from faultrecon.graph.lie import lie_derivatives, shifted_outputs
from faultrecon.numerics.information import unexplained
from faultrecon.numerics.pencil import undetectable_modes
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]
Ends = tuple[float, float]

POINTS = 64
"""Random points of the region beside the operating point."""
ALONG = 200
"""Points of a trajectory."""
RANK = 1e-8
"""Part of a direction that no other explains, from which it counts: the square root of rounding."""
FAINT = 0.01
"""Of the largest reading: what is below shows a gain a hundred times worse than where it shows best."""
AT_REST = 1e-6
"""Residual of the equations, beside the sizes of their terms, up to which a point counts as an equilibrium."""


@dataclass(frozen=True, slots=True)
class Rank:
    """At how many points of a region the sensors tell the faults from the state.

    separable: points where they do; full: where they tell the whole state as well, rank `needed` = n + q; seen: where
    the healthy sensors alone tell the state, or will.  smallest: least singular value where it is worst, at the state
    `at`, and typical: its median; states in their units, faults in their sizes, k-th derivatives times pace^k.  zero:
    sensors that lose gain, by the number of points where they read nothing; faint: where they read too little to show
    the gain, see `enough`.  readings: the least and the largest of each.  derivatives: how many were taken; short: more
    would be needed to decide, and are too long to write out.
    """

    region: str
    points: int
    separable: int
    full: int
    seen: int
    needed: int
    smallest: float
    typical: float
    at: Mapping[str, float]
    pace: float
    derivatives: int
    short: bool
    zero: Mapping[str, int]
    faint: Mapping[str, int]
    readings: Mapping[str, Ends]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {name: dict(v) if isinstance(v := getattr(self, name), Mapping) else v for name in self.__slots__}


@dataclass(frozen=True)
class Region:
    """Where the rank is asked for: points x (N, n), u (N, m), t (N,), the operating point first unless a trajectory."""

    name: str
    x: Array
    u: Array
    t: Array
    box: Mapping[str, Ends]
    corners: tuple[Array, Array] = (np.zeros(0), np.zeros(0))


def region_of(plant: Plant) -> Region:
    """The box of the polytopic form, else the domain of φ and the declared ranges, else the operating point alone."""
    point, form, term = plant.point, plant.polytopic, plant.nonlinearity
    groups = (plant.signals.x, plant.signals.u)
    declared = {
        name: (value - reach, value + reach)
        for group, values in zip(groups, (point.x, point.u), strict=True)
        for name, reach, value in zip(group, group.ranges, values, strict=True)
        if math.isfinite(reach)
    }
    if form is not None:
        box, name = dict(form.box), "the box of [polytopic]"
    elif term is not None and term.domain:
        box, name = {**declared, **term.domain}, "the declared domain"
    elif any(state in declared for state in plant.signals.x):
        box, name = declared, "the declared ranges"
    else:
        box, name = {}, "the operating point"
    rest = np.array([*point.x, *point.u])
    points, ends = rest[None, :], np.column_stack([rest, rest])
    if box:
        spread = np.concatenate([units(plant), np.zeros(len(groups[1]))])  # where nothing is declared of a state
        names = [*groups[0], *groups[1]]
        ends = np.array([box.get(n, (v - s, v + s)) for n, v, s in zip(names, rest, spread, strict=True)])
        random = np.random.default_rng(0).random((POINTS, len(ends)))
        points = np.vstack([rest, ends[:, 0] + random * (ends[:, 1] - ends[:, 0])])
    x, u = points[:, : plant.n], points[:, plant.n :]
    return Region(name, x, u, np.zeros(len(points)), box, (ends[:, 0], ends[:, 1]))


def region_along(path: Trajectory) -> Region:
    """Points of a trajectory."""
    k = np.unique(np.linspace(0, len(path.t) - 1, ALONG).astype(int))
    return Region("the trajectory", path.x[k], path.u[k], path.t[k], {})


def ranked(plant: Plant, region: Region) -> Rank:
    """The rank of (x, faults) at the points of a region."""
    equations = Equations.of(plant)
    pace = _pace(equations)
    maps, derivatives, short = ladder(equations, pace)
    n, q, p, N = plant.n, len(plant.faults), plant.p, len(region.x)
    M, h = (np.array(part) for part in maps(region.x.T, region.u.T, region.t[None, :]))
    M = M.reshape(-1, N, n + q).transpose(1, 0, 2)
    M = np.where(np.isfinite(M).all(axis=2, keepdims=True), M, 0.0)  # the logarithm of nothing says nothing
    healthy = np.tile(np.logical_not(plant.F_f.any(axis=1)), M.shape[1] // p)
    apart = np.array([_apart(R[:, :n], R[:, n:]) for R in M])
    if region.name != "the trajectory":
        apart[0] |= _apart_at_rest(equations)
    whole = np.array([_rank(R) == n + q for R in M])
    known = not any(f.site == "actuator" for f in plant.faults)  # inputs that may be wrong show no state by themselves
    seen = np.array([known and _rank(R[healthy][:, :n]) == n for R in M])
    least = np.array([np.linalg.svd(R, compute_uv=False)[-1] if R.shape[0] >= n + q else 0.0 for R in M])
    worst = int(np.argmin(least))
    return Rank(
        region=region.name,
        points=N,
        separable=int(apart.sum()),
        full=int((whole & apart).sum()),
        seen=N if _detected(equations) else int(seen.sum()),
        needed=n + q,
        smallest=float(least[worst]),
        typical=float(np.median(least)),
        at=dict(zip(plant.signals.x, map(float, region.x[worst]), strict=True)),
        pace=pace,
        derivatives=derivatives,
        short=short,
        **_shown(equations, region, h),
    )


def enough(plant: Plant, sensor: str, largest: float) -> float:
    """The reading from which one sample shows a third of a fault of its size, and `FAINT` of the largest at least."""
    i = plant.signals.y.index(sensor)
    on = [f.size * abs(f.on[sensor]) for f in plant.faults if f.effect == "multiplicative" and f.on.get(sensor)]
    sd = 0.0 if plant.noise is None else plant.noise.sd[i]
    return max(FAINT * largest, 3.0 * sd / min(on, default=math.inf))


def _shown(equations: Equations, region: Region, h: Array) -> dict[str, Any]:
    """Of each sensor that loses gain: where it reads nothing, where too little, and between what."""
    plant = equations.plant
    size = np.abs(h).max(axis=1)
    low, high = h.min(axis=1), h.max(axis=1)
    if region.box:
        M = np.abs(np.hstack([plant.C, plant.D]))
        middle, half = 0.5 * (region.corners[0] + region.corners[1]), 0.5 * (region.corners[1] - region.corners[0])
        rest = np.array([*plant.point.x, *plant.point.u])
        centre = np.array(plant.point.y) + np.hstack([plant.C, plant.D]) @ (middle - rest)
        low, high = centre - M @ half, centre + M @ half
    lost = [(i, s) for i, s in enumerate(plant.signals.y) if equations.scaling[i].any()]
    zero = {s: int(np.sum(np.abs(h[i]) <= 1e-9 * max(size[i], 1e-300))) for i, s in lost}
    faint = {s: int(np.sum(np.abs(h[i]) < enough(plant, s, float(size[i])))) for i, s in lost}
    return {
        "zero": {s: count for s, count in zero.items() if count},
        "faint": {s: count for s, count in faint.items() if count},
        "readings": {s: (float(low[i]), float(high[i])) for i, s in lost},
    }


@lru_cache(maxsize=8)
def ladder(equations: Equations, pace: float) -> tuple[Any, int, bool]:
    """x, u, t to (∂(y, ẏ, ...)/∂(x, faults), h), columns and rows scaled; how many derivatives; whether cut short."""
    import casadi as ca

    plant, s = equations.plant, equations.sx()
    x, u, f, t = s["x"], s["u"], s["f"], s["t"]
    p = ca.SX.zeros(len(equations.parameters))
    right, y = equations.right(x, u, f, p, t), _logarithms(equations, equations.shown(x, u, f, p))
    order = plant.n + equations.q - 1
    moving = ca.which_depends(right, t, 1, True) if plant.nonlinearity is not None or plant.known is not None else []
    time = t if any(moving) else None
    if plant.sample_time is None:
        rungs = [pace**k * rung for k, rung in enumerate(lie_derivatives(y, right, x, order, t=time))]
    else:
        rungs = shifted_outputs(y, right, x, order, t=time, step=plant.sample_time)
    size = np.array([fault.size for fault in plant.faults])
    columns = ca.diag(ca.DM(np.concatenate([units(plant), size])))
    M = ca.jacobian(ca.vertcat(*rungs), ca.vertcat(x, f)) @ columns
    zero = ca.DM.zeros(equations.q)
    outputs = [ca.densify(ca.substitute(M, f, zero)), equations.healthy(x, u)]
    return ca.Function("ladder", [x, u, t], outputs), len(rungs) - 1, len(rungs) <= order


def _logarithms(equations: Equations, y: Any) -> Any:
    """The logarithm of readings that only lose gain, the others in their ranges."""
    import casadi as ca

    plant = equations.plant
    lost, added = equations.scaling, equations.adding
    scaled = [bool(lost[i].any()) and not added[i].any() for i in range(plant.p)]
    reach = [r if math.isfinite(r) else 1.0 for r in plant.signals.y.ranges]
    return ca.vertcat(*(0.5 * ca.log(y[i] ** 2) if scaled[i] else y[i] / reach[i] for i in range(plant.p)))


def _apart(of_state: Array, of_faults: Array) -> bool:
    """Whether no change of the state, and of the other faults, passes for a change of a fault."""
    weight = np.linalg.norm(np.hstack([of_state, of_faults]), axis=1)
    weight = np.where(weight > 0, weight, 1.0)[:, None]  # rows of high derivatives differ by orders of magnitude
    rest = unexplained(of_state / weight, of_faults / weight)
    return rest.shape[0] >= rest.shape[1] and float(np.linalg.svd(rest, compute_uv=False)[-1]) > RANK


def _rank(M: Array) -> int:
    weight = np.linalg.norm(M, axis=1)
    M = M / np.where(weight > 0, weight, 1.0)[:, None]
    length = np.linalg.norm(M, axis=0)
    s = np.linalg.svd(M / np.where(length > 0, length, 1.0), compute_uv=False) if M.size else np.zeros(0)
    return int(np.sum(s > RANK * s.max(initial=0.0)))


def _apart_at_rest(equations: Equations) -> bool:
    """The same at the operating point where that is an equilibrium: a constant fault against a plant at rest.

    For many states it is the better conditioned question of the two.
    """
    plant = equations.plant
    f, J, E, C, F = at_point(equations)
    still = 0.0 if plant.sample_time is None else 1.0
    size = units(plant)
    moved = np.abs((f - still * np.array(plant.point.x)) / size).max()
    if not (np.isfinite(J).all() and np.isfinite(F).all()):
        return False
    if moved > AT_REST * max(1e-300, float(np.abs(J * size / size[:, None]).max())) or not F.any() + E.any():
        return False
    return pencil_rank(J, E, C, F, still)[0] == plant.n + equations.q


def _detected(equations: Equations) -> bool:
    """Whether the healthy sensors of a linear plant see every mode that does not decay: the others need no seeing."""
    plant = equations.plant
    if plant.nonlinearity is not None or plant.known is not None or any(f.site == "actuator" for f in plant.faults):
        return False
    C = plant.C[np.logical_not(plant.F_f.any(axis=1))]
    return bool(C.size) and not undetectable_modes(plant.A, C, sampled=plant.sample_time is not None)


@lru_cache(maxsize=8)
def at_point(equations: Equations) -> tuple[Array, Array, Array, Array, Array]:
    """At the operating point without fault: f (n,), ∂f/∂x, ∂f/∂faults, ∂y/∂x, ∂y/∂faults."""
    import casadi as ca

    plant, s = equations.plant, equations.sx()
    x, u, f, t = s["x"], s["u"], s["f"], s["t"]
    p = ca.SX.zeros(len(equations.parameters))
    right, y = equations.right(x, u, f, p, t), equations.shown(x, u, f, p)
    outputs = [right, *(ca.densify(ca.jacobian(e, v)) for e in (right, y) for v in (x, f))]
    values = ca.Function("point", [x, u, f, t], outputs)(plant.point.x, plant.point.u, np.zeros(equations.q), 0.0)
    rest, J, E, C, F = (np.array(v) for v in values)
    return rest.ravel(), J, E, C, F


def modes(equations: Equations) -> NDArray[np.complex128]:
    """The modes at the operating point, per unit of time; of a sampled plant the logarithms of its multipliers."""
    J, step = at_point(equations)[1], equations.plant.sample_time
    if not np.isfinite(J).all():
        return np.zeros(0, dtype=complex)
    poles: NDArray[Any] = np.linalg.eigvals(J).astype(complex)
    if step is not None:
        poles = np.log(np.where(np.abs(poles) > 1e-12, poles, 1e-12)) / step
    return poles.astype(complex)


def _pace(equations: Equations) -> float:
    """A power of two near the plant's time constants."""
    rates = np.abs(modes(equations))
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    return float(np.exp2(np.rint(-np.mean(np.log2(rates))))) if rates.size else 1.0
