# SPDX-License-Identifier: BSD-3-Clause
"""Which modes the sensors cannot see, how nearly that happens, and where a transfer matrix loses rank.

All decisions are made by orthogonal deflation (staircases of singular value decompositions) on a model in balanced
units, never by counting ranks at computed eigenvalues: an eigenvalue of a Jordan block of size k is only known to
eps^(1/k), and a rank test there misses exactly the modes that matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.numerics.scaling import scale_states, spectral_norm, state_scaling

Array = NDArray[Any]
Complex = NDArray[np.complexfloating[Any, Any]]

RANK_TOLERANCE = 1e-11
"""Relative to the norm of the balanced model: 1e5 roundings above eps, far below anything typed by hand."""

SCATTER = 1e-3
"""Relative to the model: how far rounding may scatter the eigenvalues of a Jordan block of up to five, eps^(1/5)."""


@dataclass(frozen=True, slots=True)
class Mode:
    """A mode A v = s v and how far the sensors are from missing it.

    value: s in 1/s (or the multiplier per sample).  direction: v (n,), unit length, largest entry real and positive.
    distance: smallest relative change of A and C that hides it exactly, sigma_min([(sI-A)/|A|; C/|C|]), balanced units.
    """

    value: complex
    direction: Complex
    distance: float


def unobservable_modes(A: ArrayLike, C: ArrayLike, *, tol: float = RANK_TOLERANCE) -> list[Mode]:
    """Modes of A that no row of C can see, each with the state direction it lives in.

    A: (n, n), C: (p, n), p may be 0.  Returns every s with A v = s v and C v = 0 (PBH test, Hautus 1969), one Mode per
    independent direction v, right-most first; a complex pair gives two.  Eigenvalues that rounding cannot tell apart
    are replaced by their mean.  Measuring a state in other units changes only the units of the direction.
    """
    A, C, unit = _balanced(np.asarray(A, dtype=float), np.asarray(C, dtype=float))
    return _modes_within(A, C, unit, A, np.eye(A.shape[0]), tol)


def _modes_within(A: Array, C: Array, unit: Array, L: Array, V: Array, tol: float) -> list[Mode]:
    """The unobservable modes of balanced (A, C) within the invariant subspace V, A V = V L."""
    weights = _weights(A, C)
    N = unobservable_subspace(L, C @ V, tol, sizes=weights)
    found = sorted(eigendirections(N.T @ L @ N), key=lambda pair: (-pair[0].real, -pair[0].imag))
    # At a real s all is real, at half the price.
    distances = [_smallest_singular(A, C, np.array([s if s.imag else s.real]), weights)[0] for s, _ in found]
    return [Mode(s, _normalised(unit * (V @ (N @ y))), float(d)) for (s, y), d in zip(found, distances, strict=True)]


def undetectable_modes(A: ArrayLike, C: ArrayLike, *, sampled: bool = False, tol: float = RANK_TOLERANCE) -> list[Mode]:
    """Unobservable modes that do not decay: with one of them no observer driven by C converges.

    Re s >= 0, or |s| >= 1 when `sampled`; a mode on the boundary counts, up to the rounding of its eigenvalue.
    """
    return SlowModes.of(A, C, sampled=sampled).undetectable(tol=tol)


@dataclass(frozen=True, eq=False)
class SlowModes:
    """A model in balanced units with the invariant subspace that decides detectability: A V = V L.

    Factored once, asked for many choices of outputs.  T, Z: the whole Schur form, L = T[:k, :k] and V = Z[:, :k].
    size: |A|.
    """

    A: Array
    C: Array
    unit: Array
    T: Array
    Z: Array
    L: Array
    V: Array
    sampled: bool
    size: float

    @classmethod
    def of(cls, A: ArrayLike, C: ArrayLike, *, sampled: bool = False) -> SlowModes:
        """From A (n, n) and every output C (p, n) there may be."""
        A, C = np.asarray(A, dtype=float), np.asarray(C, dtype=float)
        return _slow_modes(A.shape[0], A.tobytes(), C.shape[0], C.tobytes(), sampled)

    def undetectable(self, N: Array | None = None, *, tol: float = RANK_TOLERANCE) -> list[Mode]:
        """As `undetectable_modes`, for the outputs N C; N: (k, p), all of C by default."""
        if self.L.shape[0] == 0:
            return []
        C = self.C if N is None else N @ self.C
        slack = 64 * np.finfo(float).eps * self.A.shape[0] * self.size
        growth = (lambda s: abs(s) - 1.0) if self.sampled else (lambda s: s.real)
        # The Frobenius norm is quick and the larger one: what is seen by its measure is seen.
        if not unobservable_subspace(self.L, C @ self.V, tol, sizes=(self.size, float(np.linalg.norm(C)))).size:
            return []
        modes = _modes_within(self.A, C, self.unit, self.L, self.V, tol)
        return [mode for mode in modes if growth(mode.value) >= -slack]


@lru_cache(maxsize=8)
def _slow_modes(n: int, A_: bytes, p: int, C_: bytes, sampled: bool) -> SlowModes:
    """By content: diagnosis and methods ask about one model in turn."""
    A, C, unit = _balanced(np.frombuffer(A_).reshape(n, n), np.frombuffer(C_).reshape(p, n))
    size = spectral_norm(A)
    T, Z, k = _slow_first(A, size, sampled=sampled)
    return SlowModes(A, C, unit, T, Z, T[:k, :k], Z[:, :k], sampled, size)


def slow_part(A: Array, *, sampled: bool = False) -> tuple[Array, Array]:
    """L (k, k) and orthonormal V (n, k) with A V = V L: every mode that does not decay, and those that hardly do.

    A deflation over the whole space multiplies its rounding by one small singular value per step; fast modes cannot
    matter and are left out first.  The generous split keeps the scattered eigenvalues of a Jordan block together.
    """
    T, Z, k = _slow_first(A, spectral_norm(A), sampled=sampled)
    return T[:k, :k], Z[:, :k]


def _slow_first(A: Array, size: float, *, sampled: bool) -> tuple[Array, Array, int]:
    """The real Schur form T, Z of A with the k modes of `slow_part` first; size: |A|."""
    from scipy.linalg import LinAlgError, schur

    if A.shape[0] == 0:
        return A, A, 0
    split = SCATTER * max(size, 1e-300)

    def slow(re: float, im: float = 0.0) -> bool:
        return (float(np.hypot(re, im)) - 1.0 if sampled else re) >= -split

    try:
        T, Z, *count = schur(A, sort=slow)
    except LinAlgError:  # an eigenvalue that reordering moved across the split: then all of them count as slow
        return *schur(A)[:2], A.shape[0]
    return T, Z, int(np.asarray(count[0]))


def detectability_margin(A: ArrayLike, C: ArrayLike, *, sampled: bool = False) -> float:
    """By how small a relative change of the model a mode that does not decay could hide from the sensors.

    The smallest value found of sigma_min([(sI - A)/|A|; C/|C|]), in balanced units, over s with Re s >= 0 (|s| >= 1
    when `sampled`): candidates are the boundary, searched on a grid, and the eigenvalues of A moved into the region,
    the best few followed downhill.  Zero: undetectable.  1e-6: holds by a hair.  An upper bound of the distance.
    """
    return nearest_undetectable(A, C, sampled=sampled)[0]


def nearest_undetectable(A: ArrayLike, C: ArrayLike, *, sampled: bool = False) -> tuple[float, complex]:
    """`detectability_margin` and the s, Im s >= 0, at which it was found."""
    A, C, _ = _balanced(np.asarray(A, dtype=float), np.asarray(C, dtype=float))
    value, s = _nearest(A, C, _weights(A, C), sampled)
    return value, complex(s.real, abs(s.imag))


def distance_to_undetectability(A: ArrayLike, C: ArrayLike, *, sampled: bool = False) -> tuple[float, complex]:
    """The smallest sigma_min([sI - A; C]) found over s with Re s >= 0 (|s| >= 1 when `sampled`), and that s, Im s >= 0.

    In the units as given, as the literature tabulates it; `detectability_margin` is the same in balanced units.
    """
    A, C = np.asarray(A, dtype=float), np.asarray(C, dtype=float)
    value, s = _nearest(A, C, (1.0, 1.0), sampled)
    return value, complex(s.real, abs(s.imag))


def _weights(A: Array, C: Array) -> tuple[float, float]:
    return max(spectral_norm(A), 1e-300), max(spectral_norm(C), 1e-300)


def _nearest(A: Array, C: Array, weights: tuple[float, float], sampled: bool) -> tuple[float, complex]:
    """Where in the region of modes that do not decay the sensors are nearest to missing one, and by how much."""
    if A.shape[0] == 0:
        return np.inf, 0j

    def inside(s: Complex) -> Complex:
        if sampled:
            return s * np.maximum(1.0, 1.0 / np.maximum(np.abs(s), 1e-300))
        return np.maximum(s.real, 0.0) + 1j * s.imag

    poles = np.linalg.eigvals(A).astype(np.complex128)
    radius = max(spectral_norm(A), 1e-300)
    if sampled:
        boundary = np.exp(1j * np.linspace(0.0, np.pi, 121))
    else:
        smallest = np.abs(poles)[np.abs(poles) > 1e-12 * radius].min(initial=radius)
        boundary = 1j * np.concatenate([[0.0], np.geomspace(0.1 * smallest, 2.0 * radius, 120)])
    s = inside(np.concatenate([poles[poles.imag >= 0], 1j * np.abs(poles.imag) if not sampled else [], boundary]))
    value = _smallest_singular(A, C, s, weights)
    best = np.argsort(value)[:4]
    found = [_downhill(A, C, complex(s[k]), float(value[k]), inside, weights) for k in best]
    return min(found, key=lambda pair: pair[0])


def invariant_zeros(A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, *, tol: float = RANK_TOLERANCE) -> Complex:
    """Frequencies s at which [sI - A, -B; C, D] loses rank: inputs of that form leave no trace in the output.

    A: (n, n), B: (n, m), C: (p, n), D: (p, m), any p and m (a tall, wide or rank-deficient system is reduced first by
    the staircase of Emami-Naeini and Van Dooren 1982).  Returns the finite ones, sorted by real then imaginary part;
    each is kept only if the pencil there is nearer to losing rank than 1e-7 of its size.
    """
    from scipy.linalg import eigvals, qr

    A, B, C, D = (np.asarray(M, dtype=float) for M in (A, B, C, D))
    A, B, C = scale_states(A, B, C, state_scaling(A, B, C))
    columns, rows = _equilibrate(np.vstack([B, D])), _equilibrate(np.hstack([C, D]).T)
    model = (A, B / columns, C / rows[:, None], D / (columns * rows[:, None]))
    a, b, c, d = _square(*model, tol=tol)
    n = a.shape[0]
    if n == 0:
        return np.zeros(0, dtype=complex)
    if d.shape[0]:
        # Columns of [c d] compressed to the right: what is left on the other side is a pencil with the zeros alone.
        Q = np.asarray(qr(np.hstack([c, d]).T, mode="full")[0])[:, d.shape[0] :]
        s = eigvals(np.hstack([a, b]) @ Q, np.hstack([np.eye(n), np.zeros_like(b)]) @ Q)
    else:
        s = np.linalg.eigvals(a)
    s = np.asarray(s, dtype=complex)
    s = s[np.isfinite(s)]
    return _confirmed_zeros(model, s)


def _balanced(A: Array, C: Array) -> tuple[Array, Array, Array]:
    """A and C in balanced units, and the unit 2**e of each state."""
    none = np.zeros((A.shape[0], 0))
    e = state_scaling(A, none, C)
    A, _, C = scale_states(A, none, C, e)
    return A, C, np.ldexp(1.0, e)


def unobservable_subspace(A: Array, C: Array, tol: float, sizes: tuple[float, float] | None = None) -> Array:
    """Orthonormal basis of the largest A-invariant subspace of ker C: V <- {v in V : A v in V}, one SVD per step.

    sizes: what counts as one in A and in C; their norms by default, those of the whole for a part of a model.
    """
    size_A, size_C = sizes or (spectral_norm(A), spectral_norm(C))
    N = _kernel(C, tol * size_C)
    limit = tol * size_A
    while N.shape[1]:
        image = A @ N
        kept = _kernel(image - N @ (N.T @ image), limit)
        if kept.shape[1] == N.shape[1]:
            break
        N = N @ kept
    return N


def _kernel(M: Array, limit: float) -> Array:
    if M.shape[0] == 0 or M.shape[1] == 0:
        return np.eye(M.shape[1])
    _, sigma, Vh = np.linalg.svd(M, full_matrices=True)
    return Vh[int(np.count_nonzero(sigma > limit)) :].T


def eigendirections(A: Array) -> list[tuple[complex, Complex]]:
    """Eigenvalues of A with independent eigenvectors; those closer than their own rounding error count as one."""
    if A.shape[0] == 0:
        return []
    from scipy.linalg import eig

    values, left, right = (np.asarray(M) for M in eig(A, left=True, right=True))
    cosine = np.abs(np.sum(left.conj() * right, axis=0))
    # eps |A| / cosine bounds the error of a simple eigenvalue, and for a split Jordan block it is the splitting.
    size = max(spectral_norm(A), np.finfo(float).tiny)
    error = 64 * np.finfo(float).eps * size / np.maximum(cosine, 1e-12)
    near = np.abs(values[:, None] - values[None, :]) <= error[:, None] + error[None, :]
    found: list[tuple[complex, Complex]] = []
    left_over = set(range(values.size))
    while left_over:
        group = _connected(near, min(left_over))
        left_over -= group
        members = sorted(group)
        mean = complex(np.mean(values[members]))
        if abs(mean.imag) <= 64 * np.finfo(float).eps * size * len(members):
            mean = complex(mean.real, 0.0)
        if len(members) == 1:
            found.append((mean, right[:, members[0]]))
            continue
        _, sigma, Vh = np.linalg.svd(A - mean * np.eye(A.shape[0]))
        count = min(len(members), max(1, int(np.count_nonzero(sigma <= 1e-9 * size))))
        found.extend((mean, v.conj()) for v in Vh[-count:])
    return found


def _connected(near: NDArray[np.bool_], start: int) -> set[int]:
    group, edge = {start}, {start}
    while edge:
        edge = {int(k) for j in edge for k in np.flatnonzero(near[j] | near[:, j])} - group
        group |= edge
    return group


def _normalised(v: Complex) -> Complex:
    v = np.asarray(v, dtype=complex)
    largest = v[int(np.argmax(np.abs(v)))]
    return v / (np.linalg.norm(v) * largest / abs(largest))


def _smallest_singular(A: Array, C: Array, s: Array, weights: tuple[float, float]) -> Array:
    """sigma_min([(sI - A)/a; C/c]) for every s, real or complex, with weights (a, c)."""
    n, (a, c) = A.shape[0], weights
    stack = np.empty((s.size, n + C.shape[0], n), dtype=s.dtype)
    stack[:, :n] = (s[:, None, None] * np.eye(n) - A) / a
    stack[:, n:] = C / c
    return np.linalg.svd(stack, compute_uv=False)[:, -1]


def _downhill(
    A: Array, C: Array, s: complex, value: float, inside: Callable[[Any], Any], weights: tuple[float, float]
) -> tuple[float, complex]:
    """Compass search for a local minimum of the smallest singular value inside the region, and where it is."""
    compass = np.array([1, -1, 1j, -1j])
    step = 0.1 * max(abs(s), 1e-3 * max(spectral_norm(A), 1e-300))
    for _ in range(48):
        if step <= 1e-5 * value * weights[0]:  # the value changes by at most step / a: five digits are settled
            break
        trial = inside(s + step * compass)
        values = _smallest_singular(A, C, trial, weights)
        k = int(np.argmin(values))
        if values[k] < value:
            s, value = complex(trial[k]), float(values[k])
        else:
            step *= 0.35
    return value, s


def _equilibrate(M: Array) -> Array:
    """Powers of two that bring each non-zero column of M to a size in [1, 2)."""
    size = np.max(np.abs(M), axis=0, initial=0.0)
    return np.where(size > 0, np.exp2(np.floor(np.log2(np.where(size > 0, size, 1.0)))), 1.0)


def _square(A: Array, B: Array, C: Array, D: Array, tol: float) -> tuple[Array, Array, Array, Array]:
    """The part of the system that carries its finite zeros, with a square invertible feedthrough."""
    limit = tol * max(spectral_norm(np.block([[A, B], [C, D]])), 1e-300)
    A, B, C, D = _reduce(A, B, C, D, limit)
    At, Ct, Bt, Dt = _reduce(A.T, C.T, B.T, D.T, limit)
    return At.T, Bt.T, Ct.T, Dt.T


def _reduce(A: Array, B: Array, C: Array, D: Array, limit: float) -> tuple[Array, Array, Array, Array]:
    """Replace outputs without feedthrough by what keeping them at zero demands, until D has full row rank."""
    while C.shape[0]:
        rank, U = _row_compression(D, limit)
        C, D = U.T @ C, (U.T @ D)[:rank]
        silent, C = C[rank:], C[:rank]
        if silent.shape[0] == 0:
            break
        sigma, V = _column_space(silent, limit)
        free, pinned = V[:, sigma:], V[:, :sigma]
        if sigma == 0:
            break
        C, D = np.vstack([pinned.T @ A @ free, C @ free]), np.vstack([pinned.T @ B, D])
        A, B = free.T @ A @ free, free.T @ B
    return A, B, C, D


def _row_compression(D: Array, limit: float) -> tuple[int, Array]:
    if D.shape[1] == 0:
        return 0, np.eye(D.shape[0])
    U, sigma, _ = np.linalg.svd(D, full_matrices=True)
    return int(np.count_nonzero(sigma > limit)), U


def _column_space(C: Array, limit: float) -> tuple[int, Array]:
    if C.shape[1] == 0:
        return 0, np.eye(0)
    _, sigma, Vh = np.linalg.svd(C, full_matrices=True)
    return int(np.count_nonzero(sigma > limit)), Vh.T


def _confirmed_zeros(model: tuple[Array, Array, Array, Array], s: Complex) -> Complex:
    """Candidates at which the pencil really loses rank, compared with its rank at a generic point."""
    A, B, C, D = model
    n = A.shape[0]
    scale = max(spectral_norm(A), 1e-300)

    def singular(s: Complex) -> Array:
        stack = np.empty((s.size, n + C.shape[0], n + B.shape[1]), dtype=complex)
        stack[:, :n, :n] = s[:, None, None] * np.eye(n) - A
        stack[:, :n, n:], stack[:, n:, :n], stack[:, n:, n:] = -B, C, D
        size = np.maximum(np.abs(s), scale)
        stack[:, :n] /= size[:, None, None]
        return np.linalg.svd(stack, compute_uv=False)

    generic = singular(np.array([0.8147 + 0.9058j, -0.6324 + 0.0975j], dtype=np.complex128) * scale)
    rank = int(np.max(np.count_nonzero(generic > 1e-10, axis=1)))
    if rank == 0 or s.size == 0:
        return np.zeros(0, dtype=complex)
    kept = s[singular(s)[:, rank - 1] <= 1e-7]
    return kept[np.lexsort((kept.imag, kept.real))]
