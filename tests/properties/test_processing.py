# SPDX-License-Identifier: BSD-3-Clause
"""A log that comes in pieces, with stops in between, gives the bits of the whole log; on both engines."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import NonlinearTerm, Observer
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.runtime.processing import Reconstruction, settled
from faultrecon.storage import checkpoint

H = 0.05
K = np.array([[1.5, 0.2], [0.3, 2.0], [0.0, 0.7]])
C = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
A = np.array([[0.0, 1.0, 0.0], [-2.0, -0.4, 1.0], [0.0, -0.5, -1.0]]) - K @ C
B = np.array([[0.0], [0.5], [1.0]])
PREDICTION = Prediction(C, np.zeros((2, 1)))
NAMES = ("t", "u", "y1", "y2", "f_1", "f_2", "y2_corrected", "y1_ok", "y2_ok")


def observer():
    """One with a sine, in which the engines may differ by a bit: which one took which sample then shows."""
    linear = Observer(
        A, np.hstack([B, K]), np.eye(3), np.zeros((3, 3)), -C, np.hstack([np.zeros((2, 1)), np.eye(2)]), np.eye(2),
        np.zeros(3), np.array([0.3]), np.array([0.2, -0.1]),
    )  # fmt: skip
    phi = Graph.trace(lambda x, u, t: ca.sin(x) * (1 + 0.2 * ca.cos(0.1 * t)), {"x": 1, "u": 1, "t": 1})
    reads, into = np.array([[1.0, 0.0, 0.2]]), np.array([[0.0], [-0.8], [0.3]])
    term = NonlinearTerm(into, reads, np.array([0.4]), np.array([-2.0]), np.array([2.0]), phi)
    return replace(linear, nonlinear=term)


ESTIMATORS = {
    (engine, hold): Estimator.build(observer(), H, hold=hold, prediction=PREDICTION, engine=engine)
    for engine in ("casadi", "numba")
    for hold in ("linear", "left")
}


def processor(engine="casadi", hold="linear"):
    return Reconstruction(ESTIMATORS[engine, hold], NAMES, (1,), "it")


def log(seed, rows):
    """Samples with gaps and odd intervals, so placed that runs of plain ones are shorter and longer than 32."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(np.where(rng.random(rows) < 0.01, 2.5 * H, H))
    u, y = 0.3 + 0.3 * rng.normal(size=(rows, 1)), 0.3 * rng.normal(size=(rows, 2))
    u[rng.random(u.shape) < 0.005] = np.nan
    y[rng.random(y.shape) < rng.choice([0.0, 0.01, 0.05])] = np.nan
    return t, u, y


def whole(processor, t, u, y):
    """What `Estimator.replay` gives for the whole log, as columns."""
    trace = processor.estimator.replay(t, u, y)
    values = [t, *u.T, *y.T, *trace.fault.T, trace.corrected[:, 1], *trace.ok.T]
    return dict(zip(NAMES, values, strict=True))


def joined(pieces):
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in NAMES}


def assert_same_bits(one, other):
    assert list(one) == list(other)
    for name in one:
        assert one[name].dtype == other[name].dtype, name
        assert one[name].tobytes() == other[name].tobytes(), name


@pytest.mark.parametrize("engine", ["casadi", "numba"])
@pytest.mark.parametrize("hold", ["linear", "left"])
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), cuts=st.lists(st.integers(0, 500), max_size=8))
def test_pieces_of_any_length_give_the_bits_of_the_whole_log(engine, hold, seed, cuts):
    p, (t, u, y) = processor(engine, hold), log(seed, 500)
    state, got = p.start(), []
    for a, b in zip([0, *sorted(cuts)], [*sorted(cuts), 500], strict=True):
        state, rows = p.take(state, t[a:b], u[a:b], y[a:b])
        got.append(rows)
    got.append(p.finish(state))
    assert_same_bits(joined(got), whole(p, t, u, y))


@pytest.mark.parametrize("engine", ["casadi", "numba"])
def test_a_run_that_stops_and_goes_on_from_a_checkpoint_gives_the_same_bits(engine, tmp_path):
    p, (t, u, y), file = processor(engine), log(3, 600), tmp_path / "here.json"
    state, got = p.start(), []
    for a in range(0, 600, 37):
        state, rows = p.take(state, t[a : a + 37], u[a : a + 37], y[a : a + 37])
        checkpoint.save(file, {}, p.pack(state))
        state = p.unpack(checkpoint.load(file).content)
        got.append(rows)
    got.append(p.finish(state))
    assert_same_bits(joined(got), whole(p, t, u, y))


def test_one_sample_gives_one_row_on_casadi():
    p, (t, u, y) = processor(), log(5, 40)
    state, got = p.start(), []
    for k in range(40):
        state, rows = p.take(state, t[k : k + 1], u[k : k + 1], y[k : k + 1])
        assert len(rows["t"]) == 1
        got.append(rows)
    assert len(p.finish(state)["t"]) == 0
    assert_same_bits(joined(got), whole(p, t, u, y))


def test_a_state_is_never_changed():
    p, (t, u, y) = processor("numba"), log(6, 100)
    before, _ = p.take(p.start(), t[:50], u[:50], y[:50])
    once = p.take(before, t[50:], u[50:], y[50:])[1]
    assert_same_bits(once, p.take(before, t[50:], u[50:], y[50:])[1])


def test_samples_that_do_not_come_later_are_refused_and_harm_nothing():
    p, (t, u, y) = processor(), log(7, 10)
    state, _ = p.take(p.start(), t[:5], u[:5], y[:5])
    with pytest.raises(InputError, match="time must increase"):
        p.take(state, t[4:5], u[4:5], y[4:5])
    after = p.take(state, t[5:], u[5:], y[5:])[1]
    assert after["f_1"].tobytes() == whole(p, t, u, y)["f_1"][5:].tobytes()


@pytest.mark.parametrize("t", [1e300, 1e8 * H])
def test_a_time_absurdly_far_ahead_is_refused_and_harms_nothing(t):
    p, (times, u, y) = processor(), log(7, 10)
    state, _ = p.take(p.start(), times[:5], u[:5], y[:5])
    with pytest.raises(InputError, match="after the one before it"):
        p.take(state, np.array([t]), u[5:6], y[5:6])
    after = p.take(state, times[5:], u[5:], y[5:])[1]
    assert after["f_1"].tobytes() == whole(p, times, u, y)["f_1"][5:].tobytes()


def test_an_engine_has_to_be_settled_before_the_first_sample():
    auto = Estimator.build(observer(), H, prediction=PREDICTION)
    with pytest.raises(InputError, match="engine is not settled"):
        Reconstruction(auto, NAMES, (1,), "it")
    assert settled(auto, 100).asked == "casadi" and settled(auto, 10**8).asked == "numba"


@pytest.mark.parametrize("damage", [{}, {"row": [1.0]}, {"compiled": False, "row": np.zeros(3), "waiting": {}}])
def test_a_state_of_something_else_is_refused(damage):
    with pytest.raises(InputError, match="stored state"):
        processor().unpack(damage)


def test_a_state_of_another_estimator_is_refused():
    p = processor()
    packed = p.pack(p.start())
    with pytest.raises(InputError, match="another estimator"):
        p.unpack(packed | {"row": np.zeros(3)})
