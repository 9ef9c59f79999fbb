# SPDX-License-Identifier: BSD-3-Clause
"""Which explanations are left: every test of every observer, asked of every hypothesis.

A test that fails contradicts "all is well".  It contradicts a hypothesis too, unless the faults of that hypothesis
could have made it fail: by the peak gain from fault to test times how large the hypothesis itself says the fault has
been, error of the estimate included.  So an observer made for one sensor also rules out explanations of others, and
what has no effect on a test can never excuse it.

A fault that acts at the first sample has also misled where each observer began.  What that does to a test is over after
a while, which is known beforehand: until then the observer is not asked about explanations with that fault.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Inconclusive
from faultrecon.graph.compiled import Program, load, obstacle, plain_text
from faultrecon.numerics.discretise import zoh
from faultrecon.numerics.lag import Lag
from faultrecon.numerics.peaks import BLOCK, Outputs, gains
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.runtime.errors import ErrorSystem
from faultrecon.runtime.steps import observer_step
from faultrecon.runtime.watch import Findings, Watch

Array = NDArray[Any]

SIGNATURE = "table, table, table, table, table, table, table, int64, into"
LONGER = 4.0  # times the memory of the slowest test; it costs a third of what isolates in that test, at most
NOTHING = 1e-9  # of a sensor's own reading: what rounding makes of an effect that is none
LATER = 0.1  # of what a fault may do to a test in any case: what its start may add once it counts as over
LITTLE = 0.02  # bounds that a fault of its declared size may add once its start counts as over
OVER = 1e-3  # of what counts as over: there all that is still to come is below it
LONGEST = 2**17  # samples: a start that takes longer is never over


@dataclass(frozen=True, eq=False)
class Isolation:
    """What excuses what.  excuse (faults, tests): how much of its bound one unit of a fault may use up in each test.

    deaf (faults, watches): how many samples from the first one on a watch says nothing about hypotheses with a fault,
    which may have acted at the first one.  first (1, hypotheses + 1): where the faults of each hypothesis begin in the
    rows of both.  begins (1, watches + 1): where the tests of each watch begin in the columns of `excuse`.
    """

    excuse: Array
    deaf: Array
    first: Array
    begins: Array

    def ask(self, found: Findings, age: int) -> tuple[Array, NDArray[np.bool_]]:
        """How badly each hypothesis fits at N samples, (N, hypotheses): its worst test in bounds; above 1 it is out.

        And where any test fails at all, (N, 1).  age: how many samples there were before the first of these.
        """
        hypotheses = self.first.shape[1] - 1
        out = np.empty((len(found.peak), hypotheses + 1))
        tables = found.shares, found.peak, found.amplitude, self.excuse, self._silent, self.first, self.begins
        _compiled()(*tables, age, out)
        return out[:, :hypotheses], out[:, hypotheses:] > 1.0

    @cached_property
    def _silent(self) -> Array:
        """How long each watch says nothing about each hypothesis, (hypotheses, watches)."""
        edges = self.first[0].astype(int)
        return np.array([self.deaf[a:b].max(axis=0, initial=0.0) for a, b in pairwise(edges)])


def isolation(watches: Sequence[Watch], systems: Sequence[ErrorSystem], hypotheses: Sequence[Plant]) -> Isolation:
    """The table of excuses, by the peak gains of every fault on every test.

    watches with their error systems, all of one memory ρ; hypotheses: plants whose faults are those that act.  What a
    test remembers of a fault k samples ago counts ρ^-k times, because the size of that fault counts ρ^k times.
    """
    rho = watches[0].memory or 1.0
    faults = [fault for plant in hypotheses for fault in plant.faults]
    sizes = np.array([fault.size for fault in faults])
    parts, deaf = [], []
    for watch, system in zip(watches, systems, strict=True):
        columns = [effect(watch, system, fault) for fault in faults]
        into, out = (np.column_stack(part) for part in zip(*columns, strict=True))
        E = system.faults + system.sensors
        poles = np.array(watch.poles)
        peak = gains(system.M / rho, into / rho, system.C[:E], out[:E], tuple(poles / rho)).peak
        peak *= ((1.0 - poles) / (1.0 - poles / rho))[:, None, None]
        share = peak / watch.limits[:, :, None]
        share[peak <= NOTHING * peak.max(initial=0.0)] = 0.0
        outputs = Outputs(system.M / rho, system.C[:E])
        newest = observer_step(watch.estimator).B1
        starts = np.stack([_starts(watch, newest, len(system.M), fault) for fault in faults], axis=1)
        silent, more = _over(outputs, starts, poles, rho, watch.limits, share, sizes)
        parts.append((share + more).reshape(-1, len(faults)).T)
        deaf.append(silent)
    counts = [len(plant.faults) for plant in hypotheses]
    first, begins = np.cumsum([0, *counts]), np.cumsum([0, *(watch.tests for watch in watches)])
    return Isolation(np.hstack(parts), np.column_stack(deaf), *(at[None].astype(float) for at in (first, begins)))


def memory(watches: Sequence[Watch], systems: Sequence[ErrorSystem]) -> float:
    """How long past faults must be remembered, per sample: somewhat longer than any test remembers them."""
    slowest = [float(np.abs(np.linalg.eigvals(system.M)).max(initial=0.0)) for system in systems]
    longest = max(*slowest, *(max(watch.poles) for watch in watches), 0.0)
    return 1.0 - (1.0 - longest) / LONGER if longest < 1.0 else 1.0


def effect(watch: Watch, system: ErrorSystem, fault: FaultChannel) -> tuple[Array, Array]:
    """What one unit of a fault does to ζ and to the errors, of an observer that need not know of it."""
    plant = replace(watch.plant, faults=(fault,))
    if fault.site == "sensor":
        into, out = (part @ plant.F_f[:, 0] for part in system.reading)
        return into, out
    if plant.sample_time is not None:
        moved = plant.E_f[:, 0]
    else:
        moved = zoh(plant.A, plant.E_f, watch.estimator.sample_time)[1][:, 0]
    return system.moved @ moved, np.zeros(len(system.C))


def _starts(watch: Watch, newest: Array, height: int, fault: FaultChannel) -> Array:
    """What one unit of a fault at the first sample does to the first ζ, (nz, 3): it has misled the guess.

    With a complete sample; where the sensors that the guess does not read are silent, and the guess stands in for
    them; and where there is no guess, so that z is zero, while ζ leaves out what the sample is taken to have put in:
    `newest` times it.
    """
    observer, plant, K = watch.estimator.observer, watch.plant, watch.bounds.beginning.K
    m, starts = observer.inputs, np.zeros((height, 3))
    newest = newest[:, m:]
    if fault.site != "sensor":
        return starts
    F = replace(plant, faults=(fault,)).F_f[:, 0]
    unread = ~np.any(K != 0.0, axis=0)
    misled = K @ F
    back = np.linalg.pinv(observer.Cx if observer.prior is None else observer.prior)
    shows = observer.Dx[:, m:] if observer.prior is None else np.zeros((plant.n, plant.p))
    filled = np.where(unread, plant.C @ misled, F)
    nz = len(observer.A)
    starts[:nz, 0] = back @ (misled - shows @ F) - newest @ F
    starts[:nz, 1] = back @ (misled - shows @ filled) - newest @ filled
    starts[:nz, 2] = -newest @ F
    return starts


def _over(
    outputs: Outputs, starts: Array, poles: Array, rho: float, limits: Array, share: Array, sizes: Array
) -> tuple[Array, Array]:
    """After how many samples a start is over, by fault, and what may be left of it then in each test, as `share`.

    outputs: M over ρ.  starts (nz, faults, kinds).  limits (scales, r), share (scales, r, faults), sizes (faults,).
    Responses are taken by their size before they are filtered, because a filter may begin, and be without samples, at
    any time.
    """
    share, r = np.moveaxis(share, 2, 0), share.shape[1]
    nz, faults, kinds = starts.shape
    X, responds = starts.reshape(nz, faults * kinds).T, outputs.in_time.reshape(nz, r * BLOCK)
    enough = np.maximum(LATER * share, LITTLE / sizes[:, None, None])
    done, left, over = np.zeros(faults), np.zeros(share.shape), np.zeros(faults, dtype=bool)
    floor = NOTHING * float((np.abs(X) @ np.abs(outputs.C.T)).max(initial=0.0))
    lags, held = [Lag(a / rho, 1.0 - a, BLOCK) for a in poles], np.zeros((len(poles), faults, r))
    table = np.empty((faults, len(poles), r, BLOCK))
    for begin in range(0, LONGEST, BLOCK):
        each = X @ responds
        size = np.abs(each, out=each).reshape(faults, kinds, r, BLOCK).max(axis=1)
        size[size <= floor] = 0.0
        if outputs.slowest >= 1.0:
            return np.where(size.any(axis=(1, 2)), np.inf, 0.0), np.moveaxis(left, 0, 2)
        for i, lag in enumerate(lags):
            one = lag.over(size, held[i]) if lag.keeps else size
            held[i] = one[..., -1]
            np.divide(one, limits[i][:, None], out=table[:, i])
        most = table.max(axis=3)
        left, more = np.maximum(left, most), most > enough
        for j in np.flatnonzero(np.any(more, axis=(1, 2))):
            above = np.any(table[j, more[j]] > enough[j, more[j], None], axis=0)
            last = int(np.flatnonzero(above)[-1]) + 1
            done[j], left[j] = begin + last, table[j, ..., last:].max(axis=2, initial=0.0)
        if np.all(most <= OVER * enough):
            return done, np.moveaxis(left, 0, 2)
        over, X = np.all(most <= enough, axis=(1, 2)), X @ outputs.power.T
    return np.where(over, done, np.inf), np.moveaxis(left, 0, 2)


@cache
def _compiled() -> Callable[..., Any]:
    if obstacle():
        return _ask
    text = f"@part\n{plain_text(excused)}\n\n@kernel(int64({SIGNATURE}), nogil=True)\n{plain_text(_ask)}"
    try:
        return load(Program(text))["_ask"]
    except Inconclusive:
        return _ask


def excused(share: float, h: int, test: int, amplitudes: Array, excuse: Array, first: Array) -> float:
    """What is left of a share when the faults of a hypothesis have been as large as they may."""
    room = 1.0
    for a in range(int(first[0, h]), int(first[0, h + 1])):
        if excuse[a, test] > 0.0:
            room += excuse[a, test] * amplitudes[a]
    return share / room


def _ask(
    shares: Array,
    peaks: Array,
    amplitudes: Array,
    excuse: Array,
    silent: Array,
    first: Array,
    begins: Array,
    age: int,
    out: Array,
) -> int:
    """One pass over the samples; `out` is written, its last column with the worst of all tests.

    A watch all of whose tests hold need not be asked in detail, and of the others few tests can be the worst: the one
    that was so a sample before says how few.
    """
    hypotheses, watches = first.shape[1] - 1, begins.shape[1] - 1
    worst, by, of = np.empty(hypotheses), np.zeros(hypotheses, dtype=np.int64), np.zeros(hypotheses, dtype=np.int64)
    for k in range(peaks.shape[0]):
        largest, held = 0.0, 0.0  # of all watches, and of those whose tests all hold
        for g in range(watches):
            peak = peaks[k, g]
            largest = peak if peak > largest else largest
            held = peak if held < peak <= 1.0 else held
        out[k, hypotheses] = largest
        for h in range(hypotheses):
            out[k, h] = largest
        if largest <= 1.0:
            continue
        least = largest
        for h in range(hypotheses):
            worst[h] = held
            if peaks[k, of[h]] > 1.0 and age + k >= silent[h, of[h]]:
                worst[h] = max(held, excused(shares[k, by[h]], h, by[h], amplitudes[k], excuse, first))
            least = worst[h] if worst[h] < least else least
        for g in range(watches):
            if peaks[k, g] <= 1.0:
                continue
            for test in range(int(begins[0, g]), int(begins[0, g + 1])):
                share = shares[k, test]
                if share <= least:
                    continue
                for h in range(hypotheses):
                    if share > worst[h] and age + k >= silent[h, g]:
                        left = excused(share, h, test, amplitudes[k], excuse, first)
                        if left > worst[h]:
                            worst[h], by[h], of[h] = left, test, g
        for h in range(hypotheses):
            out[k, h] = worst[h]
    return 0
