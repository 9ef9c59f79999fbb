# SPDX-License-Identifier: BSD-3-Clause
"""What is told about faults that multiply a sensor: possible or not, how well at best, and what to trust it for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from faultrecon.diagnosis.possibility_points import Rank, enough
from faultrecon.finding import Finding
from faultrecon.plant.plant import Plant

if TYPE_CHECKING:
    from faultrecon.diagnosis.possibility import Gauge, Possibility

SEE = "Bezzaoucha 2013, re-derived"
USEFUL = 1.0 / 3.0
"""Part of a fault's size that its deviation may be: three deviations are then one fault of interest."""
SHOWN = 4
"""Numbers of the budget that are read out; all of them are in the evidence."""


def findings_of(plant: Plant, found: Possibility) -> list[Finding]:
    """Everything there is to say, the obstacle alone where there is one."""
    against = _unread(plant, found) or _not_apart(plant, found)
    if against:
        return against
    return [
        _slow(plant, found),
        *_sometimes_unread(plant, found),
        _waveform(plant, found),
        *_least(plant, found),
        *_gauges(plant, found),
        *_budget(plant, found),
        *_not_decoupled(plant),
    ]


def _names(plant: Plant) -> str:
    return " and ".join(f.name for f in plant.faults)


def _where(rank: Rank) -> str:
    return f"at {rank.region}" if rank.points == 1 else f"at {rank.separable} of {rank.points} points of {rank.region}"


# ---------------------------------------------------------------- what stands against it


def _unread(plant: Plant, found: Possibility) -> list[Finding]:
    """A sensor that reads zero wherever we look."""
    rank = found.rank
    dark = [name for name, count in rank.zero.items() if count == rank.points]
    if not dark:
        return []
    name = dark[0]
    place = "at the operating point" if rank.points == 1 else f"at every one of {rank.points} points of {rank.region}"
    return [
        Finding(
            f"{name} reads 0 {place}: there its gain cannot be seen",
            why="a multiplicative fault moves a reading of zero by nothing",
            evidence={"sensor": name, "points": rank.points, "reading": 0.0},
            remedies=(
                "declare the operating point at which the plant works, or the ranges of its states",
                "give the trajectory it works along (trajectory=... or --log)",
                "declare the fault additive",
            ),
            see=SEE,
        )
    ]


def _not_apart(plant: Plant, found: Possibility) -> list[Finding]:
    """State and fault move the sensors alike, at every point."""
    rank, names = found.rank, _names(plant)
    if rank.separable:
        return []
    evidence: dict[str, Any] = {"points": rank.points, "separable": 0, "needed": rank.needed}
    remedies = ("add a healthy sensor", "declare fewer faults at a time (faults=[...] or --fault)")
    if rank.short:
        return [
            Finding(
                f"whether {names} can be told from the state is not known after {rank.derivatives} derivatives",
                why="the next one is too long a formula, and those before do not tell them apart",
                evidence=evidence | {"derivatives": rank.derivatives},
                remedies=("give a trajectory, whose windows decide (trajectory=... or --log)", *remedies),
                see=SEE,
            )
        ]
    return [
        Finding(
            f"the sensors do not tell even a constant {names} from the state, {_where(rank)}",
            why="some change of the state moves every reading, and every rate of change of it, as the fault does",
            evidence=evidence,
            remedies=remedies,
            see=SEE,
        )
    ]


# ---------------------------------------------------------------- what can be had


def _slow(plant: Plant, found: Possibility) -> Finding:
    rank, names = found.rank, _names(plant)
    moving = "it hardly moves" if len(plant.faults) == 1 else "they hardly move"
    all_of = rank.separable == rank.points
    at = ", ".join(f"{name} = {value:.4g}" for name, value in rank.at.items())
    numbers = f"smallest singular value {rank.typical:.2g} in the middle, {rank.smallest:.2g} at worst ({at})"
    whole = f"rank {rank.needed} of {rank.needed} for state and fault" if rank.full == rank.points else "faults apart"
    return Finding(
        f"{names} can be told from the state while {moving}: {whole} {_where(rank)}",
        why=f"the readings and {rank.derivatives} rates of change show it; {numbers}",
        evidence=rank.as_dict(),
        remedies=(
            "keep to where the singular value is large" if all_of else "trust no estimate where the rank is lost",
            "add a healthy sensor",
        ),
        see=SEE,
        severity="note" if all_of else "warning",
    )


