# SPDX-License-Identifier: BSD-3-Clause
"""Expression graphs: tracing, values, derivatives, storage, identity, and readings by other algebras."""

import json
import os
import pickle
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.walk import NUMPY, OPERATIONS, walk

# Khosrowjerdi (2011), Example 4.2.
TEXTS = ["x1**3", "-6*x1**5 - 6*x1**2*x2 - 2*x1**4 - 2*x1**2"]
EXAMPLE_4_2 = Graph.from_texts(TEXTS, {"x": ["x1", "x2"]})


def everything(x, u):
    """Uses each operation a graph may hold, inside its domain for x in (0.1, 0.9)."""
    a, b = x[0], x[1]
    return [
        a + b, a - b, a * b, a / b, -a, a**2, ca.sqrt(a), a**b, a**2.5, ca.exp(a), ca.log(a), ca.sin(a), ca.cos(a),
        ca.tan(a), ca.asin(a), ca.acos(a), ca.atan(a), ca.atan2(a, b), ca.sinh(a), ca.cosh(a), ca.tanh(a), ca.asinh(a),
        ca.acosh(1 + a), ca.atanh(a), ca.log1p(a), ca.expm1(a), ca.fabs(a - b), ca.sign(a - b), ca.floor(5 * a),
        ca.ceil(5 * a), ca.hypot(a, b), ca.fmin(a, b), ca.fmax(a, b), a < b, a <= u, ca.eq(a, b), ca.ne(a, b),
        ca.logic_and(a < b, a < u), ca.logic_or(a < b, a < u), ca.logic_not(a < b), ca.if_else(a < b, a, u), 1 / a,
        2 * a, 3.0,
    ]  # fmt: skip


ALL = Graph.trace(everything, {"x": 2, "u": 1})


def test_the_operations_tested_here_are_all_there_are():
    assert {node[0] for node in ALL.nodes} == set(OPERATIONS) | {"input", "const"}


def test_a_value_is_what_the_formulas_say():
    x1, x2 = 0.3, -1.7
    expected = [x1**3, -6 * x1**5 - 6 * x1**2 * x2 - 2 * x1**4 - 2 * x1**2]
    np.testing.assert_allclose(EXAMPLE_4_2([x1, x2]), expected, rtol=1e-14)  # six roundings each


def test_many_points_give_the_same_bits_as_one_by_one():
    rng = np.random.default_rng(0)
    for rows in (0, 1, 1023, 1024, 2500):  # around the size of a mapped block
        x, u = rng.uniform(0.1, 0.9, (rows, 2)), rng.uniform(0.1, 0.9, (rows, 1))
        values = ALL.many(x, u)
        assert values.shape == (rows, ALL.n_outputs)
        for i in range(0, rows, 97):
            assert values[i].tobytes() == ALL(x[i], u[i]).tobytes()


def test_numpy_walks_to_the_same_values():
    rng = np.random.default_rng(1)
    x, u = rng.uniform(0.1, 0.9, (500, 2)), rng.uniform(0.1, 0.9, (500, 1))
    walked = np.array([np.broadcast_to(y, 500) for y in walk(ALL, NUMPY, x.T, u.T)]).T
    # Two mathematical libraries, each within 4 units in the last place; values here are of size 3 at most.
    np.testing.assert_allclose(walked, ALL.many(x, u), rtol=2e-15, atol=2e-15)


def test_the_jacobian_agrees_with_differences():
    x, h = np.array([0.4, -0.7]), 1e-6
    jacobian = EXAMPLE_4_2.jacobian("x")
    differences = np.array([(EXAMPLE_4_2(x + h * e) - EXAMPLE_4_2(x - h * e)) / (2 * h) for e in np.eye(2)]).T
    np.testing.assert_allclose(jacobian(x), differences, atol=1e-9)  # h^2 = 1e-12 and rounding 1e-16 / h = 1e-10
    assert jacobian.many(np.tile(x, (3, 1))).shape == (3, 2, 2)
    symbols = ca.SX.sym("x", 2)
    embedded = ca.Function("j", [symbols], [jacobian.symbolic(symbols)])(x).full()
    assert np.array_equal(embedded, jacobian(x))


def test_a_graph_embeds_in_a_larger_expression():
    z = ca.MX.sym("z", 2)
    larger = ca.Function("larger", [z], [EXAMPLE_4_2.symbolic(2 * z) + 1])
    np.testing.assert_allclose(larger([0.1, 0.2]).full().ravel(), EXAMPLE_4_2([0.2, 0.4]) + 1, rtol=1e-15)


@pytest.mark.parametrize("graph", [EXAMPLE_4_2, ALL, ALL.jacobian("x").graph])
def test_a_graph_survives_storage_without_losing_a_bit(graph):
    again = Graph.from_dict(json.loads(json.dumps(graph.to_dict())))
    assert again == graph and hash(again) == hash(graph) and again.digest() == graph.digest()
    assert again.texts == graph.texts
    points = [np.full(size, 0.37) for size in graph.sizes]
    assert again(*points).tobytes() == graph(*points).tobytes()
    assert pickle.loads(pickle.dumps(graph)) == graph


