# SPDX-License-Identifier: BSD-3-Clause
"""The monitor: which sensor, since when, how sure, and the same rows however the samples are cut."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from faultrecon.finding import Impossible, InputError
from faultrecon.plant.fault import Disturbance
from faultrecon.plant.signals import Channels, Noise
from faultrecon.runtime.building import noise_room
from faultrecon.runtime.decision import Rules

ROWS = 1200


def run(monitor, log, cuts=(), stored=False):
    """State and rows after a log that comes in pieces; stored: the state goes through a JSON text in between."""
    state, parts = monitor.start(), []
    for piece in zip(*(np.split(one, cuts) for one in log), strict=True):
        state, rows = monitor.take(state, *piece)
        parts.append(rows)
        if stored:
            state = monitor.unpack(json.loads(json.dumps(plain(monitor.pack(state)))))
    return state, {name: np.concatenate([part[name] for part in parts]) for name in monitor.columns}


def plain(value):
    """As a file would keep it; JSON writes the shortest decimals that read back as the same bits, and NaN."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    return [plain(one) for one in value] if isinstance(value, list | tuple) else value


def same(one, other):
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def step(rows=ROWS, at=400, until=900, size=0.4):
    k = np.arange(rows)
    return size * ((k >= at) & (k < until))


def odd_log(cart, drive):
    """A fault, holes, a gap, missing inputs."""
    t, u, y = drive(cart, np.random.default_rng(1), ROWS, faults={"v1": step()})
    y[150:154, 0] = y[200] = y[500:520, 2] = math.nan
    u[300] = math.nan
    keep = np.r_[0:600, 640:ROWS]
    return t[keep], u[keep], y[keep]


# ---------------------------------------------------------------- which sensor


@pytest.mark.parametrize("name", ["s1", "s2", "v1", "mix"])
def test_the_sensor_that_lies_is_named_with_start_size_and_evidence(cart, cart_monitor, drive, name):
    log = drive(cart, np.random.default_rng(2), ROWS, faults={name: step()})
    state, rows = run(cart_monitor, log)
    (event,) = [e for e in cart_monitor.events(state) if e.mode == "fault"]
    assert event.fault == name
    assert 20.0 < event.start < 20.0 + 2 * 10 * 0.05 + 1.0
    assert event.end > 45.0
    bound = rows[f"f_{name}_bound"].max()
    assert abs(event.size[name] - 0.4) <= bound
    named = [e for e in event.evidence if e.hypothesis == name]
    assert named[0].margin <= 1.0
    assert named[0].acting > 1.0
    assert event.runner_up in set(cart.signals.y) - {name}
    assert all(e.rejected >= 5 for e in event.evidence if e.hypothesis != name)
    assert set(rows["fault"]) == {"", name}


def test_a_healthy_log_is_tracked_and_says_nothing_else(cart, cart_monitor, drive):
    state, rows = run(cart_monitor, drive(cart, np.random.default_rng(3), ROWS))
    assert [e.mode for e in cart_monitor.events(state)] == ["tracking"]
    assert list(dict.fromkeys(rows["mode"])) == ["warming", "tracking"]


def test_the_estimate_stays_within_the_bound_that_is_printed(cart, cart_monitor, drive):
    fault = step()
    _, rows = run(cart_monitor, drive(cart, np.random.default_rng(4), ROWS, faults={"s1": fault}))
    assert np.all(np.abs(rows["f_s1"] - fault) <= rows["f_s1_bound"])


def test_two_faults_in_sequence_are_followed(cart, cart_monitor, drive):
    faults = {"s1": step(1600, 400, 700), "mix": step(1600, 1000, 1400)}
    state, _ = run(cart_monitor, drive(cart, np.random.default_rng(5), 1600, faults=faults))
    events = [(e.fault, e.mode) for e in cart_monitor.events(state) if e.mode == "fault"]
    assert events == [("s1", "fault"), ("mix", "fault")]


def test_a_spike_of_thirty_deviations_names_nobody(cart, by_hand, drive):
    t, u, y = drive(cart, np.random.default_rng(6), ROWS)
    y[150::150, 1] += 0.3
    monitor = by_hand(cart).monitor(crest=1.0)
    state, _ = run(monitor, (t, u, y))
    assert [e.mode for e in monitor.events(state)] == ["tracking"]


@pytest.mark.parametrize("size", [1.0, 40.0, 1e4])
def test_a_spike_of_any_size_never_names_another_sensor(cart, by_hand, drive, size):
    """The observers that read the sensor remember the worst of spikes for longer than a window."""
    t, u, y = drive(cart, np.random.default_rng(6), 2 * ROWS)
    y[400, 1] += size
    monitor = by_hand(cart).monitor(crest=1.0)
    state, rows = run(monitor, (t, u, y))
    assert set(rows["fault"]) <= {"", "s2"}
    assert monitor.events(state)[-1].mode == "tracking"


