# SPDX-License-Identifier: BSD-3-Clause
"""What a sliding-mode certificate promises holds in the plant's own units, whatever is declared about them."""

from dataclasses import replace

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.methods.registry import method
from faultrecon.methods.sliding_letters import sliding_gain
from faultrecon.numerics.hinf import hinf_norm
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.signals import Channels

CHAIN, AIRCRAFT = fr.library("two_mass"), fr.library("admire")


def in_ranges(plant, ranges):
    y = plant.signals.y
    return replace(plant, signals=replace(plant.signals, y=Channels(y.names, y.units, tuple(ranges))))


def slower(plant, k):
    return replace(plant, A=plant.A / k, B=plant.B / k)


def linear_gain(made):
    """From [f'; n / range] to f̂ - f without the injection, off the matrices that run, in declared sizes."""
    o, plant, q = made.observer, made.plant, len(made.plant.faults)
    size = np.array([f.size for f in plant.faults])
    ranges = np.array(plant.signals.y.ranges, float)
    into = np.hstack([np.vstack([np.zeros((plant.n, q)), -np.diag(size)]), o.B[:, o.inputs :] * ranges])
    return hinf_norm(o.A, into, o.Cf / size[:, None], np.zeros((q, into.shape[1]))).value


def motion(made):
    """The sliding motion from the observer that runs: on C e = 0, kept there by the injection's own directions."""
    o, plant = made.observer, made.plant
    n, q = plant.n, len(plant.faults)
    A = np.block([[plant.A, np.zeros((n, q))], [np.zeros((q, n + q))]])
    C, G = np.hstack([plant.C, plant.F_f]), o.injections[0].into
    on = np.linalg.svd(C)[2][plant.p :].T
    kept = np.eye(n + q) - G @ np.linalg.solve(C @ G, C)
    return on.T @ kept @ A @ on, on, kept


def sliding_gain_of(made):
    Ac, on, kept = motion(made)
    n, q = made.plant.n, len(made.plant.faults)
    size = np.array([f.size for f in made.plant.faults])
    into = np.vstack([np.zeros((n, q)), -np.diag(size)])
    return hinf_norm(Ac, on.T @ kept @ into, made.observer.Cf @ on / size[:, None], np.zeros((q, q))).value


@pytest.mark.parametrize("ranges", [(1.41, 1.41), (0.7, 0.7), (2.8, 0.3)])
def test_the_level_of_the_linear_part_counts_errors_in_the_ranges_that_are_declared(ranges):
    made = fr.design(in_ranges(CHAIN, ranges), "sliding-mode", fix={"w_y": 1.0})
    assert made.verification.sound
    assert linear_gain(made) <= made.level * (1 + 1e-9)


@pytest.mark.parametrize("size", [1e-3, 1.0, 40.0])
def test_the_level_of_the_sliding_motion_holds_for_the_observer_that_runs(size):
    fault = FaultChannel("f", {"pitch_rate": 1.0}, size=size)
    made = fr.design(replace(AIRCRAFT, faults=(fault,)), "sliding-mode")
    assert made.verification.sound
    assert made.floor <= sliding_gain_of(made) <= made.level
    # The sizes of all signals follow that of the fault where nothing else is declared: a unit is no physics.
    assert made.level == pytest.approx(fr.design(AIRCRAFT, "sliding-mode").level, rel=1e-3)


def test_a_certificate_is_about_the_injection_that_runs_whatever_coordinates_it_was_proved_in():
    """The observer is built from G_n, G_l and P0 in the plant's units: no basis comes between the proof and the run."""
    made = fr.design(AIRCRAFT, "sliding-mode")
    assert set(made.gains) == {"G_n", "G_l", "P0"}
    assert np.array_equal(made.observer.injections[0].into, made.gains["G_n"])
    mixed = replace(AIRCRAFT, C=np.array([[0, 0, 1, 0, 0.3], [0, 0.1, 0, 0, 1], [0.2, 0, 0, 1, 0]], float))
    other = fr.design(mixed, "sliding-mode")
    assert other.verification.sound
    assert sliding_gain_of(other) <= other.level


