# SPDX-License-Identifier: BSD-3-Clause
"""Certain bounds without a search over s: what a Lyapunov equation says about a whole half plane at once."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.hamiltonian import StableSubspace, stable_subspace
from faultrecon.numerics.pencil import SlowModes
from faultrecon.numerics.scaling import spectral_norm

Array = NDArray[Any]


def distance_at_least(slow: SlowModes, N: Array | None = None) -> float:
    """A certain lower bound of `detectability_margin` for the outputs N C, 0 where this way finds none.

    With any L for which M = A - L C decays, M' P + P M = -I and x of unit length, |(sI - M) x| >= 1/(2 |P|) at every s
    in the region; and (sI - M) x is (sI - A) x and C x added up with weights 1 and L.  A, C at norm one.  L comes from
    the Riccati equation of the slow modes alone, so that the Schur form of A serves for M; no search over s.
    """
    from scipy.linalg import schur

    if slow.L.shape[0] == 0:
        return _without_outputs(slow)
    outputs = slow.C if N is None else N @ slow.C
    k = slow.L.shape[0]
    # Frobenius norms are the larger ones, so the distance in their units is the smaller one.
    a, c = (max(float(np.linalg.norm(M)), 1e-300) for M in (slow.A, outputs))
    T, C = slow.T / a, outputs @ slow.Z / c
    L = _injection(T[:k, :k], C[:, :k], slow.sampled)
    if L is None:
        return 0.0
    block, U = schur(T[:k, :k] - L @ C[:, :k])[:2]
    T[:k, k:] = U.T @ (T[:k, k:] - L @ C[:, k:])
    T[:k, :k] = block
    return 1.0 / (2.0 * _settling(T, 1.0 / a if slow.sampled else None) * float(np.hypot(1.0, np.linalg.norm(L))))


@lru_cache(maxsize=8)
def _without_outputs(slow: SlowModes) -> float:
    """The same for a model that decays by itself: L = 0, so no output matters."""
    a = max(float(np.linalg.norm(slow.A)), 1e-300)
    return 1.0 / (2.0 * _settling(slow.T / a, 1.0 / a if slow.sampled else None)) if slow.A.size else np.inf


def _injection(A: Array, C: Array, sampled: bool) -> Array | None:
    """L for which A - L C decays, from the filter Riccati equation with weights one; None where there is none."""
    from scipy.linalg import LinAlgError, solve_discrete_are

    if C.shape[0] == 0:
        return None
    if sampled:
        try:
            Y = np.asarray(solve_discrete_are(A.T, C.T, np.eye(A.shape[0]), np.eye(C.shape[0])))
            return np.linalg.solve(np.eye(C.shape[0]) + C @ Y @ C.T, C @ Y @ A.T).T
        except (LinAlgError, ValueError):
            return None
    found = stable_subspace(A.T, -C.T @ C, np.eye(A.shape[0]))
    if not isinstance(found, StableSubspace):
        return None
    try:
        return found.unit * np.linalg.solve(found.U1.T, found.U2.T).T @ C.T
    except np.linalg.LinAlgError:
        return None


def _settling(T: Array, circle: float | None) -> float:
    """|P| at most, for quasi-triangular T with T' P + P T = -I, inf unless P >= 0 shows that T decays.

    circle: T is per sample in units in which one is this long; then with the Stein equation.
    """
    from scipy.linalg import LinAlgError, get_lapack_funcs, solve_discrete_lyapunov

    if T.shape[0] == 0:
        return 0.0
    if circle is not None:
        if not np.abs(np.linalg.eigvals(T)).max() < circle:
            return np.inf
        try:
            P = np.asarray(solve_discrete_lyapunov((T / circle).T, np.eye(T.shape[0])))
        except (LinAlgError, ValueError):
            return np.inf
        return float(np.linalg.norm(P)) / circle
    if not np.diag(T).max() < 0:  # in the standard form the diagonal is the real parts
        return np.inf
    (trsyl,) = get_lapack_funcs(("trsyl",), (T,))
    P, scale, info = trsyl(T, T, -np.eye(T.shape[0]), trana=b"T", tranb=b"N")
    return float(np.linalg.norm(P)) / float(scale) if info == 0 and scale > 0 else np.inf


def resolvent_bound(A: Array) -> float:
    """A bound of |(jw - A)^-1| for every w, inf where none is found: the growing and the decaying part apart."""
    from scipy.linalg import LinAlgError, schur

    if A.shape[0] == 0:
        return 0.0
    try:
        T, _, *count = schur(A, sort=lambda re, im=0.0: re >= 0)
    except LinAlgError:  # an eigenvalue that reordering moved across the axis
        return np.inf
    k = int(np.asarray(count[0]))
    # Reversing rows and columns of a transposed triangular matrix leaves it triangular.
    grows, decays = 2 * _settling(-T[:k, :k][::-1, ::-1].T, None), 2 * _settling(T[k:, k:], None)
    return grows + decays + grows * decays * spectral_norm(T[:k, k:])
