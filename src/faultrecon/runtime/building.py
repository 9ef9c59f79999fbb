# SPDX-License-Identifier: BSD-3-Clause
"""From a bank of designs to a monitor: sample time, filters, and the room that noise gets, from what is declared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from faultrecon.finding import FaultreconError, Finding, Impossible, InputError
from faultrecon.plant.plant import Plant
from faultrecon.runtime.bounds import Allowance, bounds
from faultrecon.runtime.correction import Correction, Policy
from faultrecon.runtime.decision import Rules
from faultrecon.runtime.errors import ErrorSystem, error_system
from faultrecon.runtime.isolation import isolation, memory
from faultrecon.runtime.monitor import Hypothesis, Monitor
from faultrecon.runtime.stepping import Hold
from faultrecon.runtime.watch import Watch, filters
from faultrecon.synthesis.bank import Bank

SPANS = 25.0, 250.0  # sample times: the time constants of the filters behind which drifts are looked for


def monitor_of(
    bank: Bank,
    *,
    sample_time: float | None = None,
    hold: Hold = "linear",
    crest: float = 3.0,
    false_alarms: float = 0.01,
    window: int = 24,
    spans: Sequence[float] | None = None,
    policy: Policy = "correct",
    hold_longest: float = 5.0,
    stale: float | None = None,
) -> Monitor:
    """A monitor of the hypotheses in a bank.

    sample_time in s: by default the noise's hold time.  crest: how far disturbances may go beyond their declared size.
    false_alarms: per operating hour, at most, from noise; it decides how many standard deviations noise is allowed.
    window: samples that a statement rests on.  spans: time constants of the filters, s.  policy, hold_longest: see
    `Correction`.  stale: s without a sample after which the mode says so, ten sample times by default.
    Raises Impossible when no hypothesis can be bounded.
    """
    if not (math.isfinite(false_alarms) and false_alarms > 0):
        raise InputError(f"{false_alarms} false alarms per hour", why="it is a positive number")
    if not (math.isfinite(crest) and crest > 0):
        raise InputError(f"the crest factor is {crest}", why="it is a positive number")
    if window < 2:
        raise InputError(f"the window is {window} samples", why="it takes two or more")
    rules, found, systems, refused = Rules(window), [], [], dict(bank.refused)
    T = _sample_time(bank, sample_time)
    poles = filters(T, spans if spans is not None else [span * T for span in SPANS])
    tests = len(poles) * sum(_tested(d.plant) for d in bank.designs.values())
    allowance = Allowance(crest, noise_room(false_alarms, tests, T, rules))
    for name, design in bank.designs.items():
        try:
            estimator = design.estimator(T, hold=hold, engine="auto" if design.observer.linear else "casadi")
            system = error_system(design.plant, estimator)
            limits = bounds(design.plant, estimator, system, allowance, poles)
            if not np.isfinite(limits.steady[0]).any():
                raise Impossible(_unbounded(design.plant, system))
            found.append(Hypothesis.of(name, Watch(design.plant, estimator, limits, poles)))
            systems.append(system)
        except FaultreconError as error:
            refused[name] = error.finding
    if not found:
        first = next(refused[name] for name in (*bank.designs, *refused))
        raise Impossible(
            f"no hypothesis about {bank.plant.name} can be tested",
            why=first.what + (f": {first.why}" if first.why else ""),
            remedies=first.remedies,
        )
    stale = 10.0 * T if stale is None else stale
    kept = memory([h.watch for h in found], systems)
    found = [replace(h, watch=replace(h.watch, memory=kept)) for h in found]
    excuses = isolation([h.watch for h in found], systems, [h.watch.plant for h in found])
    correction = Correction(policy, hold_longest)
    return Monitor(bank.plant, tuple(found), excuses, rules, correction, stale, bank.digest, refused)


def noise_room(false_alarms: float, tests: int, sample_time: float, rules: Rules) -> float:
    """Standard deviations for white Gaussian noise such that so many false alarms an hour come of it at most.

    A rejection takes `enough` samples outside within a window.  Each of `tests` numbers per sample lies outside with
    probability erfc(k/√2), however they depend on each other, so at most that many rejections can be paid for.
    """
    from scipy.special import erfcinv

    samples = 3600.0 / sample_time
    odds = min(1.0, false_alarms * rules.enough / (samples * max(tests, 1)))
    return float(math.sqrt(2.0) * erfcinv(odds))


def _tested(plant: Plant) -> int:
    """How many numbers of a watch are tested behind each filter: its faults, and the sensors that they do not reach."""
    return len(plant.faults) + plant.p - int(np.any(plant.F_f != 0, axis=1).sum())


def _unbounded(plant: Plant, system: ErrorSystem) -> Finding:
    """Why no error of an observer has a bound, and what would give it one."""
    rates = [s.name for s in system.unbounded if s.kind == "fault rate"]
    if rates:
        return Finding(
            f"no rate is declared for {' and '.join(dict.fromkeys(rates))}",
            why="its observer follows the fault, and without a bound on the rate nothing bounds the error",
            evidence={"without a rate": list(dict.fromkeys(rates))},
            remedies=(f"declare rate = ... in a [[fault]] table of {rates[0]}, and make the bank again",),
        )
    if system.slope:
        return Finding(
            f"no bound is known for the observer of {plant.name}",
            why="its errors feed the nonlinearity, and a small-gain argument finds no end of that",
            evidence={"Lipschitz constant": system.slope},
            remedies=("shrink the domain, and with it the Lipschitz constant", "use a shorter sample time"),
        )
    largest = float(np.abs(np.linalg.eigvals(system.M)).max(initial=0.0))
    return Finding(
        f"nothing bounds the errors of the observer of {plant.name} at this sample time",
        why="sampled, they do not decay",
        evidence={"largest eigenvalue from sample to sample": largest},
        remedies=("use a shorter sample time", "design with a smaller pole bound"),
    )


def _sample_time(bank: Bank, given: float | None) -> float:
    if given is not None:
        return given
    own = {d.observer.sample_time for d in bank.designs.values()} - {None}
    if own:
        return float(min(t for t in own if t is not None))
    if bank.plant.noise is None:
        remedies = ("pass sample_time=... in seconds", "declare [noise] with its hold time in the plant file")
        raise InputError("no sample time is known", remedies=remedies)
    return bank.plant.noise.hold
