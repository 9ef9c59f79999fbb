# SPDX-License-Identifier: BSD-3-Clause
"""What the older sliding-mode observers share: the regular form of a measured plant, their gains, what they ask for.

Regular form: x = K ξ1 + C⁺ ξ2, ξ2 = C x what is measured and ξ1 what is not, in declared ranges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Finding, Inconclusive
from faultrecon.methods.base import deviations
from faultrecon.methods.fault_state import padded
from faultrecon.numerics.annihilator import column_rank
from faultrecon.numerics.riccati import filter_riccati
from faultrecon.numerics.scaling import spectral_norm
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

FILTER = 20.0
"""a in 1/s: the filter that makes the fault an input, and how fast a fault may be to pass."""
LOW_PASS = 0.05
"""τ in s: the low pass of the equivalent injection."""
SURE = 2.0
"""The bound of an injection over what it has to be for faults of the declared size: the rest is for reaching."""


@dataclass(frozen=True, eq=False)
class RegularForm:
    """ẋ = A x, y = C x in declared ranges, and x = K ξ1 + C⁺ ξ2 in which ξ2 is what is measured, ξ1 what is not.

    A (n, n), C (k, n) of full row rank, K (n, n - k) orthonormal, states (n,) and outputs (k,) the ranges.
    """

    A: Array
    C: Array
    K: Array
    states: Array
    outputs: Array

    @staticmethod
    def of(plant: Plant, C: Array, outputs: Array) -> RegularForm:
        """The form of a plant measured by C (k, n), with these ranges (k,)."""
        t = ranges(plant.signals.x.ranges)
        scaled = C * t / outputs[:, None]
        K = np.linalg.qr(scaled.T, mode="complete")[0][:, len(C) :]
        return RegularForm(plant.A * t / t[:, None], scaled, K, t, outputs)

    @property
    def right(self) -> Array:
        """C⁺ (n, k), with C C⁺ = I and Kᵀ C⁺ = 0."""
        return np.asarray(np.linalg.pinv(self.C), dtype=float)

    @property
    def A11(self) -> Array:
        """How what is not measured moves, (n - k, n - k)."""
        return self.K.T @ self.A @ self.K

    @property
    def A12(self) -> Array:
        """How the outputs drive it, (n - k, k)."""
        return self.K.T @ self.A @ self.right

    @property
    def A21(self) -> Array:
        """How it drives the outputs, (k, n - k)."""
        return self.C @ self.A @ self.K

    @property
    def A22(self) -> Array:
        """How the outputs drive themselves, (k, k)."""
        return self.C @ self.A @ self.right

    def injection(self, L: Array) -> Array:
        """G_n (n, k) = T⁻¹ [-L; I]; L (n - k, k)."""
        return self.right - self.K @ L

    def physical(self, Gn: Array) -> Array:
        """G_n in the plant's units."""
        return self.states[:, None] * Gn / self.outputs

    def gain(self, physical: Array) -> Array:
        """The L of a G_n in the plant's units."""
        return -self.K.T @ (physical * self.outputs / self.states[:, None])


def kalman_gain(A11: Array, A21: Array, process: float) -> Array:
    """L that makes A11 + L A21 stable: the Kalman filter's for noises of `process` and 1.  Raises Inconclusive."""
    n, k = A21.shape[1], A21.shape[0]
    noises = np.hstack([process * np.eye(n), np.zeros((n, k))]), np.hstack([np.zeros((k, n)), np.eye(k)])
    found = filter_riccati(A11, noises[0], A21, noises[1], np.zeros((0, n)), np.zeros((0, n + k)))
    if found is None:
        raise Inconclusive(
            "no stable sliding motion was found",
            why="the Riccati equation of its Kalman gain has no stabilising solution in floating point",
            evidence={"states": n, "outputs": k},
            remedies=("look in `faultrecon check` for a mode that is seen by a hair", "declare ranges of the signals"),
        )
    return -found.L


def linear_gain(A: Array, G: Array, C: Array) -> float:
    """k for which A - k G C, with C G = I, is stable and decays at half the pace of the sliding motion or faster.

    For large k its eigenvalues are those of the sliding motion and -k, so that doubling ends.
    """
    K = np.linalg.qr(C.T, mode="complete")[0][:, len(C) :]
    sliding = np.linalg.eigvals(K.T @ (A - G @ (C @ A)) @ K).real.max(initial=-np.inf)
    k = max(spectral_norm(A), 1.0)
    if not len(C):
        return k
    for _ in range(60):
        if np.linalg.eigvals(A - k * G @ C).real.max() <= max(0.5 * sliding, -0.5 * k):
            break
        k *= 2.0
    return k


def linear_findings(plant: Plant) -> list[Finding]:
    """These observers are stated for linear plants; a known term that reads healthy sensors is copied."""
    if plant.nonlinearity is None:
        return []
    return [
        Finding(
            f"{plant.name} is nonlinear",
            why="what keeps the injection on its surface is derived for a linear plant",
            evidence={"Lipschitz constant": plant.nonlinearity.constant},
            remedies=("linearise it about an operating point", "use lipschitz-hinf"),
            see="Alwi 2009, (1)",
        )
    ]


def row_findings(plant: Plant, C: Array, which: str) -> list[Finding]:
    """Outputs that repeat each other cannot all be slid on."""
    rank = column_rank(C.T)
    if rank == len(C):
        return []
    return [
        Finding(
            f"the {which} of {plant.name} repeat each other: {len(C)} rows of rank {rank}",
            why="an observer slides on outputs that its states can reach one by one, so C has to be of full row rank",
            evidence={"outputs": len(C), "rank": rank, "states": plant.n},
            remedies=(f"keep {rank} of them", "average sensors that measure the same", "use lipschitz-hinf"),
            see="Alwi 2009, section 2: C of full row rank",
        )
    ]


def ranges(declared: tuple[float, ...]) -> Array:
    """Declared ranges as numbers, 1 where none is declared."""
    return np.where(np.isnan(declared), 1.0, declared)


def linear_parts(plant: Plant, states: int) -> dict[str, Any]:
    """`deviations` for an observer whose first states are the plant's, of `states` in all."""
    parts = deviations(plant)
    return parts | {"copied": padded(parts["copied"], states - plant.n)}


def scalars(**values: float) -> dict[str, Array]:
    """Numbers as gains, (1, 1) each."""
    return {name: np.array([[value]]) for name, value in values.items()}
