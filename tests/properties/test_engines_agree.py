# SPDX-License-Identifier: BSD-3-Clause
"""Both engines run the same instructions in the same order: the results are the same bits, whatever the log is like.

Where they call a mathematical function (sin, cos) the two may use different libraries; a correctly rounded function
leaves nothing to differ in, and each is within one unit in the last place, so 1e-12 is allowed there.
"""

import itertools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.graph.function import Graph
from faultrecon.graph.observer import CopiedTerm, Injection, NonlinearTerm, Observer
from faultrecon.runtime import kernel
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.storage import kernelcache

H = 0.05
HOLDS, SCHEMES = ("left", "midpoint", "linear"), ("zoh", "rk4")
K = np.array([[1.5, 0.2], [0.3, 2.0], [0.0, 0.7]])
C = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
A = np.array([[0.0, 1.0, 0.0], [-2.0, -0.4, 1.0], [0.0, -0.5, -1.0]]) - K @ C
B = np.array([[0.0], [0.5], [1.0]])
X0, U0, Y0 = np.array([1.0, -2.0, 0.0]), np.array([0.3]), np.array([0.2, -0.1])
PREDICTION = Prediction(C, np.zeros((2, 1)))
NAMES = ("fault", "state", "corrected", "ok")


@pytest.fixture(scope="module", autouse=True)
def nothing_on_disk():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(kernelcache.VARIABLE, "")
        yield


def observer(kind):
    """'linear'; 'polynomial', which needs arithmetic alone; 'transcendental'; 'sliding' and 'sliding polynomial'."""
    linear = Observer(
        A, np.hstack([B, K]), np.eye(3), np.zeros((3, 3)), -C, np.hstack([np.zeros((2, 1)), np.eye(2)]), np.eye(2),
        X0, U0, Y0,
    )  # fmt: skip
    if kind.startswith("sliding"):
        linear = replace(linear, injections=injections())
    if kind in ("linear", "sliding"):
        return linear
    sine, cosine = (ca.sin, ca.cos) if kind == "transcendental" else (lambda x: x - x**3 / 6, lambda x: 1 - 0.5 * x**2)
    phi = Graph.trace(lambda x, u, t: sine(x) * (1 + 0.2 * cosine(0.1 * t)) + 0.1 * u * x, {"x": 1, "u": 1, "t": 1})
    g = Graph.trace(lambda y, u, t: y[0] * y[1] + 0.3 * sine(0.2 * t), {"y": 2, "u": 1, "t": 1})
    reads, into = np.array([[1.0, 0.0, 0.2]]), np.array([[0.0], [-0.8], [0.3]])
    term = NonlinearTerm(into, reads, np.array([0.4]), np.array([-2.0]), np.array([2.0]), phi)
    copied = CopiedTerm(np.array([[0.0], [0.0], [0.6]]), g)
    return replace(linear, nonlinear=term, copied=copied)


def injections():
    """Three in a row: K is the linear part of the first; the others are smooth, and read what the first has moved."""
    into, direct = np.array([[1.0, 0.0], [0.0, 1.0], [0.2, -0.3]]), np.hstack([np.zeros((2, 1)), -np.eye(2)])
    first = Injection(K, into, C, direct, np.array([[2.0, 0.3], [0.3, 1.0]]), 1.5)
    third = Injection(0 * into[:, :1], into[:, :1], C[:1], direct[:1], np.array([[0.5]]), 0.4, layer=0.02)
    return first, replace(first, linear=0 * K, weight=np.diag([1.0, 9.0]), bound=0.7, layer=0.03), third


def pair(kind, hold, scheme):
    """The same estimator on both engines."""
    options = {"hold": hold, "scheme": scheme, "prediction": PREDICTION}
    return [Estimator.build(observer(kind), H, engine=name, **options) for name in ("casadi", "numba")]


def log(seed, rows=400, gaps=0.0, jitter=False):
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * H
    if jitter:
        t = t + rng.uniform(0, 0.04, rows) * (rng.random(rows) < 0.1)
    u, y = U0 + 0.3 * rng.normal(size=(rows, 1)), Y0 + 0.3 * rng.normal(size=(rows, 2))
    u[rng.random(u.shape) < gaps / 4] = np.inf
    y[np.repeat(rng.random((rows, 2)) < gaps, 7, axis=0)[:rows]] = np.nan
    return t, u, y


def assert_agree(a, b, kind):
    for name in NAMES:
        one, other = getattr(a, name), getattr(b, name)
        if kind == "transcendental":
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
        else:
            np.testing.assert_array_equal(one, other)


