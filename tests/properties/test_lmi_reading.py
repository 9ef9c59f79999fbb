# SPDX-License-Identifier: BSD-3-Clause
"""One expression, many readings: floating point, affine forms, exact integers and the stored tree agree."""

import json
from fractions import Fraction

import numpy as np
from hypothesis import given as forall
from hypothesis import settings
from hypothesis import strategies as st

from faultrecon.lmi.exact import DyadicAlgebra, integers, letters_from, read_tree
from faultrecon.lmi.expr import I, Inequality, __, blocks, given, let, sym, unknown
from faultrecon.lmi.problem import Problem, freedom
from faultrecon.lmi.prove import exact, fast_algebra, statement, tree
from faultrecon.lmi.solve import MANY, conic_data
from faultrecon.lmi.walk import leaves, substitute, value_of

EPS = np.finfo(float).eps
SIZES = st.integers(1, 4), st.integers(0, 3), st.integers(0, 2)


def inequality(rng, n, p, m, scale):
    """A bounded-real inequality like the methods' own, with every operation of the language in it, and a point."""
    A = given("A", rng.normal(size=(n, n)) * scale)
    B = given("B", rng.normal(size=(n, m)) * scale)
    C = given("C", rng.normal(size=(p, n)) / scale)
    α = given("α", rng.normal(size=(1, 1)))
    P, Z, β = unknown("P", n, n, symmetric=True), unknown("Z", n, p), unknown("β")
    Ω = let("Ω", A.T @ P + P @ A - C.T @ Z.T - Z @ C + β * α**2 * (I(n) * 0.5))
    whole = sym([[Ω, P @ B, C.T], [__, -β * I(m), 0], [__, __, -I(p)]]) < 0
    half = rng.normal(size=(n, n))
    return whole, {"P": half + half.T, "Z": rng.normal(size=(n, p)), "β": rng.normal(size=(1, 1))}


def as_fractions(dyadic):
    factor = Fraction(2) ** dyadic.exponent
    return [[Fraction(v) * factor for v in row] for row in integers(dyadic)]


def fractions(expr, values):
    """The value of an expression by Python's rational numbers: an algebra of its own, for comparison."""
    match expr.op:
        case "given" | "unknown":
            source = expr.args[1] if expr.op == "given" else np.reshape(values[expr.name], expr.shape)
            return [[Fraction(float(v)) for v in row] for row in source]
        case "let":
            return fractions(expr.args[1], values)
        case "number":
            return [[Fraction(expr.args[0])]]
        case "eye":
            return [[Fraction(i == j) for j in range(expr.shape[0])] for i in range(expr.shape[0])]
        case "zero":
            return [[Fraction(0)] * expr.shape[1] for _ in range(expr.shape[0])]
        case "block":
            rows = [[fractions(b, values) for b in row] for row in expr.args[0]]
            return [[v for b in row for v in b[i]] for row in rows for i in range(len(row[0]))]
    a = fractions(expr.args[0], values)
    match expr.op:
        case "neg":
            return [[-v for v in row] for row in a]
        case "T":
            return [[a[i][j] for i in range(len(a))] for j in range(expr.shape[0])]
    b = fractions(expr.args[1], values)
    match expr.op:
        case "add":
            return [[x + y for x, y in zip(r, s, strict=True)] for r, s in zip(a, b, strict=True)]
        case "scale":
            return [[a[0][0] * v for v in row] for row in b]
        case "matmul":
            inner = len(b)
            return [
                [sum((row[k] * b[k][j] for k in range(inner)), Fraction(0)) for j in range(expr.shape[1])] for row in a
            ]
    raise AssertionError(expr.op)


def vector(problem, values):
    """The scalar unknowns of a point, in the order of the problem."""
    v = np.zeros(problem.size)
    for name, leaf in problem.unknowns.items():
        value = np.asarray(values[name])
        part = [value[i, j] for i in range(leaf.shape[0]) for j in range(i + 1)] if leaf.args[1] else value.ravel()
        v[problem.offsets[name] : problem.offsets[name] + len(part)] = part
    return v


def rounding(whole, values):
    """What floating point may lose: every entry is a sum of at most 100 products of three factors of these sizes."""
    sizes = [np.abs(leaf.args[1]).max(initial=1.0) for leaf in leaves([whole.expr], "given").values()]
    sizes += [np.abs(v).max(initial=1.0) for v in values.values()]
    return 400 * EPS * float(np.prod(sizes))


