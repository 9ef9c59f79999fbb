# SPDX-License-Identifier: BSD-3-Clause
"""Faults that multiply a sensor: when they can be known, how well, and what nobody can tell from them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import faultrecon as fr
from faultrecon.diagnosis.possibility import possibility
from faultrecon.diagnosis.possibility_along import Course, Trajectory, model_run
from faultrecon.diagnosis.possibility_model import Equations
from faultrecon.diagnosis.possibility_points import ranked, region_of
from faultrecon.diagnosis.sensors import fault_sets
from faultrecon.numerics.information import (
    biases,
    indistinguishable,
    least_deviations,
    norms_of_products,
)
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.signals import Noise

GAIN = FaultChannel("lost gain", {"gauge": 1.0}, effect="multiplicative")


def tank(rate=-0.5, gain=2.0, level=3.0, noise=0.01, **more):
    """One state that settles, a gauge that loses gain; at rest at its operating point."""
    signals = fr.Signals(
        fr.Channels(("level",), ("m",), (1.0,)), fr.Channels(("inflow",), ("",), (0.3,)), fr.Channels(("gauge",))
    )
    return fr.Plant(
        "tank",
        signals,
        [[rate]],
        [[gain]],
        [[1.0]],
        [[0.0]],
        faults=(GAIN,),
        noise=Noise(0.1, (noise,)),
        operating_point=fr.OperatingPoint((level,), (1.0,), (level,)),
        **more,
    )


def with_healthy(plant, sd=0.01):
    """The same with a second, healthy sensor of the first state."""
    x0 = plant.point.x
    y = fr.Channels((*plant.signals.y.names, "twin"))
    row = np.eye(1, plant.n)
    return replace(
        plant,
        signals=replace(plant.signals, y=y),
        C=np.vstack([plant.C, row]),
        D=np.vstack([plant.D, np.zeros((1, plant.D.shape[1]))]),
        noise=Noise(plant.noise.hold, (*plant.noise.sd, sd)),
        operating_point=replace(plant.point, y=(*plant.point.y, x0[0])),
    )


# ---------------------------------------------------------------- rank


def test_the_gain_of_a_sensor_on_a_settling_tank_shows_while_it_is_slow():
    found = possibility(tank())
    assert found.rank.separable == found.rank.points and not found.any_waveform
    assert fr.diagnose(tank()).possible


def test_a_gain_on_a_tank_that_only_integrates_is_refused():
    # With nothing flowing in, y = (1 + f) x stays where it is, whatever f.
    rest = tank(rate=0.0)
    still = replace(rest, B=np.zeros((1, 1)))
    diagnosis = fr.diagnose(still)
    assert not diagnosis.possible
    assert "do not tell even a constant lost gain from the state" in diagnosis.together.findings[0].what


@pytest.mark.parametrize("noise", [0.01, 0.3])
def test_a_healthy_twin_makes_the_rank_full_and_any_waveform_possible(noise):
    still = replace(tank(rate=0.0), B=np.zeros((1, 1)))
    assert not fr.diagnose(still).possible
    found = possibility(with_healthy(still, noise))
    assert found.rank.full == found.rank.points and found.any_waveform
    assert fr.diagnose(with_healthy(still, noise)).possible


def test_a_sensor_that_reads_zero_where_the_plant_works_is_refused():
    plant = tank(level=0.0)
    bare = replace(plant, signals=replace(plant.signals, x=fr.Channels(("level",), ("m",))))
    diagnosis = fr.diagnose(bare)
    assert not diagnosis.possible and "gauge reads 0 at the operating point" in str(diagnosis)
    assert any("trajectory" in remedy for remedy in diagnosis.together.findings[0].remedies)


def test_a_region_in_which_a_sensor_may_read_zero_is_warned_of():
    found = possibility(tank(level=0.5))  # the level's range is one metre
    (warning,) = [f for f in found.findings if "may read 0" in f.what]
    assert warning.severity == "warning" and warning.evidence["threshold"] > 0


def test_a_trajectory_away_from_zero_shows_what_the_operating_point_hides():
    plant = tank(level=0.0)
    bare = replace(plant, signals=replace(plant.signals, x=fr.Channels(("level",), ("m",))))
    t = 0.1 * np.arange(300)
    u = 1.0 + 0.5 * (1 + np.sin(t)[:, None])
    path = (t, u, model_run(bare, t, u, [2.0]))
    assert fr.diagnose(bare, trajectory=path).possible and not fr.diagnose(bare).possible


SMALL = st.floats(0.2, 3.0).map(lambda v: round(v, 3))


@settings(max_examples=15, deadline=None)
@given(st.tuples(SMALL, SMALL, SMALL, SMALL), st.integers(0, 2**31))
def test_a_linear_plant_at_rest_shows_a_gain_unless_it_integrates(rates, seed):
    """[A 0; C diag(h) F] has full column rank exactly where A is not singular, whatever the basis of the state."""
    basis = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    for slow, expected in ((rates[0], True), (0.0, False)):
        A = basis @ np.diag([-slow, -rates[1] - 4.0, -rates[2] - 8.0]) @ basis.T
        C = (basis @ np.ones(3))[None, :]
        plant = replace(
            tank(),
            signals=fr.Signals(fr.Channels(("a", "b", "c")), fr.Channels(()), fr.Channels(("gauge",))),
            A=A,
            B=np.zeros((3, 0)),
            C=C,
            D=np.zeros((1, 0)),
            operating_point=fr.OperatingPoint((0.0,) * 3, (), (rates[3],)),
        )
        assert (ranked(plant, region_of(plant)).separable == 1) is expected


def test_units_of_the_state_change_no_answer():
    plant = tank()
    milli = replace(
        plant,
        signals=replace(plant.signals, x=fr.Channels(("level",), ("mm",), (1000.0,))),
        B=plant.B * 1000.0,
        C=plant.C / 1000.0,
        operating_point=replace(plant.point, x=(3000.0,)),
    )
    one, other = possibility(plant), possibility(milli)
    assert other.rank.smallest == pytest.approx(one.rank.smallest, rel=1e-9)
    for a, b in zip(one.windows, other.windows, strict=True):
        assert b.deviation["lost gain"] == pytest.approx(a.deviation["lost gain"], rel=1e-9)


# ---------------------------------------------------------------- least deviations


def test_the_least_deviation_at_rest_is_the_textbook_one():
    """At rest y_k = x0 + e^(-t/2) δ + f x0: f is the constant and the initial error a regressor beside it."""
    found = possibility(tank()).windows[0]
    k = np.arange(round(found.length / 0.1) + 1)
    J = np.column_stack([np.exp(-0.05 * k), np.full(len(k), 3.0)]) / 0.01
    expected = np.sqrt(np.linalg.inv(J.T @ J)[1, 1])
    assert found.deviation["lost gain"] == pytest.approx(expected, rel=1e-5)  # Runge-Kutta steps of 0.05 time constants


def test_twice_the_noise_is_twice_the_deviation_and_a_longer_window_is_never_worse():
    one, two = possibility(tank(noise=0.01)).windows, possibility(tank(noise=0.02)).windows
    for a, b in zip(one, two, strict=True):
        assert b.deviation["lost gain"] == pytest.approx(2 * a.deviation["lost gain"], rel=1e-9)
    deviations = [w.deviation["lost gain"] for w in one]
    assert deviations == sorted(deviations, reverse=True)


def test_a_healthy_twin_never_raises_the_least_deviation():
    for a, b in zip(possibility(tank()).windows, possibility(with_healthy(tank(), 0.5)).windows, strict=True):
        assert b.deviation["lost gain"] <= a.deviation["lost gain"] * (1 + 1e-9)


def test_noise_that_hides_the_fault_is_a_warning():
    found = possibility(tank(noise=50.0))
    (finding,) = [f for f in found.findings if "no window tells lost gain to a third" in f.what]
    assert finding.severity == "warning" and finding.evidence["allowed"] == pytest.approx(1 / 3)


def test_without_declared_noise_no_deviation_is_claimed():
    found = possibility(replace(tank(), noise=None))
    assert found.windows == () and any("no noise is declared" in f.what for f in found.findings)


# ---------------------------------------------------------------- contraction


def test_a_model_that_does_not_forget_is_said_to_be_no_way_out():
    growing = tank(rate=0.3)
    found = possibility(growing)
    assert not found.contraction.forgets and found.contraction.rate == pytest.approx(-0.3, rel=1e-9)
    (finding,) = [f for f in found.findings if "arbitrary waveform" in f.what]
    assert finding.severity == "warning" and "forgets nothing" in finding.what


def test_the_rate_of_a_linear_plant_is_that_of_its_slowest_mode():
    assert possibility(tank()).contraction.rate == pytest.approx(0.5, rel=1e-9)


def test_logarithms_of_products_neither_under_nor_overflow():
    steps = np.tile(np.diag([1e-200, 1e-250]), (5, 1, 1))
    assert norms_of_products(steps) == pytest.approx(np.log(1e-200) * np.arange(1, 6))


# ---------------------------------------------------------------- gauges and biases


def test_the_gain_of_the_inflow_cannot_be_told_from_that_of_the_sensor():
    """x' = -x/2 + 2 u about zero: twice the inflow's coefficient is half the sensor's gain."""
    origin = tank(level=0.0)
    plant = replace(origin, operating_point=fr.OperatingPoint((4.0,), (1.0,), (4.0,)), A=origin.A)
    absolute = replace(plant, operating_point=fr.OperatingPoint((0.0,), (0.0,), (0.0,)))
    t = 0.1 * np.arange(200)
    u = 1.0 + np.sin(t)[:, None]
    found = possibility(absolute, (t, u, model_run(absolute, t, u, [4.0])))
    names = {tuple(g.relative) for g in found.gauges}
    assert {("B[level, inflow]",), ("inflow as recorded",)} <= names
    row = {r.parameter: r.per_percent["lost gain"] for r in found.budget}["B[level, inflow]"]
    assert row == pytest.approx(0.01, rel=1e-6)


