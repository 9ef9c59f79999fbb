# SPDX-License-Identifier: BSD-3-Clause
"""Pictures for Alwi, Edwards, Tan 2009: faults and estimates, the errors that floor and level allow, and chatter."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.advise.papers._alwi2009_flights import (
    FAULTS,
    NOISE,
    Flight,
    flight,
    ideal,
    paper_design,
    reconstructed,
)
from faultrecon.methods.sliding_letters import sliding_gain
from faultrecon.plot.figures import ALARM, CORRECTED, ESTIMATE, TRUTH, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[Any]

MEMORY = {"ramp": 1.5, "sine": 10.5, "step": 1.5}
"""Seconds in which the rate of a fault still matters: three time constants of the slowest sliding pole; half a sine."""
CAPTION = (
    "bands: seconds times the largest rate of the fault in the last 1.5 s (sine: half a period); worst cases over all"
    " waveforms, not bounds at every instant"
)


def draw(out: Path, seed: int) -> tuple[Path, ...]:
    """The three figures as PNG files."""
    quiet = "Ramp, sine and step on the pitch-rate gyro, reconstructed from roll and yaw rate: 10 ms, no noise"
    noisy = f"The same with noise of {NOISE:g} rad/s on every gyro"
    return (
        save(bands(0.0, seed, quiet), out / "figure_1.png"),
        save(bands(NOISE, seed, noisy), out / "figure_2.png"),
        save(chatter(), out / "figure_3.png"),
    )


def bands(noise: float, seed: int, title: str) -> Figure:
    """Above the fault and its estimate, below the error; both with the error that floor and certified level allow."""
    made, flown = paper_design(), flight(0.01, 25.0)
    assert made.level is not None
    assert made.floor is not None
    figure, axes = _grid(2, 3, 11.0, 5.8, shared=False)
    for (above, below), (name, shape) in zip(axes.T, FAULTS.items(), strict=True):
        f = shape(flown.t)
        y = flown.outputs(made.plant.F_f, f, noise, seed)
        found, linear = reconstructed(made.observer, flown, y), reconstructed(made.observer, flown, y, bound=1e-12)
        exact = ideal(made.plant, sliding_gain(made.plant, made.gains), f, 0.01)
        rate = recent_rate(flown, f, MEMORY[name])
        for ax, base in ((above, f), (below, 0.0 * f)):
            for seconds, alpha, label in (
                (made.level, 0.16, f"certified level {made.level:.3f} s"),
                (made.floor, 0.34, f"floor {made.floor:.3f} s"),
            ):
                _band(ax, flown.t, base, seconds * rate, alpha, label)
        above.plot(flown.t, f, color=TRUTH, linewidth=2.2, label="true fault")
        above.plot(flown.t, found, color=ESTIMATE, linewidth=1.1, label="sliding-mode estimate")
        if noise:
            above.plot(flown.t, f, color=TRUTH, linewidth=0.9, dashes=(5, 3))
            below.plot(flown.t, found - f, color=ESTIMATE, linewidth=0.9)
            below.plot(flown.t, linear - f, color=CORRECTED, linewidth=0.9, label="linear observer alone, ν = 0")
        else:
            below.plot(flown.t, linear - f, color=CORRECTED, linewidth=3.0, label="linear observer alone, ν = 0")
            below.plot(flown.t, found - f, color=ESTIMATE, linewidth=1.4)
        below.plot(flown.t, exact - f, color=TRUTH, linewidth=0.9, dashes=(4, 3), label="exact F(s) f")
        above.set_title(name, fontsize=10, loc="left", fontweight="bold")
        below.set_xlabel("time [s]")
    axes[0, 0].set_ylabel("fault\n[rad/s]")
    axes[1, 0].set_ylabel("estimate - fault\n[rad/s]")
    return _finished(figure, axes, title, CAPTION)


def chatter() -> Figure:
    """Three discretisations of one observer while the aircraft pitches and the ramp begins."""
    made, flown = paper_design(), flight(0.01, 25.0)
    f = FAULTS["ramp"](flown.t)
    y, exact = flown.outputs(made.plant.F_f, f), ideal(made.plant, sliding_gain(made.plant, made.gains), f, 0.01)
    shown = flown.t <= 8.0
    kinds: dict[str, dict[str, Any]] = {
        "explicit": {"scheme": "explicit"},
        "explicit with a layer of 0.1": {"scheme": "explicit", "layer": 0.1},
        "implicit": {},
    }
    figure, axes = _grid(2, 3, 11.0, 4.8, shared=True)
    for (above, below), (name, options) in zip(axes.T, kinds.items(), strict=True):
        found = reconstructed(made.observer, flown, y, **options)
        above.plot(flown.t[shown], f[shown], color=TRUTH, linewidth=2.2, label="true fault")
        above.plot(flown.t[shown], found[shown], color=ESTIMATE, linewidth=1.0, label="estimate")
        above.plot(flown.t[shown], exact[shown], color=ALARM, linewidth=1.0, dashes=(4, 3), label="exact F(s) f")
        below.plot(flown.t[shown], 1e3 * (found - exact)[shown], color=ESTIMATE, linewidth=0.8)
        above.set_title(name, fontsize=10, loc="left", fontweight="bold")
        below.set_xlabel("time [s]")
    axes[0, 0].set_ylabel("fault\n[rad/s]")
    axes[1, 0].set_ylabel("estimate - exact\n[mrad/s]")
    return _finished(
        figure,
        axes,
        "One observer in three discretisations: 10 ms, no noise, pitch doublet at 1 s and a ramp from 5 s",
        "",
    )


def recent_rate(flown: Flight, f: Array, memory: float) -> Array:
    """The largest |f'| of the last `memory` seconds, (N,)."""
    h = float(flown.t[1] - flown.t[0])
    rate = np.abs(np.append(np.diff(f) / h, 0.0))
    past = np.concatenate([np.zeros(round(memory / h)), rate])
    return np.lib.stride_tricks.sliding_window_view(past, round(memory / h) + 1).max(axis=1)


def _grid(rows: int, columns: int, width: float, height: float, *, shared: bool) -> tuple[Figure, Any]:
    from faultrecon.plot.figures import _figure

    figure = _figure(width, height)
    return figure, figure.subplots(rows, columns, sharex="col", sharey="row" if shared else False, squeeze=False)


def _band(ax: Axes, t: Array, middle: Array, half: Array, alpha: float, label: str) -> None:
    ax.fill_between(t, middle - half, middle + half, color=ALARM, alpha=alpha, linewidth=0, label=label)


def _finished(figure: Figure, axes: Any, title: str, caption: str) -> Figure:
    from faultrecon.plot.figures import _title_and_legend

    for ax in axes.ravel():
        ax.grid(True, color="#e4e4e4", linewidth=0.7)
        ax.set_axisbelow(True)
        ax.margins(x=0.0, y=0.08)
        ax.tick_params(color="#888888", labelsize=9)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    if caption:
        title += "\n"
        figure.text(0.5, 0.955, caption, fontsize=8.5, color="#555555", ha="center", va="top")
    figure.align_ylabels()
    _title_and_legend(figure, title, axes.ravel())
    return figure
