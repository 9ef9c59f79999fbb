# SPDX-License-Identifier: BSD-3-Clause
"""Why there is no design: fact, cause, numbers, remedies."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from faultrecon.diagnosis.plausibility import oddities
from faultrecon.finding import Finding
from faultrecon.lmi.explain import explain
from faultrecon.lmi.solve import Outcome
from faultrecon.synthesis.ladder import Rung
from faultrecon.synthesis.levels import Posed


def below_floor(level: float, floor: float) -> Finding:
    """Nobody can do it."""
    return Finding(
        f"γ = {level:.6g} is below {floor:.6g}, the best any estimator can guarantee with these sensors",
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


def no_solution(posed: Posed, outcome: Outcome) -> Finding:
    """The inequalities contradict each other at every level; the solver's dual certificate was checked."""
    term = posed.plant.nonlinearity
    obstruction = explain(posed.problem(), outcome)
    why, remedies = "no γ whatever satisfies its inequalities", ["use another method that applies"]
    if posed.pole_bound is not None:
        why += f" with poles to the right of -{posed.pole_bound:.4g} rad/s"
        remedies.insert(0, "raise pole_bound")
    if term is not None:
        why += f" for a Lipschitz constant of {term.constant:.6g}"
        remedies[:0] = ["shrink the domain, and with it the Lipschitz constant", "declare which states phi reads"]
    why += f" ({obstruction})"
    evidence = {"alone": list(obstruction.alone), "shares": dict(obstruction.shares), "solver": outcome.solver}
    what = f"{posed.method.name} has no solution for {posed.plant.name}"
    return Finding(what, why, evidence, tuple(remedies), f"Theorem {posed.theorem.number}")


def no_answer(posed: Posed, outcome: Outcome) -> Finding:
    """The solver stopped without a point and without a dual certificate."""
    return Finding(
        f"the solver gave up on {posed.method.name} for {posed.plant.name}",
        why=f"its last word was '{outcome.solver}'; that is neither a solution nor a proof that there is none",
        remedies=("declare signal ranges so that the problem is scaled", "check the model's units"),
        evidence={"solver": outcome.solver},
        see=f"Theorem {posed.theorem.number}",
    )


def no_proof(posed: Posed, rungs: Sequence[Rung]) -> Finding:
    """Points were found and none of them could be proved, or none was found: not certified, with what refutes it.

    Where every level that was tried is zero, sensors that count as exact are why, and nothing a solver says adds to it.
    """
    tried = Counter(map(str, rungs))
    exact = next((f for f in oddities(posed.plant) if "sensors without a disturbance" in f.evidence), None)
    what = f"{posed.method.name} found no gains for {posed.plant.name} that could be proved; nothing is certified"
    see = f"Theorem {posed.theorem.number}"
    if exact is not None and all(rung.level == 0.0 for rung in rungs):
        why = f"{exact.what}; nothing that counts then limits the level, its optimum is 0, and no finite gains reach it"
        return Finding(what, why, {"tried": list(tried), **exact.evidence}, exact.remedies, see)
    return Finding(
        what,
        why="; ".join(rung + (f" ({times} times)" if times > 1 else "") for rung, times in tried.items()),
        evidence={"tried": [str(rung) for rung in rungs]},
        remedies=(
            *(() if exact is None else exact.remedies),
            "ask for a larger level",
            "declare signal ranges so that the problem is scaled",
            "relax pole_bound",
        ),
        see=see,
    )
