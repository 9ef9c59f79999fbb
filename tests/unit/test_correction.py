# SPDX-License-Identifier: BSD-3-Clause
"""The measurement that a controller may read: what each policy sends, and which quality says so."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.runtime.correction import BAD, CORRECTED, GOOD, HELD, PREDICTED, UNCERTAIN, Correction, Held
from faultrecon.runtime.decision import FAULT, OUTSIDE, SUSPECT, TRACKING, WARMING

NAN = math.nan


def applied(correction, y, modes, named=-1, reached=((0, (), ()),), before=None, first=0.0):
    """Rows every second; the hypotheses' corrected values are 10 + the sensor's number, and 20 + it."""
    y = np.array(y, dtype=float).reshape(len(modes), -1)
    t = first + np.arange(len(y), dtype=float)
    traces = [SimpleNamespace(corrected=np.tile(base + np.arange(y.shape[1]), (len(y), 1))) for base in (10.0, 20.0)]
    named = np.broadcast_to(named, len(y))
    return correction.apply(before or Held.nothing(y.shape[1]), t, y, np.array(modes), named, reached, traces)


def test_what_nothing_speaks_against_passes_as_it_is():
    _, out, quality = applied(Correction(), [[1.0, 2.0], [3.0, 4.0]], [TRACKING] * 2)
    np.testing.assert_array_equal(out, [[1.0, 2.0], [3.0, 4.0]])
    assert np.all(quality == GOOD)


@pytest.mark.parametrize("mode", [WARMING, OUTSIDE])
def test_while_nothing_can_be_said_every_reading_is_uncertain(mode):
    _, out, quality = applied(Correction(), [[1.0, 2.0]], [mode])
    np.testing.assert_array_equal(out, [[1.0, 2.0]])
    assert np.all(quality == UNCERTAIN)


def test_suspects_are_uncertain_and_the_others_good():
    _, out, quality = applied(Correction(), [[1.0, 2.0, 3.0]], [SUSPECT], reached=((0, (), (0, 2)),))
    np.testing.assert_array_equal(out, [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(quality, [[UNCERTAIN, GOOD, UNCERTAIN]])


@pytest.mark.parametrize(
    ("policy", "value", "quality"),
    [("correct", 21.0, CORRECTED), ("hold", 2.0, HELD), ("refuse", NAN, BAD), ("pass", 9.0, BAD)],
)
def test_each_policy_for_a_sensor_that_is_named(policy, value, quality):
    reached = ((0, (), ()), (1, (1,), ()))
    _, out, found = applied(Correction(policy), [[1.0, 2.0], [1.5, 9.0]], [TRACKING, FAULT], [-1, 1], reached)
    np.testing.assert_array_equal(out, [[1.0, 2.0], [1.5, value]])
    np.testing.assert_array_equal(found, [[GOOD, GOOD], [GOOD, quality]])


def test_a_value_is_held_no_longer_than_allowed():
    reached = ((0, (), ()), (1, (0,), ()))
    _, out, found = applied(Correction("hold", 3.0), [5.0, *[9.0] * 5], [TRACKING, *[FAULT] * 5], 0, reached)
    np.testing.assert_array_equal(out[:, 0], [5.0, 5.0, 5.0, 5.0, NAN, NAN])
    np.testing.assert_array_equal(found[:, 0], [GOOD, HELD, HELD, HELD, BAD, BAD])


def test_what_was_good_before_these_rows_is_held_too():
    before, *_ = applied(Correction("hold"), [5.0], [TRACKING])
    _, out, found = applied(Correction("hold"), [9.0], [FAULT], 0, ((0, (0,), ()),), before, first=2.0)
    assert (out[0, 0], found[0, 0]) == (5.0, HELD)


def test_what_nobody_knows_is_held_though_the_last_row_is_good_again():
    nobody = [SimpleNamespace(corrected=np.full((3, 2), NAN))]
    y, t, modes = np.array([[5.0, 1.0], [NAN, 2.0], [6.0, 3.0]]), np.arange(3.0), np.full(3, TRACKING)
    after, out, found = Correction().apply(Held.nothing(2), t, y, modes, np.full(3, -1), ((0, (), ()),), nobody)
    np.testing.assert_array_equal(out, [[5.0, 1.0], [5.0, 2.0], [6.0, 3.0]])
    assert found.tolist() == [[GOOD, GOOD], [HELD, GOOD], [GOOD, GOOD]]
    assert (after.value.tolist(), after.time.tolist()) == ([6.0, 3.0], [2.0, 2.0])


def test_an_uncertain_value_is_never_held():
    reached = ((0, (), (0,)), (1, (0,), ()))
    _, out, found = applied(Correction("hold"), [5.0, 9.0], [SUSPECT, FAULT], 0, reached)
    assert math.isnan(out[1, 0])
    assert found[1, 0] == BAD


@pytest.mark.parametrize("policy", ["correct", "hold", "pass"])
def test_a_sensor_that_sent_nothing_is_predicted(policy):
    _, out, quality = applied(Correction(policy), [[1.0, NAN]], [TRACKING])
    np.testing.assert_array_equal(out, [[1.0, 11.0]])
    np.testing.assert_array_equal(quality, [[GOOD, PREDICTED]])


def test_a_named_sensor_that_sent_nothing_is_predicted_by_the_one_that_names_it():
    _, out, quality = applied(Correction(), [[1.0, NAN]], [FAULT], 1, ((0, (1,), ()),))
    np.testing.assert_array_equal(out, [[1.0, 21.0]])
    np.testing.assert_array_equal(quality, [[GOOD, PREDICTED]])


def test_where_the_observer_predicts_nothing_the_last_good_value_stands_in():
    y, t = np.array([[4.0], [NAN], [NAN]]), np.array([0.0, 1.0, 7.0])
    trace = SimpleNamespace(corrected=np.full((3, 1), NAN))
    modes, named = np.full(3, TRACKING), np.full(3, -1)
    _, out, quality = Correction("correct", 5.0).apply(Held.nothing(1), t, y, modes, named, [(0, (), ())], [trace])
    np.testing.assert_array_equal(out[:, 0], [4.0, 4.0, NAN])
    np.testing.assert_array_equal(quality[:, 0], [GOOD, HELD, BAD])


def test_to_refuse_means_that_nothing_stands_in():
    _, out, quality = applied(Correction("refuse"), [5.0, 9.0], [TRACKING, FAULT], 0, ((0, (), ()), (1, (0,), ())))
    assert math.isnan(out[1, 0])
    assert quality[1, 0] == BAD


def test_what_came_in_is_left_alone():
    y = np.array([[1.0, 9.0]])
    applied(Correction("refuse"), y, [FAULT], 0, ((0, (1,), ()),))
    np.testing.assert_array_equal(y, [[1.0, 9.0]])


def test_what_is_held_survives_packing():
    held, *_ = applied(Correction(), [[1.0, NAN]], [TRACKING])
    again = Held.unpack(held.pack())
    np.testing.assert_array_equal(again.value, held.value)
    np.testing.assert_array_equal(again.time, held.time)


@pytest.mark.parametrize("wrong", [{"policy": "guess"}, {"longest": -1.0}, {"longest": NAN}])
def test_what_makes_no_sense_is_refused(wrong):
    with pytest.raises(InputError):
        Correction(**wrong)
