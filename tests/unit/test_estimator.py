# SPDX-License-Identifier: BSD-3-Clause
"""The estimator's contract: pure, replayable, refuses what it cannot run, and survives imperfect samples."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import NonlinearTerm, Observer
from faultrecon.io.library import read_library
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.synthesis.pipeline import design

A = np.array([[0.0, 1.0], [-2.0, -0.6]])
B = np.array([[0.0], [1.0]])
C = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
L = np.array([[1.0, 0.3, 0.0], [0.2, 1.5, 0.0]])
F = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
X0, U0, Y0 = np.array([10.0, -2.0]), np.array([3.0]), np.array([100.0, 50.0, -7.0])
PREDICTION = Prediction(C, np.zeros((3, 1)))
H = 0.02


def luenberger(gain=1.0, nonlinear=None):
    """x̂ from sensors 0 and 1; each fault is the innovation of its sensor (1 or 2)."""
    K = gain * L
    return Observer(
        A - K @ C, np.hstack([B, K]), np.eye(2), np.zeros((2, 4)),
        -F.T @ C, np.hstack([np.zeros((2, 1)), F.T]), F, X0, U0, Y0, nonlinear,
    )  # fmt: skip


def pendulum():
    import casadi as ca

    phi = Graph.trace(lambda x, u, t: ca.sin(x) + 0.1 * u, {"x": 1, "u": 1, "t": 1})
    term = NonlinearTerm(np.array([[0.0], [-1.0]]), np.eye(1, 2), X0[:1], np.array([5.0]), np.array([15.0]), phi)
    return luenberger(nonlinear=term)


def log(rows=200, h=H):
    t = np.arange(rows) * h
    u = 3.0 + np.sin(t)[:, None]
    y = Y0 + np.column_stack([np.sin(2 * t), np.cos(t), np.sin(t)])
    return t, u, y


def trace_of_steps(estimator, t, u, y, **start):
    state, estimates = estimator.init(**start), []
    for k in range(len(t)):
        state, estimate = estimator.step(state, t[k], u[k], y[k])
        estimates.append(estimate)
    return state, {
        name: np.array([getattr(e, name) for e in estimates]) for name in ("fault", "state", "corrected", "ok")
    }


def test_at_rest_the_estimate_is_the_operating_point():
    state, estimate = Estimator.build(luenberger(), H).step(Estimator.build(luenberger(), H).init(), 0.0, U0, Y0)
    np.testing.assert_array_equal(estimate.state, X0)
    np.testing.assert_array_equal(estimate.fault, [0, 0])
    np.testing.assert_array_equal(estimate.corrected, Y0)
    assert estimate.ok.all()
    assert state.samples == 1


def test_the_estimate_starts_from_the_state_it_is_told():
    estimator = Estimator.build(luenberger(), H)
    _, estimate = estimator.step(estimator.init(x=[11.0, -1.0]), 0.0, U0, Y0)
    np.testing.assert_allclose(estimate.state, [11.0, -1.0], rtol=1e-15)


def test_a_state_read_partly_from_the_sensors_still_starts_where_it_is_told():
    Dx = np.zeros((2, 4))
    Dx[0, 1] = 0.5
    estimator = Estimator.build(replace(luenberger(), Dx=Dx), H)
    _, estimate = estimator.step(estimator.init(x=[11.0, -1.0]), 0.0, U0, Y0 + 4.0)
    np.testing.assert_allclose(estimate.state, [11.0, -1.0], rtol=1e-15)


def test_a_constant_fault_is_taken_out_of_its_measurement():
    # In equilibrium x̂ = x0 whatever sensor 2 says, because no gain reads it.
    estimator = Estimator.build(luenberger(), H)
    t, u, y = np.arange(50) * H, np.tile(U0, (50, 1)), np.tile(Y0, (50, 1))
    y[20:, 2] += 0.7
    trace = estimator.replay(t, u, y)
    np.testing.assert_allclose(trace.fault[20:, 1], 0.7, rtol=1e-14)
    np.testing.assert_allclose(trace.corrected, np.tile(Y0, (50, 1)), rtol=1e-15)


@pytest.mark.parametrize("observer", [luenberger(), pendulum()], ids=["linear", "nonlinear"])
@pytest.mark.parametrize("scheme", ["zoh", "rk4"])
def test_step_mutates_nothing_and_repeats_itself(observer, scheme):
    estimator = Estimator.build(observer, H, scheme=scheme, prediction=PREDICTION)
    t, u, y = log(3)
    y[1, 0] = np.nan
    state, _ = estimator.step(estimator.init(), t[0], u[0], y[0])
    before = [state.z.copy(), state.v.copy(), state.missing.copy(), u.copy(), y.copy()]
    first = estimator.step(state, t[1], u[1], y[1])
    second = estimator.step(state, t[1], u[1], y[1])
    for a, b in zip(before, [state.z, state.v, state.missing, u, y], strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(first[0].z, second[0].z)
    np.testing.assert_array_equal(first[1].fault, second[1].fault)


def test_an_estimator_survives_pickling_with_the_same_bits():
    estimator = Estimator.build(pendulum(), H, prediction=PREDICTION)
    again = pickle.loads(pickle.dumps(estimator))
    np.testing.assert_array_equal(again.replay(*log()).fault, estimator.replay(*log()).fault)


def test_a_replay_can_be_continued_sample_by_sample():
    estimator = Estimator.build(luenberger(), H)
    t, u, y = log()
    whole = estimator.replay(t, u, y)
    part = estimator.replay(t[:120], u[:120], y[:120])
    state = part.end
    for k in range(120, 200):
        state, estimate = estimator.step(state, t[k], u[k], y[k])
        np.testing.assert_array_equal(estimate.state, whole.state[k])
    assert state.samples == whole.end.samples == 200


def test_an_empty_log_gives_an_empty_trace():
    trace = Estimator.build(luenberger(), H).replay([], np.zeros((0, 1)), np.zeros((0, 3)))
    assert trace.fault.shape == (0, 2)
    assert len(trace) == 0


@pytest.mark.parametrize("rows", [1, 2, 3, 7])
def test_a_log_of_a_few_rows_is_its_samples(rows):
    estimator = Estimator.build(luenberger(), H)
    t, u, y = log(rows)
    _, stepped = trace_of_steps(estimator, t, u, y)
    np.testing.assert_array_equal(estimator.replay(t, u, y).state, stepped["state"])


def test_an_observer_without_states_only_reads():
    static = Observer(
        np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[0.0, 1.0]]), np.zeros((1, 0)),
        np.array([[-1.0, 1.0]]), np.ones((1, 1)), np.zeros(1), np.zeros(1), np.zeros(1),
    )  # fmt: skip
    trace = Estimator.build(static, H).replay([0, H, 2 * H, 2.5 * H], [1.0, 2, 3, 4], [2.0, 2, 2, 2])
    np.testing.assert_array_equal(trace.fault[:, 0], [1, 0, -1, -2])


def test_the_whole_log_reports_its_progress_up_to_one():
    seen = []
    t, u, y = log(5000)
    Estimator.build(luenberger(), H).replay(t, u, y, progress=seen.append)
    assert seen == sorted(seen)
    assert len(seen) > 3
    assert seen[-1] == 1.0


# ------------------------------------------------------------ what is refused


def test_rk4_beyond_its_stability_limit_is_refused_before_running():
    observer = luenberger(gain=1e4)
    with pytest.raises(InputError, match="largest stable step") as caught:
        Estimator.build(observer, 0.01, scheme="rk4")
    limit = caught.value.finding.evidence["largest_stable_step"]
    assert limit == pytest.approx(2.7853 / np.abs(observer.poles).max(), rel=1e-3)
    assert any("zoh" in remedy for remedy in caught.value.finding.remedies)
    Estimator.build(observer, 0.99 * limit, scheme="rk4")


def test_zoh_stays_finite_where_rk4_would_not():
    estimator = Estimator.build(luenberger(gain=1e4), 0.01)
    assert estimator.scheme == "zoh"
    assert np.isfinite(estimator.replay(*log(500, 0.01)).state).all()


def test_auto_takes_exponentials_for_linear_and_stiff_and_rk4_for_smooth_nonlinear():
    assert Estimator.build(luenberger(), H).scheme == "zoh"
    assert Estimator.build(pendulum(), H).scheme == "rk4"
    assert Estimator.build(pendulum(), 1.0).scheme == "zoh"


@pytest.mark.parametrize("t", [0.0, -1.0, np.nan, np.inf])
def test_time_that_does_not_increase_is_refused(t):
    estimator = Estimator.build(luenberger(), H)
    state, _ = estimator.step(estimator.init(), 0.0, U0, Y0)
    with pytest.raises(InputError, match="time must increase"):
        estimator.step(state, t, U0, Y0)
    with pytest.raises(InputError, match="time does not increase at row 1"):
        estimator.replay([0.0, t], np.tile(U0, (2, 1)), np.tile(Y0, (2, 1)))


def test_wrong_shapes_are_refused_with_the_right_ones():
    estimator = Estimator.build(luenberger(), H)
    with pytest.raises(InputError, match=r"y is \(2,\): this observer takes \(3,\)"):
        estimator.step(estimator.init(), 0.0, U0, Y0[:2])
    with pytest.raises(InputError, match=r"u is \(1, 2\)"):
        estimator.replay([0.0], np.zeros((1, 2)), np.zeros((1, 3)))
    with pytest.raises(InputError, match="initial state"):
        estimator.init(x=[1.0])
    with pytest.raises(InputError, match="the observer's B"):
        Estimator.build(replace(luenberger(), B=np.zeros((2, 3))), H)
    with pytest.raises(InputError, match="the prediction has C"):
        Estimator.build(luenberger(), H, prediction=Prediction(np.eye(2), np.zeros((2, 1))))


@pytest.mark.parametrize("wrong", [{"hold": "right"}, {"scheme": "euler"}])
def test_unknown_choices_are_refused(wrong):
    with pytest.raises(InputError, match="use "):
        Estimator.build(luenberger(), H, **wrong)


@pytest.mark.parametrize("wrong", [{"bound": True}, {"layer": [np.True_, 0.1]}, {"sample_time": True}])
def test_true_is_not_taken_for_one(wrong):
    with pytest.raises(InputError, match="True is not taken for 1"):
        Estimator.build(luenberger(), **{"sample_time": H, **wrong})


def test_an_unknown_option_of_an_estimator_is_refused_with_a_suggestion():
    made = design(read_library("lipschitz_aircraft"))
    with pytest.raises(InputError, match=r"an estimator has no option 'shceme': did you mean 'scheme'"):
        made.estimator(H, shceme="zoh")
    with pytest.raises(InputError, match="an estimator has no option 'prediction'"):
        made.estimator(H, prediction=None)


@pytest.mark.parametrize("h", [0.0, -1.0, np.nan, np.inf])
def test_a_sample_time_is_positive(h):
    with pytest.raises(InputError, match="sample time"):
        Estimator.build(luenberger(), h)


# ------------------------------------------------------------ imperfect samples


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("hold", ["left", "midpoint", "linear"])
def test_a_channel_that_drives_nothing_can_be_missing_without_a_trace_elsewhere(bad, hold):
    estimator = Estimator.build(luenberger(), H, hold=hold, prediction=PREDICTION)
    t, u, y = log()
    whole = estimator.replay(t, u, y)
    y[50:90, 2] = bad
    trace = estimator.replay(t, u, y)
    np.testing.assert_allclose(trace.state, whole.state, rtol=1e-12)
    np.testing.assert_allclose(trace.fault[:, 0], whole.fault[:, 0], atol=1e-11)
    assert np.isnan(trace.fault[50:90, 1]).all()
    assert np.isfinite(np.delete(trace.fault[:, 1], slice(50, 90))).all()
    expected = np.ones((200, 3), dtype=bool)
    expected[50:90, 2] = False
    np.testing.assert_array_equal(trace.ok, expected)
    np.testing.assert_allclose(trace.corrected[50:90, 2], Y0[2] + (trace.state[50:90] - X0).sum(axis=1), rtol=1e-12)


@pytest.mark.parametrize("hold", ["left", "midpoint", "linear"])
@pytest.mark.parametrize("scheme", ["zoh", "rk4"])
@pytest.mark.parametrize("gain", [1.0, 50.0])
def test_with_every_sensor_missing_the_observer_is_the_plant(hold, scheme, gain):
    """No innovation is left, however stiff the gain: the state follows x' = A x + B u."""
    from faultrecon.numerics.discretise import zoh

    estimator = Estimator.build(luenberger(gain), H, hold=hold, scheme=scheme, prediction=PREDICTION)
    t, u = np.arange(60) * H, np.tile(U0 + 1.0, (60, 1))
    trace = estimator.replay(t, u, np.full((60, 3), np.nan), x=[11.0, -2.5])
    Ad, Bd = zoh(A, B, H)
    x = np.array([1.0, -0.5])
    for k in range(60):
        # rk4 errs by |A h|^5/120 = 4e-10 per step, relative to a state of size 1
        np.testing.assert_allclose(trace.state[k] - X0, x, atol=1e-7 if scheme == "rk4" else 1e-11)
        x = Ad @ x + Bd[:, 0]
    assert np.isnan(trace.fault).all()
    assert not trace.ok.any()


