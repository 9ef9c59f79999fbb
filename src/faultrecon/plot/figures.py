# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a reconstruction: the fault as it was and as it was found, the measurement before and after correction.

One palette everywhere: truth black, estimate blue, corrected green, alarm band amber, measured or open-loop grey.  A
figure is returned, never shown, and nothing global is touched; `save` writes it by the ending of its name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError, MissingExtra
from faultrecon.storage.atomic import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

TRUTH, ESTIMATE, CORRECTED, ALARM, PLAIN = "#1a1a1a", "#1f6fb4", "#2c9a4b", "#f2b134", "#adadad"
POINTS = 4000  # per line: two per pixel of a wide print; more only makes files large


@dataclass(frozen=True, eq=False)
class Panel:
    """One cell of an overview: a fault over time, found well and found badly.

    t: (N,), s.  truth, estimate, open_loop: (N,), in `unit`.  row and column say where the cell stands; nrmse goes
    into its title.
    """

    row: str
    column: str
    t: ArrayLike
    truth: ArrayLike
    estimate: ArrayLike
    open_loop: ArrayLike | None = None
    nrmse: float | None = None
    unit: str = ""


def reconstruction_figure(
    t: ArrayLike,
    names: Sequence[str],
    units: Sequence[str],
    estimate: ArrayLike,
    *,
    truth: ArrayLike | None = None,
    measured: ArrayLike | None = None,
    corrected: ArrayLike | None = None,
    measured_truth: ArrayLike | None = None,
    sensors: Sequence[str] | None = None,
    sensor_units: Sequence[str] | None = None,
    band: ArrayLike | None = None,
    title: str = "",
) -> Figure:
    """One row per fault: left its waveform, right the measurement it sits on, before and after correction.

    t: (N,), s.  names, units: the q faults.  estimate, truth: (N, q).  measured, corrected, measured_truth: (N, q),
    the sensor that belongs to each fault; sensors and sensor_units its name and unit (those of the fault by default).
    band: (q,) half width about zero inside which an estimate is no alarm.  The right column is left out when there is
    no measurement.  Raises InputError on shapes that do not fit, MissingExtra without matplotlib.
    """
    t = np.asarray(t, dtype=float)
    q = len(names)
    tables = {"estimate": estimate, "truth": truth, "measured": measured, "corrected": corrected}
    data = {key: _table(key, value, (t.size, q)) for key, value in (tables | {"true": measured_truth}).items()}
    _same_length("fault", q, units, sensors, sensor_units, None if band is None else np.asarray(band))
    right = data["measured"] is not None or data["corrected"] is not None
    figure = _figure(10.5 if right else 6.4, 1.1 + 2.05 * q)
    axes = figure.subplots(q, 2 if right else 1, sharex=True, squeeze=False)
    for j, name in enumerate(names):
        columns = {key: None if table is None else table[:, j] for key, table in data.items()}
        _fault(axes[j, 0], t, columns, None if band is None else float(np.asarray(band, dtype=float)[j]))
        _dress(axes[j, 0], name, units[j])
        if right:
            _sensor(axes[j, 1], t, columns)
            _dress(axes[j, 1], (sensors or names)[j], (sensor_units or units)[j])
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    figure.align_ylabels()
    _title_and_legend(figure, title, axes.ravel())
    return figure


def overview_figure(panels: Sequence[Panel], *, title: str = "") -> Figure:
    """Several logs at a glance: a grid of panels by their row and column names, in order of first appearance.

    True fault black, reconstruction blue, open loop grey; a cell nobody gave stays empty.  A row shares its scale and
    a column its time, so that cells can be compared.  Raises InputError without panels or with two for one cell.
    """
    if not panels:
        raise InputError("there is nothing to draw", remedies=("give at least one panel",))
    rows = list(dict.fromkeys(panel.row for panel in panels))
    columns = list(dict.fromkeys(panel.column for panel in panels))
    cells = {(panel.row, panel.column): panel for panel in panels}
    if len(cells) != len(panels):
        raise InputError(
            f"{len(panels)} panels share {len(cells)} cells", remedies=("give each its own row and column",)
        )
    figure = _figure(1.2 + 3.5 * len(columns), 1.0 + 1.75 * len(rows))
    axes = figure.subplots(len(rows), len(columns), sharex="col", sharey="row", squeeze=False)
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            ax, panel = axes[i, j], cells.get((row, column))
            if panel is None:
                ax.set_axis_off()
                continue
            _cell(ax, panel)
            score = "" if panel.nrmse is None else f"nrmse {panel.nrmse:.3g}"
            ax.set_title(score, fontsize=8.5, loc="right", color="#555555", pad=3)
            if i == 0:
                ax.set_title(column, fontsize=10, loc="left", fontweight="bold", pad=3)
            if all((below, column) not in cells for below in rows[i + 1 :]):
                ax.set_xlabel("time [s]")
                ax.tick_params(labelbottom=True)
        first = next(axes[i, j] for j, column in enumerate(columns) if (row, column) in cells)
        unit = next(panel.unit for panel in panels if panel.row == row)
        first.set_ylabel(f"{_wrapped(row)}\n[{unit}]" if unit else _wrapped(row))
        first.tick_params(labelleft=True)
    figure.align_ylabels()
    _title_and_legend(figure, title, axes.ravel())
    return figure


