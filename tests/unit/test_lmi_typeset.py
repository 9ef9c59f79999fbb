# SPDX-License-Identifier: BSD-3-Clause
"""Inequalities in print: the letters of the paper, stars below the diagonal, equation numbers at the margin."""

import numpy as np
import pytest

from faultrecon.lmi.expr import I, __, given, let, sym, unknown
from faultrecon.lmi.typeset import definitions_latex, inequality_latex, latex, letter_latex, text_block

A, C = given("A", np.eye(2)), given("C₁", np.ones((1, 2)))
P, Z, β, γ2 = unknown("P", 2, 2, symmetric=True), unknown("Z", 2, 1), unknown("β"), unknown("γ²")


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("A", "A"),
        ("C₁", "C_{1}"),
        ("B_φ", r"B_{\varphi}"),
        ("γ²", r"\gamma^{2}"),
        ("T⁻¹", "T^{-1}"),
        ("F⁺", "F^{+}"),
        ("Ω", r"\Omega"),
        ("plant.E_w", r"E_{w}^{\mathrm{plant}}"),
        ("noise", r"\mathrm{noise}"),
        ("x̂", r"\hat{x}"),
    ],
)
def test_a_letter_keeps_its_marks(name, wanted):
    assert letter_latex(name) == wanted


def test_a_lyapunov_term_reads_as_in_the_paper():
    assert latex(A.T @ P + P @ A - C.T @ Z.T - Z @ C) == (r"A^{\top} P + P A - C_{1}^{\top} Z^{\top} - Z C_{1}")


def test_scalars_stand_before_what_they_scale():
    assert latex(-β * I(2)) == r"-\beta I"
    assert latex(β**2 * P) == r"\beta^{2} P"
    assert latex(-(P + A)) == "-(P + A)"
    assert latex(given("T⁻¹", np.eye(2)).T) == r"T^{-\top}"


def test_a_power_takes_all_of_its_base():
    U, γ, s = given("U", np.ones((1, 1))), unknown("γ"), given("plant.α", np.ones((1, 1)))
    assert latex((U * γ) ** 2) == r"(U \gamma)^{2}"
    assert latex(γ2**2) == r"(\gamma^{2})^{2}"
    assert latex(s**2) == r"(\alpha^{\mathrm{plant}})^{2}"
    assert latex((β + γ2) ** 2) == r"(\beta + \gamma^{2})^{2}"
    assert latex((-β) ** 2) == r"(-\beta)^{2}"
    assert latex(given("U⁻¹", np.ones((1, 1))) ** 2) == "U^{-2}"


def test_a_transpose_or_inverse_takes_all_of_its_base():
    assert latex((A @ P).T) == r"(A P)^{\top}"
    assert latex((A @ P).inv()) == "(A P)^{-1}"
    assert latex(given("plant.C", np.eye(2)).T @ P.inv()) == r"(C^{\mathrm{plant}})^{\top} P^{-1}"
    assert latex(sym([[β**2 * I(2), A], [__, P]]).T).endswith(r"\end{bmatrix}^{\top}")


def test_a_block_matrix_shows_stars_and_its_number():
    Ω = let("Ω", A.T @ P + P @ A)
    claim = (sym([[Ω, Z], [__, -γ2 * I(1)]]) < 0).tagged("(3.1)")
    assert inequality_latex(claim) == (
        r"\begin{bmatrix}\Omega & Z \\ \star & -\gamma^{2} I\end{bmatrix} \prec 0 \tag{3.1}"
    )
    assert definitions_latex([claim]) == [r"\Omega = A^{\top} P + P A"]
    lines = text_block(claim).splitlines()
    assert lines[0].startswith("[ Ω") and lines[0].endswith("]")
    assert lines[1].startswith("[ *") and lines[1].endswith("< 0   (3.1)")
    assert len({line.index("]") for line in lines}) == 1  # the columns are aligned


def test_a_plain_claim_is_one_line():
    assert text_block((P > 0).tagged("P > 0")) == "P > 0"
    assert inequality_latex(P > 0) == r"P \succ 0"


def test_a_scalar_is_compared_not_definite():
    assert inequality_latex(β > 0) == r"\beta > 0"
    assert inequality_latex((β - γ2 < 0).tagged("(2)")) == r"\beta - \gamma^{2} < 0 \tag{2}"