def _sometimes_unread(plant: Plant, found: Possibility) -> list[Finding]:
    """A sensor whose reading may vanish, or comes near it."""
    out = []
    for name, (low, high) in found.rank.readings.items():
        dark, faint = low <= 0.0 <= high, found.rank.faint.get(name, 0)
        if not (dark or faint):
            continue
        least = enough(plant, name, max(abs(low), abs(high)))
        out.append(
            Finding(
                f"{name} may read 0 in {found.rank.region}: there its gain cannot be seen"
                if dark
                else f"{name} reads less than {least:.3g} at {faint} of {found.rank.points} points of "
                f"{found.rank.region}: there its gain hardly shows",
                why=f"it reads between {low:.4g} and {high:.4g}, and a multiplicative fault moves zero by nothing",
                evidence={"sensor": name, "low": low, "high": high, "threshold": least, "points below": faint},
                remedies=(
                    f"hold the estimate while |{name}| is below {least:.3g}",
                    "shrink the region to what is used",
                ),
                see=SEE,
                severity="warning",
            )
        )
    return out


def _waveform(plant: Plant, found: Possibility) -> Finding:
    """A fault of any waveform: the healthy sensors, or the model by itself."""
    rank, run, names = found.rank, found.contraction, _names(plant)
    if found.any_waveform:
        return Finding(
            f"{names} may have any waveform: the healthy sensors tell the state ({rank.seen} of {rank.points} points)",
            why="what a sensor should show then follows from the others",
            evidence={"points": rank.points, "seen": rank.seen},
            remedies=("prefer designs that use the healthy sensors",),
            see=SEE,
            severity="note",
        )
    hidden = f"of an arbitrary waveform of {names} nothing can be known from the readings"
    cause = "for any course of the state there is a waveform that explains them"
    if run is None or not run.forgets:
        said = "the model by itself forgets nothing" if run is not None else "the model has no course of its own here"
        numbers = (
            "" if run is None else f" (an error of the state becomes {run.left:.3g} times itself in {run.length:.4g})"
        )
        return Finding(
            f"{hidden}, and {said}{numbers}",
            why=cause,
            evidence={} if run is None else {"left": run.left, "peak": run.peak, "rate": run.rate},
            remedies=(
                "trust estimates of slow faults alone (rate = ... in the [[fault]] table)",
                "add a healthy sensor",
            ),
            see=SEE,
            severity="warning",
        )
    return Finding(
        f"{hidden}; what is left is simulate-invert, since the model by itself forgets at a rate of {run.rate:.4g}",
        why=f"{cause}; an error of the state first grows to {run.peak:.4g} times itself, {run.left:.2g} times is left "
        f"after {run.length:.4g}",
        evidence={"rate": run.rate, "peak": run.peak, "left": run.left, "length": run.length},
        remedies=(
            "declare how fast it moves (rate = ... in the [[fault]] table) and use an observer",
            "use simulate-invert with a model that you trust",
            "add a healthy sensor",
        ),
        see=SEE,
        severity="note",
    )


def _least(plant: Plant, found: Possibility) -> list[Finding]:
    """The least deviation on windows, against a third of the fault's size."""
    if not found.windows:
        silent = "no noise is declared" if plant.noise is None else "some sensor is declared without noise"
        return [
            Finding(
                f"how well {_names(plant)} can be known at best is not known: {silent}",
                why="the least deviation on a window follows from the noise of the sensors",
                evidence={"windows": 0},
                remedies=("declare sd and hold of every sensor in the [noise] table",),
                see=SEE,
                severity="note",
            )
        ]
    return [_best(f.name, f.size, found) for f in plant.faults]


