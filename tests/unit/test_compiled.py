# SPDX-License-Identifier: BSD-3-Clause
"""Graphs become program text without loss; compiled estimators take what people give them and say which engine runs."""

import math
import pickle
import threading

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from faultrecon.finding import Inconclusive, InputError
from faultrecon.graph import compiled, source
from faultrecon.graph.compiled import Program
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import NonlinearTerm, Observer
from faultrecon.graph.walk import NUMPY, OPERATIONS, walk
from faultrecon.runtime import engine
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.storage import kernelcache

H = 0.02
C = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
L = np.array([[1.0, 0.3, 0.0], [0.2, 1.5, 0.0]])
F = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
U0, Y0 = np.array([3.0]), np.array([100.0, 50.0, -7.0])
PHI = Graph.trace(lambda x, u, t: ca.fmin(x, 3.0) ** 2 + 0.1 * u, {"x": 1, "u": 1, "t": 1})
OBSERVER = Observer(
    np.array([[0.0, 1.0], [-2.0, -0.6]]) - L @ C, np.hstack([[[0.0], [1.0]], L]), np.eye(2), np.zeros((2, 4)),
    -F.T @ C, np.hstack([np.zeros((2, 1)), F.T]), F, np.array([10.0, -2.0]), U0, Y0,
    NonlinearTerm(np.array([[0.0], [-0.1]]), np.eye(1, 2), np.zeros(1), np.array([-5.0]), np.array([5.0]), PHI),
)  # fmt: skip
PREDICTION = Prediction(C, np.zeros((3, 1)))


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(kernelcache.VARIABLE, str(tmp_path_factory.mktemp("cache")))
        compiled.forget()
        yield


@pytest.fixture(scope="module")
def estimator():
    return Estimator.build(OBSERVER, H, prediction=PREDICTION, engine="numba")


def log(rows=50):
    t = np.arange(rows) * H
    return t, U0 + np.sin(t)[:, None], Y0 + np.column_stack([np.sin(2 * t), np.cos(t), np.sin(t)])


# ------------------------------------------------------------ text


def test_every_operation_has_a_text():
    assert set(source.PYTHON) == set(OPERATIONS)


@given(st.floats())
def test_a_number_written_as_text_reads_back_to_the_same_bits(value):
    read = float(source.literal(value).strip("()"))
    assert (math.isnan(read) and math.isnan(value)) or read.hex() == value.hex()


def test_every_operation_means_in_the_compiled_text_what_it_means_on_arrays():
    groups, names = {"x": ("a", "b")}, sorted(OPERATIONS)
    nodes = [("input", 0, 0), ("input", 0, 1)] + [(op, *range(OPERATIONS[op])) for op in names]
    graph = Graph(groups, tuple(nodes), tuple(range(2, len(nodes))))
    lines = source.statements(nodes, graph.outputs, [["a", "b"]], [f"out[{i}]" for i in range(len(names))], "n")
    body = "".join(f"    {line}\n" for line in lines)
    text = f"@kernel(int64(float64, float64, row))\ndef all_of_them(a, b, out):\n{body}    return 0\n"
    function, out = compiled.load(Program(text))["all_of_them"], np.empty(len(names))
    points = [0.0, -0.0, 0.3, -0.7, 1.0, 2.5, -3.0, math.nan, math.inf, -math.inf]
    with np.errstate(all="ignore"):
        for a in points:
            for b in points:
                function(a, b, out)
                expected = walk(graph, NUMPY, [np.float64(a), np.float64(b)])
                # Two libraries of elementary functions, each right to one unit in the last place or so.
                np.testing.assert_allclose(out, expected, rtol=1e-14, err_msg=f"{names} at {a}, {b}")


def test_long_expressions_are_cut_into_statements_of_bounded_depth():
    graph = Graph.trace(lambda x: [sum((ca.sin(x * k) for k in range(200)), x)], {"x": 1})
    lines = source.statements(graph.nodes, graph.outputs, [["x"]], ["y"], "n")
    assert max(map(len, lines)) < 4 * source._LONG


