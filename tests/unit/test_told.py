# SPDX-License-Identifier: BSD-3-Clause
"""Scores of a watched log: episodes, misses, delays and false alarms against the truth."""

import json
import math

import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.io.logs import Log
from faultrecon.io.watched import watch
from faultrecon.numerics.counting import rate_interval, share_interval
from faultrecon.runtime.events import Event
from faultrecon.runtime.told import alarm_rate, aligned, scored, told

ROWS, T = 1000, 0.1


def pulse(at, until, size=1.0):
    k = np.arange(ROWS)
    return size * ((k >= at) & (k < until))


def said(*stretches, truth=None, bound=0.5):
    """Rows and events of a monitor that says (mode, name) from row to row, and is `bound` / 2 off."""
    mode, fault = np.full(ROWS, "tracking", dtype="U20"), np.full(ROWS, "", dtype="U20")
    events = []
    for word, name, a, b in stretches:
        mode[a:b] = word
        fault[a:b] = name if word == "fault" else ""
        events.append(Event(word, name, a * T, b * T, {}, "", ()))
    rows = {"t": T * np.arange(ROWS), "mode": mode, "fault": fault}
    for name, values in (truth or {}).items():
        rows |= {f"f_{name}": values + bound / 2, f"f_{name}_bound": np.full(ROWS, bound)}
    return rows, events


# ---------------------------------------------------------------- episodes


def test_two_faults_in_sequence_are_two_episodes():
    truth = {"a": pulse(200, 300, 2.0), "b": pulse(600, 800, -3.0)}
    rows, events = said(
        ("suspect", "a", 210, 230), ("fault", "a", 230, 300), ("fault", "b", 640, 800), truth=truth
    )  # fmt: skip
    found = told(rows, events, truth)
    assert [(e.fault, e.begin, e.size) for e in found.episodes] == [("a", 20.0, 2.0), ("b", 60.0, 3.0)]
    assert [e.end for e in found.episodes] == pytest.approx([29.9, 79.9])
    assert [e.noticed for e in found.episodes] == pytest.approx([1.0, 4.0])
    assert [e.named for e in found.episodes] == pytest.approx([3.0, 4.0])
    assert [e.size_error for e in found.episodes] == pytest.approx([0.25 / 2.0, 0.25 / 3.0])
    assert (found.false_alarms, found.missed) == (0, ())


def test_a_fault_that_comes_twice_is_two_episodes_and_a_short_pause_is_none():
    truth = {"a": pulse(200, 300) + pulse(310, 400) + pulse(700, 800)}
    rows, events = said()
    assert [e.begin for e in told(rows, events, truth, grace=2.0).episodes] == [20.0, 70.0]
    assert len(told(rows, events, truth, grace=0.5).episodes) == 3


def test_a_fault_that_crosses_zero_stays_one_episode():
    t = T * np.arange(ROWS)
    truth = {"a": np.where((t >= 20) & (t < 80), np.sin(0.5 * (t - 20)), 0.0)}
    assert len(told(*said(), truth, grace=2.0).episodes) == 1


def test_a_drift_counts_from_five_percent_of_its_largest_size():
    truth = {"a": np.linspace(0.0, 1.0, ROWS)}
    (one,) = told(*said(("fault", "a", 20, 900)), truth).episodes
    assert one.begin == pytest.approx(5.0, abs=T)
    assert one.named == 0.0  # named before that: no negative delay
    assert not one.missed


def test_what_rounding_makes_of_no_fault_is_no_fault():
    truth = {"a": pulse(500, 600) + 1e-12}
    rows, events = said(("fault", "a", 100, 150))
    found = told(rows, events, truth)
    assert [(e.begin, e.missed) for e in found.episodes] == [(50.0, True)]
    assert found.of_nothing == 1


def test_no_fault_is_no_episode():
    found = told(*said(), {"a": np.zeros(ROWS)})
    assert found.episodes == ()
    assert "no fault acts" in str(found)


# ---------------------------------------------------------------- missed, and named wrongly


def test_a_fault_named_wrongly_is_missed_and_a_false_alarm():
    truth = {"a": pulse(200, 400), "b": np.zeros(ROWS)}
    found = told(*said(("fault", "b", 230, 400)), truth, grace=1.0)
    (one,) = found.episodes
    assert one.missed
    assert one.noticed == pytest.approx(3.0)
    assert one.instead == ("b",)
    assert (found.false_alarms, found.of_nothing, found.false_alarms_per_hour) == (1, 0, 0.0)
    assert "1 wrong name while a fault acted" in str(found)


