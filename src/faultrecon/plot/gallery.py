# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of simulated runs: one run, stacked traces, and the gallery of faults that sensors show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError, did_you_mean
from faultrecon.plot import figures as draw

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from faultrecon.simulation.composition import Shape
    from faultrecon.simulation.run import Run
    from faultrecon.simulation.scenario import Scenario
    from faultrecon.synthesis.result import Design

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Trace:
    """One row of a stacked figure: a name, a unit, and lines by label with their colour; the first is drawn first."""

    name: str
    unit: str
    lines: Mapping[str, tuple[ArrayLike, str]]


def traces_figure(t: ArrayLike, rows: Sequence[Trace], *, title: str = "") -> Figure:
    """Signals over a common time, one row each.  t: (N,), s.  Raises InputError without rows."""
    if not rows:
        raise InputError("there is nothing to draw", remedies=("give at least one row",))
    time = np.asarray(t, dtype=float)
    figure = draw._figure(7.2, 1.1 + 1.9 * len(rows))
    axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for ax, row in zip(axes, rows, strict=True):
        for label, (values, color) in row.lines.items():
            truth = color == draw.TRUTH
            draw._line(ax, time, np.asarray(values, dtype=float), color, label, width=2.2 if truth else 1.0)
        for values, color in row.lines.values():
            if color == draw.TRUTH:
                draw._retrace(ax, time, np.asarray(values, dtype=float))
        draw._dress(ax, row.name, row.unit)
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    draw._title_and_legend(figure, title, axes)
    return figure


def powers_figure(x: ArrayLike, lines: Mapping[str, tuple[ArrayLike, str]], *, across: str, up: str) -> Figure:
    """Lines over x (N,) with both scales logarithmic, by label with their colour; across and up name the axes."""
    figure = draw._figure(7.2, 4.6)
    ax = figure.subplots()
    at = np.asarray(x, dtype=float)
    for label, (values, color) in lines.items():
        ax.loglog(
            at, np.asarray(values, dtype=float), color=color, marker="o", markersize=4, linewidth=1.2, label=label
        )
    draw._dress(ax, up, "")
    ax.set_xlabel(across)
    draw._title_and_legend(figure, "", [ax])
    return figure


def run_figure(run: Run, *, title: str | None = None) -> Figure:
    """The faults of a run as they were and as they were found, and the sensors they sit on."""
    plant = run.design.plant
    on = [next((k for k, c in f.on.items() if c), "") for f in plant.faults]
    sensors = all(f.site == "sensor" for f in plant.faults)
    units = dict(
        zip((*plant.signals.y, *plant.signals.u), (*plant.signals.y.units, *plant.signals.u.units), strict=True)
    )
    names = [f.name for f in plant.faults]
    right: dict[str, Any] = {}
    if sensors:
        columns = [plant.signals.y.index(name) for name in on]
        right = {
            "measured": run.y[:, columns],
            "corrected": run.corrected[:, columns],
            "measured_truth": run.truth.healthy[:, columns],
            "sensors": on,
            "sensor_units": [units[name] for name in on],
        }
    about = f"{plant.name}: {run.scenario.name}" if run.scenario.name else plant.name
    return draw.reconstruction_figure(
        run.t,
        names,
        [units[name] for name in on],
        run.f_hat,
        truth=run.f,
        title=about if title is None else title,
        **right,
    )


