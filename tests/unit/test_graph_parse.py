# SPDX-License-Identifier: BSD-3-Clause
"""Formulas as text: what is understood, what is refused, and how the refusal reads."""

import math
import sys

import casadi as ca
import pytest

from faultrecon.finding import InputError
from faultrecon.graph.parse import DEEPEST, LONGEST, parse

NAMES = {"theta": ca.SX.sym("theta"), "omega": ca.SX.sym("omega")}
WHERE = "plant.toml:12  nonlinearity.phi[0]"


def value(text, theta=0.7, omega=-1.3, **constants):
    expression = parse(text, NAMES, constants=constants)
    return float(ca.Function("f", list(NAMES.values()), [expression])(theta, omega))


def refusal(text, names=NAMES):
    with pytest.raises(InputError) as caught:
        parse(text, names, where=WHERE)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-gravity * sin(theta)", -3.33 * math.sin(0.7)),
        ("-theta**2", -(0.7**2)),
        ("2*theta - omega/4 + (1 - 3)", 2 * 0.7 + 1.3 / 4 - 2),
        ("theta**-0.5", 0.7**-0.5),
        ("theta**gravity", 0.7**3.33),
        ("pow(theta, omega)", 0.7**-1.3),
        ("max(theta, omega, 0.9) + min(theta, omega)", 0.9 - 1.3),
        ("sat(10*theta) + sat(omega) + sat(theta)", 1 - 1 + 0.7),
        ("atan2(theta, omega) + sign(omega) + abs(omega)", math.atan2(0.7, -1.3) - 1 + 1.3),
        ("exp(log(theta)) + sqrt(theta) + tanh(omega)", 0.7 + math.sqrt(0.7) + math.tanh(-1.3)),
        ("asin(theta)+acos(theta)+atan(theta)+sinh(theta)+cosh(theta)+tan(theta)+cos(theta)", None),
        ("  (theta\n + 1)  ", 1.7),
        ("1_000 + 0x10 + 1e-3", 1016.001),
    ],
)
def test_a_formula_means_what_it_says(text, expected):
    if expected is None:
        expected = sum(getattr(math, f)(0.7) for f in ("asin", "acos", "atan", "sinh", "cosh", "tan", "cos"))
    # Both sides are a handful of correctly rounded operations or libm calls.
    assert value(text, gravity=3.33) == pytest.approx(expected, rel=1e-14)


def test_a_message_has_place_text_column_and_a_suggestion():
    message = refusal("1 + sin(thata)")
    assert message.startswith(WHERE + ": unknown name 'thata'")
    assert "'1 + sin(thata)', column 9" in message
    assert "did you mean 'theta'?" in message
    assert "did you mean 'sinh'?" in refusal("sinhh(theta)")


def test_columns_count_characters_not_bytes():
    assert "column 11" in refusal("  größe + ü", {"größe": NAMES["theta"]})
    assert "column 3" in refusal("  ü")


@pytest.mark.parametrize(
    "text",
    [
        "theta.real", "theta[0]", "(lambda: 1)()", "[1]", "{1: 2}", "(theta, omega)", "'text'", "b'x'", "f'{theta}'",
        "theta if omega else 1", "theta < 1", "theta and omega", "not theta", "~theta", "theta // 2", "theta % 2",
        "theta @ omega", "theta | 1", "theta := 1", "sin(x=theta)", "sin(*theta)", "sin", "sin()", "sin(1, 2)",
        "max(theta)", "atan2(theta)", "sin(theta)(1)", "__import__('os').system('true')", "open('x')", "eval('1')",
        "True", "None", "...", "1j", "1e999", "9" * 400, "9" * 5000, "9**9**9", "theta**omega", "theta**True",
        "theta**(1/2)", "theta/0", "1/0", "log(0)", "sqrt(-1)", "(-8)**0.5", "0*log(0)", "", "   ", "theta +",
        "theta; omega", "theta = 1", "import os", "theta # comment", "the\\\nta", "\x00", "\ud800", "(" * 200,
        "(" * 5000 + ")" * 5000, "-" * 9000 + "1", "- " * 4000 + "1", "sin(" * 150 + "1" + ")" * 150, "1+" * 4900 + "1",
        "theta**" * 1000 + "2", "nan", "inf",
    ],
)  # fmt: skip
def test_everything_off_the_whitelist_is_refused(text):
    assert refusal(text).startswith(WHERE + ": ")


def test_a_formula_may_be_long_but_not_endless():
    terms = "+".join(["theta"] * 400)
    assert value(terms) == pytest.approx(280.0, rel=1e-13)
    assert f"{LONGEST} at most" in refusal(terms + " " * LONGEST)
    nested = "sin(" * (DEEPEST - 1) + "theta" + ")" * (DEEPEST - 1)
    assert math.isfinite(value(nested))


def test_nesting_is_refused_the_same_way_from_deep_in_a_program():
    def below(depth):
        return below(depth - 1) if depth else refusal("(" * 300 + "1" + ")" * 300)

    assert "nested" in below(sys.getrecursionlimit() // 2)


def test_numbers_and_values_of_other_kinds_are_asked_to_be_text():
    with pytest.raises(InputError, match="a formula is text, not float"):
        parse(3.0, NAMES)  # pyright: ignore[reportArgumentType] - what a plant file may hold


def test_greek_look_alikes_are_one_name():
    assert parse("ϕ", {"φ": NAMES["theta"]}).is_symbolic()
