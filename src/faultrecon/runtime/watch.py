# SPDX-License-Identifier: BSD-3-Clause
"""The tests of one observer: everything that it says about the plant, against what its bounds allow if all is well.

Do the sensors that it takes for healthy agree with it?  And is the fault that it reconstructs larger than nothing could
look?  Each error is tested as it is and behind low-pass filters, so that drifts below the noise are found too.  What
enters a filter is cut off at `CUT` times its bound: one wild sample says one thing, once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Inconclusive
from faultrecon.graph.compiled import Program, load, obstacle, plain_text
from faultrecon.plant.plant import Plant
from faultrecon.runtime.bounds import Bounds
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.samples import Trace

Array = NDArray[Any]

SETTLED = 1.0  # bounds: an error of whose start more is left is not tested; less widens the tests by as much
CUT = 10.0  # bounds: where a residual is cut off before it is averaged
FAR = 1e30  # bounds: where counting ends
GONE = 1e-12  # bounds: what is not worth counting, and would take the processor long
SIGNATURE = ", ".join(("table",) * 8 + ("vector",) * 5 + ("table",) * 3 + ("into",) * 3)


@dataclass(frozen=True, eq=False)
class Seen:
    """What one watch found over N samples.

    peak, own (N,): the largest of all tests, and of those on its own faults, in bounds.  faded (N,): 1 where nothing is
    left untested.  bound, amplitude (N, q): of the faults, how far the estimate may be off, and how large they have
    been at most, what is past counting for less and less.
    """

    peak: Array
    own: Array
    faded: Array
    bound: Array
    amplitude: Array


@dataclass(frozen=True, eq=False)
class Watch:
    """The tests of an estimator with its bounds on its plant; (scales, q + p) of them.

    memory: how much of the size of a past fault counts a sample later.
    poles: of the low-pass filters, the first 0.  `init` is the state before the first sample, (2 scales + 3, q + p +
    1): what the filters hold, how far they may be off, what is left of the start, its quick and its slow part, and
    how large the faults have been.  The last column is for the ζ of the bounds.
    """

    plant: Plant
    estimator: Estimator
    bounds: Bounds
    poles: tuple[float, ...]
    memory: float = 0.0
    compiled: bool = True
    _offsets: Array = field(init=False)

    def __post_init__(self) -> None:
        point = self.plant.point
        object.__setattr__(self, "_offsets", np.concatenate([point.y, point.x, point.u]))

    def init(self, blind: bool = False) -> Array:
        """Before the first sample; blind: that one lacks something, so that the estimator begins at rest."""
        scales = len(self.poles)
        live = np.zeros((2 * scales + 3, self.bounds.faults + self.plant.p + 1))
        begins = self.bounds.blind if blind else self.bounds.start
        live[2 * scales : 2 * scales + 2] = begins / self.bounds.rate  # the first sample is one step on from there
        return live

    @property
    def tests(self) -> int:
        """How many tests there are."""
        return self.limits.size

    @cached_property
    def limits(self) -> Array:
        """What each test allows, (scales, q + p); inf where nothing is tested: sensors that the faults reach."""
        limits = self.bounds.steady.copy()
        limits[:, self.bounds.faults :][:, np.any(self.plant.F_f != 0, axis=1)] = math.inf
        limits[limits == 0.0] = np.finfo(float).tiny
        return limits

    def look(self, live: Array, u: Array, y: Array, gap: Array, trace: Trace, shares: Array) -> tuple[Array, Seen]:
        """The tests over N samples and the state after them.

        gap (N,): 1 where rows are missing before the sample.  shares (N, tests) is written: how much of its bound each
        test uses up, scale by scale; above 1 is outside, 0 where nothing can be said.
        """
        b, plant, q = self.bounds, self.plant, self.bounds.faults
        live, out = live.copy(), np.empty((len(y), 3 + 2 * q))
        watch = _compiled() if self.compiled else _watch
        watch(
            *(y, u, trace.state, trace.fault, plant.C, plant.D, plant.F_f, self.limits),
            *(
                self._offsets,
                np.array([*self.poles, self.memory]),
                b.fault,
                gap,
                b.diverges,
                b.rate,
                b.anew,
                b.lost,
                live,
                shares,
                out,
            ),
        )
        return live, Seen(out[:, 0], out[:, 1], out[:, 2], out[:, 3 : 3 + q], out[:, 3 + q :])


@cache
def _compiled() -> Callable[..., Any]:
    """The loop as machine code where that can be had, else as it stands."""
    if obstacle():
        return _watch
    numbers = {"SETTLED": SETTLED, "CUT": CUT, "FAR": FAR, "GONE": GONE}
    parts = [
        f"@part\n{plain_text(one, **numbers)}" for one in (_fade, _fall_silent, _residual, _filter, _wait, _remember)
    ]
    text = "\n\n".join([*parts, f"@kernel(int64({SIGNATURE}), nogil=True)\n{plain_text(_watch, **numbers)}"])
    try:
        return load(Program(text))["_watch"]
    except Inconclusive:
        return _watch


def _watch(
    y: Array,
    u: Array,
    state: Array,
    fault: Array,
    C: Array,
    D: Array,
    F: Array,
    limits: Array,
    offsets: Array,
    poles: Array,
    bound: Array,
    gap: Array,
    diverges: Array,
    rate: Array,
    anew: Array,
    lost: Array,
    live: Array,
    shares: Array,
    out: Array,
) -> int:
    """One pass over the samples; `live`, `shares` and `out` are written."""
    rows, p, q = y.shape[0], C.shape[0], F.shape[1]
    scales = poles.shape[0] - 1
    for k in range(rows):
        _fade(live, 2 * scales, u[k], gap[k], rate, anew)
        _fall_silent(live, 2 * scales, y[k], diverges, anew, lost)
        peak, own, faded = 0.0, 0.0, 1.0
        for e in range(q + p):
            for s in range(scales):
                shares[k, s * (q + p) + e] = 0.0
            if limits[0, e] == math.inf:
                continue
            rest = live[2 * scales, e] + live[2 * scales + 1, e]
            if rest > SETTLED:
                faded = 0.0
                for s in range(scales):  # a filter that begins late may be off by all that it would have held
                    live[s, e], live[scales + s, e] = 0.0, limits[s, e] / limits[0, e]
                continue
            value = fault[k, e] if e < q else _residual(e - q, y[k], u[k], state[k], C, D, offsets)
            if not math.isfinite(value):
                _wait(live, e, rest, poles)
                continue
            _filter(live, e, value, rest, poles, limits)
            for s in range(scales):
                share = abs(live[s, e]) / (limits[s, e] + limits[0, e] * live[scales + s, e])
                shares[k, s * (q + p) + e] = share
                peak = max(peak, share)
                if e < q:
                    own = max(own, share)
        out[k, 0] = peak
        out[k, 1] = own
        out[k, 2] = faded
        _remember(live, out[k], fault[k], bound, poles)
    return 0


def _fade(live: Array, top: int, u: Array, gap: float, rate: Array, anew: Array) -> None:
    """What is left of the start after one more sample; all of it where a row or an input is missing."""
    lacks = gap != 0.0
    for i in range(u.shape[0]):
        lacks = lacks or not math.isfinite(u[i])
    for part in range(2):
        for e in range(rate.shape[1]):
            rest = live[top + part, e] * rate[part, e]
            if lacks and anew[part, e] > rest:
                rest = anew[part, e]
            live[top + part, e] = rest if rest > GONE else 0.0


def _fall_silent(live: Array, top: int, y: Array, diverges: Array, anew: Array, lost: Array) -> None:
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
            share = 1.0 + live[top, last] + live[top + 1, last]
            for e in range(last + 1):
                live[top + 1, e] = min(live[top + 1, e] + lost[i, e] * share, FAR)


def _residual(i: int, y: Array, u: Array, state: Array, C: Array, D: Array, offsets: Array) -> float:
    """What sensor i shows beyond what the estimate expects."""
    p, n, m = C.shape[0], C.shape[1], D.shape[1]
    value = y[i] - offsets[i]
    for j in range(n):
        value -= C[i, j] * (state[j] - offsets[p + j])
    for j in range(m):
        if D[i, j] != 0.0:
            value -= D[i, j] * (u[j] - offsets[p + n + j])
    return value


def _filter(live: Array, e: int, value: float, rest: float, poles: Array, limits: Array) -> None:
    """One error into its filters, and what it still owes to the start beside it."""
    scales = poles.shape[0] - 1
    cut = CUT * limits[0, e] * (1.0 + rest)
    value = min(max(value, -cut), cut)
    for s in range(scales):
        live[s, e] = poles[s] * live[s, e] + (1.0 - poles[s]) * value
        more = poles[s] * live[scales + s, e] + (1.0 - poles[s]) * rest
        live[scales + s, e] = more if more > GONE else 0.0


def _wait(live: Array, e: int, rest: float, poles: Array) -> None:
    """One sample on without the error: it might have been anything within its bound."""
    scales = poles.shape[0] - 1
    for s in range(scales):
        live[s, e] = poles[s] * live[s, e]
        live[scales + s, e] = poles[s] * live[scales + s, e] + (1.0 - poles[s]) * (1.0 + rest)


def _remember(live: Array, out: Array, fault: Array, bound: Array, poles: Array) -> None:
    """How far each estimate may be off, and how large the faults have been at most."""
    last, q = live.shape[0] - 1, fault.shape[0]
    for j in range(q):
        rest = live[last - 2, j] + live[last - 1, j]
        off = bound[j] * (1.0 + rest) if rest < FAR else math.inf
        past = live[last, j] * poles[poles.shape[0] - 1]
        if math.isfinite(fault[j]):
            past = max(past, abs(fault[j]))
        live[last, j] = past
        out[3 + j] = off
        out[3 + q + j] = past + off


def filters(sample_time: float, spans: Sequence[float]) -> tuple[float, ...]:
    """The poles of no filter and of one for each time constant, s."""
    return (0.0, *(math.exp(-sample_time / span) for span in spans))
