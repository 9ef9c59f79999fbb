# SPDX-License-Identifier: BSD-3-Clause
"""The scope of the observers for multiplicative sensor faults, as findings: what forbids them, what a user should know."""

from __future__ import annotations

import numpy as np

from faultrecon.diagnosis.existence import fault_findings, sampled_findings
from faultrecon.finding import Finding, InputError
from faultrecon.graph.ranges import ranges
from faultrecon.methods.scaled_sensors import Ends, interval, readings
from faultrecon.plant.plant import Plant
from faultrecon.plant.polytopic import RANGE_RTOL
from faultrecon.plant.sector import Sector

SEE = "Bezzaoucha 2013, re-derived"
BESIDE = 1e-5
"""Of the width of a premise: how far beside its bounds counts as rounding of the numbers in a plant file."""


def scaling_findings(plant: Plant, *, form: bool = True) -> list[Finding]:
    """What takes a plant out of the scope: sampled, faults that do not multiply, no polytopic form, readings near zero.

    form: whether a polytopic form is needed at all.
    """
    if plant.sample_time is not None:
        return sampled_findings(plant, SEE)
    for f in plant.faults:
        if f.site == "actuator" or f.effect == "additive":
            return [
                Finding(
                    f"fault '{f.name}' is {f.effect} on a{'n' if f.site[0] == 'a' else ''} {f.site}",
                    why="the method reconstructs the lost gain of a sensor, a multiplicative fault",
                    evidence={"fault": f.name, "site": f.site, "effect": f.effect},
                    remedies=('declare effect = "multiplicative" if the sensor loses gain', "use lipschitz-hinf"),
                    see=SEE,
                )
            ]
    found = fault_findings(plant)
    if found:
        return found
    if plant.known is not None:
        return [
            Finding(
                "the plant has a known term g(y, u, t)",
                why="the method writes the whole right-hand side as a function of x and u",
                evidence={"terms": plant.known.g.n_outputs},
                remedies=("write the term in [nonlinearity], with the states that y reads",),
                see=SEE,
            )
        ]
    return (_form_findings(plant) or _reading_findings(plant)) if form else []


def _form_findings(plant: Plant) -> list[Finding]:
    if plant.polytopic is None:
        return [
            Finding(
                f"{plant.name} declares no polytopic form",
                why="the method is about the vertices of A(z) with z between its bounds",
                evidence={"states": plant.n},
                remedies=("add a [polytopic] table to the plant file",),
                see=SEE,
            )
        ]
    term = plant.nonlinearity
    for name, (low, high) in {} if term is None else term.domain.items():
        least, most = plant.polytopic.box[name]
        if least < low or most > high:
            return [
                Finding(
                    f"the box of {name} is [{least:g}, {most:g}], the domain of phi [{low:g}, {high:g}]",
                    why="the observer keeps what phi reads in its domain, so beyond it the vertices are not its own",
                    evidence={"state": name, "box": [least, most], "domain": [low, high]},
                    remedies=("shrink polytopic.box", "widen nonlinearity.domain"),
                    see=SEE,
                )
            ]
    try:
        return [f for f in Sector.of(plant).findings() if f.severity == "fatal"]
    except InputError as error:
        return [error.finding]


def _reading_findings(plant: Plant) -> list[Finding]:
    """A sensor that reads zero shows nothing of its gain."""
    for i, (low, high) in enumerate(readings(plant)):
        if plant.F_f[i].any() and low <= 0 <= high:
            name = plant.signals.y.names[i]
            return [
                Finding(
                    f"{name} may read zero in the box: there its gain cannot be seen",
                    why=f"it reads between {low:.4g} and {high:.4g}, and a multiplicative fault moves zero by nothing",
                    evidence={"sensor": name, "low": low, "high": high},
                    remedies=("shrink the box of [polytopic]", f"add a sensor to compare {name} with"),
                    see=SEE,
                )
            ]
    return []