def test_an_estimate_kept_in_the_state_is_kept_when_its_sensor_is_missing():
    """A fault that is a state of the observer (a constant, corrected by the innovation) stays where it is."""
    a, k = -1.0, np.array([1.0, 4.0])
    model, reads = np.array([[a, 0.0], [0.0, 0.0]]), np.array([[1.0, 1.0]])
    augmented = Observer(
        model - k[:, None] @ reads, np.column_stack([[1.0, 0.0], k]), np.eye(1, 2), np.zeros((1, 2)),
        np.array([[0.0, 1.0]]), np.zeros((1, 2)), np.ones((1, 1)), np.zeros(1), np.zeros(1), np.zeros(1),
    )  # fmt: skip
    prediction = Prediction(np.ones((1, 1)), np.zeros((1, 1)))
    estimator = Estimator.build(augmented, 0.01, prediction=prediction)
    t = np.arange(3000) * 0.01
    y = np.full((3000, 1), 0.5)
    y[2000:] = np.nan
    trace = estimator.replay(t, np.zeros((3000, 1)), y)
    np.testing.assert_allclose(trace.fault[2000:, 0], trace.fault[1999, 0], rtol=1e-9)
    np.testing.assert_allclose(trace.fault[1999, 0], 0.5, rtol=1e-3)
    assert not trace.ok[2000:].any()


