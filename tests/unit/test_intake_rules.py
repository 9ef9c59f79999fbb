# SPDX-License-Identifier: BSD-3-Clause
"""Each row of the table in docs/reference/imperfect_samples.md, and the doors to the intake."""

import json
import math
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import faultrecon as fr
from faultrecon.finding import InputError
from faultrecon.io.logs import orderly, read_log
from faultrecon.io.plantfile import parse_plant
from faultrecon.io.plantwrite import plant_text
from faultrecon.io.plausibility import unit_doubts
from faultrecon.plant.signals import Channels, Signals
from faultrecon.plant.stored import plant_from_dict
from faultrecon.runtime.intake import Intake, IntakeState
from faultrecon.runtime.intake_counts import Flag
from faultrecon.runtime.intake_watch import FINE, HOLDS, RARE, Watch, independent

NAN, INF = math.nan, math.inf
H = 0.1
Y = (Watch("encoder", -1.0, 1.0), Watch("tacho"))
TOML = """\
schema = 1
name = "drive"
[signals]
x = ["angle", "speed"]
u = ["voltage"]
y = ["encoder [rad]", "tacho"]
range = { encoder = 1.0 }
limits = { encoder = [-3.2, 3.2], voltage = [-24, inf] }
[noise]
hold = 0.1
sd = { encoder = 1e-3, tacho = 0.0 }
[matrices]
A = [[0, 1], [0, -1]]
B = [[0], [1]]
C = [[1, 0], [0, 1]]
[[fault]]
name = "f"
sensor = "tacho"
"""


def intake(**options):
    return Intake(H, (Watch("voltage"),), options.pop("y", Y), **options)


def taken(rows, **options):
    """What comes out of rows (t, voltage, encoder, tacho)."""
    x = np.array(rows, dtype=float).reshape(-1, 4)
    return intake(**options).whole(x[:, 0], x[:, 1:2], x[:, 2:])


def steady(t, *, encoder=None, tacho=None):
    """Rows at these times, with changing values where none are given."""
    k = np.arange(len(t))
    encoder, tacho = 0.01 * k if encoder is None else encoder, 2.0 * k if tacho is None else tacho
    return list(zip(t, 0.5 * k, encoder, tacho, strict=True))


def flags(out, name):
    return out.flags_y[:, [w.name for w in Y].index(name)].tolist()


# ---------------------------------------------------------------- rows


def test_a_row_out_of_order_is_put_in_its_place_while_rows_wait():
    out = taken(steady([0.0, 0.2, 0.1, 0.3]), reorder=0.15)
    assert out.t.tolist() == [0.0, 0.1, 0.2, 0.3] and out.arrival.tolist() == [0, 2, 1, 3]
    assert (out.counts.reordered, out.counts.late) == (1, 0)


def test_a_row_older_than_what_has_left_is_too_late_and_counted():
    out = taken(steady([0.0, 0.2, 0.1, 0.3]))
    assert out.t.tolist() == [0.0, 0.2, 0.3]
    assert (out.counts.late, out.counts.lateness) == (1, pytest.approx(0.1))
    (found, _) = intake().findings(out.counts)
    assert "1 of 4 rows came too late" in str(found) and "reorder=0.2" in str(found)


def test_a_row_that_repeats_the_one_before_is_a_duplicate():
    rows = [(0.0, 1.0, 0.5, NAN), (0.0, 1.0, 0.5, NAN), (0.1, 1.0, 0.6, 2.0)]
    for reorder in (0.0, 0.5):
        out = taken(rows, reorder=reorder)
        assert (len(out), out.counts.duplicates) == (2, 1)


def test_rows_of_one_time_with_different_channels_become_one():
    out = taken([(0.0, 1.0, NAN, NAN), (0.0, NAN, 0.5, NAN), (0.0, NAN, NAN, 3.0)], reorder=H)
    assert (out.u.tolist(), out.y.tolist()) == ([[1.0]], [[0.5, 3.0]])
    assert (out.counts.merged, out.counts.missing) == (2, (0, 0, 0))


