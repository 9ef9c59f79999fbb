# SPDX-License-Identifier: BSD-3-Clause
"""The tests of one observer: everything that it says about the plant, against what its bounds allow if all is well.

Do the sensors that it takes for healthy agree with it?  And is the fault that it reconstructs larger than nothing could
look?  Each error is tested as it is and behind low-pass filters, so that drifts below the noise are found too.  What
enters a filter is cut off at `CUT` times its bound: one wild sample says one thing, once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Inconclusive
from faultrecon.graph.compiled import Program, load, obstacle, plain_text
from faultrecon.plant.plant import Plant
from faultrecon.runtime.absences import Absences
from faultrecon.runtime.bounds import Bounds
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.samples import Trace, columns
from faultrecon.runtime.watchloop import CONSTANTS, LOOP, pass_over, rows_of
from faultrecon.runtime.watchrest import FAR, forgiving

Array = NDArray[Any]

SIGNATURE = ", ".join(
    [
        *("block" for _ in range(5)),
        *("table", "vector", "vector", "table", "vector", "vector", "vector"),
        *("table" for _ in range(5)),
        *("into" for _ in range(8)),
    ]
)
REGULAR = 0.1  # sample times: by how much an interval may differ from a whole number of them, and count as such
LATE = 1.5  # sample times: a longer interval is one in which rows are missing


@dataclass(frozen=True, eq=False)
class Batch:
    """N samples as every watch reads them: u (m, N), y (p, N), signal by signal.

    pace (3, N): how many rows are missing before each, infinite where that is no whole number; how many sample times
    after the one before it came, at most 1; and 1 where neither u nor y lacks anything.
    """

    u: Array
    y: Array
    pace: Array

    @staticmethod
    def of(u: Array, y: Array, waits: Array) -> Batch:
        """From samples u (N, m), y (N, p), and how many sample times after the one before it each came, (N,)."""
        with np.errstate(invalid="ignore"):  # nothing times infinity is not a number, which is what is asked
            sums = u @ np.zeros(u.shape[1]) + y @ np.zeros(y.shape[1])
        pace = np.zeros((3, len(waits)))
        late = waits > LATE
        if late.any():
            waits = np.minimum(waits, FAR)
            rows = np.round(waits[late])
            pace[0, late] = np.where(np.abs(waits[late] - rows) <= REGULAR, rows - 1.0, np.inf)
        pace[1] = np.where(waits < 1.0 - REGULAR, waits, 1.0)
        pace[2] = sums == 0.0
        return Batch(np.ascontiguousarray(u.T), np.ascontiguousarray(y.T), pace)

    @cached_property
    def complete(self) -> bool:
        """Whether no row is missing, and nothing in any."""
        return bool(np.all(self.pace[2] == 1.0) and not self.pace[0].any())


@dataclass(frozen=True, eq=False)
class Findings:
    """What watches found over N samples.

    peak, own (N, watches): the largest of all tests, and of those on its own faults, in bounds.  nis (N, watches): the
    mean of (residual / what noise makes of it)².  faded (N, watches): 1 where nothing is left untested.  bound,
    amplitude (N, faults): how far each estimate may be off, and how large the fault has been at most, what is past
    counting for less and less.
    shares (N, tests): how much of its bound each test uses up, scale by scale, 0 where nothing can be said.  Of a watch
    whose peak is not above 1 they are not written.
    """

    peak: Array
    own: Array
    nis: Array
    faded: Array
    bound: Array
    amplitude: Array
    shares: Array

    @staticmethod
    def room(rows: int, watches: Sequence[Watch]) -> tuple[Findings, list[Findings]]:
        """Room for those of several watches, and the parts that each of them writes."""
        faults = np.cumsum([0, *(w.bounds.faults for w in watches)])
        tests = np.cumsum([0, *(w.tests for w in watches)])
        peak, own, nis, faded = (columns(rows, len(watches)) for _ in range(4))
        bound, amplitude = (columns(rows, int(faults[-1])) for _ in range(2))
        every = Findings(peak, own, nis, faded, bound, amplitude, np.empty((rows, int(tests[-1]))))
        parts = []
        for g in range(len(watches)):
            one, f, s = slice(g, g + 1), slice(faults[g], faults[g + 1]), slice(tests[g], tests[g + 1])
            parts.append(every._part([one, one, one, one, f, f, s]))
        return every, parts

    def _part(self, places: Sequence[slice]) -> Findings:
        every = self.peak, self.own, self.nis, self.faded, self.bound, self.amplitude, self.shares
        return Findings(*(table[:, here] for table, here in zip(every, places, strict=True)))


@dataclass(frozen=True, eq=False)
class Watch:
    """The tests of an estimator with its bounds on its plant; (scales, q + p) of them.

    memory: how much of the size of a past fault counts a sample later.
    poles: of the low-pass filters, the first 0.  `init` is the state before the first sample, as `watchloop` keeps it.
    """

    plant: Plant
    estimator: Estimator
    bounds: Bounds
    poles: tuple[float, ...]
    memory: float = 0.0
    compiled: bool = True

    def init(self, blind: bool = False) -> Array:
        """Before the first sample; blind: that one lacks something, so that the estimator begins at rest."""
        scales = len(self.poles)
        live = np.zeros((rows_of(scales), self.bounds.faults + self.plant.p + 1))
        begins = self.bounds.blind if blind else self.bounds.start
        live[4 * scales : 4 * scales + 2] = begins / self.bounds.rate  # the first sample is one step on from there
        return live

    @property
    def tests(self) -> int:
        """How many tests there are."""
        return self.limits.size

    @cached_property
    def _reads(self) -> Array:
        """What the tested sensors are expected to show, [i, j, c]: sensor i, c times what [x; u] has at j."""
        sensors = np.hstack([self.plant.C, self.plant.D])
        sensors[np.isinf(self.limits[0, self.bounds.faults :])] = 0.0
        i, j = np.nonzero(sensors)
        return np.column_stack([i, j, sensors[i, j]])

    @cached_property
    def _offsets(self) -> Array:
        """What each sensor would show at [x; u] = 0."""
        plant, point = self.plant, self.plant.point
        return np.array(point.y) - plant.C @ np.array(point.x) - plant.D @ np.array(point.u)

    @cached_property
    def _weights(self) -> Array:
        """By sensor, what its residual is multiplied with before it is squared for the NIS."""
        q = self.bounds.faults
        noise = np.where(np.isfinite(self.limits[0, q:]), self.bounds.random[0, q:], 0.0)
        known = noise > 0.0
        weights = np.divide(1.0, noise, out=np.zeros_like(noise), where=known)
        return weights / np.sqrt(max(int(known.sum()), 1))

    @cached_property
    def _fixed(self) -> tuple[Array, ...]:
        """What the loop reads beside the samples, whatever they lack."""
        b = self.bounds
        return (
            *(self._reads, self._offsets, self._weights, np.minimum(self.limits, FAR)),
            *(np.array([*self.poles, self.memory]), forgiving(b.steady)[0, : b.faults]),
        )

    @cached_property
    def _none_missing(self) -> tuple[Array, ...]:
        """What it reads of absences while there are none and nothing is left of any: their shape alone."""
        nothing, none = np.zeros_like(self.bounds.rate), np.zeros((0, *self.bounds.rate.shape))
        return self._of_absences(Absences(nothing, none, none, none, False, np.zeros(self.plant.p + 1)))

    @cached_property
    def _some_missing(self) -> tuple[Array, ...]:
        """What it reads of absences where there are any."""
        return self._of_absences(self.bounds.absences)

    def _of_absences(self, found: Absences) -> tuple[Array, ...]:
        b, width = self.bounds, self.bounds.rate.shape[1]
        return (
            np.append(found.diverges, found.scales),
            *(np.vstack([b.rate, found.rate]), np.vstack([b.anew, np.zeros_like(b.anew)])),
            *(each.reshape(-1, width) for each in (found.lost, found.skipped, found.unfed)),
        )

    def ready(self) -> None:
        """Find out now what absences do, for who cannot wait when something is missing for the first time."""
        _ = self._some_missing

    @cached_property
    def limits(self) -> Array:
        """What each test allows, (scales, q + p); inf where nothing is tested: sensors that the faults reach."""
        limits = forgiving(self.bounds.steady)
        limits[:, self.bounds.faults :][:, np.any(self.plant.F_f != 0, axis=1)] = math.inf
        limits[limits == 0.0] = np.finfo(float).tiny
        return limits

    def look(self, live: Array, batch: Batch, trace: Trace, into: Findings) -> Array:
        """The tests over N samples, written into `into`, and the state after them."""
        live, top = live.copy(), 4 * len(self.poles)
        owing = bool(live[top + 2 : top + 4].any()) or live[top + 4, -1] != 0.0
        absences = self._some_missing if owing or not batch.complete else self._none_missing
        loop: Callable[..., Any] = _compiled() if self.compiled else pass_over
        loop(
            *(batch.y, batch.u, np.ascontiguousarray(trace.state.T), np.ascontiguousarray(trace.fault.T), batch.pace),
            *self._fixed,
            *absences,
            live,
            *(into.shares, into.peak, into.own, into.nis, into.faded, into.bound, into.amplitude),
        )
        return live


@cache
def _compiled() -> Callable[..., Any]:
    """The loop as machine code where that can be had, else as it stands."""
    if obstacle():
        return pass_over
    *parts, last = (plain_text(one, **CONSTANTS) for one in LOOP)
    text = "\n\n".join([*(f"@part\n{part}" for part in parts), f"@kernel(int64({SIGNATURE}), nogil=True)\n{last}"])
    try:
        return load(Program(text))[pass_over.__name__]
    except Inconclusive:
        return pass_over


def filters(sample_time: float, spans: Sequence[float]) -> tuple[float, ...]:
    """The poles of no filter and of one for each time constant, s."""
    return (0.0, *(math.exp(-sample_time / span) for span in spans))