def test_a_channel_that_the_state_repeats_keeps_its_last_value():
    Cx, Dx = np.diag([0.0, 1.0]), np.zeros((2, 4))
    Dx[0, 1] = 1.0  # x̂₁ is the measurement of x₁ itself
    estimator = Estimator.build(replace(luenberger(), Cx=Cx, Dx=Dx), H, prediction=PREDICTION)
    t, u, y = log()
    y[50:, 0] = np.nan
    np.testing.assert_allclose(estimator.replay(t, u, y).state[50:, 0], X0[0] + y[49, 0] - Y0[0], rtol=1e-12)


def test_without_a_prediction_the_last_value_stays_and_nothing_is_claimed():
    estimator = Estimator.build(luenberger(), H)
    t, u, y = log()
    held = y.copy()
    y[50:60, 1] = np.nan
    held[50:60, 1] = held[49, 1]
    trace = estimator.replay(t, u, y)
    np.testing.assert_array_equal(trace.state, estimator.replay(t, u, held).state)
    assert np.isnan(trace.corrected[50:60, 1]).all()
    assert not trace.ok[50:60, 1].any()


def test_rounding_left_in_a_gain_does_not_count_as_reading_a_sensor():
    Df = luenberger().Df.copy()
    Df[1, 2] = 1e-16
    estimator = Estimator.build(replace(luenberger(), Df=Df), H, prediction=PREDICTION)
    t, u, y = log()
    y[50:60, 1] = np.nan
    trace = estimator.replay(t, u, y)
    assert np.isnan(trace.fault[50:60, 0]).all()
    assert np.isfinite(trace.fault[50:60, 1]).all()


