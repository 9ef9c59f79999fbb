# SPDX-License-Identifier: BSD-3-Clause
"""The demonstration on an activated-sludge plant: an ammonium probe that fouls, in a plant that the model simplifies.

The log is a fortnight of BSM1; the designs see two of its states, and what that costs is in the table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from faultrecon.advise.activated_sludge import FAULT, MODEL, TANKS, Case, Fouling, accepted, fouling
from faultrecon.advise.demonstration import made_folder, write_results
from faultrecon.io.logs import write_log
from faultrecon.io.playback import Replay, replay
from faultrecon.synthesis.pipeline import design

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = "ts-guaranteed-cost"
WHERE = {"first_tank": "first aerated tank", "last_tank": "last tank, short of oxygen"}
CLIPPED = 0.9
"""Lost gain beyond which the figure is cut off: the model alone leaves it where its ammonium nearly vanishes."""


def activated_sludge_demo(
    out: Path, progress: Callable[[float], None] | None = None, methods: Sequence[str] | None = None
) -> Fouling:
    """Every method that accepts the plants, judged; table, figure, corrected logs and designs written to a folder.

    methods: names; those of the figure are judged in any case.  Raises InputError when the folder cannot be written.
    """
    out, tell = made_folder(out), progress or (lambda part: None)
    methods = None if methods is None else list(dict.fromkeys([*methods, MODEL, SHOWN]))
    work = sum(len(methods or accepted(Case.of(tank).plant)) for tank in TANKS)
    done = [0]

    def one_more(_: str) -> None:
        tell(done[0] / work)
        done[0] += 1

    found = fouling(methods=methods, progress=one_more)
    runs = {tank: _shown(tank) for tank in TANKS}
    written = [_written_table(found, out / "table.csv")]
    note = ""
    for tank, (shown, _) in runs.items():
        last = tank == TANKS[-1]
        figures = {out / "fouling.png": lambda: fouling_figure(runs, found)} if last else {}
        paths, note = write_results(out / f"{tank}_design.json", shown, out / f"{tank}_corrected.csv", figures)
        written += paths
    tell(1.0)
    return replace(found, written=tuple(written), note=note)


def _shown(tank: str) -> tuple[Replay, Replay]:
    """The log of one tank through the design on show, and through the model alone."""
    case = Case.of(tank)
    made, model = design(case.plant, SHOWN), design(case.plant, MODEL, certify=False)
    return replay(made, case.log), replay(model, case.log)


def _written_table(found: Fouling, path: Path) -> Path:
    columns: dict[str, list[str] | list[float]] = {
        "tank": [f.tank for f in found.found],
        "method": [f.method for f in found.found],
        "rmse": [f.rmse for f in found.found],
        "rmse_in_box": [f.within for f in found.found],
        "bias": [f.bias for f in found.found],
        "leak": [f.leak for f in found.found],
    }
    for part in ("total", "parameters", "lag", "noise", "missed"):
        name = "expected" if part == "total" else f"expected_{part}"
        columns[name] = [getattr(f.budget, part) / found.size for f in found.found]
    columns["certificate"] = [f.verdict for f in found.found]
    write_log(path, columns)
    return path


def fouling_figure(runs: dict[str, tuple[Replay, Replay]], found: Fouling) -> Figure:
    """For each tank the lost gain, true and found, and what the probe showed before and after correction."""
    from faultrecon.plot.figures import reconstruction_figure

    tanks = list(runs)
    designs, models = [runs[t][0] for t in tanks], [runs[t][1] for t in tanks]
    assert all(np.array_equal(r.log.t, designs[0].log.t) for r in designs), "the shipped logs share their times"

    def side_by_side(columns: list[np.ndarray]) -> np.ndarray:
        return np.column_stack(columns)

    figure = reconstruction_figure(
        designs[0].log.t / 24.0,
        [f"lost gain, {WHERE[t]}" for t in tanks],
        [""] * len(tanks),
        side_by_side([r.trace.fault[:, 0] for r in designs]),
        truth=side_by_side([r.log.extra[f"true_f_{FAULT}"] for r in designs]),
        measured=side_by_side([r.log.y[:, 0] for r in designs]),
        corrected=side_by_side([r.trace.corrected[:, 0] for r in designs]),
        measured_truth=side_by_side([r.log.extra["true_x_substrate"] for r in designs]),
        sensors=["ammonium"] * len(tanks),
        sensor_units=["g/m3"] * len(tanks),
        title="A fouling ammonium probe in BSM1, reconstructed with a model of two states",
    )
    for k, (tank, model) in enumerate(zip(tanks, models, strict=True)):
        ax = figure.axes[2 * k]
        ours, theirs = (100 * found.of(tank, name).rmse for name in (SHOWN, MODEL))
        _with_model(ax, model, f"RMSE {ours:.1f} % of the fault; grey: the model alone, {theirs:.1f} %")
    for ax in figure.axes[-2:]:
        ax.set_xlabel("time [days]")
    return figure


def _with_model(ax: Axes, model: Replay, title: str) -> None:
    from faultrecon.plot.figures import PLAIN

    ax.plot(model.log.t / 24.0, model.trace.fault[:, 0], color=PLAIN, linewidth=0.8, zorder=1)
    ax.set_ylim(-CLIPPED, CLIPPED)
    ax.set_title(title, fontsize=8.5, loc="right", color="#555555", pad=3)
