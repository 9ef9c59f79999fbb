# SPDX-License-Identifier: BSD-3-Clause
"""Where a monitor is tried: its plant, as it is declared, with noise, disturbances within their bounds, and one fault.

Disturbances wander with a standard deviation of their size, cut off where the monitor takes them to end (`crest` times
their size).  A run begins healthy; the fault begins once everything can be tested.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Impossible
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.runtime.monitor import Monitor
from faultrecon.runtime.told import Told, scored
from faultrecon.runtime.watchloop import SETTLED
from faultrecon.runtime.words import spelled
from faultrecon.simulation.chance import HeldNoise, held_index, stream_seed
from faultrecon.simulation.composition import Shape
from faultrecon.simulation.scenario import Scenario, Signal
from faultrecon.simulation.shapes import Waveform
from faultrecon.simulation.truth import Truth, true_run

Array = NDArray[Any]

SETTLE = 2.0
"""Longest time constants of the filters between the time when all can be tested and the fault."""
HELD = 5
"""Samples for which a disturbance stays what it is: the shortest of gusts, since noise is there for what is shorter."""
PATIENCE = 1_000_000
"""Samples: a hypothesis that cannot be tested after so many never can."""


@dataclass(frozen=True, eq=False)
class Ground:
    """A monitor, and the plant it watches, with all that happens to it but faults."""

    monitor: Monitor
    inputs: Mapping[str, Signal]
    disturbances: Mapping[str, Signal]
    noise: bool
    seed: int

    @property
    def plant(self) -> Plant:
        """What is simulated."""
        return self.monitor.plant

    @property
    def longest(self) -> float:
        """The longest time constant of the filters, s; a window where there is none."""
        T = self.monitor.sample_time
        poles = [pole for h in self.monitor.hypotheses for pole in h.watch.poles if pole > 0]
        return max([self.monitor.rules.window * T, *(-T / math.log(pole) for pole in poles)])

    @property
    def begin(self) -> float:
        """When a fault begins, s: on a sample."""
        T = self.monitor.sample_time
        return T * math.ceil(_ready(self.monitor) + SETTLE * self.longest / T)

    def channel(self, name: str) -> FaultChannel:
        """The fault as its own hypothesis has it."""
        return self.monitor.hypotheses[self.monitor.singles[name]].watch.plant.faults[0]

    def healthy(self, label: str, duration: float) -> Truth:
        """A run without a fault; everything random follows from seed and label."""
        seed, T = stream_seed(self.seed, f"trial/{label}"), self.monitor.sample_time
        drawn = {
            d.name: _wandering(d, T, duration, self._crest, stream_seed(seed, f"wandering/{d.name}"))
            for d in self.plant.disturbances
            if not _says_the_noise_again(d, self.plant)
        }
        scenario = Scenario(
            duration, T, {}, self.inputs, {**drawn, **self.disturbances}, self.noise, seed=seed, name=label
        )
        return true_run(self.plant, scenario)

    @property
    def _crest(self) -> float:
        return self.monitor.hypotheses[0].watch.bounds.allowance.crest

    def left(self, truth: Truth) -> list[str]:
        """The states that left their declared range in a run."""
        names, ranges = self.plant.signals.x.names, np.array(self.plant.signals.x.ranges)
        off = np.abs(truth.x - np.array(self.plant.point.x)).max(axis=0)
        return [name for name, far in zip(names, off > ranges, strict=True) if far]

    def tried(self, truth: Truth, channel: FaultChannel, shape: Shape) -> Told:
        """What the monitor said of a run with a fault of this shape from `begin` on, once it is compared."""
        shape = shape.starting(self.begin)
        f = np.asarray(shape(truth.t))
        return self.told(truth, self._measured(truth, channel, f, shape), {channel.name: f})

    def _measured(self, truth: Truth, channel: FaultChannel, f: Array, shape: Shape) -> Array:
        """What the sensors show with the fault, (N, p)."""
        one = replace(self.plant, faults=(channel,))
        if channel.site == "sensor" and self.plant.known is None:  # no state moves: the same run serves
            return truth.y + f[:, None] * one.F_f[:, 0]
        return true_run(one, truth.scenario.with_fault(channel.name, shape)).y

    def told(self, truth: Truth, y: Array, faults: Mapping[str, Array]) -> Told:
        """The monitor over a run, and how well it did."""
        state, rows = self.monitor.take(self.monitor.start(), truth.t, truth.u, y)
        return scored(self.monitor, spelled(rows), self.monitor.events(state), faults)


def _ready(monitor: Monitor) -> int:
    """Samples until every test of every hypothesis can be made.  Raises Impossible when some never can."""
    latest = 0
    for h in monitor.hypotheses:
        b, tested = h.watch.bounds, np.isfinite(h.watch.limits[0])
        start, rate = (part[:, :-1][:, tested] for part in (b.start, b.rate))
        k = 1
        while not (start * rate**k).sum(axis=0).max(initial=0.0) <= SETTLED:
            k *= 2
            if k > PATIENCE:
                raise Impossible(
                    f"{h.name}: its start is not forgotten within {PATIENCE} samples",
                    why="no fault can be looked for before",
                    remedies=("declare ranges of states and inputs", "design with faster poles"),
                )
        latest = max(latest, k)
    return latest


def _says_the_noise_again(d: Disturbance, plant: Plant) -> bool:
    """Whether a disturbance is one sensor's noise, declared a second time for designs that weigh it."""
    on = [name for name, c in d.on.items() if c]
    if plant.noise is None or any(d.into.values()) or len(on) != 1:
        return False
    return plant.noise.sd[plant.signals.y.index(on[0])] > 0


def _wandering(d: Disturbance, sample_time: float, duration: float, crest: float, seed: int) -> Shape:
    """A disturbance within its bounds: a first-order Gauss-Markov process, of a time constant drawn with it.

    Standard deviation `d.size`, held for `HELD` samples, cut off at `crest` times the size; the time constant is
    log-uniform between that and a tenth of the run, so that gusts of every length come.  White where it is noise.
    """
    if d.role == "noise":
        return HeldNoise(d.size, sample_time, seed)
    hold = HELD * sample_time
    count = math.ceil(duration / hold) + 2
    rng = np.random.Generator(np.random.PCG64(seed))
    slowest = max(hold, duration / 10.0)
    pole = math.exp(-hold / (hold * (slowest / hold) ** rng.random()))
    values, fresh = rng.standard_normal(count), math.sqrt(1.0 - pole**2)
    for k in range(1, count):
        values[k] = pole * values[k - 1] + fresh * values[k]
    values = d.size * np.clip(values, -crest, crest)
    kinks = tuple((hold * np.arange(1, count)).tolist())
    return Waveform(lambda t: values[np.minimum(held_index(t, hold), count - 1)], kinks)
