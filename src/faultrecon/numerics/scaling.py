# SPDX-License-Identifier: BSD-3-Clause
"""State units in which a model is well scaled, as exact powers of two.

A state measured in radians beside one in newtons makes every tolerance meaningless.  Here each state gets an integer
exponent e, so that with T = diag(2**e) the matrices T^-1 A T, T^-1 B and C T have rows and columns of comparable
size.  Powers of two lose no bits: the scaled model is the same model.
"""

from __future__ import annotations

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
    gauge = _gauge(A, B, C, fixed, declared)
    links = _links(*scale_states(A, B, C, gauge))
    fitted = _balance(links, n, free=~declared)
    exponents = gauge + np.where(declared, 0, np.rint(fitted)).astype(np.int64)
    return np.clip(exponents, -LARGEST_EXPONENT, LARGEST_EXPONENT)


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
    n = A.shape[0]
    e, known = fixed.copy(), declared.copy()
    for i in np.flatnonzero(~known):
        for row, sign in ((B[i], 1), (C[:, i], -1)):
            entries = row[row != 0]
            if entries.size and not known[i]:
                e[i], known[i] = sign * np.frexp(entries[0])[1], True
    linked = (A != 0) | (A.T != 0)
    while not known.all():
        pairs = np.argwhere(linked & known[None, :] & ~known[:, None])
        if pairs.size == 0:
            known[np.flatnonzero(~known)[0]] = True  # a group linked to nothing outside: its first state sets the unit
            continue
        i, j = (int(k) for k in pairs[0])
        entry, sign = (A[i, j], 1) if A[i, j] != 0 else (A[j, i], -1)
        e[i], known[i] = e[j] + sign * np.frexp(entry)[1], True
    assert e.shape == (n,)
    return e


def _links(A: Array, B: Array, C: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Every entry a change of units moves, as (row, column, log2 size); row or column n stands for the outside."""
    n = A.shape[0]
    ai, aj = np.nonzero(A * (1 - np.eye(n)))
    bi, bj = np.nonzero(B)
    ci, cj = np.nonzero(C)
    rows = np.concatenate([ai, bi, np.full(ci.size, n)])
    cols = np.concatenate([aj, np.full(bi.size, n), cj])
    size = np.concatenate([np.abs(A[ai, aj]), np.abs(B[bi, bj]), np.abs(C[ci, cj])])
    return rows, cols, np.log2(size)


def _balance(links: tuple[NDArray[np.intp], NDArray[np.intp], Array], n: int, free: NDArray[np.bool_]) -> Array:
    """Real exponents minimising sum_ij |entry| 2^(e_col - e_row) with a weak pull to the robust logarithmic fit."""
    rows, cols, size = links
    e = np.zeros(n)
    if not free.any() or size.size == 0:
        return e
    D = np.zeros((size.size, n + 1))
    k = np.arange(size.size)
    np.add.at(D, (k, cols), 1.0)
    np.add.at(D, (k, rows), -1.0)
    D = D[:, :n][:, free]
    fit = _logarithmic_fit(D, size)
    weight = 1e-3 * float(np.mean(np.exp2(D @ fit + size)))
    e[free] = _minimise(D, size, fit, weight)
    return e


def _logarithmic_fit(D: Array, size: Array) -> Array:
    """The exponents z that bring log2 sizes D z + size near 0: quadratic for small ones, linear beyond 2**4.

    Sizes below 1 weigh a quarter: an entry of 1e-17 is rounding noise and may stay small, one of 1e17 may not stay.
    """
    z = np.zeros(D.shape[1])
    for _ in range(60):
        t = D @ z + size
        w = np.where(t > 0, 1.0, 0.25) / np.sqrt(1.0 + (t / 4.0) ** 2)
        # A group linked to nothing makes the normal matrix singular; lstsq then keeps its exponents small.
        step = np.linalg.lstsq(D.T @ (w[:, None] * D), -D.T @ (w * t), rcond=1e-12)[0]
        z = z + step
        if np.abs(step).max() <= 1e-2:  # a hundredth of an exponent is below the rounding to come
            break
    return z


def _minimise(D: Array, size: Array, fit: Array, weight: float) -> Array:
    """Damped Newton on the convex sum_k 2^(D z + size)_k + weight/2 |D (z - fit)|^2, a handful of steps in practice."""
    laplacian = D.T @ D

    def cost(z: Array) -> float:
        return float(np.exp2(D @ z + size).sum() + 0.5 * weight * np.sum((D @ (z - fit)) ** 2))

    z, value = fit, cost(fit)
    for _ in range(100):
        terms = np.exp2(D @ z + size) * np.log(2.0)
        gradient = D.T @ terms + weight * laplacian @ (z - fit)
        hessian = D.T @ (np.log(2.0) * terms[:, None] * D) + weight * laplacian
        step = -np.linalg.lstsq(hessian, gradient, rcond=1e-13)[0]
        step *= min(1.0, 8.0 / max(float(np.abs(step).max()), 1e-300))
        while (trial := cost(z + step)) > value and np.abs(step).max() > 1e-6:
            step *= 0.5
        if trial >= value or np.abs(step).max() <= 1e-3:
            break
        z, value = z + step, trial
    return z


def spectral_norm(M: Any) -> float:
    """Spectral norm, 0 for an empty matrix."""
    M = np.asarray(M)
    return float(np.linalg.norm(M, 2)) if M.size else 0.0
