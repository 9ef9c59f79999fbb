# SPDX-License-Identifier: BSD-3-Clause
"""State units in which a model is well scaled, as exact powers of two.

A state measured in radians beside one in newtons makes every tolerance meaningless.  Here each state gets an integer
exponent e, so that with T = diag(2**e) the matrices T^-1 A T, T^-1 B and C T have rows and columns of comparable
size.  Powers of two lose no bits: the scaled model is the same model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError

Array = NDArray[Any]

LARGEST_EXPONENT = 60
"""Beyond 2**60 (1e18) two units differ by more than double precision can hold side by side."""


def scale_states(A: Array, B: Array, C: Array, exponents: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """T^-1 A T, T^-1 B and C T for T = diag(2**exponents), without a rounding error."""
    t = np.ldexp(1.0, exponents)
    return A * (t[None, :] / t[:, None]), B / t[:, None], C * t[None, :]


def state_scaling(A: ArrayLike, B: ArrayLike, C: ArrayLike, ranges: ArrayLike | None = None) -> NDArray[np.int64]:
    """Integer exponents e for which the states x = diag(2**e) z make the model well scaled.

    A: (n, n), B: (n, k), C: (p, n); k and p may be 0.  ranges: (n,), the declared size of each state, nan where none
    is declared; a declared state gets round(log2(range)) and the others are fitted around it.  Returns (n,) int64,
    each within +-60.  Raises InputError for a range that is not positive.

    The others minimise the sum of the sizes of all entries that a change of units moves (Osborne's balancing with B
    and C included; the minimum is unique and the problem convex in e), with a weak pull to a robust fit of the
    logarithms, which settles the directions in which a reducible A (a chain, a triangle) would drift for ever.
    Measuring a state in units 2**k times larger moves its exponent by exactly -k, except in a group of states that is
    linked to no input, no output and no declared range: there only the differences are determined.
    """
    A, B, C = (np.asarray(M, dtype=float) for M in (A, B, C))
    n = A.shape[0]
    fixed, declared = _declared(ranges, n)
    # A column or row of zeros links nothing, so models that differ in them alone have the same units.
    B, C = B[:, B.any(axis=0)], C[C.any(axis=1)]
    return np.frombuffer(_fitted(n, *(M.tobytes() for M in (A, B, C, fixed, declared))), dtype=np.int64).copy()


@lru_cache(maxsize=16)
def _fitted(n: int, A_: bytes, B_: bytes, C_: bytes, fixed_: bytes, declared_: bytes) -> bytes:
    """The exponents by content: they cost more than a Schur form, and many questions about one model ask for them."""
    k = max(n, 1)
    A, B, C = (np.frombuffer(M).reshape(shape) for M, shape in ((A_, (n, n)), (B_, (k, -1)), (C_, (-1, k))))
    fixed, declared = np.frombuffer(fixed_, dtype=np.int64), np.frombuffer(declared_, dtype=np.bool_)
    gauge = _gauge(A, B, C, fixed, declared)
    fitted = np.zeros(n)
    fitted[~declared] = _balance(_links(*scale_states(A, B, C, gauge), free=~declared))
    exponents = gauge + np.rint(fitted).astype(np.int64)
    return np.clip(exponents, -LARGEST_EXPONENT, LARGEST_EXPONENT).tobytes()


def _declared(ranges: ArrayLike | None, n: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    size = np.full(n, np.nan) if ranges is None else np.asarray(ranges, dtype=float).reshape(n)
    declared = ~np.isnan(size)
    wrong = np.flatnonzero(declared & ~((size > 0) & np.isfinite(size)))
    if wrong.size:
        raise InputError(
            f"the range of state {wrong[0] + 1} is {size[wrong[0]]:g}",
            why="a range is the largest size the state is expected to reach, a positive number",
            remedies=("give a positive range", "leave it out, and it is derived from the model"),
        )
    exponents = np.zeros(n, dtype=np.int64)
    exponents[declared] = np.rint(np.log2(size[declared])).astype(np.int64)
    return np.clip(exponents, -LARGEST_EXPONENT, LARGEST_EXPONENT), declared


def _gauge(A: Array, B: Array, C: Array, fixed: NDArray[np.int64], declared: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Units read off the pattern alone: they follow any change of units exactly, so what is fitted next is the same.

    States are reached in an order that only the zero pattern decides: declared ones, then those with an input or an
    output, then neighbours; each takes the binary exponent of the first entry that links it.
    """
    e, known = fixed.copy(), declared.copy()
    for M, sign in ((B, 1), (C.T, -1)):
        if M.shape[1]:
            new = M.any(axis=1) & ~known
            first = np.take_along_axis(M, np.argmax(M != 0, axis=1)[:, None], axis=1)[:, 0]
            e[new], known = sign * np.frexp(first[new])[1], known | new
    linked = (A != 0) | (A.T != 0)
    reached = linked[:, known].any(axis=1)
    while not known.all():
        i = int(np.argmax(reached & ~known))
        if reached[i] and not known[i]:
            j = int(np.argmax(linked[i] & known))
            entry, sign = (A[i, j], 1) if A[i, j] != 0 else (A[j, i], -1)
            e[i] = e[j] + sign * np.frexp(entry)[1]
        else:
            i = int(np.argmin(known))  # a group linked to nothing outside: its first state sets the unit
        known[i] = True
        reached |= linked[:, i]
    return e


