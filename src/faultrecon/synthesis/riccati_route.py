# SPDX-License-Identifier: BSD-3-Clause
"""The route without a semidefinite program, for theorems that are one filter inequality.

The optimum of such a theorem is found by Riccati equations to eight digits, at any size, where an interior-point solver
gives five and stops at about forty states.  So it is the optimum that is quoted wherever it applies, with the solver as
its check on small plants, and it is the only route on large ones, whose gains are then the central ones.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from faultrecon.finding import Impossible, Inconclusive
from faultrecon.lmi.solve import Outcome
from faultrecon.lmi.walk import value_of
from faultrecon.numerics.level import LevelSolution, optimal_level
from faultrecon.numerics.riccati import central_gain, strict_multiplier
from faultrecon.synthesis.levels import Posed

LARGE = 16
"""States from which the Riccati route takes over: the cost of the program grows with the fourth power of the size, and
the second criterion solves it many times (17 s in all at 20 states; this route takes 0.4 s at 30 and 4 s at 80)."""


def applies(posed: Posed) -> bool:
    """Whether the theorem is one filter inequality in P, L and β alone, as far as its form tells."""
    th = posed.theorem
    return th.filter is not None and th.minimise.name not in posed.fixed and "K₁" in posed.fixed


def optimum(posed: Posed) -> LevelSolution | None:
    """The optimum without a pole bound; None where the route does not apply.  Impossible when a large plant has none."""
    form = posed.theorem.filter
    if form is None or not applies(posed):
        return None
    beta, unit = posed.fixed.get("β"), posed.theorem.unit
    try:
        held = None if beta is None else unit**2 * float(np.asarray(beta).item())
        found = optimal_level(**_arrays(posed), beta=held)
    except Inconclusive:
        return None
    except Impossible:
        if posed.plant.n >= LARGE:
            raise
        return None  # the program will say so too, and which block is to blame
    beta = None if found.beta is None else found.beta / unit**2
    return replace(found, gamma=found.gamma / unit, lower=found.lower / unit, beta=beta)


def gains(posed: Posed, level: float, beta: float | None, best: float) -> Outcome:
    """The central gain between the optimum `best` and a level, with multipliers that prove the level strictly."""
    inside = math.sqrt(best * level)
    arrays, unit = _arrays(posed), posed.theorem.unit
    # A gain for a little less than the level leaves the multiplier room: its own P is the boundary of the inequality.
    scaled = None if beta is None else unit**2 * beta
    found = central_gain(**arrays, beta=scaled, gamma=unit * inside)
    P = None if found is None else strict_multiplier(**arrays, beta=scaled, gamma=unit * level, L=found.L)
    if found is None or P is None:
        return Outcome("unknown", solver="Riccati equation: no stabilising solution")
    # Without a nonlinearity β stands in an empty block and in β > 0 alone.
    values = {"P": P, "Z": P @ found.L, "β": np.array([[1.0 if beta is None else beta]])}
    fixed = {k: np.broadcast_to(v, shape) for k, v, shape in _fixed(posed)}
    return Outcome("solved", {**fixed, **values}, level**2, "Riccati equation: stabilising solution")


def _arrays(posed: Posed) -> dict:
    form = posed.theorem.filter
    assert form is not None, "asked for only where the route applies"
    fixed = {k: np.broadcast_to(v, shape) for k, v, shape in _fixed(posed)}
    arrays = {name: value_of(expr, fixed) for name, expr in form.items()}
    return {**arrays, "alpha": float(arrays["alpha"].item())}


def _fixed(posed: Posed) -> list[tuple[str, np.ndarray, tuple[int, int]]]:
    from faultrecon.lmi.walk import leaves

    form = posed.theorem.filter
    unknowns = leaves(list(form.values()), "unknown") if form else {}
    return [(k, np.asarray(v, float), unknowns[k].shape) for k, v in posed.fixed.items() if k in unknowns]
