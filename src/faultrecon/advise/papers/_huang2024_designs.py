# SPDX-License-Identifier: BSD-3-Clause
"""The two plants of Huang, Gao, Liu 2024, the gains they print, and gains of ours under a bound on the poles.

The printed text has lost its minus signs.  Those of Bd1, L1 and N are recovered for both plants, that of Bd2 for the
aircraft; Bd2 of the robot and F of both are not.  The library's plant files say the same entry by entry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Inconclusive
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import Observer
from faultrecon.io.library import read_library
from faultrecon.lmi.expr import Inequality, let
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.solve import solve
from faultrecon.lmi.walk import substitute
from faultrecon.methods.registry import method
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.certify import certificate, prove, shipped
from faultrecon.synthesis.levels import INSIDE, multipliers, pose
from faultrecon.synthesis.pipeline import design, optimum

Array = NDArray[Any]
Which = Literal["aircraft", "robot"]
Scheme = Literal["adaptive", "augmented", "augmented, printed model"]

NAMES = {"aircraft": "civil_aircraft", "robot": "flexible_joint"}
EPSILON = 40.0
"""The paper's ε for the robot."""

GAMMA = np.array([[10.0]])
L1_AIRCRAFT = 1e3 * np.array(
    [[3.6706, -0.1416, -0.7720], [-0.1834, 2.9668, 0.0010], [2.2772, -1.2722, -0.4654], [0.8820, -2.4025, -0.1584]]
)
F_AIRCRAFT = 1e5 * np.array([[-0.6781, 2.5525, 2.5825]])
L1_ROBOT = np.array(
    [
        [136.1849, -122.3783, 184.5829],
        [-18.7326, 82.5755, 24.8910],
        [22.2723, -8.1410, 97.7857],
        [9.2067, -8.4649, 214.8044],
    ]
)
F_ROBOT = 1e3 * np.array([[2.6384, 0.5372, 1.0113]])
K_ROBOT = np.array(
    [
        [22.1437, -26.1687, 16.471],
        [-8.8992, 8.4933, -1.8299],
        [-0.6727, -3.2402, 5.8621],
        [6.8826, -21.2249, 25.8055],
        [-4.7632, 16.9837, -22.5377],
        [-3.6654, 13.755, -17.8217],
    ]
)
F_SIGNS = tuple((1, a, b) for a, b in product((1, -1), repeat=2))
"""Signs of the robot's F that could be meant: the first one is that of the fault's own sensor."""


# ---------------------------------------------------------------- plants


@lru_cache(maxsize=4)
def plant_of(which: Which) -> Plant:
    """The library's plant."""
    return read_library(NAMES[which])


@lru_cache(maxsize=1)
def robot_as_printed() -> Plant:
    """The robot with |ψ(a) - ψ(b)| <= θ |a - b| in R⁴: that ψ reads x3 alone and enters x4 alone is not used."""
    robot = plant_of("robot")
    names, term = robot.signals.x.names, robot.nonlinearity
    assert term is not None
    spaces = {"x": list(names), "u": list(robot.signals.u.names), "t": ["t"]}
    phi = Graph.from_texts(["0*x1", "0*x2", "0*x3", "-0.333*sin(x3)"], spaces)
    return replace(robot, nonlinearity=replace(term, into=np.eye(4), reads=names, phi=phi))


def posed_plant(which: Which) -> Plant:
    """The plant as the paper's inequalities see it."""
    return robot_as_printed() if which == "robot" else plant_of(which)


def with_d2(plant: Plant, *signs: int) -> Plant:
    """The plant with other signs of Bd2, in the order of its states."""
    d1, d2 = plant.disturbances
    sizes = [(name, abs(v)) for name, v in d2.into.items()]
    into = {name: s * v for (name, v), s in zip(sizes, signs, strict=True)}
    return replace(plant, disturbances=(d1, replace(d2, into=into)))


# ---------------------------------------------------------------- printed gains


def printed_gains(which: Which, signs: tuple[int, ...] | None = None) -> dict[str, Array]:
    """L1, F and Γ as printed; signs: of the entries of F, in place of those taken here."""
    L1, F = (L1_AIRCRAFT, F_AIRCRAFT) if which == "aircraft" else (L1_ROBOT, F_ROBOT)
    return {"L1": L1, "F_a": F if signs is None else np.abs(F) * np.array([signs]), "Γ": GAMMA}


def printed_observer(which: Which, signs: tuple[int, ...] | None = None) -> Observer:
    """The adaptive observer with the printed gains."""
    return method("adaptive-uio").observer(plant_of(which), printed_gains(which, signs))


def printed_augmented() -> Observer:
    """The augmented observer with the gains printed for the robot."""
    gains = {"K_x": K_ROBOT[:4], "K_g": K_ROBOT[4:5], "K_f": K_ROBOT[5:]}
    return method("augmented-uio").observer(plant_of("robot"), gains)


