# SPDX-License-Identifier: BSD-3-Clause
"""What in a replayed log looks wrong without being an error: gaps in time, and numbers in other units."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from faultrecon.io.playback import Replay

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
    """A sentence for every sign that time, a signal or a fault is in other units than the plant's."""
    plant, log = done.design.plant, done.log
    found = []
    if plant.noise is not None and len(log) > 1:
        interval, hold = float(np.median(np.diff(log.t))), plant.noise.hold
        if not 1 / FAR <= interval / hold <= FAR:
            found.append(
                f"the log has a sample every {interval:.4g} s, the plant's noise is held {hold:.4g} s: "
                "is the time in other units?"
            )
    groups = ((plant.signals.u, plant.point.u, log.u), (plant.signals.y, plant.point.y, log.y))
    for channels, point, values in groups:
        for name, unit, wide, rest, column in zip(
            channels.names, channels.units, channels.ranges, point, values.T, strict=True
        ):
            if ratio := _beyond(column - rest, wide):
                found.append(
                    f"{name} goes to {ratio:.3g} times its declared range of {_with(wide, unit)} around the operating "
                    f"point of {_with(rest, unit)}: is it in other units?"
                )
    units = dict(zip(plant.signals.y.names, plant.signals.y.units, strict=True))
    for j, f in enumerate(plant.faults):
        if ratio := _beyond(done.trace.fault[:, j], f.size):
            size = _with(f.size, units.get(next(iter(f.on)), ""))
            found.append(f"{f.name} is found to reach {ratio:.3g} times its declared size of {size}: are units mixed?")
    return tuple(found)


def _beyond(values: np.ndarray, declared: float) -> float | None:
    """The largest known size in terms of what was declared, where it is far beyond; None also when none is declared."""
    known = values[np.isfinite(values)]
    if not known.size or np.isnan(declared):
        return None
    largest = float(np.max(np.abs(known)))
    return largest / declared if largest > FAR * declared else None


def _with(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip()
