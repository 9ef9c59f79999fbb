# SPDX-License-Identifier: BSD-3-Clause
"""Rates of functions along boxes of motions, and what a linear system keeps of what drives it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

import faultrecon as fr
from faultrecon.graph.function import Graph
from faultrecon.graph.interval import Interval
from faultrecon.graph.motion import enclose_motion, kept_by, magnitude, product

NUMBERS = st.floats(-3.0, 3.0)


def box(*ends: tuple[float, float]) -> Interval:
    """One box (k, 1)."""
    both = np.array(ends, dtype=float)
    return Interval(both[:, [0]], both[:, [1]])


@settings(max_examples=60, deadline=None)
@given(st.lists(NUMBERS, min_size=8, max_size=8), st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4))
def test_values_and_rates_along_any_motion_in_the_box_are_enclosed(ends, shares):
    graph = Graph.from_texts(["x**3 - 2*x*y", "sin(3*x) + abs(y)"], {"x": ("x", "y")})
    pairs = [tuple(sorted(pair)) for pair in zip(ends[::2], ends[1::2], strict=True)]
    (x, y), (vx, vy) = ([a + s * (b - a) for (a, b), s in zip(p, q, strict=True)] for p, q in
                        ((pairs[:2], shares[:2]), (pairs[2:], shares[2:])))  # fmt: skip
    values, rates = enclose_motion(graph, {"x": box(*pairs[:2])}, {"x": box(*pairs[2:])})
    true = [x**3 - 2 * x * y, np.sin(3 * x) + abs(y)]
    moves = [3 * x**2 * vx - 2 * vx * y - 2 * x * vy, 3 * np.cos(3 * x) * vx + np.sign(y) * vy]
    for i in range(2):
        slack = 1e-12 * (1 + abs(true[i]) + abs(moves[i]))  # the comparison itself is rounded
        assert values.lo[i, 0] - slack <= true[i] <= values.hi[i, 0] + slack
        if y != 0 or i == 0:
            assert rates.lo[i, 0] - slack <= moves[i] <= rates.hi[i, 0] + slack


def test_a_term_that_jumps_has_no_rate_and_is_named():
    graph = Graph.from_texts(["sign(x)"], {"x": ("x",)})
    with pytest.raises(fr.InputError, match=r"no bound on how fast sign\(x\) changes.*may jump"):
        enclose_motion(graph, {"x": box((-1.0, 1.0))}, {"x": box((1.0, 1.0))})
    assert enclose_motion(graph, {"x": box((0.5, 1.0))}, {"x": box((1.0, 1.0))})[1].hi[0, 0] == 0.0


def test_a_range_that_is_not_known_does_no_harm_where_it_does_not_act():
    graph = Graph.from_texts(["sin(x)", "x*y"], {"x": ("x", "y")})
    everywhere = (-np.inf, np.inf)
    values, rates = enclose_motion(graph, {"x": box(everywhere, (0.0, 0.0))}, {"x": box((-2.0, 1.0), (0.0, 0.0))})
    assert values.hi[:, 0].tolist() == [1.0, 0.0] and magnitude(rates).tolist() == [2.0, 0.0]
    M = Interval.point(np.array([[0.0, 1.0]]))
    assert product(M, box(everywhere, (-1.0, 2.0))).hi[0, 0] == 2.0


@pytest.mark.parametrize("T", [1e-3, 0.05, 0.5])
def test_what_a_linear_system_keeps_is_bounded_from_above_and_closely(T):
    r = np.random.default_rng(3)
    A, B = 3 * r.standard_normal((3, 3)), r.standard_normal((3, 2))
    s = (np.arange(2000) + 0.5) * T / 2000
    integral = sum((T - at) * np.abs(expm(A * at) @ B) for at in s) / 2000
    kept = kept_by(A, T, B)
    assert np.all(kept >= integral * (1 - 1e-6))  # the midpoint rule errs by some 1e-7 here
    assert kept.max() <= 1.25 * integral.max()


def test_nothing_is_kept_of_what_does_not_enter():
    assert not kept_by(np.diag([-1.0, -2.0]), 0.1, np.array([[1.0], [0.0]]))[1].any()
    assert kept_by(np.eye(2), 0.1, np.zeros((2, 0))).shape == (2, 0)
