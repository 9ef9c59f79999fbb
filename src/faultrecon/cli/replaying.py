# SPDX-License-Identifier: BSD-3-Clause
"""The verb `run`: read a design, replay a log, write what came out."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from faultrecon.finding import InputError
from faultrecon.io.designfile import read_design
from faultrecon.io.logs import write_log
from faultrecon.io.plausibility import doubts, longest_gap
from faultrecon.io.playback import Replay, replay
from faultrecon.io.tables import name_extension
from faultrecon.plant.plant import Plant

FIGURES = (".png", ".pdf", ".svg")


def run_log(
    file: str,
    log: str,
    *,
    out: Path | None,
    figure: Path | None,
    plant: Plant | None,
    mapping: Mapping[str, str],
    options: Mapping[str, Any],
) -> tuple[dict[str, Any], str]:
    """Replay `log` through the design in `file`; returns the summary as data and as text."""
    _check_targets(log, out, figure)
    design = read_design(file, plant)
    done = replay(design, log, mapping=mapping or None, **options)
    if figure is not None:  # drawn first: where that fails, no table is left without its figure
        from faultrecon.advise.demonstration import replay_figure
        from faultrecon.plot.figures import save

        save(replay_figure(done), figure)
    if out is not None:
        write_log(out, done.columns())
    return _data(done, out, figure), _text(done, out, figure)


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
