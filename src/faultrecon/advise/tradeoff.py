# SPDX-License-Identifier: BSD-3-Clause
"""What a design would have to give up: the level against the Lipschitz constant, the domain, the pole bound, the units.

Every number here is found by posing the problem again with it, so that a remedy which is printed has been tried.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from faultrecon.finding import FaultreconError, Impossible, Inconclusive, InputError
from faultrecon.graph.enclose import lipschitz_bound, lipschitz_per_channel
from faultrecon.lmi.solve import Outcome
from faultrecon.methods.base import Method
from faultrecon.plant.lipschitz import Lipschitz
from faultrecon.plant.plant import Plant
from faultrecon.synthesis import riccati_route
from faultrecon.synthesis.levels import Posed, pose, scale

BACKOFF = 1.05
"""A level that is offered lies this far above an optimum, as designs do by default: the optimum is not attained."""
HAIR = 1e-4
"""Relative width of a bracket at which bisection ends: four digits are printed."""
ROOM = 0.9
"""Share of the largest constant with a solution that is offered: at the limit itself the level has no bound."""
SHARES = (0.25, 0.5, 0.75, ROOM)
"""Where the level is computed along the way to the limit."""
HALVINGS = 20
"""Below a millionth of what was asked for, the nonlinearity is not what stands in the way."""


@dataclass(frozen=True, eq=False)
class Question:
    """A method asked for a level on a plant, with what is held fixed and the pole bound in rad/s (None: no bound)."""

    method: Method
    plant: Plant
    fix: Mapping[str, Any] = field(default_factory=dict)
    free: tuple[str, ...] = ()
    pole_bound: float | None = None

    @cached_property
    def posed(self) -> Posed:
        """The theorem in scaled units."""
        return pose(self.method, self.plant, fix=self.fix, free=self.free, pole_bound=self.pole_bound)

    @cached_property
    def outcome(self) -> Outcome:
        """What the solver says; an assumption that fails counts as no solution."""
        if any(f.severity == "fatal" for f in self.method.assumptions(self.plant)):
            return Outcome("infeasible", solver="an assumption fails")
        return self.posed.optimum()

    @cached_property
    def optimum(self) -> float:
        """The infimum of the level, infinite where there is no solution, NaN where no answer was reached."""
        try:
            found = riccati_route.optimum(self.posed) if self._allowed and self.pole_bound is None else None
        except Impossible:  # said of large plants alone, by the Riccati route
            return math.inf
        if found is not None:
            return found.gamma
        if self.outcome.solved:
            return self.posed.theorem.level(self.outcome.objective)
        return math.inf if self.outcome.status == "infeasible" else math.nan

    @property
    def _allowed(self) -> bool:
        return not any(f.severity == "fatal" for f in self.method.assumptions(self.plant))

    def reaches(self, level: float | None) -> bool | None:
        """Whether a solution exists, at a level with room above the optimum where one is given; None: no answer."""
        if math.isnan(self.optimum):
            return None
        return self.optimum < math.inf if level is None else BACKOFF * self.optimum <= level

    def at(self, constant: float) -> Question:
        """The same question for another Lipschitz constant."""
        term = self.plant.nonlinearity
        assert term is not None
        return replace(self, plant=replace(self.plant, nonlinearity=term.at(constant)))


@dataclass(frozen=True)
class TradeOff:
    """The largest Lipschitz constant tried with a solution, the smallest without, and the optimum at some in between.

    levels: pairs (α, γ), α rising.
    """

    solvable: float
    unsolvable: float
    levels: tuple[tuple[float, float], ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {
            "solvable": self.solvable,
            "unsolvable": self.unsolvable,
            "levels": [list(pair) for pair in self.levels],
        }


def trade_off(question: Question, level: float | None = None) -> TradeOff | None:
    """How far the Lipschitz constant has to come down for a solution (at a level); None where that is no help."""
    term = question.plant.nonlinearity
    if term is None or term.constant == 0 or question.at(0.0).reaches(level) is False:
        return None
    ends = _bracket(lambda c: question.at(c).reaches(level), term.constant)
    if ends is None:
        return None
    levels = [(share * ends[0], question.at(share * ends[0]).optimum) for share in SHARES]
    return TradeOff(*ends, tuple(pair for pair in levels if math.isfinite(pair[1])))


def sufficient_pole_bound(question: Question, level: float | None = None) -> Question | None:
    """The question under the first doubled pole bound with a solution (at a level); None where none helps.

    Doubled and not bisected: at the smallest bound with a solution the level has no bound.
    """
    if question.pole_bound is None or not replace(question, pole_bound=None).reaches(level):
        return None
    for k in range(1, HALVINGS):
        wider = replace(question, pole_bound=question.pole_bound * 2.0**k)
        if wider.reaches(level):
            return wider
    return None


def _bracket(holds: Callable[[float], bool | None], bad: float) -> tuple[float, float] | None:
    """(good, bad): halves `bad` until something holds, then bisects between the two, geometrically."""
    good = bad
    for _ in range(HALVINGS):
        good *= 0.5
        if holds(good):
            break
        bad = good
    else:
        return None
    while bad - good > HAIR * bad:
        middle = math.sqrt(good * bad)
        answer = holds(middle)
        if answer is None:  # too near the limit for the solver: the bracket that is known is what is reported
            break
        good, bad = (middle, bad) if answer else (good, middle)
    return good, bad


# ---------------------------------------------------------------- the nonlinearity


@dataclass(frozen=True)
class Domain:
    """A box for what φ reads, by state, and the Lipschitz constant that is proved on it."""

    box: Mapping[str, tuple[float, float]]
    constant: float

    def __str__(self) -> str:
        return ", ".join(f"{name} in [{a:.4g}, {b:.4g}]" for name, (a, b) in self.box.items())


def smaller_domain(plant: Plant, constant: float) -> Domain | None:
    """The largest box of the declared shape on which φ is proved to have at most this Lipschitz constant, or None.

    The box shrinks towards the operating point (the middle where that lies outside); its ends are rounded inwards to
    the four digits that are printed, and the constant is that of the rounded box.  Without a declared domain its shape
    is that of the declared ranges, one unit where there is none.
    """
    term = plant.nonlinearity
    if term is None or not term.reads:
        return None
    centre, half = _shape(plant, term)
    best = _on(term, _box(term, centre, half, 1.0))
    if best is not None and best.constant <= constant:
        return best
    low, high, best = 0.0, 1.0, None
    for _ in range(14):  # to a ten-thousandth of the declared width
        middle = 0.5 * (low + high)
        found = _on(term, _box(term, centre, half, middle))
        if found is not None and found.constant <= constant:
            low, best = middle, found
        else:
            high = middle
    return best


def strongest_component(plant: Plant) -> tuple[str, float, float] | None:
    """The equation that the steepest component of φ enters, its constant, and the next; None: no telling."""
    term = plant.nonlinearity
    if term is None or term.phi.n_outputs < 2 or set(term.domain) != set(term.reads) or leans_on_inputs(term):
        return None
    try:
        bounds = lipschitz_per_channel(term.phi, "x", [term.domain[name] for name in term.reads], others=_nowhere(term))
    except InputError:
        return None
    values = np.array([b.value for b in bounds])
    k = int(values.argmax())
    equation = plant.signals.x.names[int(np.abs(term.into[:, k]).argmax())]
    return equation, float(values[k]), float(np.delete(values, k).max())


def _shape(plant: Plant, term: Lipschitz) -> tuple[np.ndarray, np.ndarray]:
    """Centre (s,) and half-widths (s, 2) below and above it."""
    x = plant.signals.x
    where = [x.index(name) for name in term.reads]
    centre = np.array([plant.point.x[k] for k in where])
    sizes = np.array([1.0 if math.isnan(x.ranges[k]) else x.ranges[k] for k in where])
    lower, upper = term.limits
    lower = np.where(np.isfinite(lower), lower, centre - sizes)
    upper = np.where(np.isfinite(upper), upper, centre + sizes)
    centre = np.where((lower < centre) & (centre < upper), centre, 0.5 * (lower + upper))
    return centre, np.stack([centre - lower, upper - centre], axis=1)


def _box(term: Lipschitz, centre: np.ndarray, half: np.ndarray, share: float) -> dict[str, tuple[float, float]]:
    box = {}
    for name, c, (below, above) in zip(term.reads, centre, half, strict=True):
        if share == 1.0:
            box[name] = (float(c - below), float(c + above))
            continue
        unit = 10.0 ** (math.floor(math.log10(share * max(below, above))) - 3)
        ends = math.ceil((c - share * below) / unit), math.floor((c + share * above) / unit)
        box[name] = (float(f"{ends[0] * unit:.12g}"), float(f"{ends[1] * unit:.12g}"))
    return box


def _on(term: Lipschitz, box: Mapping[str, tuple[float, float]]) -> Domain | None:
    """The box with its constant; None where nothing is proved, or where the proof would lean on inputs or the time."""
    if any(a >= b for a, b in box.values()) or leans_on_inputs(term):
        return None
    try:
        bound = lipschitz_bound(term.phi, "x", [box[name] for name in term.reads], others=_nowhere(term))
    except InputError:
        return None
    return Domain(box, bound.value) if math.isfinite(bound.value) else None


def slope_at_point(plant: Plant) -> float | None:
    """The steepest slope of φ in a millionth of its domain about the operating point; None where nobody can tell."""
    term = plant.nonlinearity
    if term is None or not term.reads or leans_on_inputs(term):
        return None
    centre, half = _shape(plant, term)
    box = [(float(c - 1e-6 * below), float(c + 1e-6 * above)) for c, (below, above) in zip(centre, half, strict=True)]
    try:
        return lipschitz_bound(term.phi, "x", box, others=_nowhere(term)).lower
    except InputError:
        return None


def _nowhere(term: Lipschitz) -> dict[str, list[tuple[float, float]]]:
    """One point for the groups that φ does not look at."""
    return {group: [(0.0, 0.0)] * len(term.phi.inputs[group]) for group in ("u", "t")}


def leans_on_inputs(term: Lipschitz) -> bool:
    """Whether φ looks at an input or at the time."""
    groups = list(term.phi.inputs)
    return any(node[0] == "input" and groups[int(node[1])] != "x" for node in term.phi.nodes)


def states_used(term: Lipschitz) -> tuple[str, ...]:
    """The states that occur in φ, which may be fewer than those it is declared to read."""
    group = list(term.phi.inputs).index("x")
    used = {int(node[2]) for node in term.phi.nodes if node[0] == "input" and int(node[1]) == group}
    return tuple(name for k, name in enumerate(term.reads) if k in used)


# ---------------------------------------------------------------- the units


@dataclass(frozen=True)
class Spread:
    """A state or sensor, and by how many powers of ten the coefficients in its scaled rows and columns differ."""

    signal: str
    decades: float


def scaling_suspects(plant: Plant) -> tuple[Spread, ...]:
    """States and sensors by how far their coefficients are apart after scaling, worst first: what upsets a solver."""
    units = scale(plant)
    t = np.exp2(units.state.astype(float))
    w = plant.letters()["W"]
    A, C = plant.A * (t[None, :] / t[:, None]), plant.C * t[None, :]
    inputs = np.hstack([plant.E_w @ w, plant.G]) / t[:, None]
    found = [
        Spread(name, _decades(np.concatenate([A[i], A[:, i], inputs[i], C[:, i]])))
        for i, name in enumerate(plant.signals.x.names)
    ]
    found += [
        Spread(name, _decades(np.concatenate([C[i], (plant.F_w @ w)[i]])))
        for i, name in enumerate(plant.signals.y.names)
    ]
    return tuple(sorted(found, key=lambda s: (-s.decades, s.signal)))


def _decades(values: np.ndarray) -> float:
    sizes = np.abs(values[values != 0])
    return float(np.log10(sizes.max() / sizes.min())) if sizes.size else 0.0


def optimum_of(method: Method, plant: Plant) -> float:
    """The optimum of another method on this plant; infinite where it has none, NaN where there is no answer."""
    try:
        return Question(method, plant).optimum
    except (Impossible, Inconclusive):
        return math.inf
    except FaultreconError:
        return math.nan
