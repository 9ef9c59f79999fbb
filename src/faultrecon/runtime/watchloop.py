# SPDX-License-Identifier: BSD-3-Clause
"""The loop of a watch over its samples: plain Python that is also compiled as it stands; both give the same bits.

`live` (4 scales + 5, errors + 1) is what a watch remembers, row by row, a column for each error and the last for the ζ
of the bounds: what each filter holds of each error; how far that may be off for what was not known, in bounds; what was
cut off above and below before it was filtered; what is left of the start and of absences, a quick and a slow part of
each, in bounds; how large the faults have been, and what the last sample lacked.

An error is cut off where it goes beyond CUT bounds, so that one wild sample does not fill a filter.  What the filter
would have held without that is its content plus what was cut off above less what was cut off below, so neither the
content less the latter nor the negative of the content less the former can lie above what is allowed.

Complete samples take short ways, on which every step is the same for all errors side by side: that is what processors
are quick at.  Where nothing is left of a start or of an absence, whole tiles of them go together, see `watchtile`.  All
others take the long way, which knows every case.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.runtime.watchrest import FAR, GONE, add, begin_anew, fade, fall_silent, miss, remember, rest_of
from faultrecon.runtime.watchtile import (
    clip_tile,
    find_errors,
    known,
    regular,
    settled_tile,
    surely,
    tell_tile,
    worst_of,
)

Array = NDArray[Any]

SETTLED = 4.0  # bounds: an error of whose start more is left is not tested; less widens the tests by as much
CUT = 10.0  # bounds: where a residual is cut off before it is averaged
FAST = 0.5  # sample times: samples closer to the one before are not tested, as tests are made for the sample time
TILE = 128  # samples whose errors are computed together
NOTHING, CLIPPED, LITTLE, MUCH = 0, 1, 2, 3  # what is left to be accounted for

CONSTANTS = {"SETTLED": SETTLED, "CUT": CUT, "FAR": FAR, "GONE": GONE, "FAST": FAST, "TILE": TILE}
CONSTANTS |= {"NOTHING": NOTHING, "CLIPPED": CLIPPED, "LITTLE": LITTLE, "MUCH": MUCH}


def rows_of(scales: int) -> int:
    """How many rows `live` has."""
    return 4 * scales + 5


def pass_over(
    y: Array,
    u: Array,
    state: Array,
    fault: Array,
    pace: Array,
    reads: Array,
    offsets: Array,
    weights: Array,
    limits: Array,
    poles: Array,
    bound: Array,
    diverges: Array,
    rate: Array,
    anew: Array,
    lost: Array,
    skipped: Array,
    unfed: Array,
    live: Array,
    shares: Array,
    peak: Array,
    own: Array,
    nis: Array,
    faded: Array,
    off: Array,
    size: Array,
) -> int:
    """One pass over the samples; the last eight are written: `live`, and what `Findings` says of one watch.

    y (p, N), u (m, N), state (n, N), fault (q, N), pace (3, N): rows missing before the sample, sample times since the
    one before, at most 1, and 1 where it lacks nothing.  offsets (p,) and reads (k, 3): what sensor i shows is expected
    to be offsets[i] and, by the rows [i, j, c] in order of i, c times what [x; u] has at j.  limits (scales, errors):
    FAR where nothing is tested.  diverges (p + 2,): 1 for each sensor without which the error grows, for several, and
    where gaps count times what is left in ζ.  rate, anew (4, errors + 1); lost, skipped, unfed (2 k, errors + 1): what
    a silent sensor, so many missing rows, a missing input add, quick and slow.
    """
    rows, scales, errors, q = y.shape[1], limits.shape[0], limits.shape[1], fault.shape[0]
    held, one, values, tops = np.empty(live.shape), np.empty(TILE), np.empty((TILE, errors)), np.empty((TILE, errors))
    told, inverse, begun = np.empty((TILE, scales * errors)), np.empty(limits.shape), np.empty(limits.shape)
    cut, top, largest = np.empty(errors), np.empty(errors), 0.0
    held[:] = live
    for e in range(errors):
        cut[e] = CUT * limits[0, e]
        for s in range(scales):
            inverse[s, e] = 1.0 / limits[s, e]
    owing = owes(held, limits)
    for begin in range(0, rows, TILE):
        end = min(begin + TILE, rows)
        wild = find_errors(y, u, state, fault, reads, offsets, weights, limits, cut, begin, end, one, values, nis)
        if owing <= CLIPPED and regular(pace, begin, end) and (wild == 0 or known(values, end - begin)):
            clips = owing == CLIPPED or wild > 0
            detail = clips or largest > 1.0
            begun[:] = held[:scales, :errors]
            settled_tile(held, values, end - begin, poles, inverse, detail, told, tops)
            if clips:
                clip_tile(held, begun, values, end - begin, poles, limits, inverse, cut, told, tops)
                owing = owes(held, limits)
            largest = worst_of(tops, begin, end, q, peak, own)
            if largest > 1.0 and not detail:
                held[:scales, :errors] = begun
                settled_tile(held, values, end - begin, poles, inverse, True, told, tops)
            tell_tile(held, fault, begin, end, bound, poles, told, peak, shares, faded, off, size)
            continue
        for k in range(begin, end):
            value = values[k - begin]
            plain = pace[2, k] == 1.0 and pace[1, k] == 1.0 and pace[0, k] == 0.0 and within(value, cut)
            faded[k, 0] = 1.0
            if plain and owing == NOTHING:
                settled_way(held, value, poles, inverse, top)
            elif plain and owing == LITTLE:
                fading_way(held, value, poles, limits, rate, top)
                owing = owes(held, limits)
            else:
                left = 4.0 * GONE + rest_of(held, scales, errors)
                fade(held, scales, pace[1, k], rate)
                if pace[2, k] != 1.0 or pace[0, k] != 0.0 or held[4 * scales + 4, errors] != 0.0:
                    miss(held, scales, y[:, k], u[:, k], pace[0, k], left, diverges, anew, lost, skipped, unfed)
                faded[k, 0] = long_way(held, value, pace[0, k], pace[1, k], poles, cut, limits, inverse, q, top)
                owing = owes(held, limits)
            largest = 0.0
            for e in range(errors):
                if e == q:
                    own[k, 0] = largest
                largest = top[e] if top[e] > largest else largest
            peak[k, 0] = largest
            if largest > 1.0:
                tell_shares(held, limits, inverse, top, shares[k])
            remember(held, fault, k, pace[1, k], bound, poles, off, size)
    live[:] = held
    return 0


def within(value: Array, cut: Array) -> bool:
    """Whether every error is a number that need not be cut off."""
    count = 0
    for e in range(value.shape[0]):
        count += 1 if abs(value[e]) <= cut[e] else 0
    return count == value.shape[0]


def owes(live: Array, limits: Array) -> int:
    """How much is left to be accounted for: nothing, what was cut off alone, little, so that every test is made as
    usual, or much.
    """
    scales, errors = limits.shape[0], limits.shape[1]
    owed, cut, most = 0.0, 0.0, 0.0
    for e in range(live.shape[1]):
        rest = 0.0
        for part in range(4 * scales, 4 * scales + 4):
            rest += live[part, e]
        if e < errors and limits[0, e] < FAR:
            most = rest if rest > most else most
        owed += rest
        for s in range(scales):
            owed += live[scales + s, e]
            cut += live[2 * scales + s, e] + live[3 * scales + s, e]
    if most > SETTLED or live[4 * scales + 4, errors] != 0.0:
        return MUCH
    if cut > 0.0:
        return MUCH if owed > 0.0 else CLIPPED
    return LITTLE if owed > 0.0 else NOTHING


def settled_way(live: Array, value: Array, poles: Array, inverse: Array, top: Array) -> None:
    """The errors of a plain sample into their filters; top (errors,): the largest share of each, in bounds."""
    for e in range(value.shape[0]):
        top[e] = 0.0
    for s in range(inverse.shape[0]):
        takes = 1.0 - poles[s]
        keeps = 1.0 - takes
        for e in range(value.shape[0]):
            live[s, e] = keeps * live[s, e] + takes * value[e]
            share = abs(live[s, e]) * inverse[s, e]
            top[e] = share if share > top[e] else top[e]


def fading_way(live: Array, value: Array, poles: Array, limits: Array, rate: Array, top: Array) -> None:
    """The same while a little of the start is left of every error."""
    scales = limits.shape[0]
    for part in range(4):
        for e in range(live.shape[1]):
            rest = live[4 * scales + part, e] * rate[part, e]
            live[4 * scales + part, e] = rest if rest > GONE * (1.0 - rate[part, e]) else 0.0
    for e in range(value.shape[0]):
        top[e] = 0.0
    for s in range(scales):
        takes = 1.0 - poles[s]
        keeps = 1.0 - takes
        for e in range(value.shape[0]):
            rest = live[4 * scales, e] + live[4 * scales + 1, e] + live[4 * scales + 2, e] + live[4 * scales + 3, e]
            live[s, e] = keeps * live[s, e] + takes * value[e]
            owed = keeps * live[scales + s, e] + takes * rest
            live[scales + s, e] = owed if owed > GONE * takes else 0.0
            share = abs(live[s, e]) / (limits[s, e] + limits[0, e] * live[scales + s, e])
            top[e] = share if share > top[e] else top[e]


def long_way(
    live: Array,
    value: Array,
    gap: float,
    elapsed: float,
    poles: Array,
    cut: Array,
    limits: Array,
    inverse: Array,
    q: int,
    top: Array,
) -> float:
    """The same for any sample; 1 where nothing is left untested and some sensor is heard, of those that are tested."""
    scales, settled, tested, heard = limits.shape[0], 1.0, 0, 0
    for e in range(value.shape[0]):
        top[e] = 0.0
        if limits[0, e] >= FAR:
            continue
        tested += 1 if e >= q else 0
        rest = rest_of(live, scales, e)
        if rest > SETTLED:
            settled = 0.0
            for s in range(scales):  # a filter that begins late may be off by all that it would have held
                live[s, e], live[scales + s, e] = 0.0, limits[s, e] / limits[0, e]
                live[2 * scales + s, e], live[3 * scales + s, e] = 0.0, 0.0
            continue
        for _ in range(int(min(gap, 1000.0))):
            wait(live, e, rest, 1.0, poles)
        if not math.isfinite(value[e]):
            wait(live, e, rest, elapsed, poles)
            continue
        heard += 1 if e >= q else 0
        most = cut[e] * (1.0 + rest)
        over, under = max(value[e] - most, 0.0), max(-most - value[e], 0.0)
        for s in range(scales):
            takes = 1.0 if poles[s] == 0.0 else elapsed * (1.0 - poles[s])
            keeps = 1.0 - takes
            if poles[s] == 0.0:  # one sample says one thing
                live[s, e] = keeps * live[s, e] + takes * value[e]
            else:
                live[s, e] = keeps * live[s, e] + takes * min(max(value[e], -most), most)
                least = GONE * takes * limits[0, e]
                more = keeps * live[2 * scales + s, e] + takes * over
                live[2 * scales + s, e] = more if more > least else 0.0
                more = keeps * live[3 * scales + s, e] + takes * under
                live[3 * scales + s, e] = more if more > least else 0.0
            more = keeps * live[scales + s, e] + takes * rest
            live[scales + s, e] = more if more > GONE * takes else 0.0
            top[e] = max(top[e], share_of(live, s, e, limits, inverse))
    if elapsed < FAST:
        for e in range(value.shape[0]):
            top[e] = 0.0
        return 0.0
    return settled if heard > 0 or tested == 0 else 0.0


def share_of(live: Array, s: int, e: int, limits: Array, inverse: Array) -> float:
    """How much of its bound a filtered error uses up."""
    scales = limits.shape[0]
    size, owed = surely(live[s, e], live[2 * scales + s, e], live[3 * scales + s, e]), live[scales + s, e]
    return min(size * inverse[s, e] if owed == 0.0 else size / (limits[s, e] + limits[0, e] * owed), FAR)


def tell_shares(live: Array, limits: Array, inverse: Array, top: Array, shares: Array) -> None:
    """All shares of a sample, scale by scale; 0 where nothing can be said."""
    scales, errors = limits.shape[0], limits.shape[1]
    for e in range(errors):
        for s in range(scales):
            shares[s * errors + e] = share_of(live, s, e, limits, inverse) if top[e] > 0.0 else 0.0


def wait(live: Array, e: int, rest: float, elapsed: float, poles: Array) -> None:
    """One sample on without the error: it might have been anything within its bound."""
    scales = poles.shape[0] - 1
    for s in range(scales):
        takes = 1.0 if poles[s] == 0.0 else elapsed * (1.0 - poles[s])
        live[s, e] = (1.0 - takes) * live[s, e]
        live[scales + s, e] = (1.0 - takes) * live[scales + s, e] + takes * (1.0 + rest)
        live[2 * scales + s, e] = (1.0 - takes) * live[2 * scales + s, e]
        live[3 * scales + s, e] = (1.0 - takes) * live[3 * scales + s, e]


LOOP = (
    within,
    rest_of,
    remember,
    fade,
    add,
    begin_anew,
    fall_silent,
    miss,
    find_errors,
    regular,
    known,
    surely,
    settled_tile,
    clip_tile,
    worst_of,
    tell_tile,
    owes,
    share_of,
    tell_shares,
    wait,
    settled_way,
    fading_way,
    long_way,
    pass_over,
)
"""The functions of the loop, each after those it calls."""
