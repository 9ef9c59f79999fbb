# SPDX-License-Identifier: BSD-3-Clause
"""Docstrings are plain text with code in single backticks; Sphinx reads reStructuredText, where |x| and * mean more."""

from __future__ import annotations

import re
from itertools import groupby
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

CODE = re.compile(r"`([^`]+)`")
SPECIAL = re.compile(r"([\\*|_`])")


def marked(line: str) -> str:
    """One line of prose with its code kept as code and everything else taken literally."""
    parts = CODE.split(line)
    return "".join(f"``{part}``" if k % 2 else SPECIAL.sub(r"\\\1", part) for k, part in enumerate(parts))


def restructured(lines: list[str]) -> list[str]:
    """The lines of a docstring as reStructuredText; a paragraph with indented lines is shown as it stands."""
    out: list[str] = []
    for blank, group in groupby(lines, lambda line: not line.strip()):
        paragraph = list(group)
        if blank:
            out += paragraph
        elif paragraph[0].startswith("- ") or not any(line.startswith("  ") for line in paragraph):
            out += [marked(line) for line in paragraph]
        else:
            out += ["::", "", *(f"    {line}" for line in paragraph), ""]
    return out


def process(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """The event of autodoc: `lines` is changed in place."""
    lines[:] = restructured(lines)


def setup(app: Sphinx) -> None:
    """Run for every docstring."""
    app.connect("autodoc-process-docstring", process)
