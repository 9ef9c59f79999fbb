# SPDX-License-Identifier: BSD-3-Clause
"""Each scheme has the order it claims, each hold the meaning it claims, and a log is its samples one by one."""

import itertools
import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from faultrecon.graph.function import Graph
from faultrecon.graph.observer import CopiedTerm, NonlinearTerm, Observer
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.runtime.stepping import substeps

HOLDS, SCHEMES = ("left", "midpoint", "linear"), ("zoh", "rk4")
K = np.array([[1.5, 0.2], [0.3, 2.0], [0.0, 0.7]])
C = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
A = np.array([[0.0, 1.0, 0.0], [-2.0, -0.4, 1.0], [0.0, -0.5, -1.0]]) - K @ C
B = np.array([[0.0], [0.5], [1.0]])
N, S, OFFSET = np.array([[0.0], [-0.8], [0.3]]), np.array([[1.0, 0.0, 0.2]]), np.array([0.4])
M = np.array([[0.0], [0.0], [0.6]])
U0, Y0 = np.array([0.3]), np.array([0.2, -0.1])
PREDICTION = Prediction(C, np.zeros((2, 1)))


def observer(kind):
    """'linear', or 'nonlinear' with a φ that reads state, input and time and a g that reads measurement and time."""
    phi = Graph.trace(lambda x, u, t: ca.sin(x) * (1 + 0.2 * ca.cos(t)) + 0.1 * u * x, {"x": 1, "u": 1, "t": 1})
    g = Graph.trace(lambda y, u, t: y[0] * y[1] + 0.3 * ca.sin(2 * t), {"y": 2, "u": 1, "t": 1})
    term = NonlinearTerm(N, S, OFFSET, np.array([-50.0]), np.array([50.0]), phi)
    return Observer(
        A, np.hstack([B, K]), np.eye(3), np.zeros((3, 3)), -C, np.hstack([np.zeros((2, 1)), np.eye(2)]), np.eye(2),
        np.zeros(3), U0, Y0, term if kind == "nonlinear" else None, CopiedTerm(M, g) if kind == "nonlinear" else None,
    )  # fmt: skip


def reference(kind, inputs, ends):
    """The state at the times `ends`, from zero at the first, by DOP853 at 1e-12, restarted at each of them.

    inputs: (k, time) -> (u, y) in interval k, absolute.
    """

    def slope(t, z, k):
        u, y = inputs(k, t)
        out = A @ z + B @ (u - U0) + K @ (y - Y0)
        if kind == "nonlinear":
            ξ = S @ z + OFFSET
            out = out + N @ (np.sin(ξ) * (1 + 0.2 * np.cos(t)) + 0.1 * u * ξ)
            out = out + M[:, 0] * (y[0] * y[1] + 0.3 * np.sin(2 * t))
        return out

    z = [np.zeros(3)]
    for k, (a, b) in enumerate(itertools.pairwise(ends)):
        z.append(solve_ivp(slope, (a, b), z[-1], method="DOP853", rtol=1e-12, atol=1e-13, args=(k,)).y[:, -1])
    return np.array(z)


def smooth(t):
    t = np.asarray(t, dtype=float)
    return np.sin(1.3 * t)[..., None], np.stack([np.cos(2.1 * t), np.sin(0.9 * t + 1)], axis=-1)


def straight(t):
    t = np.asarray(t, dtype=float)
    return (0.5 + 0.4 * t)[..., None], np.stack([1.0 - 0.3 * t, 0.2 + 0.5 * t], axis=-1)


def constant(t):
    one = np.ones_like(np.asarray(t, dtype=float))
    return (0.8 * one)[..., None], np.stack([0.9 * one, -0.4 * one], axis=-1)


def slope_of_error(kind, scheme, hold, signal, steps=(20, 40, 80)):
    """log2 of the ratio of the errors at t = 2 s when the sample time is halved, from the two finest."""
    end = reference(kind, lambda k, t: signal(t), (0.0, 2.0))[-1]
    errors = []
    for rows in steps:
        t = np.arange(rows + 1) * (2.0 / rows)
        trace = Estimator.build(observer(kind), 2.0 / rows, hold=hold, scheme=scheme).replay(
            t, *signal(t), x=np.zeros(3)
        )
        errors.append(np.linalg.norm(trace.state[-1] - end))
    return math.log2(errors[-2] / errors[-1]), errors


# The next term of the error is one order of h smaller: at h = 0.05 and |poles| < 3 about 8 %, 0.11 in log2.
TOLERANCE = 0.15


