# SPDX-License-Identifier: BSD-3-Clause
"""What a monitor said about a log, against the truth: named or missed, after how long, how well, and false alarms.

An episode is a stretch in which a true fault is beyond `ACTS` of its largest size; pauses that a monitor has no time to
notice belong to it.  The monitor has answered if it names the fault while the fault lasts or within `grace` after it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.counting import rate_interval
from faultrecon.runtime.events import Event
from faultrecon.runtime.monitor import Monitor

Array = NDArray[Any]

ACTS = 0.05  # of its largest size: from where on a true fault counts as there, and delays are counted
NOTHING = 1e-6  # of its largest size: what rounding makes of a fault that is not there, where y - y_true is the truth
GRACE = 3  # windows: one to see that a fault is over, two more until its name is taken back
AWARE = ("suspect", "fault", "out_of_envelope")
IDLE = ("warming", "stale", "unobserved")  # modes in which nothing is decided: no operating time


@dataclass(frozen=True, slots=True)
class Episode:
    """One stretch of a true fault, from `begin` to `end` in s; size: the largest it was, in its unit.

    noticed, named: s from the beginning to the first word that something is wrong, and to the fault's name; NaN where
    that never came.  size_error: RMS of f̂ - f while it was named, over size.  inside: the share of its samples in which
    f̂ was within its bound; NaN without a hypothesis.  instead: what was named meanwhile and did not act.
    """

    fault: str
    begin: float
    end: float
    size: float
    noticed: float
    named: float
    size_error: float
    inside: float
    instead: tuple[str, ...]

    @property
    def missed(self) -> bool:
        """Whether it was never named."""
        return math.isnan(self.named)

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "instead": list(self.instead), "missed": self.missed}

    def __str__(self) -> str:
        noticed = "never noticed" if math.isnan(self.noticed) else f"noticed after {self.noticed:.2f} s"
        said = ["missed" if self.missed else f"named after {self.named:.2f} s", noticed]
        said += [] if math.isnan(self.size_error) else [f"size error {100 * self.size_error:.3g} %"]
        said += [] if math.isnan(self.inside) else [f"{100 * self.inside:.4g} % within its bound"]
        said += [f"{' and '.join(self.instead)} named wrongly"] if self.instead else []
        return f"{self.fault} from {self.begin:g} to {self.end:g} s, up to {self.size:.4g}: {', '.join(said)}"


@dataclass(frozen=True)
class Told:
    """The scores of one log.  episodes: by time.  false_alarms: events that name something that did not act then.

    of_nothing: those of them that came while nothing acted.  hours, healthy_hours: in which something could be decided,
    and in which nothing acted besides.  inside: for each fault the share of samples within its bound, counted until
    another fault acts: a bound takes the other sensors for healthy.
    """

    episodes: tuple[Episode, ...]
    false_alarms: int
    of_nothing: int
    hours: float
    healthy_hours: float
    inside: Mapping[str, float]

    @property
    def missed(self) -> tuple[Episode, ...]:
        """The episodes that were never named."""
        return tuple(one for one in self.episodes if one.missed)

    @property
    def false_alarms_per_hour(self) -> float:
        """False alarms while nothing acted, per hour of that; NaN without any."""
        return self.of_nothing / self.healthy_hours if self.healthy_hours > 0 else math.nan

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for `--json`."""
        return {
            "episodes": [one.as_dict() for one in self.episodes],
            "missed": len(self.missed),
            "false_alarms": self.false_alarms,
            "false_alarms_of_nothing": self.of_nothing,
            "hours": self.hours,
            "healthy_hours": self.healthy_hours,
            "false_alarms_per_hour": self.false_alarms_per_hour,
            "false_alarms_per_hour_at_most": rate_interval(self.of_nothing, self.healthy_hours)[1],
            "inside": dict(self.inside),
        }

    def __str__(self) -> str:
        lines = [str(one) for one in self.episodes] or ["no fault acts"]
        wrong = self.false_alarms - self.of_nothing
        lines += [f"{wrong} wrong name{'s' * (wrong > 1)} while a fault acted"] if wrong else []
        return "\n".join([*lines, alarm_rate(self.of_nothing, self.healthy_hours)])


