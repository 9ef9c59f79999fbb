# SPDX-License-Identifier: BSD-3-Clause
"""From differential equations to samples: exact holds, the reach of RK4, and noise that is constant for a while.

Measurement noise enters a real system once per sample and stays for h seconds; its effect on a state is finite and
computable, where that of "continuous white noise of variance s" has no meaning without h.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import Impossible, InputError
from faultrecon.numerics.scaling import scale_states, spectral_norm, state_scaling

Array = NDArray[Any]


def zoh(A: ArrayLike, B: ArrayLike, h: float) -> tuple[Array, Array]:
    """x[k+1] = Ad x[k] + Bd u[k], exact when u is held for h seconds.

    A: (n, n), B: (n, m).  One exponential of [[A, B], [0, 0]] h (Van Loan 1978), in balanced units.
    """
    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    n, m = B.shape
    E = _block_exponential(A, np.hstack([B, np.zeros((n, 0))]), np.zeros((m, m)), h)
    return E[:n, :n], E[:n, n:]


def foh(A: ArrayLike, B: ArrayLike, h: float) -> tuple[Array, Array, Array]:
    """x[k+1] = Ad x[k] + B0 u[k] + B1 u[k+1], exact when u runs in straight lines between samples.

    A: (n, n), B: (n, m).  One exponential of [[A, B, 0], [0, 0, I/h], [0, 0, 0]] h.
    """
    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    n, m = B.shape
    shift = np.zeros((2 * m, 2 * m))
    shift[:m, m:] = np.eye(m) / h
    E = _block_exponential(A, np.hstack([B, np.zeros((n, m))]), shift, h)
    return E[:n, :n], E[:n, n : n + m] - E[:n, n + m :], E[:n, n + m :]


def rk4_polynomial_limit(eigenvalues: ArrayLike) -> float:
    """The largest step for which classical RK4 does not amplify any of these decaying modes.

    eigenvalues: of a linear system, 1/s; those with Re >= 0 are left out.  |R(h s)| <= 1 for every step up to the
    returned one, R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24: 2.7853/|s| on the real axis, 2.8284/|s| next to the imaginary
    one.  inf when nothing decays.  The limit is for stability only; accuracy asks for less.
    """
    s = np.atleast_1d(np.asarray(eigenvalues)).astype(np.complex128)
    s = s[s.real < 0]
    if s.size == 0:
        return np.inf
    speed = np.abs(s)
    growth = _rk4_growth(s / speed)
    r = np.linspace(0.0, 3.4, 1701)  # outside |z| = 3.4 RK4 is unstable everywhere
    outside = np.stack([np.polyval(g[::-1], r) for g in growth]) > 1e-14
    first = np.argmax(outside, axis=1)
    low, high = r[np.maximum(first - 1, 0)], r[first]
    for _ in range(50):
        middle = 0.5 * (low + high)
        stable = np.array([np.polyval(g[::-1], x) for g, x in zip(growth, middle, strict=True)]) <= 0
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    return float(np.min(low / speed))


def van_loan_covariance(A: ArrayLike, B: ArrayLike, W: ArrayLike, h: float) -> tuple[Array, Array]:
    """Ad = e^(A h), and the covariance that white noise of intensity W adds in h seconds.

    The integral of e^(As) B W B' e^(A's) over 0..h; A: (n, n), B: (n, m), W: (m, m), noise squared times seconds.
    Van Loan's block exponential over a
    step short enough that e^(-A h) does not overflow, then doubled; the result is symmetric.
    """
    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    Q = B @ np.asarray(W, dtype=float) @ B.T
    n = A.shape[0]
    e = state_scaling(A, B, np.zeros((0, n)))
    t = np.ldexp(1.0, e)
    A = scale_states(A, B, np.zeros((0, n)), e)[0]
    Q = Q / np.outer(t, t)
    doublings = max(0, int(np.ceil(np.log2(max(2.0 * spectral_norm(A) * h, 1.0)))))
    step = h / 2**doublings
    from scipy.linalg import expm

    E = expm(np.block([[-A, Q], [np.zeros((n, n)), A.T]]) * step)
    Ad, P = E[n:, n:].T, E[n:, n:].T @ E[:n, n:]
    for _ in range(doublings):
        Ad, P = Ad @ Ad, P + Ad @ P @ Ad.T
    return Ad * np.outer(t, 1 / t), 0.5 * (P + P.T) * np.outer(t, t)


def held_noise_covariance(A: ArrayLike, B: ArrayLike, variances: ArrayLike, h: float) -> Array:
    """Stationary covariance of x' = A x + B v when each v_i is independent noise, constant for h seconds at a time.

    A: (n, n), B: (n, m), variances: (m,) of v, per sample.  Returns E[x x'] (n, n) at the sampling instants, from
    P = Ad P Ad' + Bd diag(variances) Bd'.  Raises Impossible when a mode does not decay, InputError for h <= 0 or a
    negative variance.
    """
    variances = np.asarray(variances, dtype=float)
    if not h > 0:
        raise InputError(f"the hold time is {h:g} s", why="noise is held for a positive time")
    if np.any(variances < 0):
        raise InputError("a noise variance is negative", evidence={"variances": variances.tolist()})
    Ad, Bd = zoh(A, B, h)
    _demand_decay(np.abs(np.linalg.eigvals(Ad)) < 1, "per sample")
    return discrete_covariance(Ad, (Bd * variances) @ Bd.T)


def continuous_covariance(A: ArrayLike, B: ArrayLike, W: ArrayLike) -> Array:
    """Stationary covariance of x' = A x + B v for white noise v of intensity W: A P + P A' + B W B' = 0.

    A: (n, n), B: (n, m), W: (m, m).  Raises Impossible when a mode does not decay.
    """
    from scipy.linalg import solve_continuous_lyapunov

    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    n = A.shape[0]
    if n == 0:
        return np.zeros((0, 0))
    poles = np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
    _demand_decay(poles.real < 0, "in time")
    e = state_scaling(A, B, np.zeros((0, n)))
    a, b, _ = scale_states(A, B, np.zeros((0, n)), e)
    P = solve_continuous_lyapunov(a, -(b @ np.asarray(W, dtype=float) @ b.T))
    t = np.ldexp(1.0, e)
    return 0.5 * (P + P.T) * np.outer(t, t)


def discrete_covariance(Ad: ArrayLike, Q: ArrayLike) -> Array:
    """P = Ad P Ad' + Q for a stable Ad: the sum of Ad^k Q Ad'^k, its length doubled until it no longer changes.

    Every term is positive semidefinite, so P is too.  Raises Impossible when |Ad^k| does not decay.
    """
    M, P = np.asarray(Ad, dtype=float), np.asarray(Q, dtype=float)
    for _ in range(64):  # 2^64 samples: a mode that lasts longer is not distinguishable from one that never decays
        added = M @ P @ M.T
        P = P + added
        if not np.isfinite(P).all():
            break
        if np.abs(added).max(initial=0.0) <= np.finfo(float).eps * np.abs(P).max(initial=0.0):
            return 0.5 * (P + P.T)
        M = M @ M
    raise Impossible("the noise has no stationary covariance", why="a mode it excites does not decay")


def _block_exponential(A: Array, B: Array, S: Array, h: float) -> Array:
    """exp([[A, B], [0, S]] h), computed in balanced state units."""
    from scipy.linalg import expm

    n, k = B.shape
    if not h >= 0:
        raise InputError(f"the step is {h:g} s", why="a step is not negative")
    e = state_scaling(A, B, np.zeros((0, n)))
    a, b, _ = scale_states(A, B, np.zeros((0, n)), e)
    E = expm(np.block([[a, b], [np.zeros((k, n)), S]]) * h)
    t = np.ldexp(1.0, e)
    E[:n] *= t[:, None]
    E[:, :n] /= t[None, :]
    return E


def _rk4_growth(direction: Array) -> list[Array]:
    """(|R(r z)|^2 - 1)/r as coefficients in r, lowest first, for each unit direction z."""
    taylor = np.array([1.0, 1.0, 1 / 2, 1 / 6, 1 / 24])
    found = []
    for z in direction:
        R = taylor * z ** np.arange(5)
        found.append(np.real(np.convolve(R, np.conj(R)))[1:])
    return found


def _demand_decay(decays: NDArray[np.bool_], what: str) -> None:
    if not decays.all():
        raise Impossible(
            "the noise has no stationary covariance",
            why=f"{int((~decays).sum())} of {decays.size} modes do not decay {what}",
            remedies=("stabilise the observer first",),
        )
