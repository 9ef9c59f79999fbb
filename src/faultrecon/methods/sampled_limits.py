# SPDX-License-Identifier: BSD-3-Clause
"""How far the reduced inequality reaches: the largest Lipschitz constant, the longest sample time, the model's error.

The first two are limits of feasibility with gains and levels that grow without bound; they say where not to go.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, Context
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from faultrecon.lmi.expr import Expr, I, __, given, sym, unknown
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.prove import statement
from faultrecon.lmi.solve import solve
from faultrecon.methods.base import Scaling
from faultrecon.methods.sampled_letters import ranges_or_one, sampled_letters, total
from faultrecon.plant.plant import Plant

if TYPE_CHECKING:
    from faultrecon.methods.euler_pi import EulerPi

Array = NDArray[np.float64]

RATES = (0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0)
"""Decay rates α in 1/s among which the practical bound takes the best."""
AGES = 1e3
"""Seconds beyond which no sample time is looked for."""
INSTANT = 1e-9
"""Seconds below which a sample time is none."""
INSIDE = 1e-7
"""How far inside each scaled inequality a point has to lie: 100 times the solver's tolerance of 1e-9."""


def largest_lipschitz(method: EulerPi, plant: Plant, alpha: float = 0.0) -> float | None:
    """The supremum of ℓ for which errors decay at `alpha` (1/s) with every φ that |φ(a) - φ(b)| ≤ ℓ |a - b| allows.

    Where each component of φ has a constant of its own, ℓ stands for all of them, which then change in proportion.
    None where the solver cannot tell.
    """
    term = plant.nonlinearity
    if term is not None and term.separate and term.constant > 0:
        edge = _edge(lambda ℓ: _holds(method, replace(plant, nonlinearity=term.at(ℓ)), alpha), term.constant)
        return edge if edge > 0 else None
    found = solve(_decay(method, plant, alpha))
    return float(np.sqrt(max(-found.objective, 0.0))) if found.solved else None


def longest_sample_time(method: EulerPi, plant: Plant, alpha: float = 0.0, *, rtol: float = 1e-3) -> float:
    """The longest T at which errors decay at `alpha` (1/s) with the plant's Lipschitz constant; inf beyond `AGES`.

    By bisection, for models for which what holds at T holds at every shorter one; 0 where nothing holds.
    """

    def holds(T: float) -> bool:
        return _holds(type(method)(T), plant, alpha)

    low, high = 0.0, 1e-3
    while holds(high):
        low, high = high, 2.0 * high
        if high > AGES:
            return np.inf
    while high - low > rtol * high:
        if high < INSTANT:
            return 0.0
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _edge(holds: Callable[[float], bool], start: float, rtol: float = 1e-3) -> float:
    """The largest number up to which something holds, by doubling or halving and then bisection; 0 below all sense."""
    low = high = start
    if holds(start):
        while holds(high) and high < start * 2.0**40:
            low, high = high, 2.0 * high
    else:
        while not holds(low):
            low, high = 0.5 * low, low
            if low < start * 2.0**-40:
                return 0.0
    while high - low > rtol * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _holds(method: EulerPi, plant: Plant, alpha: float) -> bool:
    """Whether errors decay at `alpha` with the constants of this plant."""
    problem = _decay(method, plant, alpha)
    fixed = dict(problem.fixed or {})
    if plant.nonlinearity is None or not plant.nonlinearity.separate:
        fixed["ℓ²"] = 0.0 if plant.nonlinearity is None else plant.nonlinearity.constant**2
    return solve(Problem(problem.inequalities, None, fixed), margin=INSIDE).solved


def _decay(method: EulerPi, plant: Plant, alpha: float) -> Problem:
    """V falls by 2 α T per sample where nothing disturbs; the first λ is one without loss.

    With one constant that makes it linear in ℓ², which is an unknown then.
    """
    T0 = method.time(plant)
    Φ0 = method.model(plant, T0)
    H0 = method.decoupling(plant, Φ0)
    unscaled = Scaling(np.zeros(plant.n, np.int64), np.zeros(plant.p, np.int64))
    m = sampled_letters(plant, method.channels(plant), unscaled, H0, np.ones(len(plant.faults)), T0)
    T, term, fixed = m.gains["T"], plant.nonlinearity, {"T": T0, "H": H0, "Φ₁": Φ0}
    P, Y, ℓ2 = unknown("P", m.nz, m.nz, symmetric=True), unknown("Y", m.nz, plant.p), unknown("ℓ²")
    X, PB = P @ m.A - Y @ m.C, P @ m.Bφ
    if term is not None and term.separate:
        known, price = m.Λ.bound(m.R, m.R), m.Λ.minus
        fixed |= {m.Λ.unknowns[0].name: 1.0}
        more = [λ > 0 for λ in m.Λ.unknowns[1:]]
    else:
        known, price, more = ℓ2 * (m.R.T @ m.R), -I(PB.shape[1]), []
    lmi = sym([
        [X + X.T + 2 * alpha * P + known, PB, T * X.T],
        [__, price, T * PB.T],
        [__, __, -T * P],
    ])  # fmt: skip
    return Problem([lmi < 0, P > 0, *more], -ℓ2, fixed)


@dataclass(frozen=True)
class PracticalBound:
    """In the end |e_f| <= value while the model's error stays where it was said to; proved exactly, with the rate alpha."""

    value: float
    alpha: float


