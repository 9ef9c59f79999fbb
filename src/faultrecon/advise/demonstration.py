# SPDX-License-Identifier: BSD-3-Clause
"""The demonstration on recorded data: an airliner whose sensors drift, shift and weaken.

The logs are flights of JSBSim's nonlinear 737 that ship with the package; the design sees the linear plant file and the
recorded inputs and measurements, nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from faultrecon.finding import InputError
from faultrecon.io.designfile import write_design
from faultrecon.io.library import read_library
from faultrecon.io.logs import Log, read_log, write_log
from faultrecon.io.playback import Replay, replay
from faultrecon.simulation.metrics import FaultScore
from faultrecon.synthesis.pipeline import design
from faultrecon.synthesis.result import Design

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FAULTS = {
    "pitch_rate": "pitch-rate gyro drifts",
    "pitch_angle": "pitch-angle sensor gets a bias",
    "roll_rate": "roll-rate gyro loses effectiveness",
    "all_three": "all three at once",
    "healthy": "all sensors healthy",
}
AIR = ("calm", "gust")
SHOWN = "pitch_rate_calm"
DEGREES = 180.0 / np.pi


@dataclass(frozen=True)
class Row:
    """One fault in one log: scores of the design and of the open loop (no correction scores 1 by definition)."""

    log: str
    fault: str
    design: FaultScore
    open_loop: FaultScore


@dataclass(frozen=True, eq=False)
class Demonstration:
    """What the demonstration found and wrote."""

    design: Design
    rows: tuple[Row, ...]
    written: tuple[Path, ...]
    note: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        rows = [
            {"log": r.log, "fault": r.fault, "lipschitz-hinf": r.design.as_dict(), "open-loop": r.open_loop.as_dict()}
            for r in self.rows
        ]
        written = [str(p) for p in self.written]
        return {"design": self.design.as_dict(), "rows": rows, "written": written, "note": self.note}

    def __str__(self) -> str:
        lines = [self.design.report(), "", *_table(self.rows), ""]
        lines += [f"wrote {path}" for path in self.written]
        return "\n".join([*lines, self.note] if self.note else lines)


def airliner_demo(out: Path, progress: Callable[[float], None] | None = None) -> Demonstration:
    """Design once for three faults, replay the shipped logs, score them, and write figure, corrected log and design.

    out: folder, made if it does not exist.  Raises InputError when it cannot be written.
    """
    tell = progress or (lambda part: None)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be made a folder", why=str(error.strerror or error)) from error
    plant = read_library("airliner")
    made, baseline = design(plant, "lipschitz-hinf"), design(plant, "open-loop", certify=False)
    names = [f"{fault}_{air}" for fault in FAULTS for air in AIR]
    rows: list[Row] = []
    pairs: dict[str, tuple[Replay, Replay]] = {}
    for k, name in enumerate(names):
        log = _shipped(name, made)
        pairs[name] = replay(made, log), replay(baseline, log)
        ours, theirs = (p.scores() for p in pairs[name])
        rows += [Row(name, f.name, ours[f.name], theirs[f.name]) for f in plant.faults]
        tell((k + 1) / len(names))
    written = [out / "design.json", out / f"{SHOWN}_corrected.csv"]
    write_design(made, written[0])
    write_log(written[1], pairs[SHOWN][0].columns())
    note = _draw(pairs, out, written)
    return Demonstration(made, tuple(rows), tuple(written), note)


def _shipped(name: str, made: Design) -> Log:
    with as_file(files("faultrecon") / "data" / "airliner" / f"{name}.parquet") as path:
        return read_log(path, made.plant.signals)


def _draw(pairs: dict[str, tuple[Replay, Replay]], out: Path, written: list[Path]) -> str:
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        return 'no figure: matplotlib is not installed (pip install "faultrecon[plot]")'
    from faultrecon.plot.figures import save

    for name, figure in (("overview.png", _overview(pairs)), (f"{SHOWN}.png", replay_figure(pairs[SHOWN][0]))):
        save(figure, out / name)
        written.append(out / name)
    return ""


def _overview(pairs: dict[str, tuple[Replay, Replay]]) -> Figure:
    from faultrecon.plot.figures import Panel, overview_figure

    panels = []
    for fault in ("pitch_rate", "pitch_angle", "roll_rate"):
        for air, label in (("calm", "calm air"), ("gust", "gusts")):
            ours, theirs = pairs[f"{fault}_{air}"]
            j = [f.name for f in ours.design.plant.faults].index(fault)
            truth = ours.truth(fault)
            assert truth is not None, "the shipped logs carry their true faults"
            panels.append(
                Panel(
                    FAULTS[fault],
                    label,
                    ours.log.t,
                    DEGREES * truth,
                    DEGREES * ours.trace.fault[:, j],
                    DEGREES * theirs.trace.fault[:, j],
                    ours.scores()[fault].nrmse,
                    "deg" if fault == "pitch_angle" else "deg/s",
                )
            )
    return overview_figure(panels, title="Airliner sensor faults, reconstructed from recorded flights")


def replay_figure(done: Replay) -> Figure:
    """The faults and the sensors they sit on, before and after correction; with the truth where the log carries it."""
    from faultrecon.plot.figures import reconstruction_figure

    plant, log = done.design.plant, done.log
    columns = [plant.signals.y.index(next(iter(f.on))) for f in plant.faults]
    truths = [done.truth(f.name) for f in plant.faults]
    truth = np.column_stack([t for t in truths if t is not None]) if all(t is not None for t in truths) else None
    sensors = [plant.signals.y.names[c] for c in columns]
    units = [plant.signals.y.units[c] for c in columns]
    return reconstruction_figure(
        log.t,
        [f.name for f in plant.faults],
        units,
        done.trace.fault,
        truth=truth,
        measured=log.y[:, columns],
        corrected=done.trace.corrected[:, columns],
        sensors=sensors,
        sensor_units=units,
        title=f"{plant.name}: {Path(log.source).name}",
    )


def _table(rows: tuple[Row, ...]) -> list[str]:
    """Scores as text: faults that act first, then what leaks into faults that do not."""
    head = f"{'log':20} {'fault':12} {'none':>5} {'open-loop':>10} {'lipschitz-hinf':>15} {'delay':>7} {'leak':>8}"
    lines = [
        "nrmse per log and fault (0 is perfect, 1 is no correction), delay in s, leak before the fault in °, °/s",
        head,
    ]
    for r in rows:
        if np.isfinite(r.design.nrmse):
            lines.append(
                f"{r.log:20} {r.fault:12} {1.0:5.2f} {r.open_loop.nrmse:10.3f} {r.design.nrmse:15.3f}"
                f" {r.design.delay:7.2f} {DEGREES * r.design.leak:8.3f}"
            )
    lines += ["", "RMS of the estimate where that fault never acts, in ° or °/s"]
    lines.append(f"{'log':20} {'fault':12} {'open-loop':>16} {'lipschitz-hinf':>15}")
    for r in rows:
        if not np.isfinite(r.design.nrmse):
            lines.append(f"{r.log:20} {r.fault:12} {DEGREES * r.open_loop.leak:16.3f} {DEGREES * r.design.leak:15.3f}")
    return lines
