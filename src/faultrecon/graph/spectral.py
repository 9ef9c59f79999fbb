# SPDX-License-Identifier: BSD-3-Clause
"""How large the spectral norm of a matrix can be when its entries are only known to lie in intervals."""

from __future__ import annotations

import numpy as np

from faultrecon.graph.interval import Array, Interval

_U = 2.0**-53


def norm_above(entries: Interval) -> Array:
    """Proved upper bounds on the spectral norm of matrices (N, m, k) of intervals; inf where an entry is unbounded."""
    bounded = np.asarray(np.isfinite(entries.lo) & np.isfinite(entries.hi)).all(axis=(1, 2))
    above = np.full(bounded.shape, np.inf)
    if not bounded.any():
        return above
    lo, hi = entries.lo[bounded], entries.hi[bounded]
    largest = np.maximum(np.abs(lo), np.abs(hi))
    if lo.shape[1] == lo.shape[2] == 1:
        above[bounded] = largest[:, 0, 0]
        return above
    # Scaling by a power of 2 is exact and keeps every square away from under- and overflow.
    scale = np.ldexp(1.0, np.frexp(largest.max(axis=(1, 2)))[1] - 1)[:, None, None]
    lo, hi, largest = lo / scale, hi / scale, largest / scale
    bound = np.minimum(_frobenius(largest), _schur(largest))
    if min(lo.shape[1:]) > 1:
        middle = lo + 0.5 * (hi - lo)
        radius = np.nextafter(np.maximum(hi - middle, middle - lo), np.inf)
        bound = np.minimum(bound, _spectral(middle) + np.minimum(_frobenius(radius), _schur(radius)))
    # Sums, products and roots of n nonnegative terms lose at most n + 10 roundings of 1.1e-16 each.
    slack = 1.0 + 1e-15 * (10 + lo.shape[1] * lo.shape[2])
    above[bounded] = np.where(bound > 0.0, np.nextafter(bound * slack * scale[:, 0, 0], np.inf), 0.0)
    return above


def norm_below(entries: Interval) -> Array:
    """Lower bounds on the spectral norm, in floating point; 0 where an entry is unbounded."""
    bounded = np.asarray(np.isfinite(entries.lo) & np.isfinite(entries.hi)).all(axis=(1, 2))
    below = np.zeros(bounded.shape)
    lo, hi = entries.lo[bounded], entries.hi[bounded]
    if lo.size:
        middle = lo + 0.5 * (hi - lo)
        singular = np.linalg.norm(middle, 2, axis=(1, 2))
        below[bounded] = np.maximum(singular * (1.0 - 1e-14) - np.sqrt(((hi - lo) ** 2).sum(axis=(1, 2))), 0.0)
    return below


def _frobenius(matrices: Array) -> Array:
    return np.sqrt((matrices**2).sum(axis=(1, 2)))


def _schur(matrices: Array) -> Array:
    """sqrt(norm_1 norm_inf) of nonnegative matrices."""
    return np.sqrt(matrices.sum(axis=1).max(axis=1) * matrices.sum(axis=2).max(axis=1))


def _spectral(a: Array) -> Array:
    """Upper bounds on the spectral norm of point matrices with entries of size about 1.

    With V nearly orthogonal, norm(A) <= norm(A V) norm(V^-1), where norm(A V)^2 is bounded by the row sums of
    (A V)'(A V), nearly diagonal, and norm(V^-1)^2 by 1 / (1 - row sums of |V'V - I|). V may be any matrix: what
    LAPACK returns decides how tight the bound is, not whether it holds. Products are bounded by gamma_n |A||B|.
    """
    if a.shape[1] < a.shape[2]:
        a = a.transpose(0, 2, 1)
    k = a.shape[2]
    gamma = 1.01 * _U * (max(a.shape[1:]) + 2)
    try:
        v = np.linalg.eigh(a.transpose(0, 2, 1) @ a)[1]
    except np.linalg.LinAlgError:
        return _frobenius(np.abs(a))
    vt, av = v.transpose(0, 2, 1), a @ v
    av_error = _frobenius(gamma * (np.abs(a) @ np.abs(v)) + 1e-290)
    gram = np.abs(av.transpose(0, 2, 1) @ av) + gamma * (np.abs(av).transpose(0, 2, 1) @ np.abs(av)) + 1e-290
    skew = np.abs(vt @ v - np.eye(k)) * (1.0 + _U) + gamma * (np.abs(vt) @ np.abs(v)) + 1e-290
    off = skew.sum(axis=2).max(axis=1) * (1.0 + gamma)
    bound = (np.sqrt(gram.sum(axis=2).max(axis=1)) + av_error) / np.sqrt(np.maximum(1.0 - off, 1e-300))
    return np.where(off < 0.5, bound, _frobenius(np.abs(a)))
