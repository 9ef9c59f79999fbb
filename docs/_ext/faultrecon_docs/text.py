# SPDX-License-Identifier: BSD-3-Clause
"""Markdown from plain text: escaped prose, code, tables."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

CODE = re.compile(r"`([^`]+)`")
SPECIAL = re.compile(r"([\\*_|<>\[\]$#])")


def prose(text: str) -> str:
    """Plain text of any docstring or message, with its single backticks kept as code."""
    parts = CODE.split(" ".join(text.split()))
    return "".join(code(part) if k % 2 else SPECIAL.sub(r"\\\1", part) for k, part in enumerate(parts))


def code(text: str) -> str:
    """Text as code, also inside a table; nothing stays nothing."""
    return f"`{text.replace('|', chr(0x2223))}`" if text.strip() else ""


def paragraphs(text: str) -> list[str]:
    """The paragraphs of a docstring, inner indentation kept."""
    return [part for part in re.split(r"\n\s*\n", text.strip("\n")) if part.strip()]


def table(head: Sequence[str], rows: Sequence[Sequence[str]], *, kind: str = "") -> str:
    """A Markdown table of cells that are Markdown already; kind: a class for its looks."""
    lines = ["| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)]
    text = "\n".join(lines)
    return f"{{.{kind}}}\n{text}" if kind else text


def number(value: float | None) -> str:
    """A number in seven digits, and a word where there is none."""
    return "no solution" if value is None else f"{value:.7g}"


def code_block(text: str, language: str = "text") -> str:
    """Lines shown as they stand."""
    return f"```{language}\n{text}\n```"


def formula(latex: str) -> str:
    """A formula on a line of its own."""
    return f"```{{math}}\n{latex}\n```"


def page(*parts: str) -> str:
    """Parts with blank lines in between."""
    return "\n\n".join(part.strip("\n") for part in parts if part.strip()) + "\n"


def formulas(several: Iterable[str]) -> str:
    """Short formulas beside each other where there is room."""
    shown = [formula(latex) for latex in several]
    return "::::{container} formulas\n" + "\n\n".join(shown) + "\n::::" if shown else ""


def folded(title: str, text: str) -> str:
    """Text that shows when its title is clicked."""
    return f'<details class="folded"><summary>{title}</summary>\n\n{text}\n\n</details>'


def sentence(text: str) -> str:
    """Plain text as a sentence: a capital in front, unless it begins with a name that has none, and a full stop."""
    word = text.split(maxsplit=1)[0] if text else ""
    first = text[:1] if "-" in word or not text[:1].isascii() else text[:1].upper()
    return prose(first + text[1:]) + ("" if text.endswith((".", "?")) else ".")
