# SPDX-License-Identifier: BSD-3-Clause
"""Whether a fault that multiplies a sensor can be known at all, from what, and how far the number can be trusted.

    y = (1 + f) C x      an arbitrary f(t) hides x altogether; a slow one shows in how y changes

Three questions, for the plant's declared region or along a trajectory: are faults and state told apart (rank of y, ẏ,
ÿ, ...); how well at best (least deviation on a window); and which errors of the model read as a fault (bias budget).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.possibility_along import REACH, Contraction, Course, Trajectory, Window, model_run, named
from faultrecon.diagnosis.possibility_model import Equations, units
from faultrecon.diagnosis.possibility_points import AT_REST, Rank, at_point, modes, ranked, region_along, region_of
from faultrecon.diagnosis.possibility_said import findings_of
from faultrecon.finding import Finding, Inconclusive
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

SAMPLES = 1000
"""Samples of a held course: sensors that sample faster are thinned out, their noise with them."""
STEPS = 2000
"""Integration steps of a held course: of a stiff plant only the start is followed."""
DENSEST = 50
"""Samples per time constant where no noise, and so no hold time, is declared."""
LENGTHS = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Windows at the operating point, in time constants of the slowest mode."""
SHARES = (1 / 32, 1 / 16, 1 / 8, 1 / 4)
"""Windows along a trajectory, as parts of it."""
STARTS = 8


@dataclass(frozen=True, slots=True)
class Influence:
    """What one percent of error in one number of the plant does to the estimate of each constant fault, by name.

    The truth is one percent higher than the model has it; faults are zero.
    """

    parameter: str
    kind: str
    per_percent: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Gauge:
    """Changes of the plant's numbers that no reading can tell from a change of a fault.

    relative: by number, the relative changes that read as the fault changing by `fault_change`; the initial state is
    free.  The largest of them is one percent.
    """

    fault: str
    relative: Mapping[str, float]
    fault_change: float


