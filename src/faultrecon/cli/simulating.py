# SPDX-License-Identifier: BSD-3-Clause
"""The verbs `simulate`, `compare` and `reproduce`: thin, each returns its answer as data and as text.

A design is simulated in one scenario, a bank in many: see `faultrecon.simulation.trial`.

A signal is written NAME:SHAPE:key=value,key=value, for example  pitch_rate:ramp:size=0.4,over=10,at=5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from faultrecon.finding import InputError, did_you_mean
from faultrecon.plant.plant import Plant
from faultrecon.simulation.chance import HeldNoise, LooseContact, RandomWalk
from faultrecon.simulation.composition import Shape
from faultrecon.simulation.run import Run, simulate
from faultrecon.simulation.scenario import Scenario
from faultrecon.simulation.shapes import Doublet, Drift, Loss, Ramp, Sine, Spike, Step, Stuck
from faultrecon.synthesis.result import Design

SHAPES: Mapping[str, type[Shape]] = {
    "step": Step,
    "ramp": Ramp,
    "drift": Drift,
    "walk": RandomWalk,
    "sine": Sine,
    "loss": Loss,
    "stuck": Stuck,
    "spike": Spike,
    "doublet": Doublet,
    "loose": LooseContact,
    "noise": HeldNoise,
}
FIGURES = (".png", ".pdf", ".svg")


def parsed_signal(text: str) -> tuple[str, Shape]:
    """The name and the shape of a signal as it is written on the command line.  Raises InputError."""
    name, _, rest = text.partition(":")
    word, _, options = rest.partition(":")
    how = ("write NAME:SHAPE:key=value,...", "for example pitch_rate:step:size=0.4,at=5")
    if not name or not word:
        raise InputError(f"'{text}' is no signal", why=did_you_mean(word, SHAPES), remedies=how)
    if word not in SHAPES:
        raise InputError(f"{text}: there is no shape {word}", remedies=(did_you_mean(word, SHAPES), how[0]))
    kind = SHAPES[word]
    values = _numbers(text, options)
    at, until = values.pop("at", 0.0), values.pop("until", None)
    known = {f.name: f for f in fields(kind)}
    for key in values:
        if key not in known:
            raise InputError(f"{text}: a {word} has no '{key}'", why=did_you_mean(key, [*known, "at", "until"]))
    needed = [key for key, f in known.items() if f.default is MISSING and key not in values]
    if needed:
        raise InputError(f"{text}: a {word} needs {', '.join(needed)}", remedies=(f"add {needed[0]}=...",))
    if "seed" in values:
        values["seed"] = int(values["seed"])
    shape = kind(**values).starting(at)
    return name, shape if until is None else shape.until(until)


def _numbers(text: str, options: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for part in filter(None, options.split(",")):
        key, equals, number = part.partition("=")
        try:
            found[key.strip()] = float(number)
        except ValueError:
            raise InputError(f"{text}: '{part}' is no key=number", remedies=("write size=0.4",)) from None
        if not equals:
            raise InputError(f"{text}: '{part}' is no key=number")
    return found


def scenario_from(
    faults: Sequence[str],
    inputs: Sequence[str],
    disturbances: Sequence[str],
    plant: Plant | None = None,
    **options: Any,
) -> Scenario:
    """A scenario from signals as they are written on the command line; options are the other fields of `Scenario`.

    Names are checked against the plant, when it is given, before the shapes are read.  Raises InputError.
    """
    groups = {"faults": faults, "inputs": inputs, "disturbances": disturbances}
    if plant is not None:
        _check_names("fault", faults, [f.name for f in plant.faults])
        _check_names("input", inputs, plant.signals.u.names)
        _check_names("disturbance", disturbances, [d.name for d in plant.disturbances])
    return Scenario(**{key: dict(parsed_signal(text) for text in texts) for key, texts in groups.items()}, **options)


def _check_names(what: str, texts: Sequence[str], known: Sequence[str]) -> None:
    for name in (text.partition(":")[0] for text in texts):
        if name and name not in known:
            raise InputError(f"there is no {what} '{name}'", why=did_you_mean(name, known))


def run_simulation(
    design: Design, scenario: Scenario, *, out: Path | None, figure: Path | None, **options: Any
) -> tuple[dict[str, Any], str]:
    """Simulate, score, and write the table and the figure that were asked for; options are those of `simulate`."""
    from faultrecon.io.logs import write_log
    from faultrecon.io.tables import name_extension

    if out is not None:
        name_extension(str(out))  # a wrong extension is refused before the work, not after it
    _check_figure(figure)
    run = simulate(design, scenario, **options)
    if out is not None:
        write_log(out, run.columns())
    if figure is not None:
        from faultrecon.plot.figures import save

        save(run.plot(), figure)
    return _data(run, out, figure), _text(run, out, figure)


def run_trial(
    file: str,
    faults: Sequence[str],
    inputs: Sequence[str],
    disturbances: Sequence[str],
    out: Path | None,
    figure: Path | None,
    progress: Callable[[float], None],
    **options: Any,
) -> tuple[dict[str, Any], str]:
    """The bank in `file` on simulated faults: misses by size, and false alarms; options are those of `trial`."""
    from faultrecon.io.bankfile import read_bank
    from faultrecon.io.logs import write_log
    from faultrecon.io.tables import name_extension
    from faultrecon.simulation.trial import trial

    if figure is not None:
        raise InputError("--figure with a bank", why="a trial is a table", remedies=("write it with --out trial.csv",))
    if out is not None:
        name_extension(str(out))
    for text in faults:
        if ":" in text:
            why = "a bank is tried with steps and ramps of many sizes"
            raise InputError(f"--fault {text}", why=why, remedies=("name the fault alone, and sizes with --size",))
    made = read_bank(file)
    happens = scenario_from((), inputs, disturbances, made.plant)
    found = trial(
        made,
        faults=faults or None,
        inputs=happens.inputs,
        disturbances=happens.disturbances,
        progress=progress,
        **options,
    )
    if out is not None:
        write_log(out, found.columns())
    written = {"written": None if out is None else str(out)}
    return found.as_dict() | written, "\n".join([str(found), *([f"wrote {out}"] if out is not None else [])])


def run_comparison(
    plant: Plant,
    methods: Sequence[str] | None,
    scenario: Scenario | None,
    progress: Callable[[float], None] | None = None,
) -> tuple[dict[str, Any], str]:
    """The methods side by side."""
    from faultrecon.advise.comparison import compare

    found = compare(plant, methods, scenario, progress=progress)
    return found.as_dict(), str(found)


def run_reproduction(
    key: str, out: Path | None, seed: int, progress: Callable[[str], None] | None = None
) -> tuple[dict[str, Any], str, bool]:
    """The tables of a paper; the last entry says whether every number agrees with its reference."""
    from faultrecon.advise.reproductions import reproduce

    found = reproduce(key, out, seed=seed, progress=progress)
    return found.as_dict(), str(found), found.agrees


def _check_figure(figure: Path | None) -> None:
    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise InputError(f"{figure}: unknown kind of figure", remedies=(f"use {', '.join(FIGURES)}",))


def _data(run: Run, out: Path | None, figure: Path | None) -> dict[str, Any]:
    return {
        "plant": run.truth.plant.name,
        "method": run.design.method,
        "scenario": repr(run.scenario),
        "samples": len(run.t),
        "sample_time": float(run.t[1] - run.t[0]),
        "score": run.score().as_dict(),
        "written": None if out is None else str(out),
        "figure": None if figure is None else str(figure),
    }


def _text(run: Run, out: Path | None, figure: Path | None) -> str:
    lines = [f"{run.design.method} on {run.truth.plant.name}", str(run.scenario), "", str(run.score())]
    return "\n".join([*lines, *(f"wrote {path}" for path in (out, figure) if path is not None)])