def _best(name: str, size: float, found: Possibility) -> Finding:
    rows = [(w.start, w.length, w.deviation[name]) for w in found.windows]
    good = [r for r in rows if r[2] <= USEFUL * size]
    start, length, least = min(rows, key=lambda r: r[2])
    evidence = {
        "size": size,
        "allowed": USEFUL * size,
        "windows": [[s, n, v if math.isfinite(v) else None] for s, n, v in rows],
    }
    where = "" if found.held else f" from {start:.4g} on"
    if not good:
        best = f"{least:.3g} over {length:.4g}{where}" if math.isfinite(least) else "unbounded"
        return Finding(
            f"no window tells {name} to a third of its size {size:g}: the least deviation of an estimate is {best}",
            why="noise hides it even from a model that is exact and a fault that stays constant"
            if math.isfinite(least)
            else "while the plant rests at its operating point nothing shows it"
            if found.held
            else "what the plant does there leaves it open",
            evidence=evidence,
            remedies=(
                "watch longer" if math.isfinite(least) else "give a trajectory that moves (trajectory=... or --log)",
                "take a quieter sensor or add a healthy one",
                "mend its size in the [[fault]] table",
            ),
            see="Cramér-Rao bound; " + SEE,
            severity="warning",
        )
    first, shortest = min(r[1] for r in good), min(r[1] for r in rows)
    bad = len(rows) - len(good)
    reached = f"{'already ' if first == shortest else ''}over {first:.4g}"
    unsure = f", but not by {bad} of {len(rows)} windows" if bad and not found.held else ""
    return Finding(
        f"no estimate of {name} has a deviation below {least:.3g} over {length:.4g}{where}; a third of its size "
        f"{size:g} can be reached {reached}{unsure}",
        why="no unbiased estimate of a constant fault does better, whatever the method, even with an exact model",
        evidence=evidence,
        remedies=("average over longer windows for less", "read estimates from little data with their deviation"),
        see="Cramér-Rao bound; " + SEE,
        severity="warning" if unsure else "note",
    )


# ---------------------------------------------------------------- what it can be trusted for


def _gauges(plant: Plant, found: Possibility) -> list[Finding]:
    """Errors of the model that no data can tell from the fault."""
    out = []
    for fault in plant.faults:
        own = [g for g in found.gauges if g.fault == fault.name]
        if not own:
            continue
        coefficient = next((c for c in fault.on.values() if c), 1.0)
        times = " (1 + f)" if fault.effect == "multiplicative" and coefficient == 1.0 else ""
        said = [_sentence(g, fault.name, times) for g in own]
        out.append(
            Finding(
                f"no data can tell {fault.name} from an error of the model: {'; '.join(said)}",
                why="together with another initial state these leave every reading as it is",
                evidence={"gauges": [{"relative": dict(g.relative), "reads as": g.fault_change} for g in own]},
                remedies=(
                    f"know {' and '.join(sorted({k for g in own for k in g.relative}))} from elsewhere",
                    "read the estimate relative to a time at which the sensor was known to be healthy",
                    "add a healthy sensor",
                ),
                see=SEE,
                severity="note",
            )
        )
    return out


def _sentence(gauge: Gauge, fault: str, times: str) -> str:
    """'1 % error in `c` reads as 0.01 (1 + f) of fouling'."""
    parts = [f"{'-' if v < 0 else ''}{abs(100 * v):.3g} % error in `{name}`" for name, v in gauge.relative.items()]
    read = "together read" if len(parts) > 1 else "reads"
    return f"{' and '.join(parts)} {read} as {gauge.fault_change:.3g}{times} of {fault}"


def _budget(plant: Plant, found: Possibility) -> list[Finding]:
    """Every number of the plant with what its error does."""
    rows = [row for row in found.budget if any(_seen(v) for v in row.per_percent.values())]
    if not rows or found.watched is None:
        return []
    single = len(plant.faults) == 1
    said = [f"{row.parameter} {_amounts(row.per_percent, single)}" for row in rows[:SHOWN]]
    more = f", and {len(rows) - SHOWN} more" if len(rows) > SHOWN else ""
    return [
        Finding(
            f"bias budget of {_names(plant)}, per 1 % that the plant is above the model: {', '.join(said)}{more}",
            why=f"a constant fault fitted over {found.watched[1]:.4g} takes up what the model has wrong; more data do "
            "not help",
            evidence={"per percent": {row.parameter: dict(row.per_percent) for row in rows}},
            remedies=("add up what you know of these errors before trusting a number",),
            see=SEE,
            severity="note",
        )
    ]


def _seen(value: float) -> bool:
    return math.isfinite(value) and abs(value) > 1e-6


def _amounts(per: Mapping[str, float], single: bool) -> str:
    if single:
        return f"{next(iter(per.values())):+.2g}"
    return "(" + ", ".join(f"{name} {value:+.2g}" for name, value in per.items()) + ")"


def _not_decoupled(plant: Plant) -> list[Finding]:
    wished = [d.name for d in plant.attenuated if d.role == "decouple"]
    if not wished:
        return []
    return [
        Finding(
            f"{' and '.join(wished)} should be decoupled, which is not looked at for faults that multiply",
            why="here the model counts as exact, apart from the faults",
            evidence={"disturbances": wished},
            remedies=('count it as noise or attenuate it (role = "attenuate")',),
            see=SEE,
            severity="warning",
        )
    ]
