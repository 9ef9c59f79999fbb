# SPDX-License-Identifier: BSD-3-Clause
"""No point of a box escapes its enclosure, and no slope exceeds a proved Lipschitz constant."""

import flint
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.finding import InputError
from faultrecon.graph.enclose import enclose, lipschitz_bound
from faultrecon.graph.function import Graph
from faultrecon.graph.interval import Interval, IntervalAlgebra
from faultrecon.graph.walk import walk

N = 3
NAMES = [f"x{i + 1}" for i in range(N)]
LEAVES = st.sampled_from(NAMES) | st.floats(-3, 3, allow_subnormal=False).map(lambda c: f"({c!r})")
# Every formula is defined everywhere, so that no example is lost to its domain.
FORMS = [
    "({0} + {1})", "({0} - {1})", "({0} * {1})", "({0} / (1.5 + {1}**2))", "(({0})**3)", "(({0})**2)", "abs({0})",
    "min({0}, {1})", "max({0}, {1})", "sat({0})", "sin({0})", "cos({0})", "tanh({0})", "atan({0})", "exp(sin({0}))",
    "log(0.1 + ({0})**2)", "sqrt(0.01 + ({0})**2)", "tan(sat({0}))", "asin(0.9*sin({0}))", "acos(0.5*sat({0}))",
    "sinh(tanh({0}))", "cosh(sat({0}))", "atan2({0}, 1 + abs({1}))", "(abs({0})**2.5)", "pow(1 + abs({0}), sat({1}))",
]  # fmt: skip
FORMULAS = st.recursive(
    LEAVES,
    lambda inner: st.builds(lambda form, a, b: form.format(a, b), st.sampled_from(FORMS), inner, inner),
    max_leaves=8,
)
BOXES = st.lists(
    st.tuples(st.floats(-4, 4), st.sampled_from([0.0, 1e-9, 0.1, 1.0, 3.0])).map(lambda c: (c[0], c[0] + c[1])),
    min_size=N,
    max_size=N,
)


def points_in(box, count, seed):
    """Points of a box, many of them on its faces and corners, where extremes are."""
    low, high = np.array(box).T
    share = np.clip(np.random.default_rng(seed).uniform(-0.3, 1.3, (count, N)), 0.0, 1.0)
    return np.clip(low + share * (high - low), low, high)


def thin(graph, points):
    """An enclosure of the exact value at each point."""
    with np.errstate(all="ignore"):
        outputs = walk(graph, IntervalAlgebra(), [Interval(p, p) for p in points.T])
    return [(np.broadcast_to(y.lo, len(points)), np.broadcast_to(y.hi, len(points))) for y in outputs]


@settings(max_examples=100, deadline=None)
@given(st.lists(FORMULAS, min_size=1, max_size=2), BOXES, st.integers(0, 2**32 - 1))
def test_no_point_of_a_box_escapes_its_enclosure(formulas, box, seed):
    graph = Graph.from_texts(formulas, {"x": NAMES})
    ends = enclose(graph, {"x": box})
    points = points_in(box, 5000, seed)  # 2e5 points over the examples
    values = graph.many(points)
    for i, (low, high) in enumerate(ends):
        outside = (values[:, i] < low) | (values[:, i] > high)
        if outside.any():
            # Floating point may round a value across an end; the exact value, enclosed at that point, may not.
            below, above = thin(graph, points[outside])[i]
            assert (above >= low).all() and (below <= high).all()
            slack = 1e-11 * np.maximum(1.0, np.abs(below))  # thousands of roundings; the true error is far smaller
            assert (np.abs(values[outside, i] - below) <= slack + (above - below)).all()