def least_level(plant: Plant, gains: Mapping[str, Array], fix: Mapping[str, Any] | None = None) -> float | None:
    """The least r that any P proves for given gains in the printed inequality; None when there is none."""
    posed = pose(method("adaptive-uio-printed"), plant, fix=fix)
    by = {u.name: let(u.name, e) for u, e in posed.theorem.prove_with.items() if u.name != "r²"}
    exprs = substitute([i.expr for i in posed.theorem.inequalities], by)
    inequalities = [Inequality(e, i.sense, 0, i.label) for e, i in zip(exprs, posed.theorem.inequalities, strict=True)]
    found = solve(Problem(inequalities, posed.theorem.minimise, {**posed.fixed, **gains}))
    return found.objective**0.5 if found.solved else None


def holds_at(plant: Plant, gains: dict[str, Array], level: float) -> bool:
    """Whether the printed inequality is proved exactly for these gains at this level."""
    posed = pose(method("adaptive-uio-printed"), plant)
    values = multipliers(posed, gains, level).values
    made = certificate("adaptive-uio-printed", posed.theorem, plant, gains, {**posed.fixed, **values}, level)
    return bool(values) and prove(made).sound


# ---------------------------------------------------------------- gains of ours

EVERY_ERROR: dict[str, Any] = {"W_x": np.eye(4), "ρ": 1e6}
"""As in the paper the whole state error counts; the default limit on |λ| is out of the way."""
COLUMNS: dict[str, tuple[Which, str, dict[str, Any]]] = {
    "aircraft": ("aircraft", "adaptive-uio-printed", {}),
    "aircraft, full P": ("aircraft", "adaptive-uio-full", EVERY_ERROR),
    "aircraft, augmented": ("aircraft", "augmented-uio", EVERY_ERROR | {"W_g": np.eye(1)}),
    "robot, ε = 40": ("robot", "adaptive-uio-printed", {"ε": EPSILON}),
    "robot, full P": ("robot", "adaptive-uio-full", EVERY_ERROR),
    "robot, augmented": ("robot", "augmented-uio", EVERY_ERROR | {"W_g": np.eye(1)}),
}
SCHEMES: dict[Scheme, tuple[str, dict[str, Any]]] = {
    "adaptive": ("adaptive-uio-printed", {}),
    "augmented": ("augmented-uio", EVERY_ERROR | {"W_g": np.eye(1)}),
    "augmented, printed model": ("augmented-uio-printed", {"ρ": 1e6}),
}


@lru_cache(maxsize=64)
def bounded(column: str, rho: float) -> float:
    """The least level found with every pole to the right of -rho."""
    which, name, fix = COLUMNS[column]
    return optimum(posed_plant(which), name, pole_bound=rho, fix=fix)


def proved_level(plant: Plant, name: str, fix: Mapping[str, Any], rho: float, level: float) -> float | None:
    """The level, when gains that keep it and the pole bound are found and proved exactly; None otherwise."""
    posed = pose(method(name), plant, fix=fix, pole_bound=rho)
    found = solve(posed.at_level(level), margin=INSIDE, near=posed.optimum().values)
    if not found.solved:
        return None
    gains = shipped(posed.theorem, found.values)
    poles = np.real(method(name).observer(plant, gains).poles)
    if not -rho * (1 + 1e-6) < poles.min() <= poles.max() < 0:
        return None
    for values in (found.values, multipliers(posed, gains, level).values):
        if prove(certificate(name, posed.theorem, plant, gains, {**posed.fixed, **values}, level)).sound:
            return level
    return None


@dataclass(frozen=True, eq=False)
class Retuned:
    """An observer and the level of its inequality."""

    observer: Observer
    level: float


@lru_cache(maxsize=16)
def certified(which: Which, scheme: Scheme, rho: float) -> Retuned:
    """What `design` makes: 1.05 times the least level, or the next at which a proof is found, and of all gains there
    those that pass the least sensor noise."""
    name, fix = SCHEMES[scheme]
    made = design(posed_plant(which), name, pole_bound=rho, fix=fix)
    assert made.level is not None
    return Retuned(made.observer, made.level)


@lru_cache(maxsize=16)
def unrefined(which: Which, scheme: Scheme, rho: float, level: float | None = None) -> Retuned:
    """Gains where the solver happens to stop at that level (1.05 times the least one by default): no second criterion.

    Raises Inconclusive when the solver finds none.
    """
    name, fix = SCHEMES[scheme]
    plant = posed_plant(which)
    posed = pose(method(name), plant, fix=fix, pole_bound=rho)
    at = 1.05 * posed.theorem.level(posed.optimum().objective) if level is None else level
    found = solve(posed.at_level(at), margin=INSIDE)
    if not found.solved:
        raise Inconclusive(f"no gains of the {scheme} observer at level {at:.4g}", why=found.solver)
    return Retuned(method(name).observer(plant, shipped(posed.theorem, found.values)), at)