def test_an_unknown_operation_has_no_text():
    with pytest.raises(InputError, match="no program text"):
        source.statements([("input", 0, 0), ("__import__", 0)], [1], [["x"]], ["y"], "n")


def test_a_program_that_cannot_be_compiled_says_so_and_leaves_nothing_behind():
    program = Program("@kernel(int64(int64))\ndef wrong(x):\n    return unknown(x)\n")
    with pytest.raises(Inconclusive, match="could not be compiled: TypingError"):
        compiled.load(program)
    assert compiled.where(program) == ""


# ------------------------------------------------------------ what can be given


def test_lists_integers_strided_and_read_only_arrays_are_samples_too(estimator):
    state, _ = estimator.step(estimator.init(), 0.0, U0, Y0)
    reading = np.array([101.0, 52.0, -8.0])
    frozen, strided = reading.copy(), np.repeat(reading, 2)[::2]
    frozen.setflags(write=False)
    expected = estimator.step(state, H, np.array([4.0]), reading)[1]
    for u1, y1 in [
        ([4.0], [101.0, 52, -8]), (4, reading.astype(int)), (np.array([4.0], dtype=np.float32), frozen),
        (np.array([4.0]), strided), (np.array(4.0), tuple(reading)),
    ]:  # fmt: skip
        found = estimator.step(state, H, u1, y1)[1]
        np.testing.assert_array_equal(found.state, expected.state)
        buffers = estimator.buffers(state)
        estimator.step_into(buffers, H, u1, y1)
        np.testing.assert_array_equal(buffers.fault, expected.fault)


@pytest.mark.parametrize(
    ("t", "u", "y", "message"),
    [
        (H, U0, Y0[:2], r"y is \(2,\)"),
        (H, np.zeros(2), Y0, r"u is \(2,\)"),
        (H, U0, Y0[None], r"y is \(1, 3\)"),
        (0.0, U0, Y0, "time must increase"),
        (math.nan, U0, Y0, "time must increase"),
    ],
)
def test_what_is_refused_leaves_the_buffers_as_they_were(estimator, t, u, y, message):
    state, _ = estimator.step(estimator.init(), 0.0, U0, Y0 + 1.0)
    buffers = estimator.buffers(state)
    before = buffers.fault.copy(), buffers.t
    with pytest.raises(InputError, match=message):
        estimator.step(state, t, u, y)
    with pytest.raises(InputError, match=message):
        estimator.step_into(buffers, t, u, y)
    np.testing.assert_array_equal(buffers.fault, before[0])
    assert buffers.t == before[1]
    estimator.step_into(buffers, H, U0, Y0)
    np.testing.assert_array_equal(buffers.state, estimator.step(state, H, U0, Y0)[1].state)


def test_a_state_of_another_estimator_is_refused(estimator):
    small = Observer(*(np.zeros((1, 1)) for _ in range(7)), np.zeros(1), np.zeros(0), np.zeros(1))
    foreign = Estimator.build(small, H, engine="casadi").init()
    with pytest.raises(InputError, match="another estimator"):
        estimator.step(foreign, 0.0, U0, Y0)


def test_compiled_steps_mutate_nothing_and_their_arrays_are_read_only(estimator):
    state, _ = estimator.step(estimator.init(), 0.0, U0, Y0)
    u, y = U0.copy(), Y0 + 1.0
    kept = [a.copy() for a in (state._row, u, y)]
    new, estimate = estimator.step(state, H, u, y)
    for a, b in zip(kept, (state._row, u, y), strict=True):
        np.testing.assert_array_equal(a, b)
    for array in (new.z, new.v, estimate.fault, estimate.state, estimate.corrected):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(AttributeError):
        estimate.fault = np.zeros(2)


