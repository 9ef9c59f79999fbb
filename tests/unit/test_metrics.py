# SPDX-License-Identifier: BSD-3-Clause
"""Each score means what it says."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from faultrecon.finding import InputError
from faultrecon.simulation.metrics import FaultScore, score, scores

T = np.arange(0.0, 20.0, 0.01)
STEP = np.where(T >= 5.0, 2.0, 0.0)


def test_a_perfect_reconstruction_scores_zero_throughout():
    assert score(T, STEP, STEP) == {"nrmse": 0.0, "peak": 0.0, "delay": 0.0, "leak": 0.0, "excluded": 0}


def test_an_estimate_of_zero_scores_one_and_never_arrives():
    found = score(T, STEP, np.zeros_like(T))
    assert found["nrmse"] == 1.0
    assert found["peak"] == 2.0
    assert found["delay"] == math.inf
    assert found["leak"] == 0.0


@given(st.floats(0.1, 3.0))
@example(1.7400021538021129)  # an interval that begins a millionth of itself before the answer
def test_the_delay_of_a_first_order_lag_is_its_time_constant(tau):
    lagged = np.where(T >= 5.0, 2.0 * (1 - np.exp(-(T - 5.0) / tau)), 0.0)
    # exp(-s) = 0.37 at s = -log 0.37; the answer is a row, so up to one interval later.
    assert -1e-9 <= score(T, STEP, lagged)["delay"] + math.log(0.37) * tau <= 0.01 + 1e-9


def test_an_estimate_that_leaves_the_band_again_has_not_arrived():
    estimate = STEP.copy()
    estimate[(T > 8.0) & (T < 9.0)] = 0.0
    assert score(T, STEP, estimate)["delay"] == pytest.approx(4.0, abs=0.011)


def test_the_band_on_a_ramp_grows_with_the_ramp():
    ramp = np.maximum(0.0, T - 5.0)
    late = np.maximum(0.0, T - 6.0)
    # f̂ = f - 1 is within 37 % once f >= 1/0.37; the ramp is not zero from the first row after 5 s on.
    assert score(T, ramp, late)["delay"] == pytest.approx(1 / 0.37, abs=0.021)


def test_zero_crossings_of_an_oscillation_do_not_count_as_leaving():
    wave = np.where(T >= 5.0, np.cos(3.0 * (T - 5.0)), 0.0)
    assert score(T, wave, wave + np.where(T >= 5.0, 0.3, 0.0))["delay"] == 0.0


def test_a_lone_zero_inside_a_fault_still_counts_as_acting():
    fault = np.array([0.0, 1.0, 0.0, -1.0, 0.0, 0.0])
    found = score(np.arange(6.0), fault, np.array([0.0, 1.0, 0.5, -1.0, 0.0, 0.0]))
    assert found["peak"] == 0.5
    assert found["leak"] == 0.0


def test_the_slowest_episode_sets_the_delay():
    fault = np.where(((T >= 2.0) & (T < 8.0)) | (T >= 12.0), 1.0, 0.0)
    estimate = np.where(((T >= 2.5) & (T < 8.0)) | (T >= 14.0), 1.0, 0.0)
    assert score(T, fault, estimate)["delay"] == pytest.approx(2.0, abs=0.011)


def test_leak_is_counted_only_without_a_fault():
    found = score(T, STEP, STEP + 0.1)
    assert found["leak"] == pytest.approx(0.1)
    assert found["nrmse"] == pytest.approx(0.05)


def test_a_fault_that_never_acts_has_a_leak_and_nothing_else():
    found = score(T, np.zeros_like(T), np.full_like(T, 0.2))
    assert found["leak"] == pytest.approx(0.2)
    assert all(math.isnan(found[key]) for key in ("nrmse", "peak", "delay"))


def test_a_fault_that_always_acts_has_no_leak():
    assert math.isnan(score(T, np.ones_like(T), np.ones_like(T))["leak"])


def test_rows_without_an_estimate_are_left_out_and_counted():
    estimate = STEP.copy()
    estimate[100:150] = np.nan
    estimate[600:700] = np.inf
    assert score(T, STEP, estimate) == {"nrmse": 0.0, "peak": 0.0, "delay": 0.0, "leak": 0.0, "excluded": 150}


def test_a_fault_whose_every_row_is_missing_is_never_seen():
    found = score(T, STEP, np.full_like(T, np.nan))
    assert found["delay"] == math.inf
    assert math.isnan(found["nrmse"])
    assert math.isnan(found["peak"])


@given(st.floats(1e-3, 1e3), st.integers(0, 2**32 - 1))
def test_a_change_of_unit_scales_peak_and_leak_and_nothing_else(unit, seed):
    estimate = STEP + 0.3 * np.random.default_rng(seed).standard_normal(len(T))
    a, b = score(T, STEP, estimate), score(T, unit * STEP, unit * estimate)
    assert b["nrmse"] == pytest.approx(a["nrmse"], rel=1e-9)
    assert b["peak"] == pytest.approx(unit * a["peak"], rel=1e-9)
    assert b["leak"] == pytest.approx(unit * a["leak"], rel=1e-9)


def test_all_faults_at_once_score_as_one_by_one():
    rng = np.random.default_rng(1)
    truth = np.column_stack([STEP, np.zeros_like(T), np.sin(T)])
    guess = truth + 0.1 * rng.standard_normal(truth.shape)
    together = scores(T, truth, guess, ("a", "b", "c"))
    for j, name in enumerate("abc"):
        assert isinstance(together[name], FaultScore)
        np.testing.assert_equal(together[name].as_dict(), score(T, truth[:, j], guess[:, j]))


def test_shapes_that_do_not_fit_are_named():
    with pytest.raises(InputError, match="the estimate is"):
        score(T, STEP, STEP[:-1])
