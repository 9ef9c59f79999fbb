# SPDX-License-Identifier: BSD-3-Clause
"""The table of watched flights: a line for each, from the scores of its log."""

import math

import numpy as np
import pytest

from faultrecon.advise import which_sensor as demonstration
from faultrecon.advise.which_sensor import WhichSensor, flown, which_sensor
from faultrecon.finding import InputError
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


def test_the_table_says_which_sensors_are_taken_for_healthy_because_nobody_asks(flights, by_hand):
    assert flights.unasked == () and "taken for healthy" not in str(flights)
    some = WhichSensor(by_hand(flights.bank.plant, sensors=["s1"]), ())
    assert some.unasked == ("s2", "v1", "mix")
    assert "taken for healthy, as they have none: s2, v1, mix" in str(some)
    assert some.as_dict()["taken_for_healthy"] == ["s2", "v1", "mix"]


@pytest.mark.parametrize(("every", "asked"), [(False, ["pitch_rate", "pitch_angle", "roll_rate"]), (True, None)])
def test_only_three_sensors_have_a_hypothesis_unless_every_one_is_asked_about(every, asked, monkeypatch):
    def refuse(plant, sensors):
        assert len(plant.signals.y.names) == 11
        raise InputError(str(sensors))

    monkeypatch.setattr(demonstration, "bank", refuse)
    with pytest.raises(InputError) as error:
        which_sensor(every)
    assert error.value.finding.what == str(asked)


def test_the_command_line_asks_about_every_sensor_only_where_a_bank_decides(cli, flights, monkeypatch, tmp_path):
    asked = []

    def run(out, progress, every=False):
        asked.append(every)
        return flights

    monkeypatch.setattr(demonstration, "which_sensor_demo", run)
    command = ("demo", "which-sensor", "--out", tmp_path / "new")
    assert [cli(*command)[0], cli(*command, "--every")[0]] == [0, 0]
    assert asked == [False, True]
    code, _, err = cli("demo", "airliner", "--every", "--out", tmp_path / "new")
    assert code == 2 and "which-sensor --every" in err
    assert not (tmp_path / "new").exists()
