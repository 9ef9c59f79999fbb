# SPDX-License-Identifier: BSD-3-Clause
"""The loop of a watch over its samples: plain Python that is also compiled as it stands; both give the same bits.

`live` (2 scales + 3, errors + 1) is what a watch remembers, row by row: what each filter holds of each error; how far
it may be off because of the start, in bounds; what is left of the start, its quick and its slow part; how large the
faults have been.  The last column is for the ζ of the bounds.

What is left of a start is forgotten once a share of GONE for each step is left: all that was ever forgotten of it never
counts for more than GONE, and `forgiving` says by how much the limits have to be wider for it.

Complete samples take short ways, on which every step is the same for all errors side by side: that is what processors
are quick at.  All others take the long way, which knows every case.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

SETTLED = 1.0  # bounds: an error of whose start more is left is not tested; less widens the tests by as much
CUT = 10.0  # bounds: where a residual is cut off before it is averaged
FAR = 1e30  # bounds: where counting ends
GONE = 1e-4  # bounds: what may be forgotten in all of what is left of a start; the limits make up for it
TILE = 128  # samples whose errors are computed together
NOTHING, LITTLE, MUCH = 0, 1, 2  # what is left of the start

CONSTANTS = {"SETTLED": SETTLED, "CUT": CUT, "FAR": FAR, "GONE": GONE, "TILE": TILE}
CONSTANTS |= {"NOTHING": NOTHING, "LITTLE": LITTLE, "MUCH": MUCH}


def forgiving(steady: Array) -> Array:
    """Limits (scales, errors) with room for what is forgotten: of both parts of the start, and in a filter."""
    return np.asarray(steady + 3.0 * GONE * steady[0])


def pass_over(
    y: Array,
    u: Array,
    state: Array,
    fault: Array,
    reads: Array,
    offsets: Array,
    limits: Array,
    poles: Array,
    bound: Array,
    gap: Array,
    whole: Array,
    diverges: Array,
    rate: Array,
    anew: Array,
    lost: Array,
    live: Array,
    shares: Array,
    peak: Array,
    own: Array,
    faded: Array,
    off: Array,
    size: Array,
) -> int:
    """One pass over the samples; the last seven are written: `live`, and what `Findings` says of one watch.

    y (p, N), u (m, N), state (n, N), fault (q, N).  offsets (p,) and reads (k, 3): what sensor i shows is expected to be
    offsets[i] and, by the rows [i, j, c] in order of i, c times what [x; u] has at j.  limits (scales, errors): FAR
    where nothing is tested.
    """
    rows, scales, errors, q = y.shape[1], limits.shape[0], limits.shape[1], fault.shape[0]
    held, one, values = np.empty(live.shape), np.empty(TILE), np.empty((TILE, errors))
    inverse, cut, top = np.empty(limits.shape), np.empty(errors), np.empty(errors)
    held[:] = live
    for e in range(errors):
        cut[e] = CUT * limits[0, e]
        for s in range(scales):
            inverse[s, e] = 1.0 / limits[s, e]
    owing = owes(held, limits)
    for begin in range(0, rows, TILE):
        end = min(begin + TILE, rows)
        find_errors(y, u, state, fault, reads, offsets, limits, begin, end - begin, one, values)
        for k in range(begin, end):
            value, complete = values[k - begin], whole[k] == 1.0 and gap[k] == 0.0
            for j in range(q):
                complete = complete and math.isfinite(fault[j, k])
            faded[k, 0] = 1.0
            if complete and owing == NOTHING:
                settled_way(held, value, poles, cut, inverse, top)
            elif complete and owing == LITTLE:
                fading_way(held, value, poles, cut, limits, rate, top)
                owing = owes(held, limits)
            else:
                fade(held, 2 * scales, u[:, k], gap[k], rate, anew)
                fall_silent(held, 2 * scales, y[:, k], diverges, anew, lost)
                faded[k, 0] = long_way(held, value, poles, cut, inverse, limits, top)
                owing = owes(held, limits)
            largest = 0.0
            for e in range(errors):
                if e == q:
                    own[k, 0] = largest
                largest = top[e] if top[e] > largest else largest
            peak[k, 0] = largest
            if largest > 1.0:
                tell_shares(held, inverse, limits, top, shares[k])
            remember(held, fault, k, bound, poles, off, size)
    live[:] = held
    return 0


def find_errors(
    y: Array,
    u: Array,
    state: Array,
    fault: Array,
    reads: Array,
    offsets: Array,
    limits: Array,
    begin: int,
    rows: int,
    one: Array,
    values: Array,
) -> None:
    """The faults, and what each tested sensor shows beyond what the estimate expects; one (TILE,) to work on."""
    n, q, r = state.shape[0], fault.shape[0], 0
    for j in range(q):
        for k in range(rows):
            values[k, j] = fault[j, begin + k]
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


def owes(live: Array, limits: Array) -> int:
    """How much is left of the start: nothing, little, so that all that can be tested is, or much."""
    scales, owed, most = limits.shape[0], 0.0, 0.0
    for e in range(live.shape[1]):
        rest = live[2 * scales, e] + live[2 * scales + 1, e]
        if e < limits.shape[1] and limits[0, e] < FAR:
            most = rest if rest > most else most
        owed += rest
        for s in range(scales, 2 * scales):
            owed += live[s, e]
    if most > SETTLED:
        return MUCH
    return LITTLE if owed > 0.0 else NOTHING


def settled_way(live: Array, value: Array, poles: Array, cut: Array, inverse: Array, top: Array) -> None:
    """The errors of a complete sample into their filters; top (errors,): the largest share of each, in bounds."""
    for e in range(value.shape[0]):
        top[e] = 0.0
        value[e] = value[e] if value[e] < cut[e] else cut[e]
        value[e] = value[e] if value[e] > -cut[e] else -cut[e]
    for s in range(inverse.shape[0]):
        keeps, takes = poles[s], 1.0 - poles[s]
        for e in range(value.shape[0]):
            live[s, e] = keeps * live[s, e] + takes * value[e]
            share = abs(live[s, e]) * inverse[s, e]
            top[e] = share if share > top[e] else top[e]


def fading_way(live: Array, value: Array, poles: Array, cut: Array, limits: Array, rate: Array, top: Array) -> None:
    """The same while a little of the start is left of every error."""
    scales = limits.shape[0]
    for part in range(2):
        for e in range(live.shape[1]):
            rest = live[2 * scales + part, e] * rate[part, e]
            live[2 * scales + part, e] = rest if rest > GONE * (1.0 - rate[part, e]) else 0.0
    for e in range(value.shape[0]):
        top[e] = 0.0
        most = cut[e] * (1.0 + (live[2 * scales, e] + live[2 * scales + 1, e]))
        value[e] = value[e] if value[e] < most else most
        value[e] = value[e] if value[e] > -most else -most
    for s in range(scales):
        keeps, takes = poles[s], 1.0 - poles[s]
        for e in range(value.shape[0]):
            live[s, e] = keeps * live[s, e] + takes * value[e]
            owed = keeps * live[scales + s, e] + takes * (live[2 * scales, e] + live[2 * scales + 1, e])
            live[scales + s, e] = owed if owed > GONE * takes else 0.0
            share = abs(live[s, e]) / (limits[s, e] + limits[0, e] * live[scales + s, e])
            top[e] = share if share > top[e] else top[e]


def long_way(live: Array, value: Array, poles: Array, cut: Array, inverse: Array, limits: Array, top: Array) -> float:
    """The same for any sample, with what is owed to the start beside it; 1 where nothing is left untested."""
    scales, faded = inverse.shape[0], 1.0
    for e in range(value.shape[0]):
        top[e] = 0.0
        if limits[0, e] >= FAR:
            continue
        rest = live[2 * scales, e] + live[2 * scales + 1, e]
        if rest > SETTLED:
            faded = 0.0
            for s in range(scales):  # a filter that begins late may be off by all that it would have held
                live[s, e], live[scales + s, e] = 0.0, limits[s, e] / limits[0, e]
            continue
        if not math.isfinite(value[e]):
            wait(live, e, rest, poles)
            continue
        most = cut[e] * (1.0 + rest)
        taken = min(max(value[e], -most), most)
        for s in range(scales):
            live[s, e] = poles[s] * live[s, e] + (1.0 - poles[s]) * taken
            more = poles[s] * live[scales + s, e] + (1.0 - poles[s]) * rest
            live[scales + s, e] = more if more > GONE * (1.0 - poles[s]) else 0.0
            top[e] = max(top[e], share_of(live, s, e, inverse, limits))
    return faded


def share_of(live: Array, s: int, e: int, inverse: Array, limits: Array) -> float:
    """How much of its bound a filtered error uses up."""
    owed = live[inverse.shape[0] + s, e]
    if owed == 0.0:
        return abs(live[s, e]) * inverse[s, e]
    return abs(live[s, e]) / (limits[s, e] + limits[0, e] * owed)


def tell_shares(live: Array, inverse: Array, limits: Array, top: Array, shares: Array) -> None:
    """All shares of a sample, scale by scale; 0 where nothing can be said."""
    scales, errors = inverse.shape[0], inverse.shape[1]
    for e in range(errors):
        for s in range(scales):
            shares[s * errors + e] = share_of(live, s, e, inverse, limits) if top[e] > 0.0 else 0.0


def fade(live: Array, top: int, u: Array, gap: float, rate: Array, anew: Array) -> None:
    """What is left of the start after one more sample; all of it where a row or an input is missing."""
    lacks = gap != 0.0
    for i in range(u.shape[0]):
        lacks = lacks or not math.isfinite(u[i])
    for part in range(2):
        for e in range(rate.shape[1]):
            rest = live[top + part, e] * rate[part, e]
            if lacks and anew[part, e] > rest:
                rest = anew[part, e]
            live[top + part, e] = rest if rest > GONE * (1.0 - rate[part, e]) else 0.0


def fall_silent(live: Array, top: int, y: Array, diverges: Array, anew: Array, lost: Array) -> None:
    """What the sensors that are silent add to it."""
    p, last = y.shape[0], live.shape[1] - 1
    silent, grows = 0, 0.0
    for i in range(p):
        if not math.isfinite(y[i]):
            silent += 1
            grows = max(grows, diverges[i])
    if silent > 1:
        grows = max(grows, diverges[p])
    if silent == 0:
        return
    for e in range(last + 1):
        largest = FAR if grows > 0.0 else anew[0, e] + anew[1, e]
        if live[top, e] + live[top + 1, e] > largest:
            live[top, e], live[top + 1, e] = 0.0, largest
    for i in range(p):
        if not math.isfinite(y[i]):
            share = 1.0 + 2.0 * GONE + live[top, last] + live[top + 1, last]
            for e in range(last + 1):
                live[top + 1, e] = min(live[top + 1, e] + lost[i, e] * share, FAR)


def wait(live: Array, e: int, rest: float, poles: Array) -> None:
    """One sample on without the error: it might have been anything within its bound."""
    scales = poles.shape[0] - 1
    for s in range(scales):
        live[s, e] = poles[s] * live[s, e]
        live[scales + s, e] = poles[s] * live[scales + s, e] + (1.0 - poles[s]) * (1.0 + rest)


def remember(live: Array, fault: Array, k: int, bound: Array, poles: Array, off: Array, size: Array) -> None:
    """How far each estimate may be off, and how large the faults have been at most."""
    last = live.shape[0] - 1
    for j in range(fault.shape[0]):
        rest = live[last - 2, j] + live[last - 1, j]
        off[k, j] = bound[j] * (1.0 + rest) if rest < FAR else math.inf
        past = live[last, j] * poles[poles.shape[0] - 1]
        if math.isfinite(fault[j, k]):
            past = max(past, abs(fault[j, k]))
        live[last, j] = past
        size[k, j] = past + off[k, j]


LOOP = (
    fade,
    fall_silent,
    find_errors,
    owes,
    share_of,
    tell_shares,
    wait,
    settled_way,
    fading_way,
    long_way,
    remember,
    pass_over,
)
"""The functions of the loop, each after those it calls."""
