# SPDX-License-Identifier: BSD-3-Clause
"""Inequalities in print: LaTeX and aligned text, from the same expressions that are solved and proved."""

from __future__ import annotations

import re
from collections.abc import Sequence

from faultrecon.lmi.expr import Expr, Inequality, show
from faultrecon.lmi.walk import leaves

GREEK = {
    "α": r"\alpha", "β": r"\beta", "γ": r"\gamma", "δ": r"\delta", "ε": r"\varepsilon", "θ": r"\theta",
    "κ": r"\kappa", "λ": r"\lambda", "μ": r"\mu", "ν": r"\nu", "ρ": r"\rho", "σ": r"\sigma", "τ": r"\tau",
    "φ": r"\varphi", "Γ": r"\Gamma", "Θ": r"\Theta", "Λ": r"\Lambda", "Φ": r"\Phi", "Ω": r"\Omega", "Ψ": r"\Psi",
}  # fmt: skip
RAISED = {"²": "2", "⁻¹": "-1", "⁺": "+", "ᵀ": r"\top"}
LOWERED = dict(zip("₀₁₂₃₄₅₆₇₈₉", "0123456789", strict=True))
HATS = {"x̂": r"\hat{x}", "f̂": r"\hat{f}"}


def letter_latex(name: str) -> str:
    """One letter of a paper: 'C₁' is C_{1}, 'B_φ' is B_{\\varphi}, 'γ²' is \\gamma^{2}, 'plant.A' is A^{plant}."""
    if name.startswith("plant."):
        return f"{letter_latex(name.removeprefix('plant.'))}^{{\\mathrm{{plant}}}}"
    for mark, raised in RAISED.items():
        if name.endswith(mark) and len(name) > len(mark):
            return f"{letter_latex(name.removesuffix(mark))}^{{{raised}}}"
    head, _, below = name.partition("_")
    found = re.fullmatch(r"(.+?)([₀-₉]+)", head)
    if found:
        digits = "".join(LOWERED[c] for c in found[2])
        head, below = found[1], digits + (f",{below}" if below else "")
    base = HATS.get(head) or GREEK.get(head) or (head if len(head) == 1 else rf"\mathrm{{{head}}}")
    return base + (f"_{{{GREEK.get(below, below)}}}" if below else "")


def latex(node: Expr, tight: bool = False) -> str:
    """The expression in LaTeX; named parts by their letter, lower blocks of a symmetric matrix as stars."""
    match node.op:
        case "given" | "unknown" | "let":
            return letter_latex(node.args[0])
        case "number":
            return f"{node.args[0]:g}"
        case "eye":
            return "I"
        case "zero":
            return "0"
        case "T" | "inv":
            return _raised(node.args[0], r"\top" if node.op == "T" else "-1")
        case "matmul":
            text = f"{latex(node.args[0], True)} {latex(node.args[1], True)}"
            return f"({text})" if tight and "block" in (node.args[0].op, node.args[1].op) else text
        case "scale":
            left, right = (latex(a, True) for a in node.args)
            if left == right:  # a scalar times itself
                return _raised(node.args[0], "2")
            if node.args[0].op == "neg":  # -β I, not (-β) I
                text = f"-{latex(node.args[0].args[0], True)} {right}"
                return f"({text})" if tight else text
            return f"{left} {right}"
        case "neg":
            text = f"-{latex(node.args[0], True)}"
        case "add":
            left, right = node.args
            minus = right.op == "neg"
            text = f"{latex(left)} {'-' if minus else '+'} {latex(right.args[0] if minus else right, minus)}"
        case "block":
            rows = node.args[0]
            lines = [
                " & ".join(r"\star" if _mirrored(rows, i, j) else latex(b) for j, b in enumerate(row))
                for i, row in enumerate(rows)
            ]
            return r"\begin{bmatrix}" + r" \\ ".join(lines) + r"\end{bmatrix}"
    return f"({text})" if tight else text


def _mirrored(rows: Sequence[Sequence[Expr]], i: int, j: int) -> bool:
    """Whether a block below the diagonal is the transpose of its mirror image, by construction."""
    if j >= i or i >= len(rows[j]):
        return False
    below, above = rows[i][j], rows[j][i]
    return (below.op == "T" and below.args[0] is above) or (above.op == "T" and above.args[0] is below)


def _raised(node: Expr, power: str) -> str:
    """A power: letters carry it as they are; products, sums, and letters that have a power already, in brackets."""
    if node.op in ("matmul", "scale", "add", "neg"):
        return f"({latex(node)})^{{{power}}}"
    text = latex(node, True)
    merged = {r"\top": r"-\top", "2": "-2"}.get(power)
    if text.endswith("^{-1}") and merged:
        return text.removesuffix("^{-1}") + f"^{{{merged}}}"
    plain = node.op == "block" or not ("^" in text or text.startswith("-"))
    return f"{text}^{{{power}}}" if plain else f"({text})^{{{power}}}"


def inequality_latex(inequality: Inequality) -> str:
    """The inequality in LaTeX with its number as a tag, '(3.1)' as \\tag{3.1}; other labels are left out.

    A scalar is greater or smaller than zero; a matrix is definite.
    """
    scalar = inequality.expr.shape == (1, 1)
    sign = {"<": "<" if scalar else r"\prec", ">": ">" if scalar else r"\succ"}[inequality.sense] + " 0"
    number = re.fullmatch(r"\((.+)\)", inequality.label)
    return f"{latex(inequality.expr)} {sign}" + (rf" \tag{{{number[1]}}}" if number else "")


def definitions(inequalities: Sequence[Inequality]) -> list[tuple[Expr, Expr]]:
    """The named parts of some inequalities and what they stand for, in the order in which they are needed."""
    found = leaves([i.expr for i in inequalities], "let")
    return [(node, node.args[1]) for node in found.values()]


def definitions_latex(inequalities: Sequence[Inequality]) -> list[str]:
    """Each named part as an equation in LaTeX."""
    return [f"{latex(node)} = {latex(meaning)}" for node, meaning in definitions(inequalities)]


def text_block(inequality: Inequality) -> str:
    """The inequality as aligned lines of text, `*` below the diagonal."""
    sign = f" {inequality.sense} 0"
    label = f"   {inequality.label}" if inequality.label.startswith("(") else ""
    if inequality.expr.op != "block":
        return show(inequality.expr) + sign + label
    rows = inequality.expr.args[0]
    cells = [[show(b) if j >= i else "*" for j, b in enumerate(row)] for i, row in enumerate(rows)]
    widths = [max(len(row[j]) for row in cells) for j in range(len(cells))]
    lines = ["[ " + "   ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) + " ]" for row in cells]
    lines[len(lines) // 2] += sign + label
    return "\n".join(lines)
