# SPDX-License-Identifier: BSD-3-Clause
"""Waveforms as values: what a fault, an input or a disturbance does over time.

A shape is called with times (scalar or array, s) and gives values of the same form.  At a jump it takes the value from
the right: the sample at an onset sees the fault.  Shapes add up with `+`, and are moved and cut by

    Step(0.4).starting(5.0)            nothing before 5 s; the clock of the shape starts there
    Step(0.4).starting(5.0).until(9)   nothing from 9 s on
    Sine(0.5, 2.0).during(8.0, 20.0)   0.5 sin 2t seen through a window; the clock runs on from 0

The shapes themselves are in `shapes` and, drawn by chance, in `chance`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError

Array = NDArray[Any]
Reading = ArrayLike | None


@dataclass(frozen=True, slots=True)
class Bounded:
    """How large a waveform gets and how fast it changes: sup |f| and sup |df/dt|, inf where there is no bound."""

    size: float
    rate: float


@dataclass(frozen=True)
class Shape(ABC):
    """A waveform.  A subclass says its values for times >= 0 of its own clock; it is zero before."""

    @abstractmethod
    def values(self, t: Array, reading: Reading) -> Array:
        """The values at times of its own clock, (N,); `reading` is what the signal would be without the fault."""

    def edges(self, end: float) -> tuple[float, ...]:
        """Times in (0, end) at which the values jump or kink."""
        return ()

    @property
    def bounded(self) -> Bounded:
        """How large and how fast it gets."""
        return Bounded(math.inf, math.inf)

    @property
    def relative(self) -> bool:
        """Whether it acts on the healthy signal, which it then has to be given."""
        return False

    def __call__(self, t: ArrayLike, reading: Reading = None) -> Any:
        """Values at t, of the form of t; right limits at jumps.  Raises InputError when a healthy signal is needed."""
        times = np.asarray(t, dtype=float)
        if self.relative and reading is None:
            raise InputError(
                f"{type(self).__name__} acts on the healthy signal", remedies=("pass it as the second argument",)
            )
        out = np.where(times >= 0, self.values(np.maximum(times, 0.0), reading), 0.0)
        return float(out) if out.ndim == 0 else out

    def breakpoints(self, end: float) -> tuple[float, ...]:
        """Times in [0, end] where an integrator should start anew: jumps and kinks, its own beginning included."""
        return tuple(sorted({0.0, *(s for s in self.edges(end) if 0 < s <= end)}))

    def noise_gain(self, t: ArrayLike) -> Any:
        """What is left of the sensor's noise, 1 or 0: a stuck sensor shows none."""
        return np.ones_like(np.asarray(t, dtype=float))

    def seeded(self, stream: Callable[[str], int]) -> Shape:
        """The same shape with every seed that was left open drawn from `stream(label)`."""
        return self

    def onsets(self) -> tuple[float, ...]:
        """Times at which a reading has to be remembered."""
        return ()

    def remembering(self, value: float, onset: float) -> Shape:
        """The same shape with the reading at one of its `onsets` remembered."""
        return self

    # ------------------------------------------------------------ composition

    def __add__(self, other: Shape) -> Shape:
        left = self.parts if isinstance(self, Sum) else (self,)
        right = other.parts if isinstance(other, Sum) else (other,)
        return Sum((*left, *right))

    def starting(self, t: float) -> Shape:
        """The same waveform t seconds later; nothing before."""
        return Shifted(self, _time("start", t))

    def until(self, t: float) -> Shape:
        """The same waveform, and nothing from time t on."""
        return Windowed(self, 0.0, _time("end", t))

    def during(self, start: float, end: float = math.inf) -> Shape:
        """The same waveform seen from `start` to before `end`; its clock is not moved."""
        if not start < end:
            raise InputError(f"a window from {start} to {end} s is empty")
        return Windowed(self, _time("start", start), end)


