# SPDX-License-Identifier: BSD-3-Clause
"""Cells that run a shell or write a file show what a reader types, not the magic word in their first line."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.application import Sphinx

SHELL, FILE = "%%bash", "%%writefile "
LANGUAGES = {"toml": "toml", "py": "python"}


def undressed(text: str) -> tuple[str, str] | None:
    """What to show of a cell and in which language; None for a cell of Python."""
    first, _, rest = text.partition("\n")
    if first.startswith(SHELL):
        return rest, "bash"
    if first.startswith(FILE):
        name = first.removeprefix(FILE).strip()
        return f"# {name}\n{rest}", LANGUAGES.get(name.rpartition(".")[2], "text")
    return None


def undress(app: Sphinx, document: nodes.document) -> None:
    """Take the magic lines off and colour the rest as what it is."""
    from docutils import nodes

    for block in document.findall(nodes.literal_block):
        found = undressed(block.astext())
        if found is not None:
            text, block["language"] = found
            block.children = [nodes.Text(text)]
            block.rawsource = text


def setup(app: Sphinx) -> None:
    """Run when a page has been read."""
    app.connect("doctree-read", undress)
