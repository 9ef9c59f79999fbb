# SPDX-License-Identifier: BSD-3-Clause
import warnings
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.linalg import expm

from faultrecon.finding import Inconclusive, InputError
from faultrecon.graph.function import Graph
from faultrecon.numerics.integrate import reference_solution
from faultrecon.plant.derive import discretised, drift, equilibrium, linearise, linearised
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import KnownTerm, Lipschitz
from faultrecon.plant.matrices import FindingWarning, plant_from_matrices
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Noise, Signals

EPS = np.finfo(float).eps
SIGNALS = Signals(
    Channels.declared(["angle [rad]", "rate [rad/s]"]),
    Channels.declared(["torque [Nm]"]),
    Channels.declared(["angle_a [rad]", "rate_a [rad/s]"]),
)


def pendulum(**changes):
    """A pendulum with friction and an input that a tanh limits; g is a spring that reads a sensor."""
    phi = Graph.from_texts(
        ["-9.81 * sin(angle) + tanh(torque)"], {"x": ["angle"], "u": ["torque"], "t": ["t"]}
    )  # fmt: skip
    g = Graph.from_texts(["-rate_a**3"], {"y": SIGNALS.y.names, "u": ["torque"], "t": ["t"]})
    into = np.array([[0.0], [1.0]])
    plain = Plant(
        "pendulum",
        SIGNALS,
        np.array([[0.0, 1.0], [0.0, -0.4]]),
        np.array([[0.0], [0.5]]),
        np.eye(2),
        np.array([[0.0], [0.25]]),
        faults=(FaultChannel("drift", {"angle_a": 1.0}),),
        disturbances=(Disturbance("push", {"rate": 2.0}), Disturbance("hum", {}, {"rate_a": 3.0}, role="noise")),
        nonlinearity=Lipschitz(into, ("angle",), phi, 9.81),
        known=KnownTerm(into, g),
        noise=Noise(0.01, (1e-3, 1e-3)),
        operating_point=OperatingPoint((0.1, 0.0), (0.2,), (0.1, 0.0)),
    )
    return replace(plain, **changes)


def linear(**changes):
    return pendulum(nonlinearity=None, known=None, **changes)


# ---------------------------------------------------------------- sampling


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(1e-3, 1.0))
def test_zoh_and_foh_agree_with_scipy(seed, h):
    rng = np.random.default_rng(seed)
    n, m, p = rng.integers(1, 5), rng.integers(1, 4), rng.integers(1, 4)
    system = [rng.normal(size=s) for s in ((n, n), (n, m), (p, n), (p, m))]
    plant = plant_from_matrices(*system)
    for how in ("zoh", "foh"):
        made, (*expected, _) = discretised(plant, h, how), signal.cont2discrete(system, h, method=how)
        assert made.sample_time == h
        for ours, theirs in zip((made.A, made.B, made.C, made.D), expected, strict=True):
            # Two exponentials of matrices of norm below 10 by Padé: both err by a few hundred roundings at most.
            assert ours == pytest.approx(theirs, rel=1e-10, abs=1e-10)


def test_zoh_of_an_integrator_chain_is_the_closed_form():
    plant = plant_from_matrices([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]])
    h = 0.5
    made = discretised(plant, h)
    assert pytest.approx(np.array([[1, h], [0, 1]]), abs=4 * EPS) == made.A
    assert pytest.approx(np.array([[h * h / 2], [h]]), abs=4 * EPS) == made.B


def test_foh_follows_a_ramp_exactly_where_zoh_lags():
    plant, h, steps = plant_from_matrices([[-2.0]], [[1.0]], [[1.0]], [[0.5]]), 0.1, 30
    t = h * np.arange(steps + 1)
    exact = (t / 2 - (1 - np.exp(-2 * t)) / 4) + 0.5 * t  # x' = -2x + t, y = x + t/2

    def output(made):
        x, y = -(made.D - plant.D) @ t[:1], []  # the foh state is x - B1 u; C = 1
        for u in t:
            y.append((made.C @ x + made.D @ [u])[0])
            x = made.A @ x + made.B @ [u]
        return np.array(y)

    assert output(discretised(plant, h, "foh")) == pytest.approx(exact, abs=1e-13)
    assert np.abs(output(discretised(plant, h, "zoh")) - exact).max() > 0.01


