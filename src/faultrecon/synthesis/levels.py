# SPDX-License-Identifier: BSD-3-Clause
"""The levels of a theorem: the optimum, the optimum under a pole bound, and gains at a given level.

The optima are infima that no gain attains: near them gains grow without bound and P loses rank.  So a level is backed
off, and among the gains that reach it one is picked by a second criterion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.limits import reconstruction_floor
from faultrecon.finding import InputError
from faultrecon.lmi.expr import Expr, I, Inequality, __, as_expr, given, sym, unknown
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.solve import Outcome, solve
from faultrecon.lmi.walk import leaves
from faultrecon.methods.base import Method, Scaling, Theorem
from faultrecon.numerics.annihilator import annihilator
from faultrecon.numerics.scaling import state_scaling
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.certify import proof_inequalities

Array = NDArray[np.float64]

INSIDE = 1e-7
"""How far inside each scaled inequality a point has to lie: 100 times the solver's tolerance of 1e-9."""
ROUNDS = 8
"""Majorisation steps of the second criterion; each lowers it, and later ones by less than a part in a thousand."""


@dataclass(frozen=True)
class Posed:
    """A method's theorem on a plant in scaled units, with what is held fixed and the pole bound ρ (None: no bound)."""

    method: Method
    plant: Plant
    scaling: Scaling
    theorem: Theorem
    fixed: Mapping[str, Any]
    pole_bound: float | None = None

    def inequalities(self) -> list[Inequality]:
        """The theorem's inequalities, and Re λ > -ρ for the error dynamics with the same P when a bound is set."""
        found = list(self.theorem.inequalities)
        if self.pole_bound is not None:
            for X in self.theorem.drifts or [self.theorem.drift]:
                found.append(Inequality(X + X.T + 2 * self.pole_bound * self.theorem.lyapunov, ">", 0, "pole bound"))
        return found

    def problem(self) -> Problem:
        """The smallest squared level as a semidefinite program."""
        return Problem(self.inequalities(), self.theorem.minimise, self.fixed)

    def held(self) -> dict[str, Any]:
        """What is held fixed, in full shape, by letter."""
        shapes = {k: leaf.shape for i in self.theorem.inequalities for k, leaf in leaves([i.expr], "unknown").items()}
        return {k: np.broadcast_to(np.asarray(v, float), shapes[k]) for k, v in self.fixed.items() if k in shapes}

    def optimum(self) -> Outcome:
        """The smallest squared level."""
        return solve(self.problem())

    def at_level(self, level: float) -> Problem:
        """The feasibility problem at a level."""
        fixed = {**self.fixed, self.theorem.minimise.name: self.theorem.objective(level)}
        return Problem(self.inequalities(), None, fixed)


def pose(
    method: Method,
    plant: Plant,
    *,
    fix: Mapping[str, Any] | None = None,
    free: tuple[str, ...] = (),
    pole_bound: float | None = None,
) -> Posed:
    """State the method's theorem for the plant in units that suit floating point.

    fix: unknowns held at values, by letter ('β' or 'beta', 'K₁' or 'K1'); free: unknowns the method would hold fixed.
    """
    scaling = scale(plant)
    theorem = method.theorem(plant, scaling)
    released, held = {letter(f) for f in free}, {letter(k): v for k, v in (fix or {}).items()}
    for name in sorted(released - set(theorem.fixed)):
        raise InputError(f"{name} cannot be set free", why=f"held fixed are: {', '.join(theorem.fixed) or 'none'}")
    if theorem.minimise.name in held:
        raise InputError(
            f"{theorem.minimise.name} cannot be held", why="it is what is minimised", remedies=("ask for a level",)
        )
    fixed = {k: v for k, v in theorem.fixed.items() if k not in released} | held
    posed = Posed(method, plant, scaling, theorem, fixed, pole_bound)
    _ = posed.problem().held  # a wrong name, shape or value is refused here, whichever route is taken later
    for name in theorem.bounds:
        _demand_bound(name, fixed.get(name), theorem)
    return posed


def _demand_bound(name: str, value: Any, theorem: Theorem) -> None:
    if value is None or not np.all(np.asarray(value, float) >= 0):
        raise InputError(
            f"{name} is set free" if value is None else f"{name} is {value}",
            why="below zero the inequalities do not give the claim",
            evidence={name: value},
            remedies=(f"leave {name} out: it is then {theorem.fixed[name]:g}", "hold it at a small positive number"),
        )


def at_zero(posed: Posed) -> tuple[str, ...]:
    """What is lost by bounds that somebody holds at zero."""
    lost = posed.theorem.bounds.items()
    return tuple(f"{name} is held at 0: {what}" for name, what in lost if not np.any(posed.fixed[name]))


ASCII = {
    "beta": "β",
    "gamma2": "γ²",
    "K1": "K₁",
    "epsilon": "ε",
    "rho": "ρ",
    "alpha": "α",
    "c1": "c₁",
    "c2": "c₂",
    "c3": "c₃",
}


def letter(name: str) -> str:
    """The paper's letter for an ASCII name."""
    return ASCII.get(name, name)


