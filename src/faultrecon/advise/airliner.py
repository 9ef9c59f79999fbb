# SPDX-License-Identifier: BSD-3-Clause
"""The demonstration on an airliner whose sensors drift, shift and weaken: one observer for three faults.

The logs are flights of JSBSim's nonlinear 737.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from faultrecon.advise.demonstration import (
    DEGREES,
    Demonstration,
    Row,
    made_folder,
    replay_figure,
    shipped_log,
    write_results,
)
from faultrecon.io.library import read_library
from faultrecon.io.playback import Replay, replay
from faultrecon.synthesis.pipeline import design

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


def airliner_demo(out: Path, progress: Callable[[float], None] | None = None) -> Demonstration:
    """Design once for three faults, replay the shipped logs, score them, and write figure, corrected log and design.

    out: folder, made if it does not exist.  Raises InputError when it cannot be written.
    """
    out, tell = made_folder(out), progress or (lambda part: None)
    plant = read_library("airliner")
    made, baseline = design(plant, "lipschitz-hinf"), design(plant, "open-loop", certify=False)
    names = [f"{fault}_{air}" for fault in FAULTS for air in AIR]
    rows: list[Row] = []
    pairs: dict[str, tuple[Replay, Replay]] = {}
    for k, name in enumerate(names):
        log = shipped_log("airliner", name, plant)
        pairs[name] = replay(made, log), replay(baseline, log)
        ours, theirs = (p.scores() for p in pairs[name])
        rows += [Row(name, f.name, {"open-loop": theirs[f.name], made.method: ours[f.name]}) for f in plant.faults]
        tell((k + 1) / len(names))
    shown = pairs[SHOWN][0]
    figures = {out / "overview.png": lambda: _overview(pairs), out / f"{SHOWN}.png": lambda: replay_figure(shown)}
    written, note = write_results(out / "design.json", shown, out / f"{SHOWN}_corrected.csv", figures)
    return Demonstration(made, tuple(rows), written, note)


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
