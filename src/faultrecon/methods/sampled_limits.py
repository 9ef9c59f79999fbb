# SPDX-License-Identifier: BSD-3-Clause
"""How far the reduced inequality reaches: the largest Lipschitz constant, the longest sample time.

Both are limits of feasibility with gains and levels that grow without bound; they say where not to go.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from faultrecon.lmi.expr import I, __, sym, unknown
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.solve import solve
from faultrecon.methods.base import Scaling
from faultrecon.methods.sampled_letters import sampled_letters
from faultrecon.plant.plant import Plant

if TYPE_CHECKING:
    from faultrecon.methods.euler_pi import EulerPi


def largest_lipschitz(method: EulerPi, plant: Plant, alpha: float = 0.0) -> float | None:
    """The supremum of ℓ for which errors decay at `alpha` (1/s) with every φ that |φ(a) - φ(b)| ≤ ℓ |a - b| allows.

    λ is one without loss, so that ℓ² is an unknown of a linear inequality.  None where the solver cannot tell.
    """
    T0 = method.time(plant)
    Φ0 = method.model(plant, T0)
    H0 = method.decoupling(plant, Φ0)
    unscaled = Scaling(np.zeros(plant.n, np.int64), np.zeros(plant.p, np.int64))
    m = sampled_letters(plant, unscaled, H0, np.ones(len(plant.faults)))
    T = m.gains["T"]
    P, Y, ℓ2 = unknown("P", m.nz, m.nz, symmetric=True), unknown("Y", m.nz, plant.p), unknown("ℓ²")
    X, PB = P @ m.A - Y @ m.C, P @ m.Bφ
    lmi = sym([
        [X + X.T + 2 * alpha * P + ℓ2 * (m.R.T @ m.R), PB, T * X.T],
        [__, -I(PB.shape[1]), T * PB.T],
        [__, __, -T * P],
    ])  # fmt: skip
    found = solve(Problem([lmi < 0, P > 0], -ℓ2, {"T": T0, "H": H0, "Φ₁": Φ0}))
    return float(np.sqrt(max(-found.objective, 0.0))) if found.solved else None
