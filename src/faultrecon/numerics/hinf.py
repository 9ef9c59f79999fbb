# SPDX-License-Identifier: BSD-3-Clause
"""Peak gains over frequency, and the level below which no estimator can go.

Both are found the same way (Bruinsma and Steinbuch 1990): guess a peak from a grid, ask a Hamiltonian or a pencil at
which frequencies the gain crosses a slightly higher level, evaluate between the crossings, repeat until there are
none.  What is returned is always a gain evaluated at a frequency, never an extrapolation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.numerics.pencil import RANK_TOLERANCE, invariant_zeros
from faultrecon.numerics.scaling import scale_states, spectral_norm, state_scaling

Array = NDArray[Any]
Complex = NDArray[np.complexfloating[Any, Any]]
Gain = Callable[[Array], Array]

ON_AXIS = 1e-6
"""An eigenvalue this near the imaginary axis (relative) is tried as a crossing: a false one costs one evaluation."""


@dataclass(frozen=True, slots=True)
class Peak:
    """The largest gain found and the frequency (rad/s, may be inf) at which it was evaluated."""

    value: float
    frequency: float


def frequency_response(A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, w: ArrayLike) -> Complex:
    """C (jw - A)^-1 B + D at every frequency w (rad/s): (k, p, m).  w = inf gives D.

    A frequency that is exactly a pole of A gives entries that are infinite or nan.
    """
    A, B, C, D = (np.asarray(M, dtype=float) for M in (A, B, C, D))
    w = np.atleast_1d(np.asarray(w, dtype=float))
    G = np.broadcast_to(D.astype(np.complex128), (w.size, *D.shape)).copy()
    finite = np.isfinite(w)
    if A.shape[0] and B.shape[1] and C.shape[0] and finite.any():
        with np.errstate(invalid="ignore", over="ignore"):
            for part in _portions(np.flatnonzero(finite), A.shape[0]):
                G[part] += C @ _resolvent(A, B, w[part])
    return G


def _portions(indices: NDArray[np.intp], n: int) -> list[NDArray[np.intp]]:
    """The indices in turns of which each fills about a megabyte with (n, n) matrices: a thousand at once, at n = 160,
    would spend more time on fetching memory than on arithmetic."""
    at_once = max(1, 2**16 // max(n * n, 1))
    return [indices[k : k + at_once] for k in range(0, indices.size, at_once)]


def hinf_norm(A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, *, rtol: float = 1e-9) -> Peak:
    """Largest singular value of C (sI - A)^-1 B + D over the imaginary axis; inf when A is not stable.

    The value is the gain at the returned frequency; the true norm exceeds it by at most about 2 rtol (relative).
    An unstable or undamped A gives Peak(inf, |Im| of that eigenvalue), even if B or C does not touch it.
    """
    A, B, C, D = (np.asarray(M, dtype=float) for M in (A, B, C, D))
    if 0 in D.shape:
        return Peak(0.0, 0.0)
    if A.shape[0] == 0:
        return Peak(spectral_norm(D), 0.0)
    A, B, C = scale_states(A, B, C, state_scaling(A, B, C))
    poles = np.linalg.eigvals(A).astype(np.complex128)
    worst = poles[int(np.argmax(poles.real))]
    if worst.real >= 0:
        return Peak(np.inf, float(abs(worst.imag)))

    def gain(w: Array) -> Array:
        return np.linalg.norm(frequency_response(A, B, C, D, w), 2, axis=(1, 2))

    def crossings(level: float) -> Array:
        """Frequencies at which `level` is a singular value: imaginary eigenvalues of the Hamiltonian."""
        R = level**2 * np.eye(D.shape[1]) - D.T @ D
        closed = A + B @ np.linalg.solve(R, D.T @ C)
        S = B @ np.linalg.solve(R, B.T)
        Q = C.T @ C + C.T @ D @ np.linalg.solve(R, D.T @ C)
        t = np.sqrt(max(spectral_norm(Q), 1e-300) / max(spectral_norm(S), 1e-300))
        return on_axis(np.linalg.eigvals(np.block([[closed, S * t], [-Q / t, -closed.T]])))

    return _climb(gain, crossings, frequency_grid(poles, 12), rtol)


def estimator_floor(
    A: ArrayLike, B: ArrayLike, C1: ArrayLike, E1: ArrayLike, C2: ArrayLike, E2: ArrayLike, *, rtol: float = 1e-9
) -> Peak:
    """The gain from disturbance to fault error that no linear estimator of the faults can beat.

    x' = A x + B w, healthy outputs y1 = C1 x + E1 w, faulty outputs y2 = C2 x + E2 w + f.  An estimator that
    passes f with unit gain is y2 - K y1; at each frequency the best K leaves |Y2 (I - Y1^+ Y1)|, with
    Yi = Ci (jw-A)^-1 B + Ei, and the floor is the supremum over w.  A: (n, n), B: (n, l), C1: (p1, n), p1 may
    be 0 (then it is sup |Y2|), C2: (q, n).

    The value is a lower bound, evaluated at the returned frequency; one at which rounding could inflate it by more than
    1e-6 is left out (next to a pole on the imaginary axis, say).  Where the supremum is infinite the
    value is merely very large.
    """
    A, B, C1, E1, C2, E2 = (np.asarray(M, dtype=float) for M in (A, B, C1, E1, C2, E2))
    if B.shape[1] == 0 or C2.shape[0] == 0:
        return Peak(0.0, 0.0)
    C, E = np.vstack([C1, C2]), np.vstack([E1, E2])
    A, B, C = scale_states(A, B, C, state_scaling(A, B, C))
    C1, C2 = C[: C1.shape[0]], C[C1.shape[0] :]

    def gain(w: Array) -> Array:
        Y = frequency_response(A, B, C, E, w)
        return unexplained(Y[:, : C1.shape[0]], Y[:, C1.shape[0] :], sensitivity(A, w))

    def crossings(level: float) -> Array:
        return _floor_crossings(A, B, C1, E1, C2, E2, level)

    poles = np.linalg.eigvals(A).astype(np.complex128)
    zeros = invariant_zeros(A, B, C1, E1)
    return _climb(gain, crossings, frequency_grid(np.concatenate([poles, zeros]), 40), rtol)


def imitated(A: Array, B: Array, C: Array, E: Array, Ef: Array, Ff: Array, s: complex) -> float:
    """The largest fault that disturbances of size one imitate at s: no estimator that follows faults there does better.

    Over all x, w, f with (sI - A) x = B w + Ef f and C x + E w + Ff f = 0, the supremum of |f|/|w|; inf when a fault
    hides without any disturbance.  A (n, n), B (n, m), C (p, n), E (p, m), Ef (n, q), Ff (p, q); s may be a pole of A.
    """
    A, B, C, E, Ef, Ff = (np.asarray(M, dtype=float) for M in (A, B, C, E, Ef, Ff))
    n, m = B.shape
    A, both, C = scale_states(A, np.hstack([B, Ef]), C, state_scaling(A, np.hstack([B, Ef]), C))
    reach = np.linalg.norm(np.vstack([both, np.hstack([E, Ff])]), axis=0)
    reach = np.where(reach > 0, reach, 1.0)
    top = np.hstack([s * np.eye(n) - A, -both / reach])
    bottom = np.hstack([C, np.hstack([E, Ff]) / reach])
    rows = [M / np.maximum(np.linalg.norm(M, axis=1, keepdims=True), 1e-300) for M in (top, bottom)]
    _, sigma, Vh = np.linalg.svd(np.vstack(rows))
    null = Vh[int(np.count_nonzero(sigma > RANK_TOLERANCE * sigma.max(initial=0.0))) :].conj().T
    w, f = null[n : n + m] / reach[:m, None], null[n + m :] / reach[m:, None]
    if f.shape[1] == 0 or not f.any():
        return 0.0
    _, size, Wh = np.linalg.svd(w)
    known = int(np.count_nonzero(size > RANK_TOLERANCE * size.max(initial=0.0)))
    if spectral_norm(f @ Wh[known:].conj().T) > 1e-8 * spectral_norm(f):
        return float("inf")
    return spectral_norm(f @ Wh[:known].conj().T / size[:known])


def _floor_crossings(A: Array, B: Array, C1: Array, E1: Array, C2: Array, E2: Array, level: float) -> Array:
    """Stationary points of |C2 x + E2 w|^2 - level^2 |w|^2 on the solutions that healthy outputs do not show."""
    from scipy.linalg import LinAlgError, eigvals

    n, m, p1, q = *B.shape, C1.shape[0], C2.shape[0]
    Z = np.zeros
    # fmt: off
    M = np.block([                                      # unknowns x, lambda, w, mu, v with v = (C2 x + E2 w)/level
        [A,          Z((n, n)),  B,                 Z((n, p1)),  Z((n, q))],
        [Z((n, n)),  -A.T,       Z((n, m)),         C1.T,        C2.T],
        [Z((m, n)),  -B.T,       -level * np.eye(m), E1.T,       E2.T],
        [C1,         Z((p1, n)), E1,                Z((p1, p1)), Z((p1, q))],
        [C2,         Z((q, n)),  E2,                Z((q, p1)),  -level * np.eye(q)],
    ])
    # fmt: on
    J = Z(M.shape)
    J[: 2 * n, : 2 * n] = np.eye(2 * n)
    try:
        return on_axis(eigvals(M, J))
    except (LinAlgError, ValueError):
        return np.zeros(0)


def _resolvent(A: Array, B: Array, w: Array) -> Complex:
    """(jw - A)^-1 B for every w, infinite where A has that pole."""
    n = A.shape[0]
    stack = 1j * w[:, None, None] * np.eye(n) - A
    try:
        return np.linalg.solve(stack, np.broadcast_to(B.astype(np.complex128), (w.size, *B.shape)))
    except np.linalg.LinAlgError:
        X = np.full((w.size, *B.shape), complex(np.inf), dtype=complex)
        for k in range(w.size):
            try:
                X[k] = np.linalg.solve(stack[k], B)
            except np.linalg.LinAlgError:
                continue
        return X


def sensitivity(A: Array, w: Array) -> Array:
    """Relative rounding error to expect in the response at each w: eps times the condition of jw - A."""
    n = A.shape[0]
    if n == 0:
        return np.full(w.size, np.finfo(float).eps)
    condition = np.empty(w.size)
    for part in _portions(np.arange(w.size), n):
        s = 1j * np.where(np.isfinite(w[part]), w[part], 0.0)
        sigma = np.linalg.svd(s[:, None, None] * np.eye(n) - A, compute_uv=False)
        condition[part] = sigma[:, 0] / np.maximum(sigma[:, -1], 1e-300)
    return np.finfo(float).eps * np.where(np.isfinite(w), condition, 1.0)


def unexplained(Y1: Complex, Y2: Complex, rounding: Array) -> Array:
    """|Y2 (I - Y1^+ Y1)| at each frequency; 0 where it cannot be trusted to six digits."""
    usable = np.asarray(np.all(np.isfinite(Y1), axis=(1, 2)) & np.all(np.isfinite(Y2), axis=(1, 2)))
    trusted = usable[:, None, None]
    Y1, Y2 = np.where(trusted, Y1, 0.0), np.where(trusted, Y2, 0.0)
    size = np.linalg.norm(Y2, 2, axis=(1, 2))
    if Y1.shape[1] == 0:
        return np.where(usable & (rounding < 1e-6), size, 0.0)
    rows = np.linalg.norm(Y1, axis=2, keepdims=True)  # the null space of Y1 does not depend on the units of its rows
    _, sigma, Vh = np.linalg.svd(Y1 / np.where(rows > 0, rows, 1.0), full_matrices=False)
    # A direction counts as explained unless it is rounding noise: that errs to the low side, and a bound must.
    kept = sigma > 1e-13 * Y1.shape[2]
    explained = np.where(kept[:, :, None], Vh, 0.0)
    left = Y2 - (Y2 @ explained.conj().transpose(0, 2, 1)) @ explained
    value = np.linalg.norm(left, 2, axis=(1, 2))
    smallest = np.min(np.where(kept, sigma, 1.0), axis=1)
    return np.where(usable & (rounding * size / smallest < 1e-6 * value), value, 0.0)


def on_axis(eigenvalues: Any) -> Array:
    """Frequencies of the eigenvalues on, or within rounding of, the imaginary axis."""
    s = np.asarray(eigenvalues).astype(np.complex128)
    s = s[np.isfinite(s)]
    reach = ON_AXIS * np.maximum(np.abs(s), 1e-12 * np.max(np.abs(s), initial=0.0))
    return np.unique(np.abs(s.imag[np.abs(s.real) <= reach]))


def frequency_grid(points: Complex, per_decade: int) -> Array:
    """Frequencies where something may happen: 0, infinity, a logarithmic grid, and the flank of every pole or zero."""
    size = np.abs(points)
    size = size[(size > 1e-12 * size.max(initial=1.0)) & (size < 1e12)]
    low, high = (size.min() / 30, size.max() * 30) if size.size else (1e-3, 1e3)
    count = int(np.clip(per_decade * np.log10(high / low), 16, 600))
    flanks = np.abs(points.imag)[:, None] + np.abs(points.real)[:, None] * np.array([-1.0, -0.3, 0.0, 0.3, 1.0])
    near_axis = np.abs(points.imag)[:, None] * (1 + np.array([-1e-3, 1e-3]))
    w = np.concatenate([[0.0, np.inf], np.geomspace(low, high, count), flanks.ravel(), near_axis.ravel()])
    return np.unique(w[(w >= 0)])


def _climb(gain: Gain, crossings: Callable[[float], Array], w: Array, rtol: float) -> Peak:
    """From the best of a grid to the global peak: refine locally, then look between the crossings of a higher level."""
    values = gain(w)
    best = _refine(gain, w, values)
    for _ in range(30):
        if best.value <= 0 or not np.isfinite(best.value):
            break
        crossed = crossings(best.value * (1 + 2 * rtol))
        if crossed.size == 0:
            break
        middle = np.sqrt(crossed[1:] * crossed[:-1]) if crossed.size > 1 else np.zeros(0)
        trial = np.unique(np.concatenate([crossed, middle, 0.5 * (crossed[1:] + crossed[:-1])]))
        values = gain(trial)
        k = int(np.argmax(values))
        if not values[k] > best.value * (1 + rtol):
            break
        best = _refine(gain, trial, values)
    return best


def _refine(gain: Gain, w: Array, values: Array) -> Peak:
    """Golden-section search around the four highest local maxima of the grid, all at once."""
    k = int(np.argmax(values))
    best = Peak(float(values[k]), float(w[k]))
    finite = np.isfinite(w)
    w, values = w[finite], values[finite]
    if w.size < 3:
        return best
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
    peaks = peaks[np.argsort(values[peaks])[-4:]]
    a, b = w[np.maximum(peaks - 1, 0)], w[np.minimum(peaks + 1, w.size - 1)]
    ratio = (np.sqrt(5.0) - 1) / 2
    for _ in range(42):  # 0.618^42 = 2e-9 of the interval; the gain is flat to the square of that
        c, d = b - ratio * (b - a), a + ratio * (b - a)
        both = gain(np.concatenate([c, d]))
        k = int(np.argmax(both))
        if both[k] > best.value:
            best = Peak(float(both[k]), float(np.concatenate([c, d])[k]))
        left = both[: c.size] >= both[c.size :]
        a, b = np.where(left, a, c), np.where(left, d, b)
    return best
