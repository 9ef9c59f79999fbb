# SPDX-License-Identifier: BSD-3-Clause
"""The verbs that work on files; those that simulate are in `trying`."""

from __future__ import annotations

import math
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from faultrecon.cli.root import Faults, Json, PlantName, app, plant_named
from faultrecon.cli.shell import NEGATIVE, answer, bar, guarded, speak_any_letter


def run_app() -> None:
    """Run the command line."""
    speak_any_letter()
    app()


@app.command()
def new(
    path: Annotated[Path, typer.Argument(help="The plant file to write (.toml).")],
    copy: Annotated[str, typer.Option("--from", help="A library plant to start from.")] = "",
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    as_json: Json = False,
) -> None:
    """Write a plant file to start from: a commented template, or a copy of a library plant."""
    with guarded(as_json):
        from faultrecon.io.template import new_plant

        new_plant(path, copy, force)
        answer(as_json, {"written": str(path)}, f"wrote {path}; edit it, then: faultrecon check {path}")


DEFAULT = "lipschitz-hinf"


@app.command()
def check(
    plant: PlantName,
    faults: Faults = None,
    sensors: Annotated[
        bool, typer.Option("--sensors", help="Tell what one more sensor would do, and which faults can be had at once.")
    ] = False,
    sensor: Annotated[
        list[str] | None,
        typer.Option(
            "--sensor", help="Rank a sensor that could be added: 'name on state=coefficient noise=size'; repeatable."
        ),
    ] = None,
    log: Annotated[
        str, typer.Option("--log", help="Where the plant goes (.csv, .parquet), for faults that multiply a sensor.")
    ] = "",
    as_json: Json = False,
) -> None:
    """Can these faults be reconstructed, and if not, why not? Which methods apply?"""
    with guarded(as_json):
        from faultrecon.cli.checking import examined

        model = plant_named(plant)
        model = model.with_faults(faults) if faults else model
        possible, data, text = examined(model, sensors, sensor or (), as_json=as_json, log=log)
        answer(as_json, data, text)
        if not possible:
            raise SystemExit(NEGATIVE)


