# SPDX-License-Identifier: BSD-3-Clause
"""Which explanations are left: every test of every observer, asked of every hypothesis.

A test that fails contradicts "all is well".  It contradicts a hypothesis too, unless the faults of that hypothesis
could have made it fail: by the peak gain from fault to test times how large the hypothesis itself says the fault has
been, error of the estimate included.  So an observer made for one sensor also rules out explanations of others, and
what has no effect on a test can never excuse it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Inconclusive
from faultrecon.graph.compiled import Program, load, obstacle, plain_text
from faultrecon.numerics.discretise import zoh
from faultrecon.numerics.peaks import gains
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.runtime.errors import ErrorSystem
from faultrecon.runtime.watch import Findings, Watch

Array = NDArray[Any]

SIGNATURE = "table, table, table, table, table, table, into"
LONGER = 4.0  # times the memory of the slowest test; it costs a third of what isolates in that test, at most
NOTHING = 1e-9  # of a sensor's own reading: what rounding makes of an effect that is none


@dataclass(frozen=True, eq=False)
class Isolation:
    """What excuses what.  excuse (faults, tests): how much of its bound one unit of a fault may use up in each test.

    first (1, hypotheses + 1): where the faults of each hypothesis begin in the rows of `excuse`.  begins (1, watches +
    1): where the tests of each watch begin in its columns.
    """

    excuse: Array
    first: Array
    begins: Array

    def ask(self, found: Findings) -> tuple[Array, NDArray[np.bool_]]:
        """How badly each hypothesis fits at N samples, (N, hypotheses): its worst test in bounds; above 1 it is out.

        And where any test fails at all, (N, 1).
        """
        hypotheses = self.first.shape[1] - 1
        out = np.empty((len(found.peak), hypotheses + 1))
        _compiled()(found.shares, found.peak, found.amplitude, self.excuse, self.first, self.begins, out)
        return out[:, :hypotheses], out[:, hypotheses:] > 1.0


def isolation(watches: Sequence[Watch], systems: Sequence[ErrorSystem], hypotheses: Sequence[Plant]) -> Isolation:
    """The table of excuses, by the peak gains of every fault on every test.

    watches with their error systems, all of one memory ρ; hypotheses: plants whose faults are those that act.  What a
    test remembers of a fault k samples ago counts ρ^-k times, because the size of that fault counts ρ^k times.
    """
    rho = watches[0].memory or 1.0
    faults = [fault for plant in hypotheses for fault in plant.faults]
    parts = []
    for watch, system in zip(watches, systems, strict=True):
        columns = [_effect(watch, system, fault) for fault in faults]
        into, out = (np.column_stack(part) for part in zip(*columns, strict=True))
        E = system.faults + system.sensors
        poles = np.array(watch.poles)
        peak = gains(system.M / rho, into / rho, system.C[:E], out[:E], tuple(poles / rho)).peak
        peak *= ((1.0 - poles) / (1.0 - poles / rho))[:, None, None]
        share = peak / watch.limits[:, :, None]
        share[peak <= NOTHING * peak.max(initial=0.0)] = 0.0
        parts.append(share.reshape(-1, len(faults)).T)
    counts = [len(plant.faults) for plant in hypotheses]
    begins = np.cumsum([0, *(watch.tests for watch in watches)])
    return Isolation(np.hstack(parts), np.cumsum([0, *counts])[None].astype(float), begins[None].astype(float))


def memory(watches: Sequence[Watch], systems: Sequence[ErrorSystem]) -> float:
    """How long past faults must be remembered, per sample: somewhat longer than any test remembers them."""
    slowest = [float(np.abs(np.linalg.eigvals(system.M)).max(initial=0.0)) for system in systems]
    longest = max(*slowest, *(max(watch.poles) for watch in watches), 0.0)
    return 1.0 - (1.0 - longest) / LONGER if longest < 1.0 else 1.0


def _effect(watch: Watch, system: ErrorSystem, fault: FaultChannel) -> tuple[Array, Array]:
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


@cache
def _compiled() -> Callable[..., Any]:
    if obstacle():
        return _ask
    text = f"@kernel(int64({SIGNATURE}), nogil=True)\n" + plain_text(_ask)
    try:
        return load(Program(text))["_ask"]
    except Inconclusive:
        return _ask


def _ask(shares: Array, peaks: Array, amplitudes: Array, excuse: Array, first: Array, begins: Array, out: Array) -> int:
    """One pass over the samples; `out` is written, its last column with the worst of all tests.

    A watch all of whose tests hold need not be asked in detail.
    """
    hypotheses, watches = first.shape[1] - 1, begins.shape[1] - 1
    for k in range(peaks.shape[0]):
        worst, held = 0.0, 0.0  # of all watches, and of those whose tests all hold
        for g in range(watches):
            peak = peaks[k, g]
            worst = peak if peak > worst else worst
            held = peak if held < peak <= 1.0 else held
        for h in range(hypotheses + 1):
            out[k, h] = worst
        if worst <= 1.0:
            continue
        for h in range(hypotheses):
            worst = held
            for g in range(watches):
                if peaks[k, g] <= 1.0:
                    continue
                for test in range(int(begins[0, g]), int(begins[0, g + 1])):
                    share = shares[k, test]
                    if share <= worst:
                        continue
                    excused = 1.0
                    for a in range(int(first[0, h]), int(first[0, h + 1])):
                        if excuse[a, test] > 0.0:
                            excused += excuse[a, test] * amplitudes[k, a]
                    worst = max(worst, share / excused)
            out[k, h] = worst
    return 0