CASE = forall(st.integers(0, 2**32 - 1), *SIZES, st.sampled_from([1.0, 1e3, 1e-4]))


@settings(max_examples=40, deadline=None)
@CASE
def test_affine_coefficients_reproduce_the_floating_evaluation(seed, n, p, m, scale):
    whole, values = inequality(np.random.default_rng(seed), n, p, m, scale)
    problem = Problem([whole])
    (form,) = problem.forms
    affine = form.constant + (form.slope @ vector(problem, values)).reshape(form.constant.shape)
    assert np.abs(affine - value_of(whole.positive, values)).max() <= rounding(whole, values)


@settings(max_examples=40, deadline=None)
@CASE
def test_unpacking_undoes_packing(seed, n, p, m, scale):
    whole, values = inequality(np.random.default_rng(seed), n, p, m, scale)
    problem = Problem([whole], fixed={"β": values["β"]})
    back = problem.unpack(vector(problem, values))
    assert set(back) == {"P", "Z", "β"}
    assert all(np.array_equal(back[k], values[k]) for k in back)


@settings(max_examples=40, deadline=None)
@CASE
def test_holding_an_unknown_equals_evaluating_there(seed, n, p, m, scale):
    whole, values = inequality(np.random.default_rng(seed), n, p, m, scale)
    problem = Problem([whole], fixed={"P": values["P"], "β": values["β"]})
    (form,) = problem.forms
    slope = 0.0 if form.slope is None else (form.slope @ vector(problem, values)).reshape(form.constant.shape)
    assert np.abs(form.constant + slope - value_of(whole.positive, values)).max() <= rounding(whole, values)


@settings(max_examples=40, deadline=None)
@CASE
def test_the_exact_value_is_exact_and_floating_point_is_near_it(seed, n, p, m, scale):
    whole, values = inequality(np.random.default_rng(seed), n, p, m, scale)
    made = statement(whole, values)
    algebra = DyadicAlgebra()
    letters = letters_from({k: exact(v, algebra) for k, v in made.data.items()}, made.lets, algebra)
    found = as_fractions(read_tree(made.tree, letters.__getitem__, algebra))
    assert found == fractions(whole.positive, values)
    near = value_of(whole.positive, values)
    worst = max(abs(Fraction(float(near[i, j])) - found[i][j]) for i in range(len(found)) for j in range(len(found)))
    assert worst <= rounding(whole, values)


@settings(max_examples=40, deadline=None)
@CASE
def test_a_tree_that_went_through_json_means_the_same_with_either_integer_library(seed, n, p, m, scale):
    whole, values = inequality(np.random.default_rng(seed), n, p, m, scale)
    made = statement(whole, values)
    stored = json.loads(json.dumps({"tree": made.tree, "lets": made.lets}))
    results = []
    for algebra, source, lets in (
        (DyadicAlgebra(), made.tree, made.lets),
        (DyadicAlgebra(), stored["tree"], stored["lets"]),
        (fast_algebra(), stored["tree"], stored["lets"]),
    ):
        letters = letters_from({k: exact(v, algebra) for k, v in made.data.items()}, lets, algebra)
        results.append(as_fractions(read_tree(source, letters.__getitem__, algebra)))
    assert results[0] == results[1] == results[2]


@settings(max_examples=40, deadline=None)
@CASE
def test_the_solvers_vectors_hold_the_matrix_up_to_a_congruence_by_powers_of_two(seed, n, p, m, scale):
    whole, values = inequality(np.random.default_rng(seed), n, p, m, scale)
    problem = Problem([whole])
    data = conic_data(problem)
    (size,) = data.sizes
    z = data.b - data.M @ vector(problem, values)
    i, j = np.array([(i, j) for j in range(size) for i in range(j + 1)]).T
    expected = value_of(whole.positive, values)
    expected = 0.5 * (expected + expected.T)
    # The congruence is read off the diagonal, as a power of two per row.
    diagonal = np.diag(expected)
    exponents = 0.5 * np.log2(np.abs(z[i == j] / np.where(diagonal == 0, 1.0, diagonal)) + 1e-300)
    # An entry of size s loses rounding(...); its logarithm moves by that over s.
    loss = rounding(whole, values)
    trusted = np.abs(diagonal) > 1e3 * loss
    assert np.all(np.abs(exponents - np.rint(exponents))[trusted] < 1e-2)
    d = np.exp2(np.rint(exponents))
    sure = trusted[i] & trusted[j]
    rebuilt = z / (d[i] * d[j] * np.where(i == j, 1.0, np.sqrt(2.0)))
    assert np.all(np.abs(rebuilt - expected[i, j])[sure] <= 4 * loss)