@settings(max_examples=100, deadline=None)
@given(st.lists(FORMULAS, min_size=1, max_size=2), BOXES, st.integers(0, 2**32 - 1))
def test_no_secant_is_steeper_than_the_proved_constant(formulas, box, seed):
    graph = Graph.from_texts(formulas, {"x": NAMES})
    found = lipschitz_bound(graph, "x", box, budget=200)
    a, b = points_in(box, 500, seed), points_in(box, 500, seed + 1)
    b[::2] = np.clip(a[::2] + 1e-3 * (b[::2] - a[::2]), *np.array(box).T)
    rise = np.linalg.norm(graph.many(a) - graph.many(b), axis=1)
    # What rounding can add to a difference: the widths of the exact values' enclosures at both ends.
    noise = sum((hi - lo) for points in (a, b) for lo, hi in thin(graph, points))
    noise = noise + 1e-14 * (1.0 + np.abs(graph.many(a)).sum(axis=1))
    assert (rise <= found.value * np.linalg.norm(a - b, axis=1) + noise).all()
    assert found.lower <= found.value


@settings(max_examples=100, deadline=None)
@given(FORMULAS, BOXES, st.integers(0, 2**32 - 1))
def test_no_derivative_is_larger_than_the_proved_constant(formula, box, seed):
    graph = Graph.from_texts([formula], {"x": NAMES})
    found = lipschitz_bound(graph, "x", box, budget=100)
    low, high = np.array(box).T
    moving = high > low  # across a side of no width there is nothing to differ by
    # Strictly inside: at a kink on a face, half of the slope belongs to the world outside the box.
    inside = low + np.random.default_rng(seed).uniform(0.01, 0.99, (500, N)) * (high - low)
    slopes = np.linalg.norm(graph.jacobian("x").many(inside)[:, 0, moving], axis=1)
    # CasADi's derivative, in floating point, of a formula of at most some dozens of operations.
    assert slopes.max(initial=0.0) <= found.value * (1 + 1e-9) + 1e-9


# Each function alone, on boxes inside its domain, against 200-bit ball arithmetic: a wrong rounding by one unit shows.
EXACT = {
    "sin": (lambda x: x.sin(), -50, 50), "cos": (lambda x: x.cos(), -50, 50), "tan": (lambda x: x.tan(), -1.5, 1.5),
    "asin": (lambda x: x.asin(), -1, 1), "acos": (lambda x: x.acos(), -1, 1), "atan": (lambda x: x.atan(), -50, 50),
    "sinh": (lambda x: x.sinh(), -50, 50), "cosh": (lambda x: x.cosh(), -50, 50), "tanh": (lambda x: x.tanh(), -5, 5),
    "asinh": (lambda x: x.asinh(), -50, 50), "acosh": (lambda x: x.acosh(), 1, 50),
    "atanh": (lambda x: x.atanh(), -0.99, 0.99), "exp": (lambda x: x.exp(), -800, 800),
    "expm1": (lambda x: x.expm1(), -50, 50), "log": (lambda x: x.log(), 1e-9, 50),
    "log1p": (lambda x: x.log1p(), -0.99, 50), "sqrt": (lambda x: x.sqrt(), 0, 50), "abs": (lambda x: abs(x), -5, 5),
    "sq": (lambda x: x * x, -5, 5), "neg": (lambda x: -x, -5, 5), "floor": (lambda x: x.floor(), -5, 5),
    "ceil": (lambda x: x.ceil(), -5, 5), "sign": (lambda x: x.sgn(), -5, 5),
}  # fmt: skip
EXACT_2 = {
    "add": (lambda x, y: x + y, -5, 5), "sub": (lambda x, y: x - y, -5, 5), "mul": (lambda x, y: x * y, -5, 5),
    "div": (lambda x, y: x / y, 0.3, 5), "min": (lambda x, y: x.min(y), -5, 5), "max": (lambda x, y: x.max(y), -5, 5),
    "atan2": (lambda x, y: flint.arb.atan2(x, y), 0.3, 5), "hypot": (lambda x, y: (x * x + y * y).sqrt(), -5, 5),
    "pow": (lambda x, y: x**y, 0.3, 5),
}  # fmt: skip


