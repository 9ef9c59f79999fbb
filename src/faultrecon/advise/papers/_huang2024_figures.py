# SPDX-License-Identifier: BSD-3-Clause
"""Pictures for Huang, Gao, Liu 2024: states and fault of both plants, and the errors of both schemes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.advise.papers._huang2024_designs import certified, printed_augmented, printed_observer
from faultrecon.advise.papers._huang2024_runs import SEGMENTS, Log, estimates, log_of, until
from faultrecon.graph.observer import Observer
from faultrecon.plot.figures import ALARM, CORRECTED, ESTIMATE, PLAIN, TRUTH, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[Any]

EVERY = 20
"""Samples between two points of a line: 10 ms."""
AIRCRAFT_STATES = ("pitch rate x1", "air speed x2", "angle of attack x3", "pitch angle x4")
ROBOT_STATES = ("motor angle x1", "motor speed x2", "link angle x3", "link speed x4, a tenth")


def draw(out: Path) -> tuple[Path, ...]:
    """The five figures as PNG files."""
    aircraft, robot = log_of("aircraft"), log_of("robot")
    by_adaptive = printed_observer("robot")
    of_aircraft = {
        "ρ = 30, certified": (certified("aircraft", "adaptive", 30.0).observer, ALARM),
        "ρ = 100, certified": (certified("aircraft", "adaptive", 100.0).observer, CORRECTED),
        "printed gains, 2.6e6 rad/s": (printed_observer("aircraft"), ESTIMATE),
    }
    printed = {
        "augmented, printed gains": (printed_augmented(), ALARM),
        "adaptive, printed gains": (by_adaptive, ESTIMATE),
    }
    retuned = {
        f"{scheme}, ρ = {rho}, certified": (certified("robot", scheme, float(rho)).observer, colour)
        for scheme, rho, colour in (
            ("augmented", 30, ALARM),
            ("augmented", 100, PLAIN),
            ("adaptive", 30, CORRECTED),
            ("adaptive", 100, ESTIMATE),
        )
    }
    made = (
        states(until(aircraft, 20.0), of_aircraft, AIRCRAFT_STATES, "Aircraft: states and estimates (figures 1 to 4)"),
        fault(aircraft, of_aircraft, {}, "Aircraft: sensor fault, estimates and their errors (figure 5)"),
        states(robot, printed, ROBOT_STATES, "Robot: states and estimates with the printed gains (figures 6 to 9)"),
        fault(robot, printed, SEGMENTS, "Robot: sensor fault with the printed gains of both schemes (figure 10)"),
        fault(robot, retuned, SEGMENTS, "Robot: the same with gains of ours under one bound on the poles"),
    )
    return tuple(save(figure, out / f"figure_{k}.png", dpi=100) for k, figure in enumerate(made, 1))


Observers = dict[str, tuple[Observer, str]]


def states(log: Log, observers: Observers, names: tuple[str, ...], title: str) -> Figure:
    """Left the states and their estimates, right the errors."""
    figure, axes = _grid(len(names), 2, 11.0, 8.0)
    t = log.t[::EVERY]
    for name, (observer, colour) in observers.items():
        found = estimates(observer, log)[1][::EVERY]
        for k in range(len(names)):
            axes[k, 0].plot(t, found[:, k], color=colour, linewidth=2.0, label=name)
            axes[k, 1].plot(t, found[:, k] - log.x[::EVERY, k], color=colour, linewidth=0.9)
    for k, name in enumerate(names):
        axes[k, 0].plot(t, log.x[::EVERY, k], color=TRUTH, linewidth=0.8, dashes=(4, 3), label="true state")
        low, high = float(log.x[:, k].min()), float(log.x[:, k].max())
        axes[k, 0].set_ylim(low - 0.2 * (high - low), high + 0.2 * (high - low))
        axes[k, 0].set_ylabel(name)
        _clipped(axes[k, 1], t, 2.0)
    axes[0, 1].set_title("estimate - true", fontsize=10, loc="left")
    return _finished(figure, axes, title)


def fault(log: Log, observers: Observers, segments: dict[str, tuple[float, float]], title: str) -> Figure:
    """Above the fault and its estimates, below the size of the errors on a logarithmic scale."""
    figure, axes = _grid(2, 1, 11.0, 6.4)
    above, below = axes[:, 0]
    t, f = log.t[::EVERY], log.f[::EVERY]
    for name, (observer, colour) in observers.items():
        found = estimates(observer, log)[0][::EVERY]
        above.plot(t, found, color=colour, linewidth=1.6, label=name)
        below.plot(t, np.maximum(np.abs(found - f), 1e-6), color=colour, linewidth=0.8)
    above.plot(t, f, color=TRUTH, linewidth=0.9, dashes=(4, 3), label="true fault")
    above.set_ylabel("fault")
    size = float(np.abs(f).max())
    above.set_ylim(-1.35 * size, 1.35 * size)
    below.set_yscale("log")
    below.set_ylim(1e-5, 10.0)
    below.set_ylabel("|estimate - fault|")
    for name, (start, end) in segments.items():
        above.text(0.5 * (start + end), 1.2 * size, name, ha="center", va="center", fontsize=9, color="#555555")
        for ax in axes[:, 0]:
            ax.axvline(end, color="#bbbbbb", linewidth=0.7)
    return _finished(figure, axes, title)


def _clipped(ax: Axes, t: Array, since: float) -> None:
    """The scale of what is left after the start."""
    largest = max(float(np.abs(np.asarray(line.get_ydata())[t >= since]).max()) for line in ax.get_lines())
    ax.set_ylim(-1.1 * largest, 1.1 * largest)


def _grid(rows: int, columns: int, width: float, height: float) -> tuple[Figure, Any]:
    from faultrecon.plot.figures import _figure

    figure = _figure(width, height)
    return figure, figure.subplots(rows, columns, sharex=True, squeeze=False)


def _finished(figure: Figure, axes: Any, title: str) -> Figure:
    from faultrecon.plot.figures import _title_and_legend

    for ax in axes.ravel():
        ax.grid(True, color="#e4e4e4", linewidth=0.7)
        ax.set_axisbelow(True)
        ax.margins(x=0.0)
        ax.tick_params(color="#888888", labelsize=9)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    figure.align_ylabels()
    _title_and_legend(figure, title, axes.ravel())
    return figure
