# SPDX-License-Identifier: BSD-3-Clause
"""What is true is never refuted, whatever the fault looks like and however the samples come; what is untested is not
called good."""

import math

import numpy as np
import pytest

ROWS, T = 1600, 0.05


def take(monitor, log, doubt=None):
    state, rows = monitor.take(monitor.start(), *log, doubt)
    return monitor.events(state), rows


def shapes(size):
    k = np.arange(ROWS)
    late = k >= 500
    return {
        "constant": size * late,
        "sawtooth": size * late * ((k % 20) / 19.0 - 0.5),
        "rare spikes over a bias": late * np.where(k % 40 == 0, 20.0 * size, -0.5 * size),
        "sine": size * late * np.sin(0.3 * k),
        "chatter": size * late * (-1.0) ** k,
    }


@pytest.mark.parametrize("size", [0.1, 0.5, 5.0, 500.0])
@pytest.mark.parametrize("shape", list(shapes(1.0)))
def test_the_hypothesis_that_is_true_is_never_refuted(cart, cart_monitor, drive, shape, size):
    log = drive(cart, np.random.default_rng(31), ROWS, faults={"s1": shapes(size)[shape]}, gaussian=False)
    looked = cart_monitor._look(cart_monitor.start(), *log, np.ones(ROWS))
    assert looked.misfit[:, 0].max() <= 1.0
    events, _ = take(cart_monitor, log)
    assert {e.fault for e in events if e.mode == "fault"} <= {"s1"}
    assert "out_of_envelope" not in {e.mode for e in events}


@pytest.mark.parametrize("part", [0.02, 0.1, 0.3])
def test_a_log_with_missing_rows_is_decided_within_its_bounds(cart, cart_monitor, drive, part):
    rng = np.random.default_rng(32)
    f = 0.4 * (np.arange(ROWS) >= 500)
    keep = rng.random(ROWS) >= part
    keep[0] = True
    log = tuple(one[keep] for one in drive(cart, rng, ROWS, faults={"s2": f}, gaussian=False))
    events, rows = take(cart_monitor, log)
    assert [e.fault for e in events if e.mode == "fault"] == ["s2"]
    assert np.all(np.abs(rows["f_s2"] - f[keep]) <= rows["f_s2_bound"])
    assert np.mean(rows["mode"] == "warming") < 0.05 or part > 0.1


def test_missing_inputs_and_cells_do_not_refute_what_is_true(cart, cart_monitor, drive):
    rng = np.random.default_rng(33)
    f = 0.4 * (np.arange(ROWS) >= 500)
    t, u, y = drive(cart, rng, ROWS, faults={"v1": f}, gaussian=False)
    u[rng.random(u.shape) < 0.02] = math.nan
    y[rng.random(y.shape) < 0.02] = math.nan
    u[0], y[0] = 0.0, np.nan_to_num(y[0])
    events, rows = take(cart_monitor, (t, u, y))
    assert {e.fault for e in events if e.mode == "fault"} <= {"v1"}
    told = np.isfinite(rows["f_v1"])
    assert np.all(np.abs(rows["f_v1"] - f)[told] <= rows["f_v1_bound"][told])


@pytest.mark.parametrize("faster", [1.1, 1.6, 2.0])
def test_samples_that_come_faster_stay_within_their_bounds(cart, cart_monitor, drive, faster):
    """What is left of a start fades with time, not with samples."""
    f = 0.4 * (np.arange(ROWS) >= 500)
    log = drive(
        cart, np.random.default_rng(34), ROWS, T=T / faster, faults={"s1": f}, gaussian=False, start=[1.5, -1.0]
    )
    events, rows = take(cart_monitor, log)
    assert {e.fault for e in events if e.mode == "fault"} <= {"s1"}
    assert np.all(np.abs(rows["f_s1"] - f) <= rows["f_s1_bound"])


def test_samples_that_come_much_faster_are_not_tested(cart, cart_monitor, drive):
    f = 0.4 * (np.arange(ROWS) >= 500)
    log = drive(cart, np.random.default_rng(35), ROWS, T=T / 5.0, faults={"s1": f})
    assert set(take(cart_monitor, log)[1]["mode"]) == {"warming"}


@pytest.mark.parametrize("value", [1e3, 1e12, 1e30])
def test_after_one_wild_sample_nobody_else_is_named_and_it_is_over_in_the_end(cart, cart_monitor, drive, value):
    t, u, y = drive(cart, np.random.default_rng(36), ROWS, gaussian=False)
    y[800, 0] = value
    events, rows = take(cart_monitor, (t, u, y))
    assert {e.fault for e in events if e.mode == "fault"} <= {"s1"}  # observers that read it are led astray for a while
    assert rows["mode"][-1] == "tracking"


def test_a_reading_that_something_else_speaks_against_is_uncertain(cart, cart_monitor, drive):
    log = drive(cart, np.random.default_rng(37), ROWS, gaussian=False)
    doubt = np.zeros((ROWS, 4), dtype=bool)
    doubt[700:800, 2] = True
    _, rows = take(cart_monitor, log, doubt)
    assert set(rows["v1_quality"][700:800]) == {"uncertain"}
    assert set(rows["v1_quality"][800:]) == set(rows["s1_quality"][700:]) == {"good"}


def test_a_sensor_that_no_other_can_speak_against_is_not_good(cart, cart_monitor, drive):
    t, u, y = drive(cart, np.random.default_rng(38), ROWS, gaussian=False)
    y[800:, 1:] = math.nan
    _, rows = take(cart_monitor, (t, u, y))
    assert set(rows["s1_quality"][900:]) == {"uncertain"}


def test_a_named_sensor_that_falls_silent_is_still_named(cart, cart_monitor, drive):
    f = 0.4 * (np.arange(ROWS) >= 500)
    t, u, y = drive(cart, np.random.default_rng(39), ROWS, faults={"s1": f}, gaussian=False)
    y[800:, 0] = math.nan
    events, rows = take(cart_monitor, (t, u, y))
    assert events[-1].fault == "s1"
    assert events[-1].end is None
    assert "good" not in set(rows["s1_quality"][800:])
