# SPDX-License-Identifier: BSD-3-Clause
"""Matrix expressions: mistakes surface on the line that makes them, in the words of the paper's block matrix."""

import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.lmi.expr import I, Inequality, ShapeError, __, as_expr, given, let, sym, unknown, zeros
from faultrecon.lmi.problem import NotAffineError, Problem
from faultrecon.lmi.walk import leaves, substitute, value_of

A = given("A", [[0.0, 1.0], [-2.0, -3.0]])
B = given("B", [[0.0], [1.0]])
P = unknown("P", 2, 2, symmetric=True)
Z = unknown("Z", 2, 1)
β = unknown("β")


def test_a_block_of_the_wrong_shape_is_named_with_the_shape_the_diagonal_asks_for():
    with pytest.raises(ShapeError) as caught:
        sym([[A.T @ P + P @ A, P], [__, -β * I(1)]])
    assert str(caught.value) == "block (1,2) is (2, 2), the diagonal asks for (2, 1)"


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([[P, B], [__]], "block row 2 has 1 blocks: the matrix has 2 block rows"),
        ([[0, B], [__, I(1)]], "block (1,1) is 0: diagonal blocks give the sizes"),
        ([[B, 0], [__, I(1)]], "block (1,1) is (2, 1): diagonal blocks are square"),
        ([[P, B], [B.T, I(1)]], "block (2,1) is written: symmetry fixes it: write __"),
        ([[P, __], [__, I(1)]], "block (1,2) is __: the upper triangle has to be written"),
        ([[P, 1.0], [__, I(1)]], "block (1,2) is 1.0: a block is an expression or 0"),
    ],
)
def test_every_mistake_in_a_block_matrix_names_its_block(rows, message):
    with pytest.raises(ShapeError) as caught:
        sym(rows)
    assert str(caught.value) == message


def test_a_bare_array_is_no_block():
    with pytest.raises(ShapeError, match=r"(?s)block \(1,2\) is .*: a block is an expression or 0"):
        sym([[P, np.zeros((2, 1))], [__, I(1)]])


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: A + B, "cannot add A (2, 2) and B (2, 1): the shapes differ"),
        (lambda: A @ B.T, "cannot multiply A (2, 2) by Bᵀ (1, 2): 2 columns meet 1 rows"),
        (lambda: A * P, "'*' scales by a number; A is (2, 2); use '@' for matrix products"),
        (lambda: A**2, "only the square of a scalar is meant here, not A**2"),
        (lambda: β**3, "only the square of a scalar is meant here, not β**3"),
        (lambda: B.inv(), "cannot invert a (2, 1) matrix: it is not square"),
        (lambda: A + 1.0, "cannot add A (2, 2) and 1 (1, 1): the shapes differ"),
        (lambda: B > 0, "B (2, 1) cannot be definite: it is not square"),
        (lambda: P > 1, "an inequality compares with 0; move the bound to the left side"),
        (lambda: unknown("S", 2, 3, symmetric=True), "S (2, 3) cannot be symmetric: it is not square"),
        (lambda: np.eye(2) * P, "ndarray stands in a formula; name it: given('M', array)"),
    ],
)
def test_an_operation_that_does_not_fit_says_which_letters_and_why(build, message):
    with pytest.raises(ShapeError) as caught:
        build()
    assert str(caught.value) == message


def test_a_given_matrix_has_finite_entries_and_the_bad_one_is_named():
    with pytest.raises(InputError, match=r"A\[1, 0\] is nan: every entry must be a finite number"):
        given("A", [[0.0, 1.0], [np.nan, 2.0]])


def test_a_given_matrix_does_not_change_with_the_array_it_came_from():
    array = np.eye(2)
    letter = given("M", array)
    array[0, 0] = 7.0
    assert np.array_equal(value_of(letter, {}), np.eye(2))
    with pytest.raises(ValueError, match="read-only"):
        value_of(letter, {})[0, 0] = 3.0


@pytest.mark.parametrize("n", [0, 1, 3])
@pytest.mark.parametrize("m", [0, 2])
def test_blocks_of_size_zero_are_ordinary_blocks(n, m):
    M = given("M", np.ones((n, m)).reshape(n, m)) if n and m else zeros(n, m)
    whole = sym([[I(n), M], [__, I(m)]])
    assert whole.shape == (n + m, n + m)
    value = value_of(whole, {})
    assert np.array_equal(value, value.T)
    assert np.array_equal(np.diag(value), np.ones(n + m))
    product = zeros(n, m) @ zeros(m, 4)
    assert np.array_equal(value_of(product, {}), np.zeros((n, 4)))


