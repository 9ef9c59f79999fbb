# SPDX-License-Identifier: BSD-3-Clause
"""How well anyone could reconstruct the faults of a plant, whatever the method and the solver."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.conditions import fault_columns
from faultrecon.diagnosis.model import Matrices, bilinear, healthy, noisy_outputs, sensor_rank, slow_modes, unseen
from faultrecon.numerics.hinf import Peak, estimator_floor, imitated
from faultrecon.numerics.interpolation import floor_of_slow_part
from faultrecon.plant.plant import Plant

Array = NDArray[Any]
Kind = Literal["disturbance", "hidden mode", "slow fault"]


@dataclass(frozen=True, slots=True)
class Floor:
    """A level that no estimator beats, and what it is the level of.

    kind "disturbance": gain from the counted disturbances to the reconstruction errors, both in declared sizes;
    frequency (rad/s, may be inf) is where it was evaluated.  kind "hidden mode": gain in seconds from the rate of the
    faults to the errors, when the healthy sensors miss the `modes`; frequency is the |Im| of the first of them.  kind
    "slow fault": as "disturbance", for estimators that follow faults up to the frequency `band` (rad/s, 0: constant
    ones), which is what an actuator fault allows.
    """

    value: float
    frequency: float
    kind: Kind = "disturbance"
    modes: tuple[complex, ...] = ()
    band: float = 0.0

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
        if self.value == 0:
            return "no level is too small for some estimator (floor 0)"
        if self.kind == "disturbance":
            return f"no estimator can guarantee less than γ = {self.value:.6g}"
        if self.kind == "slow fault":
            which = f"faults up to {self.band:.4g} rad/s" if self.band else "a constant fault"
            return f"no estimator that follows {which} can guarantee less than γ = {self.value:.6g}"
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
    return reconstruction_floors([plant])[0]


def reconstruction_floors(plants: Sequence[Plant]) -> list[Floor | None]:
    """`reconstruction_floor` of each: plants that differ in their faults alone share the work."""
    bounded = [_has_floor(plant) for plant in plants]
    found = [hidden_floor(plant) if has else None for plant, has in zip(plants, bounded, strict=True)]
    open_ = [j for j, plant in enumerate(plants) if found[j] is None and bounded[j] and plant.attenuated]
    for j, floor in zip(open_, _disturbance_floors([plants[j] for j in open_]), strict=True):
        found[j] = floor
    return found


def _has_floor(plant: Plant) -> bool:
    """Independent additive sensor faults, and no others."""
    if not plant.faults or any(f.site == "actuator" or f.effect == "multiplicative" for f in plant.faults):
        return False
    return sensor_rank(plant) == len(plant.faults)


def hidden_floor(plant: Plant) -> Floor | None:
    """The floor that modes unseen by the healthy sensors set for the faults; None when they see every one.

    Error and rate in declared sizes of the faults.  Source: [Alwi 2009], re-derived: Nevanlinna-Pick bound.
    """
    if not unseen(plant):
        return None
    N, K = _split(plant)
    slow = slow_modes(Matrices.of(plant))
    found = floor_of_slow_part(slow.L, slow.V, slow.size, N @ slow.C, K @ slow.C, plant.sample_time)
    if found.value == 0:
        return None
    return Floor(found.value, abs(found.modes[0].imag), "hidden mode", found.modes)


def disturbance_floor(plant: Plant) -> Floor | None:
    """The gain from disturbances to errors below which no linear estimator that passes the faults can go.

    sup over frequency of |Y2 (I - Y1⁺ Y1)|; for a sampled plant over the unit circle, which a bilinear map brings to
    the imaginary axis.  None without a counted disturbance.  Source: [Khosrowjerdi 2011], re-derived.
    """
    return _disturbance_floors([plant])[0] if plant.attenuated else None


def _disturbance_floors(plants: Sequence[Plant]) -> list[Floor | None]:
    """The floors of plants with disturbances: those with equal matrices together, where their outputs allow it."""
    found: list[Floor | None] = [None] * len(plants)
    alike: dict[Matrices, list[int]] = {}
    for j, plant in enumerate(plants):
        alike.setdefault(Matrices.of(plant), []).append(j)
    for matrices, members in alike.items():
        outputs = noisy_outputs(matrices)
        sets = [_split(plants[j]) for j in members]
        peaks = [None] * len(sets) if outputs is None else outputs.floors(sets)
        for j, split, peak in zip(members, sets, peaks, strict=True):
            found[j] = _level(peak or _alone(matrices, *split), matrices.sample_time)
    return found


def slow_fault_floor(plant: Plant) -> Floor | None:
    """The level below which no estimator can go that follows these faults, actuator faults among them, while they move
    slowly.

    An actuator fault reaches the sensors through the plant, which passes fast ones ever more weakly: a floor over all
    frequencies is infinite.  Here it is the supremum up to rate/size of the actuator faults, on a grid, so from below;
    at rest alone where no rate is declared.  None without a counted disturbance.
    """
    if not plant.attenuated or not plant.faults:
        return None
    band = min(f.rate / f.size if math.isfinite(f.rate) else 0.0 for f in plant.faults if f.site == "actuator")
    T = plant.sample_time
    if T is not None:
        band = min(band, math.pi / T)
    A, B, C, E = Matrices.of(plant).arrays()
    into, onto = fault_columns(plant)
    size = np.array([f.size for f in plant.faults])
    resonances = np.abs(np.linalg.eigvals(A).imag) if T is None else np.abs(np.angle(np.linalg.eigvals(A))) / T
    inside = np.geomspace(1e-3 * band, band, 24) if band else np.zeros(0)
    w = np.unique(np.concatenate([[0.0], inside, resonances[resonances <= band]]))
    points = 1j * w if T is None else np.exp(1j * w * T)
    values = [imitated(A, B, C, E, into * size, onto * size, s) for s in points]
    k = int(np.argmax(values))
    return Floor(values[k], float(w[k]), "slow fault", band=band)


def _alone(matrices: Matrices, N: Array, K: Array) -> Peak | None:
    """The floor of one set of faults, whatever its outputs."""
    A, B, C, E = matrices.arrays()
    if matrices.sample_time is not None:
        mapped = bilinear(A, B, C, E)
        if mapped is None:
            return None
        A, B, C, E = mapped
    return estimator_floor(A, B, N @ C, N @ E, K @ C, K @ E)


def _level(peak: Peak | None, sample_time: float | None) -> Floor | None:
    if peak is None:
        return None
    frequency = peak.frequency if sample_time is None else 2.0 * float(np.arctan(peak.frequency)) / sample_time
    return Floor(peak.value if np.isfinite(peak.value) else float("inf"), frequency)


def _split(plant: Plant) -> tuple[Array, Array]:
    """N: the outputs that no fault reaches; V F⁺: what reads the faults, in their declared sizes, from the others."""
    size, length = np.array([f.size for f in plant.faults]), np.linalg.norm(plant.F_f, axis=0)
    F = plant.F_f / length
    inverse = F.T if len(size) == 1 else np.linalg.pinv(F)
    return healthy(plant), inverse / (length * size)[:, None]
