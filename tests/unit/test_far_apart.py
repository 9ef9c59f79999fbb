# SPDX-License-Identifier: BSD-3-Clause
"""Two samples absurdly far apart: refused at once on every road, and nothing is harmed."""

import time

import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import Injection, NonlinearTerm, Observer
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.runtime.general import FARTHEST

H = 0.02
A = np.array([[-1.0, 1.0], [-2.0, -3.0]])
L = np.array([[1.0, 0.0], [0.0, 1.0]])
C = np.eye(2)
PHI = Graph.trace(lambda x, u, t: [0.1 * np.sin(x[0])], {"x": 1, "u": 1, "t": 1})
TERM = NonlinearTerm(np.eye(2, 1), np.eye(1, 2), np.zeros(1), -np.ones(1), np.ones(1), PHI)
SWITCHES = Injection(np.eye(2, 1), np.eye(2, 1), np.eye(1, 2), np.array([[0.0, -1.0, 0.0]]), np.eye(1), 1.0, 0.0)
KINDS = {
    "zoh": {},
    "rk4": {"nonlinear": TERM},
    "implicit": {"injections": (SWITCHES,)},
    "sampled": {"sample_time": H},
}


def estimator(kind, engine, hold="linear"):
    drift = 0.2 * np.eye(2) if kind == "sampled" else A
    observer = Observer(
        drift, np.hstack([np.eye(2, 1), L]), np.eye(2), np.zeros((2, 3)), -C[1:], np.array([[0.0, 0.0, 1.0]]),
        np.array([[0.0], [1.0]]), np.zeros(2), np.zeros(1), np.zeros(2), **KINDS[kind],
    )  # fmt: skip
    return Estimator.build(
        observer, H, scheme=kind, hold=hold, engine=engine, prediction=Prediction(C, np.zeros((2, 1)))
    )


def samples(count=4):
    k = np.arange(count)
    return k * H, np.sin(k)[:, None], np.column_stack([np.cos(k), 0.1 * k])


@pytest.fixture(scope="module", params=[(kind, engine) for kind in KINDS for engine in ("casadi", "numba")], ids=str)
def made(request):
    return estimator(*request.param)


FAR = [1e300, 1.7e308, 1e9 * H, 1.01 * FARTHEST * H]


@pytest.mark.parametrize("far", FAR)
def test_a_step_over_more_than_ten_million_sample_times_is_refused_and_leaves_the_buffers_as_they_were(made, far):
    t, u, y = samples()
    state = made.replay(t, u, y).end
    buffers = made.buffers(state)
    shown = buffers.fault.copy(), buffers.state.copy(), buffers.corrected.copy(), buffers.ok.copy(), buffers.t
    began = time.perf_counter()
    for take in (lambda: made.step(state, far, u[0], y[0]), lambda: made.step_into(buffers, far, u[0], y[0])):
        with pytest.raises(InputError, match="after the one before it") as told:
            take()
        assert told.value.finding.evidence["time"] == far
        assert told.value.finding.evidence["interval"] == far - t[-1]
        assert "init" in str(told.value) and "check the clock" in str(told.value)
    assert time.perf_counter() - began < 1.0  # microseconds; crossing it would take minutes, or for ever
    for before, after in zip(
        shown, (buffers.fault, buffers.state, buffers.corrected, buffers.ok, buffers.t), strict=True
    ):
        np.testing.assert_array_equal(before, after)
    made.step_into(buffers, t[-1] + H, u[1], y[1])
    np.testing.assert_array_equal(buffers.state, made.step(state, t[-1] + H, u[1], y[1])[1].state)


@pytest.mark.parametrize("far", FAR)
@pytest.mark.parametrize("at", [0, 1, 100])
def test_a_log_with_such_an_interval_is_refused(made, far, at):
    t, u, y = samples(200)
    t[at + 1 :] = far + np.arange(199 - at) * np.maximum(H, 2 * np.spacing(far))
    state = made.replay(t[: at + 1], u[: at + 1], y[: at + 1]).end
    for road in ({"t": t, "u": u, "y": y}, {"t": t[at + 1 :], "u": u[at + 1 :], "y": y[at + 1 :], "state": state}):
        with pytest.raises(InputError, match="after the one before it"):
            made.replay(**road)


def test_times_infinitely_far_apart_are_refused_without_overflowing(made):
    _, u, y = samples(2)
    with pytest.raises(InputError, match="comes inf s after the one before it"):
        made.replay([-1.7e308, 1.7e308], u, y)


@pytest.mark.parametrize("kind", ["zoh", "rk4"])
def test_a_long_interval_below_that_is_crossed(kind):
    t, u, y = samples(3)
    t[2] = 1e4 * H
    assert np.isfinite(estimator(kind, "casadi").replay(t, u, y).state).all()


def test_the_first_sample_may_have_any_time(made):
    t, u, y = samples(3)
    np.testing.assert_allclose(
        made.replay(1e9 + t, u, y).state, made.replay(t, u, y).state, atol=1e-6
    )  # the clock's grain
