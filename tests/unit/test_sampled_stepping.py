# SPDX-License-Identifier: BSD-3-Clause
"""Observers that are a map from one sample to the next: what they are stepped by, and what they do without samples."""

from dataclasses import replace

import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import CopiedTerm, NonlinearTerm, Observer
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction

T = 0.02
C, D = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.5]]), np.array([[0.0], [0.25]])


def observer(states: int = 3) -> Observer:
    """z = [what x should be; f̂]: x̂ = J z + H (y - D u) about a point, with φ, g and an actuator fault's estimate."""
    r = np.random.default_rng(3)
    n, nz = states, states + 1
    A = 0.9 * np.eye(nz) + 0.2 * r.normal(size=(nz, nz)) / np.sqrt(nz)
    sees = np.zeros((2, n))
    sees[:, :3] = C
    H = np.zeros((n, 2))
    H[0, 0] = 0.5
    J = np.eye(n) - H @ sees
    phi = Graph.trace(lambda x, u, t: [0.1 * np.sin(x[0]) + 0.01 * u[0] * t[0]], {"x": 1, "u": 1, "t": 1})
    g = Graph.trace(lambda y, u, t: [0.01 * y[0] * y[1]], {"y": 2, "u": 1, "t": 1})
    return Observer(
        A=A * (0.8 / np.abs(np.linalg.eigvals(A)).max()),
        B=0.1 * r.normal(size=(nz, 3)),
        Cx=np.hstack([J, np.zeros((n, 1))]),
        Dx=np.hstack([-H @ D, H]),
        Cf=np.eye(1, nz, n),
        Df=np.zeros((1, 3)),
        F=np.zeros((2, 1)),
        x0=np.linspace(0.1, 0.3, n),
        u0=np.array([0.5]),
        y0=np.array([0.2, -0.1]),
        nonlinear=NonlinearTerm(
            np.eye(nz, 1, -1),
            np.eye(1, nz),
            np.array([0.1]),
            np.array([-1.0]),
            np.array([1.0]),
            phi,
            0.1 * np.ones((1, 3)),
        ),
        copied=CopiedTerm(np.eye(nz, 1), g),
        sample_time=T,
        prior=np.eye(n, nz),
    )


def prediction(states: int = 3) -> Prediction:
    sees = np.zeros((2, states))
    sees[:, :3] = C
    return Prediction(sees, D)


def log(rows: int):
    r = np.random.default_rng(11)
    return T * np.arange(rows), 0.5 + r.normal(size=(rows, 1)), r.normal(size=(rows, 2))


def by_hand(o: Observer, t, u, y):
    """x̂ and f̂ of complete samples, straight from the definition."""
    z, states, faults = np.zeros(len(o.A)), [], []
    for k in range(len(t)):
        v = np.concatenate((u[k] - o.u0, y[k] - o.y0))
        states.append(o.x0 + o.Cx @ z + o.Dx @ v)
        faults.append(o.Cf @ z + o.Df @ v)
        term = o.nonlinear
        argument = np.clip(term.reads @ z + term.direct @ v + term.offset, term.lower, term.upper)
        z = o.A @ z + o.B @ v + term.into @ term.phi(argument, u[k], [t[k]])
        z = z + o.copied.into @ o.copied.g(y[k], u[k], [t[k]])
    return np.array(states), np.array(faults)


def same(a, b) -> bool:
    return np.asarray(a).tobytes() == np.asarray(b).tobytes()


def walk(est: Estimator, t, u, y):
    state, rows = est.init(), []
    for k in range(len(t)):
        state, estimate = est.step(state, t[k], u[k], y[k])
        rows.append(estimate)
    return state, rows


def test_the_map_acts_on_the_sample_that_is_left_and_the_estimate_reads_the_new_one():
    o, (t, u, y) = observer(), log(60)
    trace = Estimator.build(o, T, prediction=prediction()).replay(t, u, y)
    states, faults = by_hand(o, t, u, y)
    # Sixty contractions by 0.8: rounding of 1e-16 per step stays below 1e-14 of entries near one.
    assert np.allclose(trace.state, states, atol=1e-13) and np.allclose(trace.fault, faults, atol=1e-13)