def test_source_texts_and_constants_come_back():
    graph = Graph.from_texts(["-g*sin(a)"], {"x": ["a"]}, {"g": 0.1})
    again = Graph.from_dict(graph.to_dict())
    assert again.texts == ("-g*sin(a)",) and dict(again.constants) == {"g": 0.1}


def test_the_digest_is_the_same_in_another_process():
    script = (
        "from faultrecon.graph.function import Graph\n"
        f"print(Graph.from_texts({TEXTS!r}, {{'x': ['x1', 'x2']}}).digest())"
    )
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        out = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment
        )
        assert out.stdout.strip() == EXAMPLE_4_2.digest()


def test_the_same_function_written_as_text_and_as_code_is_one_graph():
    code = Graph.trace(
        lambda x: [x[0] ** 3, -6 * x[0] ** 5 - 6 * x[0] ** 2 * x[1] - 2 * x[0] ** 4 - 2 * x[0] ** 2], {"x": 2}
    )
    assert code == EXAMPLE_4_2
    assert code != Graph.from_texts(["x1", "x2"], {"x": ["x1", "x2"]})


def test_another_constant_in_the_last_place_is_another_graph():
    one, other = (Graph.from_texts(["c*a"], {"x": ["a"]}, {"c": c}) for c in (0.1, np.nextafter(0.1, 1)))
    assert one != other and one.digest() != other.digest()


def test_plain_array_code_traces_like_numpy_vectors():
    A, b = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([5.0, 6.0])

    def f(x, u):
        return A @ x + b * np.sin(x) + np.maximum(x, 0.0) * u

    before = ca.GlobalOptions.getNumpyMode()
    graph = Graph.trace(f, {"x": 2, "u": 1})
    x = np.array([0.3, -0.4])
    np.testing.assert_allclose(graph(x, [2.0]), f(x, 2.0), rtol=1e-15)
    assert ca.GlobalOptions.getNumpyMode() == before


def test_a_switch_shields_what_lies_outside_its_domain():
    graph = Graph.trace(lambda x: ca.if_else(x > 0, ca.log(x), 7.0), {"x": 1})
    assert graph([-1.0])[0] == 7.0


def test_wrong_shapes_and_names_are_told_apart():
    with pytest.raises(InputError, match="need shapes"):
        EXAMPLE_4_2([1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="need shapes"):
        ALL.many(np.zeros((3, 2)), np.zeros((2, 1)))
    with pytest.raises(InputError, match="no input 'y'"):
        EXAMPLE_4_2.jacobian("y")
    with pytest.raises(InputError, match="declared twice"):
        Graph.from_texts(["a"], {"x": ["a"], "u": ["a"]})
    with pytest.raises(InputError, match="declared twice"):
        Graph.from_texts(["a"], {"x": ["a"]}, {"a": 1.0})
    with pytest.raises(InputError, match="not a finite number"):
        Graph.from_texts(["a"], {"x": ["a"]}, {"c": float("nan")})
    with pytest.raises(InputError, match=r"phi\[1\]: unknown name"):
        Graph.from_texts(["a", "b"], {"x": ["a"]}, where="phi")
    with pytest.raises(InputError, match="must return"):
        Graph.trace(lambda x: "text", {"x": 1})


@pytest.mark.parametrize(
    "damage",
    [
        {"nodes": [["input", 0, 5]]},
        {"nodes": [["input", -1, 0]]},
        {"nodes": [["const", "nan"]]},
        {"nodes": [["const", "0x1p99999"]]},
        {"nodes": [["const", 1.0]]},
        {"nodes": [["os.system", 0]]},
        {"nodes": [["sin", 0]]},  # its own operand
        {"nodes": [["add", 0]]},
        {"nodes": [[]]},
        {"nodes": 3},
        {"outputs": [99]},
        {"outputs": []},
        {"outputs": [True]},
        {"inputs": None},
    ],
)
def test_a_damaged_file_is_refused(damage):
    with pytest.raises(InputError):
        Graph.from_dict({**EXAMPLE_4_2.to_dict(), **damage})


def test_one_channel_stands_alone():
    channel = EXAMPLE_4_2.channel(0)
    assert channel == Graph.from_texts(TEXTS[:1], {"x": ["x1", "x2"]})
    assert channel.texts == (TEXTS[0],)


def test_an_algebra_that_lacks_an_operation_says_which():
    with pytest.raises(InputError, match="'sin' has no meaning"):
        walk(Graph.from_texts(["sin(a)"], {"x": ["a"]}), {"const": float}, [0.0])
    strings = {"mul": "({} * {})".format, "const": repr}
    assert walk(Graph.from_texts(["2*a**2"], {"x": ["a"]}), strings, ["a"]) == ["(2.0 * (a * a))"]