def alarm_rate(count: int, hours: float) -> str:
    """So many false alarms in so many hours without a fault, and what that says about the rate."""
    if not hours > 0:
        return "no time without a fault: false alarms cannot be counted"
    low, high = rate_interval(count, hours)
    between = f"{low:.3g} to {high:.3g}" if count else f"at most {high:.3g}"
    alarms = f"{count or 'no'} false alarm{'s' * (count != 1)}"
    return f"{alarms} in {hours:.3g} h without a fault: {between} per hour"


# ---------------------------------------------------------------- scoring


def scored(monitor: Monitor, rows: Mapping[str, Array], events: Sequence[Event], truth: Mapping[str, Array]) -> Told:
    """The rows and events of a monitor against the truth; see `told`."""
    members = {h.name: h.faults for h in monitor.hypotheses}
    return told(rows, events, truth, members=members, grace=GRACE * monitor.rules.window * monitor.sample_time)


def told(
    rows: Mapping[str, Array],
    events: Sequence[Event],
    truth: Mapping[str, Array],
    *,
    members: Mapping[str, Sequence[str]] | None = None,
    grace: float = 0.0,
) -> Told:
    """Scores of one log.

    rows: t, mode, fault, f_<fault>, f_<fault>_bound, (N,) each, in order of time.  truth: the waveform of each fault,
    (N,); NaN where it is not known, and nothing for faults that never act.  members: the faults of each name, where
    they are not the name itself.  grace: s after a fault in which its name still counts as said in time.
    """
    log = _Said(rows, members or {}, truth, grace)
    episodes = [log.episode(fault, span) for fault, found in log.spans.items() for span in found]
    alarms = [k for event in events if event.mode == "fault" and log.false(event.fault, k := log.row(event.start))]
    waits = np.diff(log.t, prepend=log.t[:1]) * ~np.isin(rows["mode"], IDLE) / 3600.0
    return Told(
        tuple(sorted(episodes, key=lambda one: (one.begin, one.fault))),
        len(alarms),
        sum(bool(log.healthy[k]) for k in alarms),
        float(waits.sum()),
        float(waits[log.healthy].sum()),
        {fault: log.share_inside(fault, log.until_another(fault)) for fault in truth if f"f_{fault}" in rows},
    )


def aligned(t: Array, times: Array, values: Array) -> Array:
    """Values that came at `times`, in any order and some twice, at the times t; the first of each time counts.

    In straight lines between them, where a time never came.
    """
    known = np.flatnonzero(np.isfinite(times))
    found, first = np.unique(times[known], return_index=True)
    return np.interp(t, found, values[known][first]) if len(found) else np.full(len(t), math.nan)


@dataclass(frozen=True, slots=True)
class _Span:
    """The rows of an episode: the first and the last with any of the fault, and those beyond `ACTS` of it."""

    first: int
    begin: int
    end: int
    last: int