def test_a_name_that_comes_shortly_after_is_in_time_and_one_much_later_is_not():
    truth = {"a": pulse(200, 300)}
    rows, events = said(("fault", "a", 310, 350))
    assert told(rows, events, truth, grace=2.0).episodes[0].named == pytest.approx(11.0)
    late = told(rows, events, truth, grace=0.5)
    assert late.episodes[0].missed
    assert late.false_alarms == 1


def test_the_name_of_one_of_two_faults_says_nothing_about_the_other():
    truth = {"a": pulse(200, 600), "b": pulse(300, 600)}
    found = told(*said(("fault", "a", 220, 600)), truth)
    a, b = found.episodes
    assert not a.missed
    assert b.missed
    assert math.isnan(b.noticed)
    assert found.false_alarms == 0


def test_a_set_of_faults_names_each_of_them_and_is_false_where_one_does_not_act():
    members = {"a + b": ("a", "b")}
    both = {"a": pulse(200, 600), "b": pulse(200, 600)}
    found = told(*said(("fault", "a + b", 220, 600)), both, members=members)
    assert [e.missed for e in found.episodes] == [False, False]
    assert found.false_alarms == 0
    one = told(*said(("fault", "a + b", 220, 600)), {"a": pulse(200, 600)}, members=members)
    assert not one.episodes[0].missed
    assert one.false_alarms == 1


def test_a_fault_without_a_hypothesis_is_missed():
    found = told(*said(("out_of_envelope", "", 250, 400)), {"unheard": pulse(200, 400)})
    assert found.episodes[0].missed
    assert found.episodes[0].noticed == pytest.approx(5.0)
    assert math.isnan(found.episodes[0].inside)


# ---------------------------------------------------------------- hours, bounds


def test_hours_count_where_something_could_be_decided():
    rows, events = said(("warming", "", 0, 100), ("stale", "", 100, 101), ("fault", "a", 900, 950))
    found = told(rows, events, {"a": pulse(300, 500)}, grace=5.0)
    assert found.hours * 3600 == pytest.approx(T * (ROWS - 101))
    assert found.healthy_hours * 3600 == pytest.approx(T * (ROWS - 101 - 250), abs=1.01 * T)  # the grace is left out
    assert found.of_nothing == 1
    assert found.false_alarms_per_hour == pytest.approx(1 / found.healthy_hours)


def test_a_bound_speaks_until_another_fault_acts():
    truth = {"a": pulse(200, 400), "b": pulse(600, 800)}
    rows, events = said(truth=truth)
    rows["f_a"][700:] += 9.0
    rows["f_b"][:100] += 9.0
    found = told(rows, events, truth)
    assert found.inside == {"a": 1.0, "b": pytest.approx(0.5)}


def test_a_truth_that_is_not_known_is_neither_healthy_nor_outside():
    values = np.zeros(ROWS)
    values[500:] = math.nan
    rows, events = said(("fault", "a", 700, 800), truth={"a": np.zeros(ROWS)})
    found = told(rows, events, {"a": values})
    assert found.inside["a"] == 1.0
    assert found.healthy_hours * 3600 == pytest.approx(50.0, abs=1.01 * T)
    assert (found.false_alarms, found.of_nothing) == (1, 0)


def test_scores_are_plain_values():
    truth = {"a": pulse(200, 300)}
    found = told(*said(("fault", "a", 230, 300), truth=truth), truth)
    again = json.loads(json.dumps(found.as_dict()))
    assert again["episodes"][0]["named"] == pytest.approx(3.0)
    assert again["missed"] == 0


# ---------------------------------------------------------------- what a count says


def test_no_alarm_in_some_hours_is_up_to_three_over_them():
    low, high = rate_interval(0, 10.0)
    assert low == 0.0
    assert high == pytest.approx(-math.log(0.05) / 10.0)
    assert "at most 0.3 per hour" in alarm_rate(0, 10.0)
    assert rate_interval(3, 0.0) == (0.0, math.inf)


def test_no_miss_in_twenty_runs_is_up_to_fourteen_percent():
    assert share_interval(0, 20) == (0.0, pytest.approx(1 - 0.05 ** (1 / 20)))
    assert share_interval(20, 20) == (pytest.approx(0.05 ** (1 / 20)), 1.0)
    assert share_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize("count", [1, 7, 19])
