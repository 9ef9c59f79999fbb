# SPDX-License-Identifier: BSD-3-Clause
"""The public `design`: by a method's name, or by comparing all that apply and taking the best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from faultrecon.plant.plant import Plant
from faultrecon.synthesis import pipeline
from faultrecon.synthesis.result import Design

BEST = "best"
"""The name that stands for whichever method a comparison picks."""


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
    progress: Callable[[str], None] | None = None,
) -> Design:
    """Gains with a guaranteed level, rounded to float64 and proved.

    method: a name, or "best": every method that applies is designed, let loose on each fault in turn and compared, and
    the one that `best` picks is designed with the options given here; which, and by what rule, is among its notes.
    faults: names of the faults to reconstruct, the others taken as healthy; all by default.  level: γ to aim at; by
    default (1 + backoff) times the optimum under the pole bound.  backoff: 0.05, or what the method says.
    pole_bound: ρ in rad/s for Re λ > -ρ, None for none, "auto" for 2 / (noise hold time), or ten times the plant's
    fastest mode where no noise is declared.  fix, free: unknowns of the theorem held or set free, by letter.
    certify=False gives a baseline's gains without a proof.  progress: called with a word before each stage.

    Raises Impossible (an assumption fails, the level is below what the method or anybody can reach, no method applies),
    Inconclusive (the solver gave up, or no proof was found), InputError.
    """
    given: dict[str, Any] = {"level": level, "backoff": backoff, "pole_bound": pole_bound, "fix": fix, "free": free}
    given |= {"certify": certify, "progress": progress}
    if method != BEST:
        return pipeline.design(plant, method, faults=faults, **given)
    from faultrecon.advise.recommendation import best

    if progress is not None:
        progress("comparing methods")
    picked = best(plant if faults is None else plant.with_faults(faults))
    made = picked.design(**given)
    compared = ", ".join(e.method for e in picked.table.entries)
    note = f"{made.method} was picked from {compared}: {picked.rule}"
    return replace(made, details=replace(made.details, notes=(note, *made.details.notes)))
