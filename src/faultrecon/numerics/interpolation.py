# SPDX-License-Identifier: BSD-3-Clause
"""What modes that hide behind a fault cost any estimator: a Nevanlinna-Pick bound in closed form.

A mode of A that the healthy outputs do not see looks, at the faulty ones, exactly like a fault that grows as exp(λt).
A stable estimator whose error is to stay bounded must not respond to that waveform: f -> f̂, called F, satisfies
F(λ) C2 v = 0, so E = (F - I)/s, the gain from the rate of the fault to the error, is prescribed at λ.  The smallest
norm of a stable function with prescribed values is the Nevanlinna-Pick bound [Alwi 2009, re-derived].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.numerics.pencil import RANK_TOLERANCE, eigendirections, slow_part, unobservable_subspace
from faultrecon.numerics.scaling import scale_states, spectral_norm, state_scaling

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class HiddenModes:
    """The modes that do not decay, are invisible to the healthy outputs and visible to the faulty ones.

    value: smallest gain from the rate of the fault to the error of its estimate, in seconds (0: no such mode, inf: a
    constant fault looks like one).  An infimum, not attained.  modes: their values s (or multipliers per sample), the
    one that decides first where a single one does.
    """

    value: float
    modes: tuple[complex, ...]


def hidden_mode_floor(
    A: ArrayLike, C1: ArrayLike, C2: ArrayLike, *, sample_time: float | None = None, tol: float = RANK_TOLERANCE
) -> HiddenModes:
    """The infimum over all stable estimators of |f' -> f̂ - f|, where y1 = C1 x is healthy and y2 = C2 x + f.

    A: (n, n), C1: (p1, n), p1 may be 0, C2: (q, n).  Modes in the open right half plane by the Lyapunov equation
    Λ'X + XΛ = W'W: |X^½ Λ⁻¹ X^-½|; a pair ±jω on the axis demands 1/ω (a boundary value binds no neighbour, so the
    larger of the two is the answer); a mode at the origin makes it infinite.  With a sample time the same for
    f⁺ - f = T × rate on the unit circle: Λ - I over T in place of Λ, and a Stein equation.
    """
    A, C1, C2 = (np.asarray(M, dtype=float) for M in (A, C1, C2))
    A, _, C = scale_states(A, np.zeros((A.shape[0], 0)), np.vstack([C1, C2]), state_scaling(A, A[:, :0], C1))
    L, V = slow_part(A, sampled=sample_time is not None)
    return floor_of_slow_part(L, V, spectral_norm(A), C[: C1.shape[0]], C[C1.shape[0] :], sample_time, tol)


def floor_of_slow_part(
    L: Array, V: Array, size: float, C1: Array, C2: Array, sample_time: float | None, tol: float = RANK_TOLERANCE
) -> HiddenModes:
    """The same from a model in balanced units of which `slow_part` gave L and V; size: |A|."""
    n = V.shape[0]
    N = unobservable_subspace(L, C1 @ V, tol, sizes=(size, spectral_norm(C1)))
    L, W = N.T @ L @ N, C2 @ (V @ N)
    visible = _complement(unobservable_subspace(L, W, tol, sizes=(size, spectral_norm(C2))))
    L, W = visible.T @ L @ visible, W @ visible
    if L.shape[0] == 0 or W.shape[0] == 0:
        return HiddenModes(0.0, ())
    slack = 64 * np.finfo(float).eps * n * max(size, np.finfo(float).tiny)
    # Right-most first, as everywhere.
    values = np.array(sorted((s for s, _ in eigendirections(L)), key=lambda s: (-s.real, -s.imag)))
    growth = np.abs(values) - 1.0 if sample_time is not None else np.real(values)
    axis = values[np.abs(growth) <= slack]
    rate = np.abs(axis) if sample_time is None else np.abs(axis - 1.0) / sample_time
    slow = slack if sample_time is None else slack / sample_time
    found = tuple(complex(s) for s in values[growth >= -slack])
    if np.any(rate <= slow):
        at_rest = complex(axis[int(np.argmin(rate))])
        return HiddenModes(np.inf, (at_rest, *(s for s in found if s != at_rest)))
    boundary = float(np.max(1.0 / rate, initial=0.0))
    inside = _growing(L, W, slack, sample_time)
    if boundary > inside:
        found = tuple(sorted(found, key=lambda s: -float(np.any(s == axis[rate == rate.min()]))))
    return HiddenModes(max(boundary, inside), found)


def _growing(L: Array, W: Array, slack: float, sample_time: float | None) -> float:
    """The Nevanlinna-Pick bound of the modes that grow: |R M⁻¹ R⁻¹| with X = R'R, M = Λ or (Λ - I)/T."""
    from scipy.linalg import schur, solve_triangular

    def grows(re: float, im: float = 0.0) -> bool:
        return (float(np.hypot(re, im)) - 1.0 if sample_time is not None else re) > slack

    T, Z, *count = schur(L, sort=grows)
    k = int(np.asarray(count[0]))
    if k == 0:
        return 0.0
    lam, w = T[:k, :k], W @ Z[:, :k]
    if sample_time is None:
        a = np.sqrt(np.abs(np.linalg.eigvals(lam)).prod() ** (1.0 / k) * spectral_norm(lam))
        shifted = np.linalg.inv(a * np.eye(k) + lam)  # Cayley: the same X for steps of a sampled model
        R, M = gramian_factor((a * np.eye(k) - lam) @ shifted, np.sqrt(2.0 * a) * w @ shifted), lam
    else:
        R, M = gramian_factor(np.linalg.inv(lam), w), (lam - np.eye(k)) / sample_time
    if np.abs(R.diagonal()).min() <= k * np.finfo(float).eps * spectral_norm(R):
        # Directions that the faulty outputs hardly see: each mode alone still binds.
        return float(1.0 / np.abs(np.linalg.eigvals(M)).min())
    middle = R @ np.linalg.inv(M)
    return spectral_norm(solve_triangular(R, middle.T, trans=1).T)


def gramian_factor(B: Array, W: Array) -> Array:
    """Upper triangular R with R'R = Σ (Bʲ)' W'W Bʲ, B (k, k) with all eigenvalues inside the unit circle, W (q, k).

    Doubled and compressed by QR without ever forming R'R: directions that W sees by less than √ε keep their digits.
    """
    k = B.shape[0]
    R: Array = np.asarray(np.linalg.qr(np.vstack([W, np.zeros((k, k))]), mode="r"))
    for _ in range(64):  # 2^64 steps: farther than a rate of rounding size reaches
        more = R @ B
        R = np.asarray(np.linalg.qr(np.vstack([R, more]), mode="r"))
        if np.linalg.norm(more) <= np.finfo(float).tiny + np.finfo(float).eps ** 2 * np.linalg.norm(R):
            break
        B = B @ B
    return R


def _complement(N: Array) -> Array:
    """Orthonormal basis of what is orthogonal to the columns of N."""
    if N.shape[1] == 0:
        return np.eye(N.shape[0])
    return np.linalg.qr(N, mode="complete")[0][:, N.shape[1] :]
