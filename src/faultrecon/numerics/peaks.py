# SPDX-License-Identifier: BSD-3-Clause
"""How large the outputs of a sampled linear system can get: for inputs that stay within bounds, and for white noise.

    x⁺ = M x + B d,   y = C x + D d;      impulse response  h₀ = D,  hₖ = C M^(k-1) B

|y| ≤ Σₖ |hₖ| d̄ whenever |d| ≤ d̄, and no smaller bound holds for all such d (the peak gain, or l1 norm); white noise of
standard deviation s leaves sqrt(Σₖ hₖ²) s.  Both also for y behind low-pass filters  s⁺ = a s + (1 - a) y⁺.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

BLOCK = 256  # samples of the impulse response that are computed at once
OVER = 1e-7  # of a sum: a block that adds less ends it
NOTHING = 1e-10  # of the largest sum of an output: rounding
STEADY = 1e-3  # of the distance to 1: how little the ratio of two blocks may change for the rest to be geometric
GROWING = 2.0  # from block to block: a sum that is not about to end
BEYOND = 300.0  # as a logarithm: sizes that no sequence worth having begins with
FADED = 1e-4  # of the unit, or of the largest value if that is less: a response below it has faded
AT_ONCE = 1e-9  # per sample: a rate below it is that of nothing
WATCHED = 4  # blocks after which a response that has not faded is bounded mode by mode
APART = 1e9  # condition of the modes up to which that says something
LONGEST_FADE = 2**17  # samples of a fading response that are looked at
LONGEST = 2**20  # samples: there it ends in any case


@dataclass(frozen=True, eq=False)
class Gains:
    """peak and noise: (filters, r, d), by filter, output and input; infinite where the response does not decay."""

    peak: Array
    noise: Array


def gains(M: Array, B: Array, C: Array, D: Array, smoothing: Sequence[float] = (0.0,)) -> Gains:
    """Peak and noise gains of x⁺ = M x + B d, y = C x + D d, plain sums in floating point.

    M (n, n), B (n, d), C (r, n), D (r, d).  smoothing: the poles a of the filters, 0 <= a < 1; 0 is no filter.
    """
    from scipy.signal import lfilter

    poles = np.asarray(smoothing, dtype=float)
    n, r, d = M.shape[0], C.shape[0], B.shape[1]
    peak, energy = np.zeros((len(poles), r, d)), np.zeros((len(poles), r, d))
    if r == 0 or d == 0:
        return Gains(peak, energy)
    slowest = float(np.abs(np.linalg.eigvals(M)).max()) if n else 0.0
    if slowest >= 1.0:
        seen = _reaches(M, B, C)[None] | np.zeros((len(poles), 1, 1), dtype=bool)
        return Gains(np.where(seen, np.inf, np.abs(D)), np.where(seen, np.inf, np.abs(D)))
    stack, power = observations(M, C)
    states = [np.zeros((1, r, d)) for _ in poles]
    block, X, done, agreed = D[None], B, 0, 0
    before, last = np.zeros((2, *peak.shape)), np.full((2, *peak.shape), np.inf)
    while True:
        added = np.zeros((2, *peak.shape))
        for i, a in enumerate(poles):
            response, states[i] = lfilter([1.0 - a], [1.0, -a], block, axis=0, zi=states[i])
            added[0, i] = np.abs(response).sum(axis=0)
            added[1, i] = np.square(response).sum(axis=0)
        peak += added[0]
        energy += added[1]
        done += len(block)
        if n == 0 and not any(np.any(s) for s in states):
            return Gains(peak, np.sqrt(energy))
        ratio = np.divide(added, before, out=np.where(added > 0, GROWING, 0.0), where=GROWING * before > added)
        # where two ratios agree the slowest mode is alone, and the rest is geometric
        steady = (ratio < 1.0) & (np.abs(ratio - last) <= STEADY * (1.0 - ratio))
        over = (added[0] <= OVER * peak) | (peak <= NOTHING * peak.max(axis=2, keepdims=True))
        agreed = agreed + 1 if done > 1 and np.all(steady | over) else 0
        if agreed == 2 or done >= LONGEST:
            rest = min(slowest**BLOCK, 1.0 - np.finfo(float).eps)
            ratio = np.where(steady, ratio, np.where(over, 0.0, rest))
            total = np.stack([peak, energy]) + added * ratio / (1.0 - ratio)
            return Gains(total[0], np.sqrt(total[1]))
        before, last = added, ratio
        block = (stack @ X).reshape(BLOCK, r, d)
        X = power @ X


@dataclass(frozen=True, eq=False)
class Fading:
    """How outputs of x⁺ = M x fade: |y_k| ≤ Σ first × rate^k over two parts, a quick one and a slow one.

    first, rate: (2, r).  Where an output does not fade first is inf and rate 1.
    """

    first: Array
    rate: Array


def fading(M: Array, C: Array, box: Array, units: Array, rate: Array | None = None) -> Fading:
    """How fast |C Mᵏ box| fades, each output in its unit: C (r, n), box (n, k), columns of which any |share| ≤ 1.

    Of all such pairs above an output, until it has faded, one with nearly the smallest sum is taken; rate (2, r): of
    those with these rates.
    """
    r = C.shape[0]
    if not M.size or not box.size:
        return Fading(np.zeros((2, r)), np.zeros((2, r)) if rate is None else rate)
    slowest = float(np.abs(np.linalg.eigvals(M)).max())
    if slowest >= 1.0:
        return Fading(np.full((2, r), np.inf), np.ones((2, r)) if rate is None else rate)
    ends, table = _envelope(M, C, box, units)
    best = np.full(r, np.inf), Fading(np.full((2, r), np.inf), np.full((2, r), slowest))
    if rate is not None:
        return Fading(_least(best, ends, table, rate[1], lambda _: rate[0])[1].first, rate)
    tries = np.concatenate([1.0 - (1.0 - slowest) * 0.5 ** np.arange(1, 3), slowest**1.5 ** np.arange(16)])
    for slow in tries[tries > AT_ONCE]:
        best = _least(best, ends, table, np.full(r, slow), lambda end: np.full(r, np.exp(-3.0 / max(end, 1.0))))
    return best[1]


def _least(
    best: tuple[Array, Fading], ends: Array, table: Array, slow: Array, quick: Callable[[float], Array]
) -> tuple[Array, Fading]:
    """The best sums and their pairs, where none with this slow rate has a smaller one, by output.

    The slow part lies above all from one stretch on, the quick one, at a rate that goes by where that is, above what
    is left before it.
    """
    total, found = best
    decay = np.multiply.outer(ends, np.log(slow))
    tails = np.maximum.accumulate((np.log(table) - decay)[::-1], axis=0)[::-1]
    for cut in range(0, len(ends), 4):
        size, more, rate = np.exp(np.minimum(tails[cut], BEYOND)), 0.0 * slow, 0.0 * slow
        if cut:
            rate = quick(ends[cut - 1])
            rest = np.maximum(table[:cut] - size * np.exp(decay[:cut]), np.finfo(float).tiny)
            earlier = np.max(np.log(rest) - np.multiply.outer(ends[:cut], np.log(rate)), axis=0)
            more = np.exp(np.minimum(earlier, BEYOND))
        sums = more / (1.0 - rate) + size / (1.0 - slow)
        pair = Fading(np.vstack([more, size]), np.vstack([rate, slow]))
        found = Fading(*(np.where(sums < total, *two) for two in ((pair.first, found.first), (pair.rate, found.rate))))
        total = np.minimum(total, sums)
    return total, found


def _envelope(M: Array, C: Array, box: Array, units: Array) -> tuple[Array, Array]:
    """The largest outputs within stretches that end at `ends`, (stretches,) and (stretches, r); never quite zero."""
    stack, power = observations(M, C)
    blocks, X, top, faded = [], box, 0.0, 0.0
    each, modes = np.ones(box.shape[1]), None
    while len(blocks) * BLOCK < LONGEST_FADE:
        responses = stack @ X
        block = (np.abs(responses, out=responses) @ each).reshape(BLOCK, len(C)) / units
        blocks.append(block)
        top = max(top, float(block.max(initial=0.0)))
        faded = FADED * min(top, 1.0)
        if float(block.max(initial=0.0)) <= faded:
            break
        X = power @ X
        if len(blocks) == WATCHED and (modes := _modes(M, C, X, units)) is not None:
            break
    table = np.concatenate(blocks)
    edges = np.unique(np.concatenate([np.arange(17), np.geomspace(16, len(table), 120).astype(int)]))
    ends, largest = edges[1:] - 1, np.maximum.reduceat(table, edges[:-1], axis=0)
    if modes is not None:
        later = np.geomspace(1.0, LONGEST_FADE / len(table), 40)
        starts = np.unique((len(table) * (later - 1.0)).astype(int))
        tail = modes[1] ** starts[:, None] @ modes[0].T
        kept = 1 + int(np.count_nonzero(tail.max(axis=1) > faded))  # sizes only fall
        ends = np.concatenate([ends, len(table) + np.append(starts[1:], starts[-1] + 1)[:kept] - 1])
        largest = np.vstack([largest, tail[:kept]])
    return ends.astype(float), np.maximum(largest, np.finfo(float).tiny)


def _modes(M: Array, C: Array, X: Array, units: Array) -> tuple[Array, Array] | None:
    """Sizes (r, n) and rates (n,) with |C M^k X| <= sizes rate^k, mode by mode; None where these are too alike."""
    values, vectors = np.linalg.eig(M)
    if not np.linalg.cond(vectors) <= APART:
        return None
    weights = np.abs(np.linalg.solve(vectors, X)).sum(axis=1)
    return np.abs(C @ vectors) * weights / units[:, None], np.abs(values)


def observations(M: Array, C: Array) -> tuple[Array, Array]:
    """[C; C M; ...; C M^(BLOCK-1)] and M^BLOCK."""
    rows, power = [C], M
    while len(rows) * len(C) < BLOCK * len(C):
        rows += [one @ power for one in rows]
        power = power @ power
    return np.vstack(rows), power


def _reaches(M: Array, B: Array, C: Array) -> NDArray[np.bool_]:
    """Which outputs an input reaches through the state at all, (r, d)."""
    stack, _ = observations(M, C)
    seen = np.abs((stack @ B).reshape(-1, len(C), B.shape[1])).max(axis=0)
    return np.asarray(seen > 0)
