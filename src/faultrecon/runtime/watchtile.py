# SPDX-License-Identifier: BSD-3-Clause
"""What a watch does with many samples at once: their errors, and, while nothing happens, all of their tests.

Part of the loop of a watch, in its layout and compiled with it; see `watchloop`.  Side by side is what processors are
quick at, so the errors of a tile of samples are computed signal by signal, and samples of which there is nothing to
tell go through one filter after the other.  The bits are those of one sample after the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.runtime.watchrest import FAR

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
            values[k, j] = fault[j, begin + k]
            wild += 0 if abs(fault[j, begin + k]) <= cut[j] else 1
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


def settled_tile(
    live: Array,
    values: Array,
    begin: int,
    end: int,
    q: int,
    poles: Array,
    inverse: Array,
    filters: Array,
    tops: Array,
    peak: Array,
    own: Array,
) -> float:
    """Plain samples that nothing is left for: what the filters come to, the largest shares, and the largest of all.

    What is written does with many samples what `settled_way` does with one.
    """
    for s in range(filters.shape[0]):
        keeps, takes = poles[s], 1.0 - poles[s]
        for e in range(filters.shape[1]):
            filters[s, e] = live[s, e]
        for k in range(end - begin):
            for e in range(filters.shape[1]):
                filters[s, e] = keeps * filters[s, e] + takes * values[k, e]
                share = abs(filters[s, e]) * inverse[s, e]
                tops[k, e] = share if s == 0 or share > tops[k, e] else tops[k, e]
    most = 0.0
    for k in range(end - begin):
        largest = 0.0
        for e in range(q):
            largest = tops[k, e] if tops[k, e] > largest else largest
        own[begin + k, 0] = largest
        for e in range(q, filters.shape[1]):
            largest = tops[k, e] if tops[k, e] > largest else largest
        peak[begin + k, 0] = largest
        most = largest if largest > most else most
    return most


def tell_tile(
    live: Array,
    filters: Array,
    fault: Array,
    begin: int,
    end: int,
    bound: Array,
    poles: Array,
    faded: Array,
    off: Array,
    size: Array,
) -> None:
    """What is said of plain samples whose tests all hold."""
    for s in range(filters.shape[0]):
        for e in range(filters.shape[1]):
            live[s, e] = filters[s, e]
    last, keeps = live.shape[0] - 1, 1.0 - (1.0 - poles[poles.shape[0] - 1])
    for k in range(begin, end):
        faded[k, 0] = 1.0
    for j in range(fault.shape[0]):
        past = live[last, j]
        for k in range(begin, end):
            past = max(past * keeps, abs(fault[j, k]))
            off[k, j] = bound[j]
            size[k, j] = past + bound[j]
        live[last, j] = past