@pytest.mark.parametrize(("scheme", "order"), [("rk4", 4), ("zoh", 2)])
@pytest.mark.parametrize("hold", HOLDS)
def test_each_scheme_has_its_order_when_the_input_is_constant(scheme, order, hold):
    assert slope_of_error("nonlinear", scheme, hold, constant)[0] == pytest.approx(order, abs=TOLERANCE)


@pytest.mark.parametrize(("scheme", "order"), [("rk4", 4), ("zoh", 2)])
def test_the_linear_hold_keeps_that_order_on_straight_lines(scheme, order):
    assert slope_of_error("nonlinear", scheme, "linear", straight)[0] == pytest.approx(order, abs=TOLERANCE)


@pytest.mark.parametrize(("hold", "order"), [("left", 1), ("midpoint", 2), ("linear", 2)])
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("kind", ["linear", "nonlinear"])
def test_each_hold_has_its_order_on_smooth_signals(kind, scheme, hold, order):
    assert slope_of_error(kind, scheme, hold, smooth)[0] == pytest.approx(order, abs=TOLERANCE)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_reading_samples_at_their_mean_is_far_better_than_holding_the_older_one(scheme):
    left = slope_of_error("nonlinear", scheme, "left", smooth)[1][-1]
    assert slope_of_error("nonlinear", scheme, "midpoint", smooth)[1][-1] < left / 20
    assert slope_of_error("nonlinear", scheme, "linear", smooth)[1][-1] < left / 20


def held(hold, t, u, y):
    """What the input is inside interval k under each hold."""

    def inputs(k, time):
        w = {"left": 0.0, "midpoint": 0.5, "linear": (time - t[k]) / (t[k + 1] - t[k])}[hold]
        return u[k] + w * (u[k + 1] - u[k]), y[k] + w * (y[k + 1] - y[k])

    return inputs


@pytest.mark.parametrize("hold", HOLDS)
def test_zoh_is_exact_for_a_linear_observer_under_every_hold_and_any_interval(hold):
    rng = np.random.default_rng(3)
    t = np.concatenate(([0.0], np.cumsum([0.1, 0.1, 0.037, 0.1, 0.4, 0.1, 0.123])))
    u, y = rng.normal(size=(8, 1)), rng.normal(size=(8, 2))
    trace = Estimator.build(observer("linear"), 0.1, hold=hold).replay(t, u, y, x=np.zeros(3))
    # 1e-12: the tolerance of the reference
    np.testing.assert_allclose(trace.state, reference("linear", held(hold, t, u, y), t), atol=1e-11)


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize(("scheme", "order"), [("rk4", 4), ("zoh", 2)])
def test_parts_of_an_interval_follow_the_same_held_input_with_the_order_of_the_scheme(hold, scheme, order):
    """Four times as many parts per interval of an irregular log: 4^order less error against the held input itself."""
    rng = np.random.default_rng(4)
    t = np.concatenate(([0.0], np.cumsum([0.05, 0.1, 0.05, 0.35, 0.05, 0.15])))
    u, y = rng.normal(size=(7, 1)), rng.normal(size=(7, 2))
    exact = reference("nonlinear", held(hold, t, u, y), t)
    coarse, fine = (
        np.linalg.norm(
            Estimator.build(observer("nonlinear"), h, hold=hold, scheme=scheme).replay(t, u, y, x=np.zeros(3)).state
            - exact
        )
        for h in (0.05, 0.0125)
    )
    assert math.log(coarse / fine, 4) == pytest.approx(order, abs=TOLERANCE)


@given(st.floats(1e-6, 1e4))
def test_no_part_of_an_interval_is_longer_than_the_sample_time(ratio):
    parts = substeps(ratio * 0.01, 0.01)
    assert ratio / parts <= 1 + 1.001e-6
    assert parts == 1 or ratio / (parts - 1) > 1


