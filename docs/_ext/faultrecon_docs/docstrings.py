# SPDX-License-Identifier: BSD-3-Clause
"""Docstrings are plain text with code in single backticks; Sphinx reads reStructuredText, where |x| and * mean more."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

CODE = re.compile(r"`([^`]+)`")
SPECIAL = re.compile(r"([\\*|_`])")


def marked(line: str) -> str:
    """One line of prose with its code kept as code and everything else taken literally."""
    parts = CODE.split(line)
    return "".join(f"``{part}``" if k % 2 else SPECIAL.sub(r"\\\1", part) for k, part in enumerate(parts))


def restructured(lines: list[str]) -> list[str]:
    """The lines of a docstring as reStructuredText; what is indented is shown as it stands."""
    out: list[str] = []
    shown = False
    for k, line in enumerate(lines):
        indented = line.startswith("    ") and (shown or not lines[k - 1].strip())
        if indented and not shown:
            out += ["::", ""]
        shown = indented or (shown and not line.strip())
        out.append(line if indented else marked(line))
    return out


def process(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """The event of autodoc: `lines` is changed in place."""
    lines[:] = restructured(lines)


def setup(app: Sphinx) -> None:
    """Run for every docstring."""
    app.connect("autodoc-process-docstring", process)