def test_at_each_end_of_an_interval_the_count_is_one_in_twenty(count):
    from scipy.stats import binom, poisson

    low, high = share_interval(count, 20)
    assert binom.sf(count - 1, 20, low) == pytest.approx(0.05)
    assert binom.cdf(count, 20, high) == pytest.approx(0.05)
    low, high = rate_interval(count, 2.0)
    assert poisson.sf(count - 1, 2.0 * low) == pytest.approx(0.05)
    assert poisson.cdf(count, 2.0 * high) == pytest.approx(0.05)


# ---------------------------------------------------------------- of a log


def faulty(cart, drive, rows=1200):
    k = np.arange(rows)
    fault = 0.4 * ((k >= 400) & (k < 900))
    t, u, y = drive(cart, np.random.default_rng(2), rows, faults={"s1": fault})
    return t, u, y, fault


def test_noise_and_disturbances_within_their_bounds_give_no_false_alarm(cart, cart_monitor, drive):
    for seed in range(5):
        log = drive(cart, np.random.default_rng(seed), 4000, gaussian=False)
        state, rows = cart_monitor.take(cart_monitor.start(), *log)
        found = scored(cart_monitor, rows, cart_monitor.events(state), {"s1": np.zeros(4000)})
        assert found.false_alarms == 0
        assert found.inside["s1"] == 1.0


def test_a_log_holds_its_truth_as_columns(cart, by_hand, drive):
    t, u, y, fault = faulty(cart, drive)
    options = {"spans": (0.5, 2.5), "window": 10, "crest": 1.0}
    watched = watch(by_hand(cart), Log(t, u, y, {"true_f_s1": fault, "true_f_s2": 0 * fault}), **options)
    found = watched.scores()
    (one,) = found.episodes
    assert (one.fault, one.begin) == ("s1", 20.0)
    assert 0.0 < one.noticed <= one.named < 2.0
    assert one.inside == 1.0
    assert found.false_alarms == 0
    assert set(found.inside) == {"s1", "s2"}
    assert watched.as_dict()["scores"]["episodes"][0]["fault"] == "s1"
    assert "against the recorded truth:\n    s1 from 20" in str(watched)
    bare = watch(by_hand(cart), Log(t, u, y), **options)
    assert bare.scores() is None
    assert bare.as_dict()["scores"] is None
    assert "truth" not in str(bare)
    assert bare.scores({"s1": fault, "s2": 0 * fault}).as_dict() == found.as_dict()


@pytest.mark.parametrize(("truth", "message"), [({"s3": 0}, "no fault 's3'"), ({"s1": 7}, "one value for each")])
def test_a_truth_that_does_not_fit_is_refused(cart, by_hand, drive, truth, message):
    t, u, y, _ = faulty(cart, drive, 200)
    watched = watch(by_hand(cart), Log(t, u, y))
    with pytest.raises(InputError, match=message):
        watched.scores({name: np.zeros(200 - off) for name, off in truth.items()})


def test_rows_that_came_late_or_twice_change_no_score(cart, by_hand, drive):
    """The truth is put beside the rows by time, wherever in the file it stood."""
    t, u, y, fault = faulty(cart, drive)
    options = {"spans": (0.5, 2.5), "window": 10, "crest": 1.0, "sample_time": 0.05, "reorder": 1.0}
    ordered = watch(by_hand(cart), Log(t, u, y, {"true_f_s1": fault}), **options)
    order = np.arange(len(t))
    order[395:405] = order[395:405][::-1]
    order = np.insert(order, 600, 590)  # a row twice
    mixed = Log(t[order], u[order], y[order], {"true_f_s1": fault[order]})
    watched = watch(by_hand(cart), mixed, **options)
    assert watched.counts.received == len(t) + 1
    assert len(watched.table["t"]) == len(t)
    assert watched.scores().as_dict() == ordered.scores().as_dict()


def test_values_are_put_beside_rows_by_time():
    times = np.array([0.0, 2.0, 1.0, math.nan, 2.0])
    values = np.array([5.0, 7.0, 6.0, 99.0, 98.0])
    assert aligned(np.array([0.0, 1.0, 2.0]), times, values).tolist() == [5.0, 6.0, 7.0]
    assert np.isnan(aligned(np.array([0.0]), np.array([math.nan]), np.array([1.0]))).all()