@dataclass(frozen=True, slots=True)
class Links:
    """Every entry that a change of units moves, as an arrow between two free states or a state and the outside.

    from_, to: (k,) indices of the free states, `count` stands for whatever has its unit fixed.  size: (k,) log2 sizes.
    An entry changes by 2^(z_to - z_from), so all sums below are over a graph and none needs the (k, count) matrix.
    """

    from_: NDArray[np.intp]
    to: NDArray[np.intp]
    size: Array
    count: int

    def sizes(self, z: Array) -> Array:
        """log2 sizes (k,) in the units z (count,)."""
        return self.change(z) + self.size

    def change(self, z: Array) -> Array:
        """z_to - z_from for every arrow (k,)."""
        padded = np.append(z, 0.0)
        return padded[self.to] - padded[self.from_]

    def pull(self, force: Array) -> Array:
        """The transpose of `change`: what forces (k,) along the arrows add up to at every state (count,)."""
        arriving = np.bincount(self.to, force, self.count + 1)
        return (arriving - np.bincount(self.from_, force, self.count + 1))[: self.count]

    def laplacian(self, weight: Array) -> Array:
        """The matrix (count, count) of z -> pull(weight * change(z))."""
        n = self.count + 1
        joined = np.bincount(self.from_ * n + self.to, weight, n * n).reshape(n, n)
        joined = joined + joined.T
        return (np.diag(joined.sum(axis=1)) - joined)[: self.count, : self.count]


def _links(A: Array, B: Array, C: Array, free: NDArray[np.bool_]) -> Links:
    """The entries of a model as arrows from their row to their column."""
    n = A.shape[0]
    ai, aj = np.nonzero(A * (1 - np.eye(n)))
    bi, bj = np.nonzero(B)
    ci, cj = np.nonzero(C)
    outside = int(np.count_nonzero(free))
    place = np.append(np.where(free, np.cumsum(free) - 1, outside), outside)
    rows = np.concatenate([ai, bi, np.full(ci.size, n)])
    cols = np.concatenate([aj, np.full(bi.size, n), cj])
    size = np.concatenate([np.abs(A[ai, aj]), np.abs(B[bi, bj]), np.abs(C[ci, cj])])
    return Links(place[rows], place[cols], np.log2(size), outside)


def _balance(links: Links) -> Array:
    """Real exponents minimising sum_ij |entry| 2^(e_col - e_row) with a weak pull to the robust logarithmic fit."""
    if links.count == 0 or links.size.size == 0:
        return np.zeros(links.count)
    loose = _loose(links)
    fit = _logarithmic_fit(links, loose)
    return _minimise(links, loose, fit, weight=1e-3 * float(np.mean(np.exp2(links.sizes(fit)))))


def _loose(links: Links) -> Array:
    """Orthonormal (count, k): the groups of states linked to nothing with a fixed unit, which no sum below tells apart
    from the same group in other units."""
    group = np.arange(links.count + 1)
    while True:
        least = np.minimum(group[links.from_], group[links.to])
        before = group.copy()
        np.minimum.at(group, links.from_, least)
        np.minimum.at(group, links.to, least)
        group = group[group]
        if np.array_equal(group, before):
            break
    own = [group == k for k in np.unique(group) if k != group[-1]]
    return np.array([mask[:-1] / np.sqrt(mask.sum()) for mask in own]).reshape(-1, links.count).T