@app.command()
def design(
    plant: PlantName,
    method: Annotated[
        str, typer.Option("--method", "-m", help="See `faultrecon methods`; 'best' compares them.")
    ] = DEFAULT,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Where to write the design file (.json)."),
    ] = None,
    faults: Faults = None,
    level: Annotated[float | None, typer.Option(help="The level γ to aim at.")] = None,
    backoff: Annotated[
        float | None, typer.Option(help="How far above the optimum to stay, relative; the method's own by default.")
    ] = None,
    pole_bound: Annotated[
        str, typer.Option(help="No pole to the left of minus this, rad/s; 'auto' from the sample time, or 'none'.")
    ] = "auto",
    fix: Annotated[
        list[str] | None,
        typer.Option("--fix", help="Hold an unknown of the theorem, for example beta=3; repeat for several."),
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option("--free", help="Set an unknown free that the method holds, for example K1."),
    ] = None,
    of_all: Annotated[
        bool, typer.Option("--bank", help="A design for each sensor that may fail, to find out which one does.")
    ] = False,
    actuator: Annotated[
        list[str] | None, typer.Option("--actuator", help="With --bank: an input that may fail too; repeatable.")
    ] = None,
    together: Annotated[
        list[str] | None, typer.Option("--together", help="With --bank: faults that may act at once, a+b; repeatable.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find gains, back off, round, prove, and write the design with its certificate.

    Where there is no design, say why, and what would help.  With --bank, do so for every sensor, or those of --fault.
    """
    with guarded(as_json):
        from faultrecon.cli.designing import for_all, make_design
        from faultrecon.io.designfile import target, write_design

        if of_all or actuator or together:
            from faultrecon.cli.monitoring import make_bank
            from faultrecon.cli.shell import stages

            with stages("designing") as tell:
                data, text = make_bank(
                    plant_named(plant),
                    out,
                    faults,
                    actuator or (),
                    together or (),
                    tell,
                    **for_all(
                        "" if method == DEFAULT else method,
                        backoff,
                        _bound(pole_bound),
                        level=level,
                        fix=fix,
                        free=free,
                    ),
                )
            answer(as_json, data, text)
            return

        if out is not None:
            target(out)  # an unsuitable name is refused before the work, not after it
        model = plant_named(plant)
        made, said, chosen = make_design(
            model.with_faults(faults) if faults else model,
            method,
            as_json,
            level=level,
            backoff=backoff,
            pole_bound=_bound(pole_bound),
            fix=_held(fix or []),
            free=tuple(free or ()),
        )
        if out is not None:
            write_design(made, out)
        where = f"\nwrote {out}" if out is not None else "\nnothing written; add --out design.json"
        answer(
            as_json,
            made.as_dict() | said | {"written": None if out is None else str(out)},
            chosen + made.report() + where,
        )


def _held(pairs: list[str]) -> dict[str, float]:
    from faultrecon.finding import InputError

    held = {}
    for pair in pairs:
        name, _, value = pair.partition("=")
        try:
            held[name] = float(value)
        except ValueError:
            raise InputError(f"--fix {pair}", why="it is written letter=number, for example beta=3") from None
    return held


def _bound(text: str) -> float | str | None:
    from faultrecon.finding import InputError

    if text == "auto":
        return text
    if text == "none":
        return None
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--pole-bound is '{text}'", why="it is 'auto', 'none' or a number in rad/s") from None


@app.command()
def verify(
    file: Annotated[str, typer.Argument(help="A design, or a bank of designs (.json).")],
    as_json: Json = False,
) -> None:
    """Prove the certificate of a design file again, or those of a bank, with the standard library alone."""
    with guarded(as_json):
        from faultrecon.cli.verifying import verified

        sound, data, text = verified(file)
        answer(as_json, data, text)
        if not sound:
            raise SystemExit(NEGATIVE)


Checkpoint = Annotated[
    Path | None,
    typer.Option(help="Run the log a piece at a time, and keep in this file where the run stands."),
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint, if it is there.")]
Every = Annotated[float, typer.Option(help="Seconds between checkpoints.")]
Format = Annotated[str, typer.Option("--format", help="Of a stream: json, csv, or auto, by its first line.")]


@app.command()
def run(
    file: Annotated[str, typer.Argument(metavar="DESIGN", help="A design, or a bank of designs (.json).")],
    log: Annotated[str, typer.Argument(help="A recorded log (.csv or .parquet), or - for lines on standard input.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Where to write faults, corrected measurements and flags (.csv, .parquet)."),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(help="Where to draw the reconstruction (.png, .pdf, .svg)."),
    ] = None,
    plant: Annotated[str, typer.Option(help="The plant file the design has to belong to.")] = "",
    hold: Annotated[str, typer.Option(help="Samples in between: left, midpoint or linear.")] = "linear",
    scheme: Annotated[
        str, typer.Option(help="Integration: auto, zoh or rk4; for sliding modes implicit or explicit.")
    ] = "auto",
    sample_time: Annotated[
        float | None,
        typer.Option(help="Seconds; the log's median interval by default."),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option("--column", help="signal=column where names differ; repeat for several."),
    ] = None,
    crest: Annotated[
        float, typer.Option(help="Of a bank: how far disturbances may go beyond their declared size.")
    ] = 3.0,
    false_alarms: Annotated[float, typer.Option(help="Of a bank: per hour, at most, from noise.")] = 0.01,
    policy: Annotated[
        str, typer.Option(help="Of a bank: correct, hold, refuse or pass a sensor that is named.")
    ] = "correct",
    reorder: Annotated[float, typer.Option(help="Of a bank: seconds that rows wait for late ones.")] = 0.0,
    leap: Annotated[
        float, typer.Option(help="Of a bank: seconds by which one time may be ahead of the newest.")
    ] = math.inf,
    window: Annotated[int, typer.Option(help="Of a bank: samples that a statement rests on.")] = 24,
    patience: Annotated[int, typer.Option(help="Of a bank: windows without an explanation before that is said.")] = 8,
    checkpoint: Checkpoint = None,
    resume: Resume = False,
    every: Every = 5.0,
    form: Format = "auto",
    as_json: Json = False,
) -> None:
    """Reconstruct the faults in a recorded log, or in samples as they come, and take them out of the measurements."""
    with guarded(as_json):
        from faultrecon.cli.keeping import Keeping
        from faultrecon.cli.replaying import run_log, run_stdin

        keeping, names = Keeping(checkpoint, resume, every), _mapping(column or [])
        options: dict[str, object] = {"hold": hold, "scheme": scheme, "sample_time": sample_time}
        options |= {"crest": crest, "false_alarms": false_alarms, "policy": policy, "reorder": reorder}
        options |= {"leap": leap, "window": window, "patience": patience}
        belongs = plant_named(plant) if plant else None
        if log == "-":
            run_stdin(file, out or figure, belongs, form, names, options, keeping, as_json)
            return
        with bar("reconstructing") as tell:
            data, text = run_log(file, log, out, figure, belongs, form, names, options, keeping, tell)
        answer(as_json, data, text)


def _mapping(pairs: list[str]) -> dict[str, str]:
    from faultrecon.finding import InputError

    mapping: dict[str, str] = {}
    for pair in pairs:
        name, equals, column = pair.partition("=")
        if not (name and equals and column):
            raise InputError(f"--column {pair}", why="it is written signal=column")
        if mapping.get(name, column) != column:
            raise InputError(f"--column {pair}", why=f"'{name}' has the column '{mapping[name]}' already")
        mapping[name] = column
    return mapping


DEMONSTRATIONS = "Which demonstration: airliner, fighter, which-sensor or activated-sludge."
ALL_SENSORS = "Of which-sensor: a hypothesis for each of the eleven sensors, not only for the three that ever fail."


@app.command()
def demo(
    name: Annotated[str, typer.Argument(help=DEMONSTRATIONS)] = "airliner",
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for figures, corrected log and design.")] = Path(
        "faultrecon-demo"
    ),
    every: Annotated[bool, typer.Option("--every", help=ALL_SENSORS)] = False,
    as_json: Json = False,
) -> None:
    """Reconstruct sensor faults in flights that ship with the package; the fighter's gyro fails inside its loop.

    which-sensor: find out which sensor lies in each of the airliner's flights, without being told.  activated-sludge: a
    probe that loses gain in BSM1, by every method that reconstructs one, and how far the model's mismatch limits them.
    """
    with guarded(as_json):
        from faultrecon.advise.airliner import airliner_demo
        from faultrecon.advise.fighter import fighter_demo
        from faultrecon.advise.fouling_demo import activated_sludge_demo
        from faultrecon.advise.which_sensor import which_sensor_demo
        from faultrecon.finding import InputError, did_you_mean

        known = {"airliner": airliner_demo, "fighter": fighter_demo, "which-sensor": which_sensor_demo}
        known |= {"activated-sludge": activated_sludge_demo}
        if name not in known:
            raise InputError(f"there is no demonstration '{name}'", why=did_you_mean(name, known))
        if every and name != "which-sensor":
            raise InputError(f"{name} has no --every", remedies=("faultrecon demo which-sensor --every",))
        options = {"every": True} if every else {}
        with bar(f"{name} logs") as tell:
            shown = known[name](out, progress=tell, **options)
        answer(as_json, shown.as_dict(), str(shown))


@app.command()
def methods(
    variants: Annotated[bool, typer.Option("--variants", help="List variants of methods too.")] = False,
    as_json: Json = False,
) -> None:
    """List the methods, what they are for, and where they come from."""
    with guarded(as_json):
        from faultrecon.methods.registry import list_methods, method

        found = [method(name) for name in list_methods(variants=variants)]
        rows = [
            {
                "name": m.name,
                "summary": m.summary,
                "baseline": m.baseline,
                "paper": m.paper.key,
                "variant_of": m.variant_of,
            }
            for m in found
        ]
        width = max(len(m.name) for m in found)
        answer(as_json, {"methods": rows}, "\n".join(f"{m.name:{width}}  {m.summary}  [{m.paper.key}]" for m in found))


@app.command()
def cite(name: Annotated[str, typer.Argument(metavar="METHOD")], as_json: Json = False) -> None:
    """Print the reference of a method."""
    with guarded(as_json):
        from faultrecon.methods.registry import method

        paper = method(name).paper
        answer(as_json, {"method": name, **paper.__dict__}, str(paper))


@app.command()
def doctor(as_json: Json = False) -> None:
    """Tell what is installed, and check that the solver, exact integers and files work here."""
    with guarded(as_json):
        from faultrecon.cli.health import examine

        found = examine()
        answer(as_json, found.as_dict(), str(found))
        if not found.fine:
            raise SystemExit(NEGATIVE)


import_module("faultrecon.cli.trying")  # registers its verbs, after these
