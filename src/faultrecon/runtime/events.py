# SPDX-License-Identifier: BSD-3-Clause
"""What happened, as rows: from when to when, what it is taken for, how large, and the numbers it was decided on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from faultrecon.runtime.decision import FAULT, MODES, NOBODY, RECOVERING, Standing
from faultrecon.runtime.samples import Trace


@dataclass(frozen=True, slots=True)
class Evidence:
    """One hypothesis over the window in which an event began.

    rejected: samples in which some test failed that its faults cannot excuse.  margin: the worst such test, in bounds;
    above 1 is outside.  acting: the largest its fault was, in bounds of what nothing could look like.  nis: normalised
    innovations squared, the mean over its healthy sensors of (residual / what noise makes of it)², some 1 by noise
    alone; 0 where no noise is declared.
    """

    hypothesis: str
    rejected: int
    margin: float
    acting: float
    nis: float


@dataclass(frozen=True, slots=True)
class Event:
    """One row: mode, what is named, start and end in s (end None: still going on), and the evidence at its start.

    fault: a hypothesis, or those that are left, the likeliest first.

    size: the largest estimate of each fault while it went on.  runner_up: the other hypothesis that came closest.
    """

    mode: str
    fault: str
    start: float
    end: float | None
    size: Mapping[str, float]
    runner_up: str
    evidence: tuple[Evidence, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "evidence": [asdict(one) for one in self.evidence], "size": dict(self.size)}

    @staticmethod
    def from_dict(found: Mapping[str, Any]) -> Event:
        """The inverse of `as_dict`."""
        return Event(**{**found, "evidence": tuple(Evidence(**one) for one in found["evidence"])})

    def __str__(self) -> str:
        end = "still going on" if self.end is None else f"to {self.end:g} s"
        sizes = ", ".join(f"{name} up to {value:.4g}" for name, value in self.size.items())
        said = f"{self.mode}{f'({self.fault})' if self.fault else ''} from {self.start:g} s {end}"
        return said + (f": {sizes}" if sizes else "") + (f"; runner-up {self.runner_up}" if self.runner_up else "")


@dataclass(frozen=True)
class Open:
    """An event that is going on.  hypothesis: its number, or NOBODY; one fault that recovers is still one event."""

    mode: int
    hypothesis: int
    name: str
    start: float
    runner_up: str
    evidence: tuple[Evidence, ...]
    size: Mapping[str, float]

    def goes_on(self, now: Standing) -> bool:
        """Whether the new decision is about the same thing."""
        same = now.named == self.hypothesis
        if self.hypothesis != NOBODY:
            return same and now.mode in (FAULT, RECOVERING, self.mode)
        return same and now.mode == self.mode

    def narrowed(self, now: Standing, evidence: Sequence[Evidence]) -> Open:
        """The same event, in which other explanations are left than before."""
        name = said(now, evidence)
        return replace(self, name=name) if name and self.hypothesis == NOBODY else self

    def seen(self, traces: Sequence[Trace], first: int, last: int) -> Open:
        """With the sizes of rows first to last counted in."""
        if self.hypothesis == NOBODY or last <= first:
            return self
        size = dict(self.size)
        for j, name in enumerate(size):
            part = np.abs(traces[self.hypothesis].fault[first:last, j])
            part = part[np.isfinite(part)]
            if part.size:
                size[name] = max(size[name], float(part.max()))
        return replace(self, size=size)

    def pack(self) -> dict[str, Any]:
        """Plain values."""
        return {**vars(self), "evidence": [asdict(one) for one in self.evidence], "size": dict(self.size)}

    @staticmethod
    def unpack(found: Mapping[str, Any]) -> Open:
        """The inverse of `pack`."""
        return Open(**{**found, "evidence": tuple(Evidence(**one) for one in found["evidence"])})


def opened(now: Standing, t: float, evidence: tuple[Evidence, ...], faults: Sequence[str] = ()) -> Open:
    """What begins at t with a decision; faults: those that are named."""
    others = [e for i, e in enumerate(evidence) if i != now.named]
    runner_up = min(others, key=lambda e: e.margin).hypothesis if others and now.named != NOBODY else ""
    name = said(now, evidence)
    return Open(now.mode, now.named, name, t, runner_up, evidence, dict.fromkeys(faults, 0.0))


def said(now: Standing, evidence: Sequence[Evidence]) -> str:
    """What is named, or may be meant, the likeliest first: the one whose fault stands out most from nothing."""
    if now.named != NOBODY:
        return evidence[now.named].hypothesis
    ordered = sorted((evidence[c] for c in now.candidates), key=lambda e: -e.acting)
    return " or ".join(e.hypothesis for e in ordered)


def closed(one: Open, t: float | None) -> Event:
    """The row of an event that ends at t, or has not ended (None)."""
    return Event(MODES[one.mode], one.name, one.start, t, one.size, one.runner_up, one.evidence)
