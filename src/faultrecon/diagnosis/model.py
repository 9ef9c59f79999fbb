# SPDX-License-Identifier: BSD-3-Clause
"""What all sets of faults of one plant have in common, factored once.

A set of faults only chooses which outputs count as healthy.  The modes that decide, and the response to disturbances,
belong to the plant; plants that differ in their faults alone share them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.annihilator import annihilator, column_rank
from faultrecon.numerics.decay import distance_at_least
from faultrecon.numerics.pencil import Mode, SlowModes
from faultrecon.numerics.shared_floor import NoisyOutputs
from faultrecon.plant.plant import Plant

Array = NDArray[Any]

ROUNDING = 1e-9
"""A hundred times the tolerance below which a mode counts as unseen."""


@dataclass(frozen=True)
class Matrices:
    """The matrices of a plant by content: equal ones share what was computed from them.

    A (n, n), E_w W (n, l), C (p, n), F_w W (p, l) in row order; sample_time None for continuous time.
    """

    n: int
    p: int
    A: bytes
    B: bytes
    C: bytes
    E: bytes
    sample_time: float | None

    @classmethod
    def of(cls, plant: Plant) -> Matrices:
        """Those of a plant, disturbances in their declared sizes."""
        size = np.array([d.size for d in plant.attenuated])
        B, E = plant.E_w * size, plant.F_w * size
        return cls(plant.n, plant.p, plant.A.tobytes(), B.tobytes(), plant.C.tobytes(), E.tobytes(), plant.sample_time)

    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C, E again."""
        shapes = (
            (self.A, (self.n, self.n)),
            (self.B, (self.n, -1)),
            (self.C, (self.p, self.n)),
            (self.E, (self.p, -1)),
        )
        A, B, C, E = (np.frombuffer(raw).reshape(shape) if raw else np.zeros((shape[0], 0)) for raw, shape in shapes)
        return A, B, C, E


@lru_cache(maxsize=8)
def slow_modes(of: Matrices) -> SlowModes:
    """The modes that decide detectability, for every choice of outputs."""
    A, _, C, _ = of.arrays()
    return SlowModes.of(A, C, sampled=of.sample_time is not None)


@lru_cache(maxsize=8)
def noisy_outputs(of: Matrices) -> NoisyOutputs | None:
    """The response to disturbances, for every set of faults; None unless each output has noise of its own.

    For a sampled plant on the unit circle, which a bilinear map brings to the imaginary axis.
    """
    _, B, _, E = of.arrays()
    slow = slow_modes(of)
    A, B, C = slow.A, B / slow.unit[:, None], slow.C
    if of.sample_time is not None:
        mapped = bilinear(A, B, C, E)
        if mapped is None:
            return None
        A, B, C, E = mapped
    return NoisyOutputs.of(A, B, C, E)


@lru_cache(maxsize=64)
def healthy(plant: Plant) -> Array:
    """N (p - q, p): the outputs that no sensor fault reaches."""
    return annihilator(plant.F_f)


@lru_cache(maxsize=64)
def sensor_rank(plant: Plant) -> int:
    """How many sensor faults can be told apart by the directions in which they move the measurements."""
    F = plant.F_f[:, [f.site == "sensor" for f in plant.faults]]
    return int(F.any()) if F.shape[1] == 1 else column_rank(F)


@lru_cache(maxsize=64)
def certain_distance(plant: Plant) -> float:
    """How far the healthy outputs certainly are from missing a mode that does not decay, relative to the model.

    Found without a search over s; 0 where this way finds nothing, or less than rounding could bring about.
    """
    found = distance_at_least(slow_modes(Matrices.of(plant)), healthy(plant))
    return found if found > ROUNDING else 0.0


@lru_cache(maxsize=64)
def unseen(plant: Plant) -> tuple[Mode, ...]:
    """The modes that do not decay and that no healthy output sees."""
    if certain_distance(plant) > 0:
        return ()
    return tuple(slow_modes(Matrices.of(plant)).undetectable(healthy(plant)))


def bilinear(A: Array, B: Array, C: Array, D: Array) -> tuple[Array, Array, Array, Array] | None:
    """The continuous system with G(s) = G(z), z = (1 + s)/(1 - s); None when z = -1 is a pole."""
    n = A.shape[0]
    plus = A + np.eye(n)
    if np.linalg.cond(plus) > 1e12:  # the map would carry rounding of 1e-4 into the answer
        return None
    root = np.sqrt(2.0)
    back = np.linalg.solve(plus, B)
    return np.linalg.solve(plus, A - np.eye(n)), root * back, root * np.linalg.solve(plus.T, C.T).T, D - C @ back
