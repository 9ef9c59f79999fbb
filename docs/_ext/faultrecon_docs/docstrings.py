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


READABLE = (
    (r"~?(?:\w+\.)*ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[[^\[\]]*\]\]", "Array"),
    (r"TypeAliasForwardRef\('(\w+)'\)", r"\1"),
    (r"~(?:\w+\.)+", ""),  # the short name of a type
    (r"<factory>", "..."),  # a default that is made anew, such as an empty mapping
)


def readable(signature: str) -> str:
    """A signature as one would write it; Sphinx can then set it argument by argument, with links."""
    for pattern, written in READABLE:
        signature = re.sub(pattern, written, signature)
    return signature


def process_signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """The event of autodoc."""
    return signature and readable(signature), returns and readable(returns)


def setup(app: Sphinx) -> None:
    """Run for every docstring and signature."""
    app.connect("autodoc-process-docstring", process)
    app.connect("autodoc-process-signature", process_signature)
