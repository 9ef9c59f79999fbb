# SPDX-License-Identifier: BSD-3-Clause
"""What a watch does with many samples at once: their errors, and, where nothing is missing, all of their tests.

Part of the loop of a watch, in its layout and compiled with it; see `watchloop`.  Side by side is what processors are
quick at, so the errors of a tile of samples are computed signal by signal, and go through one filter after the other
where nothing is left of a start or of an absence.  The bits are those of one sample after the other.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.runtime.watchrest import FAR, GONE, remember

Array = NDArray[Any]


def find_errors(
    y: Array,
    u: Array,
    state: Array,
    fault: Array,
    reads: Array,
    offsets: Array,
    weights: Array,
    limits: Array,
    cut: Array,
    begin: int,
    end: int,
    one: Array,
    values: Array,
    nis: Array,
) -> int:
    """The faults, and what each tested sensor shows beyond what the estimate expects; one (TILE,) to work on.

    How many of these errors are to be cut off, or no numbers, comes back.
    """
    n, q, r, wild = state.shape[0], fault.shape[0], 0, 0
    rows = end - begin
    squares = np.zeros(rows)
    for j in range(q):
        for k in range(rows):
            values[k, j] = fault[j, begin + k] if limits[0, j] < FAR else 0.0
            wild += 0 if abs(values[k, j]) <= cut[j] else 1
    for i in range(y.shape[0]):
        for k in range(rows):
            one[k] = y[i, begin + k] - offsets[i] if limits[0, q + i] < FAR else 0.0
        while r < reads.shape[0] and int(reads[r, 0]) == i:
            j, c = int(reads[r, 1]), reads[r, 2]
            if j < n:
                for k in range(rows):
                    one[k] -= c * state[j, begin + k]
            else:
                for k in range(rows):
                    one[k] -= c * u[j - n, begin + k]
            r += 1
        for k in range(rows):
            values[k, q + i] = one[k]
        for k in range(rows):  # apart from the loop before, whose strides would slow it down
            wild += 0 if abs(one[k]) <= cut[q + i] else 1
            noise = one[k] * weights[i]
            squares[k] += noise * noise if abs(noise) < FAR else 0.0
    for k in range(rows):
        nis[begin + k, 0] = squares[k]
    return wild


def regular(pace: Array, begin: int, end: int) -> bool:
    """Whether samples lack nothing, and each came a sample time after the one before it."""
    count = 0
    for k in range(begin, end):
        count += 1 if pace[2, k] == 1.0 and pace[1, k] == 1.0 and pace[0, k] == 0.0 else 0
    return count == end - begin


def known(values: Array, rows: int) -> bool:
    """Whether every error is a number."""
    count = 0
    for k in range(rows):
        for e in range(values.shape[1]):
            count += 1 if abs(values[k, e]) < math.inf else 0
    return count == rows * values.shape[1]


def settled_tile(
    live: Array, values: Array, rows: int, poles: Array, inverse: Array, detail: bool, told: Array, tops: Array
) -> None:
    """The tests of errors that are not cut off: tops are the largest shares by error, told in detail all of them.

    It does with many samples what `settled_way` does with one; errors that are cut off are for `clip_tile` to mend.
    """
    scales, errors = inverse.shape[0], inverse.shape[1]
    for s in range(scales):
        takes = 1.0 - poles[s]
        keeps = 1.0 - takes
        for k in range(rows):
            for e in range(errors):
                live[s, e] = keeps * live[s, e] + takes * values[k, e]
                share = abs(live[s, e]) * inverse[s, e]
                if detail:
                    told[k, s * errors + e] = share
                tops[k, e] = share if s == 0 or share > tops[k, e] else tops[k, e]


def clip_tile(
    live: Array,
    begun: Array,
    values: Array,
    rows: int,
    poles: Array,
    limits: Array,
    inverse: Array,
    cut: Array,
    told: Array,
    tops: Array,
) -> None:
    """What `settled_tile` has done with errors that are, or have been, cut off, done again.

    begun: the filters before the tile.  It does with many samples what `long_way` does with one, as long as nothing but
    what was cut off is to be accounted for.
    """
    scales, errors = limits.shape[0], limits.shape[1]
    for e in range(errors):
        wild = 0
        for k in range(rows):
            wild += 0 if abs(values[k, e]) <= cut[e] else 1
        for s in range(scales):
            wild += 1 if live[2 * scales + s, e] + live[3 * scales + s, e] > 0.0 else 0
        if wild == 0:
            continue
        for s in range(scales):
            takes, most = 1.0 - poles[s], cut[e] if poles[s] != 0.0 else math.inf
            keeps, least = 1.0 - takes, GONE * takes * limits[0, e]
            held, over, under = begun[s, e], live[2 * scales + s, e], live[3 * scales + s, e]
            for k in range(rows):
                above, below = values[k, e] - most, -most - values[k, e]
                over = keeps * over + takes * (above if above > 0.0 else 0.0)
                over = over if over > least else 0.0
                under = keeps * under + takes * (below if below > 0.0 else 0.0)
                under = under if under > least else 0.0
                held = keeps * held + takes * (most if above > 0.0 else -most if below > 0.0 else values[k, e])
                share = min(surely(held, over, under) * inverse[s, e], FAR)
                told[k, s * errors + e] = share
                tops[k, e] = share if s == 0 or share > tops[k, e] else tops[k, e]
            live[s, e], live[2 * scales + s, e], live[3 * scales + s, e] = held, over, under


def surely(held: float, over: float, under: float) -> float:
    """How large a filtered error is for certain, whatever of it was cut off."""
    above, below = held - under, -held - over
    largest = above if above > below else below
    return largest if largest > 0.0 else 0.0


def worst_of(tops: Array, begin: int, end: int, q: int, peak: Array, own: Array) -> float:
    """The largest share of each sample, and of its faults, are written; the largest of all comes back."""
    most = 0.0
    for k in range(end - begin):
        largest = 0.0
        for e in range(q):
            largest = tops[k, e] if tops[k, e] > largest else largest
        own[begin + k, 0] = largest
        for e in range(q, tops.shape[1]):
            largest = tops[k, e] if tops[k, e] > largest else largest
        peak[begin + k, 0] = largest
        most = largest if largest > most else most
    return most


def tell_tile(
    live: Array,
    fault: Array,
    begin: int,
    end: int,
    bound: Array,
    poles: Array,
    told: Array,
    peak: Array,
    shares: Array,
    faded: Array,
    off: Array,
    size: Array,
) -> None:
    """What is said of samples that come at regular times, lack nothing, and leave nothing untested."""
    for k in range(begin, end):
        faded[k, 0] = 1.0
        if peak[k, 0] > 1.0:
            for test in range(told.shape[1]):
                shares[k, test] = told[k - begin, test]
        remember(live, fault, k, 1.0, bound, poles, off, size)