@dataclass(frozen=True)
class Sum(Shape):
    """Several waveforms at once."""

    parts: tuple[Shape, ...]

    def values(self, t: Array, reading: Reading) -> Array:
        return np.sum([np.asarray(part(t, reading)) for part in self.parts], axis=0)

    def edges(self, end: float) -> tuple[float, ...]:
        return tuple(s for part in self.parts for s in part.breakpoints(end))

    @property
    def bounded(self) -> Bounded:
        found = [part.bounded for part in self.parts]
        return Bounded(sum(b.size for b in found), sum(b.rate for b in found))

    @property
    def relative(self) -> bool:
        return any(part.relative for part in self.parts)

    def noise_gain(self, t: ArrayLike) -> Any:
        return np.min([part.noise_gain(t) for part in self.parts], axis=0)

    def seeded(self, stream: Callable[[str], int]) -> Shape:
        return Sum(tuple(part.seeded(lambda s, i=i: stream(f"{i}/{s}")) for i, part in enumerate(self.parts)))

    def onsets(self) -> tuple[float, ...]:
        return tuple(s for part in self.parts for s in part.onsets())

    def remembering(self, value: float, onset: float) -> Shape:
        return Sum(tuple(part.remembering(value, onset) for part in self.parts))


@dataclass(frozen=True)
class Shifted(Shape):
    """A waveform that begins later."""

    shape: Shape
    start: float

    def values(self, t: Array, reading: Reading) -> Array:
        return np.asarray(self.shape(t - self.start, reading))

    def edges(self, end: float) -> tuple[float, ...]:
        return tuple(self._outer(np.array(self.shape.breakpoints(max(end - self.start, 0.0)))).tolist())

    def _outer(self, inner: Array) -> Array:
        """The first floats t with t - start >= inner: start + inner may be one rounding off, and an edge must not."""
        t = self.start + inner
        for _ in range(2):
            t = np.where(t - self.start < inner, np.nextafter(t, np.inf), t)
            before = np.nextafter(t, -np.inf)
            t = np.where(before - self.start >= inner, before, t)
        return t

    @property
    def bounded(self) -> Bounded:
        return self.shape.bounded

    @property
    def relative(self) -> bool:
        return self.shape.relative

    def noise_gain(self, t: ArrayLike) -> Any:
        return self.shape.noise_gain(np.asarray(t, dtype=float) - self.start)

    def seeded(self, stream: Callable[[str], int]) -> Shape:
        return Shifted(self.shape.seeded(stream), self.start)

    def onsets(self) -> tuple[float, ...]:
        return tuple(self._outer(np.array(self.shape.onsets())).tolist())

    def remembering(self, value: float, onset: float) -> Shape:
        inner = {float(self._outer(np.array(s))): s for s in self.shape.onsets()}
        return Shifted(self.shape.remembering(value, inner[onset]), self.start) if onset in inner else self


@dataclass(frozen=True)
class Windowed(Shape):
    """A waveform seen from `start` to before `end`."""

    shape: Shape
    start: float
    end: float

    def _open(self, t: Array) -> NDArray[np.bool_]:
        return (t >= self.start) & (t < self.end)

    def values(self, t: Array, reading: Reading) -> Array:
        return np.where(self._open(t), np.asarray(self.shape(t, reading)), 0.0)

    def edges(self, end: float) -> tuple[float, ...]:
        return (*self.shape.breakpoints(min(end, self.end)), self.start, self.end)

    @property
    def bounded(self) -> Bounded:
        inner = self.shape.bounded
        return Bounded(inner.size, math.inf if inner.size else 0.0)

    @property
    def relative(self) -> bool:
        return self.shape.relative

    def noise_gain(self, t: ArrayLike) -> Any:
        times = np.asarray(t, dtype=float)
        return np.where(self._open(times), self.shape.noise_gain(times), 1.0)

    def seeded(self, stream: Callable[[str], int]) -> Shape:
        return Windowed(self.shape.seeded(stream), self.start, self.end)

    def onsets(self) -> tuple[float, ...]:
        return self.shape.onsets()

    def remembering(self, value: float, onset: float) -> Shape:
        return Windowed(self.shape.remembering(value, onset), self.start, self.end)


def _time(what: str, t: float) -> float:
    if not (math.isfinite(t) and t >= 0):
        raise InputError(f"the {what} is at {t} s", why="a scenario begins at 0")
    return float(t)