def test_a_missing_input_keeps_its_last_value_and_flags_the_row():
    estimator = Estimator.build(luenberger(), H)
    t, u, y = log()
    held = u.copy()
    u[50:60] = np.nan
    u[70] = np.inf
    held[50:60], held[70] = held[49], held[69]
    trace, expected = estimator.replay(t, u, y), estimator.replay(t, held, y)
    np.testing.assert_array_equal(trace.fault, expected.fault)
    flagged = np.flatnonzero(~trace.ok.all(axis=1))
    np.testing.assert_array_equal(flagged, [*range(50, 60), 70])
    assert not trace.ok[50].any()
    assert trace.end.gaps == 11


def test_an_input_missing_from_the_start_is_the_operating_point():
    estimator = Estimator.build(luenberger(), H)
    t, u, y = log(20)
    rest = u.copy()
    u[:5], rest[:5] = np.nan, U0
    np.testing.assert_array_equal(estimator.replay(t, u, y).state, estimator.replay(t, rest, y).state)


def test_jitter_below_a_millionth_is_the_sample_time_and_above_it_is_not():
    estimator = Estimator.build(luenberger(), H)
    (t, u, y), grown = log(), np.arange(200) * H * (1 + 1e-4)
    near = np.arange(200) * H * (1 + 5e-7)
    exact = estimator.replay(t, u, y).state
    np.testing.assert_array_equal(estimator.replay(near, u, y).state, exact)
    assert np.abs(estimator.replay(grown, u, y).state - exact).max() > 1e-8


