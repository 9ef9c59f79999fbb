# SPDX-License-Identifier: BSD-3-Clause
"""How far the reduced inequality reaches: the largest Lipschitz constant, the longest sample time, the model's error.

The first two are limits of feasibility with gains and levels that grow without bound; they say where not to go.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from faultrecon.lmi.expr import I, __, given, sym, unknown
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.prove import statement
from faultrecon.lmi.solve import solve
from faultrecon.methods.base import Scaling
from faultrecon.methods.sampled_letters import sampled_letters
from faultrecon.plant.plant import Plant

if TYPE_CHECKING:
    from faultrecon.methods.euler_pi import EulerPi

Array = NDArray[np.float64]

RATES = (0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0)
"""Decay rates α in 1/s among which the practical bound takes the best."""
AGES = 1e3
"""Seconds beyond which no sample time is looked for."""
INSIDE = 1e-7
"""How far inside each scaled inequality a point has to lie: 100 times the solver's tolerance of 1e-9."""


def largest_lipschitz(method: EulerPi, plant: Plant, alpha: float = 0.0) -> float | None:
    """The supremum of ℓ for which errors decay at `alpha` (1/s) with every φ that |φ(a) - φ(b)| ≤ ℓ |a - b| allows.

    None where the solver cannot tell.
    """
    found = solve(_decay(method, plant, alpha))
    return float(np.sqrt(max(-found.objective, 0.0))) if found.solved else None


def longest_sample_time(method: EulerPi, plant: Plant, alpha: float = 0.0, *, rtol: float = 1e-3) -> float:
    """The longest T at which errors decay at `alpha` (1/s) with the plant's Lipschitz constant; inf beyond `AGES`.

    By bisection, for models for which what holds at T holds at every shorter one; 0 where nothing holds.
    """
    squared = 0.0 if plant.nonlinearity is None else plant.nonlinearity.constant**2

    def holds(T: float) -> bool:
        problem = _decay(type(method)(T), plant, alpha)
        fixed = {**(problem.fixed or {}), "ℓ²": squared}
        return solve(Problem(problem.inequalities, None, fixed), margin=INSIDE).solved

    low, high = 0.0, 1e-3
    while holds(high):
        low, high = high, 2.0 * high
        if high > AGES:
            return np.inf
    while high - low > rtol * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _decay(method: EulerPi, plant: Plant, alpha: float) -> Problem:
    """V falls by 2 α T per sample where nothing disturbs; λ is one without loss, so that it is linear in ℓ²."""
    T0 = method.time(plant)
    Φ0 = method.model(plant, T0)
    H0 = method.decoupling(plant, Φ0)
    unscaled = Scaling(np.zeros(plant.n, np.int64), np.zeros(plant.p, np.int64))
    m = sampled_letters(plant, method.channels(plant), unscaled, H0, np.ones(len(plant.faults)), T0)
    T = m.gains["T"]
    P, Y, ℓ2 = unknown("P", m.nz, m.nz, symmetric=True), unknown("Y", m.nz, plant.p), unknown("ℓ²")
    X, PB = P @ m.A - Y @ m.C, P @ m.Bφ
    lmi = sym([
        [X + X.T + 2 * alpha * P + ℓ2 * (m.R.T @ m.R), PB, T * X.T],
        [__, -I(PB.shape[1]), T * PB.T],
        [__, __, -T * P],
    ])  # fmt: skip
    return Problem([lmi < 0, P > 0], -ℓ2, {"T": T0, "H": H0, "Φ₁": Φ0})


@dataclass(frozen=True)
class PracticalBound:
    """In the end |e_f| <= value while the model's error stays in its ellipsoid; proved exactly, with the rate alpha."""

    value: float
    alpha: float


def practical_bound(
    method: EulerPi, plant: Plant, gains: Mapping[str, Array], reach: Array, rates: Sequence[float] = RATES
) -> PracticalBound | None:
    """The error that a wrong model leaves in the first reconstructed actuator fault, in its declared size.

    reach (n,): the model is off by m per second, x(k+1) = Φ_T + T m, with Σ (m_i / reach_i)² <= 1 at all times; nothing
    else disturbs.  It replaces the semiglobal practical theorems of the paper.  None where no rate gives a bound.
    """
    T0 = float(gains["T"].item())
    unscaled = Scaling(np.zeros(plant.n, np.int64), np.zeros(plant.p, np.int64))
    m = sampled_letters(plant, method.channels(plant), unscaled, gains["H"], np.ones(len(plant.faults)), T0)
    P, σ2, λ, α = unknown("P", m.nz, m.nz, symmetric=True), unknown("σ²"), unknown("λ"), unknown("α")
    T, D = m.gains["T"], given("reach", np.diag(reach))
    c = given("c", np.eye(1, len(plant.faults))) @ m.faults
    X, PB, Z = P @ m.A - P @ m.K @ m.C, P @ m.Bφ, P @ m.Πx @ D
    lmi = sym([
        [X + X.T + 2 * α * P + λ * m.α**2 * (m.R.T @ m.R), PB, Z, T * X.T],
        [__, -λ * I(PB.shape[1]), 0, T * PB.T],
        [__, __, -σ2 * I(plant.n), T * Z.T],
        [__, __, __, -T * P],
    ])  # fmt: skip
    inequalities = [lmi < 0, P - c.T @ c > 0]
    best: PracticalBound | None = None
    for rate in rates:
        known = {**gains, "T": T0, "α": rate} | ({} if PB.shape[1] else {"λ": 1.0})
        found = solve(Problem(inequalities, σ2, known), margin=INSIDE)
        if not found.solved or found.objective <= 0:
            continue
        value = float(np.sqrt(found.objective / (2 * rate)))
        if best is not None and value >= best.value:
            continue
        if all(statement(i, {**known, **found.values}).prove().verdict == "proved" for i in inequalities):
            best = PracticalBound(value, rate)
    return best
