# SPDX-License-Identifier: BSD-3-Clause
"""Scenarios are values: seeded, reproducible, and each signal has a stream of its own."""

import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.io.library import read_library
from faultrecon.simulation.chance import HeldNoise, RandomWalk
from faultrecon.simulation.scenario import Scenario, schedule
from faultrecon.simulation.shapes import Sine, Step
from faultrecon.simulation.truth import true_run


@pytest.fixture(scope="module")
def airliner():
    return read_library("airliner")


BASE = Scenario(
    duration=2.0,
    faults={"pitch_rate": RandomWalk(0.01)},
    disturbances={"gust_w": HeldNoise(1.0, 0.1)},
    inputs={"elevator": HeldNoise(0.01, 0.5)},
    seed=11,
)


def test_the_same_seed_gives_the_same_bits(airliner):
    first, again = true_run(airliner, BASE), true_run(airliner, BASE)
    for name in ("t", "u", "w", "f", "x", "y"):
        assert np.array_equal(getattr(first, name), getattr(again, name))


def test_another_seed_gives_another_run(airliner):
    first, other = true_run(airliner, BASE), true_run(airliner, BASE.with_seed(12))
    for name in ("u", "w", "f", "y"):
        assert not np.array_equal(getattr(first, name), getattr(other, name))


def test_a_signal_that_is_added_leaves_the_others_alone(airliner):
    more = BASE.with_disturbance("gust_u", HeldNoise(1.0, 0.1)).with_fault("roll_rate", RandomWalk(0.01))
    first, other = schedule(airliner, BASE), schedule(airliner, more)
    a, b = true_run(airliner, BASE), true_run(airliner, more)
    assert np.array_equal(first.noise, other.noise)
    assert np.array_equal(a.f[:, 0], b.f[:, 0])
    kept = [d.name for d in airliner.disturbances].index("gust_w")
    assert np.array_equal(a.w[:, kept], b.w[:, kept])
    assert np.array_equal(a.u, b.u)


def test_two_random_parts_of_one_signal_are_two_streams(airliner):
    twice = Scenario(duration=5.0, disturbances={"gust_w": HeldNoise(1.0, 0.1) + HeldNoise(1.0, 0.1)})
    shapes = schedule(airliner, twice).disturbances[[d.name for d in airliner.disturbances].index("gust_w")]
    t = 0.1 * np.arange(50) + 0.05
    assert abs(np.corrcoef(shapes.parts[0](t), shapes.parts[1](t))[0, 1]) < 0.5


def test_noise_streams_of_sensors_are_independent_and_have_the_declared_spread(airliner):
    noise = schedule(airliner, Scenario.healthy(duration=200.0)).noise
    spread = noise.std(axis=0) / np.array(airliner.noise.sd)
    # 10 001 samples: one sigma of a standard deviation is 0.7 %, of a correlation 1 %; eleven sensors, fixed seed.
    assert np.all(np.abs(spread - 1.0) < 0.03)
    correlation = np.corrcoef(noise.T) - np.eye(airliner.p)
    assert np.abs(correlation).max() < 0.05


def test_noise_is_held_for_its_hold_time_when_sampled_faster(airliner):
    s = schedule(airliner, Scenario.healthy(duration=1.0, sample_time=airliner.noise.hold / 4))
    blocks = s.noise[:-1].reshape(-1, 4, airliner.p)
    assert np.array_equal(blocks, np.repeat(blocks[:, :1], 4, axis=1))
    assert np.all(np.abs(np.diff(blocks[:, 0], axis=0)).min(axis=1) > 0)


def test_a_quiet_scenario_has_no_noise(airliner):
    run = true_run(airliner, BASE.quiet())
    assert not run.noise.any()
    assert run.y - run.healthy == pytest.approx(run.f @ airliner.F_f.T, abs=1e-12)


def test_inputs_are_deviations_and_logs_absolute(airliner):
    run = true_run(airliner, Scenario.healthy(duration=1.0, inputs={"n2": Step(2.0)}))
    assert run.u[0, 0] == airliner.point.u[0] + 2.0


def test_functions_and_arrays_are_signals_too(airliner):
    given = Scenario(duration=1.0, inputs={"elevator": lambda t: 0.01 * np.sin(t), "n2": np.linspace(0, 1, 51)})
    run = true_run(airliner, given)
    assert run.u[:, 1] == pytest.approx(airliner.point.u[1] + 0.01 * np.sin(run.t))
    assert run.u[:, 0] == pytest.approx(airliner.point.u[0] + run.t)


def test_where_it_starts_is_told_by_name_or_in_full(airliner):
    run = true_run(airliner, Scenario(duration=1.0, x0={"q": 0.02}, initial_error={"q": 0.01}))
    q = airliner.signals.x.index("q")
    assert run.x[0, q] == 0.02
    assert run.x_hat0[q] == pytest.approx(0.01)
    with pytest.raises(InputError, match="finite numbers"):
        true_run(airliner, Scenario(duration=1.0, x0=(1.0,)))


@pytest.mark.parametrize(
    ("scenario", "words"),
    [
        (Scenario.step("pitch_rat", size=1.0), "did you mean 'pitch_rate'"),
        (Scenario(inputs={"elevato": Step(1.0)}), "no input 'elevato'"),
        (Scenario(disturbances={"gust": Step(1.0)}), "no disturbance 'gust'"),
        (Scenario(duration=0.001), "no sample"),
    ],
)
def test_unknown_names_are_refused_with_a_suggestion(airliner, scenario, words):
    with pytest.raises(InputError, match=words):
        true_run(airliner, scenario)


@pytest.mark.parametrize("bad", [{"duration": -1.0}, {"sample_time": 0.0}, {"input_hold": "left"}])
def test_senseless_scenarios_are_refused(bad):
    with pytest.raises(InputError):
        Scenario(**bad)


def test_the_constructors_say_what_they_are():
    assert "step on pitch_rate" in repr(Scenario.step("pitch_rate", size=0.4, at=5.0))
    assert Scenario.healthy().faults == {}
    shapes = [
        Scenario.ramp("f", size=1.0, over=2.0, at=1.0),
        Scenario.sine("f", amplitude=1.0, omega=2.0, at=1.0),
        Scenario.fault("f", Sine(1.0, 2.0).starting(1.0)),
    ]
    assert [s.faults["f"](0.5) for s in shapes] == [0.0, 0.0, 0.0]
    assert [round(s.faults["f"](1.5), 3) for s in shapes] == [0.25, 0.841, 0.841]