def test_a_state_survives_pickling(estimator):
    state, _ = estimator.step(estimator.init(), 0.0, U0, Y0)
    again = pickle.loads(pickle.dumps(state))
    np.testing.assert_array_equal(
        estimator.step(again, H, U0, Y0 + 1)[1].fault, estimator.step(state, H, U0, Y0 + 1)[1].fault
    )
    assert pickle.loads(pickle.dumps(estimator)).engine.name == "numba"


def test_buffers_flag_a_gap_and_forget_it_afterwards(estimator):
    t, u, y = log(4)
    y[2, 0] = math.nan
    buffers, seen = estimator.buffers(), []
    ok = buffers.ok
    for k in range(4):
        estimator.step_into(buffers, t[k], u[k], y[k])
        seen.append((ok.tolist(), buffers.complete))
    whole = [True] * 3
    assert seen == [(whole, True), (whole, True), ([False, True, True], False), (whole, True)]
    assert buffers.snapshot().gaps == 1


def test_an_estimator_is_shared_by_threads(estimator):
    t, u, y = log(300)
    expected = estimator.replay(t, u, y)
    differences = []

    def run():
        state = estimator.init()
        for k in range(len(t)):
            state, estimate = estimator.step(state, t[k], u[k], y[k])
            differences.append(np.abs(estimate.state - expected.state[k]).max())

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert max(differences) == 0.0


# ------------------------------------------------------------ which engine


def test_a_short_log_and_a_single_step_compile_nothing():
    compiled.forget()
    fresh = Estimator.build(OBSERVER, H)
    fresh.replay(*log())
    fresh.step(fresh.init(), 0.0, U0, Y0)
    assert fresh.engine.name == "casadi"
    assert "engine casadi" in repr(fresh)


def test_a_long_log_compiles_when_that_repays_itself_and_the_result_is_the_same(monkeypatch):
    compiled.forget()
    fresh, asked = Estimator.build(OBSERVER, H), Estimator.build(OBSERVER, H, engine="casadi")
    monkeypatch.setattr(engine, "SHORT_LOG", 40)
    monkeypatch.setattr(engine, "PER_SAMPLE", (1.0, 0.0))
    trace, other = fresh.replay(*log()), asked.replay(*log())
    assert fresh.engine.name == "numba"
    assert (asked.engine.name, asked.engine.why) == ("casadi", "as asked")
    np.testing.assert_array_equal(trace.fault, other.fault)


def test_what_is_compiled_already_is_used_for_any_log_worth_asking(estimator, monkeypatch):
    monkeypatch.setattr(engine, "SHORT_LOG", 40)
    estimator.warm()
    again = Estimator.build(OBSERVER, H, prediction=PREDICTION)
    again.replay(*log())
    assert again.engine.name == "numba"
    assert again.engine.why in ("compiled before", "from the kernel cache")


@pytest.mark.parametrize("reason", ["Numba is not installed", "NUMBA_DISABLE_JIT is set"])
def test_where_numba_is_not_to_be_had_the_other_engine_works_and_says_why(monkeypatch, reason):
    if "DISABLE" in reason:
        monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    else:
        monkeypatch.setattr(compiled.importlib.util, "find_spec", lambda _: None)
    compiled.forget()
    lean = Estimator.build(OBSERVER, H).warm()
    assert lean.engine == ("casadi", reason)
    assert np.isfinite(lean.replay(*log()).fault).all()
    with pytest.raises(InputError, match=reason):
        Estimator.build(OBSERVER, H, engine="numba")


def test_where_numba_fails_the_other_engine_works_and_says_why(monkeypatch):
    def failing(_):
        raise Inconclusive("the program could not be compiled", why="LoweringError: made up")

    monkeypatch.setattr(engine, "load", failing)
    lean = Estimator.build(OBSERVER, H).warm()
    assert lean.engine == ("casadi", "LoweringError: made up")
    assert np.isfinite(lean.replay(*log()).fault).all()


def test_an_unknown_engine_is_refused():
    with pytest.raises(InputError, match="use auto, casadi or numba"):
        Estimator.build(OBSERVER, H, engine="fortran")
