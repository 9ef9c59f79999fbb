# SPDX-License-Identifier: BSD-3-Clause
"""Whatever the text, reading a formula ends in an expression or in an InputError."""

import casadi as ca
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.finding import InputError
from faultrecon.graph.parse import FUNCTIONS, parse

NAMES = {"x1": ca.SX.sym("x1"), "θ": ca.SX.sym("θ")}
PIECES = [
    *FUNCTIONS, *NAMES, "c", "foo", "lambda", "if", "else", "not", "for", "in", "and", "**", "*", "+", "-", "/", "//",
    "%", "@", "<", "==", "=", ":=", "(", ")", "[", "]", "{", "}", ",", ".", ":", ";", "'", '"', "f'", "\\", "#", "\n",
    "\t", " ", "0", "1", "2.5", "1e308", "1e-320", "9" * 30, "1j", "0x", "0b1", "_", "__class__", "True", "None", "...",
    "\x00", "é", "\ud800", "１", "\u2028", "\ufeff",
]  # fmt: skip


def read(text):
    try:
        expression = parse(text, NAMES, constants={"c": 1.5}, where="here")
    except InputError as refusal:
        assert str(refusal).startswith("here: ")
    else:
        assert expression.shape == (1, 1)


@settings(max_examples=400, deadline=None)
@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(text):
    read(text)


@settings(max_examples=1000, deadline=None)
@given(st.lists(st.sampled_from(PIECES), max_size=25), st.sampled_from(["", " "]))
def test_any_heap_of_tokens_is_read_or_refused(pieces, between):
    read(between.join(pieces))


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(PIECES), st.sampled_from(PIECES), st.integers(1, 6000), st.sampled_from(["", "1", "x1", ")"]))
def test_any_repetition_is_read_or_refused(first, second, times, end):
    read((first + second) * times + end)
