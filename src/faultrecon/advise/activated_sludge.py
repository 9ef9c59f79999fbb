# SPDX-License-Identifier: BSD-3-Clause
"""Ammonium sensors that foul in a treatment plant nobody here wrote, and how far a two-state model lets one see it.

The logs are a dry fortnight of Benchmark Simulation Model No. 1 (21 variables per tank): one of the first aerated tank,
where two states follow the plant within a hundredth, and one of the last, where oxygen runs short and ammonium falls to
the noise of its sensor.  Every method that accepts the fitted plant is replayed; beside what it leaves stands what was
to be expected from the healthy part of the log alone.  Times are in hours, as in the plant files.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.resources import as_file, files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import FaultreconError, Impossible, InputError, did_you_mean
from faultrecon.graph.function import Graph
from faultrecon.io.document import read_text as text_of
from faultrecon.io.logs import Log, read_log
from faultrecon.io.plantfile import read_plant
from faultrecon.methods.registry import all_methods
from faultrecon.plant.plant import Plant
from faultrecon.plant.sector import Sector
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.runtime.samples import Trace
from faultrecon.simulation.chance import normal_samples, stream_seed
from faultrecon.synthesis.pipeline import design
from faultrecon.synthesis.result import Design

Array = NDArray[np.float64]

TANKS = ("first_tank", "last_tank")
FAULT = "fouling"
MODEL = "simulate-invert"
"""The design whose state is the model's own, uncorrected."""
WARM = 24.0
"""Hours left to the estimates to settle."""
DIVERGED = 1e3
"""No sensor's gain is wrong by that factor."""
PERCENT = 0.01
"""By how much a constant is changed to see what the estimate makes of it."""
MEASURED = {"flow meter": 0, "feed analyser": 1}
"""Inputs whose calibration is as much a constant of the model as those in its equations, by column of u."""


@dataclass(frozen=True)
class Budget:
    """What was to be expected of one method in the units of f, from model, fit and the healthy log alone; RMS each.

    parameters: constants off by as much as the fit leaves open.  lag: the method on its own model, without noise.
    noise: what it makes of sensor noise.  missed: the estimate on a healthy day that the fit has not seen, noise taken
    out: what the two states cannot follow.  The fault that scales `missed` and moves `lag` is the one of the log.
    """

    parameters: float
    lag: float
    noise: float
    missed: float

    @property
    def total(self) -> float:
        """All of them, as if independent."""
        return float(np.sqrt(self.parameters**2 + self.lag**2 + self.noise**2 + self.missed**2))


@dataclass(frozen=True)
class Found:
    """One method on one log.

    rmse: of f from the onset on, over the size of the fault.  within: the same while the model's ammonium is in the box
    of the plant file.  bias: mean error there, over the size.  leak: RMS of the estimate before the onset, over the
    size.  budget: predicted, in units of f.  gauges: mean change of the estimate per percent of each constant.
    verdict: of the certificate, about the model and not the plant.
    """

    tank: str
    method: str
    rmse: float
    within: float
    bias: float
    leak: float
    budget: Budget
    gauges: Mapping[str, float]
    verdict: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"gauges": dict(self.gauges), "expected": self.budget.total}


@dataclass(frozen=True)
class Fouling:
    """All methods on all logs, those that found no gains or diverged with the reason, and the size of the fault.

    written: the files of a demonstration; note: what it says about them.
    """

    size: float
    found: tuple[Found, ...]
    refused: Mapping[tuple[str, str], str]
    written: tuple[Path, ...] = ()
    note: str = ""

    def of(self, tank: str, method: str) -> Found:
        """One of them.  Raises InputError when it was refused or is none."""
        for one in self.found:
            if (one.tank, one.method) == (tank, method):
                return one
        why = self.refused.get((tank, method), did_you_mean(method, [f.method for f in self.found]))
        raise InputError(f"'{method}' has no result on '{tank}'", why=why)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        refused = [{"tank": t, "method": m, "why": why} for (t, m), why in self.refused.items()]
        plain = {"size": self.size, "found": [f.as_dict() for f in self.found], "refused": refused}
        return plain | {"written": [str(path) for path in self.written], "note": self.note}

    def __str__(self) -> str:
        head = f"RMSE of the lost gain over its size, {self.size:g}; expected: root of the sum of squares of its parts"
        lines = [head, _HEADER]
        for f in self.found:
            b, s = f.budget, self.size
            parts = " ".join(f"{v / s:10.3f}" for v in (b.total, b.parameters, b.lag, b.noise, b.missed))
            lines.append(
                f"{f.tank:11} {f.method:22} {f.rmse:7.3f} {f.within:7.3f} {f.bias:+7.3f} {f.leak:7.3f} {parts}"
            )
        lines += ["", "change of the estimate per percent, mean from the onset on"]
        for f in self.found:
            lines.append(f"{f.tank:11} {f.method:22} " + ", ".join(f"{k} {v:+.4f}" for k, v in f.gauges.items()))
        lines += ["", *(f"{tank}: {name}: {why}" for (tank, name), why in self.refused.items())]
        lines += [WORDS, *(f"wrote {path}" for path in self.written)]
        return "\n".join([*lines, self.note] if self.note else lines)


