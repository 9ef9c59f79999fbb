# SPDX-License-Identifier: BSD-3-Clause
"""The verbs that try things out: simulate, compare, reproduce."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from faultrecon.cli.root import Json, PlantName, app, plant_named
from faultrecon.cli.shell import NEGATIVE, answer, bar, guarded, stages

Signals = list[str] | None
Path_ = Path | None

FAULT = typer.Option("--fault", help="NAME:SHAPE:key=value,... for example pitch_rate:ramp:size=0.04,over=20,at=5.")
INPUT = typer.Option("--input", help="An input's deviation, written like a fault.")
DISTURBANCE = typer.Option("--disturbance", help="A disturbance, written like a fault; 'noise' is a shape too.")


def _scenario(
    faults: list[str] | None,
    inputs: list[str] | None,
    disturbances: list[str] | None,
    plant: Any,
    options: dict[str, Any],
) -> Any:
    from faultrecon.cli.simulating import scenario_from

    given = {key: value for key, value in options.items() if value is not None}
    return scenario_from(faults or [], inputs or [], disturbances or [], plant, **given)


@app.command()
def simulate(
    name: Annotated[
        str, typer.Argument(metavar="DESIGN", help="A design or a bank (.json), or a plant to design for.")
    ],
    method: Annotated[str, typer.Option("--method", "-m", help="Method, when a plant is given.")] = "lipschitz-hinf",
    faults: Annotated[Signals, FAULT] = None,
    inputs: Annotated[Signals, INPUT] = None,
    disturbances: Annotated[Signals, DISTURBANCE] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds; with a bank, that each fault lasts.")] = None,
    sample_time: Annotated[float | None, typer.Option(help="Seconds.")] = None,
    runs: Annotated[int, typer.Option(help="Of a bank: for each fault, size and waveform.")] = 20,
    sizes: Annotated[
        list[float] | None, typer.Option("--size", help="Of a bank: a size to try, in declared sizes; repeatable.")
    ] = None,
    hours: Annotated[float, typer.Option(help="Of a bank: without a fault, to count false alarms.")] = 0.5,
    noise: Annotated[bool, typer.Option(help="Whether the declared sensor noise acts.")] = True,
    seed: Annotated[int, typer.Option(help="Every random signal follows from it.")] = 0,
    out: Annotated[Path_, typer.Option("--out", "-o", help="Where to write the run (.csv, .parquet).")] = None,
    figure: Annotated[Path_, typer.Option(help="Where to draw it (.png, .pdf, .svg).")] = None,
    as_json: Json = False,
) -> None:
    """Let a fault happen in the plant and see what the design makes of it.

    With a bank: let each fault, or those of --fault NAME, happen many times, as a step and as a ramp, and tell how
    many were missed by size, and how many were made up.
    """
    with guarded(as_json):
        from faultrecon.cli.simulating import run_simulation, run_trial
        from faultrecon.io.bankfile import is_bank

        options = {"duration": duration, "sample_time": sample_time, "noise": noise, "seed": seed}
        if is_bank(name):
            options |= {"runs": runs, "sizes": sizes or None, "hours": hours}
            with bar("trying") as tell:
                data, text = run_trial(
                    name, faults or (), inputs or (), disturbances or (), out, figure, tell, **options
                )
            answer(as_json, data, text)
            return
        if name.lower().endswith(".json"):
            from faultrecon.io.designfile import read_design

            design = read_design(name)
            scenario = _scenario(faults, inputs, disturbances, design.plant, options)
        else:
            from faultrecon.synthesis.pipeline import design as make

            plant = plant_named(name)
            scenario = _scenario(faults, inputs, disturbances, plant, options)
            with stages("designing") as tell_stage:
                design = make(plant, method, progress=tell_stage)
        with bar("simulating") as tell:
            data, text = run_simulation(design, scenario, out=out, figure=figure, progress=tell)
        answer(as_json, data, text)


@app.command()
def compare(
    plant: PlantName,
    methods: Annotated[Signals, typer.Option("--method", "-m", help="Repeat for several; all by default.")] = None,
    faults: Annotated[Signals, FAULT] = None,
    inputs: Annotated[Signals, INPUT] = None,
    disturbances: Annotated[Signals, DISTURBANCE] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds.")] = None,
    seed: Annotated[int, typer.Option(help="Every random signal follows from it.")] = 0,
    as_json: Json = False,
) -> None:
    """Put methods side by side on one plant and one scenario; each fault in turn when none is given."""
    with guarded(as_json):
        from faultrecon.cli.simulating import run_comparison

        described, chosen = plant_named(plant), None
        if faults or inputs or disturbances:
            chosen = _scenario(faults, inputs, disturbances, described, {"duration": duration, "seed": seed})
        with bar("comparing") as tell:
            data, text = run_comparison(described, methods or None, chosen, tell)
        answer(as_json, data, text)


@app.command()
def reproduce(
    key: Annotated[str, typer.Argument(metavar="PAPER", help="For example khosrowjerdi2011.")],
    out: Annotated[Path_, typer.Option("--out", "-o", help="Folder for the figures.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noisy rows.")] = 0,
    as_json: Json = False,
) -> None:
    """Compute the tables of a paper again: printed value, ours, status and reason."""
    with guarded(as_json):
        from faultrecon.cli.simulating import run_reproduction

        with stages(f"reproducing {key}") as tell:
            data, text, fine = run_reproduction(key, out, seed, tell)
        answer(as_json, data, text)
        if not fine:
            raise SystemExit(NEGATIVE)