def test_of_two_values_at_one_time_the_first_stays_and_the_other_is_counted():
    out = taken([(0.0, 1.0, 0.5, 3.0), (0.0, 1.0, 0.25, 3.0)], reorder=H)
    assert out.y.tolist() == [[0.5, 3.0]]
    assert out.counts.conflicts == (0, 1, 0)
    assert taken([(0.0, 1.0, 0.5, 3.0), (0.0, 1.0, 0.25, 3.0)]).counts.conflicts == (0, 1, 0)


def test_a_row_without_a_time_is_counted_and_left_out():
    out = taken(steady([0.0, NAN, 0.1, INF, 0.2]))
    assert out.t.tolist() == [0.0, 0.1, 0.2] and out.counts.bad_time == 2


def test_one_time_far_ahead_does_not_make_all_others_late():
    out = taken(steady([0.0, 0.1, 1e9, 0.2, 0.3]), leap=10.0)
    assert out.t.tolist() == [0.0, 0.1, 0.2, 0.3] and (out.counts.bad_time, out.counts.late) == (1, 0)
    believing = taken(steady([0.0, 0.1, 1e9, 0.2, 0.3]))
    assert believing.counts.late == 2
    assert "leap=" in str(intake().findings(believing.counts)[0])


def test_a_clock_that_has_really_leapt_is_believed_at_the_second_row():
    out = taken(steady([0.0, 0.1, 1000.0, 1000.1, 1000.2]), leap=10.0)
    assert out.t.tolist() == [0.0, 0.1, 1000.1, 1000.2] and out.counts.bad_time == 1


def test_an_interval_longer_than_one_and_a_half_samples_says_how_many_rows_it_lacks():
    out = taken(steady([0.0, 0.1, 0.24, 0.4, 1.0]))
    assert out.lacking.tolist() == [0.0, 0.0, 0.0, 1.0, 5.0]
    assert (out.counts.gaps, out.counts.gap_rows) == (2, 6)


def test_a_flush_lets_all_rows_go_and_takes_more_afterwards():
    one = intake(reorder=1.0)
    state, first = one.take(one.init(), 0.0, [1.0], [0.1, 2.0])
    assert len(first) == 0 and "1 waiting" in repr(state)
    state, last = one.flush(state)
    assert last.t.tolist() == [0.0]
    state, more = one.take(state, 0.0, [1.0], [0.2, 2.0])
    assert (len(more), state.counts.late) == (0, 1)


# ---------------------------------------------------------------- values


def test_a_value_that_did_not_come_is_flagged_missing():
    out = taken([(0.0, NAN, 0.5, NAN)])
    assert out.flags_u.tolist() == [[Flag.MISSING]] and out.flags_y.tolist() == [[Flag.GOOD, Flag.MISSING]]
    assert out.counts.missing == (1, 0, 1)


def test_a_value_beyond_its_limits_or_infinite_counts_as_missing():
    out = taken(steady([0.0, 0.1, 0.2], encoder=[0.5, 1.1, 0.5], tacho=[1.0, 2.0, -INF]))
    assert np.isnan(out.y[1, 0]) and np.isnan(out.y[2, 1]) and np.isfinite(out.y[0]).all()
    assert flags(out, "encoder") == [0, Flag.OUT_OF_LIMITS, 0] and out.counts.out_of_limits == (0, 1, 1)


def test_a_value_at_a_limit_counts_as_missing_from_the_third_sample_on():
    out = taken(steady(H * np.arange(7), encoder=[0.5, 1.0, 1.0, 1.0, 1.0, 0.9, 1.0]))
    assert flags(out, "encoder") == [0, 0, 0, Flag.SATURATED, Flag.SATURATED, 0, 0]
    assert np.isnan(out.y[3:5, 0]).all() and out.counts.saturated == (0, 2, 0)