def test_two_sensors_of_the_same_thing_alone_are_both_suspected(cart, by_hand, drive):
    """With s1 and s2 only, and nothing that says which of them is right but the spring itself, which is disturbed."""
    y = Channels(("s1", "s2"), ranges=(2.0, 2.0))
    two = replace(
        cart,
        signals=replace(cart.signals, y=y),
        C=cart.C[:2],
        D=cart.D[:2],
        noise=Noise(0.05, (0.01,) * 2),
        disturbances=(Disturbance("push", {"v": 1.0}, size=2.0),),
        operating_point=None,
    )
    monitor = by_hand(two).monitor(spans=(0.5,), window=10, crest=1.0)
    log = drive(two, np.random.default_rng(7), ROWS, faults={"s1": step(size=1.0)}, crest=0.05)
    state, rows = run(monitor, log)
    suspects = [e for e in monitor.events(state) if e.mode == "suspect"]
    assert suspects
    assert {frozenset(e.fault.split(" or ")) for e in suspects} == {frozenset({"s1", "s2"})}
    assert set(rows["s1_quality"][600:800]) == {"uncertain"}


def test_what_nothing_explains_is_out_of_envelope(cart, cart_monitor, drive):
    faults = {name: size * step(until=ROWS) for name, size in (("s1", 1.0), ("v1", -3.0), ("mix", 5.0))}
    state, rows = run(cart_monitor, drive(cart, np.random.default_rng(8), ROWS, faults=faults))
    assert cart_monitor.events(state)[-1].mode == "out_of_envelope"
    assert set(rows["mix_quality"][-50:]) == {"uncertain"}


def test_a_disturbance_of_ten_times_its_size_is_said_to_break_the_bounds(cart, cart_monitor, drive):
    state, _ = run(cart_monitor, drive(cart, np.random.default_rng(9), 4 * ROWS, crest=10.0))
    modes = {e.mode for e in cart_monitor.events(state)}
    assert modes & {"suspect", "out_of_envelope"}


def test_a_set_of_faults_that_act_together_is_named_as_one(cart, by_hand, drive):
    monitor = by_hand(cart, together=(("s1", "s2"),)).monitor(spans=(0.5, 2.5), window=10, crest=1.0)
    both = {"s1": step(until=ROWS), "s2": -step(until=ROWS)}
    state, rows = run(monitor, drive(cart, np.random.default_rng(10), ROWS, faults=both))
    last = monitor.events(state)[-1]
    assert (last.mode, last.fault) == ("fault", "s1 + s2")
    assert set(last.size) == {"s1", "s2"}
    assert set(rows["s1_quality"][-50:]) == set(rows["s2_quality"][-50:]) == {"corrected"}


def test_a_corrected_sensor_reads_what_a_healthy_one_would(cart, cart_monitor, drive):
    t, u, y = drive(cart, np.random.default_rng(11), ROWS)
    _, rows = run(cart_monitor, (t, u, y + step()[:, None] * [1.0, 0.0, 0.0, 0.0]))
    corrected = rows["s1_quality"] == "corrected"
    assert corrected.sum() > 400
    bound = rows["f_s1_bound"] + 5 * 0.01  # and the noise of the healthy reading it is compared with
    assert np.all(np.abs(rows["s1_corrected"] - y[:, 0])[corrected] <= bound[corrected])


# ---------------------------------------------------------------- samples as they come


def test_the_modes_of_a_stream_with_holes(cart, cart_monitor, drive):
    t, u, y = drive(cart, np.random.default_rng(12), ROWS)
    y[500:505] = math.nan
    keep = np.r_[0:700, 760:ROWS]
    _, rows = run(cart_monitor, (t[keep], u[keep], y[keep]))
    assert set(rows["mode"][500:505]) == {"unobserved"}
    assert rows["mode"][700] == "stale"
    assert rows["mode"][699] == rows["mode"][-1] == "tracking"
    assert rows["f_s1_bound"][700] > 2 * rows["f_s1_bound"][699]
    assert set(rows["s1_quality"][500:505]) == {"predicted"}


def test_after_a_gap_no_fault_is_made_up(cart, cart_monitor, drive):
    for seed in range(5):
        t, u, y = drive(cart, np.random.default_rng(20 + seed), ROWS)
        keep = np.sort(np.random.default_rng(seed).choice(ROWS, ROWS - 300, replace=False))
        state, _ = run(cart_monitor, (t[keep], u[keep], y[keep]))
        assert {e.mode for e in cart_monitor.events(state)} <= {"warming", "tracking"}


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("cuts", [(1,), (399, 400, 401), (152, 201, 505), tuple(range(1, 1160))])
def test_where_the_samples_are_cut_changes_no_bit(cart, cart_monitor, drive, cuts, stored):
    log = odd_log(cart, drive)
    whole, rows = run(cart_monitor, log)
    parts, again = run(cart_monitor, log, cuts, stored)
    same(rows, again)
    assert plain(cart_monitor.pack(parts)).keys() == plain(cart_monitor.pack(whole)).keys()
    assert json.dumps(plain(cart_monitor.pack(parts))) == json.dumps(plain(cart_monitor.pack(whole)))
    assert cart_monitor.events(parts) == cart_monitor.events(whole)