def test_held_disturbances_and_actuator_faults_move_as_the_exponential_says():
    fault = FaultChannel("leak", {"torque": -2.0}, site="actuator")
    made = discretised(linear(faults=(fault,)), 0.2)
    big = np.zeros((3, 3))
    for column, expected in ((linear().E_w, made.E_w), (-2.0 * linear().B, made.E_f)):
        big[:2, :2], big[:2, 2:] = linear().A, column
        assert expected == pytest.approx(expm(0.2 * big)[:2, 2:], rel=1e-12, abs=1e-15)
    assert [d.role for d in made.disturbances] == ["attenuate", "noise"] and made.disturbances[1].on == {"rate_a": 3.0}


def test_names_faults_point_and_noise_stay_and_noise_is_drawn_once_a_step_at_most():
    plant = pendulum()
    for how in ("zoh", "euler"):
        made = discretised(plant, 0.05, how)
        assert made.signals == plant.signals and made.faults == plant.faults and made.point == plant.point
        assert made.noise == Noise(0.05, (1e-3, 1e-3)) and how in made.source
    assert discretised(plant, 0.002).noise == plant.noise  # five samples share one draw


def test_euler_is_x_plus_h_times_the_derivative_also_in_the_nonlinear_parts():
    plant, h = pendulum(), 0.01
    made = discretised(plant, h, "euler")
    x, u = np.array([0.7, -0.3]), np.array([0.9])
    assert drift(made, x, u) == pytest.approx(h * drift(plant, x, u), rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("how", ["zoh", "euler"])
def test_a_step_of_a_nonlinear_plant_errs_by_the_square_of_its_length(how):
    plant, x, u = pendulum(), np.array([0.7, -0.3]), np.array([0.9])
    steps = [0.02, 0.01, 0.005]
    errors = []
    for h in steps:
        exact = reference_solution(lambda t, s: drift(plant, s, u, t=t), x, np.array([0.0, h]))[-1]
        made = discretised(plant, h, how)
        errors.append(np.abs(x + drift(made, x, u) - exact).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert np.all((ratios > 3.5) & (ratios < 4.5))  # second order: halving the step quarters the error


def test_euler_steps_that_would_turn_decay_into_growth_are_refused_with_the_limit():
    plant = plant_from_matrices([[-10.0, 0], [0, 1.0]], [[1], [1]], [[1, 1]], [[0]])
    assert np.abs(np.linalg.eigvals(discretised(plant, 0.19, "euler").A)).min() < 1
    with pytest.raises(InputError, match=r"s = -10.*steps of 0.2 s and more"):
        discretised(plant, 0.2, "euler")
    discretised(plant, 0.2, "zoh")


@pytest.mark.parametrize(
    ("plant", "h", "how", "words"),
    [
        (linear(sample_time=0.1), 0.1, "zoh", "is sampled already: its sample time is 0.1 s"),
        (linear(), 0.0, "zoh", "the step is 0.0"),
        (linear(), float("nan"), "zoh", "the step is nan"),
        (linear(), 0.1, "zho", "did you mean 'zoh'"),
        (pendulum(), 0.1, "foh", "φ is nonlinear"),
        (linear(faults=(FaultChannel("a", {"torque": 1.0}, "actuator"),)), 0.1, "foh", "'a' is an actuator fault"),
    ],
)
def test_what_cannot_be_discretised_is_refused(plant, h, how, words):
    with pytest.raises(InputError, match=words):
        discretised(plant, h, how)


# ---------------------------------------------------------------- about a point


def numerical(function, at, h=1e-6):
    """Central differences, column by column."""
    return np.column_stack([(function(at + h * e) - function(at - h * e)) / (2 * h) for e in np.eye(len(at))])


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[st.floats(-2, 2)] * 3))
def test_the_linear_plant_has_the_slopes_that_finite_differences_find(point):
    plant, x, u = pendulum(), np.array(point[:2]), np.array(point[2:])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FindingWarning)
        made = linearised(plant, x, u)
    # Central differences of a smooth function of size below 40: rounding 40 eps / 1e-6 = 1e-8, truncation 1e-12 * 40.
    assert pytest.approx(numerical(lambda v: drift(plant, v, u), x), abs=1e-7) == made.A
    assert pytest.approx(numerical(lambda v: drift(plant, x, v), u), abs=1e-7) == made.B
    assert made.nonlinearity is None and made.known is None
    assert (made.point.x, made.point.u) == (tuple(x), tuple(u))
    assert made.point.y == pytest.approx(tuple([0.1, 0.0] + x - [0.1, 0.0] + plant.D @ (u - 0.2)), abs=4 * EPS)