def test_limits_rounded_to_single_precision_are_still_the_limits():
    y = (Watch("encoder", -0.1, 0.1), Y[1])
    out = taken(steady(H * np.arange(5), encoder=[float(np.float32(0.1))] * 5), y=y)
    assert flags(out, "encoder") == [0, 0, 3, 3, 3]  # 0.1 in single precision is 1.5e-9 beyond


def test_a_value_that_stands_still_longer_than_its_noise_allows_is_flagged_and_passed_on():
    y = (Y[0], Watch("tacho", sd=0.1, hold=H))
    rng = np.random.default_rng(2)
    tacho = 0.1 * rng.standard_normal(100)
    tacho[40:80] = tacho[40]
    out = taken(steady(H * np.arange(100), tacho=tacho), y=y)
    assert np.flatnonzero(out.flags_y[:, 1]).tolist() == list(range(59, 80))  # from the twentieth on, until it moves
    assert np.array_equal(out.y[:, 1], tacho) and out.counts.frozen == (0, 0, 21)


def test_a_channel_that_comes_in_every_fourth_row_is_judged_by_its_own_samples():
    y = (Y[0], Watch("tacho", sd=0.1, hold=H))
    tacho = np.full(200, NAN)
    tacho[::4] = 1.0
    tacho[:40:4] = 1.0 + 0.01 * np.arange(10)
    out = taken(steady(H * np.arange(200), tacho=tacho), y=y)
    assert np.flatnonzero(out.flags_y[:, 1] == Flag.FROZEN)[0] == 40 + 4 * 19


def test_a_channel_without_noise_is_never_frozen_unless_asked():
    rows = steady(H * np.arange(100), tacho=np.ones(100))
    assert not taken(rows).flags_y.any()
    asked = taken(rows, y=(Y[0], Watch("tacho", still=5)))
    assert flags(asked, "tacho") == [0] * 4 + [Flag.FROZEN] * 96


@pytest.mark.parametrize("q", [0.05, 0.2, 0.5, 1.0, 2.0, 4.0])
def test_noise_in_coarse_steps_is_not_called_frozen(q):
    """100 sensors for 20 000 samples, at the place where a step swallows most of the noise: its middle.

    Each run is called frozen with a probability below 1e-12, and there are at most 2e6 runs.
    """
    rng = np.random.default_rng(int(100 * q))
    N, p = 20_000, 100
    y = np.round(0.05 * rng.standard_normal((N, p)) / (0.05 * q)) * (0.05 * q)
    one = Intake(H, (), tuple(Watch(f"y{j}", sd=0.05, hold=H) for j in range(p)))
    assert sum(one.whole(H * np.arange(N), np.empty((N, 0)), y).counts.frozen) == 0


def test_the_number_of_samples_is_the_smallest_that_makes_chance_rare():
    for ratio in (0.5, 1.0, 3.0):
        p, K = math.erf(ratio / math.sqrt(8)), independent(ratio)
        assert p**K <= RARE < p ** (K - 1)
    assert independent(FINE) == HOLDS and independent(0.0) == HOLDS and independent(100.0) > 10**15


def test_a_sensor_dead_from_the_first_sample_is_found_after_318_holds():
    """Its step is not known, so it is taken for the largest that its noise allows: √12 σ."""
    y = (Y[0], Watch("tacho", sd=0.1, hold=H))
    out = taken(steady(H * np.arange(1000), tacho=np.ones(1000)), y=y)
    assert np.flatnonzero(out.flags_y[:, 1])[0] == independent(math.sqrt(12)) == 318


# ---------------------------------------------------------------- doors


