# SPDX-License-Identifier: BSD-3-Clause
"""Methods side by side on one plant and one scenario: what each promises, and what each then does."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from faultrecon.finding import FaultreconError, Impossible, Inconclusive
from faultrecon.methods.registry import list_methods, method
from faultrecon.plant.plant import Plant
from faultrecon.simulation.chance import HeldNoise
from faultrecon.simulation.metrics import FaultScore
from faultrecon.simulation.run import undeclared_noise, watch
from faultrecon.simulation.scenario import Scenario, default_sample_time
from faultrecon.simulation.shapes import Step
from faultrecon.simulation.truth import true_run
from faultrecon.synthesis.pipeline import design
from faultrecon.synthesis.result import Design

GUSTS = 40
"""How many samples of a held disturbance fit into the default scenario: slow enough to move the states."""
HALVINGS = 12


@dataclass(frozen=True)
class Entry:
    """One method: its design's promises, its scores by fault, and a note where something has to be said.

    verdict: of the certificate, "none" for a baseline that runs without one, "impossible" or "inconclusive" when there
    are no gains.  noise_sd: standard deviation of each reconstructed fault under the declared sensor noise.
    undeclared: sensors whose noise acts and is none of the disturbances, which leaves no achieved gain to compare.
    """

    method: str
    verdict: str
    note: str = ""
    level: float | None = None
    optimum: float | None = None
    floor: float | None = None
    achieved: float | None = None
    fastest_pole: float | None = None
    largest_step: float | None = None
    noise_sd: dict[str, float] | None = None
    scores: dict[str, FaultScore] | None = None
    undeclared: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        found = None if self.scores is None else {name: s.as_dict() for name, s in self.scores.items()}
        return {**self.__dict__, "scores": found, "undeclared": list(self.undeclared)}


@dataclass(frozen=True)
class SideBySide:
    """The comparison: one entry per method, in the order they were asked for."""

    plant: str
    scenario: Scenario
    entries: tuple[Entry, ...]

    def __getitem__(self, name: str) -> Entry:
        return next(e for e in self.entries if e.method == name)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {"plant": self.plant, "scenario": repr(self.scenario), "methods": [e.as_dict() for e in self.entries]}

    def __str__(self) -> str:
        width = max([6, *(len(e.method) for e in self.entries)])
        head = f"{'method':{width}}  {'verdict':12} {'level':>9} {'optimum':>9} {'floor':>9} {'achieved':>9}"
        lines = [f"{self.plant}: {self.scenario}", "", head + f" {'fastest pole':>13} {'largest step':>13}"]
        for e in self.entries:
            numbers = (e.level, e.optimum, e.floor, e.achieved)
            lines.append(
                f"{e.method:{width}}  {e.verdict:12} "
                + " ".join(f"{_number(v):>9}" for v in numbers)
                + f" {_number(e.fastest_pole):>13} {_number(e.largest_step):>13}"
            )
        faults = list(dict.fromkeys(name for e in self.entries for name in e.scores or {}))
        for fault in faults:
            row = f"{fault:{width}}  {'nrmse':>9} {'delay [s]':>10} {'leak':>10} {'noise sd':>10}"
            lines += ["", row]
            for e in self.entries:
                if e.scores and fault in e.scores:
                    s = e.scores[fault]
                    noise = None if e.noise_sd is None else e.noise_sd[fault]
                    lines.append(
                        f"{e.method:{width}}  {_number(s.nrmse):>9} {_number(s.delay):>10} {_number(s.leak):>10}"
                        f" {_number(noise):>10}"
                    )
        notes = [f"  {e.method}: {e.note}" for e in self.entries if e.note]
        silent = list(dict.fromkeys(name for e in self.entries for name in e.undeclared))
        if silent:
            notes.append(f"  no gain achieved is shown: {undeclared_noise(silent)}")
        return "\n".join([*lines, "", *notes] if notes else lines)


def compare(
    plant: Plant,
    methods: Sequence[str] | None = None,
    scenario: Scenario | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> SideBySide:
    """Design with every method, let the same thing happen to the plant, and score each reconstruction.

    methods: all by default, baselines among them.  scenario: `one_by_one` by default.  A baseline that cannot be
    certified runs without a certificate, and says so; a method that has no gains for this plant gets an entry that says
    why.  Raises InputError on unknown names.
    """
    names = list(methods) if methods is not None else list_methods()
    chosen = [method(name) for name in names]
    happening = scenario or one_by_one(plant)
    truth = true_run(plant, happening)
    entries = []
    for k, (name, found) in enumerate(zip(names, chosen, strict=True)):
        made, entry = _designed(plant, name, found.baseline)
        if made is not None:
            try:
                score = watch(made, truth).score()
                entry = replace(_entry(made, entry.note, score.achieved, dict(score)), undeclared=score.undeclared)
            except FaultreconError as error:
                entry = _entry(made, f"does not run: {error}", None, None)
        entries.append(entry)
        if progress is not None:
            progress((k + 1) / len(names))
    return SideBySide(plant.name, happening, tuple(entries))


def one_by_one(plant: Plant, duration: float = 20.0) -> Scenario:
    """A bias on every fault, one after the other, while disturbances act as held random signals, all of declared size.

    Disturbances are halved until the plant stays bounded and in the domain of its nonlinearity.  Those on sensors alone
    are left out where sensor noise is declared, which is the same thing said twice.
    """
    count, h = len(plant.faults), default_sample_time(plant)
    faults = {f.name: Step(f.size).starting(duration * (k + 1) / (count + 2)) for k, f in enumerate(plant.faults)}
    about, share = "a bias on every fault in turn, disturbances", 1.0
    for _ in range(HALVINGS):
        disturbances = {
            d.name: HeldNoise(share * d.size, duration / GUSTS if d.into else h)
            for d in plant.attenuated
            if d.into or plant.noise is None
        }
        size = "of their declared sizes" if share == 1.0 else f"of {share:g} of their sizes to stay in the domain"
        scenario = Scenario(duration=duration, faults=faults, disturbances=disturbances, name=f"{about} {size}")
        if plant.nonlinearity is None or _stays(plant, scenario):
            return scenario
        share *= 0.5
    return Scenario(duration=duration, faults=faults, name=f"{about} none")


def _stays(plant: Plant, scenario: Scenario) -> bool:
    try:
        return not true_run(plant, scenario, inside=True).left_domain()
    except Inconclusive:
        return False


def _designed(plant: Plant, name: str, baseline: bool) -> tuple[Design | None, Entry]:
    """A design with a certificate if there is one, a baseline's without if not, else an entry that says why."""
    try:
        return design(plant, name), Entry(name, "")
    except (Impossible, Inconclusive) as error:
        why, kind = str(error), "impossible" if isinstance(error, Impossible) else "inconclusive"
    if baseline:
        try:
            return design(plant, name, certify=False), Entry(name, "none", f"runs without a certificate: {why}")
        except FaultreconError as error:
            why = str(error)
    return None, Entry(name, kind, why)


def _entry(made: Design, note: str, achieved: float | None, scores: dict[str, FaultScore] | None) -> Entry:
    verified, d = made.verification, made.details
    return Entry(
        made.method,
        "none" if verified is None else verified.verdict,
        note,
        made.level,
        made.optimum,
        made.floor,
        achieved,
        d.fastest_pole,
        d.largest_step if math.isfinite(d.largest_step) else None,
        None if d.noise_sd is None else dict(d.noise_sd),
        scores,
    )


def _number(value: float | None) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:.4g}"
