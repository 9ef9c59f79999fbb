# SPDX-License-Identifier: BSD-3-Clause
"""Observer gains from one Riccati equation, without a semidefinite solver.

The gain L of  e' = (A - L C1) e + (B1 - L D21) v,  z = Cz e + D11 v  that makes |v -> z| < 1, when there is one, is the
central gain of a filter Riccati equation; a Lipschitz nonlinearity is one more channel, scaled by its multiplier beta.
Khosrowjerdi 2011, Theorem 3.1, in the equivalent form of a filter problem.  `optimal_level` finds the smallest level.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import Inconclusive
from faultrecon.numerics.hamiltonian import StableSubspace, signs, stable_subspace
from faultrecon.numerics.hinf import hinf_norm
from faultrecon.numerics.level import LevelSolution, full_row_rank, optimal_level
from faultrecon.numerics.pencil import RANK_TOLERANCE, unobservable_subspace
from faultrecon.numerics.scaling import scale_states, spectral_norm, state_scaling

__all__ = ["FilterSolution", "LevelSolution", "central_gain", "filter_riccati", "full_row_rank", "optimal_level"]

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class FilterSolution:
    """Q >= 0 (n, n) of the filter equation, the central gain L (n, p1), and P > 0 (n, n) with the same closed loop.

    P is Q^-1 when Q is positive.  Where Q is singular (a state that nothing disturbs) P solves the inequality of the
    closed loop with a little noise added to every state; P is None when even the smallest such noise breaks it.
    """

    Q: Array
    L: Array
    P: Array | None


def filter_riccati(
    A: ArrayLike, B1: ArrayLike, C1: ArrayLike, D21: ArrayLike, Cz: ArrayLike, D11: ArrayLike
) -> FilterSolution | None:
    """The central gain of the H-infinity filter with level 1, or None when no gain reaches it.

    A: (n, n), B1: (n, k), C1: (p1, n), D21: (p1, k) of full row rank, Cz: (r, n), D11: (r, k); p1 = 0 is the bounded
    real test of A itself.  Accepted only when Q >= 0 stabilises and the closed loop's gain, computed anew, is below
    1 + 1e-6.  Raises Inconclusive when D21 lacks row rank: the equation then does not exist.
    """
    A, B1, C1, D21, Cz, D11 = (np.asarray(M, dtype=float) for M in (A, B1, C1, D21, Cz, D11))
    _demand_noise(D21)
    if spectral_norm(D11) >= 1:
        return None
    e = state_scaling(A, B1, np.vstack([C1, Cz]))
    a, b, c = scale_states(A, B1, np.vstack([C1, Cz]), e)
    t = np.ldexp(1.0, e)
    Q, L = _central(a, b, c[: C1.shape[0]], D21, c[C1.shape[0] :], D11)
    if Q is None or L is None:
        return None
    Q, L = Q * np.outer(t, t), t[:, None] * L
    closed = A - L @ C1
    if hinf_norm(closed, B1 - L @ D21, Cz, D11, rtol=1e-8).value > 1 + 1e-6:
        return None
    return FilterSolution(Q, L, _certificate(Q, t, closed, B1 - L @ D21, Cz, D11))


def central_gain(
    A: ArrayLike,
    Bphi: ArrayLike,
    B: ArrayLike,
    C1: ArrayLike,
    E1: ArrayLike,
    H1: ArrayLike,
    H2: ArrayLike,
    G: ArrayLike,
    alpha: float,
    beta: float | None,
    gamma: float,
) -> FilterSolution | None:
    """The central gain of the Lipschitz filter problem at a given (beta, gamma), or None when there is none.

    Arguments as for `optimal_level`; beta is None only without a nonlinearity (m = 0 or alpha = 0).  The returned P
    satisfies the matrix inequality with Z = P L, up to its boundary.
    """
    return filter_riccati(*_weighted(A, Bphi, B, C1, E1, H1, H2, G, alpha, beta, gamma))


def strict_multiplier(
    A: ArrayLike,
    Bphi: ArrayLike,
    B: ArrayLike,
    C1: ArrayLike,
    E1: ArrayLike,
    H1: ArrayLike,
    H2: ArrayLike,
    G: ArrayLike,
    alpha: float,
    beta: float | None,
    gamma: float,
    L: ArrayLike,
) -> Array | None:
    """P > 0 that satisfies the matrix inequality strictly for a given gain, or None when none was found.

    The Riccati equation of the closed loop with as much extra noise on every state as the level bears: the P of a
    central gain solves its own equation, which is the boundary of the inequality.
    """
    A, B1, C1, D21, Cz, D11 = _weighted(A, Bphi, B, C1, E1, H1, H2, G, alpha, beta, gamma)
    L = np.asarray(L, dtype=float)
    closed, into = A - L @ C1, B1 - L @ D21
    return _noisy_multiplier(np.ldexp(1.0, state_scaling(closed, into, Cz)), closed, into, Cz, D11)


def _weighted(
    A: Any,
    Bphi: Any,
    B: Any,
    C1: Any,
    E1: Any,
    H1: Any,
    H2: Any,
    G: Any,
    alpha: float,
    beta: float | None,
    gamma: float,
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """A, B1, C1, D21, Cz, D11 of the level-1 filter problem at (beta, gamma)."""
    A, Bphi, B, C1, E1, H1, H2, G = (np.asarray(M, dtype=float) for M in (A, Bphi, B, C1, E1, H1, H2, G))
    if beta is None:
        Bphi, G, beta = Bphi[:, :0], G[:0], 1.0
    m, k, root = Bphi.shape[1], G.shape[0], float(np.sqrt(beta))
    B1 = np.hstack([Bphi / root, B / gamma])
    D21 = np.hstack([np.zeros((E1.shape[0], m)), E1 / gamma])
    Cz = np.vstack([H1, alpha * root * G])
    D11 = np.zeros((H1.shape[0] + k, m + B.shape[1]))
    D11[: H1.shape[0], m:] = H2 / gamma
    return A, B1, C1, D21, Cz, D11


def _central(A: Array, B1: Array, C1: Array, D21: Array, Cz: Array, D11: Array) -> tuple[Array | None, Array | None]:
    """Q and L of the filter equation in the given units; (None, None) when there is no stabilising Q >= 0."""
    n = A.shape[0]
    S = np.linalg.inv(np.eye(D11.shape[1]) - D11.T @ D11)
    R = np.linalg.inv(np.eye(D11.shape[0]) - D11 @ D11.T)
    K = B1 @ S @ D21.T
    W = np.linalg.inv(D21 @ S @ D21.T)
    Ct = C1 + D21 @ D11.T @ R @ Cz
    At = A + B1 @ D11.T @ R @ Cz - K @ W @ Ct
    # Th = B1 S B1' - K W K' as a square, so that it is exactly zero where nothing is left to disturb the estimate.
    F = np.linalg.cholesky(S)
    unseen = B1 @ F @ np.linalg.qr((D21 @ F).T, mode="complete")[0][:, D21.shape[0] :]
    Th = unseen @ unseen.T
    Ga = Cz.T @ R @ Cz - Ct.T @ W @ Ct
    if n == 0:
        return np.zeros((0, 0)), np.zeros((0, C1.shape[0]))
    found = stable_subspace(At.T, 0.5 * (Ga + Ga.T), 0.5 * (Th + Th.T))
    if not isinstance(found, StableSubspace) or signs(found)[0][0] < -found.slack:
        return None, None
    try:
        Q = found.unit * np.linalg.solve(found.U1.T, found.U2.T).T
    except np.linalg.LinAlgError:
        return None, None
    Q = 0.5 * (Q + Q.T)
    L = (Q @ Ct.T + K) @ W
    return (Q, L) if np.isfinite(L).all() else (None, None)


def _certificate(Q: Array, t: Array, A: Array, B: Array, C: Array, D: Array) -> Array | None:
    """P > 0 for the bounded real inequality of the closed loop: Q^-1, or that with noise added to every state."""
    undisturbed = unobservable_subspace(A.T, B.T, RANK_TOLERANCE).shape[1] > 0
    if not undisturbed and _definite(Q, t):
        return _inverse(Q, t)
    return _noisy_multiplier(t, A, B, C, D)


def _noisy_multiplier(t: Array, A: Array, B: Array, C: Array, D: Array) -> Array | None:
    """P of the closed loop with noise on every state, in the units t."""
    none = np.zeros((0, A.shape[0]))
    a, b, c = A * (t[None, :] / t[:, None]), B / t[:, None], C * t[None, :]
    size = max(spectral_norm(b), 1e-3 * spectral_norm(a))
    for share in np.geomspace(1e-2, 1e-9, 8):  # the most that the margin bears gives the best conditioned P
        noisy = np.hstack([b, share * size * np.eye(A.shape[0])])
        wide = np.hstack([D, np.zeros((D.shape[0], A.shape[0]))])
        X, _ = _central(a, noisy, none, np.zeros((0, noisy.shape[1])), c, wide)
        if X is not None and _definite(X, np.ones(A.shape[0])):
            return _inverse(X * np.outer(t, t), t)
    return None


def _definite(Q: Array, t: Array) -> bool:
    """Whether Q is positive clear of rounding, in balanced units."""
    value = np.linalg.eigvalsh(Q / np.outer(t, t))
    return bool(value.size == 0 or value[0] > 1e-10 * value[-1])


def _inverse(Q: Array, t: Array) -> Array:
    P = np.linalg.inv(Q / np.outer(t, t))
    return 0.5 * (P + P.T) / np.outer(t, t)


def _demand_noise(D21: Array) -> None:
    if not full_row_rank(D21):
        raise Inconclusive(
            "the Riccati route does not apply",
            why="some combination of the healthy outputs carries no noise (E1 lacks row rank)",
            remedies=("solve the linear matrix inequality instead", "declare noise on every healthy sensor"),
        )
