# SPDX-License-Identifier: BSD-3-Clause
"""The verb `run`: read a design, replay a log, write what came out.

A log is read whole, unless a checkpoint is asked for or its file is large: then it is run a piece at a time, with the
same output, and without what needs the whole of it: a figure, scores, and doubts about the faults that were found.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from faultrecon.cli.keeping import Keeping, large, plain, run_pieces, watched
from faultrecon.cli.monitoring import bank_stream, run_bank
from faultrecon.finding import InputError
from faultrecon.io.bankfile import is_bank
from faultrecon.io.designfile import read_design
from faultrecon.io.logs import write_log
from faultrecon.io.plausibility import GAP, Gap, doubts, longest_gap, unit_doubts_of
from faultrecon.io.playback import Replay, replay
from faultrecon.io.running import Ran, reconstruction
from faultrecon.io.tables import name_extension
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.result import Design

FIGURES = (".png", ".pdf", ".svg")


def run_log(
    file: str,
    log: str,
    out: Path | None,
    figure: Path | None,
    plant: Plant | None,
    form: str,
    mapping: Mapping[str, str],
    options: Mapping[str, Any],
    keeping: Keeping,
    progress: Callable[[float], None],
) -> tuple[dict[str, Any], str]:
    """Replay `log` through the design in `file`; returns the summary as data and as text.

    options: sample_time, hold and scheme; for a bank, those of `Bank.monitor` instead of scheme.
    """
    _check_targets(log, out, figure)
    if form != "auto":
        raise InputError(f"--format {form} with a file", why="the extension of a file says what it is")
    if keeping.checkpoint is not None and figure is not None:
        raise InputError(
            "--figure with --checkpoint",
            why="a figure needs the whole log, a checkpoint is for one that is run a piece at a time",
            remedies=("leave one of them out",),
        )
    if is_bank(file):
        return run_bank(file, log, out, figure, plant, mapping, watched(options), keeping, progress)
    options = plain(options)
    design = read_design(file, plant)
    if keeping.checkpoint is not None or (figure is None and large(log)):
        return _in_pieces(design, log, out, mapping, options, keeping, progress)
    done = replay(design, log, mapping=mapping or None, progress=progress, **options)
    if figure is not None:  # drawn first: where that fails, no table is left without its figure
        from faultrecon.advise.demonstration import replay_figure
        from faultrecon.plot.figures import save

        save(replay_figure(done), figure)
    if out is not None:
        write_log(out, done.columns())
    return _data(done, out, figure), _text(done, out, figure)


def run_stdin(
    file: str,
    target: Path | None,
    plant: Plant | None,
    form: str,
    mapping: Mapping[str, str],
    options: Mapping[str, Any],
    keeping: Keeping,
    as_json: bool,
) -> None:
    """Answer standard input line by line on standard output; the summary goes to the error stream."""
    from faultrecon.cli.shell import json_text
    from faultrecon.cli.streaming import listen

    if target is not None:
        raise InputError(
            f"{target} with a stream", why="answers go to standard output as they come", remedies=(f"write > {target}",)
        )
    if is_bank(file):
        make, signals = bank_stream(file, plant, watched(options))
    else:
        design = read_design(file, plant)
        make, signals = reconstruction(design, **plain(options)), design.plant.signals
    data, text = listen(
        make,
        signals,
        form=form,
        mapping=mapping,
        checkpoint=None if keeping.checkpoint is None else str(keeping.checkpoint),
        resume=keeping.resume,
        every=keeping.every,
    )
    print(json_text(data) if as_json else f"faultrecon: {text}", file=sys.stderr)


def _in_pieces(
    design: Design,
    log: str,
    out: Path | None,
    mapping: Mapping[str, str],
    options: Mapping[str, Any],
    keeping: Keeping,
    progress: Callable[[float], None],
) -> tuple[dict[str, Any], str]:
    make = reconstruction(design, **options)
    done = run_pieces(make, design.plant.signals, log, out, mapping, keeping, progress)
    data = _data_of_pieces(design, done, out)
    return data, _text_of_pieces(design, log, done, data)


def _data_of_pieces(design: Design, done: Ran, out: Path | None) -> dict[str, Any]:
    tally, interval, verified = done.tally, done.survey.interval, design.verification
    gap = None
    if interval is not None and tally.longest > GAP * interval:
        gap = Gap(tally.longest, tally.longest / interval, tally.longest_at).as_dict()
    names = [f.name for f in design.plant.faults]
    return {
        "samples": tally.rows,
        "seconds": tally.last - tally.first,
        "longest_interval": gap,
        "notes": list(unit_doubts_of(design.plant, interval, done.survey.spans)),
        "missing": dict(tally.missing),
        "flagged_samples": tally.flagged,
        "verdict": None if verified is None else verified.verdict,
        "faults": {n: {"rms": tally.rms(f"f_{n}"), "largest": tally.greatest(f"f_{n}")} for n in names},
        "written": None if out is None else str(out),
        "resumed_at": done.resumed_at,
        **done.chosen,
    }


def _text_of_pieces(design: Design, log: str, done: Ran, data: Mapping[str, Any]) -> str:
    lines = [f"{log}: {data['samples']} samples over {data['seconds']:g} s, a piece at a time"]
    if done.resumed_at:
        lines.append(f"  went on at row {done.resumed_at + 1}")
    if data["longest_interval"] is not None:
        lines.append(f"  {Gap(**data['longest_interval'])}")
    if data["missing"]:
        lines.append("  missing values: " + ", ".join(f"{k} {v}" for k, v in data["missing"].items()))
    lines.append(f"  samples with a flagged channel: {data['flagged_samples']}")
    units = dict(zip(design.plant.signals.y.names, design.plant.signals.y.units, strict=True))
    for f in design.plant.faults:
        unit, found = units.get(next(iter(f.on)), ""), data["faults"][f.name]
        lines.append(f"  {f.name}: RMS {found['rms']:.4g} {unit}, largest {found['largest']:.4g} {unit}")
    if data["verdict"] is None:
        lines.append("  this design carries no certificate; nothing is claimed")
    lines += [f"  note: {note}" for note in data["notes"]]
    lines += [f"  wrote {data['written']}"] if data["written"] else []
    return "\n".join(lines)


def _check_targets(log: str, out: Path | None, figure: Path | None) -> None:
    """Unsuitable places are refused before the work, not after it; a recording is never written over."""
    if out is not None:
        name_extension(str(out))
        if os.path.exists(out) and os.path.exists(log) and os.path.samefile(out, log):
            raise InputError(f"{out}: is the recording itself", remedies=("write to another file",))
    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise InputError(f"{figure}: unknown kind of figure", remedies=(f"use {', '.join(FIGURES)}",))
    for path in (p for p in (out, figure) if p is not None):
        if os.path.isdir(path) or not os.path.isdir(path.parent):
            why = "it is a folder" if os.path.isdir(path) else f"the folder {path.parent} does not exist"
            raise InputError(f"cannot write {path}", why=why)


def _data(done: Replay, out: Path | None, figure: Path | None) -> dict[str, Any]:
    scores, verified, gap = done.scores(), done.design.verification, longest_gap(done)
    faults = {}
    for j, f in enumerate(done.design.plant.faults):
        values = done.trace.fault[:, j]
        faults[f.name] = {"rms": _rms(values), "largest": _largest(values)}
        if f.name in scores:
            faults[f.name]["score"] = scores[f.name].as_dict()
    return {
        "samples": len(done.log),
        "seconds": float(done.log.t[-1] - done.log.t[0]),
        "longest_interval": None if gap is None else gap.as_dict(),
        "notes": list(doubts(done)),
        "missing": dict(done.log.missing),
        "ignored_columns": list(done.log.ignored),
        "flagged_samples": int(np.sum(~done.trace.ok.all(axis=1))),
        "verdict": None if verified is None else verified.verdict,
        "faults": faults,
        "written": None if out is None else str(out),
        "figure": None if figure is None else str(figure),
    }


def _rms(values: np.ndarray) -> float:
    top = _largest(values)
    finite = values[np.isfinite(values)]
    return float(top * np.sqrt(np.mean(np.square(finite / top)))) if top > 0 else top  # scaled: squares may overflow


def _largest(values: np.ndarray) -> float:
    """The largest size of a number that is known; nan when none is."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else float("nan")


