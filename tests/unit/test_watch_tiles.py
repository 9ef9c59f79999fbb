# SPDX-License-Identifier: BSD-3-Clause
"""Many samples at once: the same bits as one after the other."""

from __future__ import annotations

import numpy as np
import pytest

from faultrecon.runtime.watchloop import remember, rows_of, settled_way
from faultrecon.runtime.watchtile import regular, settled_tile, tell_tile

SCALES, ERRORS, FAULTS, ROWS = 3, 7, 2, 90
POLES = np.array([0.0, 0.9, 0.999, 0.9998])  # of the filters, and how much of the size of a past fault counts


@pytest.fixture
def samples() -> dict[str, np.ndarray]:
    """Errors within limits, faults among them, and what a watch remembers of those before."""
    rng = np.random.default_rng(3)
    live = np.zeros((rows_of(SCALES), ERRORS + 1))
    live[:SCALES, :ERRORS] = rng.standard_normal((SCALES, ERRORS))
    live[-1, :FAULTS] = 0.3
    values = rng.standard_normal((ROWS, ERRORS)) * 10.0 ** rng.integers(-8, 3, (ROWS, ERRORS))
    limits = np.abs(values).max(axis=0) * rng.uniform(1.1, 3.0, (SCALES, ERRORS)) + np.abs(live[:SCALES, :ERRORS])
    return {"live": live, "values": values, "inverse": 1.0 / limits, "bound": rng.uniform(1.0, 2.0, FAULTS)}


def test_a_tile_leaves_the_filters_shares_and_sizes_that_single_samples_leave(samples: dict[str, np.ndarray]) -> None:
    values, inverse, bound = samples["values"], samples["inverse"], samples["bound"]
    fault = np.ascontiguousarray(values[:, :FAULTS].T)
    one, many = samples["live"].copy(), samples["live"].copy()
    peaks, owns, top = np.empty((ROWS, 1)), np.empty((ROWS, 1)), np.empty(ERRORS)
    offs, sizes = np.empty((ROWS, FAULTS)), np.empty((ROWS, FAULTS))
    for k in range(ROWS):
        settled_way(one, values[k], POLES, inverse, top)
        owns[k], peaks[k] = top[:FAULTS].max(), top.max()
        remember(one, fault, k, 1.0, bound, POLES, offs, sizes)

    peak, own, faded = np.empty((ROWS, 1)), np.empty((ROWS, 1)), np.zeros((ROWS, 1))
    off, size = np.empty((ROWS, FAULTS)), np.empty((ROWS, FAULTS))
    filters, tops = np.empty((SCALES, ERRORS)), np.empty((ROWS, ERRORS))
    most = settled_tile(many, values, 0, ROWS, FAULTS, POLES, inverse, filters, tops, peak, own)
    assert np.array_equal(many, samples["live"])  # until it is said that all tests hold
    tell_tile(many, filters, fault, 0, ROWS, bound, POLES, faded, off, size)
    for found, expected in ((many, one), (peak, peaks), (own, owns), (off, offs), (size, sizes)):
        assert np.array_equal(found, expected)
    assert most == peaks.max()
    assert faded.all()


@pytest.mark.parametrize("entry", [(0, 1.0), (1, 0.5), (2, 0.0)], ids=["a gap", "an early sample", "a silent sensor"])
def test_one_sample_that_is_not_plain_keeps_its_tile_from_going_together(entry: tuple[int, float]) -> None:
    pace = np.ones((3, ROWS))
    pace[0] = 0.0
    assert regular(pace, 0, ROWS)
    pace[entry[0], 40] = entry[1]
    assert not regular(pace, 0, ROWS)
    assert regular(pace, 41, ROWS)