def test_compared_with_a_twin_alone_the_twins_own_gain_passes_for_the_fault():
    still = replace(tank(rate=0.0), B=np.zeros((1, 1)))
    found = possibility(with_healthy(still))
    assert {tuple(g.relative): g.fault_change for g in found.gauges} == {("gain of twin",): pytest.approx(-0.01)}
    rows = {r.parameter: r.per_percent["lost gain"] for r in found.budget}
    assert rows["gain of twin"] == pytest.approx(-0.01, rel=1e-6) and rows["inflow as recorded"] == 0.0


def test_sets_that_pass_for_one_another_are_found_whole_and_smallest():
    rng = np.random.default_rng(0)
    f, g, h = rng.normal(size=(3, 40))
    K = np.column_stack([2.0 * f, g, f - g, h])
    assert indistinguishable(np.zeros((40, 0)), f, K) == [
        {0: pytest.approx(-0.5)},
        {1: pytest.approx(-1.0), 2: pytest.approx(-1.0)},
    ]
    assert indistinguishable(f[:, None], f, K) == []  # without f itself in the data nothing is to be confused


def test_what_is_seen_nowhere_has_no_finite_deviation():
    J = np.column_stack([np.ones(5), np.zeros(5)])
    assert least_deviations(J)[0] == pytest.approx(1 / np.sqrt(5)) and np.isinf(least_deviations(J)[1])
    assert np.isnan(biases(J, np.ones((5, 1)))).all()


