# SPDX-License-Identifier: BSD-3-Clause
"""Proved ranges and Lipschitz constants: known values, kinks, domains, and how a refusal reads."""

import math

import casadi as ca
import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.graph.enclose import enclose, lipschitz_bound, lipschitz_per_channel
from faultrecon.graph.function import Graph
from faultrecon.graph.interval import Interval
from faultrecon.graph.spectral import norm_above


def graph(*texts, n=2):
    return Graph.from_texts(list(texts), {"x": [f"x{i + 1}" for i in range(n)]})


# Khosrowjerdi (2011), Example 4.2.
EXAMPLE_4_2 = graph("x1**3", "-6*x1**5 - 6*x1**2*x2 - 2*x1**4 - 2*x1**2")


def bound(function, *box, **options):
    return lipschitz_bound(function, "x", box, **options)


@pytest.mark.parametrize("box", [(-3.2, 3.2), (0.0, 0.1), (-1e-9, 1e-9), (-0.1, 5.0), (-1e9, 1e9)])
def test_sin_has_constant_1_on_any_box_that_holds_0(box):
    found = bound(graph("sin(x1)", n=1), box)
    assert 1.0 <= found.value <= 1.01 and found.complete


def test_sin_away_from_0_is_flatter():
    found = bound(graph("sin(x1)", n=1), (1.0, 2.0))
    assert math.cos(1.0) <= found.value <= 1.01 * math.cos(1.0)  # |cos| is greatest at 1


def test_example_4_2_has_constant_1_17_on_the_box_where_the_paper_needs_it():
    found = bound(EXAMPLE_4_2, (-0.17634, 0.17634), (-0.17634, 0.17634))
    assert found.value == pytest.approx(1.17, rel=0.01)
    assert found.lower <= found.value <= 1.01 * found.lower and found.complete


def test_each_channel_has_a_constant_of_its_own_and_together_they_bound_the_whole():
    box = [(-0.17634, 0.17634)] * 2
    channels = lipschitz_per_channel(EXAMPLE_4_2, "x", box)
    assert channels[0].value == pytest.approx(3 * 0.17634**2, rel=0.01)
    assert bound(EXAMPLE_4_2, *box).lower <= math.hypot(*(c.value for c in channels))


@pytest.mark.parametrize(
    ("texts", "constant"),
    [
        (["sat(x1)"], 1.0),
        (["0.5*(abs(x1 + 1) - abs(x1 - 1))"], 1.0),  # the same saturation, as Example 4.1 prints it
        (["max(x1, x2)"], 1.0),
        (["max(x1, 0)", "min(x1, x2)"], math.sqrt(2)),
        (["sat(x1 + x2)", "sat(x1 - x2)"], math.sqrt(2)),
        (["abs(x1 + x2)"], math.sqrt(2)),
        (["x1 + x2", "x1 - x2"], math.sqrt(2)),
        (["3*x1 - 4*x2"], 5.0),
        (["x1*x2"], math.hypot(3, 3)),
        (["7"], 0.0),
    ],
)
def test_kinks_and_rotations_cost_nothing(texts, constant):
    found = bound(graph(*texts), (-3.0, 3.0), (-3.0, 3.0))
    assert constant <= found.value <= 1.01 * constant and found.complete


def test_a_switch_is_bounded_on_either_side_and_refused_across():
    switch = Graph.trace(lambda x: ca.if_else(x > 0.3, x**2, x), {"x": 1})
    assert bound(switch, (0.4, 1.0)).value == pytest.approx(2.0, rel=0.01)
    with pytest.raises(InputError, match="may jump"):
        bound(switch, (0.0, 1.0))


def test_a_condition_on_another_input_is_no_jump():
    switch = Graph.trace(lambda x, u: ca.if_else(u > 0, 3 * x, ca.sin(x)), {"x": 1, "u": 1})
    assert bound(switch, (-1.0, 1.0), others={"u": [(-1.0, 1.0)]}).value == pytest.approx(3.0, rel=0.01)


def test_the_constant_holds_for_every_value_of_the_other_inputs():
    product = Graph.from_texts(["u*sin(a)"], {"x": ["a"], "u": ["u"]})
    assert bound(product, (0.0, 1.0), others={"u": [(-3.0, 2.0)]}).value == pytest.approx(3.0, rel=0.01)
    with pytest.raises(InputError, match="boxes are needed for x, u"):
        bound(product, (0.0, 1.0))


def test_overestimated_domains_are_settled_by_halving():
    # u^2 - u + 1 >= 3/4, but one interval evaluation says [0, 3].
    shifted = Graph.from_texts(["a + log(u**2 - u + 1)"], {"x": ["a"], "u": ["u"]})
    assert bound(shifted, (0.0, 1.0), others={"u": [(-1.0, 1.0)]}).value == 1.0


def test_a_small_budget_still_proves_but_admits_the_gap():
    wavy = graph("sin(x1*x2)*x1")
    rough = bound(wavy, (-3.0, 3.0), (-3.0, 3.0), budget=3)
    fine = bound(wavy, (-3.0, 3.0), (-3.0, 3.0))
    assert not rough.complete and fine.complete and rough.boxes <= 3
    assert rough.value >= fine.value >= fine.lower >= rough.lower