@pytest.mark.parametrize("name", [*EXACT, *EXACT_2])
def test_every_operation_encloses_its_exact_values(name):
    function, least, most = {**EXACT, **EXACT_2}[name]
    operands = 2 if name in EXACT_2 else 1
    rng = np.random.default_rng(len(name) + ord(name[0]))
    centre = rng.uniform(least, most, (operands, 200))
    width = (most - least) * 10.0 ** rng.uniform(-17, -0.5, centre.shape)
    low, high = np.clip(centre - width, least, most), np.clip(centre + width, least, most)
    result = getattr(IntervalAlgebra(), name)(*(Interval(a, b) for a, b in zip(low, high, strict=True)))
    share = rng.choice([0.0, 1.0, 0.5, 0.1], centre.shape)
    at = np.clip(low + share * (high - low), low, high)
    with flint.ctx.workprec(200):
        for j in range(200):
            exact = function(*(flint.arb(float(x)) for x in at[:, j]))
            assert not exact < flint.arb(float(result.lo[j])), (name, at[:, j])
            assert not exact > flint.arb(float(result.hi[j])), (name, at[:, j])


ALONE = ["sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "abs", "sat"]
TOGETHER = ["x1*x2", "x1/x2", "x1**3", "x1**2.5", "x1**-1.5"]
PAIRS = ["pow(x1, x2)", "atan2(x1, x2)", "min(x1, x2)", "max(x1, x2)"]


@pytest.mark.parametrize("text", [*(f"{name}(x1)" for name in ALONE), *TOGETHER, *PAIRS])
def test_every_function_has_its_own_derivative(text):
    # The straight part makes the norm see the sign of each derivative.
    graph = Graph.from_texts([f"{text} + 3*x1 + 2*x2"], {"x": ["x1", "x2"]})
    for point in np.random.default_rng(3).uniform(0.1, 0.9, (5, 2)):
        found = lipschitz_bound(graph, "x", [(v, v) for v in point])
        # CasADi's derivative, a dozen roundings; the bound at a point has a slack of 1e-13.
        assert found.value == pytest.approx(np.linalg.norm(graph.jacobian("x")(point)), rel=1e-12)
        assert found.lower == pytest.approx(found.value, rel=1e-12)


def test_huge_tiny_and_opposite_numbers_stay_enclosed():
    extremes = np.array(
        [0.0, -0.0, 5e-324, -5e-324, 1e-308, 1e-200, -1e-200, 1.0, -1.0, 1e200, -1e200, 1.7e308, -1.7e308]
    )
    a, b = (side.ravel() for side in np.meshgrid(extremes, extremes))
    for name in ("add", "sub", "mul", "div"):
        with np.errstate(all="ignore"):
            result = getattr(IntervalAlgebra(), name)(Interval(a, a), Interval(b, b))
        with flint.ctx.workprec(4000):  # any sum or product of two doubles is exact here
            for x, y, lo, hi in zip(a, b, result.lo, result.hi, strict=True):
                if name == "div" and y == 0.0:
                    assert np.isnan(lo) and np.isnan(hi)
                    continue
                exact = EXACT_2[name][0](flint.arb(float(x)), flint.arb(float(y)))
                assert not exact < flint.arb(float(lo)) and not exact > flint.arb(float(hi)), (name, x, y)


@settings(max_examples=50, deadline=None)
@given(FORMULAS, BOXES)
def test_a_smaller_box_never_has_a_larger_enclosure_or_constant(formula, box):
    graph = Graph.from_texts([formula], {"x": NAMES})
    inner = [(a, a + 0.5 * (b - a)) for a, b in box]
    ((low, high),), ((a, b),) = enclose(graph, {"x": box}), enclose(graph, {"x": inner})
    assert low <= a <= b <= high
    whole, part = (lipschitz_bound(graph, "x", x, budget=1).value for x in (box, inner))
    assert part <= whole * (1 + 1e-12)  # the norm bound itself is loose by 1e-13


def test_a_point_outside_the_domain_is_never_passed_over():
    graph = Graph.from_texts(["tanh(log(x1)) + x2 + x3"], {"x": NAMES})
    with pytest.raises(InputError, match="log"):
        lipschitz_bound(graph, "x", [(-1.0, 1.0)] * 3)