# ---------------------------------------------------------------- sampled plants, several faults, the doors


def test_a_sampled_plant_has_the_answers_of_the_continuous_one():
    plant = tank()
    sampled = fr.discretised(plant, 0.1)
    one, other = possibility(plant), possibility(sampled)
    assert other.rank.separable == other.rank.points
    path = model_run(plant, 0.1 * np.arange(41), np.ones((41, 1)))
    courses = [
        Course(Equations.of(p), Trajectory(0.1 * np.arange(41), np.ones((41, 1)), path)).windows([(0.0, 4.0)], 0.1)[0]
        for p in (plant, sampled)
    ]
    a, b = (w.deviation["lost gain"] for w in courses)
    assert a == pytest.approx(b, rel=1e-5)
    assert other.contraction.rate == pytest.approx(one.contraction.rate, rel=1e-6)


def test_two_faults_of_two_kinds_are_asked_together_and_each_alone():
    two = replace(with_healthy(tank()), faults=(GAIN, FaultChannel("offset", {"twin": 1.0})))
    diagnosis = fr.diagnose(two)
    assert [d.possibility is None for d in diagnosis.alone] == [False, True]
    assert diagnosis.together.possibility.rank.needed == 3
    sets = {s.faults: s.reconstructible for s in fault_sets(two)}
    assert sets["lost gain",] and sets["offset",]


def test_an_additive_fault_takes_no_trajectory():
    with pytest.raises(fr.InputError, match="no fault multiplies"):
        fr.diagnose(fr.library("airliner"), trajectory=(np.arange(3.0), np.zeros((3, 2)), np.zeros((3, 8))))


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ({"t": [0.0, 0.0], "u": [[1.0], [1.0]]}, "not strictly increasing"),
        (([0.0, 1.0], [[1.0], [1.0]], [[1.0, 2.0], [1.0, 2.0]]), "1 inputs and 2 states"),
        (([0.0, 1.0], [[np.nan], [1.0]], [[1.0], [1.0]]), "not finite"),
        (3, "has times t"),
    ],
)
def test_what_is_no_trajectory_of_the_plant_is_refused(path, message):
    with pytest.raises(fr.InputError, match=message):
        fr.diagnose(tank(), trajectory=path)


def test_the_command_line_answers_and_takes_a_log(cli, tmp_path):
    code, out, _ = cli("check", "activated_sludge")
    assert code == 0 and "can be reconstructed, while slow" in out and "bias budget of fouling" in out
    t = 0.1 * np.arange(600)
    log = tmp_path / "log.csv"
    columns = {"t": t, "dilution": 0.33 + 0.1 * np.sin(t), "turbidity": np.full(600, 3.4)}
    fr.write_log(log, columns)
    code, out, _ = cli("check", "activated_sludge", "--log", log, "--json")
    found = json.loads(out)["together"]["possibility"]
    assert code == 0 and found["rank"]["region"] == "the trajectory" and not found["held"]
    assert {tuple(g["relative"]) for g in found["gauges"]} == {("c",), ("b", "d")}


def test_every_answer_is_plain_json():
    for plant in (tank(), tank(noise=50.0), tank(rate=0.3), with_healthy(tank())):
        json.dumps(fr.diagnose(plant).as_dict(), allow_nan=False)
