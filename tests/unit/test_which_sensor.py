# SPDX-License-Identifier: BSD-3-Clause
"""The table of watched flights: a line for each, from the scores of its log."""

import math

import numpy as np
import pytest

from faultrecon.advise.which_sensor import WhichSensor, flown
from faultrecon.io.logs import Log
from faultrecon.io.watched import watch

ROWS = 1600


@pytest.fixture(scope="module")
def flights(by_hand, cart_monitor, drive):
    made = by_hand(cart_monitor.plant)
    k = np.arange(ROWS)
    twice = 0.2 * ((k >= 400) & (k < 600)) + 0.4 * ((k >= 900) & (k < 1300))
    rows = []
    for name, fault in (("quiet", 0.0 * k), ("twice", twice), ("small", 0.01 * (k >= 400))):
        t, u, y = drive(made.plant, np.random.default_rng(3), ROWS, faults={"s1": fault})
        log = Log(t, u, y, {"true_f_s1": fault, "true_f_s2": 0.0 * k})
        rows.append(flown(watch(made, log, spans=(0.5, 2.5), window=10, crest=1.0), name))
    return WhichSensor(made, tuple(rows))


def test_a_fault_in_episodes_is_timed_from_the_first_and_sized_by_the_largest(flights):
    row = flights.rows[1]
    assert row.fault == "s1"
    assert 0.0 < row.noticed <= row.named < 5.0
    assert row.size_error < 0.5
    assert row.inside == 1.0


def test_a_fault_that_is_too_small_to_be_named_has_no_delay(flights):
    row = flights.rows[2]
    assert (row.fault, row.named_fault) == ("s1", "")
    assert math.isnan(row.named)


def test_hours_without_a_fault_are_added_up(flights):
    alarms, hours = flights.healthy
    assert alarms == 0
    assert hours * 3600 == pytest.approx(0.05 * (1600 + 1000 + 400), rel=0.1)  # less what is warming up or a grace
    assert flights.false_alarms_per_hour == 0.0
    assert "no false alarms in" in str(flights)
    assert flights.as_dict()["flights"][0]["fault"] == ""