_HEADER = (
    f"{'log':11} {'method':22} {'RMSE':>7} {'in box':>7} {'bias':>7} {'leak':>7}"
    f" {'expected':>10} {'parameters':>10} {'lag':>10} {'noise':>10} {'missed':>10}"
)
WORDS = (
    "A gain of the feed analyser and the lost gain cannot be told apart: one percent of the one is about one percent of"
    " the other.  Constants of the fit matter by what its own uncertainty leaves of them, mismatch of structure by the"
    " column `missed`, which no better fit of these two states removes."
)


# ---------------------------------------------------------------- what ships


def reactor(tank: str) -> Plant:
    """The two-state plant fitted to one tank.  Raises InputError for a tank that is not there."""
    with as_file(_shipped(tank, ".toml")) as path:
        return read_plant(path)


def recording(tank: str, plant: Plant | None = None) -> Log:
    """The recorded fortnight of one tank; `extra` holds the true fault and the true states."""
    with as_file(_shipped(tank, ".csv")) as path:
        return read_log(path, (plant or reactor(tank)).signals)


def fit_of(tank: str) -> tuple[tuple[str, ...], Array, tuple[float, float]]:
    """The constants that were fitted, their covariance, and the healthy hours that the fit has not seen."""
    with as_file(files("faultrecon") / "data" / "activated_sludge" / "fit.json") as path:
        stored = json.loads(text_of(path))
    low, high = stored["held_out_h"]
    return tuple(stored[tank]["constants"]), np.array(stored[tank]["covariance"]), (low, high)


def _shipped(tank: str, ending: str) -> Traversable:
    if tank not in TANKS:
        raise InputError(f"there is no log of '{tank}'", why=did_you_mean(tank, TANKS))
    return files("faultrecon") / "data" / "activated_sludge" / f"{tank}{ending}"


# ---------------------------------------------------------------- reconstruct


def fouling(
    tanks: Sequence[str] = TANKS, methods: Sequence[str] | None = None, progress: Callable[[str], None] | None = None
) -> Fouling:
    """Replay the methods over the logs and say what each leaves and what was to be expected.

    methods: names; by default every one that accepts the plant, variants and references for nothing but comparison
    left out.  progress: told tank and method.
    """
    found: list[Found] = []
    refused: dict[tuple[str, str], str] = {}
    size = 0.0
    for tank in tanks:
        case = Case.of(tank)
        size = float(np.abs(case.f).max())
        for name in accepted(case.plant) if methods is None else methods:
            if progress is not None:
                progress(f"{tank}: {name}")
            try:
                found.append(case.judged(design(case.plant, name)))
            except FaultreconError as error:
                refused[tank, name] = error.finding.what
    return Fouling(size, tuple(found), refused)


def accepted(plant: Plant) -> list[str]:
    """The methods without a fatal finding on the plant, in alphabetical order; no variant of another one."""
    return [
        name
        for name, m in sorted(all_methods().items())
        if not m.variant_of and not any(f.severity == "fatal" for f in m.assumptions(plant))
    ]


