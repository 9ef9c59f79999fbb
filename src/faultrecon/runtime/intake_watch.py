# SPDX-License-Identifier: BSD-3-Clause
"""What is to be thought of each value: it came or not, is possible or not, stands at a limit, or stands still.

When does a value stand still for longer than its noise allows?  Let q be the step in which a sensor's readings come and
σ its noise, normal and independent from one hold to the next.  Wherever the true value lies, a sample falls into one
given step with a probability of at most p = erf(q / (2√2 σ)), and K of them all do with p^K.  K is the number that
makes this `RARE`.  It takes K hold times, and fewer than 20 samples are never called still.  q is the smallest change
seen so far; before the first change it is √12 σ, the step whose own rounding noise is all of σ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.runtime.intake_counts import Flag
from faultrecon.runtime.samples import Array

Flags = NDArray[np.uint8]
Tally = NDArray[np.int64]

USELESS = np.isin(
    np.arange(len(Flag)), (Flag.MISSING, Flag.OUT_OF_LIMITS, Flag.SATURATED)
)  # by flag: is no measurement
RARE = 1e-12  # the chance that noise alone leaves a healthy sensor standing still, per stretch of K samples
STILL = 20  # samples: fewer are never called still, whatever the noise
HOLDS = 10  # hold times, likewise
FINE = 0.15  # of σ: p = 0.06 and K = 9.8 at this step, so that a finer one changes nothing any more
TOUCH = 1e-6  # of the span: how near to a limit counts as at it; single precision rounds the limits by 6e-8
BLOCK = 8192  # rows: eight channels of them stay in the second cache


@dataclass(frozen=True, slots=True)
class Watch:
    """What one channel can do.  low, high: its limits.  sd: its noise, 0 for none declared, held for `hold` seconds.

    touches: samples at a limit from which on it counts as saturated.  still: identical samples from which on it counts
    as frozen; None derives it from the noise, and a channel without noise is then never frozen.
    """

    name: str
    low: float = -math.inf
    high: float = math.inf
    sd: float = 0.0
    hold: float = 0.0
    touches: int = 3
    still: int | None = None

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise InputError(f"the limits of {self.name} are {self.low:g} and {self.high:g}", why="low is below high")
        for name, value in (("sd", self.sd), ("hold", self.hold)):
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"the {name} of {self.name} is {value}", why="it is finite and not negative")
        for name, count in (("touches", self.touches), ("still", self.still)):
            if count is not None and count < 2:
                raise InputError(
                    f"{name} of {self.name} is {count}", why="one sample alone tells nothing; give 2 or more"
                )

    @property
    def tolerance(self) -> float:
        """How near to a limit counts as at it."""
        span = self.high - self.low
        ends = [abs(end) for end in (self.low, self.high) if math.isfinite(end)]
        return TOUCH * (span if math.isfinite(span) else max(ends, default=0.0))

    @property
    def judged(self) -> bool:
        """Whether standing still means something."""
        return self.sd > 0 or self.still is not None

    def samples(self, step: float) -> tuple[int, float]:
        """How many identical samples, over how many seconds, are too many when readings come in this step."""
        if self.still is not None:
            return self.still, -math.inf
        K = independent(math.sqrt(12.0) if math.isinf(step) else step / self.sd)
        # Half a hold less, since times are rounded and the first sample stands at an unknown place in its hold.
        return max(STILL, K), (K - 0.5) * self.hold


@lru_cache(maxsize=4096)
def independent(ratio: float) -> int:
    """K, the independent samples that noise leaves in one step of q = ratio σ with probability `RARE`; 10 at least."""
    p = math.erf(ratio / math.sqrt(8.0))
    if p <= 0.0:
        return HOLDS
    return max(HOLDS, math.ceil(math.log(RARE) / math.log(p))) if p < 1.0 else 2**62


@dataclass(frozen=True, eq=False, slots=True)
class Seen:
    """What is remembered of k channels, (k,) each: the last value that came, how often in a row it did, since when.

    step: the smallest change so far, no finer than matters.  side: -1 or 1 at a limit, touching: for how many samples.
    """

    value: Array
    run: NDArray[np.int64]
    since: Array
    step: Array
    side: NDArray[np.int64]
    touching: NDArray[np.int64]

    @staticmethod
    def nothing(channels: int) -> Seen:
        """Before the first sample."""
        value, since, step = (np.full(channels, fill) for fill in (math.nan, math.nan, math.inf))
        run, side, touching = np.zeros((3, channels), dtype=np.int64)
        return Seen(value, run, since, step, side, touching)


@dataclass(frozen=True)
class Watching:
    """The channels of one group, judged block by block."""

    channels: tuple[Watch, ...]

    @cached_property
    def _inside(self) -> tuple[Array, Array]:
        """Between these, (k,) each, a value is neither beyond a limit nor at it."""
        low = [w.low + w.tolerance for w in self.channels]
        return np.array(low, dtype=float), np.array([w.high - w.tolerance for w in self.channels], dtype=float)

    @cached_property
    def _judged(self) -> NDArray[np.intp]:
        return np.flatnonzero([w.judged for w in self.channels])

    @cached_property
    def _fine(self) -> Array:
        """The step below which a finer one changes nothing; infinite where steps do not matter at all."""
        told = [FINE * w.sd if w.judged and w.still is None else math.inf for w in self.channels]
        return np.array(told, dtype=float)

    def judge(self, before: Seen, t: Array, x: Array) -> tuple[Seen, Array, Flags, Tally]:
        """Values x (N, k) at times t (N,), NaN where they are of no use, the flags (N, k), how many of each (k, 5).

        The values are x itself where all are of use; columns of the flags lie in one piece.
        """
        rows, k = x.shape
        flags, usable, tally = np.zeros((k, rows), dtype=np.uint8).T, x, np.zeros((k, len(Flag)), dtype=np.int64)
        if not k:
            return before, usable, flags, tally
        for a in range(0, rows, BLOCK):
            b = min(a + BLOCK, rows)
            piece = x[a:b].T if x.flags.f_contiguous else np.ascontiguousarray(x[a:b].T)
            doubtful = np.flatnonzero(self._doubtful(before, piece))
            after = self._passed(before, float(t[b - 1]), piece)
            for j in doubtful:
                found = self._look(int(j), before, after, t[a:b], piece[j])
                flags[a:b, j] = found
                here = np.bincount(found, minlength=len(Flag))
                tally[j] += here
                if here[USELESS].any():
                    usable = x.copy(order="K") if usable is x else usable
                    usable[a:b, j][USELESS[found]] = math.nan
            before = after
        return before, usable, flags, tally

    def _doubtful(self, seen: Seen, piece: Array) -> NDArray[np.bool_]:
        """The channels of a block (k, B) that need a closer look, (k,): anything but new values within the limits."""
        low, high = self._inside
        doubtful = ~((piece.min(axis=1) > low) & (piece.max(axis=1) < high))  # NaN is neither
        j = self._judged
        if j.size:
            mine = piece if j.size == len(piece) else piece[j]
            doubtful[j] |= (mine[:, 0] == seen.value[j]) | (seen.step[j] > self._fine[j])
            doubtful[j] |= np.any(mine[:, 1:] == mine[:, :-1], axis=1)
        return doubtful

    def _passed(self, before: Seen, t: float, piece: Array) -> Seen:
        """What is remembered after a block of new values only; arrays that `_look` may still write to."""
        after = Seen.nothing(len(self.channels))
        j = self._judged
        after.value[j], after.run[j], after.since[j], after.step[:] = piece[j, -1], 1, t, before.step
        return after

    def _look(self, j: int, before: Seen, after: Seen, t: Array, x: Array) -> Flags:
        """The flags of one channel over a block, x (B,); what is remembered of it is written to `after`."""
        watch = self.channels[j]
        flags = np.full(len(x), Flag.MISSING, dtype=np.uint8)
        came = np.flatnonzero(~np.isnan(x))
        for name in ("value", "run", "since", "step", "side", "touching"):
            getattr(after, name)[j] = getattr(before, name)[j]
        if not came.size:
            return flags
        w, t = x[came], t[came]
        beyond = (w < watch.low - watch.tolerance) | (w > watch.high + watch.tolerance) | np.isinf(w)
        low, high = self._inside
        side = np.where(beyond, 0, (w >= high[j]).astype(np.int64) - (w <= low[j]))
        alike = side == np.concatenate(([before.side[j]], side[:-1]))
        touching = np.where(side != 0, _runs(alike, int(before.touching[j])), 0)
        after.side[j], after.touching[j] = side[-1], touching[-1]
        flags[came] = np.where(
            beyond, Flag.OUT_OF_LIMITS, np.where(touching >= watch.touches, Flag.SATURATED, Flag.GOOD)
        )
        if watch.judged:
            frozen = self._still(j, before, after, t, w) & (flags[came] == Flag.GOOD)
            flags[came[frozen]] = Flag.FROZEN
        return flags

    def _still(self, j: int, before: Seen, after: Seen, t: Array, w: Array) -> NDArray[np.bool_]:
        """Which values of one channel, all of them came, stand still for too long."""
        watch, fine = self.channels[j], self._fine[j]
        earlier = np.concatenate(([before.value[j]], w[:-1]))
        same = w == earlier
        run = _runs(same, int(before.run[j]))
        begin = np.maximum.accumulate(np.where(same, -1, np.arange(len(w))))
        since = np.where(begin < 0, before.since[j], t[np.maximum(begin, 0)])
        with np.errstate(over="ignore", invalid="ignore"):
            change = np.where(same | np.isnan(earlier), math.inf, np.maximum(np.abs(w - earlier), fine))
        step = np.minimum(np.minimum.accumulate(change), before.step[j])
        after.value[j], after.run[j], after.since[j], after.step[j] = w[-1], run[-1], since[-1], step[-1]
        frozen = np.zeros(len(w), dtype=bool)
        long = np.flatnonzero(run >= (watch.still or STILL))
        if long.size:
            with np.errstate(over="ignore"):
                lasts = t[long] - since[long]
            for one in np.unique(step[long]):
                count, seconds = watch.samples(float(one))
                frozen[long] |= (step[long] == one) & (run[long] >= count) & (lasts >= seconds)
        return frozen


def _runs(same: NDArray[np.bool_], before: int) -> NDArray[np.int64]:
    """How many in a row up to each place; `same`: as the one before it, whose own count is `before` at the first."""
    places = np.arange(len(same))
    begin = np.maximum.accumulate(np.where(same, -1, places))
    return np.where(begin < 0, before + places + 1, places - begin + 1)
