# SPDX-License-Identifier: BSD-3-Clause
"""The well-posed design problem: optimum, back-off, pole bound, second criterion, rounding, proof, report."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.certificate import Certificate, Verification
from faultrecon.diagnosis.limits import reconstruction_floor
from faultrecon.finding import Finding, Impossible, Inconclusive, InputError
from faultrecon.graph.observer import Observer
from faultrecon.lmi.solve import Outcome
from faultrecon.methods.base import Method
from faultrecon.methods.registry import method as method_named
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.certify import certificate, prove, shipped
from faultrecon.synthesis.levels import Posed, multipliers, pose, quietest, smallest_gain
from faultrecon.synthesis.report import DesignReport, describe

if TYPE_CHECKING:
    from faultrecon.runtime.estimator import Estimator

Array = NDArray[np.float64]
Progress = Callable[[str], None]

STEP_SHARE = 2.0
"""Default pole bound times sample time: inside the 2.785 at which classical Runge-Kutta turns unstable on the real axis."""
GROWTH = (1.0, 2.0, 4.0)
"""By how much the back-off may grow before a design is given up as not certified."""


@dataclass(frozen=True, eq=False)
class Design:
    """A plant, a method, the gains that ship, and what is proved about them.

    optimum: infimum of the level without a pole bound.  level: γ that the certificate claims (None: no certificate).
    floor: no linear estimator gets below it (None: not known).  gains: by the paper's letters, in the plant's units.
    """

    plant: Plant
    method: str
    gains: Mapping[str, Array]
    optimum: float | None
    level: float | None
    floor: float | None
    certificate: Certificate | None
    details: DesignReport

    @cached_property
    def observer(self) -> Observer:
        """The executable equations."""
        return method_named(self.method).observer(self.plant, self.gains)

    @cached_property
    def verification(self) -> Verification | None:
        """The certificate's proof, by exact integers; computed once."""
        return None if self.certificate is None else prove(self.certificate)

    def estimator(self, sample_time: float | None = None, **options: Any) -> Estimator:
        """The observer at run time: pure `init` and `step`.  sample_time in s, the noise's hold time by default.

        options: `hold` ("left", "midpoint", "linear") and `scheme` ("auto", "zoh", "rk4"), see `Estimator.build`.
        """
        from faultrecon.runtime.estimator import Estimator
        from faultrecon.runtime.stepping import Prediction

        prediction = Prediction(self.plant.C, self.plant.D)
        return Estimator.build(self.observer, self._sample_time(sample_time), prediction=prediction, **options)

    def _sample_time(self, given: float | None) -> float:
        if given is not None:
            return given
        if self.plant.noise is None:
            raise InputError("no sample time is known", remedies=("pass sample_time=... in seconds",))
        return self.plant.noise.hold

    def as_dict(self) -> dict[str, Any]:
        """A summary as plain values, for `--json`."""
        found = self.verification
        return {
            "plant": self.plant.name,
            "method": self.method,
            "faults": [f.name for f in self.plant.faults],
            "optimum": self.optimum,
            "level": self.level,
            "floor": self.floor,
            "verdict": None if found is None else found.verdict,
            "certificate": None if found is None else found.as_dict(),
            "details": self.details.as_dict(),
        }

    def report(self) -> str:
        """The design in a dozen lines of text."""
        d, found = self.details, self.verification
        lines = [f"{self.method} for {self.plant.name}: faults {', '.join(f.name for f in self.plant.faults)}"]
        if self.level is not None:
            floor = "not known" if self.floor is None else f"{self.floor:.6g}"
            lines.append(f"  γ shipped {self.level:.6g}, optimum {self.optimum:.6g}, floor {floor}")
        if d.pole_bound is not None and d.bounded_optimum is not None:
            lines.append(f"  optimum {d.bounded_optimum:.6g} with poles to the right of -{d.pole_bound:.4g} rad/s")
        lines.append(f"  chosen by: {d.criterion}")
        if d.gain_norms:
            lines.append("  gains: " + ", ".join(f"|{k}| = {v:.4g}" for k, v in d.gain_norms.items()))
        lines.append(f"  poles: fastest {d.fastest_pole:.4g} rad/s, slowest decay {d.slowest_pole:.4g} 1/s")
        lines.append(f"  largest stable Runge-Kutta step: {d.largest_step:.4g} s")
        if d.noise_sd is not None:
            units = dict(zip(self.plant.signals.y.names, self.plant.signals.y.units, strict=True))
            for fault in self.plant.faults:
                unit = units.get(next(iter(fault.on)), "")
                lines.append(f"  noise in {fault.name}: {d.noise_sd[fault.name]:.4g} {unit} (standard deviation)")
        lines += [f"  note: {note}" for note in d.notes]
        if found is None or self.certificate is None:
            lines.append("  certificate: none; nothing is claimed")
        else:
            lines.append(f"  certificate: {found.verdict}; {self.certificate.claim}")
            lines.append(f"  scope: {self.certificate.scope}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        level = "no certificate" if self.level is None else f"γ = {self.level:.6g}"
        return f"Design({self.method!r} for {self.plant.name!r}: {level})"


def design(
    plant: Plant,
    method: str = "lipschitz-hinf",
    *,
    faults: Sequence[str] | None = None,
    level: float | None = None,
    backoff: float = 0.05,
    pole_bound: float | str | None = "auto",
    fix: Mapping[str, Any] | None = None,
    free: Sequence[str] = (),
    certify: bool = True,
    progress: Progress | None = None,
) -> Design:
    """Gains with a guaranteed level, rounded to float64 and proved.

    faults: names of the faults to reconstruct, the others taken as healthy; all by default.  level: γ to aim at; by
    default (1 + backoff) times the optimum under the pole bound.  pole_bound: ρ in rad/s for Re λ > -ρ, None for none,
    "auto" for 2 / (noise hold time).  fix, free: unknowns of the theorem held or set free, by letter.  certify=False
    gives a baseline's gains without a proof.  progress: called with a word before each stage.

    Raises Impossible (an assumption fails, the level is below what the method or anybody can reach), Inconclusive (the
    solver gave up, or no proof was found), InputError.
    """
    started = time.perf_counter()
    say = progress or (lambda stage: None)
    if faults is not None:
        plant = plant.with_faults(faults)
    chosen = method_named(method)
    _options(backoff, level)
    if not certify:
        return _unproved(chosen, plant, started)
    fatal = [f for f in chosen.assumptions(plant) if f.severity == "fatal"]
    if fatal:
        raise Impossible(fatal[0])
    say("floor")
    peak = reconstruction_floor(plant)
    floor = None if peak is None else peak.value
    if level is not None and floor is not None and level < floor:
        raise Impossible(_below_floor(level, floor, None))
    say("optimum")
    free_posed = pose(chosen, plant, fix=fix, free=tuple(free))
    best = _level(free_posed.optimum(), free_posed, level)
    posed, bounded, notes = _bounded(chosen, plant, fix, tuple(free), pole_bound, best)
    if level is not None and level <= bounded:
        raise Impossible(_below_method(level, bounded, floor, posed))
    for growth in GROWTH:
        target = level if level is not None else (1.0 + backoff * growth) * bounded
        say("gains" if growth == 1.0 else f"gains, backing off by {backoff * growth:.3g}")
        found, criterion = _gains(posed, target)
        if not found.solved:
            continue
        gains = shipped(posed.theorem, found.values)
        say("proof")
        made, verification = _proved(chosen, posed, gains, found, target)
        if made is not None:
            details = describe(
                plant,
                chosen.observer(plant, gains),
                gains,
                criterion=criterion,
                backoff=target / bounded - 1.0,
                pole_bound=posed.pole_bound,
                bounded_optimum=bounded if posed.pole_bound is not None else None,
                solves=(found.solver,),
                seconds=time.perf_counter() - started,
                notes=(*notes, *(str(f) for f in chosen.assumptions(plant) if f.severity != "fatal")),
            )
            result = Design(plant, method, gains, best, target, floor, made, details)
            result.__dict__["verification"] = verification
            return result
        if level is not None:
            break
    raise Inconclusive(
        Finding(
            f"{method} found no gains for {plant.name} that could be proved",
            why=f"levels up to {target:.6g} were tried; the solver's last word was '{found.solver}'",
            remedies=("ask for a larger level", "declare signal ranges so that the problem is scaled", "relax pole_bound"),
        )
    )


def optimum(
    plant: Plant,
    method: str = "lipschitz-hinf",
    *,
    fix: Mapping[str, Any] | None = None,
    free: Sequence[str] = (),
    pole_bound: float | None = None,
    all_states: bool = False,
) -> float:
    """The infimum of the level; all_states gives the nonlinearity's structure away, as the paper prints its inequality.

    Raises Impossible when the inequality has no solution, Inconclusive when the solver cannot tell.
    """
    posed = pose(
        method_named(method),
        plant.reading_all_states() if all_states else plant,
        fix=fix,
        free=tuple(free),
        pole_bound=pole_bound,
    )
    return _level(posed.optimum(), posed, None)


# ---------------------------------------------------------------- stages


def _options(backoff: float, level: float | None) -> None:
    if not (math.isfinite(backoff) and backoff > 0):
        raise InputError(f"the back-off is {backoff}", why="the optimum itself is not attained; 0.05 is usual")
    if level is not None and not (math.isfinite(level) and level > 0):
        raise InputError(f"the level is {level}", why="γ is a positive number")


def _level(outcome: Outcome, posed: Posed, wanted: float | None) -> float:
    name = posed.method.name
    if outcome.solved:
        return math.sqrt(max(outcome.objective, 0.0))
    if outcome.status == "infeasible":
        bound = posed.plant.nonlinearity
        remedies = ["use another method that applies"]
        why = "no γ whatever satisfies its inequalities"
        if bound is not None:
            why += f" for a Lipschitz constant of {bound.constant:.6g}"
            remedies = [
                "shrink the domain, and with it the Lipschitz constant",
                "declare which states phi reads",
                *remedies,
            ]
        see = f"Theorem {posed.theorem.number}"
        raise Impossible(
            Finding(f"{name} has no solution for {posed.plant.name}", why=why, remedies=tuple(remedies), see=see)
        )
    raise Inconclusive(
        Finding(
            f"the solver gave up on {name} for {posed.plant.name}",
            why=f"its last word was '{outcome.solver}'; that is neither a solution nor a proof that there is none",
            remedies=("declare signal ranges so that the problem is scaled", "check the model's units"),
        )
    )


def _bounded(
    chosen: Method,
    plant: Plant,
    fix: Mapping[str, Any] | None,
    free: tuple[str, ...],
    pole_bound: float | str | None,
    best: float,
) -> tuple[Posed, float, tuple[str, ...]]:
    """The problem under its pole bound and its optimum; an automatic bound is doubled while it forbids a solution."""
    if pole_bound is not None and pole_bound != "auto":
        if isinstance(pole_bound, str) or not (math.isfinite(pole_bound) and pole_bound > 0):
            raise InputError(f"the pole bound is {pole_bound!r}", why="it is 'auto', None or a positive number in rad/s")
        posed = pose(chosen, plant, fix=fix, free=free, pole_bound=float(pole_bound))
        return posed, _level(posed.optimum(), posed, None), ()
    if pole_bound is None or plant.noise is None:
        return pose(chosen, plant, fix=fix, free=free), best, ()
    bound = wanted = STEP_SHARE / plant.noise.hold
    for _ in range(8):
        posed = pose(chosen, plant, fix=fix, free=free, pole_bound=bound)
        outcome = posed.optimum()
        if outcome.solved:
            note = () if bound == wanted else (f"the pole bound was raised from {wanted:.4g} to {bound:.4g} rad/s",)
            return posed, _level(outcome, posed, None), note
        bound *= 2.0
    return pose(chosen, plant, fix=fix, free=free), best, ("no automatic pole bound had a solution; none is set",)


def _gains(posed: Posed, level: float) -> tuple[Outcome, str]:
    if posed.plant.noise is not None and any(posed.plant.noise.sd):
        return quietest(posed, level), "least noise in the reconstructed fault (bound)"
    return smallest_gain(posed, level), "least gain from the healthy outputs to the state, in scaled units (bound)"


def _proved(
    chosen: Method, posed: Posed, gains: Mapping[str, Array], found: Outcome, level: float
) -> tuple[Certificate | None, Verification | None]:
    """The certificate of these gains if a proof is found: with the solver's multipliers, else with those of most margin."""
    for attempt in (lambda: found, lambda: multipliers(posed, gains, level)):
        outcome = attempt()
        if not outcome.solved:
            return None, None
        values = {**posed.fixed, **outcome.values}
        made = certificate(chosen.name, posed.theorem, posed.plant, gains, values, level)
        verification = prove(made)
        if verification.sound:
            return made, verification
    return None, None


def _unproved(chosen: Method, plant: Plant, started: float) -> Design:
    gains = chosen.gains_without_proof(plant)
    if gains is None:
        raise InputError(f"{chosen.name} has no gains without its theorem", remedies=("leave certify=True",))
    details = describe(
        plant,
        chosen.observer(plant, gains),
        gains,
        criterion="none: there is nothing to choose",
        backoff=0.0,
        pole_bound=None,
        bounded_optimum=None,
        solves=(),
        seconds=time.perf_counter() - started,
    )
    return Design(plant, chosen.name, gains, None, None, None, None, details)


def _below_floor(level: float, floor: float, optimum: float | None) -> Finding:
    return Finding(
        f"γ = {level:.6g} is below {floor:.6g}, the best any estimator can do with these sensors",
        evidence={"level": level, "floor": floor},
        remedies=(f"ask for more than {floor:.6g}", "add a healthy sensor or use a quieter one"),
        see="Khosrowjerdi 2011, re-derived floor",
    )


def _below_method(level: float, optimum: float, floor: float | None, posed: Posed) -> Finding:
    bound = "" if posed.pole_bound is None else f" with poles to the right of -{posed.pole_bound:.4g} rad/s"
    return Finding(
        f"γ = {level:.6g} is below {optimum:.6g}, the optimum of {posed.method.name}{bound}",
        evidence={"level": level, "optimum": optimum, "floor": floor},
        remedies=(f"ask γ ≥ {1.05 * optimum:.4g}",)
        + (("raise pole_bound",) if posed.pole_bound is not None else ())
        + (("shrink the domain of the nonlinearity",) if posed.plant.nonlinearity is not None else ()),
        see=f"Theorem {posed.theorem.number}",
    )
