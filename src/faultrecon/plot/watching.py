# SPDX-License-Identifier: BSD-3-Clause
"""What a monitor said over a log: every fault with its bound, and below them the mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.plot import figures as draw

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHADES = {"suspect": "#f6e3b5", "fault": "#f4b9b0", "recovering": "#cfe6d4", "out_of_envelope": "#d9c3e6"}


def watched_figure(
    table: Mapping[str, NDArray[Any]],
    faults: Sequence[str],
    units: Sequence[str],
    *,
    truth: Mapping[str, NDArray[Any]] | None = None,
    title: str = "",
) -> Figure:
    """One row per fault: its reconstruction, what its bound leaves open, and the truth where there is one.

    table: the columns of a monitor; faults, units: those to show.  The background says what the monitor said, and where
    it named this fault.  Raises InputError without rows or faults.
    """
    t = table["t"]
    if not len(t) or not faults:
        raise InputError("there is nothing to draw", why=f"{len(t)} samples, {len(faults)} faults")
    figure = draw._figure(8.4, 1.2 + 1.7 * len(faults))
    axes = figure.subplots(len(faults), 1, sharex=True, squeeze=False)[:, 0]
    for ax, name, unit in zip(axes, faults, units, strict=True):
        for mode, a, b in stretches(t, table["mode"]):
            if mode in SHADES:
                ax.axvspan(a, b, color=SHADES[mode], lw=0)
        value, bound = table[f"f_{name}"], table[f"f_{name}_bound"]
        thin = slice(None, None, max(1, len(t) // draw.POINTS))
        low, high = value - bound, value + bound
        ax.fill_between(t[thin], low[thin], high[thin], color=draw.ESTIMATE, alpha=0.18, lw=0, label="within its bound")
        ax.plot(t[thin], value[thin], color=draw.ESTIMATE, lw=1.1, label="reconstructed")
        if truth is not None and name in truth:
            ax.plot(t[thin], truth[name][thin], color=draw.TRUTH, lw=1.2, ls="--", label="true")
        settled = np.isfinite(bound) & (bound < 4.0 * np.median(bound))
        reach = np.nanmax(np.abs(np.where(settled, np.abs(value) + bound, np.nan)), initial=0.0)
        if reach > 0:
            ax.set_ylim(-1.1 * reach, 1.1 * reach)
        said = "  named" if np.any(table["fault"] == name) else ""
        ax.set_title(name + said, fontsize=9.5, loc="left", fontweight="bold" if said else "normal", pad=3)
        ax.set_ylabel(unit, fontsize=8.5)
        ax.margins(x=0)
    axes[-1].set_xlabel("time [s]")
    _legend(axes[0], figure, title)
    return figure


def stretches(t: NDArray[Any], mode: NDArray[Any]) -> list[tuple[str, float, float]]:
    """The modes one after the other, each with its first and its last time."""
    edges = np.flatnonzero(mode[1:] != mode[:-1]) + 1
    starts, ends = [0, *edges.tolist()], [*edges.tolist(), len(t) - 1]
    return [(str(mode[a]), float(t[a]), float(t[b])) for a, b in zip(starts, ends, strict=True)]


def _legend(ax: Any, figure: Figure, title: str) -> None:
    from matplotlib.patches import Patch

    handles, labels = ax.get_legend_handles_labels()
    shades = [Patch(color=color, label=mode.replace("_", " ")) for mode, color in SHADES.items()]
    figure.legend(
        [*handles, *shades],
        [*labels, *(str(s.get_label()) for s in shades)],
        loc="outside lower center",
        ncols=4,
        fontsize=8,
        frameon=False,
    )
    if title:
        figure.suptitle(title, fontsize=10.5, x=0.01, ha="left")