@settings(deadline=None, max_examples=40)
@given(
    st.sampled_from(["linear", "nonlinear"]),
    st.sampled_from(SCHEMES),
    st.sampled_from(HOLDS),
    st.booleans(),
    st.floats(0.0, 0.4),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_a_log_is_its_samples_one_by_one_to_the_last_bit(kind, scheme, hold, predicted, gaps, jitter, seed):
    rng = np.random.default_rng(seed)
    rows = int(rng.integers(1, 80))
    t = np.arange(rows) * 0.05
    if jitter:
        t = t + rng.uniform(0, 0.04, rows) * (rng.random(rows) < 0.2)
    u, y = rng.normal(size=(rows, 1)), rng.normal(size=(rows, 2))
    u[rng.random(u.shape) < gaps / 4] = np.inf
    # Stretches as well as single rows: gaps that last reach the compiled loop.
    y[np.repeat(rng.random((rows, 2)) < gaps, 7, axis=0)[:rows]] = np.nan
    prediction = PREDICTION if predicted else None
    estimator = Estimator.build(observer(kind), 0.05, hold=hold, scheme=scheme, prediction=prediction)
    trace, state = estimator.replay(t, u, y), estimator.init()
    for k in range(rows):
        state, estimate = estimator.step(state, t[k], u[k], y[k])
        for name in ("fault", "state", "corrected", "ok"):
            np.testing.assert_array_equal(getattr(trace, name)[k], getattr(estimate, name))
    np.testing.assert_array_equal(trace.end.z, state.z)
    np.testing.assert_array_equal(trace.end.v, state.v)
    assert (trace.end.samples, trace.end.gaps) == (state.samples, state.gaps)


@pytest.mark.parametrize("kind", ["linear", "nonlinear"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_log_longer_than_one_compiled_block_is_still_its_samples(kind, scheme):
    rows = 2500
    t = np.arange(rows) * 0.05
    u, y = smooth(t)
    estimator = Estimator.build(observer(kind), 0.05, scheme=scheme)
    trace, state = estimator.replay(t, u, y), estimator.init()
    for k in range(rows):
        state, _ = estimator.step(state, t[k], u[k], y[k])
    np.testing.assert_array_equal(trace.end.z, state.z)
    np.testing.assert_array_equal(trace.state[-1], state.z)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("hold", HOLDS)
def test_an_observer_that_misses_a_sensor_is_the_observer_built_without_its_gain(scheme, hold):
    t = np.arange(60) * 0.05
    u, y = smooth(t)
    whole = replace(observer("nonlinear"), copied=None)
    without = replace(whole, A=A + K[:, :1] @ C[:1], B=np.hstack([B, 0 * K[:, :1], K[:, 1:]]))
    expected = Estimator.build(without, 0.05, hold=hold, scheme=scheme).replay(t, u, y)
    y[:, 0] = np.nan
    trace = Estimator.build(whole, 0.05, hold=hold, scheme=scheme, prediction=PREDICTION).replay(t, u, y)
    # The same numbers up to the rounding of 60 steps.
    np.testing.assert_allclose(trace.state, expected.state, atol=1e-13)
    assert np.isnan(trace.fault[:, 0]).all()
    np.testing.assert_allclose(trace.fault[:, 1], expected.fault[:, 1], atol=1e-13)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_copied_term_reads_the_prediction_of_a_missing_measurement(scheme):
    """g = y1 y2 with y1 missing is (z1 + y01) y2: the φ of an observer that never had the sensor."""
    t = np.arange(40) * 0.05
    u, y = smooth(t)
    y[:, 1] = 0.7  # constant, so that it can stand in φ as a number
    product = Graph.trace(lambda y, u, t: y[0] * y[1], {"y": 2, "u": 1, "t": 1})
    whole = replace(observer("linear"), copied=CopiedTerm(M, product))
    term = NonlinearTerm(
        M, np.eye(1, 3), Y0[:1], np.array([-50.0]), np.array([50.0]),
        Graph.trace(lambda x, u, t: 0.7 * x, {"x": 1, "u": 1, "t": 1}),
    )  # fmt: skip
    without = replace(
        whole, A=A + K[:, :1] @ C[:1], B=np.hstack([B, 0 * K[:, :1], K[:, 1:]]), nonlinear=term, copied=None
    )  # fmt: skip
    expected = Estimator.build(without, 0.05, scheme=scheme).replay(t, u, y)
    y[:, 0] = np.nan
    trace = Estimator.build(whole, 0.05, scheme=scheme, prediction=PREDICTION).replay(t, u, y)
    np.testing.assert_allclose(trace.state, expected.state, atol=1e-13)


def test_rk4_hands_over_to_exponentials_where_a_missing_sensor_makes_the_poles_too_fast():
    """The plant's pole is -200/s and the sensor slows the observer to -20/s: without it, 200 x 0.05 = 10 > 2.78."""
    one = np.ones((1, 1))
    slowed = Observer(
        -20 * one, np.array([[200.0, -180.0]]), one, np.zeros((1, 2)), -one, np.array([[0.0, 1.0]]), one,
        np.zeros(1), np.zeros(1), np.zeros(1),
    )  # fmt: skip
    estimator = Estimator.build(slowed, 0.05, scheme="rk4", prediction=Prediction(one, 0 * one))
    t = np.arange(20) * 0.05
    trace = estimator.replay(t, np.zeros(20), np.full(20, np.nan), x=[1.0])
    np.testing.assert_allclose(trace.state[:, 0], np.exp(-200 * t), atol=1e-15)
