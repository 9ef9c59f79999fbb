# SPDX-License-Identifier: BSD-3-Clause
"""Why there is no design: fact, cause, numbers, remedies."""

from __future__ import annotations

from collections.abc import Sequence

from faultrecon.finding import Finding
from faultrecon.lmi.solve import Outcome
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.levels import Posed


def below_floor(level: float, floor: float) -> Finding:
    """Nobody can do it."""
    return Finding(
        f"γ = {level:.6g} is below {floor:.6g}, the best any estimator can do with these sensors",
        evidence={"level": level, "floor": floor},
        remedies=(f"ask for more than {floor:.6g}", "add a healthy sensor or use a quieter one"),
        see="Khosrowjerdi 2011, re-derived floor",
    )


def below_method(level: float, optimum: float, floor: float | None, posed: Posed) -> Finding:
    """Somebody might, this method cannot."""
    bound = "" if posed.pole_bound is None else f" with poles to the right of -{posed.pole_bound:.4g} rad/s"
    return Finding(
        f"γ = {level:.6g} is below {optimum:.6g}, the optimum of {posed.method.name}{bound}",
        evidence={"level": level, "optimum": optimum, "floor": floor},
        remedies=(f"ask γ ≥ {1.05 * optimum:.4g}",)
        + (("raise pole_bound",) if posed.pole_bound is not None else ())
        + (("shrink the domain of the nonlinearity",) if posed.plant.nonlinearity is not None else ()),
        see=f"Theorem {posed.theorem.number}",
    )


def no_solution(posed: Posed) -> Finding:
    """The inequalities contradict each other at every level; the solver's dual certificate was checked."""
    term = posed.plant.nonlinearity
    why, remedies = "no γ whatever satisfies its inequalities", ["use another method that applies"]
    if posed.pole_bound is not None:
        why += f" with poles to the right of -{posed.pole_bound:.4g} rad/s"
        remedies.insert(0, "raise pole_bound")
    if term is not None:
        why += f" for a Lipschitz constant of {term.constant:.6g}"
        remedies[:0] = ["shrink the domain, and with it the Lipschitz constant", "declare which states phi reads"]
    what = f"{posed.method.name} has no solution for {posed.plant.name}"
    return Finding(what, why=why, remedies=tuple(remedies), see=f"Theorem {posed.theorem.number}")


def no_answer(posed: Posed, outcome: Outcome) -> Finding:
    """The solver stopped without a point and without a dual certificate."""
    return Finding(
        f"the solver gave up on {posed.method.name} for {posed.plant.name}",
        why=f"its last word was '{outcome.solver}'; that is neither a solution nor a proof that there is none",
        remedies=("declare signal ranges so that the problem is scaled", "check the model's units"),
    )


def no_proof(method: str, plant: Plant, attempts: Sequence[tuple[float, str]]) -> Finding:
    """Points were found and none of them could be proved, or none was found."""
    tried = "; ".join(f"γ = {level:.6g}: {word}" for level, word in attempts)
    return Finding(
        f"{method} found no gains for {plant.name} that could be proved",
        why=f"tried {tried}",
        remedies=("ask for a larger level", "declare signal ranges so that the problem is scaled", "relax pole_bound"),
    )
