# SPDX-License-Identifier: BSD-3-Clause
"""The well-posed design problem: optimum, back-off, pole bound, second criterion, rounding, proof, report."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Finding, Impossible, Inconclusive, InputError
from faultrecon.lmi.solve import Outcome, solve
from faultrecon.methods.base import ClosedForm, Method, Unproved
from faultrecon.methods.registry import method as method_named
from faultrecon.numerics.level import LevelSolution
from faultrecon.plant.plant import Plant
from faultrecon.synthesis import riccati_route
from faultrecon.synthesis.ladder import Central, climb, pick
from faultrecon.synthesis.levels import INSIDE, Posed, at_zero, pose
from faultrecon.synthesis.refusals import below_floor, below_method, no_answer, no_proof, no_solution
from faultrecon.synthesis.report import describe
from faultrecon.synthesis.result import Design

Array = NDArray[np.float64]
Progress = Callable[[str], None]

STEP_SHARE = 2.0
"""Default pole bound times sample time, inside the 2.785 at which classical Runge-Kutta turns unstable."""
OWN_SHARE = 10.0
"""Default pole bound over the plant's fastest mode where no sample time is known: an observer need not be faster."""
LARGEST_LEVEL = 1e60
"""Its square, in any units the program may choose, is still a float."""
AGREEMENT = 1e-4
"""Relative difference of the two routes to an optimum that is worth a note; the solver is good to 1e-5 or better."""
GROWTH = (1.0, 2.0, 4.0, 20.0, 200.0, 2e3, 2e4, 2e5)
"""By how much the back-off may grow before a design is given up as not certified: where a sensor is free of noise the
optimum is nearly zero, and levels that gains of ordinary size can reach are many times that."""


def design(
    plant: Plant,
    method: str = "lipschitz-hinf",
    *,
    faults: Sequence[str] | None = None,
    level: float | None = None,
    backoff: float | None = None,
    pole_bound: float | str | None = "auto",
    fix: Mapping[str, Any] | None = None,
    free: Sequence[str] = (),
    certify: bool = True,
    progress: Progress | None = None,
) -> Design:
    """Gains with a guaranteed level, rounded to float64 and proved.

    faults: names of the faults to reconstruct, the others taken as healthy; all by default.  level: γ to aim at; by
    default (1 + backoff) times the optimum under the pole bound.  backoff: 0.05, or what the method says.
    pole_bound: ρ in rad/s for Re λ > -ρ, None for none,
    "auto" for 2 / (noise hold time), or ten times the plant's fastest mode where no noise is declared.  fix, free:
    unknowns of the theorem held or set free, by letter.  certify=False gives a baseline's gains without a proof.
    progress: called with a word before each stage.

    Raises Impossible (an assumption fails, the level is below what the method or anybody can reach), Inconclusive (the
    solver gave up, or no proof was found), InputError.
    """
    started = time.perf_counter()
    say = progress or (lambda stage: None)
    if faults is not None:
        plant = plant.with_faults(faults)
    chosen = method_named(method).sampling(fix or {})
    backoff = chosen.backoff if backoff is None else backoff
    _options(backoff, level)
    if not certify or isinstance(chosen, Unproved):
        return _unproved(chosen, plant, started)
    findings = _allowed(chosen, plant)
    say("floor")
    peak = chosen.floor(plant)
    floor = None if peak is None else peak.value
    if level is not None and floor is not None and level < floor:
        raise Impossible(below_floor(level, floor))
    say("optimum")
    route = _route(chosen, plant, fix, tuple(free), pole_bound, level)
    posed, best, bounded, notes = route.posed, route.best, route.bounded, route.notes
    if level is not None and level <= bounded:
        raise Impossible(below_method(level, bounded, floor, posed))
    targets = [level] if level is not None else [(1.0 + backoff * growth) * bounded for growth in GROWTH]
    proven, rungs = climb(posed, targets, say, route.central)
    if proven is None:
        raise Inconclusive(no_proof(posed, rungs))
    if proven.level > 2.0 * bounded and level is None:
        notes = (
            *notes,
            f"the level is {proven.level / bounded:.3g} times the optimum: nearer to it no gains were proved",
        )
    details = describe(
        plant,
        chosen.observer(plant, proven.gains),
        proven.gains,
        criterion=proven.criterion,
        backoff=proven.level / bounded - 1.0,
        pole_bound=posed.pole_bound,
        bounded_optimum=bounded if posed.pole_bound is not None else None,
        attempts=tuple(str(rung) for rung in rungs),
        seconds=time.perf_counter() - started,
        notes=(*notes, *at_zero(posed), *chosen.notes(plant, proven.gains), *(str(f) for f in findings)),
    )
    result = Design(plant, method, proven.gains, best, proven.level, floor, proven.certificate, details)
    result.__dict__["verification"] = proven.verification  # fills the cached property: the proof is not run twice
    return result


