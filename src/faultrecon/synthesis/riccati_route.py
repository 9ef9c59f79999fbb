# SPDX-License-Identifier: BSD-3-Clause
"""The route without a semidefinite program, for theorems that are one filter inequality.

The optimum of such a theorem is found by Riccati equations to eight digits, at any size, where an interior-point solver
gives five and stops at about forty states.  So it is the optimum that is quoted wherever it applies, with the solver as
its check on small plants, and it is the only route on large ones, whose gains are then the central ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from faultrecon.finding import Impossible, Inconclusive
from faultrecon.lmi.solve import Outcome
from faultrecon.lmi.walk import leaves, value_of
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
    """The optimum without a pole bound; None where the route does not apply.  Impossible: a large plant has none."""
    if posed.theorem.filter is None or not applies(posed):
        return None
    beta, form = posed.fixed.get("β"), filter_form(posed)
    linear = form.arrays["Bphi"].shape[1] == 0  # β then stands in an empty block, and is held at one
    try:
        held = None if beta is None or linear else form.beta_unit * float(np.asarray(beta).item())
        found = optimal_level(**form.arrays, beta=held)
    except Inconclusive:
        return None
    except Impossible:
        if posed.plant.n >= LARGE:
            raise
        return None  # the program will say so too, and which block is to blame
    beta = None if found.beta is None else found.beta / form.beta_unit
    return replace(found, gamma=found.gamma / form.unit, lower=found.lower / form.unit, beta=beta)


def gains(posed: Posed, level: float, beta: float | None, best: float) -> Outcome:
    """The central gain between the optimum `best` and a level, with multipliers that prove the level strictly."""
    form = filter_form(posed)
    scaled = None if beta is None else form.beta_unit * beta
    # A gain for a little less than the level leaves the multiplier room: its own P is the boundary of the inequality.
    found = central_gain(**form.arrays, beta=scaled, gamma=form.unit * math.sqrt(best * level))
    P = None
    if found is not None:
        P = strict_multiplier(**form.arrays, beta=scaled, gamma=form.unit * level, L=found.L)
    if found is None or P is None:
        return Outcome("unknown", solver="Riccati equation: no stabilising solution")
    # Without a nonlinearity β stands in an empty block and in β > 0 alone.
    values = {"P": P, "Z": P @ found.L, "β": np.array([[1.0 if beta is None else beta]])}
    return Outcome("solved", {**form.held, **values}, level**2, "Riccati equation: stabilising solution")


@dataclass(frozen=True)
class FilterForm:
    """The arguments of `optimal_level` in units in which γ and β are near one.

    unit: times γ; beta_unit: times β.  held: the unknowns of the theorem that are held fixed.
    """

    arrays: dict[str, Any]
    unit: float
    beta_unit: float
    held: dict[str, np.ndarray]


def filter_form(posed: Posed) -> FilterForm:
    """The theorem's filter inequality in numbers.  Raises KeyError where the theorem has no such form.

    What φ is measured in must not matter: G φ(H x) with |φ| ≤ α |H x| is the same as c G φ' with |φ'| ≤ |H x| / |H| for
    c = α |H|, and β is then c² times what it was.
    """
    letters = dict(posed.theorem.filter or {})
    shapes = {name: leaf.shape for name, leaf in leaves(list(letters.values()), "unknown").items()}
    fixed = {k: np.broadcast_to(np.asarray(v, float), shapes[k]) for k, v in posed.fixed.items() if k in shapes}
    arrays: dict[str, Any] = {name: value_of(expr, fixed) for name, expr in letters.items()}
    alpha, unit = float(arrays["alpha"].item()), posed.theorem.unit
    reach = float(np.linalg.norm(arrays["G"]))
    c = alpha * reach if alpha * reach > 0 else 1.0
    if alpha * reach > 0:
        arrays |= {"Bphi": c * arrays["Bphi"], "G": arrays["G"] / reach, "alpha": 1.0}
    else:
        arrays["alpha"] = alpha
    return FilterForm(arrays, unit, (unit * c) ** 2, fixed)
