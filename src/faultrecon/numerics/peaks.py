# SPDX-License-Identifier: BSD-3-Clause
"""How large the outputs of a sampled linear system can get: for inputs that stay within bounds, and for white noise.

    x⁺ = M x + B d,   y = C x + D d;      impulse response  h₀ = D,  hₖ = C M^(k-1) B

|y| ≤ Σₖ |hₖ| d̄ whenever |d| ≤ d̄, and no smaller bound holds for all such d (the peak gain, or l1 norm); white noise of
standard deviation s leaves sqrt(Σₖ hₖ²) s.  Both also for y behind low-pass filters  s⁺ = a s + (1 - a) y⁺.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.lag import Lag

Array = NDArray[Any]

BLOCK = 256  # samples of the impulse response that are computed at once
OVER = 1e-7  # of a sum: a block that adds less ends it
NOTHING = 1e-10  # of the largest sum of an output: rounding
STEADY = 1e-3  # of the distance to 1: how little the ratio of two blocks may change for the rest to be geometric
GROWING = 2.0  # from block to block: a sum that is not about to end
BEYOND = 300.0  # as a logarithm: sizes that no sequence worth having begins with
MOST = 690.0  # as a logarithm: how much larger than at its end a quick part is taken to have been
EQUAL = 1e-9  # relative: sums that differ by no more are the same
CUTS = 4  # stretches between two places where a slow part may begin to be all
FADED = 1e-4  # of the unit, or of the largest value if that is less: a response below it has faded
AT_ONCE = 1e-9  # per sample: a rate below it is that of nothing
WATCHED = 4  # blocks after which a response that has not faded is bounded mode by mode
APART = 1e9  # condition of the modes up to which that says something
AT_HAND = 2**15  # numbers that a processor's nearest cache but one holds
LONGEST_FADE = 2**17  # samples of a fading response that are looked at
LONGEST = 2**20  # samples: there it ends in any case


@dataclass(frozen=True, eq=False)
class Gains:
    """peak and noise: (filters, r, d), by filter, output and input; infinite where the response does not decay."""

    peak: Array
    noise: Array


@dataclass(frozen=True, eq=False)
class Outputs:
    """The outputs C x of x⁺ = M x, and what all questions about them have in common: M (n, n), C (r, n)."""

    M: Array
    C: Array

    @cached_property
    def slowest(self) -> float:
        """The largest |eigenvalue| of M, 0 without a state."""
        return float(np.abs(np.linalg.eigvals(self.M)).max(initial=0.0))

    @cached_property
    def _powers(self) -> tuple[Array, Array]:
        rows, power = [self.C], self.M
        while len(rows) * len(self.C) < BLOCK * len(self.C):
            rows += [one @ power for one in rows]
            power = power @ power
        return np.vstack(rows), power

    @property
    def stack(self) -> Array:
        """[C; C M; ...; C M^(BLOCK-1)], (BLOCK r, n)."""
        return self._powers[0]

    @property
    def power(self) -> Array:
        """M^BLOCK."""
        return self._powers[1]

    @cached_property
    def in_time(self) -> Array:
        """The stack by state, output and sample, (n, r, BLOCK): what is done along the samples is done in a row."""
        r, n = self.C.shape
        return np.ascontiguousarray(self.stack.reshape(BLOCK, r, n).transpose(2, 1, 0))

    @cached_property
    def modes(self) -> tuple[Array, Array] | None:
        """Eigenvalues and eigenvectors of M; None where these are too alike to say something."""
        values, vectors = np.linalg.eig(self.M)
        return (values, vectors) if np.linalg.cond(vectors) <= APART else None


def gains(M: Array, B: Array, C: Array, D: Array, smoothing: Sequence[float] = (0.0,)) -> Gains:
    """Peak and noise gains of x⁺ = M x + B d, y = C x + D d, plain sums in floating point.

    M (n, n), B (n, d), C (r, n), D (r, d).  smoothing: the poles a of the filters, 0 <= a < 1; 0 is no filter.
    """
    poles = np.asarray(smoothing, dtype=float)
    n, r, d = M.shape[0], C.shape[0], B.shape[1]
    if r == 0 or d == 0:
        return Gains(*np.zeros((2, len(poles), r, d)))
    outputs = Outputs(M, C)
    if outputs.slowest >= 1.0:
        seen = _reaches(outputs, B)[None] | np.zeros((len(poles), 1, 1), dtype=bool)
        return Gains(*(np.where(seen, np.inf, np.abs(D)) for _ in range(2)))
    begins = (1.0 - poles)[:, None, None] * D.T
    held, sums = poles[:, None, None] * begins, _added(np.abs(begins)[..., None])
    before, last, agreed = sums, np.where(sums > 0, GROWING, 0.0), 0
    for done, added in enumerate(_blocks(outputs, B.T, held, poles)):
        sums = sums + added
        ratio = np.divide(added, before, out=np.where(added > 0, GROWING, 0.0), where=GROWING * before > added)
        # where two ratios agree the slowest mode is alone, and the rest is geometric
        steady = (ratio < 1.0) & (np.abs(ratio - last) <= STEADY * (1.0 - ratio))
        over = (added[0] <= OVER * sums[0]) | (sums[0] <= NOTHING * sums[0].max(axis=1, keepdims=True))
        agreed = agreed + 1 if np.all(steady | over) else 0
        if agreed == 2 or done * BLOCK >= LONGEST or not (n or held.any()):
            rest = min(outputs.slowest**BLOCK, 1.0 - np.finfo(float).eps)
            ratio = np.where(steady, ratio, np.where(over, 0.0, rest))
            sums = sums + added * ratio / (1.0 - ratio)
            break
        before, last = added, ratio
    peak, energy = np.swapaxes(sums, 2, 3)
    return Gains(peak, np.sqrt(energy))


def _blocks(outputs: Outputs, X: Array, held: Array, poles: Array) -> Iterator[Array]:
    """What block after block of the response to X (d, n) adds to both sums, without end; see `_added`.

    The stack is filtered instead of what it makes of X.  held (filters, d, r), what each brings along, is updated.
    """
    (n, r, _), d = outputs.in_time.shape, len(X)
    lags, nothing = [Lag(a, 1.0 - a, BLOCK) for a in poles], np.zeros((n, r))
    filtered = [lag.over(outputs.in_time, nothing).reshape(n, r * BLOCK) for lag in lags]
    fades = [a ** np.arange(BLOCK) for a in poles]
    room = np.empty((len(poles), d, r, BLOCK))
    sheet = room.reshape(len(poles), d, r * BLOCK)
    while True:
        for i, a in enumerate(poles):
            np.matmul(X, filtered[i], out=sheet[i])
            if a:
                room[i] += held[i, :, :, None] * fades[i]
                held[i] = a * room[i, :, :, -1]
        yield _added(np.abs(room, out=room))
        X = X @ outputs.power.T


def _added(sizes: Array) -> Array:
    """The sums of sizes and of their squares over the samples, (2, filters, d, r), of (filters, d, r, samples)."""
    return np.stack([sizes.sum(axis=3), np.einsum("idrk,idrk->idr", sizes, sizes)])


@dataclass(frozen=True, eq=False)
class Fading:
    """How outputs of x⁺ = M x fade: |y_k| ≤ Σ first × rate^k over two parts, a quick one and a slow one.

    first, rate: (2, r).  Where an output does not fade first is inf and rate 1.
    """

    first: Array
    rate: Array


def fading(outputs: Outputs, box: Array, units: Array, rate: Array | None = None) -> Fading:
    """How fast |C Mᵏ box| fades, each output in its unit: box (n, k), columns of which any |share| ≤ 1.

    Of all such pairs above an output, until it has faded, one with nearly the smallest sum is taken; rate (2, r): of
    those with these rates.
    """
    r, slowest = len(outputs.C), outputs.slowest
    if not outputs.M.size or not box.size:
        return Fading(np.zeros((2, r)), np.zeros((2, r)) if rate is None else rate)
    if slowest >= 1.0:
        return Fading(np.full((2, r), np.inf), np.ones((2, r)) if rate is None else rate)
    ends, table = _envelope(outputs, box, units)
    cuts = np.arange(0, len(ends), CUTS)
    if rate is not None:
        return Fading(_least(ends, table, cuts, np.tile(rate[0], (len(cuts), 1)), rate[1:]).first, rate)
    tries = np.concatenate([1.0 - (1.0 - slowest) * 0.5 ** np.arange(1, 3), slowest**1.5 ** np.arange(16)])
    quick = np.exp(-3.0 / np.maximum(ends[cuts - 1], 1.0))
    return _least(ends, table, cuts, quick[:, None], tries[tries > AT_ONCE, None])


def _least(ends: Array, table: Array, cuts: NDArray[np.intp], quick: Array, slow: Array) -> Fading:
    """The pairs with the smallest sums, by output.

    The slow part, at one of the rates slow (tries, r or 1), lies above all from one of the cuts on; the quick part, at
    the rate quick (cuts, r or 1) that goes by the cut, above what is left before it.
    """
    decay = ends[:, None] * np.log(slow)[:, None]
    tails = np.maximum.accumulate((np.log(table) - decay)[:, ::-1], axis=1)[:, ::-1]
    size, falls = np.exp(np.minimum(tails[:, cuts], BEYOND)), np.exp(decay)
    more, quick = np.zeros(size.shape), np.where(cuts[:, None] > 0, quick, 0.0)
    for c, cut in enumerate(cuts[1:], 1):  # what is less than e^(BEYOND - MOST) is nothing
        grows = np.exp(np.minimum(-ends[:cut, None] * np.log(quick[c]), MOST))
        rest = size[:, None, c] * falls[:, :cut]
        np.subtract(table[:cut], rest, out=rest)
        with np.errstate(over="ignore"):
            rest *= grows
        more[:, c] = rest.max(axis=1)
    more = np.clip(more, 0.0, np.exp(BEYOND))
    sums = more / (1.0 - quick) + size / (1.0 - slow[:, None])
    sums = np.where(np.isnan(sums), np.inf, sums).reshape(-1, table.shape[1])
    best = np.argmax(sums <= (1.0 + EQUAL) * sums.min(axis=0), axis=0)  # the first, or rounding would have its say
    each = np.arange(table.shape[1])

    def taken(part: Array) -> Array:
        return np.broadcast_to(part, size.shape).reshape(sums.shape)[best, each]

    known = sums[best, each] < np.inf
    first = np.where(known, np.vstack([taken(more), taken(size)]), np.inf)
    return Fading(first, np.vstack([taken(quick[None]), taken(slow[:, None])]))


def _envelope(outputs: Outputs, box: Array, units: Array) -> tuple[Array, Array]:
    """The largest outputs within stretches that end at `ends`, (stretches,) and (stretches, r); never quite zero."""
    blocks, X, top, faded = [], box, 0.0, 0.0
    modes = None
    while len(blocks) * BLOCK < LONGEST_FADE:
        block = _sizes(outputs.stack, X).reshape(BLOCK, len(units)) / units
        blocks.append(block)
        top = max(top, float(block.max(initial=0.0)))
        faded = FADED * min(top, 1.0)
        if float(block.max(initial=0.0)) <= faded:
            break
        X = outputs.power @ X
        if len(blocks) == WATCHED and (modes := _modes(outputs, X, units)) is not None:
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


def _sizes(rows: Array, X: Array) -> Array:
    """How large each row of a product gets for columns of which any |share| ≤ 1; some rows at a time, for the cache."""
    found, each = np.empty(len(rows)), np.ones(X.shape[1])
    few = max(1, AT_HAND // X.shape[1])
    room = np.empty((few, X.shape[1]))
    for k in range(0, len(rows), few):
        some = rows[k : k + few]
        product = np.matmul(some, X, out=room[: len(some)])
        np.abs(product, out=product).dot(each, out=found[k : k + few])
    return found


def _modes(outputs: Outputs, X: Array, units: Array) -> tuple[Array, Array] | None:
    """Sizes (r, n) and rates (n,) with |C M^k X| <= sizes rate^k, mode by mode; None where these are too alike."""
    if outputs.modes is None:
        return None
    values, vectors = outputs.modes
    weights = np.abs(np.linalg.solve(vectors, X)).sum(axis=1)
    return np.abs(outputs.C @ vectors) * weights / units[:, None], np.abs(values)


def _reaches(outputs: Outputs, B: Array) -> NDArray[np.bool_]:
    """Which outputs an input reaches through the state at all, (r, d)."""
    seen = np.abs((outputs.stack @ B).reshape(-1, len(outputs.C), B.shape[1])).max(axis=0)
    return np.asarray(seen > 0)