@pytest.mark.parametrize(
    "call",
    [
        lambda: Intake(0.0, (), Y),
        lambda: Intake(H, (), ()),
        lambda: Intake(H, (), Y, reorder=-1.0),
        lambda: Intake(H, (), Y, reorder=NAN),
        lambda: Intake(H, (), Y, leap=0.0),
        lambda: Watch("a", 1.0, 1.0),
        lambda: Watch("a", sd=-1.0),
        lambda: Watch("a", touches=1),
        lambda: intake().whole([0.0], [[1.0]], [[1.0]]),
        lambda: intake().whole([0.0, 1.0], [[1.0]], [[1.0, 2.0]]),
        lambda: intake().whole([[0.0]], [[1.0]], [[1.0, 2.0]]),
        lambda: intake().whole([0.0], [["a"]], [[1.0, 2.0]]),
        lambda: Intake.of(parse_plant(TOML), still={"tachoo": 5}),
        lambda: IntakeState.unpack({}),
        lambda: IntakeState.unpack({**intake().init().pack(), "seen_y.value": np.zeros(5)}),
        lambda: IntakeState.unpack({**intake().init().pack(), "waiting.newest": "soon"}),
    ],
)
def test_what_makes_no_sense_is_refused(call):
    with pytest.raises(InputError):
        call()


def test_an_intake_takes_limits_and_noise_from_the_plant():
    one = Intake.of(parse_plant(TOML), reorder=0.5, still={"voltage": 30})
    assert one.names == ("voltage", "encoder", "tacho") and one.sample_time == 0.1
    assert (one.u[0].low, one.u[0].high, one.u[0].still) == (-24.0, INF, 30)
    assert (one.y[0].high, one.y[0].sd, one.y[0].hold) == (3.2, 1e-3, 0.1) and not one.y[1].judged


def test_counts_are_plain_values_with_names():
    told = taken([(0.0, 1.0, NAN, 5.0), (0.0, 2.0, NAN, 5.0)], reorder=1.0).counts.as_dict(intake().names)
    assert json.loads(json.dumps(told)) == told
    assert (told["missing"], told["conflicts"], told["frozen"]) == ({"encoder": 1}, {"voltage": 1}, {})


def test_every_finding_has_its_numbers_and_a_remedy():
    y = (Y[0], Watch("tacho", still=2))
    rows = steady([0.0, 0.1, 0.2, NAN, 0.1, 0.9], encoder=[1.0] * 5 + [7.0], tacho=[3.0] * 6)
    out = taken([*rows, (0.9, 7.0, NAN, NAN)], y=y)
    found = intake(y=y).findings(out.counts)
    assert len(found) == 7 and all(f.what and f.evidence and f.remedies for f in found)
    assert intake().findings(taken(steady([0.0, 0.1])).counts) == ()


def test_the_estimator_takes_what_the_intake_lets_through():
    design = fr.design(fr.library("airliner"), "open-loop")
    plant = design.plant
    rng = np.random.default_rng(4)
    t = 0.01 * np.arange(60) + rng.choice([0.0, 0.0, 0.05, NAN], 60)
    u, y = rng.standard_normal((60, len(plant.signals.u))), rng.standard_normal((60, plant.p))
    y[rng.random(y.shape) < 0.1] = INF
    out = Intake.of(plant, 0.01, reorder=0.03).whole(t, u, y)
    trace = design.estimator(0.01).replay(out.t, out.u, out.y)
    assert len(trace) == out.counts.passed > 20
    assert np.array_equal(trace.ok, np.isfinite(out.y))


# ---------------------------------------------------------------- limits of signals


def test_limits_survive_the_plant_file_and_the_stored_plant():
    plant = parse_plant(TOML)
    assert plant.signals.u.limits == ((-24.0, INF),) and plant.signals.y.limited() == {"encoder": (-3.2, 3.2)}
    assert parse_plant(plant_text(plant)).digest() == plant.digest()
    assert plant_from_dict(plant.to_dict()).signals.y.limits == plant.signals.y.limits


def test_a_plant_without_limits_is_stored_as_before():
    plain = parse_plant(TOML.replace("limits =", "# limits ="))
    assert "limits" not in plain.to_dict()["signals"]["y"] and "limits" not in plant_text(plain)
    assert plain.digest() != parse_plant(TOML).digest()