# Two kinds per scheme and hold are enough: each brings one kernel of its own, and each kernel costs half a second.
CASES = [
    ("linear", "linear", "zoh"),
    ("polynomial", "linear", "rk4"),
    ("polynomial", "midpoint", "zoh"),
    ("polynomial", "left", "rk4"),
    ("transcendental", "linear", "zoh"),
    ("transcendental", "left", "rk4"),
    ("sliding", "linear", "implicit"),
    ("sliding polynomial", "left", "implicit"),
    ("sliding polynomial", "midpoint", "explicit"),
]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: "-".join(case))
def engines(request):
    return (request.param[0], *pair(*request.param))


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), gaps=st.floats(0.0, 0.3), jitter=st.booleans(), rows=st.integers(1, 300))
def test_both_engines_see_the_same_in_any_log(engines, seed, gaps, jitter, rows):
    kind, casadi, numba = engines
    t, u, y = log(seed, rows, gaps, jitter)
    a, b = casadi.replay(t, u, y, x=X0), numba.replay(t, u, y, x=X0)
    assert_agree(a, b, kind)
    assert (a.end.samples, a.end.gaps) == (b.end.samples, b.end.gaps)


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), gaps=st.floats(0.0, 0.3), jitter=st.booleans())
def test_compiled_a_log_is_its_samples_one_by_one_to_the_last_bit(engines, seed, gaps, jitter):
    _, _, estimator = engines
    t, u, y = log(seed, 60, gaps, jitter)
    trace, state, buffers = estimator.replay(t, u, y), estimator.init(), estimator.buffers()
    for k in range(len(t)):
        state, estimate = estimator.step(state, t[k], u[k], y[k])
        estimator.step_into(buffers, t[k], u[k], y[k])
        for name in NAMES:
            np.testing.assert_array_equal(getattr(trace, name)[k], getattr(estimate, name))
            np.testing.assert_array_equal(getattr(trace, name)[k], getattr(buffers, name))
    for end in (state, buffers.snapshot()):
        np.testing.assert_array_equal(trace.end.z, end.z)
        np.testing.assert_array_equal(trace.end.v, end.v)
        np.testing.assert_array_equal(trace.end.missing, end.missing)
        assert (trace.end.t, trace.end.samples, trace.end.gaps) == (end.t, end.samples, end.gaps)


@pytest.mark.parametrize(
    ("kind", "hold", "scheme"),
    [("polynomial", *pair) for pair in itertools.product(HOLDS, SCHEMES)]
    + [("linear", "linear", "zoh"), ("sliding", "left", "implicit"), ("sliding polynomial", "linear", "implicit")]
    + [("sliding", "linear", "explicit"), ("sliding polynomial", "midpoint", "explicit")],
)
def test_loops_over_matrices_add_up_in_the_order_of_the_straight_line(kind, hold, scheme, monkeypatch):
    monkeypatch.setattr(kernel, "UNROLLED", 0)
    casadi, numba = pair(kind, hold, scheme)
    t, u, y = log(5, gaps=0.05)
    assert "times(" in kernel.program(numba._general).text
    assert_agree(casadi.replay(t, u, y, x=X0), numba.replay(t, u, y, x=X0), kind)


def test_a_large_observer_is_compiled_as_loops_and_agrees():
    rng = np.random.default_rng(7)
    n, p = 30, 10
    L, Cn = 0.1 * rng.normal(size=(n, p)), rng.normal(size=(p, n))
    big = Observer(
        -2 * np.eye(n) + 0.2 * rng.normal(size=(n, n)), L, np.eye(n), np.zeros((n, p)), -Cn, np.eye(p), np.eye(p),
        np.zeros(n), np.zeros(0), np.zeros(p),
    )  # fmt: skip
    t, y = np.arange(500) * 0.01, rng.normal(size=(500, p))
    casadi, numba = (Estimator.build(big, 0.01, scheme="rk4", engine=e) for e in ("casadi", "numba"))
    assert "times(" in kernel.program(numba._general).text
    a, b = (e.replay(t, np.zeros((500, 0)), y) for e in (casadi, numba))
    assert_agree(a, b, "linear")


def test_without_faults_or_inputs_or_states_there_is_still_a_kernel():
    static = Observer(
        np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)), np.zeros((0, 0)), np.zeros((0, 1)),
        np.zeros((1, 0)), np.zeros(1), np.zeros(0), np.zeros(1),
    )  # fmt: skip
    trace = Estimator.build(static, H, engine="numba").replay(np.arange(5) * H, np.zeros((5, 0)), np.arange(5.0))
    np.testing.assert_array_equal(trace.state[:, 0], np.arange(5.0))
    assert trace.fault.shape == (5, 0)