def optimum(
    plant: Plant,
    method: str = "lipschitz-hinf",
    *,
    fix: Mapping[str, Any] | None = None,
    free: Sequence[str] = (),
    pole_bound: float | None = None,
    all_states: bool = False,
) -> float:
    """The infimum of the level; all_states gives the nonlinearity's structure away, as the paper prints its inequality.

    Raises Impossible when the inequality has no solution, Inconclusive when the solver cannot tell.
    """
    chosen = method_named(method).sampling(fix or {})
    if (closed := chosen.closed_form(plant)) is not None:
        return closed.optimum
    posed = pose(
        chosen,
        plant.reading_all_states() if all_states else plant,
        fix=fix,
        free=tuple(free),
        pole_bound=pole_bound,
    )
    return _level(posed.optimum(), posed)


# ---------------------------------------------------------------- stages


def _options(backoff: float, level: float | None) -> None:
    if not (math.isfinite(backoff) and backoff > 0):
        raise InputError(f"the back-off is {backoff}", why="the optimum itself is not attained; 0.05 is usual")
    if level is not None and not 0 < level < LARGEST_LEVEL:
        raise InputError(f"the level is {level}", why=f"γ is a positive number below {LARGEST_LEVEL:g}")


def _allowed(chosen: Method, plant: Plant) -> list[Finding]:
    """What the plant violates of the method's assumptions without forbidding a design.  Raises Impossible otherwise."""
    findings = chosen.assumptions(plant)
    for finding in findings:
        if finding.severity == "fatal":
            raise Impossible(finding)
    return findings


@dataclass(frozen=True, eq=False)
class Route:
    """The problem to be proved, the optimum without and with its pole bound, and where gains come from.

    central: None for the program itself.
    """

    posed: Posed
    best: float
    bounded: float
    notes: tuple[str, ...]
    central: Central | None = None


def _route(
    chosen: Method,
    plant: Plant,
    fix: Mapping[str, Any] | None,
    free: tuple[str, ...],
    pole_bound: float | str | None,
    level: float | None,
) -> Route:
    """How this method finds gains for this plant: program, Riccati equations, closed form, or by way of a stand-in."""
    posed = pose(chosen, plant, fix=fix, free=free)
    by_riccati = riccati_route.optimum(posed)
    if by_riccati is not None and plant.n >= riccati_route.LARGE:
        best, beta = by_riccati.gamma, by_riccati.beta
        central = Central(lambda at: (riccati_route.gains(posed, at, beta, best), "central gain (Riccati)"))
        return Route(posed, best, best, ("a large plant: Riccati route, central gains, no pole bound",), central)
    if (closed := chosen.closed_form(plant)) is not None:
        central = Central(lambda at: (_closed(closed, posed, at), closed.name), multipliers=False)
        return Route(posed, closed.optimum, closed.optimum, (), central)
    if (stand_in := chosen.stand_in(plant)) is not None:
        other = pose(chosen, stand_in, fix=fix, free=free)
        best = _level(other.optimum(), other)
        other, bounded, notes = _bounded(chosen, stand_in, fix, free, pole_bound, best, level)
        notes += ("gains and optimum are those of the plant with its nearly hidden mode hidden; proved for the plant",)
        central = Central(partial(pick, other), multipliers=False, theorem=other.theorem)
        return Route(posed, best, bounded, notes, central)
    best, notes = _checked_optimum(posed, by_riccati)
    posed, bounded, more = _bounded(chosen, plant, fix, free, pole_bound, best, level)
    return Route(posed, best, bounded, notes + more)


def _closed(form: ClosedForm, posed: Posed, level: float) -> Outcome:
    """The gains of a closed form as if a solver had found them, without multipliers."""
    values = form.at(level)
    if values is None:
        return Outcome("unknown", solver=f"{form.name}: no gains at this level")
    return Outcome("solved", {**posed.held(), **values}, posed.theorem.objective(level), form.name)


