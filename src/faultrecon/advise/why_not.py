# SPDX-License-Identifier: BSD-3-Clause
"""Why there is no design, and what would change that: each remedy with its number, and each number tried.

In this order: an assumption of the method fails; a block of its inequality fails alone; only the whole fails; the level
asked for is below what can be had; the solver gave up.  The first that holds is the reason.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from faultrecon.advise.remedies import for_assumption, for_level, for_solver, quieter
from faultrecon.advise.tradeoff import (
    BACKOFF,
    Question,
    TradeOff,
    strongest_component,
    sufficient_pole_bound,
    trade_off,
)
from faultrecon.finding import FaultreconError, Finding, Impossible, Inconclusive
from faultrecon.lmi.explain import explain
from faultrecon.methods.base import Unproved
from faultrecon.methods.registry import method as method_named
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.refusals import below_floor, below_method, no_answer, no_solution

PAGE = "docs: know why there is no design"
"""Where to read on, for findings that no paper speaks of."""

Stage = Literal["assumption", "block", "whole", "level", "solver", "proof", "none"]


@dataclass(frozen=True)
class Explanation:
    """What stands against a design, the reason first.

    stage: where it fails: an "assumption", a "block" alone, the "whole" inequality, the "level", the "solver", the
    "proof", or "none" when nothing was found against it.  findings: the reason with its remedies, then notes.
    tradeoff: the level against the Lipschitz constant, where the nonlinearity is what stands in the way.
    """

    plant: str
    method: str
    stage: Stage
    findings: tuple[Finding, ...]
    tradeoff: TradeOff | None = None

    @property
    def exit_code(self) -> int:
        """As of the command line: 0 nothing stands against it, 1 a negative answer, 3 no answer."""
        return {"none": 0, "solver": Inconclusive.exit_code, "proof": Inconclusive.exit_code}.get(
            self.stage, Impossible.exit_code
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {
            "plant": self.plant,
            "method": self.method,
            "stage": self.stage,
            "findings": [f.as_dict() for f in self.findings],
            "tradeoff": None if self.tradeoff is None else self.tradeoff.as_dict(),
        }

    def __str__(self) -> str:
        return "\n".join(line for finding in self.findings for line in _paragraph(finding))


def _paragraph(finding: Finding) -> list[str]:
    """A finding for people: the fact, then cause, remedies and source, each on a line."""
    lines = [finding.what]
    if finding.why:
        lines.append(f"  why: {finding.why}")
    lines += [f"  {'do' if k == 0 else 'or'}:  {remedy}" for k, remedy in enumerate(finding.remedies)]
    return [*lines, f"  see: {finding.see}"] if finding.see else lines


def why_not(
    plant: Plant,
    method: str = "lipschitz-hinf",
    *,
    level: float | None = None,
    pole_bound: float | None = None,
    fix: Mapping[str, Any] | None = None,
    free: Sequence[str] = (),
) -> Explanation:
    """Why a method gives no design for this plant (at a level γ), and what would: remedies whose numbers were tried.

    pole_bound in rad/s, fix and free as for `design`.  Raises InputError on unknown names.
    """
    question = Question(method_named(method), plant, dict(fix or {}), tuple(free), pole_bound)
    fatal = [f for f in question.method.assumptions(plant) if f.severity == "fatal"]
    if fatal:
        return _assumption(question, fatal)
    if isinstance(question.method, Unproved):
        return Explanation(plant.name, method, "none", (_claims_nothing(question),))
    peak = question.method.floor(plant)
    floor = None if peak is None else peak.value
    if level is not None and floor is not None and level < floor:
        return _below_floor(question, level, floor)
    optimum = question.optimum
    if math.isnan(optimum):
        return _gave_up(question)
    if math.isinf(optimum):
        return _no_solution(question)
    if level is not None and level <= optimum:
        return _below_method(question, level, optimum, floor)
    return Explanation(plant.name, method, "none", (_nothing_against(question, optimum),))


def why_failed(plant: Plant, method: str, error: FaultreconError, **asked: Any) -> Explanation:
    """The explanation of an error that `design` raised; the error's own finding leads where nothing more is found."""
    found = why_not(plant, method, **asked)
    if found.stage != "none":
        return found
    stage = "solver" if isinstance(error, Inconclusive) else "level"
    notes = (for_solver(plant), *found.findings) if stage == "solver" else found.findings
    return Explanation(plant.name, method, "proof" if stage == "solver" else stage, (error.finding, *notes))


# ---------------------------------------------------------------- one function per stage