@pytest.mark.parametrize("scheme", ["zoh", "rk4"])
def test_a_long_gap_beyond_the_stable_step_stays_finite(scheme):
    estimator = Estimator.build(pendulum(), H, scheme=scheme)
    t = np.array([0.0, H, 2 * H, 40.0, 40.0 + H])
    trace = estimator.replay(t, np.tile(U0, (5, 1)), np.tile(Y0 + 1.0, (5, 1)))
    assert np.isfinite(trace.state).all()
    assert np.abs(trace.state - X0).max() < 10


def test_a_clock_that_counts_from_the_epoch_is_still_regular():
    estimator = Estimator.build(luenberger(), H)
    t, u, y = log()
    np.testing.assert_array_equal(estimator.replay(1.7e9 + t, u, y).state, estimator.replay(t, u, y).state)


def test_every_row_of_a_replay_is_a_step():
    t, u, y = log()
    estimator = Estimator.build(pendulum(), H, prediction=PREDICTION)
    state, stepped = trace_of_steps(estimator, t, u, y, x=[10.5, -2.0])
    trace = estimator.replay(t, u, y, x=[10.5, -2.0])
    for name, values in stepped.items():
        np.testing.assert_array_equal(getattr(trace, name), values)
    np.testing.assert_array_equal(state.z, trace.end.z)