def test_a_sensor_disturbance_that_g_reads_enters_the_states():
    with pytest.warns(FindingWarning):
        made = linearised(pendulum(), [0.0, 2.0], [0.2])
    assert made.disturbances[1].into == {"rate": pytest.approx(-3 * 2.0**2 * 3.0)}  # g' = -3 y², and F_w = 3


def test_a_fault_on_a_sensor_that_g_reads_is_refused():
    plant = pendulum(faults=(FaultChannel("drift", {"rate_a": 1.0}),))
    with pytest.raises(InputError, match="'drift' would enter the states through g"):
        linearised(plant, [0.0, 1.0], [0.2])


def test_an_equilibrium_is_found_stays_put_and_is_linearised_without_a_word():
    plant = pendulum()
    x = equilibrium(plant, [0.5], guess=[0.0, 0.0])
    assert np.abs(drift(plant, x, [0.5])).max() < 1e-11
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = linearised(plant, x, [0.5])
    assert np.linalg.eigvals(made.A).real.max() < 0  # hanging, it is stable; and standing on its head it is not
    up = equilibrium(plant, [0.5], guess=[3.1, 0.0])
    assert up[0] > 3 and np.linalg.eigvals(linearised(plant, up, [0.5]).A).real.max() > 0


def test_a_point_that_is_no_equilibrium_is_told_with_its_drift():
    with pytest.warns(FindingWarning, match=r"no equilibrium: .*rate by -") as heard:
        linearised(pendulum(), [1.0, 0.0], [0.2])
    residual = heard[0].message.findings[0].evidence["residual"]
    assert residual["rate"] == pytest.approx(drift(pendulum(), [1.0, 0.0], [0.2])[1])
    assert heard[0].filename == __file__


def test_a_sampled_plant_rests_where_the_next_state_is_this_one():
    plant, sampled = pendulum(), discretised(pendulum(), 0.05)
    assert equilibrium(sampled, [0.5]) == pytest.approx(equilibrium(plant, [0.5]), abs=1e-9)
    assert drift(sampled, [0.1, 0.0], [0.2]) == pytest.approx(
        sampled.G @ plant.nonlinearity.phi([0.1], [0.2], [0.0]), abs=1e-15
    )