def scale(plant: Plant) -> Scaling:
    """Exponents of two for the states (from declared ranges where given), the healthy outputs, and the error.

    The error's unit brings the floor of the level near one: a program whose optimum is 1e-10 is solved by nobody.
    """
    weights = plant.letters()
    inputs = np.hstack([plant.E_w @ weights["W"], plant.G])
    C = plant.C / _sensor_units(plant)[:, None]
    state = state_scaling(plant.A, inputs, C, np.array(plant.signals.x.ranges))
    if plant.G.size == 0 and inputs.size == 0:
        state = state_scaling(plant.A, plant.B, C, np.array(plant.signals.x.ranges))
    N = annihilator(plant.F_f)
    rows = np.hstack([N @ plant.C * np.exp2(state.astype(float)), N @ plant.F_w @ weights["W"]])
    size = np.abs(rows).max(axis=1, initial=0.0)
    output = np.rint(np.log2(np.where(size > 0, size, 1.0))).astype(np.int64)
    peak = reconstruction_floor(plant)
    known = peak is not None and 0 < peak.value < np.inf
    error = -round(np.log2(peak.value)) if known and peak is not None else 0
    return Scaling(state, np.clip(output, -60, 60), int(np.clip(error, -200, 200)))


def _sensor_units(plant: Plant) -> Array:
    """What each sensor is uncertain by: counted disturbances on it, else its noise; 1 where nothing is declared."""
    counted = np.abs(plant.F_w @ plant.letters()["W"]).max(axis=1, initial=0.0)
    noise = np.zeros(plant.p) if plant.noise is None else np.array(plant.noise.sd)
    size = np.where(counted > 0, counted, noise)
    return np.exp2(np.rint(np.log2(np.where(size > 0, size, 1.0))))


def trace(expr: Expr) -> Expr:
    """The trace of a square expression as a (1, 1) expression."""
    n = expr.shape[0]
    total = as_expr(0.0)
    for k in range(n):
        e = given(f"e{k + 1}", np.eye(n)[:, [k]])
        total = total + e.T @ expr @ e
    return total


def quietest(posed: Posed, level: float) -> Outcome:
    """Gains at this level with the least variance of the reconstructed fault under sensor noise.

    With P L W Lᵀ P / κ in the Lyapunov inequality, cov(e) <= κ P⁻¹, so the variance is bounded by κ tr(H1 P⁻¹ H1ᵀ):
    a product of two convex terms, lowered by majorisation (each step a semidefinite program with κ an unknown).
    The theorem's P serves both claims, so this is an upper bound of the variance, not the variance.
    """
    th = posed.theorem
    q, k = th.readout.shape[0], th.noise.shape[1]
    S, κ = unknown("S", q, q, symmetric=True), unknown("κ")
    problem = posed.at_level(level)
    if k == 0:  # no gain passes noise to the state: there is nothing to choose
        return solve(problem, margin=INSIDE)
    noisy = sym([[th.drift + th.drift.T, th.noise], [__, -κ * I(k)]]) < 0
    bound = sym([[S, th.readout], [__, th.lyapunov]]) > 0
    weights = (1.0, 1.0)
    best, best_value = Outcome("unknown"), np.inf
    near = solve(problem, margin=INSIDE).values or None  # any point of this level knows the size of its multipliers
    for _ in range(ROUNDS):
        objective = κ * (1.0 / weights[0]) + trace(S) * (1.0 / weights[1])
        wanted = Problem([*problem.inequalities, noisy, bound], objective, problem.fixed)
        outcome = solve(wanted, margin=INSIDE, near=near)
        if not outcome.solved:
            return best if best.solved else outcome
        pair = float(outcome.values["κ"][0, 0]), float(np.trace(outcome.values["S"]))
        value = pair[0] * pair[1]
        if value < best_value:
            improved = best_value / value if np.isfinite(best_value) else np.inf
            best, best_value, near = outcome, value, outcome.values
        else:
            improved = 1.0
        if improved < 1.001 or min(pair) <= 0:
            return best
        weights = pair
    return best


def mildest(posed: Posed, level: float) -> Outcome:
    """Gains at this level by the theorem's own second criterion: the least largest eigenvalue of `mildest`."""
    expr = posed.theorem.mildest
    assert expr is not None, "asked of a theorem that has no second criterion of its own"
    t, problem = unknown("t"), posed.at_level(level)
    near = solve(problem, margin=INSIDE).values or None
    below = Inequality(t * I(expr.shape[0]) - expr, ">", 0, "second criterion")
    return solve(Problem([*problem.inequalities, below], t, problem.fixed), margin=INSIDE, near=near)


def smallest_gain(posed: Posed, level: float) -> Outcome:
    """Gains at this level that pass the least of unit noise on the healthy outputs (scaled units) to the state."""
    th = posed.theorem
    everything = replace(th, readout=I(th.lyapunov.shape[0]))
    return quietest(replace(posed, theorem=everything), level)


def multipliers(posed: Posed, gains: Mapping[str, Array], level: float) -> Outcome:
    """For gains that are rounded already: the multipliers that satisfy the theorem with the largest margin."""
    t = unknown("t")
    fixed = {**posed.fixed, **gains, "γ": level}
    inequalities = proof_inequalities(posed.theorem)
    known = {leaf for i in inequalities for leaf in _unknowns(i)}
    fixed = {k: v for k, v in fixed.items() if k in known}
    inside = [
        Inequality(i.positive - t * I(i.expr.shape[0]), ">", 0, i.label) for i in inequalities if i.expr.shape[0] > 0
    ]
    return solve(Problem([*inside, (1 - t) > 0], -t, fixed))


def _unknowns(inequality: Inequality) -> list[str]:
    return list(leaves([inequality.expr], "unknown"))
