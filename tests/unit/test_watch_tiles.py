# SPDX-License-Identifier: BSD-3-Clause
"""Many samples at once: the same bits as one after the other."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from faultrecon.runtime.watch import Batch, Findings
from faultrecon.runtime.watchloop import CLIPPED, CUT, NOTHING, long_way, owes, rows_of, settled_way
from faultrecon.runtime.watchrest import remember
from faultrecon.runtime.watchtile import clip_tile, regular, settled_tile, tell_tile, worst_of

SCALES, ERRORS, FAULTS, ROWS = 3, 7, 2, 90
POLES = np.array([0.0, 0.9, 0.999, 0.9998])  # of the filters, and how much of the size of a past fault counts


def samples(wild):
    """Errors, the share `wild` of them beyond where they are cut off; limits; and what a watch remembers."""
    rng = np.random.default_rng(3)
    limits = 10.0 ** rng.integers(-6, 4, ERRORS) * rng.uniform(0.2, 1.0, (SCALES, ERRORS))
    values = rng.uniform(-2.0, 2.0, (ROWS, ERRORS)) * limits[0]
    values[rng.random(values.shape) < wild] *= 40.0
    live = np.zeros((rows_of(SCALES), ERRORS + 1))
    live[:SCALES, :ERRORS] = rng.uniform(-1.0, 1.0, (SCALES, ERRORS)) * limits
    live[-1, :FAULTS] = 0.3
    return live, values, limits


@pytest.mark.parametrize("wild", [0.0, 0.02], ids=["plain", "some cut off"])
def test_a_tile_leaves_the_filters_shares_and_sizes_that_single_samples_leave(wild):
    begun, values, limits = samples(wild)
    inverse, cut, fault = 1.0 / limits, CUT * limits[0], np.ascontiguousarray(values[:, :FAULTS].T)
    bound = limits[0, :FAULTS]
    one, tops = begun.copy(), np.empty((ROWS, ERRORS))
    offs, sizes = np.empty((ROWS, FAULTS)), np.empty((ROWS, FAULTS))
    ways = set()
    for k in range(ROWS):
        owing = owes(one, limits)
        ways.add(owing)
        if owing == NOTHING and np.all(np.abs(values[k]) <= cut):
            settled_way(one, values[k], POLES, inverse, tops[k])
        else:
            assert long_way(one, values[k], 0.0, 1.0, POLES, cut, limits, inverse, FAULTS, tops[k]) == 1.0
        remember(one, fault, k, 1.0, bound, POLES, offs, sizes)
    assert ways == ({NOTHING, CLIPPED} if wild else {NOTHING})

    many, told, found = begun.copy(), np.empty((ROWS, SCALES * ERRORS)), np.empty((ROWS, ERRORS))
    settled_tile(many, values, ROWS, POLES, inverse, True, told, found)
    if wild:
        clip_tile(many, begun[:SCALES, :ERRORS], values, ROWS, POLES, limits, inverse, cut, told, found)
    peak, own, faded = np.empty((ROWS, 1)), np.empty((ROWS, 1)), np.zeros((ROWS, 1))
    off, size, shares = np.empty((ROWS, FAULTS)), np.empty((ROWS, FAULTS)), np.full((ROWS, SCALES * ERRORS), -1.0)
    worst_of(found, 0, ROWS, FAULTS, peak, own)
    tell_tile(many, fault, 0, ROWS, bound, POLES, told, peak, shares, faded, off, size)
    for made, expected in ((many, one), (found, tops), (off, offs), (size, sizes)):
        np.testing.assert_array_equal(made, expected)
    np.testing.assert_array_equal(peak[:, 0], tops.max(axis=1))
    np.testing.assert_array_equal(own[:, 0], tops[:, :FAULTS].max(axis=1))
    failing = peak[:, 0] > 1.0
    assert failing.any() and not failing.all() and faded.all()
    np.testing.assert_array_equal(shares[failing].reshape(-1, SCALES, ERRORS).max(axis=1), tops[failing])
    assert np.all(shares[~failing] == -1.0)


@pytest.mark.parametrize("entry", [(0, 1.0), (1, 0.5), (2, 0.0)], ids=["a gap", "an early sample", "a silent sensor"])
def test_one_sample_that_is_not_plain_keeps_its_tile_from_going_together(entry):
    pace = np.ones((3, ROWS))
    pace[0] = 0.0
    assert regular(pace, 0, ROWS)
    pace[entry[0], 40] = entry[1]
    assert not regular(pace, 0, ROWS)
    assert regular(pace, 41, ROWS)


def test_where_tiles_begin_and_end_changes_no_bit(cart, cart_monitor, drive):
    rng, rows = np.random.default_rng(8), 3000
    k = np.arange(rows)
    fault = 0.3 * np.minimum(k / 400.0, 1.0) * (k > 500) * (k < 1200) + 300.0 * ((k > 1500) & (k < 1530))
    t, u, y = drive(cart, rng, rows, faults={"s1": fault})
    y[(rng.random(y.shape) < 0.003) & (k > 900)[:, None]] += 1e3  # once nothing is left of the start
    y[2000:2004, 1] = u[2400] = y[2600] = np.nan
    waits = np.where(k == 2800, 3.0, np.where(k == 2900, 0.5, 1.0))
    first, second = (h.watch for h in cart_monitor.hypotheses[:2])
    certain = first.bounds.certain.copy()
    certain[:, 0] = np.inf  # as of a fault that may go anywhere
    for watch in (first, second, replace(first, bounds=replace(first.bounds, certain=certain))):
        trace = watch.estimator.replay(t, u, y)
        whole, pieces = (Findings.room(rows, [watch])[0] for _ in range(2))
        end = watch.look(watch.init(), Batch.of(u, y, waits), trace, whole)
        live, edges = watch.init(), [0, *np.sort(rng.choice(np.arange(1, rows), 30, replace=False)).tolist(), rows]
        for a, b in pairwise(edges):
            part = replace(trace, state=trace.state[a:b], fault=trace.fault[a:b])
            into = Findings(*(table[a:b] for table in vars(pieces).values()))
            live = watch.look(live, Batch.of(u[a:b], y[a:b], waits[a:b]), part, into)
        np.testing.assert_array_equal(live, end)
        for name in ("peak", "own", "nis", "faded", "bound", "amplitude"):
            np.testing.assert_array_equal(getattr(pieces, name), getattr(whole, name))
        failing = whole.peak[:, 0] > 1.0
        assert 0.02 < failing.mean() < 0.9
        np.testing.assert_array_equal(pieces.shares[failing], whole.shares[failing])


@pytest.mark.parametrize("cut", [1501, 1560, 1700])
def test_a_log_may_be_cut_while_a_filter_still_holds_what_was_cut_off(cart, cart_monitor, drive, cut):
    t, u, y = drive(cart, np.random.default_rng(0), 3000)
    y[1500, 0] += 50.0
    end, whole = cart_monitor.take(cart_monitor.start(), t, u, y)
    state, parts = cart_monitor.start(), []
    for here in (slice(0, cut), slice(cut, None)):
        state, rows = cart_monitor.take(state, t[here], u[here], y[here])
        parts.append(rows)
    for name, column in whole.items():
        np.testing.assert_array_equal(np.concatenate([rows[name] for rows in parts]), column)
    for made, expected in zip(state.live, end.live, strict=True):
        np.testing.assert_array_equal(made, expected)


def test_an_estimate_without_end_says_nothing_about_how_large_a_fault_has_been():
    live, fault = np.zeros((rows_of(1), 2)), np.array([[0.5, np.inf, 0.25]])
    live[-1, 0] = 2.0
    one, tile = live.copy(), live.copy()
    poles, bound, offs, sizes = np.array([0.0, 0.5]), np.ones(1), np.empty((3, 1)), np.empty((3, 1))
    for k in range(3):
        remember(one, fault, k, 1.0, bound, poles, offs, sizes)
    found = [np.empty((3, 1)) for _ in range(4)]
    tell_tile(tile, fault, 0, 3, bound, poles, np.zeros((3, 1)), np.zeros((3, 1)), *found)
    np.testing.assert_array_equal(tile, one)
    assert tile[-1, 0] == 0.25
    np.testing.assert_array_equal(found[-1], sizes)
