# SPDX-License-Identifier: BSD-3-Clause
"""What in a replayed log looks wrong without being an error: gaps in time, other units, a box that was left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from faultrecon.io.playback import Replay
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

GAP = 3.0
"""Sample times: a longer interval is told."""
FAR = 10.0
"""Ratio to what was declared beyond which units are doubted; degrees for radians are 57, milliseconds 1000."""


@dataclass(frozen=True, slots=True)
class Gap:
    """The longest interval between two rows: seconds, the same in sample times, and the time at which it begins."""

    seconds: float
    samples: float
    at: float

    def as_dict(self) -> dict[str, float]:
        """Plain values for `--json`."""
        return asdict(self)

    def __str__(self) -> str:
        return f"longest interval {self.seconds:.6g} s = {self.samples:.4g} samples at t = {self.at:.6g}"


def longest_gap(done: Replay) -> Gap | None:
    """The longest interval when it is more than three sample times."""
    t, h = done.log.t, done.sample_time
    if len(t) < 2 or h is None:
        return None
    steps = np.diff(t)
    k = int(np.argmax(steps))
    return Gap(float(steps[k]), float(steps[k] / h), float(t[k])) if steps[k] > GAP * h else None


def doubts(done: Replay) -> tuple[str, ...]:
    """A sentence for every sign that time, a signal or a fault is in other units than the plant's, and one where the
    estimate left the box of the certificate."""
    plant, log = done.design.plant, done.log
    found = [*unit_doubts(plant, log.t, log.u, log.y)]
    units = dict(zip(plant.signals.y.names, plant.signals.y.units, strict=True))
    for j, f in enumerate(plant.faults):
        if ratio := _beyond(done.trace.fault[:, j], f.size):
            size = _with(f.size, units.get(next(iter(f.on)), ""))
            found.append(f"{f.name} is found to reach {ratio:.3g} times its declared size of {size}: are units mixed?")
    if (held := done.coverage()) is not None and held.outside:
        found.append(str(held))
    return tuple(found)


def unit_doubts(plant: Plant, t: Array, u: Array, y: Array) -> tuple[str, ...]:
    """A sentence for every sign that time or a signal is in other units than the plant's.

    t (N,), u (N, m), y (N, p), also as they came: in any order, with gaps, before limits took away what is beyond them.
    """
    with np.errstate(over="ignore"):  # of clocks gone wild
        intervals = np.diff(np.unique(t[np.isfinite(t)]))
        interval = float(np.median(intervals)) if intervals.size else None
    spans = {}
    for channels, values in ((plant.signals.u, u), (plant.signals.y, y)):
        spans |= {name: span(column) for name, column in zip(channels.names, values.T, strict=True)}
    return unit_doubts_of(plant, interval, spans)


def unit_doubts_of(
    plant: Plant, interval: float | None, spans: Mapping[str, Sequence[float] | None]
) -> tuple[str, ...]:
    """The same sentences, from what is kept of a log of any length: its median interval, s, and `span`s by signal."""
    found = []
    if plant.noise is not None and interval is not None:
        hold = plant.noise.hold
        if not 1 / FAR <= interval / hold <= FAR:
            found.append(
                f"the log has a sample every {interval:.4g} s, the plant's noise is held {hold:.4g} s: "
                "is the time in other units?"
            )
    for channels, point in ((plant.signals.u, plant.point.u), (plant.signals.y, plant.point.y)):
        for name, unit, wide, rest in zip(channels.names, channels.units, channels.ranges, point, strict=True):
            ends = np.array(spans.get(name) or (), dtype=float)
            with np.errstate(over="ignore"):  # an end may be the largest number there is
                ratio = _beyond(ends - rest, wide)
            if ratio:
                found.append(
                    f"{name} goes to {ratio:.3g} times its declared range of {_with(wide, unit)} around the operating "
                    f"point of {_with(rest, unit)}: is it in other units?"
                )
    return tuple(found)


def span(values: Array) -> tuple[float, float] | None:
    """The least and the largest finite value, None where there is none."""
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if known.size else None


def _beyond(values: Array, declared: float) -> float | None:
    """The largest known size in terms of what was declared, where it is far beyond; None also when none is declared."""
    known = values[np.isfinite(values)]
    if not known.size or np.isnan(declared):
        return None
    largest = float(np.max(np.abs(known)))
    return largest / declared if largest > FAR * declared else None


def _with(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip()
