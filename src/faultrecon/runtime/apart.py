# SPDX-License-Identifier: BSD-3-Clause
"""How large a fault must be before a wrong explanation is ruled out: which hypotheses can be told apart at all.

A constant fault settles: every test of every watch then shows its own share of it, and so does the fault that a wrong
hypothesis reconstructs in its place.  The wrong hypothesis is ruled out for certain where some test must fail even
though bounds are used up in the other direction, and even though that hypothesis may excuse as much as its own estimate
allows; see `faultrecon.runtime.isolation`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Finding
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.runtime.building import monitor_of
from faultrecon.runtime.errors import ErrorSystem, error_system
from faultrecon.runtime.isolation import effect
from faultrecon.runtime.monitor import Monitor
from faultrecon.runtime.watch import Watch
from faultrecon.runtime.watchloop import CUT
from faultrecon.synthesis.bank import Bank

Array = NDArray[Any]

NOTHING = 1e-9  # of the largest share of a test that a fault has: less is rounding
ROUNDING = 1e-6  # of what is added up: what is left where that cancels, in observers with large gains
ENDLESS = 1e-6  # 1 - the slowest pole per sample: what takes longer to settle than that says nothing in time


def separation(monitor: Monitor) -> dict[str, dict[str, float]]:
    """The smallest constant fault of each kind that rules each other hypothesis out, for certain, in the end.

    By fault, then by hypothesis; inf where none does.  In units of the fault, of a sensor or of an actuator.  Nonlinear
    plants by the linear part of the error.
    """
    every = monitor.hypotheses
    systems = [error_system(h.watch.plant, h.watch.estimator) for h in every]
    table: dict[str, dict[str, float]] = {}
    for fault, i in monitor.singles.items():
        channel = every[i].watch.plant.faults[0]
        shown = [_settled(h.watch, system, channel) for h, system in zip(every, systems, strict=True)]
        largest = _largest(monitor.plant, channel)
        table[fault] = {
            h.name: _needed(monitor, k, shown, largest) for k, h in enumerate(every) if fault not in h.faults
        }
    return table


def _settled(watch: Watch, system: ErrorSystem, fault: FaultChannel) -> Array:
    """What one unit of a constant fault makes of f̂ - f and y - ŷ in the end, (q + p,); nan where that has no end."""
    into, out = effect(watch, system, fault)
    rows = system.faults + system.sensors
    if np.abs(np.linalg.eigvals(system.M)).max(initial=0.0) > 1.0 - ENDLESS:
        return np.full(rows, math.nan)
    zeta = np.linalg.solve(np.eye(len(system.M)) - system.M, into)
    settled = np.abs(out + system.C @ zeta)[:rows]
    settled[settled <= ROUNDING * (np.abs(out) + np.abs(system.C) @ np.abs(zeta))[:rows]] = 0.0
    q, own = system.faults, np.abs(np.diag(system.reading[1][system.faults : rows]))
    settled[q:][own <= ROUNDING] = 0.0  # ŷ is y itself: such a residual shows nothing
    return settled


def _needed(monitor: Monitor, k: int, shown: Sequence[Array], largest: float) -> float:
    """The size from which on, up to the largest that makes sense, some test of some watch rules hypothesis k out.

    A fault of size s shows s g in a test with the limit l, less l because bounds may be used up; the hypothesis says
    that its faults are up to s a + 2 b, and excuses e of that in limits: out where s g / l - 1 > 1 + e (s a + 2 b).
    What enters a filter is cut off at c: the test then shows no more of larger faults, and is of use up to where they
    are excused.
    """
    watch, isolation = monitor.hypotheses[k].watch, monitor.isolation
    begins, first = (part[0].astype(int) for part in (isolation.begins, isolation.first))
    excuse = isolation.excuse[first[k] : first[k + 1]]
    estimates = shown[k][: watch.bounds.faults]
    if np.isnan(estimates).any():
        return math.inf
    sizes = []
    for g, h in enumerate(monitor.hypotheses):
        e, limits = excuse[:, begins[g] : begins[g + 1]], h.watch.limits
        share, excused = (shown[g] / limits).ravel(), e.T @ estimates
        room = 2.0 + 2.0 * (e.T @ watch.bounds.fault)
        seen = share - excused > NOTHING * share.max(initial=0.0)  # nothing is, of what is not a number
        seen &= _shown_at_most(limits) > room + np.where(excused > 0.0, excused * largest, 0.0)
        sizes += (room[seen] / (share - excused)[seen]).tolist()
    return min(sizes, default=math.inf)


def _shown_at_most(limits: Array) -> Array:
    """What a test of each scale shows at most, in its limits: no end without a filter, else what is cut off."""
    most = np.full(limits.shape, math.inf)
    finite = np.isfinite(limits[1:])
    most[1:][finite] = CUT * np.broadcast_to(limits[0], finite.shape)[finite] / limits[1:][finite]
    return most.ravel()


@dataclass(frozen=True)
class Apart:
    """Which single faults of a bank are told from which, for certain, by constants.

    needed: `separation`.  largest: by fault, the range of what it sits on, or its size where none is declared.  groups:
    faults that are not told apart up to that, in one direction at least.  untested: hypotheses that cannot be tested,
    and why.  crest: how far disturbances may go beyond their declared sizes in all this.
    """

    needed: Mapping[str, Mapping[str, float]]
    largest: Mapping[str, float]
    groups: tuple[tuple[str, ...], ...]
    untested: Mapping[str, Finding] = field(default_factory=dict)
    crest: float = 3.0

    def left_open(self, fault: str) -> dict[str, float]:
        """The single faults that the largest constant one does not rule out, and what would; inf: nothing does."""
        return {name: s for name, s in self.needed[fault].items() if name in self.needed and s > self.largest[fault]}

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for `--json`; a size that is never enough is null."""
        return {
            "groups": [list(group) for group in self.groups],
            "needed": {
                f: {h: s if math.isfinite(s) else None for h, s in row.items()} for f, row in self.needed.items()
            },
            "largest": dict(self.largest),
            "crest": self.crest,
            "untested": {name: finding.as_dict() for name, finding in self.untested.items()},
        }

    def __str__(self) -> str:
        lines = []
        for group in self.groups:
            lines.append(f"not told apart for certain: {', '.join(group)}")
            for fault in group:
                left = [f"{name} ({_size(size)})" for name, size in self.left_open(fault).items()]
                upto = f"{self.largest[fault]:.4g}"
                lines += [f"  {fault}: a constant one up to {upto} leaves open {', '.join(left)}"] if left else []
        if self.groups:
            lines.append(f"  for certain: with any disturbances up to {self.crest:g} times their declared sizes")
            lines.append(
                "  what may help: a further sensor (faultrecon check PLANT --sensors), or sizes that are truer"
            )
        elif len(self.needed) > 1:
            lines.append("told apart: every fault from every other, by constants within their ranges")
        lines += [f"cannot be tested: {name}; {finding}" for name, finding in self.untested.items()]
        return "\n".join(lines)