def _score(s: Mapping[str, float], unit: str) -> str:
    if np.isnan(s["nrmse"]):
        return f"it never acts; leak {s['leak']:.4g} {unit}"
    delay = f"delay {s['delay']:.3g} s" if np.isfinite(s["delay"]) else "never within 37 %"
    return f"nrmse {s['nrmse']:.3f}, {delay}"


def _text(done: Replay, out: Path | None, figure: Path | None) -> str:
    data = _data(done, out, figure)
    lines = [f"{done.log.source}: {data['samples']} samples over {data['seconds']:g} s"]
    if (gap := longest_gap(done)) is not None:
        lines.append(f"  {gap}")
    if data["missing"]:
        lines.append("  missing values: " + ", ".join(f"{k} {v}" for k, v in data["missing"].items()))
    if data["ignored_columns"]:
        lines.append("  columns without numbers, ignored: " + ", ".join(data["ignored_columns"]))
    lines.append(f"  samples with a flagged channel: {data['flagged_samples']}")
    units = dict(zip(done.design.plant.signals.y.names, done.design.plant.signals.y.units, strict=True))
    for f in done.design.plant.faults:
        never = [name for name in f.on if data["missing"].get(name) == data["samples"]]
        if never and np.isnan(data["faults"][f.name]["rms"]):
            lines.append(f"  {f.name}: {' and '.join(never)} was never measured, its fault cannot be read")
            continue
        unit, found = units.get(next(iter(f.on)), ""), data["faults"][f.name]
        lines.append(f"  {f.name}: RMS {found['rms']:.4g} {unit}, largest {found['largest']:.4g} {unit}")
        if "score" in found:
            lines.append(f"    against the recorded truth: {_score(found['score'], unit)}")
    if data["verdict"] is None:
        lines.append("  this design carries no certificate; nothing is claimed")
    lines += [f"  note: {note}" for note in data["notes"]]
    lines += [f"  wrote {path}" for path in (out, figure) if path is not None]
    return "\n".join(lines)
