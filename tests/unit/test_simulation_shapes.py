# SPDX-License-Identifier: BSD-3-Clause
"""Waveforms: their values at jumps, their clocks, their bounds, and what chance draws."""

import math

import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.simulation.chance import HeldNoise, LooseContact, RandomWalk, Table, held_index, stream_seed
from faultrecon.simulation.shapes import Doublet, Drift, Intermittent, Loss, Ramp, Sine, Spike, Step, Stuck, Waveform

T = np.array([0.0, 4.999, 5.0, 5.001, 9.0, 12.0])


def test_a_step_is_up_at_its_onset_and_down_at_its_end():
    assert Step(0.4).starting(5.0).until(9.0)(T).tolist() == [0.0, 0.0, 0.4, 0.4, 0.0, 0.0]


def test_nothing_happens_before_the_clock_starts():
    for shape in (Step(1.0), Drift(1.0), Sine(1.0, 2.0, 1.0), Spike(1.0, 9.0), HeldNoise(1.0, 0.1, seed=1)):
        assert shape.starting(5.0)(T)[:2].tolist() == [0.0, 0.0]


def test_a_number_in_gives_a_number_out():
    value = Ramp(2.0, 4.0).starting(1.0)(3.0)
    assert isinstance(value, float)
    assert value == 1.0


def test_a_ramp_saturates_and_says_how_fast_it_is():
    ramp = Ramp(-0.6, 3.0)
    assert ramp([0.0, 1.5, 3.0, 30.0]).tolist() == [0.0, -0.3, -0.6, -0.6]
    assert (ramp.bounded.size, ramp.bounded.rate) == (0.6, pytest.approx(0.2))
    assert ramp.starting(2.0).breakpoints(10.0) == (0.0, 2.0, 5.0)


def test_a_window_does_not_move_the_clock_and_a_start_does():
    sine = Sine(0.5, 2.0)
    t = np.linspace(8.0, 12.0, 9)
    assert sine.during(8.0)(t) == pytest.approx(0.5 * np.sin(2 * t))
    assert sine.starting(8.0)(t) == pytest.approx(0.5 * np.sin(2 * (t - 8)))


def test_a_doublet_goes_up_and_down_and_back():
    assert Doublet(1.0, 2.0)([0.0, 1.9, 2.0, 3.9, 4.0]).tolist() == [1, 1, -1, -1, 0]


def test_shapes_add_up_and_so_do_their_bounds():
    both = Step(1.0).starting(2.0) + Ramp(1.0, 2.0) + Sine(0.5, 3.0)
    t = np.linspace(0, 5, 11)
    assert both(t) == pytest.approx(Step(1.0).starting(2.0)(t) + Ramp(1.0, 2.0)(t) + Sine(0.5, 3.0)(t))
    assert both.bounded.size == 2.5
    assert math.isinf(both.bounded.rate)
    assert len(both.parts) == 3


def test_a_loose_contact_by_table_is_on_from_each_odd_switch():
    contact = Intermittent(2.0, (1.0, 2.0, 4.0))
    assert contact([0.5, 1.0, 1.99, 2.0, 4.0, 9.0]).tolist() == [0, 2, 2, 0, 2, 2]
    with pytest.raises(InputError, match="increase"):
        Intermittent(1.0, (2.0, 1.0))


def test_a_loss_acts_on_the_signal_and_asks_for_it():
    loss = Loss(0.25, over=2.0).starting(1.0)
    reading = np.array([8.0, 8.0, 8.0, 4.0])
    assert loss([0.0, 1.0, 2.0, 5.0], reading).tolist() == [0.0, 0.0, -1.0, -1.0]
    with pytest.raises(InputError, match="healthy signal"):
        loss([0.0])


def test_a_stuck_sensor_shows_its_value_and_no_noise():
    stuck = Stuck(3.0).starting(1.0).until(2.0)
    t, reading = np.array([0.5, 1.0, 1.5, 2.0]), np.array([1.0, 2.0, 7.0, 9.0])
    assert (reading + stuck(t, reading)).tolist() == [1.0, 3.0, 3.0, 9.0]
    assert stuck.noise_gain(t).tolist() == [1.0, 0.0, 0.0, 1.0]


def test_a_function_becomes_a_waveform_with_one_value_per_time():
    assert Waveform(lambda t: t**2).starting(1.0)([0.0, 2.0, 3.0]).tolist() == [0.0, 1.0, 4.0]
    assert Waveform(lambda t: 2.0)([0.0, 1.0]).tolist() == [2.0, 2.0]
    with pytest.raises(InputError, match="one value per time"):
        Waveform(lambda t: np.zeros(3))([0.0, 1.0])


def test_a_table_is_read_in_straight_lines_or_held():
    assert Table.sampled([0.0, 2.0, 4.0], 0.5)([0.25, 0.5, 9.0]).tolist() == [1.0, 2.0, 4.0]
    assert Table.sampled([1.0, 2.0], 0.5, held=True)([0.0, 0.499, 0.5, 9.0]).tolist() == [1.0, 1.0, 2.0, 2.0]
    with pytest.raises(InputError, match="increasing"):
        Table((0.0, 0.0), (1.0, 2.0))


@pytest.mark.parametrize("hold", [0.01, 0.1, 1 / 3, 0.02])
def test_a_held_signal_changes_exactly_at_its_edges(hold):
    k = np.arange(1, 2000)
    edges = hold * k
    assert held_index(edges, hold).tolist() == k.tolist()
    assert held_index(np.nextafter(edges, 0.0), hold).tolist() == (k - 1).tolist()


@pytest.mark.parametrize("shape", [HeldNoise(1.0, 0.1, 7), RandomWalk(1.0, 0.1, 7), LooseContact(1.0, 0.3, 0.2, 7)])
def test_a_longer_run_begins_like_a_shorter_one(shape):
    t = np.arange(0.0, 2.0, 0.01)
    assert np.array_equal(shape(t), shape(np.arange(0.0, 50.0, 0.01))[: len(t)])


def test_held_noise_has_the_spread_it_was_given():
    # 40 000 independent samples: their standard deviation is within 1 % at 2.8 sigma; the seed is fixed.
    values = HeldNoise(0.3, 0.1, seed=5)(0.1 * np.arange(40_000) + 0.05)
    assert np.std(values) == pytest.approx(0.3, rel=0.01)


def test_a_random_walk_spreads_with_the_root_of_time():
    ends = [RandomWalk(0.5, 0.1, seed)(4.0) for seed in range(2000)]
    # sd 0.5 sqrt(4) = 1; 2000 draws know it to 1.6 % (one sigma).
    assert np.std(ends) == pytest.approx(1.0, rel=0.06)


def test_what_chance_draws_needs_a_seed():
    with pytest.raises(InputError, match="seed"):
        HeldNoise(1.0, 0.1)(1.0)


def test_a_stream_is_named_and_the_same_on_every_machine():
    assert stream_seed(0, "noise/y1") != stream_seed(0, "noise/y2")
    assert stream_seed(0, "noise/y1") != stream_seed(1, "noise/y1")
    # A recorded value: it changes if the documented way to draw seeds does.
    first = np.random.Generator(np.random.PCG64(stream_seed(3, "noise/y1"))).standard_normal()
    assert first == pytest.approx(RECORDED, abs=1e-15)


RECORDED = 0.4913632281857206


@pytest.mark.parametrize("bad", [lambda: Ramp(1.0, 0.0), lambda: Step(1.0).starting(-1.0), lambda: Spike(1.0, -2.0)])
def test_impossible_times_are_refused(bad):
    with pytest.raises(InputError):
        bad()