@pytest.mark.parametrize("k", [1e-3, 60.0, 3600.0, 1e5])
def test_the_unit_of_time_is_no_physics(k):
    for plant in (AIRCRAFT, CHAIN):
        fast, slow = fr.design(plant, "sliding-mode"), fr.design(slower(plant, k), "sliding-mode")
        # The plant's pace is rounded to a power of two, so a level may differ by what that rounding weighs.
        assert slow.level / k == pytest.approx(fast.level, rel=0.5)
        assert np.abs(slow.observer.poles).max() * k < 4 * np.abs(fast.observer.poles).max()
        assert bool(method("sliding-mode").assumptions(slower(plant, k))) == bool(
            method("sliding-mode").assumptions(plant)
        )


def test_powers_of_two_in_time_change_nothing_at_all():
    fast, slow = (fr.design(slower(AIRCRAFT, k), "sliding-mode") for k in (1.0, 1024.0))
    assert slow.level / 1024.0 == pytest.approx(fast.level, rel=1e-4)


@pytest.mark.parametrize("size", [1.0, 10.0, 100.0])
def test_large_gusts_make_a_large_level_and_no_refusal(size):
    gusty = replace(AIRCRAFT, disturbances=(Disturbance("gust", {"alpha": 1.0}, size=size),))
    made = fr.design(gusty, "sliding-mode")
    assert made.verification.sound and made.level > size


def test_the_bound_of_the_injection_covers_disturbances_of_declared_size():
    gusty = replace(AIRCRAFT, disturbances=(Disturbance("gust", {"alpha": 1.0, "q": 0.5}, size=20.0),))
    made = fr.design(gusty, "sliding-mode")
    S = made.observer.injections[0].reads
    asked = S[:, : AIRCRAFT.n] @ gusty.E_w * 20.0  # what ψ of its size asks for at once
    assert made.observer.injections[0].bound > np.linalg.norm(asked)


def test_a_disturbance_on_a_sensor_is_named_neither_in_the_claim_nor_in_a_comparison():
    noisy = replace(CHAIN, disturbances=(Disturbance("hum", {}, {"position1": 1.0}, size=0.01),))
    made = fr.design(noisy, "sliding-mode")
    assert "ψ" not in made.certificate.claim
    score = fr.simulate(made, fr.Scenario()).score()
    assert score.achieved is None
    both = replace(CHAIN, disturbances=(Disturbance("both", {"v1": 1.0}, {"position1": 1.0}),))
    with pytest.raises(fr.Impossible, match="states and on sensors at once"):
        fr.design(both, "sliding-mode")


def test_a_mode_that_no_sensor_sees_is_named_before_any_solver_is_asked():
    A = np.diag([0.5, -1.0, -2.0])
    plant = fr.Plant(
        "three modes",
        fr.Signals(fr.Channels(("a", "b", "c")), fr.Channels(("u",)), fr.Channels(("y1", "y2"))),
        A, np.zeros((3, 1)), np.array([[0, 1.0, 0], [0, 0, 1.0]]), np.zeros((2, 1)),
        faults=(FaultChannel("f", {"y2": 1.0}),),
    )  # fmt: skip
    for name in ("sliding-mode", "sliding-mode-riccati", "sliding-mode-exact"):
        (found,) = method(name).assumptions(plant)
        assert "no sensor sees the mode at 0.5" in str(found) and "a" in str(found)


def test_L_comes_back_from_the_gain_that_ships():
    made = fr.design(AIRCRAFT, "sliding-mode")
    L = sliding_gain(made.plant, made.gains)
    assert L.shape == (3, 3) and abs(L[:, -1]).max() > 1