@pytest.mark.parametrize(
    ("text", "box", "function"),
    [
        ("log(x1)", (0.0, 1.0), "log"),
        ("log(x1 - 0.3)", (0.0, 1.0), "log"),
        ("1/x1", (-1.0, 2.0), "division"),
        ("1/(x1 - 0.3)", (0.0, 1.0), "division"),
        ("x1**-2", (-1.0, 1.0), "division"),
        ("sqrt(x1)", (0.0, 1.0), "sqrt"),
        ("sqrt(abs(x1 - 0.3))", (0.0, 1.0), "sqrt"),
        ("sqrt(x1)", (-1.0, 1.0), "sqrt"),
        ("tan(x1)", (1.0, 2.0), "tan"),
        ("asin(x1)", (0.0, 1.0), "asin"),
        ("acos(x1)", (0.0, 2.0), "acos"),
        ("x1**1.5", (-1.0, 1.0), "power 1.5"),
        ("sign(x1)", (-1.0, 1.0), "sign"),
        ("atan2(x1, -1)", (-1.0, 1.0), "atan2"),
        ("tanh(log(x1))", (-1.0, 1.0), "log"),  # finite again further on, but undefined all the same
    ],
)
def test_leaving_the_domain_names_function_and_box(text, box, function):
    with pytest.raises(InputError, match=rf"no Lipschitz constant in 'x' on x1.*{function}"):
        bound(graph(text, n=1), box)


def test_an_enclosure_outside_the_domain_names_function_and_box():
    with pytest.raises(InputError, match=r"x1 in \[0, 1\].*log of a number"):
        enclose(graph("log(x1)", n=1), {"x": [(0.0, 1.0)]})
    with pytest.raises(InputError, match=r"division by a number that may be 0 \(its argument is in \[-1, 2\]\)"):
        enclose(graph("tanh(1/x1)", n=1), {"x": [(-1.0, 2.0)]})


@pytest.mark.parametrize(
    ("text", "box", "low", "high"),
    [
        ("sin(x1)", (0.0, 3.0), 0.0, 1.0),
        ("cos(x1)", (-1.0, 4.0), -1.0, 1.0),
        ("x1**2", (-2.0, 1.0), 0.0, 4.0),
        ("sqrt(1 - x1**2)", (-1.0, 1.0), 0.0, 1.0),  # exact ends: not a hair outside the domain
        ("sqrt(x1)", (0.0, 0.25), 0.0, 0.5),
        ("abs(x1) + max(x1, 0) + min(x1, 0)", (-1.0, 2.0), -1.0, 4.0),
        ("atan2(x1, 1)", (-1.0, 1.0), -math.pi / 4, math.pi / 4),
        ("x1**2.5", (0.0, 4.0), 0.0, 32.0),
        ("exp(x1)", (0.0, 1.0), 1.0, math.e),
        ("cosh(x1)", (-1.0, 0.5), 1.0, math.cosh(1.0)),
    ],
)
def test_ranges_of_single_functions_are_sharp(text, box, low, high):
    ((a, b),) = enclose(graph(text, n=1), {"x": [box]})
    assert a <= low + 1e-15 and b >= high - 1e-15
    assert (a, b) == pytest.approx((low, high), abs=1e-14, rel=1e-14)  # a few outward roundings


def test_boxes_must_be_finite_ordered_and_complete():
    function = graph("x1 + x2")
    for box in ([(1.0, 0.0), (0.0, 1.0)], [(0.0, math.inf), (0.0, 1.0)], [(math.nan, 1.0), (0.0, 1.0)], [(0.0, 1.0)]):
        with pytest.raises(InputError, match="the box of"):
            enclose(function, {"x": box})
    with pytest.raises(InputError, match="no input 'z'"):
        lipschitz_bound(function, "z", [(0.0, 1.0)])


def test_the_matrix_norm_bound_is_above_the_norm_and_close_to_it():
    rng = np.random.default_rng(2)
    for m, k in ((1, 1), (1, 5), (4, 1), (3, 3), (2, 6), (7, 4)):
        matrices = rng.normal(size=(50, m, k)) * 10.0 ** rng.uniform(-150, 150, (50, 1, 1))
        exact = np.linalg.norm(matrices, 2, axis=(1, 2))
        above = norm_above(Interval(matrices, matrices))
        # LAPACK's singular values are good to a few units of 1e-16 relative; the bound's slack is 1e-12.
        assert (above >= exact * (1 - 1e-14)).all() and (above <= exact * (1 + 1e-12)).all()
        low, high = matrices - 0.1 * abs(matrices), matrices + 0.2 * abs(matrices)
        inside = low + rng.uniform(size=low.shape) * (high - low)
        assert (norm_above(Interval(low, high)) >= np.linalg.norm(inside, 2, axis=(1, 2)) * (1 - 1e-14)).all()


def test_a_kink_on_a_face_of_the_box_lends_it_no_slope():
    found = bound(graph("min(x1, 0)", "min(x1, 0) + max(x1, 0)", n=1), (0.0, 1.0))
    assert found.lower <= 1.0 <= found.value <= 1.01
