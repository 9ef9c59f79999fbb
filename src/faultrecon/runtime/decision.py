# SPDX-License-Identifier: BSD-3-Clause
"""From tests to a name: which hypothesis explains the samples, said only when it has held for a while.

"All healthy" is contradicted when some test fails in at least half of the last `window` samples, and a hypothesis is
rejected when tests that its faults cannot excuse fail in as many.  By Markov's inequality that happens by chance no
more often than 2/window times the chance of one sample to lie outside, whatever the correlation between samples; so
one wild sample never decides anything.

A hypothesis that is not rejected explains the samples, tested or not: silence and a start that is not over refute
nothing.  Only one that was tested in at least half of a window is named, so one that has just begun never looks best.

- `fault(name)`: "all healthy" is contradicted, and of the hypotheses with the fewest faults this one alone is not
  rejected, which has been so for `window` samples; and it is tested.
- `suspect`: "all healthy" is contradicted, and several explain it, or one for not long enough, or none.
- `out_of_envelope`: for `patience` windows nothing has explained it: the plant is not the model, or bounds are broken.
- `recovering`: no test has failed for a window since a fault was named, which is tested and its sensor heard; after two
  more windows it is over.
- `warming`: no hypothesis is tested: too much is left of the start or of a gap, or no sensor is heard.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

MODES = (
    "warming",
    "tracking",
    "suspect",
    "fault",
    "recovering",
    "stale",
    "unobserved",
    "out_of_envelope",
)
WARMING, TRACKING, SUSPECT, FAULT, RECOVERING, STALE, UNOBSERVED, OUTSIDE = range(len(MODES))
NOBODY = -1


@dataclass(frozen=True, slots=True)
class Rules:
    """window: samples that a statement rests on; patience: windows without an explanation before that is said."""

    window: int = 24
    patience: int = 8

    @property
    def enough(self) -> int:
        """How many samples of a window count as a rejection."""
        return (self.window + 1) // 2


@dataclass(frozen=True, slots=True)
class Verdicts:
    """What the tests say over N samples.

    contradicted, quiet (N, 1): "all healthy" does not hold; no test has failed for a window.  rejected, ready, heard
    (N, hypotheses): it does not explain the samples; it was tested, and the sensors it calls faulty were heard,
    in at least half of a window.
    """

    contradicted: Array
    quiet: Array
    rejected: Array
    ready: Array
    heard: Array


@dataclass(frozen=True)
class Counts:
    """The last `window` - 1 samples as 0 and 1: a test failed (window - 1, 1), each hypothesis was out, was tested, its
    sensors were heard.
    """

    failed: Array
    outside: Array
    faded: Array
    heard: Array

    @staticmethod
    def none(rules: Rules, hypotheses: int) -> Counts:
        """Before the first sample."""
        empty = np.zeros((rules.window - 1, hypotheses), dtype=np.int8)
        return Counts(empty[:, :1], empty, empty, empty)

    @property
    def uneventful(self) -> bool:
        """Whether no test fails, and every hypothesis is tested and its sensors are heard, at every sample."""
        return bool(self.faded.all() and self.heard.all()) and not (self.failed.any() or self.outside.any())


def counted(rules: Rules, before: Counts, now: Counts) -> tuple[Counts, Verdicts]:
    """The verdicts over N samples, from 0 and 1 as in `Counts`, and what the next ones go on from."""
    W, sums, after = rules.window, [], []
    for name in ("failed", "outside", "faded", "heard"):
        both = np.vstack([getattr(before, name), getattr(now, name).astype(np.int8)])
        total = np.cumsum(both, axis=0, dtype=np.int32)
        total = np.vstack([np.zeros((1, both.shape[1]), dtype=np.int32), total])
        sums.append(total[W:] - total[:-W])
        after.append(both[len(both) - (W - 1) :])
    failed, outside, faded, heard = sums
    least = rules.enough
    return Counts(*after), Verdicts(failed >= least, failed == 0, outside >= least, faded >= least, heard >= least)


@dataclass(frozen=True)
class Standing:
    """Where the decision stands: mode, the hypothesis that is named, and since when what has been so (samples)."""

    mode: int = WARMING
    named: int = NOBODY
    candidates: tuple[int, ...] = ()
    candidate_since: int = 0
    unexplained_since: int = -1
    quiet_since: int = -1
    samples: int = 0


@dataclass(frozen=True)
class Change:
    """The decision after `row` of the samples at hand."""

    row: int
    before: Standing
    after: Standing


@dataclass(frozen=True)
class Decider:
    """The rules, applied to hypotheses of so many faults each; 'all healthy' is the one that is always there."""

    rules: Rules
    faults: tuple[int, ...]
    _order: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_order", tuple(sorted(set(self.faults))))

    def take(
        self, counts: Counts, standing: Standing, now: Counts
    ) -> tuple[Counts, Standing, list[Change], NDArray[np.bool_]]:
        """N samples on: what is counted, where the decision stands, how it came to that, and which hypotheses were
        tested enough, (N, hypotheses).
        """
        if standing.mode == TRACKING and not standing.candidates and counts.uneventful and now.uneventful:
            return counts, replace(standing, samples=standing.samples + len(now.failed)), [], now.faded
        after, verdicts = counted(self.rules, counts, now)
        there, changes = self.decide(standing, verdicts)
        return after, there, changes, verdicts.ready

    def decide(self, standing: Standing, verdicts: Verdicts) -> tuple[Standing, list[Change]]:
        """The changes over N samples, and where the decision stands after them."""
        rows = len(verdicts.ready)
        if rows == 0:
            return standing, []
        table = np.hstack(_parts(verdicts))
        edges = np.flatnonzero(np.any(table[1:] != table[:-1], axis=1)) + 1
        changes: list[Change] = []
        begin = standing.samples
        for a, b in zip([0, *edges.tolist()], [*edges.tolist(), rows], strict=True):
            k = a
            while k < b:
                new, again = self._at(standing, begin + k, *(part[a] for part in _parts(verdicts)))
                if (new.mode, new.named, new.candidates) != (standing.mode, standing.named, standing.candidates):
                    changes.append(Change(k, standing, new))
                standing = new
                k = b if again is None else min(b, max(k + 1, again - begin))
        standing = replace(standing, samples=begin + rows)
        return standing, changes

    def _at(
        self, now: Standing, k: int, failing: Array, calm: Array, rejected: Array, ready: Array, heard: Array
    ) -> tuple[Standing, int | None]:
        """The decision at sample k, and the sample at which to look again if nothing changes."""
        contradicted, quiet = bool(failing[0]), bool(calm[0])
        found = self._explain(~rejected) if contradicted else ()
        if found != now.candidates:
            now = replace(now, candidates=found, candidate_since=k)
        if now.named != NOBODY and not rejected[now.named]:
            kept, due = self._keep(now, k, bool(quiet and heard[now.named] and ready[now.named]))
            if kept.named != NOBODY:
                return kept, due
            now = kept
        if not ready.any():
            return replace(now, mode=WARMING, named=NOBODY, unexplained_since=-1, quiet_since=-1), None
        if not contradicted:
            return replace(now, mode=TRACKING, named=NOBODY, unexplained_since=-1, quiet_since=-1), None
        if found:
            return self._suspect(now, k, ready)
        since = k if now.unexplained_since < 0 else now.unexplained_since
        due = since + self.rules.patience * self.rules.window
        mode = OUTSIDE if k >= due else SUSPECT
        return replace(now, mode=mode, named=NOBODY, unexplained_since=since), None if k >= due else due

    def _suspect(self, now: Standing, k: int, ready: Array) -> tuple[Standing, int | None]:
        """Some hypotheses explain what the healthy plant does not: is it one alone, tested, and for long enough?"""
        now, due = replace(now, unexplained_since=-1), now.candidate_since + self.rules.window
        sole = now.candidates[0]
        if len(now.candidates) > 1 or not ready[sole]:
            return replace(now, mode=SUSPECT, named=NOBODY), None
        if k >= due:
            return replace(now, mode=FAULT, named=sole, quiet_since=-1), None
        return replace(now, mode=SUSPECT, named=NOBODY), due

    def _keep(self, now: Standing, k: int, quiet: bool) -> tuple[Standing, int | None]:
        """The named fault still explains everything: it acts, is about to be over, or is over: then nobody is named."""
        now = replace(now, unexplained_since=-1)
        if not quiet:
            return replace(now, mode=FAULT, quiet_since=-1), None
        since = k if now.quiet_since < 0 else now.quiet_since
        due = since + 2 * self.rules.window
        if k >= due:
            return replace(now, named=NOBODY, quiet_since=-1), None
        return replace(now, mode=RECOVERING, quiet_since=since), due

    def _explain(self, fits: Array) -> tuple[int, ...]:
        """The hypotheses that fit, of those with the fewest faults among them."""
        for size in self._order:
            found = tuple(i for i in np.flatnonzero(fits).tolist() if self.faults[i] == size)
            if found:
                return found
        return ()


def _parts(verdicts: Verdicts) -> Sequence[Array]:
    return verdicts.contradicted, verdicts.quiet, verdicts.rejected, verdicts.ready, verdicts.heard
