# SPDX-License-Identifier: BSD-3-Clause
"""What Sphinx needs to document this package: generated pages, formulas as pictures, cells that run shell lines.

What writes pages needs the package alone, so that it can be tested without Sphinx.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, Any]:
    """Register everything; the generated pages are written before Sphinx looks for pages.

    The bibliography comes earlier still: its extension reads it while the environment is made, before the builder.
    """
    from faultrecon_docs import cells, docstrings, formulas

    formulas.setup(app)
    cells.setup(app)
    docstrings.setup(app)
    app.connect("config-inited", _bibliography)
    app.connect("builder-inited", _generate)
    return {"parallel_read_safe": True, "parallel_write_safe": True, "version": "1"}


def _bibliography(app: Sphinx, config: object) -> None:
    from faultrecon_docs.pages import write_bibliography

    write_bibliography(Path(app.srcdir))


def _generate(app: Sphinx) -> None:
    from sphinx.util import logging

    from faultrecon_docs.pages import write_pages

    write_pages(Path(app.srcdir), logging.getLogger(__name__).warning)
