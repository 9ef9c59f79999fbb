# SPDX-License-Identifier: BSD-3-Clause
"""What observers share that carry the fault as a further state, z = [x̂; f̂], which moves by innovations alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.observer import CopiedTerm, Injection, Observer
from faultrecon.methods.base import deviations
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]


def with_fault_state(plant: Plant) -> tuple[Array, Array]:
    """([A 0; 0 0], [C F]) of the state [x; f]."""
    n, q = plant.n, len(plant.faults)
    return np.block([[plant.A, np.zeros((n, q))], [np.zeros((q, n + q))]]), np.hstack([plant.C, plant.F_f])


def fault_state_observer(plant: Plant, K: Array, injections: Sequence[Injection] = ()) -> Observer:
    """z' = [A x̂ + B u + g; 0] + K (y - C x̂ - F f̂ - D u) of a linear plant, K (n+q, p), and what injections add."""
    A, C = with_fault_state(plant)
    n, q, (p, m) = plant.n, len(plant.faults), plant.D.shape
    own = deviations(plant)
    own["copied"] = padded(own["copied"], q)
    return Observer(
        A=A - K @ C,
        B=np.hstack([np.vstack([plant.B, np.zeros((q, m))]) - K @ plant.D, K]),
        Cx=np.eye(n, n + q),
        Dx=np.zeros((n, m + p)),
        Cf=np.eye(q, n + q, n),
        Df=np.zeros((q, m + p)),
        F=plant.F_f,
        injections=tuple(injections),
        **own,
    )


def padded(term: CopiedTerm | None, states: int) -> CopiedTerm | None:
    """A copied term that enters the first states, with so many more below that it does not enter."""
    return None if term is None else CopiedTerm(below(term.into, states), term.g)


def below(into: Array, rows: int) -> Array:
    """A matrix with rows of zeros below."""
    return np.vstack([into, np.zeros((rows, into.shape[1]))])
