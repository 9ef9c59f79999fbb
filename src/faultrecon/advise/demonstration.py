# SPDX-License-Identifier: BSD-3-Clause
"""What the demonstrations on recorded flights share: the shipped logs, the table of scores, and the files they write.

The logs are flights of JSBSim's nonlinear aircraft that ship with the package; a design sees the linear plant file and
the recorded inputs and measurements, nothing else.  Each demonstration is a file of its own: `airliner`, `fighter`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from faultrecon.finding import InputError
from faultrecon.io.designfile import write_design
from faultrecon.io.logs import Log, read_log, write_log
from faultrecon.io.playback import Replay
from faultrecon.plant.plant import Plant
from faultrecon.simulation.metrics import FaultScore
from faultrecon.synthesis.result import Design

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEGREES = 180.0 / np.pi


@dataclass(frozen=True)
class Row:
    """One fault in one log: scores by method, baselines first (no correction scores 1 by definition)."""

    log: str
    fault: str
    scores: Mapping[str, FaultScore]

    def __getitem__(self, method: str) -> FaultScore:
        return self.scores[method]

    @property
    def acts(self) -> bool:
        """Whether the fault ever acts in this log."""
        return any(np.isfinite(s.nrmse) for s in self.scores.values())

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {"log": self.log, "fault": self.fault, **{name: s.as_dict() for name, s in self.scores.items()}}


@dataclass(frozen=True, eq=False)
class Demonstration:
    """What a demonstration found and wrote.

    lines: what the text says beyond design and scores.  found: the same as plain values for `--json`.
    """

    design: Design
    rows: tuple[Row, ...]
    written: tuple[Path, ...]
    note: str = ""
    lines: tuple[str, ...] = ()
    found: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        rows, written = [r.as_dict() for r in self.rows], [str(p) for p in self.written]
        return {"design": self.design.as_dict(), "rows": rows, **self.found, "written": written, "note": self.note}

    def __str__(self) -> str:
        lines = [self.design.report(), "", *score_table(self.rows), ""]
        lines += [*self.lines, ""] if self.lines else []
        lines += [f"wrote {path}" for path in self.written]
        return "\n".join([*lines, self.note] if self.note else lines)


def made_folder(out: Path) -> Path:
    """The folder, made if it does not exist.  Raises InputError when it cannot be."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be made a folder", why=str(error.strerror or error)) from error
    return out


def shipped_log(folder: str, name: str, plant: Plant) -> Log:
    """A flight that ships with the package."""
    with as_file(files("faultrecon") / "data" / folder / f"{name}.parquet") as path:
        return read_log(path, plant.signals)


def write_results(
    design_path: Path, shown: Replay, corrected_path: Path, figures: Mapping[Path, Callable[[], Figure]]
) -> tuple[tuple[Path, ...], str]:
    """Write design, corrected log and, where matplotlib is, the figures; what was written, and a note if none was."""
    from importlib.util import find_spec

    write_design(shown.design, design_path)
    write_log(corrected_path, shown.columns())
    written = (design_path, corrected_path)
    if find_spec("matplotlib") is None:
        return written, 'no figure: matplotlib is not installed (pip install "faultrecon[plot]")'
    from faultrecon.plot.figures import save

    return (*written, *(save(draw(), path) for path, draw in figures.items())), ""


def score_table(rows: Sequence[Row]) -> list[str]:
    """Scores as text: faults that act first, then what leaks into faults that do not.

    Delay and leak are those of the last method, the one on show.
    """
    names = list(rows[0].scores)
    widths = [max(9, len(name)) + 1 for name in names]
    head = " ".join(f"{name:>{width}}" for name, width in zip(names, widths, strict=True))
    lines = [
        "nrmse per log and fault (0 is perfect, 1 is no correction), delay in s, leak before the fault in °, °/s",
        f"{'log':20} {'fault':12} {'none':>5} {head} {'delay':>7} {'leak':>8}",
    ]
    for r in (r for r in rows if r.acts):
        values = " ".join(f"{r[name].nrmse:{width}.3f}" for name, width in zip(names, widths, strict=True))
        last = r[names[-1]]
        lines.append(f"{r.log:20} {r.fault:12} {1.0:5.2f} {values} {last.delay:7.2f} {DEGREES * last.leak:8.3f}")
    lines += ["", "RMS of the estimate where that fault never acts, in ° or °/s"]
    lines.append(f"{'log':20} {'fault':12} {'':5} {head}")
    for r in (r for r in rows if not r.acts):
        values = " ".join(f"{DEGREES * r[name].leak:{width}.3f}" for name, width in zip(names, widths, strict=True))
        lines.append(f"{r.log:20} {r.fault:12} {'':5} {values}")
    return lines


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
