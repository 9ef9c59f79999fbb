# SPDX-License-Identifier: BSD-3-Clause
"""Typeset expressions as a reader would write them by hand."""

from __future__ import annotations

import re

from faultrecon.lmi.typeset import letter_latex
from faultrecon.methods.base import Theorem


def printed_latex(text: str) -> str:
    """The typeset expression as a reader writes it: stars as asterisks, plant letters with a p, powers as powers."""
    text = text.replace(r"\star", r"\ast").replace(r"^{\mathrm{plant}}", "^{p}")
    for pattern, written in REWRITTEN:
        text = re.sub(pattern, written, text)
    return text


REWRITTEN = (
    (r"(\\[a-z]+)\^\{p\} \1\^\{p\}", r"(\1^{p})^{2}"),  # α α
    (r"V\^\{-1\}", "(V^{p})^{-1}"),
    (r"(U )?\\gamma \1\\gamma", lambda found: r"(U \gamma)^{2}" if found[1] else r"\gamma^{2}"),
    (r"\bU U\b", r"U^{2}"),
    (r"U\^\{-1\} U\^\{-1\}", r"U^{-2}"),
    (r"(\\[a-z]+\^\{p\}) (\d) ", r"\2 \1 "),  # a number comes first
    (r"\(-([^()&]*?)\) (?=I|\()", r"-\1 "),  # (-β) I
    (r"(?<=& )\(-([^()&]*?)\) (?=[A-Z\\])", r"-\1 "),  # (-P) F, in front
    (r"\\gamma 1\b", r"\\gamma"),
    (r"\\mathrm\{([A-Z])(\d+)\}", r"\1_{\2}"),
    (r"\\mathrm\{([A-Z])(\d+)(?: |\\ )?([A-Z])(\d+)\}", r"(\1_{\2} \3_{\4})"),  # one letter: P11 L2
    (r"\\mathrm\{Δ([A-Z])\}(?=\^)", r"(\\Delta \1)"),
    (r"\\mathrm\{Δ([A-Z])\}", r"{\\Delta \1}"),
    (r"_\{([a-z]{2,})\}", r"_{\\mathrm{\1}}"),
    (r" (\\mathrm\{[a-z]+\})", r" \\, \1"),
)


def shipped_latex(text: str, theorem: Theorem) -> str:
    """The same with a raised s on what ships: the gains that run, in the plant's units, and the level γ.

    Without the mark K₁, an unknown of the inequality, and the gain made from it would look alike.
    """
    for name in ("γ", *(gain.name for gain in theorem.gains)):
        letter = re.escape(letter_latex(name))
        text = re.sub(rf"(?<![A-Za-z\\]){letter}(?![A-Za-z^_])", lambda found: found[0] + "^{s}", text)
    return printed_latex(text)
