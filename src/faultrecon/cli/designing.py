# SPDX-License-Identifier: BSD-3-Clause
"""The verb `design`: with one method or the best of all, what would help where there is no design, and for banks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

from faultrecon.cli.shell import leave, stages
from faultrecon.finding import FaultreconError, Impossible, Inconclusive, InputError
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.pipeline import design
from faultrecon.synthesis.result import Design

BEST = "best"
"""The name under which the command line compares all methods that apply."""


def make_design(plant: Plant, method: str, as_json: bool, **options: Any) -> tuple[Design, dict[str, Any], str]:
    """The design, with what is to be said of the choice of its method; ends with an explanation where there is none."""
    data, text = {}, ""
    if method == BEST:
        from faultrecon.advise.recommendation import best

        with stages("comparing methods"):
            picked = best(plant)
        method, data, text = picked.method, {"picked": picked.as_dict()}, f"{picked}\n\n"
    try:
        with stages("designing") as tell:
            return design(plant, method, progress=tell, **options), data, text
    except (Impossible, Inconclusive) as error:
        _explain(error, plant, method, as_json, options)


def for_all(
    method: str,
    backoff: float | None,
    pole_bound: float | str | None,
    *,
    level: float | None = None,
    fix: Sequence[str] | None = None,
    free: Sequence[str] | None = None,
) -> dict[str, Any]:
    """What holds for every design of a bank.  Raises InputError on options that only one design can have."""
    if method == BEST:
        why = "a comparison is made for one set of faults; each hypothesis has its own"
        raise InputError("--method best with a bank", why=why, remedies=("name a method, or leave it to --bank",))
    if level is not None:
        why = "each hypothesis has an optimum of its own, and one level would be too low for some of them"
        raise InputError(
            f"--level {level:g} with a bank", why=why, remedies=("say how far to stay off with --backoff",)
        )
    for name, given in (("--fix", fix), ("--free", free)):
        if given:
            why = "it is about a letter of one theorem, and a bank may take several methods"
            raise InputError(f"{name} {given[0]} with a bank", why=why, remedies=("make that design alone",))
    return {"method": method, "backoff": backoff, "pole_bound": pole_bound}


def _explain(error: FaultreconError, plant: Plant, method: str, as_json: bool, options: dict[str, Any]) -> NoReturn:
    """Say why there is no design and what would help, each number tried; end with the exit code of the error."""
    from faultrecon.advise.why_not import why_failed

    asked = {key: options[key] for key in ("level", "fix", "free")}
    bound = options["pole_bound"]
    with stages("looking for what would help"):
        try:
            # An automatic bound gives way when it forbids a solution, so it is never the reason.
            found = why_failed(plant, method, error, pole_bound=bound if isinstance(bound, float) else None, **asked)
        except FaultreconError:  # the refusal stands, whatever became of the advice
            leave(error, as_json)
    leave(error, as_json, also={"explanation": found.as_dict()}, text=str(found))