def test_a_block_of_no_channels_drops_out_of_the_affine_data():
    G = zeros(2, 0)
    without = Problem([A.T @ P + P @ A < 0])
    with_none = Problem([sym([[A.T @ P + P @ A, P @ G], [__, -β * I(0)]]) < 0])
    assert np.array_equal(without.forms[0].constant, with_none.forms[0].constant)
    slope = with_none.forms[0].slope[:, [with_none.offsets["P"] + k for k in range(3)]]
    assert np.array_equal(without.forms[0].slope, slope)


def test_zero_takes_the_shape_of_its_neighbour():
    assert (P + 0).shape == (2, 2)
    assert (0 - P).shape == (2, 2)
    assert as_expr(0, like=B).shape == (2, 1)


def test_two_transposes_and_two_signs_cancel():
    assert B.T.T is B
    negative = -B
    assert -negative is B


def test_an_expression_prints_in_the_papers_letters():
    Ω = let("Ω", A.T @ P + P @ A - Z @ B.T)
    assert str(Ω) == "Ω"
    assert str(Ω.args[1]) == "Aᵀ P + P A - (Z Bᵀ)"
    assert str((A.T @ P + P @ A < 0).tagged("(3.1)")) == "(3.1) Aᵀ P + P A < 0"
    assert repr(B) == "<B 2x1>"


def test_an_inequality_is_no_truth_value():
    with pytest.raises(TypeError, match="a statement, not a truth value"):
        bool(P > 0)


def test_the_positive_side_of_a_negative_definite_claim_is_its_negative():
    assert (P > 0).positive is P
    assert Inequality(-P, "<").positive is P


def test_one_letter_for_two_matrices_is_refused():
    with pytest.raises(ShapeError, match="the letter A stands for two things"):
        leaves([A @ P, given("A", np.eye(2)) @ P], "given")
    with pytest.raises(ShapeError, match="the letter P stands for two things"):
        leaves([P, unknown("P", 2, 2, symmetric=True)], "unknown")


def test_the_same_given_matrix_may_be_written_twice():
    again = given("A", [[0.0, 1.0], [-2.0, -3.0]])
    assert list(leaves([A @ P, again @ P], "given")) == ["A"]


def test_named_parts_are_listed_innermost_first():
    H = let("H", A @ P)
    K = let("K", H + H.T)
    assert list(leaves([K], "let")) == ["H", "K"]


def test_substitution_gives_what_the_formula_gives_and_keeps_named_parts():
    L = unknown("L", 2, 1)
    Ω = let("Ω", P @ A - Z @ B.T)
    (new,) = substitute([Ω + Ω.T], {"Z": P @ L})
    assert list(leaves([new], "let")) == ["Ω"]
    assert set(leaves([new], "unknown")) == {"P", "L"}
    p, gain = np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([[1.0], [-2.0]])
    expected = value_of(Ω + Ω.T, {"P": p, "Z": p @ gain})
    # Small integers: both sides are exact.
    assert np.array_equal(value_of(new, {"P": p, "L": gain}), expected)


def test_a_substitute_of_another_shape_is_refused():
    with pytest.raises(ShapeError, match=r"Z is \(2, 1\), its substitute P is \(2, 2\)"):
        substitute([Z @ B.T], {"Z": P})


@pytest.mark.parametrize(
    ("expr", "message"),
    [
        (lambda: Z @ Z.T, "a product of two unknowns"),
        (lambda: β * P, "a product of two unknowns"),
        (lambda: β**2, "a product of two unknowns"),
        (lambda: P.inv(), "an inverse of an unknown"),
    ],
)
def test_what_is_not_affine_is_refused_before_any_solver(expr, message):
    with pytest.raises(NotAffineError, match=message):
        _ = Problem([expr() > 0]).forms


def test_a_product_becomes_affine_when_one_factor_is_held():
    problem = Problem([β * P > 0], fixed={"β": 2.0})
    assert np.array_equal(problem.forms[0].slope @ [1.0, 3.0, 5.0], [2.0, 6.0, 6.0, 10.0])


def test_holding_a_letter_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="Q is held fixed: the unknowns are P"):
        _ = Problem([P > 0], fixed={"Q": 1.0}).unknowns


def test_holding_a_letter_at_a_value_of_another_shape_is_refused():
    with pytest.raises(ShapeError, match=r"P is held at a \(3, 3\) value: it is \(2, 2\)"):
        _ = Problem([P > 0], fixed={"P": np.eye(3)}).forms


def test_an_unknown_without_a_value_is_named():
    with pytest.raises(InputError, match="no value is given for the unknown P"):
        value_of(P @ A, {})
