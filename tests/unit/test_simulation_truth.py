# SPDX-License-Identifier: BSD-3-Clause
"""The simulated plant does what its equations say, and sensors show what their faults make of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from faultrecon.finding import Inconclusive, InputError
from faultrecon.graph.function import Graph
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import KnownTerm, Lipschitz
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.simulation.chance import HeldNoise
from faultrecon.simulation.scenario import Scenario, default_sample_time
from faultrecon.simulation.shapes import Doublet, Loss, Sine, Step, Stuck
from faultrecon.simulation.truth import true_run

A = np.array([[0.0, 1.0], [-4.0, -0.8]])
POINT = OperatingPoint((1.0, -0.5), (0.3,), (2.0, -1.0))


def _plant(**changes) -> Plant:
    plant = Plant(
        "oscillator",
        Signals(Channels(("x1", "x2")), Channels(("u",)), Channels(("y1", "y2"))),
        A,
        np.array([[0.0], [2.0]]),
        np.eye(2),
        np.array([[0.0], [0.5]]),
        faults=(FaultChannel("bias", {"y2": 1.0}), FaultChannel("valve", {"u": 1.0}, site="actuator")),
        disturbances=(Disturbance("w", {"x1": 1.0}), Disturbance("ripple", on={"y1": 2.0})),
        noise=Noise(0.1, (0.05, 0.02)),
    )
    return replace(plant, **changes)


def _still(plant: Plant) -> Plant:
    """The same equations with a nonlinear term that is zero: they take the route of a nonlinear plant."""
    phi = Graph.from_texts(["0*x1"], {"x": ("x1",), "u": ("u",), "t": ("t",)})
    return replace(plant, nonlinearity=Lipschitz(np.array([[0.0], [1.0]]), ("x1",), phi, 0.0))


def test_a_linear_plant_follows_its_matrix_exponential():
    plant = _plant(operating_point=POINT)
    scenario = Scenario(duration=4.0, sample_time=0.05, x0={"x1": 2.0}, inputs={"u": Step(0.7)}, noise=False)
    run = true_run(plant, scenario)
    rest = np.linalg.solve(A, -plant.B[:, 0] * 0.7)
    exact = [np.array(POINT.x) + rest + expm(A * t) @ (np.array([1.0, 0.0]) - rest) for t in run.t]
    # 80 steps, each right to a few units in the last place of values near 2.
    assert np.max(np.abs(run.x - exact)) < 1e-13
    assert run.y == pytest.approx(np.array(POINT.y) + (run.x - POINT.x) @ plant.C.T + 0.7 * plant.D[:, 0])
    assert run.u[:, 0] == pytest.approx(np.full(len(run.t), 1.0))


def test_a_sine_enters_as_the_closed_form_says():
    plant = _plant()
    run = true_run(plant, Scenario(duration=5.0, sample_time=0.1, disturbances={"w": Sine(1.0, 3.0)}, noise=False))
    # x = Im (e^(3it) - e^(At)) (3i - A)^-1 E
    E = np.array([1.0, 0.0])
    gain = np.linalg.solve(3j * np.eye(2) - A, E.astype(complex))
    exact = [np.imag(np.exp(3j * t) * gain - expm(A * t) @ gain) for t in run.t]
    assert np.max(np.abs(run.x - exact)) < 1e-13


def test_both_routes_agree_on_jumps_between_samples():
    scenario = Scenario(
        duration=6.0,
        sample_time=0.25,
        inputs={"u": Doublet(1.0, 0.777).starting(0.333)},
        disturbances={"w": HeldNoise(0.3, 0.13) + Step(0.2).starting(1.111)},
        faults={"valve": Step(0.4).starting(2.2221)},
        noise=False,
    )
    direct, reference = true_run(_plant(), scenario), true_run(_still(_plant()), scenario)
    # DOP853 at rtol 1e-10 over some fifty restarts.
    assert np.max(np.abs(direct.x - reference.x)) < 1e-8
    assert np.abs(direct.x).max() > 0.1


def test_a_stiff_plant_is_as_exact():
    stiff = _plant(A=np.array([[-3000.0, 1.0], [0.0, -0.5]]))
    run = true_run(stiff, Scenario(duration=1.0, sample_time=0.1, inputs={"u": Step(1.0)}, noise=False))
    rest = np.linalg.solve(stiff.A, -stiff.B[:, 0])
    exact = [rest - expm(stiff.A * t) @ rest for t in run.t]
    assert np.max(np.abs(run.x - exact)) < 1e-12


def test_the_sample_at_an_onset_sees_the_fault_wherever_rounding_puts_it():
    for onset, h in ((0.3, 0.1), (0.7, 0.1), (1 / 3, 1 / 30), (2.3, 0.01)):
        run = true_run(_plant(), Scenario.step("bias", size=1.0, at=onset, duration=3.0, sample_time=h, noise=False))
        k = round(onset / h)
        assert run.f[k - 1 : k + 1, 0].tolist() == [0.0, 1.0]
        assert run.y[k, 1] - run.healthy[k, 1] == 1.0


def test_additive_faults_add_and_multiplicative_ones_multiply():
    channels = (FaultChannel("gain", {"y1": 1.0}, effect="multiplicative"), FaultChannel("bias", {"y2": 2.0}))
    scenario = Scenario(duration=2.0, x0=(1.0, 0.0), noise=False, faults={"gain": Step(-0.3), "bias": Step(0.1)})
    run = true_run(_plant(faults=channels), scenario)
    assert run.y[:, 0] == pytest.approx(0.7 * run.healthy[:, 0])
    assert run.y[:, 1] == pytest.approx(run.healthy[:, 1] + 0.2)


def test_a_loss_of_effectiveness_is_the_same_said_either_way():
    scenario = Scenario(duration=2.0, x0=(1.0, 0.0), noise=False)
    lossy = true_run(_plant(), scenario.with_fault("bias", Loss(0.4)))
    gain = _plant(faults=(FaultChannel("gain", {"y2": 1.0}, effect="multiplicative"),))
    told = true_run(gain, scenario.with_fault("gain", Step(-0.4)))
    lost = true_run(gain, scenario.with_fault("gain", Loss(0.4)))
    assert lossy.y == pytest.approx(told.y)
    assert lost.y == pytest.approx(told.y)
    assert lossy.f[:, 0] == pytest.approx(-0.4 * lossy.healthy[:, 1])


@pytest.mark.parametrize("make", [_plant, lambda: _still(_plant())])
def test_a_stuck_sensor_repeats_what_it_showed_last_without_noise(make):
    scenario = Scenario.stuck("bias", at=1.05, duration=3.0, sample_time=0.1, x0=(1.0, 0.0), seed=2)
    run = true_run(make(), scenario)
    after = run.t >= 1.05
    shown = run.y[after, 1]
    assert np.ptp(shown) < 1e-14
    before = true_run(make(), Scenario(duration=1.05, sample_time=1.05, x0=(1.0, 0.0), noise=False))
    assert shown[0] == pytest.approx(before.healthy[-1, 1], abs=1e-9)
    assert np.ptp(run.y[~after, 1] - run.healthy[~after, 1]) > 0.01


def test_a_stuck_actuator_holds_its_input():
    swing = Scenario(duration=4.0, sample_time=0.1, inputs={"u": Sine(1.0, 2.0)}, noise=False)
    stuck = true_run(_plant(), swing.with_fault("valve", Stuck().starting(2.0)))
    held = true_run(_plant(), replace(swing, inputs={"u": Sine(1.0, 2.0).until(2.0) + Step(np.sin(4.0)).starting(2.0)}))
    assert stuck.x == pytest.approx(held.x, abs=1e-12)
    assert stuck.u != pytest.approx(held.u)


def test_measurements_fed_back_carry_their_faults_and_noise():
    g = Graph.from_texts(["-3*y1"], {"y": ("y1", "y2"), "u": ("u",), "t": ("t",)})
    fed = _plant(known=KnownTerm(np.array([[1.0], [0.0]]), g), faults=(FaultChannel("bias", {"y1": 1.0}),))
    # The loop closed by hand: the bias and the ripple of y1 drive x1 through -3.
    closed = replace(
        _plant(A=A - np.array([[3.0, 0.0], [0.0, 0.0]])),
        disturbances=(Disturbance("b", {"x1": -3.0}), Disturbance("r", {"x1": -6.0})),
    )
    bias, ripple = Step(0.5).starting(0.73), Sine(0.2, 5.0)
    scenario = Scenario(duration=3.0, sample_time=0.1, noise=False)
    open_form = true_run(fed, replace(scenario, faults={"bias": bias}, disturbances={"ripple": ripple}))
    closed_form = true_run(closed, replace(scenario, disturbances={"b": bias, "r": ripple}))
    assert np.max(np.abs(open_form.x - closed_form.x)) < 1e-9
    noisy = true_run(fed, replace(scenario, noise=True))
    assert np.abs(noisy.x).max() > 1e-3


def test_inputs_held_by_a_controller_are_steps():
    scenario = Scenario(duration=2.0, sample_time=0.5, inputs={"u": Sine(1.0, 2.0)}, noise=False, input_hold="sample")
    run = true_run(_plant(), scenario)
    later = (Step(np.sin(2 * t) - np.sin(2 * t - 1)).starting(t) for t in (1.0, 1.5))
    steps = sum(later, Step(np.sin(1)).starting(0.5))
    stepped = true_run(_plant(), Scenario(duration=2.0, sample_time=0.5, inputs={"u": steps}, noise=False))
    assert run.x == pytest.approx(stepped.x, abs=1e-12)


def test_a_sampled_plant_steps_by_its_matrices():
    sampled = _plant(A=np.array([[0.9, 0.1], [0.0, 0.8]]), sample_time=0.2, operating_point=POINT)
    run = true_run(sampled, Scenario(duration=1.0, inputs={"u": Step(0.5)}, x0=(2.0, 0.0), noise=False))
    x = np.array([1.0, 0.5])
    for k in range(len(run.t)):
        assert run.x[k] - POINT.x == pytest.approx(x)
        x = sampled.A @ x + sampled.B[:, 0] * 0.5
    with pytest.raises(InputError, match="steps every"):
        true_run(sampled, Scenario(duration=1.0, sample_time=0.1))


def test_a_plant_that_diverges_says_when():
    unstable = _plant(A=np.array([[800.0, 0.0], [0.0, -1.0]]))
    with pytest.raises(Inconclusive, match="diverges at t ="):
        true_run(unstable, Scenario(duration=10.0, sample_time=0.1, x0=(1.0, 0.0)))


def test_one_can_ask_to_stop_where_the_bound_of_phi_ends():
    phi = Graph.from_texts(["x1**3"], {"x": ("x1",), "u": ("u",), "t": ("t",)})
    term = Lipschitz(np.array([[0.0], [-1.0]]), ("x1",), phi, 3.0, domain={"x1": (-0.5, 0.5)})
    plant, scenario = _plant(nonlinearity=term), Scenario(duration=3.0, x0=(0.0, 2.0), noise=False)
    assert true_run(plant, scenario).left_domain() == ("x1",)
    with pytest.raises(Inconclusive, match="leaves the domain"):
        true_run(plant, scenario, inside=True)
    assert true_run(plant, replace(scenario, x0=(0.0, 0.2)), inside=True).left_domain() == ()


def test_the_sample_time_comes_from_the_noise_else_from_the_fastest_mode():
    assert default_sample_time(_plant()) == 0.1
    assert default_sample_time(_plant(noise=None)) == 0.02  # 1/(20 · 2 rad/s) = 0.025, rounded down