def test_where_there_is_no_equilibrium_that_is_said():
    plant = plant_from_matrices([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(Inconclusive, match="still moves by 1"):
        equilibrium(plant, [1.0])


def test_a_point_without_derivative_is_refused():
    phi = Graph.from_texts(["sqrt(angle)"], {"x": ["angle"], "u": ["torque"], "t": ["t"]})
    plant = replace(pendulum(known=None), nonlinearity=Lipschitz(
        np.array([[0.0], [1.0]]), ("angle",), phi, 1.0))  # fmt: skip
    with pytest.raises(InputError, match="phi has no derivative by x at this point"):
        linearised(plant, [0.0, 0.0], [0.0])
    with pytest.raises(InputError, match="it takes 2 finite numbers"):
        linearised(plant, [0.0], [0.0])


# ---------------------------------------------------------------- array code


def tanks(x, u, w):
    """Two tanks in a row; w leaks out of the second one."""
    flow = 0.5 * ca.sqrt(x[0])
    return [u[0] - flow, flow - 0.4 * np.sqrt(x[1]) - w[0]]


def test_array_code_is_linearised_to_the_closed_form_with_names_and_disturbances():
    level = [4.0, 6.25]
    found = linearise(
        tanks,
        lambda x, u, w: [x[0] ** 2, x[1] + 3 * w[0]],
        level,
        [1.0],
        states=["upper [m]", "lower [m]"],
        inputs=["inflow [m^3/s]"],
        outputs=["pressure [Pa]", "level [m]"],
        disturbances=["leak"],
        faults=["level"],
    )
    plant = found.plant
    assert pytest.approx(np.array([[-0.125, 0], [0.125, -0.08]]), abs=4 * EPS) == plant.A
    assert np.array_equal(plant.B, [[1], [0]]) and np.array_equal(plant.C, [[8, 0], [0, 1]])
    assert plant.disturbances == (Disturbance("leak", {"lower": -1.0}, {"level": 3.0}),)
    assert plant.faults[0].on == {"level": 1.0} and plant.point == OperatingPoint((4.0, 6.25), (1.0,), (16.0, 6.25))
    assert found.at_rest and found.residual == pytest.approx([0, 0], abs=4 * EPS)


def test_a_residual_is_reported_with_the_state_that_moves():
    found = linearise(lambda x, u: [u[0] - x[0], -x[1]], lambda x, u: x, [1.0, 0.0], [1.5])
    assert not found.at_rest and np.array_equal(found.residual, [0.5, 0.0])
    assert found.findings[0].evidence["residual"] == {"x1": 0.5}


def test_array_code_without_inputs_and_in_discrete_time_serves():
    found = linearise(lambda x, u: [0.5 * x[0] + 1], lambda x, u: [ca.exp(x[0])], [2.0], sample_time=0.1)
    assert found.at_rest and found.plant.sample_time == 0.1 and found.plant.B.shape == (1, 0)
    assert pytest.approx(np.exp(2.0)) == found.plant.C[0, 0]


def test_array_code_agrees_with_the_plant_it_describes():
    plant = pendulum()

    def rhs(x, u):
        y = plant.D @ (u - 0.2) + x
        move = plant.A @ (x - np.array([0.1, 0.0])) + plant.B @ (u - 0.2)
        return [move[0], move[1] - 9.81 * np.sin(x[0]) + np.tanh(u[0]) - y[1] ** 3]

    x, u = [0.3, -0.2], [0.4]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FindingWarning)
        expected = linearised(plant, x, u)
    found = linearise(rhs, lambda x, u: x + plant.D @ (u - 0.2), x, u)
    for letter in "ABCD":
        assert getattr(found.plant, letter) == pytest.approx(getattr(expected, letter), abs=1e-13)
    assert found.residual == pytest.approx(drift(plant, x, u), abs=1e-14)


@pytest.mark.parametrize(
    ("rhs", "words"),
    [
        (lambda x, u: [x[0]], "rhs gives 1 numbers: x0 has 2"),
        (lambda x, u: "x", "must return a vector"),
        (lambda x, u: [ca.sqrt(x[0]), x[1]], "rhs has no derivative by x"),
    ],
)
def test_array_code_that_does_not_fit_is_refused(rhs, words):
    with pytest.raises(InputError, match=words):
        linearise(rhs, lambda x, u: x, [0.0, 0.0], [0.0])
