# SPDX-License-Identifier: BSD-3-Clause
"""The waveforms that faults, inputs and disturbances take: offsets, drifts, oscillations, outliers, losses.

They add up with `+` and are moved and cut by `.starting(t)`, `.until(t)` and `.during(t1, t2)`, see `Shape`.  Two of
them act on what the sensor would have shown (`Loss`, `Stuck`): they take that as a second argument.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError
from faultrecon.simulation.composition import Bounded, Reading, Shape

Array = NDArray[Any]


@dataclass(frozen=True)
class Step(Shape):
    """A constant offset: a sensor bias."""

    size: float

    def values(self, t: Array, reading: Reading) -> Array:
        return np.full_like(t, self.size)

    @property
    def bounded(self) -> Bounded:
        return Bounded(abs(self.size), math.inf)


@dataclass(frozen=True)
class Ramp(Shape):
    """An incipient fault: rises to `size` within `over` seconds and stays there."""

    size: float
    over: float

    def __post_init__(self) -> None:
        _positive("a ramp rises over", self.over)

    def values(self, t: Array, reading: Reading) -> Array:
        return self.size * np.minimum(t / self.over, 1.0)

    def edges(self, end: float) -> tuple[float, ...]:
        return (self.over,)

    @property
    def bounded(self) -> Bounded:
        return Bounded(abs(self.size), abs(self.size) / self.over)


@dataclass(frozen=True)
class Drift(Shape):
    """A drift at a constant rate per second, without end."""

    rate: float

    def values(self, t: Array, reading: Reading) -> Array:
        return self.rate * t

    @property
    def bounded(self) -> Bounded:
        return Bounded(math.inf if self.rate else 0.0, abs(self.rate))


@dataclass(frozen=True)
class Sine(Shape):
    """An oscillation, amplitude sin(omega t + phase); omega in rad/s."""

    amplitude: float
    omega: float
    phase: float = 0.0

    def values(self, t: Array, reading: Reading) -> Array:
        return self.amplitude * np.sin(self.omega * t + self.phase)

    @property
    def bounded(self) -> Bounded:
        jumps = self.amplitude * math.sin(self.phase) != 0
        return Bounded(abs(self.amplitude), math.inf if jumps else abs(self.amplitude * self.omega))


@dataclass(frozen=True)
class Doublet(Shape):
    """Up for `width` seconds, down for as long, then back: the usual test input."""

    size: float
    width: float

    def __post_init__(self) -> None:
        _positive("half a doublet lasts", self.width)

    def values(self, t: Array, reading: Reading) -> Array:
        return self.size * np.select([t < self.width, t < 2 * self.width], [1.0, -1.0], 0.0)

    def edges(self, end: float) -> tuple[float, ...]:
        return (self.width, 2 * self.width)

    @property
    def bounded(self) -> Bounded:
        return Bounded(abs(self.size), math.inf)


@dataclass(frozen=True)
class Spike(Shape):
    """A single outlier: `size` for `width` seconds."""

    size: float
    width: float

    def __post_init__(self) -> None:
        _positive("a spike lasts", self.width)

    def values(self, t: Array, reading: Reading) -> Array:
        return np.where(t < self.width, self.size, 0.0)

    def edges(self, end: float) -> tuple[float, ...]:
        return (self.width,)

    @property
    def bounded(self) -> Bounded:
        return Bounded(abs(self.size), math.inf)


@dataclass(frozen=True)
class Intermittent(Shape):
    """A loose contact by table: an offset that switches on, off, on, ... at the given times."""

    size: float
    switches: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "switches", tuple(float(s) for s in self.switches))
        if any(s < 0 for s in self.switches) or any(np.diff(self.switches) <= 0):
            raise InputError(f"the switches are at {self.switches}", why="times increase from 0 on")

    def values(self, t: Array, reading: Reading) -> Array:
        return self.size * (np.searchsorted(np.array(self.switches), t, side="right") % 2)

    def edges(self, end: float) -> tuple[float, ...]:
        return self.switches

    @property
    def bounded(self) -> Bounded:
        return Bounded(abs(self.size), math.inf)


@dataclass(frozen=True)
class Loss(Shape):
    """Loss of effectiveness: the sensor shows (1 - fraction) of its signal; the loss grows over `over` seconds."""

    fraction: float
    over: float = 0.0

    def values(self, t: Array, reading: Reading) -> Array:
        lost = np.minimum(t / self.over, 1.0) if self.over > 0 else np.ones_like(t)
        return -self.fraction * lost * np.asarray(reading, dtype=float)

    def edges(self, end: float) -> tuple[float, ...]:
        return (self.over,) if self.over > 0 else ()

    @property
    def relative(self) -> bool:
        return True


@dataclass(frozen=True)
class Stuck(Shape):
    """A frozen sensor: it shows `value`, or the last thing it showed, and no noise."""

    value: float | None = None

    def values(self, t: Array, reading: Reading) -> Array:
        shown = math.nan if self.value is None else self.value  # not told yet: see `remembering`
        return shown - np.asarray(reading, dtype=float)

    @property
    def relative(self) -> bool:
        return True

    def noise_gain(self, t: ArrayLike) -> Any:
        return np.where(np.asarray(t, dtype=float) >= 0, 0.0, 1.0)

    def onsets(self) -> tuple[float, ...]:
        return (0.0,) if self.value is None else ()

    def remembering(self, value: float, onset: float) -> Shape:
        return replace(self, value=value) if self.value is None and onset == 0.0 else self


@dataclass(frozen=True)
class Waveform(Shape):
    """Any function of time (array in, array out), with the times at which it jumps or kinks."""

    function: Callable[[Array], ArrayLike]
    kinks: tuple[float, ...] = ()

    def values(self, t: Array, reading: Reading) -> Array:
        found = np.asarray(self.function(t), dtype=float)
        if found.shape not in (t.shape, ()):
            raise InputError(f"the waveform gives {found.shape} for times {t.shape}", why="one value per time")
        return np.broadcast_to(found, t.shape)

    def edges(self, end: float) -> tuple[float, ...]:
        return self.kinks


def _positive(what: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{what} {value} s", why="a duration is a positive number of seconds")
