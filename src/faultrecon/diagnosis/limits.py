# SPDX-License-Identifier: BSD-3-Clause
"""How well anyone could reconstruct the faults of a plant, whatever the method and the solver."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.annihilator import annihilator, column_rank, left_inverse
from faultrecon.numerics.hinf import estimator_floor
from faultrecon.numerics.interpolation import hidden_mode_floor
from faultrecon.plant.plant import Plant

Array = NDArray[Any]
Kind = Literal["disturbance", "hidden mode"]


@dataclass(frozen=True, slots=True)
class Floor:
    """A level that no estimator beats, and what it is the level of.

    kind "disturbance": gain from the counted disturbances to the reconstruction errors, both in declared sizes;
    frequency (rad/s, may be inf) is where it was evaluated.  kind "hidden mode": gain in seconds from the rate of the
    faults to the errors, when the healthy sensors miss the `modes`; frequency is the |Im| of the first of them.
    """

    value: float
    frequency: float
    kind: Kind = "disturbance"
    modes: tuple[complex, ...] = ()

    def noise_gain(self, level: float) -> float | None:
        """How much of the noise of a faulty sensor reaches f̂ at high frequency, at this level above the floor.

        Of the first-order design, exact for one real hidden mode λ in continuous time: 1/(λ level - 1), so that a
        level nearer to the floor is paid for with noise; inf at or below the floor.  None where no such formula is
        known (another kind of floor, several modes, a complex one).
        """
        one = self.kind == "hidden mode" and len(self.modes) == 1 and self.modes[0].imag == 0
        if not one or not 0 < self.value < np.inf:
            return None
        return 1.0 / (level / self.value - 1.0) if level > self.value else np.inf

    def __str__(self) -> str:
        if self.kind == "disturbance":
            return f"no estimator can guarantee less than γ = {self.value:.6g}"
        if np.isinf(self.value):
            return "no estimator whatever: a constant fault looks like a drift of the plant"
        return f"at best an error of {self.value:.6g} s times the rate of the fault"


@lru_cache(maxsize=16)
def reconstruction_floor(plant: Plant) -> Floor | None:
    """The floor that applies: that of the hidden modes when healthy sensors miss one, else that of the disturbances.

    None where neither applies: no sensor fault, an actuator fault, dependent fault directions, or no counted
    disturbance.  For a nonlinear plant it bounds what can be *guaranteed* for every φ within the Lipschitz bound, of
    which φ = 0 is one; for the φ of one plant alone less may be possible.
    """
    if not plant.faults or any(f.site == "actuator" for f in plant.faults):
        return None
    if column_rank(plant.F_f) < len(plant.faults):
        return None
    return hidden_floor(plant) or disturbance_floor(plant)


def hidden_floor(plant: Plant) -> Floor | None:
    """The floor that modes unseen by the healthy sensors set for the faults; None when they see every one.

    Error and rate in declared sizes of the faults.  Source: [Alwi 2009], re-derived: Nevanlinna-Pick bound.
    """
    N, Fp = annihilator(plant.F_f), plant.letters()["V"] @ left_inverse(plant.F_f)
    found = hidden_mode_floor(plant.A, N @ plant.C, Fp @ plant.C, sample_time=plant.sample_time)
    if found.value == 0:
        return None
    return Floor(found.value, abs(found.modes[0].imag), "hidden mode", found.modes)


def disturbance_floor(plant: Plant) -> Floor | None:
    """The gain from disturbances to errors below which no linear estimator that passes the faults can go.

    sup over frequency of |Y2 (I - Y1⁺ Y1)|; for a sampled plant over the unit circle, which a bilinear map brings to
    the imaginary axis.  None without a counted disturbance.  Source: [Khosrowjerdi 2011], re-derived.
    """
    if not plant.attenuated:
        return None
    letters = plant.letters()
    N, Fp = annihilator(plant.F_f), letters["V"] @ left_inverse(plant.F_f)
    A, B, C, E = plant.A, plant.E_w @ letters["W"], plant.C, plant.F_w @ letters["W"]
    if plant.sample_time is not None:
        mapped = _bilinear(A, B, C, E)
        if mapped is None:
            return None
        A, B, C, E = mapped
    peak = estimator_floor(A, B, N @ C, N @ E, Fp @ C, Fp @ E)
    frequency = peak.frequency
    if plant.sample_time is not None:
        frequency = 2.0 * float(np.arctan(frequency)) / plant.sample_time
    return Floor(peak.value if np.isfinite(peak.value) else float("inf"), frequency)


def _bilinear(A: Array, B: Array, C: Array, D: Array) -> tuple[Array, Array, Array, Array] | None:
    """The continuous system with G(s) = G(z), z = (1 + s)/(1 - s); None when z = -1 is a pole."""
    n = A.shape[0]
    plus = A + np.eye(n)
    if np.linalg.cond(plus) > 1e12:  # the map would carry rounding of 1e-4 into the answer
        return None
    root = np.sqrt(2.0)
    back = np.linalg.solve(plus, B)
    return np.linalg.solve(plus, A - np.eye(n)), root * back, root * np.linalg.solve(plus.T, C.T).T, D - C @ back