def gallery_figure(
    runs: Mapping[str, Run], fault: str, *, title: str = "", scale: float = 1.0, unit: str = ""
) -> Figure:
    """One fault in every shape it takes: per run the measurement before and after, and the waveform that was found.

    runs: by the words to put beside each row.  fault: a sensor fault of all of them.  scale, unit: what to draw in,
    the sensor's unit by default.  Raises InputError without runs.
    """
    if not runs:
        raise InputError("there is nothing to draw", remedies=("give at least one run",))
    figure = draw._figure(11.0, 1.2 + 1.45 * len(runs))
    axes = figure.subplots(len(runs), 2, sharex="col", squeeze=False)
    heads = ("", "")
    for (left, right), (words, run) in zip(axes, runs.items(), strict=True):
        plant = run.design.plant
        j = [f.name for f in plant.faults].index(fault)
        sensor = next(k for k, c in plant.faults[j].on.items() if c)
        heads = (f"{sensor.replace('_', ' ')}: measured and corrected", "fault: true and reconstructed")
        i = plant.signals.y.index(sensor)
        unit = unit or plant.signals.y.units[i]
        data = {"measured": run.y, "true": run.truth.healthy, "corrected": run.corrected}
        draw._sensor(left, run.t, {key: scale * table[:, i] for key, table in data.items()})
        draw._fault(right, run.t, {"truth": scale * run.f[:, j], "estimate": scale * run.f_hat[:, j]}, None)
        draw._dress(left, words, unit)
        draw._dress(right, "", "")
        nrmse = run.score()[fault].nrmse
        right.set_title(f"nrmse {nrmse:.3g}", fontsize=8.5, loc="right", color="#555555", pad=3)
    for ax, head in zip(axes[0], heads, strict=True):
        ax.set_title(head, fontsize=10, loc="left", fontweight="bold")
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    figure.align_ylabels()
    draw._title_and_legend(figure, title, axes.ravel())
    return figure


def fault_gallery(
    design: Design, fault: str, *, base: Scenario | None = None, scale: float = 1.0, unit: str = "", title: str = ""
) -> Figure:
    """Every shape of fault on one sensor, simulated with the design and drawn by `gallery_figure`.

    base: what happens besides the fault; by default 60 s in which every input swings by a quarter of its range.  The
    faults begin after a quarter of it, in the declared size of the fault.  Raises InputError on an unknown fault.
    """
    from faultrecon.simulation.run import simulate
    from faultrecon.simulation.scenario import Scenario
    from faultrecon.simulation.shapes import Sine

    plant = design.plant
    found = {f.name: f for f in plant.faults}
    if fault not in found:
        raise InputError(f"there is no fault '{fault}'", why=did_you_mean(fault, found))
    if base is None:
        swing = {
            name: Sine(0.25 * (1.0 if np.isnan(r) else r), 0.5 + 0.1 * k)
            for k, (name, r) in enumerate(zip(plant.signals.u, plant.signals.u.ranges, strict=True))
        }
        base = Scenario(duration=60.0, inputs=swing)
    start, size = 0.25 * base.duration, found[fault].size
    shapes = {words: shape.starting(start) for words, shape in every_fault(size, base.duration).items()}
    runs = {words: simulate(design, base.with_fault(fault, shape)) for words, shape in shapes.items()}
    return gallery_figure(runs, fault, scale=scale, unit=unit, title=title)


def every_fault(size: float, duration: float) -> dict[str, Shape]:
    """One fault of each shape that sensors show, by the words for it, for a scenario of that duration."""
    from faultrecon.simulation.chance import LooseContact, RandomWalk
    from faultrecon.simulation.shapes import Drift, Loss, Ramp, Sine, Spike, Step, Stuck

    return {
        "bias": Step(size),
        "incipient": Ramp(size, 0.3 * duration),
        "drift": Drift(1.5 * size / duration),
        "random walk": RandomWalk(size / np.sqrt(0.5 * duration)),
        "oscillation": Sine(size, 12.0 * np.pi / duration),
        "loose contact": LooseContact(size, 0.08 * duration, 0.06 * duration),
        "spikes": Spike(2 * size, 0.01 * duration)
        + Spike(-size, 0.01 * duration).starting(0.2 * duration)
        + Spike(1.5 * size, 0.01 * duration).starting(0.45 * duration),
        "half the gain lost": Loss(0.5),
        "stuck": Stuck(),
    }