@pytest.mark.parametrize(
    ("written", "answer"),
    [
        ("{ encoder = [3.2, -3.2] }", "plant.toml:8  signals.limits.encoder: is [3.2, -3.2]"),
        ("{ encoder = [3.2] }", "give [low, high]"),
        ("{ encoder = 3.2 }", "put it in [ ]"),
        ("{ encoder = [inf, inf] }", "give [low, high]"),
        ("{ angle = [0, 1] }", "there is no input or sensor 'angle'"),
        ("{ encodr = [0, 1] }", "did you mean 'encoder'?"),
    ],
)
def test_limits_that_make_no_sense_are_refused_with_their_line(written, answer):
    with pytest.raises(InputError) as caught:
        parse_plant(TOML.replace("{ encoder = [-3.2, 3.2], voltage = [-24, inf] }", written))
    assert answer in str(caught.value) and "plant.toml:8" in str(caught.value)


def test_a_state_has_no_limits():
    limited = Channels(("a",), limits=((0.0, 1.0),))
    with pytest.raises(InputError, match="the state a has limits"):
        Signals(limited, Channels(()), Channels(("y",)))
    with pytest.raises(InputError, match="limits of a"):
        replace(limited, limits=((1.0, 0.0),))


# ---------------------------------------------------------------- recordings as they came


def test_a_log_read_as_it_came_keeps_rows_that_are_refused_otherwise(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("t,voltage,encoder,tacho,mark\n0,1,,2,7\n0.2,1,0.1,inf,8\n,1,0.1,2,9\n0.1,1,0.2,3,10\n0,1,5,2,11\n")
    signals = parse_plant(TOML).signals
    with pytest.raises(InputError):
        read_log(file, signals)
    log = read_log(file, signals, as_it_came=True)
    assert np.array_equal(log.t, [0.0, 0.2, NAN, 0.1, 0.0], equal_nan=True) and log.y[1, 1] == INF
    ordered, out = orderly(log, Intake.of(parse_plant(TOML), reorder=1.0))
    assert ordered.t.tolist() == [0.0, 0.1, 0.2] and ordered.extra["mark"].tolist() == [7.0, 10.0, 8.0]
    assert dict(ordered.missing) == {"encoder": 1, "tacho": 1}
    assert (out.counts.bad_time, out.counts.reordered, out.counts.merged, out.counts.received) == (1, 2, 1, 5)


def test_dates_out_of_order_and_absent_are_seconds_from_the_first_row_that_has_one(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text(
        "time,voltage,encoder,tacho\n,1,2,3\n2026-03-01T12:00:01Z,1,2,3\n,1,2,3\n2026-03-01T12:00:00Z,1,2,3\n"
    )
    signals = parse_plant(TOML).signals
    log = read_log(file, signals, as_it_came=True)
    assert np.array_equal(log.t, [NAN, 0.0, NAN, -1.0], equal_nan=True)
    assert log.start is not None and log.start.isoformat() == "2026-03-01T12:00:01+00:00"
    text = pa.array(["2026-03-01T12:00:01Z", None, "noon"]).dictionary_encode()
    one = pa.array([1.0] * 3)
    table = pa.table({"t": text, "voltage": one, "encoder": one, "tacho": one})
    pq.write_table(table, tmp_path / "log.parquet")
    with pytest.raises(InputError, match="row 3 is 'noon'"):
        read_log(tmp_path / "log.parquet", signals, as_it_came=True)


def test_units_are_doubted_before_limits_take_the_evidence_away():
    plant = parse_plant(TOML)
    t = np.array([0.0, 300.0, 100.0, NAN, 200.0])
    y = np.column_stack([[0.0, 57.3, 10.0, 20.0, INF], np.zeros(5)])
    found = unit_doubts(plant, t, np.zeros((5, 1)), y)
    assert len(found) == 2 and "time in other units" in found[0] and "encoder goes to 57.3 times" in found[1]
