# SPDX-License-Identifier: BSD-3-Clause
"""Samples as they come, made fit for the estimator: in the order of their times, a row per time, each value judged.

Rows may arrive late, twice, out of order, in pieces (some channels now, others later with the same time) and without a
time; values may be absent, infinite, beyond what the device can put out, stuck at a limit or frozen.  What happens to
each is specified here and counted; nothing is dropped in silence:

    rows received = passed on + merged + duplicates + too late + without a time + still waiting.

- A row waits until one has come that is `reorder` seconds newer; then it leaves, in the order of times.  With 0, the
  default, no row waits, and what comes out of order comes too late.
- Rows of one time that meet while they wait become one row.  Where two give the same channel different values the
  first one stays and the other is counted as a conflict.  Any `reorder` above 0 lets them meet.
- A row no later than what has left is too late: it is counted and written nowhere.  One that repeats, value for value,
  what has just left is a duplicate.
- A time that is not finite is a bad time.  So is one more than `leap` seconds ahead of the newest, unless a second one
  in a row agrees with it: then the time has really leapt.
- Infinite values and those beyond the limits are taken for missing, and so is a value at a limit from its third sample
  on: it says that the truth is at least that.  A frozen value is flagged and passed on: a stuck sensor is a fault that
  is to be named.
- An interval longer than 1.5 sample times is a gap; the row after it says how many rows are missing.

The results do not depend on how the arrivals are cut into pieces, to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from faultrecon.finding import Finding, InputError
from faultrecon.plant.plant import Plant
from faultrecon.runtime.intake_counts import Counts, Flag, findings
from faultrecon.runtime.intake_order import Fates, Index, Rows, Waiting, arranged, flushed
from faultrecon.runtime.intake_watch import Flags, Seen, Watch, Watching
from faultrecon.runtime.samples import Array

GAP = 1.5  # sample times: half a sample of jitter on a missing row makes 1.5 or more, on none 1.5 or less


@dataclass(frozen=True, eq=False, slots=True)
class Taken:
    """Rows ready for the estimator: t (N,) strictly increasing, u (N, m), y (N, p), NaN where a value is of no use.

    flags_u (N, m), flags_y (N, p): `Flag` of each value.  lacking (N,): rows that should have come before each.
    arrival (N,): which row brought the time, counted from 0 since `init`.  fates (K,): `Fate` of each row that was
    given, in the order in which they arrived; those that are to be passed on may still wait.  counts: what became of
    what came.  Where nothing was to change the arrays may be those that were given: do not write to either.
    """

    t: Array
    u: Array
    y: Array
    flags_u: Flags
    flags_y: Flags
    lacking: Array
    arrival: Index
    fates: Fates
    counts: Counts

    def __len__(self) -> int:
        return len(self.t)

    def followed_by(self, *others: Taken) -> Taken:
        """This and what came out after it, as one."""
        parts = (self, *others)
        counts = self.counts
        for other in others:
            counts += other.counts
        names = [one.name for one in fields(Taken) if one.name != "counts"]
        joined: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return Taken(**joined, counts=counts)


@dataclass(frozen=True, eq=False, slots=True)
class IntakeState:
    """Where the intake stands between two pieces: what waits, what was seen of each channel, and all counts so far."""

    waiting: Waiting
    seen_u: Seen
    seen_y: Seen
    counts: Counts

    def __repr__(self) -> str:
        c = self.counts
        return f"IntakeState({c.received} rows received, {c.passed} passed on, {len(self.waiting.t)} waiting)"

    def pack(self) -> dict[str, Any]:
        """Plain numbers and arrays by name, for a checkpoint; `unpack` gives the same state to the last bit."""
        out = {
            f"{part}.{one.name}": getattr(whole, one.name)
            for part, whole in (("waiting", self.waiting), ("seen_u", self.seen_u), ("seen_y", self.seen_y))
            for one in fields(whole)
        }
        out |= {f"counts.{name}": value for name, value in self.counts.pack().items()}
        return {name: v.copy() if isinstance(v, np.ndarray) else v for name, v in out.items()}

    @staticmethod
    def unpack(packed: Mapping[str, Any]) -> IntakeState:
        """The state that `pack` described.  Raises InputError where a part is missing or does not fit."""
        counts = Counts.unpack({key[7:]: value for key, value in packed.items() if key.startswith("counts.")})
        try:
            m, p = (int(np.asarray(packed[f"seen_{g}.value"]).size) for g in "uy")
            like = {"waiting": Waiting.nothing(m, p), "seen_u": Seen.nothing(m), "seen_y": Seen.nothing(p)}
            k = int(np.asarray(packed["waiting.t"]).size)
            waiting, seen_u, seen_y = (_like(blank, name, packed, k) for name, blank in like.items())
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(
                "the stored state of the intake is damaged",
                why=f"{type(error).__name__}: {error}",
                remedies=("start from an undamaged checkpoint",),
            ) from error
        return IntakeState(waiting, seen_u, seen_y, counts)


def _like(blank: Any, part: str, packed: Mapping[str, Any], rows: int) -> Any:
    """A Waiting or a Seen from packed values, each of the kind and shape of the blank one."""
    found = {}
    for one in fields(blank):
        model, value = getattr(blank, one.name), packed[f"{part}.{one.name}"]
        if isinstance(model, np.ndarray):
            value = np.array(value, dtype=model.dtype)
            # What waits has a row each; everything else is one number per channel.
            shape = (rows, *model.shape[1:]) if part == "waiting" and len(model) == 0 else model.shape
            found[one.name] = value.reshape(shape)
        else:
            found[one.name] = type(model)(value)
    return type(blank)(**found)


@dataclass(frozen=True)
class Intake:
    """How samples are taken in: pure `init`, `take` and `flush`.  Use `Intake.of` for a plant.

    sample_time: s, for gaps alone.  u, y: what each channel can do.  reorder: s that rows wait for older ones; inf
    sorts a whole log.  leap: s by which one time may be ahead of the newest; inf believes every time.
    """

    sample_time: float
    u: tuple[Watch, ...]
    y: tuple[Watch, ...]
    reorder: float = 0.0
    leap: float = math.inf

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sample_time) and self.sample_time > 0):
            raise InputError(f"the sample time is {self.sample_time}", why="it is a positive number of seconds")
        if not self.reorder >= 0:
            raise InputError(f"rows are to wait for {self.reorder} s", remedies=("give 0 or more seconds",))
        if not self.leap > 0:
            raise InputError(f"a time may leap {self.leap} s ahead", remedies=("give a positive number of seconds",))
        if not self.y:
            raise InputError("an intake without sensors", why="there is nothing to take in")

    @staticmethod
    def of(
        plant: Plant,
        sample_time: float | None = None,
        *,
        reorder: float = 0.0,
        leap: float = math.inf,
        touches: int = 3,
        still: Mapping[str, int] | None = None,
    ) -> Intake:
        """The intake for a plant's signals, with their limits and noise.

        sample_time: the plant's own, else the hold of its noise by default.  touches: samples at a limit that saturate.
        still: by name, after how many identical samples a channel counts as frozen, in place of what its noise says.
        """
        noise, signals = plant.noise, plant.signals
        if sample_time is None:
            sample_time = plant.sample_time or (noise.hold if noise is not None else None)
        if sample_time is None:
            raise InputError(f"{plant.name} tells no sample time", remedies=("pass sample_time=...",))
        asked = dict(still or {})
        for name in asked:
            if name not in signals.u.names:
                signals.y.index(name)  # or InputError with a suggestion
        sd = dict(zip(signals.y.names, noise.sd, strict=True)) if noise is not None else {}
        hold = noise.hold if noise is not None else 0.0
        u, y = (
            tuple(
                Watch(name, low, high, sd.get(name, 0.0), hold, touches, asked.get(name))
                for name, (low, high) in zip(group.names, group.limits, strict=True)
            )
            for group in (signals.u, signals.y)
        )
        return Intake(float(sample_time), u, y, float(reorder), float(leap))

    @property
    def names(self) -> tuple[str, ...]:
        """Inputs, then sensors: the order of all counts per channel."""
        return tuple(w.name for w in (*self.u, *self.y))

    @cached_property
    def _watching(self) -> tuple[Watching, Watching]:
        return Watching(self.u), Watching(self.y)

    def init(self) -> IntakeState:
        """Before the first row."""
        m, p = len(self.u), len(self.y)
        return IntakeState(Waiting.nothing(m, p), Seen.nothing(m), Seen.nothing(p), Counts.none(m + p))

    def take(self, state: IntakeState, t: ArrayLike, u: ArrayLike, y: ArrayLike) -> tuple[IntakeState, Taken]:
        """Rows in the order in which they arrived, any number of them: t (N,), u (N, m), y (N, p), NaN: nothing came.

        One row may come as a number and two lists.  Raises InputError on a wrong shape, and on nothing else.
        """
        first = state.waiting.received
        rows = _rows(t, u, y, (len(self.u), len(self.y)), first)
        return self._judged(state, *arranged(state.waiting, rows, self.reorder, self.leap))

    def flush(self, state: IntakeState) -> tuple[IntakeState, Taken]:
        """All rows that still wait: nothing more is expected.  What comes later than this may still be taken in."""
        return self._judged(state, *flushed(state.waiting), np.empty(0, dtype=np.int8))

    def whole(self, t: ArrayLike, u: ArrayLike, y: ArrayLike) -> Taken:
        """A whole recording at once."""
        state, first = self.take(self.init(), t, u, y)
        _, last = self.flush(state)
        return first.followed_by(last) if len(last) else first

    def findings(self, counts: Counts) -> tuple[Finding, ...]:
        """What somebody should know about the samples that came; () when all is well."""
        return findings(counts, self.names, self.sample_time, self.reorder)

    def _judged(
        self, state: IntakeState, waiting: Waiting, ready: Rows, counts: Counts, fates: Fates
    ) -> tuple[IntakeState, Taken]:
        """Ordered rows with each value judged."""
        lacking = self._lacking(state.waiting.left, ready.t)
        watching_u, watching_y = self._watching
        seen_u, u, flags_u, of_u = watching_u.judge(state.seen_u, ready.t, ready.u)
        seen_y, y, flags_y, of_y = watching_y.judge(state.seen_y, ready.t, ready.y)
        tally = np.concatenate((of_u, of_y)).T.tolist()
        gaps = lacking[lacking > 0]
        counts = replace(
            counts,
            gaps=len(gaps),
            gap_rows=sum(map(int, gaps.tolist())),  # whole numbers of any size, so that no order of adding matters
            missing=tuple(tally[Flag.MISSING]),
            out_of_limits=tuple(tally[Flag.OUT_OF_LIMITS]),
            saturated=tuple(tally[Flag.SATURATED]),
            frozen=tuple(tally[Flag.FROZEN]),
        )
        taken = Taken(ready.t, u, y, flags_u, flags_y, lacking, ready.arrival, fates, counts)
        return IntakeState(waiting, seen_u, seen_y, state.counts + counts), taken

    def _lacking(self, before: float, t: Array) -> Array:
        """How many rows are missing before each, (N,); none before the very first."""
        out = np.zeros(len(t))
        if not len(t):
            return out
        with np.errstate(over="ignore"):
            intervals = np.minimum(np.diff(t), np.finfo(float).max)
            first = min(float(t[0]) - before, float(np.finfo(float).max)) if before > -math.inf else 0.0
        for here, lengths in ((slice(0, 1), np.array([first])), (slice(1, None), intervals)):
            if lengths.size and lengths.max() > GAP * self.sample_time:
                with np.errstate(over="ignore"):
                    beats = np.minimum(np.rint(lengths / self.sample_time), np.finfo(float).max)
                out[here] = np.where(lengths > GAP * self.sample_time, np.maximum(beats - 1.0, 1.0), 0.0)
        return out


def _rows(t: ArrayLike, u: ArrayLike, y: ArrayLike, sizes: tuple[int, int], first: int) -> Rows:
    """Arrived rows as arrays of floats; one row, or one channel, may come with an axis less.  Raises InputError."""
    try:
        times, *values = (np.asarray(a, dtype=float) for a in (t, u, y))
    except (TypeError, ValueError) as error:
        raise InputError("the samples are no numbers", why=str(error), remedies=("NaN says absent",)) from error
    single, rows = times.ndim == 0, times.size
    for k, (name, size) in enumerate(zip("uy", sizes, strict=True)):
        known = [(rows, size), *([(rows,)] if size == 1 else []), *([(size,)] if single else [])]
        if values[k].shape not in known or times.ndim > 1:
            why = f"this intake takes ({rows}, {size})"
            raise InputError(f"{name} is {values[k].shape} for times of {times.shape}", why=why)
        values[k] = values[k].reshape(rows, size)
    return Rows(times.reshape(rows), values[0], values[1], np.arange(first, first + rows, dtype=np.int64))
