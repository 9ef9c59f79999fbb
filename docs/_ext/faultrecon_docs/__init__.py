# SPDX-License-Identifier: BSD-3-Clause
"""What Sphinx needs to document this package: pages that are generated, formulas as pictures, cells that run shell lines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from faultrecon_docs import cells, docstrings, formulas
from faultrecon_docs.pages import write_pages


def setup(app: Sphinx) -> dict[str, Any]:
    """Register everything; the generated pages are written before Sphinx looks for pages."""
    formulas.setup(app)
    cells.setup(app)
    docstrings.setup(app)
    app.connect("builder-inited", _generate)
    return {"parallel_read_safe": True, "parallel_write_safe": True, "version": "1"}


def _generate(app: Sphinx) -> None:
    write_pages(Path(app.srcdir))