def test_longer_than_a_block_is_the_same_as_in_pieces(cart, cart_monitor, drive):
    log = drive(cart, np.random.default_rng(14), 9000, faults={"s2": step(9000, 4000, 4200)})
    _, whole = run(cart_monitor, log)
    same(whole, run(cart_monitor, log, (17, 4095, 4097, 8191))[1])


def test_no_rows_in_no_rows_out(cart_monitor):
    state, rows = cart_monitor.take(cart_monitor.start(), np.empty(0), np.empty((0, 1)), np.empty((0, 4)))
    assert {len(column) for column in rows.values()} == {0}
    assert state.samples == 0
    assert {len(column) for column in cart_monitor.finish(state).values()} == {0}


def test_time_goes_forward_and_shapes_fit(cart, cart_monitor, drive):
    t, u, y = drive(cart, np.random.default_rng(15), 20)
    state, _ = cart_monitor.take(cart_monitor.start(), t, u, y)
    for wrong in ((t, u, y), (t[::-1] + 9.0, u, y), (t + 9.0, u, y[:, :3]), (t + 9.0, u[:5], y)):
        with pytest.raises(InputError):
            cart_monitor.take(state, *wrong)
    after, _ = cart_monitor.take(state, t + 1.0, u, y)
    assert after.samples == 40


@pytest.mark.parametrize("broken", [{}, {"t": 0.0}, {"estimators": [[0.0]] * 4}, None])
def test_a_state_of_something_else_is_refused(cart_monitor, broken):
    whole = cart_monitor.pack(cart_monitor.start())
    packed = broken if broken is None else {**whole, **broken} if broken else {}
    if broken == {"t": 0.0}:
        packed = {**whole, "standing": {"mode": 1, "unheard": 2, "candidates": []}}
    with pytest.raises(InputError):
        cart_monitor.unpack(packed)


def test_of_events_that_are_over_the_last_are_told_and_all_are_counted(cart, cart_monitor, drive, monkeypatch):
    monkeypatch.setattr("faultrecon.runtime.monitor.KEPT", 1)
    state, _ = run(cart_monitor, drive(cart, np.random.default_rng(16), ROWS, faults={"s1": step()}))
    assert len(state.events) == 1 < state.over


# ---------------------------------------------------------------- how it is made


def test_the_identity_tells_monitors_apart(cart, by_hand):
    options = ({}, {"window": 11}, {"policy": "hold"}, {"false_alarms": 1.0}, {"hold": "left"}, {"spans": (0.5,)})
    found = {by_hand(cart).monitor(**one).identity for one in options}
    assert len(found) == len(options)
    assert by_hand(cart).monitor().identity in found


@pytest.mark.parametrize(
    "wrong",
    [{"false_alarms": 0.0}, {"false_alarms": math.nan}, {"crest": 0.0}, {"window": 1}, {"policy": "guess"},
     {"hold": "spline"}, {"sample_time": -1.0}],
)  # fmt: skip
def test_options_that_make_no_sense_are_refused(cart, by_hand, wrong):
    with pytest.raises((InputError, Impossible)):
        by_hand(cart).monitor(**wrong)


def test_without_a_sample_time_anywhere_one_is_asked_for(cart, by_hand):
    with pytest.raises(InputError, match="sample time"):
        by_hand(replace(cart, noise=None)).monitor()


def test_fewer_false_alarms_leave_more_room_for_noise():
    rooms = [noise_room(rate, 10, 0.05, Rules()) for rate in (0.001, 0.1, 10.0)]
    assert rooms == sorted(rooms, reverse=True)


# ---------------------------------------------------------------- false alarms

RATE = 5.0  # per hour, at most: so many that some might be seen


@pytest.mark.parametrize("window", [2, 10])
def test_false_alarms_stay_below_the_rate_that_is_stated(cart, by_hand, drive, window):
    """Forty hours of noise and of disturbances within their bounds: what comes of it is far below 200 alarms."""
    T, hours = 0.5, 40.0
    push = (Disturbance("push", {"v": 1.0}, size=1e-4),)  # small, so that noise does go outside now and then
    slow = replace(cart, A=cart.A / 10.0, B=cart.B / 10.0, noise=Noise(T, (0.01,) * 4), disturbances=push)
    monitor = by_hand(slow).monitor(sample_time=T, false_alarms=RATE, window=window, crest=1.0, spans=(5.0, 25.0))
    log = drive(slow, np.random.default_rng(17), int(hours * 3600 / T), T=T)
    state, rows = run(monitor, log)
    alarms = [e for e in monitor.events(state) if e.mode not in ("tracking", "warming")]
    assert np.mean(rows["mode"] == "tracking") > 0.99
    assert len(alarms) <= RATE * hours
    looked = monitor._look(monitor.start(), *log, np.ones(len(log[0])))
    assert looked.failed.sum() > 0
