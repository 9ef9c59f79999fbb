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


ENOUGH = 1e-4
"""A lower bound of a relative distance beyond which a larger one would change nobody's mind."""


def distance_at_least(slow: SlowModes, N: Array | None = None) -> float:
    """A certain lower bound of `detectability_margin` for the outputs N C, 0 where this way finds none.

    With any L for which M = A - L C decays, M' P + P M = -I and x of unit length, |(sI - M) x| >= 1/(2 |P|) at every s
    in the region; and (sI - M) x is (sI - A) x and C x added up with weights 1 and L.  A, C at norm one.  L moves the
    slow modes alone, so that the Schur form of A serves for M: all of them to one place where the outputs see that many
    directions well, else by the Riccati equation; no search over s.
    """
    if slow.L.shape[0] == 0:
        return _without_outputs(slow)
    outputs = slow.C if N is None else N @ slow.C
    # Frobenius norms are the larger ones, so the distance in their units is the smaller one.
    a, c = (max(float(np.linalg.norm(M)), 1e-300) for M in (slow.A, outputs))
    C = outputs @ slow.Z / c
    placed = _placed(slow, a, C)
    return placed if placed >= ENOUGH else max(placed, _riccati(slow, a, C))


def _placed(slow: SlowModes, a: float, C: Array) -> float:
    """The bound with every slow mode at one s < 0, or at z = 0, in units in which |A| = 1; 0 where C hardly sees one.

    M = [s X; 0 T] in the Schur basis and P = [-1/(2s) Y; Y' R] with Y (T + s) = X/(2s), T'R + R T = -(I + X'Y + Y'X).
    That R is at most 1 + 2 |X| |Y| times the R of -I, which serves all choices of outputs.  Sampled, in units of the
    circle: P = [I 0; 0 R] and T'R T - R = -(I + X'X).
    """
    k = slow.L.shape[0]
    if C.shape[0] < k:
        return 0.0
    U, sigma, Vh = np.linalg.svd(C[:, :k], full_matrices=False)
    if sigma[-1] < ENOUGH:  # |L| is about 1/sigma, and the bound no more than 1/(2 |L|)
        return 0.0
    settling, s, back = _fast_part(slow)
    if not np.isfinite(settling):
        return 0.0
    L = ((slow.L / a - s * np.eye(k)) @ Vh.T / sigma) @ U.T
    X = slow.T[:k, k:] / a - L @ C[:, k:]
    x = float(np.linalg.norm(X))
    if slow.sampled:
        P = max(a, (1.0 + (a * x) ** 2) * settling)
    else:
        y = float(np.linalg.norm(X @ back)) / (2.0 * -s)
        P = float(np.sqrt(0.25 * k / s**2 + 2.0 * y**2 + ((1.0 + 2.0 * x * y) * settling) ** 2))
    return 1.0 / (2.0 * P * float(np.hypot(1.0, np.linalg.norm(L))))


@lru_cache(maxsize=8)
def _fast_part(slow: SlowModes) -> tuple[float, float, Array]:
    """What `_settling` says of the modes that decay, in units in which |A| = 1; the s at which it would say the same of
    one mode, 0 when sampled; and (T + s)^-1 of their Schur form."""
    k, a = slow.L.shape[0], max(float(np.linalg.norm(slow.A)), 1e-300)
    T = slow.T[k:, k:] / a
    settling = _settling(T, 1.0 / a if slow.sampled else None)
    s = 0.0 if slow.sampled else -1.0 / max(2.0 * settling, 1.0)
    return settling, s, np.zeros((0, 0)) if slow.sampled else np.linalg.inv(T + s * np.eye(len(T)))


def _riccati(slow: SlowModes, a: float, C: Array) -> float:
    """The bound with L from the Riccati equation of the slow modes, in units in which |A| = 1."""
    from scipy.linalg import schur

    T, k = slow.T / a, slow.L.shape[0]
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