def interval_warnings(plant: Plant) -> list[Finding]:
    """Fault intervals that leave the healthy plant out."""
    found = []
    for f in plant.faults:
        low, high = interval(plant, f.name, f.size)
        if not low <= 0.0 <= high:
            found.append(
                Finding(
                    f"the interval [{low:g}, {high:g}] of '{f.name}' does not contain 0",
                    why="the healthy plant, and the estimate before the first sample, lie outside: nothing is covered"
                    " there",
                    evidence={"fault": f.name, "low": low, "high": high},
                    remedies=(f"declare polytopic.faults.{f.name} = [{min(low, 0.0):g}, {max(high, 0.0):g}]",),
                    see="Bezzaoucha 2013, section IV",
                    severity="warning",
                )
            )
    return found


def premise_warnings(sector: Sector) -> list[Finding]:
    """Premises that leave the bounds their user gives them while x and u are still in the box."""
    given = sector.form.bounds
    if not any(name in given for name in sector.family.names):
        return []
    found = []
    for premise, reach in zip(sector.premises, _reached(sector), strict=True):
        room = BESIDE * (premise.high - premise.low)
        if premise.name in given and (reach[0] < premise.low - room or reach[1] > premise.high + room):
            found.append(
                Finding(
                    f"the premise {premise.name} leaves its bounds within the box",
                    why=f"it reaches [{reach[0]:.6g}, {reach[1]:.6g}] there and is declared in [{premise.low:.6g},"
                    f" {premise.high:.6g}]: beyond, nothing is covered, and weights stay at those of the bound",
                    evidence={"premise": premise.name, "reached": list(reach), "bounds": [premise.low, premise.high]},
                    remedies=(f"drop polytopic.bounds.{premise.name}, which is then proved", "shrink polytopic.box"),
                    see=SEE,
                    severity="warning",
                )
            )
    return found


def _reached(sector: Sector) -> list[Ends]:
    """What each premise is seen to reach in the box: where it is searched for, or at random points."""
    boxes = sector.form.boxes
    try:
        return [(one.least, one.most) for one in ranges(sector.family.premises, boxes, rtol=RANGE_RTOL)]
    except InputError:
        low, high = np.array([*boxes["x"], *boxes["u"]]).T
        at = np.random.default_rng(0).uniform(low, high, (1000, len(low)))
        z = sector.premise_values(at[:, : sector.plant.n], at[:, sector.plant.n :])
        return [(float(a), float(b)) for a, b in zip(z.min(axis=0), z.max(axis=0), strict=True)]


def shared_findings(plant: Plant) -> list[Finding]:
    """Multiplicative faults that do not each sit on a sensor of their own."""
    own = [f for f in plant.faults if f.effect == "multiplicative"]
    found = [f.name for f in own if sum(map(bool, f.on.values())) > 1]
    for f in own:
        sensor = next(name for name, c in f.on.items() if c)
        if sum(1 for other in plant.faults if other.site == "sensor" and other.on.get(sensor)) > 1:
            found.append(f.name)
    if not found:
        return []
    return [
        Finding(
            f"fault '{found[0]}' shares its sensor with another, or reaches several",
            why="the method gives every lost gain a signal of its own, that of the sensor it sits on",
            evidence={"faults": list(dict.fromkeys(found))},
            remedies=("declare one fault for each sensor", "use ts-mean-value"),
            see=SEE,
        )
    ]


def direct_findings(plant: Plant) -> list[Finding]:
    """Inputs that reach a faulty sensor through D."""
    direct = float(np.abs(plant.D[plant.F_f.any(axis=1)]).max(initial=0.0))
    if direct == 0:
        return []
    return [
        Finding(
            "an input reaches a faulty sensor directly",
            why="what the sensor should show is read off the state alone",
            evidence={"entry of D": direct},
            remedies=("add the actuator as a state", "use ts-mean-value"),
            see=SEE,
        )
    ]
