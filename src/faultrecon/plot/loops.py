# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a sensor fault inside a control loop: what was reconstructed, and below it what the loop made of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from faultrecon.finding import InputError
from faultrecon.plot import figures as draw

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Course:
    """How one signal went in one flight.  t, values: (N,).  ended: whether a cross marks its last point."""

    label: str
    t: ArrayLike
    values: ArrayLike
    color: str
    dashed: bool = False
    ended: bool = False


@dataclass(frozen=True, eq=False)
class LoopColumn:
    """One fault: its waveform, and the courses of some signals with and without correction.

    t, truth, estimate, band: (N,), s and `unit`; band is the half width about the truth.  below: by name and unit.
    """

    title: str
    t: ArrayLike
    truth: ArrayLike
    estimate: ArrayLike
    band: ArrayLike
    unit: str
    below: Mapping[tuple[str, str], Sequence[Course]]
    remark: str = ""


def loop_figure(columns: Sequence[LoopColumn], *, band_label: str, title: str = "") -> Figure:
    """A column per fault: the fault on top, each to its own scale; below, to one, what the loop did with it.

    Raises InputError without columns, and where they do not show the same signals.
    """
    if not columns or any(list(c.below) != list(columns[0].below) for c in columns):
        raise InputError("there is no figure to draw", why="every column shows the same signals, and one is needed")
    below = list(columns[0].below)
    figure = draw._figure(1.6 + 3.6 * len(columns) + 1.6 * (len(columns) == 1), 1.2 + 1.9 * (1 + len(below)))
    axes = figure.subplots(1 + len(below), len(columns), sharex="col", squeeze=False)
    for j, column in enumerate(columns):
        _fault(axes[0, j], column, band_label)
        for ax, name in zip(axes[1:, j], below, strict=True):
            _courses(ax, column.below[name])
            if j > 0:
                ax.sharey(axes[1 + below.index(name), 0])
        axes[0, j].set_title(column.title, fontsize=10, loc="left", fontweight="bold", pad=3)
        axes[0, j].set_title(column.remark, fontsize=8.5, loc="right", color="#555555", pad=3)
        axes[-1, j].set_xlabel("time [s]")
    for ax, (name, unit) in zip(axes[:, 0], [("fault", columns[0].unit), *below], strict=True):
        ax.set_ylabel(f"{name}\n[{unit}]")
    figure.align_ylabels()
    figure.suptitle(title, fontsize=12, fontweight="bold")
    _legend(figure, list(axes[:, 0]), per_row=4 if len(columns) > 1 else 2)
    return figure


def _legend(figure: Figure, axes: Sequence[Axes], per_row: int) -> None:
    """One legend below the plots, in as many rows as its labels need; every label once."""
    handles = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    names = list(handles)
    figure.legend(handles.values(), names, loc="outside lower center", ncols=per_row, frameon=False, fontsize=9)


def _fault(ax: Axes, column: LoopColumn, band_label: str) -> None:
    t, truth, band = (np.asarray(a, dtype=float) for a in (column.t, column.truth, column.band))
    ax.fill_between(t, truth - band, truth + band, color=draw.ALARM, alpha=0.45, linewidth=0, label=band_label)
    draw._line(ax, t, truth, draw.TRUTH, "true fault", width=2.2)
    draw._line(ax, t, np.asarray(column.estimate, dtype=float), draw.ESTIMATE, "reconstructed fault", width=0.7)
    draw._retrace(ax, t, truth)
    draw._dress(ax, "", "")


def _courses(ax: Axes, courses: Sequence[Course]) -> None:
    for c in courses:
        t, values = np.asarray(c.t, dtype=float), np.asarray(c.values, dtype=float)
        draw._line(ax, t, values, c.color, c.label, width=1.4)
        if c.dashed:
            ax.lines[-1].set_dashes((4, 2))
        if c.ended:
            ax.plot(t[-1], values[-1], "x", color=c.color, markersize=8, markeredgewidth=2.2, clip_on=False)
    draw._dress(ax, "", "")