def _known(size: float) -> float | None:
    return size if math.isfinite(size) else None


def _size(size: float) -> str:
    return f"{size:.4g} would rule it out" if math.isfinite(size) else "none is certain to rule it out"


def apart(bank: Bank) -> Apart:
    """What the monitor of a bank, as it is by default, tells apart.  Raises Impossible where it can test nothing."""
    monitor = monitor_of(bank)
    table = separation(monitor)
    singles = {name: monitor.hypotheses[i] for name, i in monitor.singles.items()}
    largest = {name: _largest(bank.plant, h.watch.plant.faults[0]) for name, h in singles.items()}
    # A hypothesis of one fault is asked for by its own name, which is that of the fault.
    unsure = {name: {h for h, s in table[name].items() if h in table and s > largest[name]} for name in table}
    untested = {name: finding for name, finding in monitor.refused.items() if name in bank.designs}
    crest = monitor.hypotheses[0].watch.bounds.allowance.crest
    return Apart(table, largest, _groups(unsure), untested, crest)


def _largest(plant: Plant, fault: FaultChannel) -> float:
    """The largest size that makes sense: that which moves a signal by its range; else the declared one."""
    signals = plant.signals.y if fault.site == "sensor" else plant.signals.u
    moved = [abs(signals.ranges[signals.index(name)] / c) for name, c in fault.on.items() if c]
    known = [size for size in moved if math.isfinite(size)]
    return max([fault.size, *known])


def _groups(unsure: Mapping[str, set[str]]) -> tuple[tuple[str, ...], ...]:
    """The connected sets of two and more, in the order of the names."""
    left, found = dict.fromkeys(unsure), []
    while left:
        group, new = set(), {next(iter(left))}
        while new:
            group |= new
            new = {b for a in new for b in unsure if b in unsure[a] or a in unsure[b]} - group
        for name in group:
            del left[name]
        if len(group) > 1:
            found.append(tuple(name for name in unsure if name in group))
    return tuple(found)