@dataclass(frozen=True, eq=False)
class Case:
    """One log with everything that does not depend on the method.

    model (N,): ammonium as the model says it, nothing corrected.  since: rows from the onset of the fault on; within:
    those of them where the model is in its box; warm: healthy rows; unseen: healthy rows that the fit has not seen.
    """

    tank: str
    plant: Plant
    log: Log
    f: Array
    model: Array
    since: NDArray[np.bool_]
    within: NDArray[np.bool_]
    warm: NDArray[np.bool_]
    unseen: NDArray[np.bool_]

    @staticmethod
    @cache
    def of(tank: str) -> Case:
        """Read and simulate."""
        plant = reactor(tank)
        log = recording(tank, plant)
        f, t = log.extra[f"true_f_{FAULT}"], log.t
        state = _trace(plant, all_methods()[MODEL].observer(plant, {}), log.u, log.y, t).state
        assert plant.polytopic is not None, "the shipped plants have one"
        inside = Sector.of(plant).membership_margin(state, log.u) >= 0
        low, high = fit_of(tank)[2]
        since = f != 0
        return Case(
            tank, plant, log, f, state[:, 1], since, since & inside, (t >= WARM) & ~since, (t >= low) & (t < high)
        )

    def estimate(
        self, made: Design, plant: Plant | None = None, u: Array | None = None, y: Array | None = None
    ) -> Array:
        """f̂ (N,) by the gains of a design in the observer of a plant, from inputs and readings; those of the log."""
        method = all_methods()[made.method]
        observer = made.observer if plant is None else method.observer(plant, made.gains)
        u, y = self.log.u if u is None else u, self.log.y if y is None else y
        return _trace(self.plant, observer, u, y, self.log.t).fault[:, 0]

    def judged(self, made: Design) -> Found:
        """What a design leaves, and what was to be expected."""
        found = self.estimate(made)
        gone = np.flatnonzero(~(np.abs(found) < DIVERGED))
        if gone.size:
            k = int(gone[0])
            raise Impossible(
                f"the estimate diverges at {self.log.t[k]:.1f} h, where the model says {self.model[k]:.2g} g/m3",
                why="the log leaves the box in which the design holds",
                evidence={"time": float(self.log.t[k]), "ammonium": float(self.model[k])},
                remedies=("take a method whose innovation is not divided by the reading", "use another sensor"),
            )
        error, size = found - self.f, float(np.abs(self.f).max())
        verdict = "none" if made.verification is None else made.verification.verdict
        return Found(
            self.tank,
            made.method,
            _rms(error[self.since]) / size,
            _rms(error[self.within]) / size,
            float(error[self.since].mean()) / size,
            _rms(found[self.warm]) / size,
            self.budget(made, found),
            self.gauges(made, found),
            verdict,
        )

    def budget(self, made: Design, found: Array) -> Budget:
        """Four parts, none of which looks at the true fault's estimate.  found (N,): f̂ on the log."""
        clean = ((1.0 + self.f) * self.model)[:, None]
        assert self.plant.noise is not None, "the plant files declare it"
        noise = self.plant.noise.sd[0] * normal_samples(stream_seed(0, "noise/0"), len(clean))[:, None]
        by_model = self.estimate(made, y=clean)
        by_noise = self.estimate(made, y=clean + noise) - by_model
        healthy = self.model[:, None]
        quiet = self.estimate(made, y=healthy + noise) - self.estimate(made, y=healthy)
        missed = max(_rms(found[self.unseen]) ** 2 - _rms(quiet[self.unseen]) ** 2, 0.0) ** 0.5
        scale = _rms(1.0 + self.f[self.since])
        lag = _rms((by_model - self.f)[self.since])
        return Budget(self._parameters(made, found), lag, _rms(by_noise[self.since]), missed * scale)

    def _parameters(self, made: Design, found: Array) -> float:
        """RMS over time of the standard deviation that the fit's covariance gives f̂, to first order."""
        names, covariance, _ = fit_of(self.tank)
        steps = np.sqrt(np.diag(covariance)) / 4  # small against what they stand for, large against rounding
        slopes = [
            (self.estimate(made, changed(self.plant, name, step)) - found) / step
            for name, step in zip(names, steps, strict=True)
        ]
        g = np.stack(slopes, axis=1)[self.since]
        return float(np.sqrt(np.mean(np.einsum("ki,ij,kj->k", g, covariance, g))))

    def gauges(self, made: Design, found: Array) -> dict[str, float]:
        """Mean change of f̂ from the onset on when a constant, or the calibration of an input, is one percent larger."""
        term = self.plant.nonlinearity
        assert term is not None, "the model is nothing but its nonlinear term"
        constants = term.phi.constants
        moved = {k: self.estimate(made, changed(self.plant, k, PERCENT * v)) for k, v in constants.items()}
        for name, column in MEASURED.items():
            factor = np.ones(self.log.u.shape[1])
            factor[column] += PERCENT
            moved[name] = self.estimate(made, u=self.log.u * factor)
        return {name: float((f_hat - found)[self.since].mean()) for name, f_hat in moved.items()}


def changed(plant: Plant, constant: str, by: float) -> Plant:
    """The same plant with one constant of its equations larger by `by`; its box and vertices stay those of before."""
    term = plant.nonlinearity
    if term is None or constant not in term.phi.constants:
        known = () if term is None else tuple(term.phi.constants)
        raise InputError(f"{plant.name} has no constant '{constant}'", why=did_you_mean(constant, known))
    phi = term.phi
    other = Graph.from_texts(phi.texts, phi.inputs, {**phi.constants, constant: phi.constants[constant] + by})
    return replace(plant, nonlinearity=replace(term, phi=other))


def _trace(plant: Plant, observer: Any, u: Array, y: Array, t: Array) -> Trace:
    assert plant.noise is not None, "the plant files declare it"
    estimator = Estimator.build(observer, plant.noise.hold, prediction=Prediction(plant.C, plant.D))
    return estimator.replay(t, u, y)


def _rms(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(np.square(finite)))) if finite.size else float("nan")