@pytest.mark.parametrize("states", [3, 48])  # straight-line code and loops over matrices
def test_steps_a_log_and_the_compiled_kernel_give_the_same_bits(states):
    o, (t, u, y) = observer(states), log(400)
    o = replace(o, nonlinear=None, copied=None) if states == 48 else o
    y[37:41, 1] = np.nan
    y[200] = np.nan
    kept = np.r_[0:90, 93:400]
    t, u, y = t[kept], u[kept], y[kept]
    plain = Estimator.build(o, T, prediction=prediction(states), engine="casadi")
    compiled = Estimator.build(o, T, prediction=prediction(states), engine="numba")
    trace, fast = plain.replay(t, u, y), compiled.replay(t, u, y)
    state, rows = walk(compiled, t, u, y)
    for part in ("fault", "state", "corrected", "ok"):
        stepped = np.array([getattr(row, part) for row in rows])
        if states == 48:
            assert same(getattr(trace, part), getattr(fast, part)) and same(stepped, getattr(fast, part)), part
        else:  # sin may differ in its last bit from one mathematical library to the other
            assert np.allclose(getattr(trace, part), getattr(fast, part), rtol=0, atol=1e-13), part
            assert same(stepped, getattr(fast, part)), part
    assert state.gaps == trace.end.gaps == fast.end.gaps == 8


def test_rows_that_never_came_are_rows_without_a_single_measurement():
    o, (t, u, y) = observer(), log(40)
    u[20:23] = u[19]  # the input that stays
    whole = y.copy()
    whole[20:23] = np.nan
    est, kept = Estimator.build(o, T, prediction=prediction()), np.r_[0:20, 23:40]
    silent, absent = est.replay(t, u, whole), est.replay(t[kept], u[kept], y[kept])
    assert np.allclose(absent.state, silent.state[kept], rtol=0, atol=1e-14)  # t0 + 2 T against the t of the log
    assert np.allclose(absent.fault, silent.fault[kept], rtol=0, atol=1e-14)
    assert absent.end.gaps == silent.end.gaps == 3 and absent.ok.all()


def test_without_any_measurement_the_state_is_what_the_map_predicts_and_no_innovation_is_left():
    o, (t, u, y) = observer(), log(30)
    y[10:] = np.nan
    est = Estimator.build(o, T, prediction=prediction())
    trace, state = est.replay(t, u, y), est.init()
    for k in range(30):
        state, estimate = est.step(state, t[k], u[k], y[k])
        if k >= 10:
            assert np.allclose(estimate.state, o.x0 + o.prior @ state.z, rtol=0, atol=1e-13)
            assert np.allclose(state.v[1:], C @ (estimate.state - o.x0) + D @ (u[k] - o.u0), rtol=0, atol=1e-13)
    assert np.isfinite(trace.fault).all() and not trace.ok[10:].any()


def test_a_sample_between_two_beats_is_flagged_whole_and_taken_for_the_nearest():
    o, (t, u, y) = observer(), log(20)
    est = Estimator.build(replace(o, nonlinear=None), T, prediction=prediction())
    moved = t.copy()
    moved[8] += 0.3 * T
    trace, late = est.replay(t, u, y), est.replay(moved, u, y)
    assert same(trace.fault, late.fault)  # nothing in it reads the time
    assert np.array_equal(~late.ok.any(axis=1), np.isin(np.arange(20), (8, 9))) and late.end.gaps == 2
    _, rows = walk(est, moved, u, y)
    assert same(np.array([row.ok for row in rows]), late.ok)


def test_a_start_is_a_state_for_the_map_and_not_for_the_measurement():
    o = observer()
    est = Estimator.build(o, T, prediction=prediction())
    guess = np.array([0.4, 0.5, 0.6])
    state, _ = est.step(est.init(x=guess), 0.0, o.u0, [5.0, 5.0])
    assert np.allclose(o.x0 + o.prior @ state.z, guess, rtol=0, atol=1e-14)


def test_only_the_sample_time_of_its_map_and_the_scheme_that_applies_it_are_taken():
    o = observer()
    with pytest.raises(InputError, match=r"made for 0\.02 s"):
        Estimator.build(o, 0.01)
    with pytest.raises(InputError, match="cannot step a sampled observer"):
        Estimator.build(o, T, scheme="zoh")
    with pytest.raises(InputError, match="cannot step a continuous observer"):
        Estimator.build(replace(o, sample_time=None), T, scheme="sampled")
    est = Estimator.build(o, T, hold="midpoint")
    assert (est.scheme, est.hold) == ("sampled", "left")


def test_poles_of_a_sampled_observer_are_multipliers_and_their_rates_are_per_second():
    o = replace(observer(), A=np.diag([0.5, -0.25, 0.0, 0.9]))
    assert np.allclose(np.abs(o.poles), [0.9, 0.5, 0.25, 0.0])
    assert np.allclose(o.rates.real, np.log([0.9, 0.5, 0.25, 1e-6]) / T)