@settings(max_examples=20, deadline=None)
@forall(st.integers(0, 2**32 - 1), st.floats(1e-9, 1e-3))
def test_a_margin_moves_the_scaled_matrix_by_that_multiple_of_the_identity(seed, margin):
    whole, _ = inequality(np.random.default_rng(seed), 3, 2, 1, 1.0)
    problem = Problem([whole])
    plain, moved = conic_data(problem), conic_data(problem, margin)
    (size,) = plain.sizes
    on_diagonal = np.array([i == j for j in range(size) for i in range(j + 1)])
    # Scaled entries are at most a few units, so their difference rounds at a few eps.
    assert np.allclose(plain.b - moved.b, np.where(on_diagonal, margin, 0.0), rtol=0, atol=16 * EPS)


def test_a_tree_holds_letters_and_numbers_only():
    P = unknown("P", 2, 2, symmetric=True)
    stored = tree(let("Ω", P @ given("A", np.eye(2)) * 0.5))
    assert stored == "Ω"
    assert tree(0.5 * P) == ["scale", ["number", "0x1.0000000000000p-1"], "P"]


def test_the_statement_of_a_negative_claim_is_about_its_positive_side():
    P = unknown("P", 2, 2, symmetric=True)
    made = statement(Inequality(P, "<"), {"P": -np.eye(2)})
    assert made.tree == ["neg", "P"]
    assert made.prove().verdict == "proved"


@settings(max_examples=40, deadline=None)
@forall(st.integers(0, 2**32 - 1), *SIZES, st.sampled_from([0.0, 1e-4]), st.booleans(), st.booleans(), st.booleans())
def test_inequalities_read_together_give_the_arrays_of_each_read_alone(seed, n, p, m, margin, nearby, held, bare):
    rng = np.random.default_rng(seed)
    stated = [inequality(rng, n, p, m, 1.0)[0] for _ in range(MANY)]
    P, Z, β = (leaves([stated[0].expr], "unknown").get(name) for name in "PZβ")
    own = {"P": P, "Z": Z, "β": β}
    claims = [substitute([i.expr], {k: v for k, v in own.items() if v is not None})[0] for i in stated]
    # Positive and negative claims, whole matrices and sums of them, one that is no block, one block inside another.
    mixed = [Inequality(e, "<" if k % 2 else ">") for k, e in enumerate(claims)]
    mixed += [P - I(n) * 0.5 > 0, sym([[claims[0], 0], [__, -β * I(2)]]) < 0]
    if bare:
        mixed += [Inequality(claims[1] + 2 * claims[2], "<"), blocks([[P, 2 * P], [P, P]]) > 0]
    fixed = {"β": 0.75} if held else {}
    together = Problem(mixed, None, fixed)
    near = 1 + rng.random(together.size) if nearby else None
    data = conic_data(together, margin, near)
    M, at = data.M.toarray(), 0
    for k, claim in enumerate(mixed):
        alone = Problem(
            [claim], None, {name: v for name, v in fixed.items() if name in leaves([claim.expr], "unknown")}
        )
        columns = np.concatenate([together.offsets[x] + np.arange(freedom(leaf)) for x, leaf in alone.unknowns.items()])
        one = conic_data(alone, margin, None if near is None else near[columns])
        rows, at = slice(at, at + len(one.b)), at + len(one.b)
        assert data.sizes[k] == one.sizes[0]
        assert np.array_equal(data.b[rows], one.b)
        # Sums of products may be taken in another order: a few roundings of numbers of about one.
        assert np.allclose(M[rows][:, columns], one.M.toarray(), rtol=0, atol=64 * EPS * (1 + np.abs(one.M).max()))
        assert not np.delete(M[rows], columns, axis=1).any()