def _assumption(question: Question, fatal: list[Finding]) -> Explanation:
    exchange = trade_off(question)  # an assumption on the strength of the nonlinearity holds for a weaker one
    first = replace(fatal[0], remedies=for_assumption(question, fatal[0], exchange), see=fatal[0].see or PAGE)
    findings = (first, *fatal[1:], *_exchange(question, exchange))
    return Explanation(question.plant.name, question.method.name, "assumption", findings, exchange)


def _no_solution(question: Question) -> Explanation:
    posed, outcome = question.posed, question.outcome
    exchange = trade_off(question)
    remedies = _wider(question) + for_level(question, exchange)
    first = no_solution(posed, outcome)
    alone = bool(explain(posed.problem(), outcome).alone) if outcome.status == "infeasible" else False
    first = replace(first, remedies=remedies or first.remedies)
    stage: Stage = "block" if alone else "whole"
    return Explanation(
        question.plant.name, question.method.name, stage, (first, *_exchange(question, exchange)), exchange
    )


def _below_floor(question: Question, level: float, floor: float) -> Explanation:
    optimum = question.optimum
    first = below_floor(level, floor)
    best = () if not math.isfinite(optimum) else (f"ask γ ≥ {BACKOFF * optimum:.4g} of {question.method.name}",)
    first = replace(first, remedies=(*best, quieter(question, level)), evidence={**first.evidence, "optimum": optimum})
    return Explanation(question.plant.name, question.method.name, "level", (first,))


def _below_method(question: Question, level: float, optimum: float, floor: float | None) -> Explanation:
    exchange = trade_off(question, level)
    first = below_method(level, optimum, floor, question.posed)
    larger = f"ask γ ≥ {BACKOFF * optimum:.4g}"
    first = replace(first, remedies=(larger, *_wider(question, level), *for_level(question, exchange, level)))
    return Explanation(
        question.plant.name, question.method.name, "level", (first, *_exchange(question, exchange, level)), exchange
    )


def _gave_up(question: Question) -> Explanation:
    exchange, first = trade_off(question), no_answer(question.posed, question.outcome)
    first = replace(first, remedies=(*_wider(question), *for_level(question, exchange), *first.remedies))
    findings = (first, for_solver(question.plant), *_exchange(question, exchange))
    return Explanation(question.plant.name, question.method.name, "solver", findings, exchange)


def _wider(question: Question, level: float | None = None) -> tuple[str, ...]:
    wider = sufficient_pole_bound(question, level)
    if wider is None:
        return ()
    return (f"raise pole_bound to {wider.pole_bound:.4g} rad/s, where γ ≥ {BACKOFF * wider.optimum:.4g} can be had",)


def _nothing_against(question: Question, optimum: float) -> Finding:
    name = question.method.name
    return Finding(
        f"{name} has a solution for {question.plant.name}",
        why=f"its optimum is {optimum:.6g}",
        evidence={"optimum": optimum},
        remedies=(f"ask γ ≥ {BACKOFF * optimum:.4g}, or no level, which is the same",),
        severity="note",
    )


def _claims_nothing(question: Question) -> Finding:
    return Finding(
        f"nothing stands against {question.method.name} for {question.plant.name}",
        why="it is a baseline without a theorem: its assumptions hold, and it claims no level that could be missed",
        remedies=("judge it by simulation: faultrecon compare",),
        severity="note",
    )


def _exchange(question: Question, exchange: TradeOff | None, level: float | None = None) -> tuple[Finding, ...]:
    """The trade-off between the constant and the level in a row of numbers, and where the nonlinearity is strongest."""
    if exchange is None:
        return ()
    asked = "a solution exists" if level is None else f"γ = {level:.4g} can be had"
    row = ", ".join(f"γ = {best:.4g} at α = {constant:.4g}" for constant, best in exchange.levels)
    notes = [
        Finding(
            f"the nonlinearity decides: {asked} up to a Lipschitz constant of α = {exchange.solvable:.4g}",
            why="found by bisection on the optimum" + (f", which is {row}" if row else ""),
            evidence=exchange.as_dict(),
            remedies=("bring the constant below that: on a smaller domain, or with what is linear in phi put into A",),
            severity="note",
        )
    ]
    part = strongest_component(question.plant)
    if part is not None:
        notes.append(
            Finding(
                f"the steepest component of phi is the one that enters the equation of {part[0]}",
                why=f"its constant on the declared domain is {part[1]:.4g}, that of the next is {part[2]:.4g}",
                evidence={"equation": part[0], "constant": part[1], "next": part[2]},
                remedies=("model that component better first: what is linear in it belongs into A",),
                severity="note",
            )
        )
    return tuple(notes)
