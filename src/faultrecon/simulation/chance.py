# SPDX-License-Identifier: BSD-3-Clause
"""Waveforms that chance draws, each from a stream of its own, and tables of recorded values.

Every random signal of a scenario has its own stream: NumPy's PCG64, seeded by `SeedSequence` with the scenario's seed
and the first 128 bits of SHA-256 of the signal's label.  So the same seed gives the same signal on every machine, a
signal added or removed leaves the others alone, and a longer run begins like a shorter one.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError
from faultrecon.simulation.composition import Bounded, Reading, Shape

Array = NDArray[Any]


def stream_seed(seed: int, label: str) -> int:
    """One number that seeds the stream of a label."""
    words = hashlib.sha256(label.encode()).digest()[:16]
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=tuple(int(w) for w in np.frombuffer(words, "<u4")))
    low, high = (int(w) for w in sequence.generate_state(2, np.uint64))
    return low + (high << 64)


@lru_cache(maxsize=256)
def normal_samples(seed: int, count: int) -> Array:
    """The first `count` standard normal samples of a stream; read-only, since they are remembered."""
    samples = np.random.Generator(np.random.PCG64(seed)).standard_normal(count)
    samples.setflags(write=False)
    return samples


def held_index(t: Array, hold: float) -> NDArray[np.intp]:
    """Which sample of a signal held for `hold` seconds is up at each time: k from the float hold * k on, exactly."""
    k = np.floor(np.asarray(t, dtype=float) / hold)
    k = k + (hold * (k + 1) <= t) - (hold * k > t)
    return k.astype(np.intp)


def held_edges(hold: float, end: float) -> tuple[float, ...]:
    """The times at which a held signal changes, up to the first one past `end`."""
    return tuple((hold * np.arange(1, math.floor(end / hold) + 2)).tolist())


@dataclass(frozen=True)
class HeldNoise(Shape):
    """Independent normal samples, each held for `hold` seconds; the scenario seeds it when `seed` is None."""

    sd: float
    hold: float
    seed: int | None = None

    def __post_init__(self) -> None:
        _spread(self.sd, self.hold)

    def values(self, t: Array, reading: Reading) -> Array:
        index = held_index(t, self.hold)
        return self.sd * normal_samples(_known(self.seed, self), int(index.max(initial=0)) + 1)[index]

    def edges(self, end: float) -> tuple[float, ...]:
        return held_edges(self.hold, end)

    def seeded(self, stream: Callable[[str], int]) -> Shape:
        return self if self.seed is not None else replace(self, seed=stream("held"))


@dataclass(frozen=True)
class RandomWalk(Shape):
    """A random drift: independent normal increments, spread `sd` after one second, straight lines over each `hold`."""

    sd: float
    hold: float = 0.1
    seed: int | None = None

    def __post_init__(self) -> None:
        _spread(self.sd, self.hold)

    def values(self, t: Array, reading: Reading) -> Array:
        position = t / self.hold
        steps = normal_samples(_known(self.seed, self), int(np.floor(position.max(initial=0.0))) + 2)
        path = np.concatenate(([0.0], np.cumsum(steps))) * self.sd * math.sqrt(self.hold)
        return np.interp(position, np.arange(len(path)), path)

    def edges(self, end: float) -> tuple[float, ...]:
        return held_edges(self.hold, end)

    def seeded(self, stream: Callable[[str], int]) -> Shape:
        return self if self.seed is not None else replace(self, seed=stream("walk"))


@dataclass(frozen=True)
class LooseContact(Shape):
    """An offset that comes and goes: on for `on` and off for `off` seconds on average, exponentially distributed."""

    size: float
    on: float
    off: float
    seed: int | None = None

    def __post_init__(self) -> None:
        _spread(abs(self.size), self.on)
        _spread(abs(self.size), self.off)

    def switches(self, end: float) -> Array:
        """Times up to beyond `end` at which it switches, on first."""
        seed, count = _known(self.seed, self), 16
        while True:
            waits = np.random.Generator(np.random.PCG64(seed)).standard_exponential(count)
            times = np.cumsum(waits * np.where(np.arange(count) % 2, self.on, self.off))
            if times[-1] > end:
                return times
            count *= 2

    def values(self, t: Array, reading: Reading) -> Array:
        times = self.switches(float(t.max(initial=0.0)))
        return self.size * (np.searchsorted(times, t, side="right") % 2)

    def edges(self, end: float) -> tuple[float, ...]:
        return tuple(float(s) for s in self.switches(end))

    @property
    def bounded(self) -> Bounded:
        return Bounded(abs(self.size), math.inf)

    def seeded(self, stream: Callable[[str], int]) -> Shape:
        return self if self.seed is not None else replace(self, seed=stream("contact"))


@dataclass(frozen=True)
class Table(Shape):
    """Recorded values: straight lines between them, or each held until the next; the last one stays."""

    times: tuple[float, ...]
    numbers: tuple[float, ...]
    held: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", tuple(float(s) for s in self.times))
        object.__setattr__(self, "numbers", tuple(float(v) for v in self.numbers))
        t, v = np.array(self.times), np.array(self.numbers)
        if t.shape != v.shape or t.size == 0 or not np.isfinite([t, v]).all() or np.any(np.diff(t) <= 0):
            raise InputError(f"a table has {t.size} times and {v.size} values", why="as many, finite, times increasing")

    @staticmethod
    def sampled(values: ArrayLike, sample_time: float, *, held: bool = False) -> Table:
        """One value per sample from time 0 on."""
        numbers = np.asarray(values, dtype=float)
        return Table(tuple(sample_time * np.arange(numbers.size)), tuple(numbers), held)

    def values(self, t: Array, reading: Reading) -> Array:
        times, numbers = np.array(self.times), np.array(self.numbers)
        if not self.held:
            return np.interp(t, times, numbers)
        return numbers[np.maximum(np.searchsorted(times, t, side="right") - 1, 0)]

    def edges(self, end: float) -> tuple[float, ...]:
        return self.times

    @property
    def bounded(self) -> Bounded:
        jumps = self.held or self.numbers[0] != 0
        rate = np.abs(np.diff(self.numbers) / np.diff(self.times)).max(initial=0.0)
        return Bounded(float(np.abs(self.numbers).max()), math.inf if jumps else float(rate))


def _known(seed: int | None, shape: Shape) -> int:
    if seed is None:
        raise InputError(f"{type(shape).__name__} has no seed", remedies=("pass seed=..., or use it in a Scenario",))
    return seed


def _spread(sd: float, hold: float) -> None:
    if not (math.isfinite(sd) and sd >= 0 and math.isfinite(hold) and hold > 0):
        raise InputError(f"a random signal of spread {sd} over {hold} s", why="a spread is >= 0 and a time positive")