def practical_bound(
    method: EulerPi,
    plant: Plant,
    gains: Mapping[str, Array],
    reach: Array,
    rates: Sequence[float] = RATES,
    *,
    fault: int = 0,
) -> PracticalBound | None:
    """The error that a wrong model leaves in a reconstructed fault that is constant, in its declared size.

    reach (n,): the model is off by m per second, x(k+1) = Φ_T + T m, with Σ (m_i / reach_i)² <= 1 at all times; nothing
    else disturbs.  It replaces the semiglobal practical theorems of the paper.  None where no rate gives a bound.
    """
    σ2 = unknown("σ²")
    return _least_over_rates(method, plant, gains, np.diag(reach), (σ2 * I(plant.n), σ2), rates, fault)


def practical_bound_in_box(
    method: EulerPi,
    plant: Plant,
    gains: Mapping[str, Array],
    reach: Array,
    rates: Sequence[float] = RATES,
    *,
    fault: int = 0,
) -> PracticalBound | None:
    """The same with |m_i| <= reach_i for each i: one multiplier per entry, Σ σ_i² (m_i / reach_i)² <= Σ σ_i²."""
    moving = np.flatnonzero(reach)
    if not moving.size:
        return PracticalBound(0.0, 0.0)
    parts = [unknown(f"σ{i}²") for i in moving]
    size = len(parts)
    picks = [given(f"J_{i}", np.eye(1, size, k)) for k, i in enumerate(moving)]
    weight = total([σ2 * (J.T @ J) for σ2, J in zip(parts, picks, strict=True)])
    return _least_over_rates(method, plant, gains, np.diag(reach)[:, moving], (weight, total(parts)), rates, fault)


def _least_over_rates(
    method: EulerPi,
    plant: Plant,
    gains: Mapping[str, Array],
    into: Array,
    priced: tuple[Expr, Expr],
    rates: Sequence[float],
    fault: int,
) -> PracticalBound | None:
    """The least bound for m = into v with v' weight v <= level, `priced` = (weight, level), that is proved."""
    weight, level = priced
    T0, units = float(gains["T"].item()), np.rint(np.log2(ranges_or_one(plant))).astype(np.int64)
    own, even = Scaling(units, np.zeros(plant.p, np.int64)), np.ones(len(plant.faults))
    m = sampled_letters(plant, method.channels(plant), own, gains["H"], even, T0, idempotent=method.idempotent)
    unit = float(
        np.exp2(np.rint(np.log2(into.max())))
    )  # errors are proportional to m; numbers near one are solved best
    P, Λ, α = unknown("P", m.nz, m.nz, symmetric=True), m.Λ, unknown("α")
    T, c = m.gains["T"], given("c", np.eye(1, len(plant.faults), fault)) @ m.faults
    X, PB, Z = P @ m.A - P @ m.K @ m.C, P @ m.Bφ, P @ m.Πx @ given("reach", into / unit)
    lmi = sym([
        [X + X.T + 2 * α * P + Λ.bound(m.R, m.R), PB, Z, T * X.T],
        [__, Λ.minus, 0, T * PB.T],
        [__, __, -weight, T * Z.T],
        [__, __, __, -T * P],
    ])  # fmt: skip
    inequalities = [lmi < 0, P - c.T @ c > 0]
    found = []
    for rate in rates:
        known = {**gains, "T": T0, "α": rate} | ({} if PB.shape[1] else {"λ": 1.0})
        outcome = solve(Problem(inequalities, level, known), margin=INSIDE)
        if outcome.solved and outcome.objective > 0:
            found.append((float(np.sqrt(outcome.objective / (2 * rate))), rate, {**known, **outcome.values}))
    for value, rate, values in sorted(found, key=lambda one: one[:2]):
        if all(statement(i, values).prove().verdict == "proved" for i in inequalities):
            return PracticalBound(
                value * unit * (1.0 + 2.0**-40), rate
            )  # the sum, the quotient and the root are rounded
    return None


SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
"""Decay rates that a practical bound is tried with, as shares of that of the slowest mode: there is none beyond it."""


def practical_notes(method: EulerPi, plant: Plant, gains: Mapping[str, Array]) -> tuple[str, ...]:
    """How far the model is off on the declared domain, and what error of a constant fault it leaves, in sentences."""
    off, channels = method.mismatch(plant, float(gains["T"].item())), plant.signals.x
    if off.size is None:
        remedy = f"; declare the range of {', '.join(off.missing)} to have it bounded" if off.missing else ""
        return (f"sup |m|, how far the model is off per second, is to be checked in simulation: {off.why}{remedy}",)
    if not off.size.any():
        return ("sup |m| = 0: the model is exact while u, f and the disturbances are held over a sample time (proved)",)
    sizes = ", ".join(f"{name} {_above(size)}" for name, size in zip(channels.names, off.size, strict=True) if size)
    said = f"sup |m| <= {sizes} per second: how far the model is off (proved on the declared domain: {DOMAIN})"
    slowest = -float(np.real(method.observer(plant, gains).rates).max())
    rates = [float(share * slowest) for share in SHARES]
    ends = []
    for k, fault in enumerate(plant.faults):
        bound = practical_bound_in_box(method, plant, gains, off.size, rates, fault=k) if slowest > 0 else None
        if bound is None:
            return (said, f"no bound was found on what that leaves of {fault.name}")
        ends.append(f"|{fault.name} - its estimate| <= {_above(bound.value * fault.size)}")
    quiet = "nothing but what is decoupled" if method.channels(plant).decouple.shape[1] else "nothing"
    return said, f"for constant faults while {quiet} disturbs, in the end {', '.join(ends)} (proved for that sup |m|)"


DOMAIN = (
    "x and u stay in their ranges and in the domain of φ; u, f and the counted disturbances are held over a sample time,"
    " f and they no larger than declared"
)


def _above(value: float) -> str:
    """Four digits, rounded up: a bound that is shown is one."""
    return f"{float(Context(prec=4, rounding=ROUND_CEILING).create_decimal_from_float(value)):.4g}"
