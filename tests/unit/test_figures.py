# SPDX-License-Identifier: BSD-3-Clause
"""Figures say what they show, keep peaks and gaps, and touch nothing global."""

import subprocess
import sys

import numpy as np
import pytest

from faultrecon.finding import InputError, MissingExtra
from faultrecon.plot.figures import (
    CORRECTED,
    ESTIMATE,
    PLAIN,
    POINTS,
    TRUTH,
    Panel,
    overview_figure,
    reconstruction_figure,
    save,
)

T = np.linspace(0.0, 10.0, 501)
F = np.column_stack([np.where(T > 5, 0.4, 0.0), 0.1 * T])
NAMES, UNITS = ("pitch_rate_bias", "drift"), ("rad/s", "deg")


def _lines(ax, color):
    return [line for line in ax.lines if line.get_color() == color]


def test_every_fault_has_its_row_with_name_and_unit():
    figure = reconstruction_figure(T, NAMES, UNITS, F)
    assert len(figure.axes) == 2
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert "pitch rate bias" in labels[0]
    assert "[rad/s]" in labels[0]
    assert "[deg]" in labels[1]
    assert figure.axes[-1].get_xlabel() == "time [s]"


def test_the_palette_is_truth_black_estimate_blue_corrected_green():
    figure = reconstruction_figure(T, NAMES, UNITS, 0.9 * F, truth=F, measured=F + 1, corrected=F + 2)
    left, right = figure.axes[:2]
    np.testing.assert_array_equal(_lines(left, TRUTH)[0].get_ydata(), F[:, 0])
    np.testing.assert_array_equal(_lines(left, ESTIMATE)[0].get_ydata(), 0.9 * F[:, 0])
    np.testing.assert_array_equal(_lines(right, PLAIN)[0].get_ydata(), F[:, 0] + 1)
    np.testing.assert_array_equal(_lines(right, CORRECTED)[0].get_ydata(), F[:, 0] + 2)


def test_the_legend_names_each_kind_of_line_once():
    figure = reconstruction_figure(T, NAMES, UNITS, F, truth=F, measured=F, corrected=F, measured_truth=F, band=[1, 1])
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["alarm band", "true fault", "reconstructed fault", "measured", "true value", "corrected"]


def test_no_peak_of_a_long_log_is_lost():
    t = np.arange(300_000) * 0.01
    f = np.zeros((t.size, 1))
    f[123_457] = 7.0
    f[234_568] = -5.0
    line = _lines(reconstruction_figure(t, ("a",), ("",), f).axes[0], ESTIMATE)[0]
    x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    assert len(y) <= 1.1 * POINTS
    assert (y.min(), y.max()) == (-5.0, 7.0)
    assert np.all(np.diff(x) >= 0)


def test_rows_without_an_estimate_are_gaps_in_the_line():
    f = F[:, :1].copy()
    f[100:120] = np.nan
    assert (
        np.count_nonzero(np.isnan(_lines(reconstruction_figure(T, ("a",), ("",), f).axes[0], ESTIMATE)[0].get_ydata()))
        == 20
    )


def test_an_overview_puts_each_log_in_its_cell_with_its_score():
    panels = [
        Panel(row, column, T, F[:, 0], F[:, 0], 2 * F[:, 0], score, "deg")
        for row, column, score in (("bias", "calm", 0.05), ("bias", "gust", 0.1234), ("drift", "gust", None))
    ]
    figure = overview_figure(panels, title="flights")
    axes = figure.axes
    assert len(axes) == 4
    assert axes[0].get_title("left") == "calm"
    assert axes[1].get_title("left") == "gust"
    assert axes[1].get_title("right") == "nrmse 0.123"
    assert not axes[2].axison
    assert "bias" in axes[0].get_ylabel()
    assert _lines(axes[0], PLAIN)


def test_a_saved_figure_has_the_same_bytes_each_time(tmp_path):
    for ending in ("png", "svg", "pdf"):
        files = [save(reconstruction_figure(T, NAMES, UNITS, F), tmp_path / f"{k}.{ending}") for k in "ab"]
        assert files[0].read_bytes() == files[1].read_bytes()
        assert files[0].stat().st_size > 1000


def test_drawing_leaves_pyplot_alone():
    code = (
        "import sys, numpy as np; from faultrecon.plot.figures import reconstruction_figure\n"
        "reconstruction_figure(np.arange(3.0), ('a',), ('',), np.zeros((3, 1)))\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_matplotlib_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtra, match=r"faultrecon\[plot\]"):
        reconstruction_figure(T, NAMES, UNITS, F)


def test_shapes_that_do_not_fit_are_named():
    with pytest.raises(InputError, match="the truth to draw"):
        reconstruction_figure(T, NAMES, UNITS, F, truth=F[:, :1])
    with pytest.raises(InputError, match="1 labels"):
        reconstruction_figure(T, NAMES, UNITS[:1], F)
    with pytest.raises(InputError, match="nothing to draw"):
        overview_figure([])
    panel = Panel("a", "b", T, F[:, 0], F[:, 0])
    with pytest.raises(InputError, match="share 1 cells"):
        overview_figure([panel, panel])
    with pytest.raises(InputError, match="no figure format"):
        save(overview_figure([panel]), "x.gif")
