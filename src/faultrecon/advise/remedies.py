# SPDX-License-Identifier: BSD-3-Clause
"""What a user can do about a design that does not exist: each remedy is tried on the plant before it is offered."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from faultrecon.advise.tradeoff import (
    BACKOFF,
    HALVINGS,
    ROOM,
    Domain,
    Question,
    TradeOff,
    leans_on_inputs,
    optimum_of,
    scaling_suspects,
    slope_at_point,
    smaller_domain,
    states_used,
)
from faultrecon.diagnosis.existence import detectability_findings, disturbance_findings, fault_findings
from faultrecon.diagnosis.limits import reconstruction_floor
from faultrecon.diagnosis.sensors import Candidate, with_sensor
from faultrecon.finding import Finding
from faultrecon.methods.base import Method, Unproved
from faultrecon.methods.registry import list_methods
from faultrecon.methods.registry import method as method_named
from faultrecon.numerics.annihilator import annihilator
from faultrecon.numerics.pencil import undetectable_modes
from faultrecon.plant.plant import Plant

NAMED = 3
"""How many suspects or sensors a sentence names; more are no help."""
APART = 3.0
"""Powers of ten between coefficients of one scaled row from which a signal counts as a suspect."""


def for_assumption(question: Question, finding: Finding, exchange: TradeOff | None) -> tuple[str, ...]:
    """Remedies for an assumption that fails, those of the finding where nothing better was found."""
    plant, told = question.plant, list(finding.remedies)
    if exchange is not None:
        found = [*_weaker(question, exchange, None), *_others(question)]
    elif plant.sample_time is not None:
        translated = _in_continuous_time(plant)
        told = [] if translated and "sample_time" in finding.evidence else told  # the same advice, with numbers
        found = [*told, *translated, *_others(question)]
    elif any(f.site == "actuator" for f in plant.faults):
        spelt_out = _without_actuators(question)
        told = [] if spelt_out and finding.evidence.get("site") == "actuator" else told
        found = [*told, *spelt_out, *_others(question)]
    elif fault_findings(plant):
        found = [*_fewer_faults(question), *told]
    elif len(plant.faults) == plant.p or detectability_findings(plant):
        found = [*_fewer_faults(question), *_healing_sensors(question), *_others(question)]
    elif disturbance_findings(plant):
        found = [*told, *_snippet(plant)]
    else:
        found = [*told, *_others(question)]
    return tuple(dict.fromkeys(found or told))


def for_level(question: Question, exchange: TradeOff | None, level: float | None = None) -> tuple[str, ...]:
    """Remedies for an inequality without a solution, or without one at a level."""
    found = [] if exchange is None else _weaker(question, exchange, level)
    return (*found, *_structure(question, level), *_others(question, level))


def for_solver(plant: Plant) -> Finding:
    """The states and sensors whose scaled coefficients are furthest apart, and what to do about them."""
    suspects = [s for s in scaling_suspects(plant) if s.decades >= APART][:NAMED]
    if not suspects:
        return Finding(
            "no state or sensor is badly scaled",
            why=f"in scaled units its coefficients lie within a factor of {10**APART:.0f} of each other",
            remedies=("ask for a level well above the optimum (--level)", "set --pole-bound none"),
            severity="note",
        )
    rows = ", ".join(f"{s.signal} (a factor of 1e{s.decades:.0f})" for s in suspects)
    names = [s.signal for s in suspects]
    return Finding(
        f"the scaling of {', '.join(names)} is suspect",
        why=f"after scaling, coefficients that meet in one row or column still differ: {rows}",
        evidence={s.signal: s.decades for s in suspects},
        remedies=(
            f"check the units of the coefficients of {names[0]}, and drop those that are only noise",
            f"declare how far each signal moves (signals.range = {{ {names[0]} = ... }})",
            "remove modes far faster than the sensors can follow from the model",
        ),
        severity="note",
    )


# ---------------------------------------------------------------- the nonlinearity


def _weaker(question: Question, exchange: TradeOff, level: float | None) -> list[str]:
    """Smaller domains that were tried: where the constant is small enough for a solution, or for the level."""
    term = question.plant.nonlinearity
    assert term is not None
    wanted = exchange.solvable if level is not None else ROOM * exchange.solvable
    whole = _tighter(question, exchange)
    if whole is not None:
        best = question.at(whole.constant).optimum
        if (BACKOFF * best <= level) if level is not None else best < math.inf:
            return [
                f'write lipschitz = "derive": on the declared domain {whole.constant:.4g} is proved instead of'
                f" {term.constant:.4g}, and γ ≥ {BACKOFF * best:.4g} can be had"
            ]
    found = smaller_domain(question.plant, wanted)
    if found is not None and any(a < b for a, b in found.box.values()):
        best = question.at(found.constant).optimum
        return [
            f'shrink the domain to {found} with lipschitz = "derive": {found.constant:.4g} is proved there, and'
            f" γ ≥ {BACKOFF * best:.4g} can be had"
        ]
    return [_slope_remains(question.plant, wanted)]


def _slope_remains(plant: Plant, wanted: float) -> str:
    """What to say where no domain was found: φ is too steep even at the operating point, or nothing could be proved."""
    slope = slope_at_point(plant)
    if slope is not None and slope > wanted:
        return (
            f"put the slope of phi at the operating point, {slope:.4g}, into A and keep the rest in phi: no smaller"
            f" domain brings the constant to {wanted:.4g} as it stands, that of the rest shrinks with the domain"
        )
    why = (
        "reads an input or the time"
        if plant.nonlinearity and leans_on_inputs(plant.nonlinearity)
        else "resists a proof"
    )
    return f"show that the Lipschitz constant is {wanted:.4g} or less on a smaller domain and declare it: phi {why}"


def _tighter(question: Question, exchange: TradeOff) -> Domain | None:
    """The declared domain, where more is proved on it than was declared, and enough."""
    term = question.plant.nonlinearity
    if term is None or not term.domain:
        return None
    found = smaller_domain(question.plant, exchange.solvable)
    unchanged = found is not None and all(found.box[k] == pair for k, pair in term.domain.items())
    return found if unchanged and set(term.domain) == set(term.reads) else None


def _structure(question: Question, level: float | None) -> list[str]:
    """Giving φ only the states that it really reads, when that makes a solution or a lower level."""
    term = question.plant.nonlinearity
    if term is None:
        return []
    used = states_used(term)
    if not used or len(used) == len(term.reads):
        return []
    better = replace(question, plant=reading_only(question.plant, used))
    if not better.reaches(level):
        return []
    return [
        f"declare reads = [{', '.join(repr(n) for n in used)}]: phi depends on nothing else, and"
        f" γ ≥ {BACKOFF * better.optimum:.4g} can then be had"
    ]


def reading_only(plant: Plant, names: tuple[str, ...]) -> Plant:
    """The same plant with φ declared to read these states alone; it must depend on no other."""
    from faultrecon.graph.function import Graph

    old = plant.nonlinearity
    assert old is not None
    place = [names.index(n) if n in names else 0 for n in old.reads]
    sizes = {"x": len(names), "u": len(plant.signals.u), "t": 1}
    phi = Graph.trace(lambda x, u, t: old.phi.symbolic(x[place], u, t), sizes)
    phi = replace(phi, inputs={"x": names, "u": plant.signals.u.names, "t": ("t",)})
    domain = {k: v for k, v in old.domain.items() if k in names}
    return replace(plant, nonlinearity=replace(old, reads=names, phi=phi, domain=domain))


# ---------------------------------------------------------------- methods, faults, sensors


def _candidates(question: Question) -> list[Method]:
    names = list_methods()
    parent = question.method.variant_of
    ordered = [*([parent] if parent else []), *names]
    found = [method_named(n) for n in dict.fromkeys(ordered) if n != question.method.name]
    return [other for other in found if not isinstance(other, Unproved)]


def _others(question: Question, level: float | None = None) -> list[str]:
    """Other methods that have a solution for this plant (at the level); with equal floors, levels mean the same."""
    found = []
    for other in _candidates(question):
        if any(f.severity == "fatal" for f in other.assumptions(question.plant)):
            continue
        alike = other.floor(question.plant) == question.method.floor(question.plant)
        if level is not None and not alike:
            continue
        best = optimum_of(other, question.plant)
        if best < math.inf and not alike:
            found.append(
                f"use the method {other.name}, which has a solution for this plant; its γ measures another gain"
            )
        elif best < math.inf and (level is None or BACKOFF * best <= level):
            found.append(f"use the method {other.name}, which reaches γ ≥ {BACKOFF * best:.4g} for this plant")
    return found


def _allowed(question: Question, plant: Plant) -> bool:
    return not any(f.severity == "fatal" for f in question.method.assumptions(plant))


def _fewer_faults(question: Question) -> list[str]:
    """Sets of faults that the method takes: all but one where that is enough, else each alone."""
    plant = question.plant
    names = [f.name for f in plant.faults]
    if len(names) < 2:
        return []
    for kept in ([[n for n in names if n != left] for left in names], [[n] for n in names]):
        possible = [k for k in kept if k and _allowed(question, plant.with_faults(k))]
        if possible:
            options = "; ".join(" ".join(f'--fault "{n}"' for n in k) for k in possible[:NAMED])
            return [f"reconstruct fewer faults at a time; the method takes: {options}"]
    return []


def _healing_sensors(question: Question) -> list[str]:
    """States of which a healthy sensor makes every mode visible that has to be."""
    plant = question.plant
    C1 = annihilator(plant.F_f) @ plant.C
    names = [
        name
        for k, name in enumerate(plant.signals.x.names)
        if not undetectable_modes(plant.A, np.vstack([C1, np.eye(plant.n)[k]]), sampled=plant.sample_time is not None)
    ]
    trusted = [n for n, row in zip(plant.signals.y.names, plant.F_f, strict=True) if not row.any()]
    beside = f"beside {', '.join(trusted)} " if trusted else ""
    if names:
        one = "it" if len(names) == 1 else "any one of them"
        return [f"add a healthy sensor that reads {' or '.join(names[:NAMED])}: {beside}{one} is enough"]
    return ["no single sensor of one state is enough: add two, or sensors of sums of states"]


def quieter(question: Question, level: float) -> str:
    """The sensor that brings a level within reach with the most noise of its own, tried; else how one is tried."""
    best = 0.0, ""
    for state in question.plant.signals.x.names:
        for k in range(HALVINGS):
            noise = 2.0**-k
            if noise <= best[0]:
                break
            if _reaches_with(question, state, noise, level):
                best = noise, state
    if best[1]:
        noise, state = best
        return (
            f"add a healthy sensor that reads {state} with noise of size {noise:.4g}: γ = {level:.4g} can then be had"
        )
    return "add healthy sensors or use quieter ones: `faultrecon check` prints the floor of the changed plant file"


def _reaches_with(question: Question, state: str, noise: float, level: float) -> bool:
    wider = with_reading(question.plant, state, noise)
    floor = reconstruction_floor(wider)  # quicker to see than an optimum
    return floor is not None and floor.value < level and bool(replace(question, plant=wider).reaches(level))


def with_reading(plant: Plant, state: str, noise: float = 0.0) -> Plant:
    """The plant with one more sensor, healthy, that reads a state; its noise, if any, is a counted disturbance."""
    known = (d.name.removeprefix("noise of ") for d in plant.disturbances)
    taken = {*plant.signals.y.names, *plant.signals.u.names, *known}
    name = f"{state}_sensor"
    while name in taken:
        name += "_"
    return with_sensor(plant, Candidate(name, {state: 1.0}, noise))


def _in_continuous_time(plant: Plant) -> list[str]:
    """How fast the plant is, so that a model in seconds can be written down."""
    h = float(plant.sample_time or 1.0)
    values = np.abs(np.linalg.eigvals(plant.A))
    rates = [math.log(v) / h for v in values if v > 0]
    slow = f"; its modes grow or decay at {min(rates):.4g} to {max(rates):.4g} 1/s" if rates else ""
    return [
        f"write the plant in continuous time, without sample_time = {h:.4g} and with A of ẋ = A x"
        f" (the logarithm of A divided by {h:.4g}{slow})"
    ]


def _without_actuators(question: Question) -> list[str]:
    """The sensor faults by themselves, with what the actuators may do declared as disturbances."""
    plant = question.plant
    sensors = [f.name for f in plant.faults if f.site == "sensor"]
    tables = []
    for fault in plant.faults:
        if fault.site == "actuator":
            column = plant.B @ np.array([fault.on.get(name, 0.0) for name in plant.signals.u.names])
            into = ", ".join(f"{n} = {v:.4g}" for n, v in zip(plant.signals.x.names, column, strict=True) if v)
            tables.append(f'[[disturbance]] name = "{fault.name}", into = {{ {into} }}, size = {fault.size:.4g}')
    instead = f"with what the actuator may do as a disturbance in place of its [[fault]]: {'; '.join(tables)}"
    if sensors and _allowed(question, plant.with_faults(sensors)):
        return ["reconstruct the sensor faults alone, " + instead]
    return ["declare the sensor faults that you suspect, " + instead]


def _snippet(plant: Plant) -> list[str]:
    """A disturbance table that can be pasted: sensor noise of the declared size, or of one unit."""
    rows = []
    for k, name in enumerate(plant.signals.y.names):
        sd = 1.0 if plant.noise is None else plant.noise.sd[k]
        rows.append(f'[[disturbance]] name = "noise of {name}", on = {{ {name} = 1.0 }}, size = {sd:.4g}')
    return [f"begin with the noise of each sensor: {'; '.join(rows[:NAMED])}"]
