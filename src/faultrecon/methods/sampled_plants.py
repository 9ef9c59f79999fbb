# SPDX-License-Identifier: BSD-3-Clause
"""Plants that come sampled, x⁺ = A x + B u + ..., for observers that are made for one sample time.

Such a plant is its own model, and an exact one: with Φ₁ = I/T and A - I in place of A,

    x⁺ = x + T Φ₁ ((A - I) x + B u + B_φ φ(H_φ x) + E f + D₁ d₁ + D₂ d₂),

which is how `sampled_letters` writes every plant.  Nothing else changes, and no other sample time makes sense.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Finding
from faultrecon.lmi.expr import Expr, I
from faultrecon.methods.base import Identity
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]
Matrix = TypeVar("Matrix", Array, Expr)

SEE = "Jia 2015, section 4, re-derived"
OWN_MAP = "at the plant's own sample time T: the prediction is the map of the plant as it was given, exact;"
"""What a certificate for a sampled plant covers."""
HAS_ITS_MAP = "use euler-pi, whose prediction is the plant's own map"
"""What to do instead of approximating a map that is known."""
MOVES = 1e-7
"""Of the fastest rate: a mode below it stands still.  A double eigenvalue at 1 is known to the root of its rounding."""
LONGEST = 0.25
"""The largest α T that is asked for: V may fall to half in a sample, which a mode that is gone sooner allows as well."""


def continuous_findings(plant: Plant, remedy: str = "give the plant in continuous time") -> list[Finding]:
    """A finding where the plant is sampled, for methods that discretise a continuous one themselves."""
    if plant.sample_time is None:
        return []
    why = "the method discretises a continuous plant itself, together with what is decoupled"
    evidence = {"steps every": plant.sample_time}
    return [Finding("the plant is sampled", why=why, evidence=evidence, remedies=(remedy,), see=SEE)]


def own_time_findings(plant: Plant, sample_time: float | None) -> list[Finding]:
    """A finding where another sample time is asked for than that of a sampled plant."""
    own = plant.sample_time
    if own is None or sample_time is None or abs(sample_time - own) <= 1e-9 * own:
        return []
    return [
        Finding(
            f"a design for a sample every {sample_time:g} s was asked for, and {plant.name} steps every {own:g} s",
            why="what a sampled plant does between its steps, or in several, is not in its matrices",
            evidence={"asked": sample_time, "steps every": own},
            remedies=(f"leave T out, or give T = {own:g}", "give the plant in continuous time"),
            see=SEE,
        )
    ]


def moves(plant: Plant, A: Matrix) -> Matrix:
    """What x does to its own change: A of a continuous plant, A - I of a sampled one; as numbers or as an expression."""
    if plant.sample_time is None:
        return A
    return A - np.eye(plant.n) if isinstance(A, np.ndarray) else A - I(plant.n)


def own_map(n: int, T: float) -> Array:
    """Φ₁ = I/T, (n, n)."""
    return np.eye(n) / T


def own_map_identities(ship: Mapping[str, Expr], n: int, rounding: float) -> tuple[Identity, ...]:
    """T Φ₁ = I: the prediction is the plant's own map."""
    return (Identity("T Φ₁ = I: the prediction is the plant's own map", ship["T"] * ship["Φ₁"] - I(n), rounding),)


def sampled_decay_rate(plant: Plant) -> float:
    """α in 1/s for a sampled plant: a quarter of its slowest mode that moves, half of the slowest fixed zero."""
    from faultrecon.diagnosis.conditions import decoupled_into, decoupled_onto
    from faultrecon.numerics.pencil import invariant_zeros

    T = plant.sample_time
    assert T is not None, "asked for sampled plants alone"
    zeros = invariant_zeros(plant.A, decoupled_into(plant), plant.C, decoupled_onto(plant))
    return min(LONGEST / T, 0.25 * _slowest(np.linalg.eigvals(plant.A), T), 0.5 * _slowest(zeros[np.abs(zeros) < 1], T))


def _slowest(values: NDArray[Any], T: float) -> float:
    """The slowest |log z| / T among numbers z that move; infinite where none does."""
    size = values[np.abs(values) > 0].astype(complex)
    rates = np.abs(np.log(size)) / T
    rates = rates[rates > MOVES * rates.max(initial=0.0)]
    return float(rates.min()) if rates.size else np.inf
