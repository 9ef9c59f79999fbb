# SPDX-License-Identifier: BSD-3-Clause
"""Cells that begin with %%bash show what a reader types, not the magic word that runs it."""

from __future__ import annotations

from docutils import nodes
from sphinx.application import Sphinx

MAGIC = "%%bash"


def undress(app: Sphinx, document: nodes.document) -> None:
    """Take the magic line off and colour the rest as shell."""
    for block in document.findall(nodes.literal_block):
        first, _, rest = block.astext().partition("\n")
        if first.startswith(MAGIC) and rest:
            block.children = [nodes.Text(rest)]
            block.rawsource = rest
            block["language"] = "bash"


def setup(app: Sphinx) -> None:
    """Run when a page has been read."""
    app.connect("doctree-read", undress)