def _logarithmic_fit(links: Links, loose: Array) -> Array:
    """The exponents z that bring all log2 sizes near 0: quadratic for small ones, linear beyond 2**4.

    Sizes below 1 weigh a quarter: an entry of 1e-17 is rounding noise and may stay small, one of 1e17 may not stay.
    """
    z = np.zeros(links.count)
    for _ in range(60):
        t = links.sizes(z)
        w = np.where(t > 0, 1.0, 0.25) / np.sqrt(1.0 + (t / 4.0) ** 2)
        step = _smallest_solution(links.laplacian(w), -links.pull(w * t), loose)
        z = z + step
        if np.abs(step).max() <= 1e-2:  # a hundredth of an exponent is below the rounding to come
            break
    return z


def _smallest_solution(M: Array, b: Array, loose: Array) -> Array:
    """x with M x = b for M symmetric, positive semidefinite, zero on `loose`; the smallest one where M is singular.

    A group of states that is linked to nothing makes it singular; its exponents are then kept small.
    """
    from scipy.linalg import get_lapack_funcs

    if loose.shape[1]:
        M = M + M.diagonal().max() * loose @ loose.T
    potrf, potrs = get_lapack_funcs(("potrf", "potrs"), (M, b))
    factor, failed = potrf(M)
    pivots = factor.diagonal()
    if failed or pivots.min() <= 1e-5 * pivots.max():
        return np.linalg.lstsq(M, b, rcond=1e-12)[0]  # ten times the time
    x = potrs(factor, b)[0]
    return x - loose @ (loose.T @ x) if loose.shape[1] else x


def _minimise(links: Links, loose: Array, fit: Array, weight: float) -> Array:
    """Damped Newton on the convex sum_k 2^size_k(z) + weight/2 |change(z - fit)|^2, a handful of steps in practice.

    Arrows between the same two ends add up, so both terms are quadratic in matrices of order count + 1.
    """
    n = links.count + 1
    sizes = np.bincount(links.from_ * n + links.to, np.exp2(links.sizes(fit)), n * n).reshape(n, n)
    stiffness = links.laplacian(np.full(links.size.size, weight))

    def terms(y: Array) -> Array:
        unit = np.exp2(np.append(y, 0.0))
        return sizes * (unit / unit[:, None])

    def cost(y: Array, now: Array) -> float:
        return float(now.sum() + 0.5 * y @ stiffness @ y)

    # z - fit, which stays small, from the best shift of all states that are linked to the outside.
    y = np.ones(links.count) - loose @ loose.sum(axis=0)
    y *= _shift(float(sizes[-1, :-1].sum()), float(sizes[:-1, -1].sum()), float(y @ stiffness @ y))
    now = terms(y)
    value = cost(y, now)
    for _ in range(100):
        gradient = (np.log(2.0) * (now.sum(axis=0) - now.sum(axis=1)))[:-1] + stiffness @ y
        both = np.log(2.0) ** 2 * (now + now.T)
        hessian = (np.diag(both.sum(axis=1)) - both)[:-1, :-1] + stiffness
        step = -_smallest_solution(hessian, gradient, loose)
        step *= min(1.0, 8.0 / max(float(np.abs(step).max()), 1e-300))
        while (trial := cost(y + step, now := terms(y + step))) > value and np.abs(step).max() > 1e-6:
            step *= 0.5
        if trial >= value or np.abs(step).max() <= 1e-3:
            break
        y, value = y + step, trial
    return fit + y


def _shift(outputs: float, inputs: float, stiffness: float) -> float:
    """s that minimises outputs 2^s + inputs 2^-s + stiffness s^2/2, to a thousandth; 0 where nothing decides."""
    low, high = -float(LARGEST_EXPONENT), float(LARGEST_EXPONENT)
    if outputs + inputs + stiffness <= 0:
        return 0.0
    for _ in range(17):
        s = 0.5 * (low + high)
        if np.log(2.0) * (outputs * 2.0**s - inputs * 2.0**-s) + stiffness * s > 0:
            high = s
        else:
            low = s
    return 0.5 * (low + high)


def spectral_norm(M: Any) -> float:
    """Spectral norm, 0 for an empty matrix."""
    M = np.asarray(M)
    return float(np.linalg.norm(M, 2)) if M.size else 0.0
