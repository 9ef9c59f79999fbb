# SPDX-License-Identifier: BSD-3-Clause
"""From tests to a name: which hypothesis explains the samples, said only when it has held for a while.

"All healthy" is contradicted when some test fails in at least half of the last `window` samples, and a hypothesis is
rejected when tests that its faults cannot excuse fail in as many.  By Markov's inequality that happens by chance no
more often than 2/window times the chance of one sample to lie outside, whatever the correlation between samples; so
one wild sample never decides anything.

- `fault(name)`: "all healthy" is contradicted, and of the hypotheses with the fewest faults this one alone is not
  rejected, which has been so for `window` samples.
- `suspect`: "all healthy" is contradicted, and several explain it, or none has for long enough.
- `out_of_envelope`: for `patience` windows nothing has explained it: the plant is not the model, or bounds are broken.
- `recovering`: no test has failed for a window since a fault was named; after two more windows it is over.
- `warming`: no hypothesis has seen enough of the start to be tested.

A hypothesis that has just begun is not ready for a window, so it never looks best.
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

    contradicted, quiet (N, 1): "all healthy" does not hold; no test has failed for a window.  rejected, ready (N,
    hypotheses): it does not explain the samples; it has been tested for a window.
    """

    contradicted: Array
    quiet: Array
    rejected: Array
    ready: Array


@dataclass(frozen=True)
class Counts:
    """The last `window` - 1 samples as 0 and 1: a test failed (window - 1, 1), each hypothesis was out, was tested."""

    failed: Array
    outside: Array
    faded: Array

    @staticmethod
    def none(rules: Rules, hypotheses: int) -> Counts:
        """Before the first sample."""
        empty = np.zeros((rules.window - 1, hypotheses), dtype=np.int8)
        return Counts(empty[:, :1], empty, empty)


def counted(rules: Rules, before: Counts, failed: Array, outside: Array, faded: Array) -> tuple[Counts, Verdicts]:
    """The verdicts over N samples, from 0 and 1 as in `Counts`, and what the next ones go on from."""
    W, sums, after = rules.window, [], []
    for old, new in ((before.failed, failed), (before.outside, outside), (before.faded, faded)):
        both = np.vstack([old, new.astype(np.int8)])
        total = np.cumsum(both, axis=0, dtype=np.int64)
        total = np.vstack([np.zeros((1, both.shape[1]), dtype=np.int64), total])
        sums.append(total[W:] - total[:-W])
        after.append(both[len(both) - (W - 1) :])
    ready = sums[2] == W
    return Counts(*after), Verdicts(sums[0] >= rules.enough, sums[0] == 0, (sums[1] >= rules.enough) & ready, ready)


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
        self, now: Standing, k: int, failing: Array, calm: Array, rejected: Array, ready: Array
    ) -> tuple[Standing, int | None]:
        """The decision at sample k, and the sample at which to look again if nothing changes."""
        W = self.rules.window
        if not ready.any():
            return replace(now, mode=WARMING if now.named == NOBODY else now.mode), None
        contradicted, quiet = bool(failing[0]), bool(calm[0])
        found = self._explain(ready & ~rejected) if contradicted else ()
        if found != now.candidates:
            now = replace(now, candidates=found, candidate_since=k)
        sole = found[0] if len(found) == 1 else NOBODY
        if now.named != NOBODY and not rejected[now.named]:
            return self._keep(now, k, quiet)
        if not contradicted:
            return replace(now, mode=TRACKING, named=NOBODY, unexplained_since=-1, quiet_since=-1), None
        if sole != NOBODY:
            due = now.candidate_since + W
            if k >= due:
                return replace(now, mode=FAULT, named=sole, unexplained_since=-1, quiet_since=-1), None
            return replace(now, mode=SUSPECT, unexplained_since=-1), due
        if found:
            return replace(now, mode=SUSPECT, unexplained_since=-1), None
        since = k if now.unexplained_since < 0 else now.unexplained_since
        due = since + self.rules.patience * W
        mode = OUTSIDE if k >= due else SUSPECT
        named = NOBODY if mode == OUTSIDE else now.named
        return replace(now, mode=mode, named=named, unexplained_since=since), None if k >= due else due

    def _keep(self, now: Standing, k: int, quiet: bool) -> tuple[Standing, int | None]:
        """The named fault still explains everything: it acts, or it is about to be over."""
        now = replace(now, unexplained_since=-1)
        if not quiet:
            return replace(now, mode=FAULT, quiet_since=-1), None
        since = k if now.quiet_since < 0 else now.quiet_since
        due = since + 2 * self.rules.window
        if k >= due:
            return replace(now, mode=TRACKING, named=NOBODY, quiet_since=-1), None
        return replace(now, mode=RECOVERING, quiet_since=since), due

    def _explain(self, fits: Array) -> tuple[int, ...]:
        """The hypotheses that fit, of those with the fewest faults among them."""
        for size in self._order:
            found = tuple(i for i in np.flatnonzero(fits).tolist() if self.faults[i] == size)
            if found:
                return found
        return ()


def _parts(verdicts: Verdicts) -> Sequence[Array]:
    return verdicts.contradicted, verdicts.quiet, verdicts.rejected, verdicts.ready