def save(figure: Figure, path: str | Path, *, dpi: int = 150) -> Path:
    """Write a figure whole or not at all, as its ending says (png, svg, pdf); one figure gives the same bytes."""
    path = Path(path)
    undated: dict[str, dict[str, Any]] = {
        ".svg": {"Date": None},
        ".pdf": {"CreationDate": None, "ModDate": None},
        ".png": {"Software": None},
    }
    if path.suffix.lower() not in undated:
        raise InputError(f"no figure format '{path.suffix}'", remedies=("use .png, .svg or .pdf",))
    import matplotlib as mpl

    with mpl.rc_context({"svg.hashsalt": "faultrecon"}), replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi, metadata=undated[path.suffix.lower()])
    return path


# ---------------------------------------------------------------- pieces


def _figure(width: float, height: float) -> Figure:
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtra("matplotlib", "plot") from error
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    engine: Any = figure.get_layout_engine()
    engine.set(w_pad=0.08, h_pad=0.06, wspace=0.03, hspace=0.03)
    return figure


def _fault(ax: Axes, t: Array, data: Mapping[str, Array | None], band: float | None) -> None:
    if band is not None:
        ax.axhspan(-band, band, color=ALARM, alpha=0.22, linewidth=0, label="alarm band")
    _line(ax, t, data["truth"], TRUTH, "true fault", width=2.4)
    _line(ax, t, data["estimate"], ESTIMATE, "reconstructed fault", width=1.1)
    _retrace(ax, t, data["truth"])


def _sensor(ax: Axes, t: Array, data: Mapping[str, Array | None]) -> None:
    _line(ax, t, data["measured"], PLAIN, "measured", width=1.0)
    _line(ax, t, data["true"], TRUTH, "true value", width=2.4)
    _line(ax, t, data["corrected"], CORRECTED, "corrected", width=1.1)
    _retrace(ax, t, data["true"])


def _cell(ax: Axes, panel: Panel) -> None:
    t = np.asarray(panel.t, dtype=float)
    lines = {"open loop": (panel.open_loop, PLAIN, 0.9), "true fault": (panel.truth, TRUTH, 2.2)}
    for label, (values, color, width) in (lines | {"reconstructed": (panel.estimate, ESTIMATE, 1.1)}).items():
        table = _table(label, values, (t.size,))
        _line(ax, t, table, color, label, width=width)
    _retrace(ax, t, np.asarray(panel.truth, dtype=float))
    _dress(ax, "", "")
    ax.tick_params(labelsize=8)


def _line(ax: Axes, t: Array, values: Array | None, color: str, label: str, *, width: float) -> None:
    if values is not None:
        x, y = _thinned(t, values)
        ax.plot(x, y, color=color, linewidth=width, label=label, solid_joinstyle="round")


def _retrace(ax: Axes, t: Array, truth: Array | None) -> None:
    """The truth once more, thin and dashed, so that a noisy estimate does not bury it."""
    if truth is not None:
        ax.plot(*_thinned(t, truth), color=TRUTH, linewidth=0.9, dashes=(5, 3))


def _thinned(t: Array, values: Array) -> tuple[Array, Array]:
    """Both extremes of every stretch of rows, so that no peak is lost; gaps (not finite) stay gaps."""
    stretch = -(-t.size * 2 // POINTS)
    if stretch <= 2:
        return t, np.where(np.isfinite(values), values, np.nan)
    rows = t.size // stretch * stretch
    blocks = values[:rows].reshape(-1, stretch)
    whole = np.all(np.isfinite(blocks), axis=1).reshape(-1, 1)
    safe = np.where(np.isfinite(blocks), blocks, 0.0)
    pick = np.sort(np.stack([safe.argmin(axis=1), safe.argmax(axis=1)], axis=1), axis=1)
    y = np.where(whole, np.take_along_axis(safe, pick, axis=1), np.nan)
    x = np.take_along_axis(t[:rows].reshape(-1, stretch), pick, axis=1)
    rest = np.where(np.isfinite(values[rows:]), values[rows:], np.nan)
    return np.append(x.ravel(), t[rows:]), np.append(y.ravel(), rest)


def _dress(ax: Axes, name: str, unit: str) -> None:
    ax.set_ylabel(f"{_wrapped(name.replace('_', ' '))}\n[{unit}]" if unit else _wrapped(name.replace("_", " ")))
    ax.grid(True, color="#e4e4e4", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.margins(x=0.0, y=0.12)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color("#888888")
    ax.tick_params(color="#888888", labelsize=9)


def _wrapped(text: str) -> str:
    import textwrap

    return textwrap.fill(text, 20)


def _title_and_legend(figure: Figure, title: str, axes: Any) -> None:
    """One legend for the whole figure, below the plots; every label once."""
    handles: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if title:
        figure.suptitle(title, fontsize=12, fontweight="bold")
    if handles:
        names = list(handles)
        figure.legend(handles.values(), names, loc="outside lower center", ncols=len(names), frameon=False, fontsize=9)


def _table(name: str, values: ArrayLike | None, shape: tuple[int, ...]) -> Array | None:
    if values is None:
        return None
    table = np.asarray(values, dtype=float)
    if table.shape != shape:
        raise InputError(f"the {name} to draw is {table.shape}", why=f"times and names ask for {shape}")
    return table


def _same_length(what: str, size: int, *groups: Any) -> None:
    for group in groups:
        if group is not None and len(group) != size:
            raise InputError(f"{len(group)} labels are given for {size} {what}s")
