# SPDX-License-Identifier: BSD-3-Clause
"""What is left of the start and of absences: how it fades, and what silence, gaps and missing inputs add to it.

Part of the loop of a watch, in its layout and compiled with it; see `watchloop`.  What is left is forgotten once a
share of GONE for each step is left: all that was ever forgotten of it never counts for more than GONE, and `forgiving`
says by how much the limits have to be wider for it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

FAR = 1e30  # bounds: where counting ends
GONE = 1e-4  # bounds: what may be forgotten in all of what is left of a start; the limits make up for it
FORGOTTEN = 6.0  # times GONE: of four parts of what is left, of what is owed, and of what was cut off


def forgiving(steady: Array) -> Array:
    """Limits (scales, errors) with room for what is forgotten."""
    return np.asarray(steady + FORGOTTEN * GONE * steady[0])


def rest_of(live: Array, scales: int, e: int) -> float:
    """What is left of the start and of absences, in bounds."""
    top = 4 * scales
    return live[top, e] + live[top + 1, e] + live[top + 2, e] + live[top + 3, e]


def fade(live: Array, scales: int, elapsed: float, rate: Array) -> None:
    """What is left of everything after so much of a sample time."""
    for part in range(4):
        for e in range(rate.shape[1]):
            keeps = 1.0 - elapsed * (1.0 - rate[part, e])  # no less than rate^elapsed
            rest = live[4 * scales + part, e] * keeps
            live[4 * scales + part, e] = rest if rest > GONE * (1.0 - keeps) else 0.0


def add(live: Array, top: int, table: Array, row: int, share: float) -> bool:
    """Two rows of a table, share times, to what is left of absences; False where they are not finite."""
    finite = True
    for e in range(live.shape[1]):
        finite = finite and table[row, e] < math.inf and table[row + 1, e] < math.inf
    if finite:
        for part in range(2):
            for e in range(live.shape[1]):
                live[top + 2 + part, e] = min(live[top + 2 + part, e] + table[row + part, e] * share, FAR)
    return finite


def begin_anew(live: Array, top: int, anew: Array) -> None:
    """At least as much is left as of an observer at rest."""
    for part in range(4):
        for e in range(live.shape[1]):
            live[top + part, e] = max(live[top + part, e], anew[part, e])


def fall_silent(
    live: Array, scales: int, y: Array, silent: int, share: float, diverges: Array, anew: Array, lost: Array
) -> None:
    """What the sensors that are silent add, share times."""
    p, top, last, grows = y.shape[0], 4 * scales, live.shape[1] - 1, 0.0
    for i in range(p):
        if not math.isfinite(y[i]):
            grows = max(grows, diverges[i])
    if silent > 1:
        grows = max(grows, diverges[p])
    if grows == 0.0:
        share = min(share, 1.0 + anew[0, last] + anew[1, last])
    for e in range(last + 1):
        largest = FAR if grows > 0.0 else anew[0, e] + anew[1, e]
        if rest_of(live, scales, e) > largest:
            live[top, e], live[top + 1, e], live[top + 2, e], live[top + 3, e] = 0.0, largest, 0.0, 0.0
    for i in range(p):
        if math.isfinite(y[i]) or add(live, top, lost, 2 * i, share):
            continue
        if grows > 0.0:
            for e in range(last + 1):
                live[top + 1, e] = FAR
        else:
            begin_anew(live, top, anew)


def miss(
    live: Array,
    scales: int,
    y: Array,
    u: Array,
    gap: float,
    left: float,
    diverges: Array,
    anew: Array,
    lost: Array,
    skipped: Array,
    unfed: Array,
) -> None:
    """What is added by rows that are missing, and by what this sample and the one before it lack.

    left: of everything in ζ, at the sample before.
    """
    top, last = 4 * scales, live.shape[1] - 1
    sensors, inputs, before = 0, 0, int(live[top + 4, last])
    for i in range(y.shape[0]):
        sensors += 0 if math.isfinite(y[i]) else 1
    for i in range(u.shape[0]):
        inputs += 0 if math.isfinite(u[i]) else 1
    lacks = (1 if sensors else 0) + (2 if inputs else 0)
    live[top + 4, last] = lacks
    row = 2 * (int(min(gap, 1e6)) - 1)
    known = gap == 0.0 or (lacks == 0 and before == 0 and 0 <= row < skipped.shape[0])
    if lacks == 3 or (lacks > 0 and before > 0 and before != lacks):
        known = False  # what sensors and inputs do to each other is not accounted for
    if known and gap > 0.0:
        known = add(live, top, skipped, row, 1.0 + float(diverges[y.shape[0] + 1]) * left)
    if sensors:
        fall_silent(live, scales, y, sensors, 1.0 + left, diverges, anew, lost)
    for i in range(u.shape[0]):
        if not math.isfinite(u[i]):
            known = add(live, top, unfed, 2 * i, 1.0) and known
    if not known:
        begin_anew(live, top, anew)


def remember(
    live: Array, fault: Array, k: int, elapsed: float, bound: Array, poles: Array, off: Array, size: Array
) -> None:
    """How far each estimate may be off, and how large the faults have been at most."""
    last = live.shape[0] - 1
    for j in range(fault.shape[0]):
        rest = live[last - 4, j] + live[last - 3, j] + live[last - 2, j] + live[last - 1, j]
        off[k, j] = bound[j] * (1.0 + rest) if rest < FAR else math.inf
        past = live[last, j] * (1.0 - elapsed * (1.0 - poles[poles.shape[0] - 1]))
        if math.isfinite(fault[j, k]):
            past = max(past, abs(fault[j, k]))
        live[last, j] = past
        size[k, j] = past + off[k, j]