@dataclass(frozen=True)
class Possibility:
    """The answer for one set of faults, with the numbers behind it.

    rank: at the points of a region.  windows: least deviations of constant faults, () where no noise is declared.
    contraction: of the model by itself, None where it has no course.  budget: per number of the plant, the strongest
    first, over the window `watched` (start, length).  gauges: exact ones.  held: no trajectory was given, inputs are
    held at the operating point.
    """

    faults: tuple[str, ...]
    rank: Rank
    windows: tuple[Window, ...]
    contraction: Contraction | None
    budget: tuple[Influence, ...]
    gauges: tuple[Gauge, ...]
    watched: tuple[float, float] | None
    held: bool
    findings: tuple[Finding, ...] = ()

    @property
    def any_waveform(self) -> bool:
        """Whether the healthy sensors tell the state, so that a fault of any waveform can be had."""
        return self.rank.seen == self.rank.points

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`; None stands for a deviation that no estimate reaches."""

        def plain(v: float) -> float | None:
            return float(v) if math.isfinite(v) else None

        run = self.contraction
        return {
            "rank": self.rank.as_dict(),
            "any_waveform": self.any_waveform,
            "windows": [
                {"start": w.start, "length": w.length, "deviation": {k: plain(v) for k, v in w.deviation.items()}}
                for w in self.windows
            ],
            "contraction": None if run is None else {k: getattr(run, k) for k in (*run.__slots__, "forgets")},
            "budget": [
                {
                    "parameter": i.parameter,
                    "kind": i.kind,
                    "per_percent": {k: plain(v) for k, v in i.per_percent.items()},
                }
                for i in self.budget
            ],
            "gauges": [
                {"fault": g.fault, "relative": dict(g.relative), "fault_change": g.fault_change} for g in self.gauges
            ],
            "watched": None if self.watched is None else list(self.watched),
            "held": self.held,
        }

    def __str__(self) -> str:
        return "\n".join(str(f) for f in self.findings)


def possibility(
    plant: Plant, trajectory: Any = None, windows: Sequence[tuple[float, float]] | None = None
) -> Possibility:
    """Whether the declared faults, some of which multiply, can be known while they hardly move, and how well.

    trajectory: a run, or (t, u, x) absolute, along which everything is asked; without it the rank is asked at points
    of the declared region and the rest at the operating point with inputs held.  windows: (start, length) of each
    window on it.  Faults of every kind count as constant.  Raises InputError on a trajectory that is none of this
    plant.
    """
    if trajectory is None:
        return _at_point(plant)
    path = Trajectory.of(plant, trajectory)
    t0, span = float(path.t[0]), float(path.t[-1] - path.t[0])
    if windows is None:
        starts = t0 + span * np.arange(STARTS) / STARTS
        pairs = ((float(s), span * share) for share in SHARES for s in starts)
        windows = [(s, length) for s, length in pairs if s + length <= t0 + span * (1 + 1e-9)]
    return _said(plant, _measured(plant, Course(Equations.of(plant), path), windows, ranked(plant, region_along(path))))


@lru_cache(maxsize=16)
def _at_point(plant: Plant) -> Possibility:
    """Without a trajectory: the declared region, and a course with held inputs from the operating point."""
    rank = ranked(plant, region_of(plant))
    try:
        course, unit = _held(Equations.of(plant))
        found = _measured(plant, course, [(0.0, unit * k) for k in LENGTHS], rank)
        gauges = _exact(course, unit) if found.budget else ()
        found = replace(found, gauges=gauges, contraction=_at_rest(course) or found.contraction)
    except Inconclusive:
        found = Possibility(tuple(f.name for f in plant.faults), rank, (), None, (), (), None, True)
    return _said(plant, replace(found, held=True))


def _said(plant: Plant, found: Possibility) -> Possibility:
    return replace(found, findings=tuple(findings_of(plant, found)))


def _exact(held: Course, unit: float) -> tuple[Gauge, ...]:
    """The gauges of a plant that moves: at rest, all readings alike, many more errors pass for a fault.

    Inputs swing by half of what is declared of them and the state starts off the operating point.
    """
    plant, t = held.plant, held.path.t
    region = region_of(plant)
    half = 0.5 * (region.corners[1] - region.corners[0])
    n = plant.n
    start = np.array(plant.point.x) + 0.2 * np.where(half[:n] > 0, half[:n], units(plant))
    reach = np.where(half[n:] > 0, 0.5 * half[n:], 0.1 * np.maximum(np.abs(plant.point.u), 1.0))
    # Frequencies without a common period, so that no two inputs move alike.
    phases = np.sqrt(np.arange(2.0, 2.0 + len(reach))) * (t / unit)[:, None]
    u = np.array(plant.point.u) + reach * np.sin(phases)
    try:
        course = replace(held, path=Trajectory(t, u, model_run(plant, t, u, start)))
        return _budget(course, float(t[0]), float(t[-1] - t[0]), float(t[1] - t[0]))[1]
    except Inconclusive:
        return ()


def _measured(plant: Plant, course: Course, windows: Sequence[tuple[float, float]], rank: Rank) -> Possibility:
    """Windows, contraction and budget along one course."""
    names, noise, t = tuple(f.name for f in plant.faults), plant.noise, course.path.t
    every = max(noise.hold if noise is not None else 0.0, float(np.diff(t).min()))
    quiet = noise is None or not all(noise.sd)
    found = () if quiet else course.windows(windows, every)
    watched = max(windows, key=lambda w: w[1], default=None)
    budget, gauges = ((), ()) if watched is None or not rank.separable else _budget(course, *watched, every)
    return Possibility(names, rank, found, course.contraction(), budget, gauges, watched, False)


def _budget(
    course: Course, start: float, length: float, every: float
) -> tuple[tuple[Influence, ...], tuple[Gauge, ...]]:
    off, sets = course.budget(start, length, every)
    names, numbers = [f.name for f in course.plant.faults], course.equations.parameters
    rows = [
        Influence(one.name, one.kind, {name: 0.01 * float(off[j, k]) for j, name in enumerate(names)})
        for k, one in enumerate(numbers)
    ]
    rows.sort(key=lambda row: -max((abs(v) for v in row.per_percent.values() if math.isfinite(v)), default=0.0))
    gauges = []
    for name, found in zip(names, sets, strict=True):
        for one in found:
            # A change of the fault by 1 undoes these; so they, in the plant, read as the fault changing by -1.
            relative = named(numbers, one)
            unit = 0.01 / max(relative.values(), key=abs)
            gauges.append(Gauge(name, {k: v * unit for k, v in relative.items()}, -unit))
    return tuple(rows), tuple(gauges)


def _held(equations: Equations) -> tuple[Course, float]:
    """The course from the operating point under held inputs, and its slowest time constant."""
    plant, rates = equations.plant, modes(equations)
    size = np.abs(rates.real)
    size = size[size > 1e-6 * np.abs(rates).max(initial=0.0)]
    unit = 1.0 / float(size.min()) if size.size else 1.0
    growth = float(rates.real.max(initial=0.0))
    if growth > 0:  # not beyond e^10: what has grown further is no plant any more
        unit = min(unit, 10.0 / (growth * LENGTHS[-1]))
    if plant.sample_time is None and size.size:
        unit = min(unit, STEPS * REACH / float(np.abs(rates).max()) / LENGTHS[-1])
    noise, step = plant.noise, plant.sample_time
    hold = unit / DENSEST if noise is None else noise.hold
    if step is not None:
        count = int(min(SAMPLES, max(LENGTHS[-1] * unit / step, 2 * (plant.n + equations.q))))
        dt, unit = step, step * count / LENGTHS[-1]
    else:
        dt = max(hold, LENGTHS[-1] * unit / SAMPLES)
        dt = min(dt, unit / 4)
        count = max(1, round(LENGTHS[-1] * unit / dt))
    t = dt * np.arange(count + 1, dtype=float)
    u = np.tile(np.array(plant.point.u), (len(t), 1))
    course = Course(equations, Trajectory(t, u, _states(equations, t, u)), max(1.0, dt / hold))
    return course, unit


def _at_rest(course: Course) -> Contraction | None:
    """The contraction of a plant that rests: over the slowest time constants, however stiff; None where it moves."""
    from scipy.linalg import expm

    equations, path = course.equations, course.path
    plant, rates = equations.plant, modes(equations).real
    if np.ptp(path.x, axis=0).any() or plant.sample_time is not None or not rates.size:
        return None
    slowest = float(np.abs(rates).min()) or float(np.abs(rates).max()) or 1.0
    J, scale = at_point(equations)[1], units(plant)
    span = LENGTHS[-1] / max(slowest, 1e-6 * float(np.abs(rates).max()))
    with np.errstate(over="ignore", invalid="ignore"):  # the peak of |e^(Jt)| may come early: times crowd there
        products = [expm(J * scale / scale[:, None] * time) for time in np.geomspace(span / 4096, span, 97)]
    sizes = [float(np.linalg.norm(one, 2)) if np.isfinite(one).all() else math.inf for one in products]
    left, peak = min(sizes[-1], math.exp(700.0)), min(max(1.0, *sizes), math.exp(700.0))
    return Contraction(0.0, span, peak, left, -math.log(max(left, 1e-300)) / span)


def _states(equations: Equations, t: Array, u: Array) -> Array:
    """At rest where the operating point is an equilibrium: rounding then cannot drive an unstable plant off it."""
    plant, (f, J, *_) = equations.plant, at_point(equations)
    start = np.array(plant.point.x)
    moved = f if plant.sample_time is None else f - start
    if np.abs(moved).max() <= AT_REST * max(1e-300, float(np.abs(J).max()) * max(1.0, float(np.abs(start).max()))):
        return np.tile(start, (len(t), 1))
    return model_run(plant, t, u)