@dataclass(frozen=True, eq=False)
class _Said:
    """A log beside its truth, row by row."""

    rows: Mapping[str, Array]
    members: Mapping[str, Sequence[str]]
    truth: Mapping[str, Array]
    grace: float

    @cached_property
    def t(self) -> Array:
        """Time of each row (N,), s."""
        return np.asarray(self.rows["t"], dtype=float)

    @cached_property
    def spans(self) -> dict[str, list[_Span]]:
        """The episodes of each fault."""
        return {fault: _spans(self.t, values, self.grace) for fault, values in self.truth.items()}

    @cached_property
    def near(self) -> dict[str, Array]:
        """For each fault the rows in which it acts, or did just before."""
        return {fault: self._rows_of(found, self.grace) for fault, found in self.spans.items()}

    @cached_property
    def healthy(self) -> Array:
        """The rows in which nothing acts, nor did just before; none of those whose truth is not known."""
        out = np.ones(len(self.t), dtype=bool)
        for fault, values in self.truth.items():
            out &= np.isfinite(values) & ~self.near[fault]
        return out

    def _rows_of(self, spans: Sequence[_Span], grace: float) -> Array:
        near = np.zeros(len(self.t), dtype=bool)
        for span in spans:
            near[span.first : self._until(span, grace)] = True
        return near

    def _until(self, span: _Span, grace: float) -> int:
        return int(np.searchsorted(self.t, self.t[span.last] + grace, side="right"))

    def row(self, time: float) -> int:
        """The row of an event's start."""
        return min(int(np.searchsorted(self.t, time)), len(self.t) - 1)

    def false(self, name: str, rows: Any) -> Array:
        """Whether a fault of this name does not act at the rows, nor did just before."""
        nowhere = np.zeros(len(self.t), dtype=bool)
        return ~np.all([self.near.get(fault, nowhere)[rows] for fault in self._faults_of(name)], axis=0)

    def _faults_of(self, name: str) -> tuple[str, ...]:
        return tuple(self.members.get(name, (name,)))

    def episode(self, fault: str, span: _Span) -> Episode:
        """One episode, and what was said during it."""
        here = slice(span.first, self._until(span, self.grace))
        named, lasts = self.rows["fault"][here], span.last - span.first + 1
        right, other = np.zeros(len(named), dtype=bool), np.zeros(len(named), dtype=bool)
        instead: list[tuple[int, str]] = []
        for name in (str(one) for one in np.unique(named) if one):
            said, wrong = named == name, self.false(name, here)
            if fault in self._faults_of(name):
                right |= said
            else:
                other |= said & ~wrong  # the name of another fault that does act is no word about this one
            if (said & wrong)[:lasts].any():
                instead.append((int(np.argmax(said & wrong)), name))
        aware = np.isin(self.rows["mode"][here], AWARE) & ~other
        size = float(np.nanmax(np.abs(self.truth[fault][span.begin : span.end + 1])))
        return Episode(
            fault,
            float(self.t[span.begin]),
            float(self.t[span.end]),
            size,
            self._after(span, aware),
            self._after(span, right),
            self._size_error(fault, span.first + np.flatnonzero(right[:lasts]), size),
            self.share_inside(fault, np.arange(span.begin, span.end + 1)),
            tuple(name for _, name in sorted(instead)),
        )

    def _after(self, span: _Span, when: Array) -> float:
        """s from the beginning to the first row of those since `first` for which it is so; NaN where there is none."""
        found = np.flatnonzero(when)
        return max(0.0, float(self.t[span.first + found[0]] - self.t[span.begin])) if found.size else math.nan

    def _size_error(self, fault: str, rows: Array, size: float) -> float:
        if not rows.size or f"f_{fault}" not in self.rows:
            return math.nan
        error = self.rows[f"f_{fault}"][rows] - self.truth[fault][rows]
        error = error[np.isfinite(error)]
        return float(np.sqrt(np.mean(np.square(error))) / size) if error.size else math.nan

    def until_another(self, fault: str) -> Array:
        """The rows before any other fault acts."""
        firsts = [span.first for other, found in self.spans.items() if other != fault for span in found]
        return np.arange(min([len(self.t), *firsts]))

    def share_inside(self, fault: str, rows: Array) -> float:
        """Of these rows, those in which the estimate is within its bound; rows without truth or estimate left out."""
        if f"f_{fault}" not in self.rows:
            return math.nan
        off = np.abs(self.rows[f"f_{fault}"][rows] - self.truth[fault][rows])
        known = np.isfinite(off)
        if not known.any():
            return math.nan
        return float(np.mean(off[known] <= self.rows[f"f_{fault}_bound"][rows][known]))


def _spans(t: Array, values: Array, grace: float) -> list[_Span]:
    """The episodes of one fault, in order."""
    size = np.nan_to_num(np.abs(values))
    largest = float(size.max(initial=0.0))
    if largest == 0.0:
        return []
    strong = _stretches(size >= ACTS * largest)
    joined = [strong[0]]
    for a, b in strong[1:]:
        if t[a] - t[joined[-1][1]] <= grace:
            joined[-1] = joined[-1][0], b
        else:
            joined.append((a, b))
    weak = _stretches(size > NOTHING * largest)
    first = [next(c for c, d in weak if c <= a <= d) for a, _ in joined]
    last = [next(d for c, d in weak if c <= b <= d) for _, b in joined]
    for k, ((_, b), (a, _)) in enumerate(pairwise(joined)):
        last[k] = min(last[k], a - 1)  # one stretch that is hardly there in between: it ends with the pause
        first[k + 1] = max(first[k + 1], b + 1, last[k] + 1)
    return [_Span(first[k], a, b, last[k]) for k, (a, b) in enumerate(joined)]


def _stretches(acts: Array) -> list[tuple[int, int]]:
    """First and last row of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], acts, [False]))))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