def _checked_optimum(posed: Posed, by_riccati: LevelSolution | None) -> tuple[float, tuple[str, ...]]:
    """The optimum by both routes where both apply; the Riccati value, unless its own bounds are apart.

    The Riccati search ends with a level that was reached and one that cannot be; a solver gives one number.  Where they
    do not meet, the better founded one is quoted with a note.
    """
    outcome = posed.optimum()
    if by_riccati is None:
        return _level(outcome, posed), ()
    settled = by_riccati.gamma <= (1.0 + AGREEMENT) * by_riccati.lower
    if not outcome.solved:
        return by_riccati.gamma, (f"the optimum is by the Riccati route; the solver's word was '{outcome.solver}'",)
    by_solver = _level(outcome, posed)
    if not settled:
        return by_solver, ()
    if abs(by_solver - by_riccati.gamma) <= AGREEMENT * by_riccati.gamma:
        return by_riccati.gamma, ()
    note = f"two routes to the optimum disagree: {by_riccati.gamma:.9g} (Riccati) and {by_solver:.9g} (solver)"
    # A point strictly inside between the two refutes the other route's bound; without one the solver stopped too low.
    between = posed.at_level(math.sqrt(by_solver * by_riccati.gamma))
    refuted = by_solver < by_riccati.gamma and solve(between, margin=INSIDE).solved
    return (by_solver if refuted else by_riccati.gamma), (note,)


def _level(outcome: Outcome, posed: Posed) -> float:
    if outcome.solved:
        return posed.theorem.level(outcome.objective)
    if (known := posed.method.unsolvable(posed.plant)) is not None:
        raise Impossible(known)
    if outcome.status == "infeasible":
        raise Impossible(no_solution(posed, outcome))
    raise Inconclusive(no_answer(posed, outcome))


def _bounded(
    chosen: Method,
    plant: Plant,
    fix: Mapping[str, Any] | None,
    free: tuple[str, ...],
    pole_bound: float | str | None,
    best: float,
    level: float | None,
) -> tuple[Posed, float, tuple[str, ...]]:
    """The problem under its pole bound and its optimum; an automatic bound is doubled while it forbids a solution."""
    if pole_bound is not None and pole_bound != "auto":
        if isinstance(pole_bound, str) or not (math.isfinite(pole_bound) and pole_bound > 0):
            raise InputError(f"the pole bound is {pole_bound!r}", why="it is 'auto', None or a positive number")
        posed = pose(chosen, plant, fix=fix, free=free, pole_bound=float(pole_bound))
        return posed, _level(posed.optimum(), posed), ()
    bound = wanted = math.inf if pole_bound is None or chosen.sampled else automatic_pole_bound(plant)
    if math.isinf(bound):
        return pose(chosen, plant, fix=fix, free=free), best, ()
    for _ in range(8):
        posed = pose(chosen, plant, fix=fix, free=free, pole_bound=bound)
        outcome = posed.optimum()
        if outcome.solved and (level is None or level > _level(outcome, posed)):
            note = () if bound == wanted else (f"the pole bound was raised from {wanted:.4g} to {bound:.4g} rad/s",)
            return posed, _level(outcome, posed), note
        bound *= 2.0
    return pose(chosen, plant, fix=fix, free=free), best, ("no automatic pole bound had a solution; none is set",)


def automatic_pole_bound(plant: Plant) -> float:
    """ρ in rad/s: 2 / (time for which a noise sample is held), else ten times the fastest mode of the plant."""
    if plant.noise is not None:
        return STEP_SHARE / plant.noise.hold
    fastest = float(np.abs(np.linalg.eigvals(plant.A)).max())
    return OWN_SHARE * fastest if fastest > 0 else math.inf


def _unproved(chosen: Method, plant: Plant, started: float) -> Design:
    findings = _allowed(chosen, plant) if isinstance(chosen, Unproved) else []
    gains = chosen.gains_without_proof(plant)
    if gains is None:
        raise InputError(f"{chosen.name} has no gains without its theorem", remedies=("leave certify=True",))
    details = describe(
        plant,
        chosen.observer(plant, gains),
        gains,
        criterion=chosen.criterion,
        backoff=0.0,
        pole_bound=None,
        bounded_optimum=None,
        attempts=(),
        seconds=time.perf_counter() - started,
        notes=(*chosen.notes(plant, gains), *(str(f) for f in findings)),
    )
    return Design(plant, chosen.name, gains, None, None, None, None, details)
