# SPDX-License-Identifier: BSD-3-Clause
"""Formulas as SVG, drawn while the pages are built.

MathJax and KaTeX come from a network or as megabytes of script beside the pages, and LaTeX is a large installation.
ziamath is a small Python package with a mathematical font inside: what it draws looks the same in every browser,
offline, without script, and a formula that cannot be drawn fails the build instead of the reader.
"""

from __future__ import annotations

import re
from functools import cache
from html import escape
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.math import get_node_equation_number
from ziafont.config import config as glyphs
from ziamath.zmath import Latex

SIZE = 17.0  # px; a shade larger than the text, as letters of a formula carry more
TAG = re.compile(r"\\tag\{([^}]*)\}")

glyphs.svg2 = False  # glyphs as paths, not as symbols with an id: many formulas share one page


@cache
def picture(latex: str, inline: bool) -> tuple[str, float]:
    """A formula as an SVG element in the colour of the text around it, and how far it hangs below the line, px."""
    try:
        drawn = Latex(respaced(latex), size=SIZE, color="currentColor", inline=inline, title=latex)
    except Exception as error:  # whatever ziamath stumbles over, the page has to be mended
        raise ExtensionError(f"the formula {latex!r} cannot be drawn: {error}") from error
    svg = drawn.svg().replace("<svg ", f'<svg role="img" aria-label="{escape(latex, quote=True)}" ', 1)
    return svg, float(drawn.getyofst())


def respaced(latex: str) -> str:
    """A sign that is no operation, as in 'a = -b', without the space of one."""
    return re.sub(r"(=|&|\[|\(|\\\\|\{bmatrix\}|^)\s*-(?=\s*[A-Za-z\\(])", r"\1 {-}", latex)


def inline(translator: Any, node: nodes.math) -> None:
    """A formula in a line of text."""
    svg, below = picture(node.astext(), True)
    translator.body.append(f'<span class="formula" style="vertical-align: {below:.2f}px">{svg}</span>')
    raise nodes.SkipNode


def display(translator: Any, node: nodes.math_block) -> None:
    """A formula on its own, with the number that its paper gives it (\\tag) or that this page does."""
    latex = node.astext().strip()
    tag = TAG.search(latex)
    number = tag[1] if tag else get_node_equation_number(translator, node) if node["number"] else ""
    svg, _ = picture(TAG.sub("", latex).strip(), False)
    ids = "".join(f' id="{name}"' for name in node.get("ids", [])[:1])
    translator.body.append(f'<div class="formula"{ids}><div class="formula-body">{svg}</div>')
    if number:
        link = f'<a class="headerlink" href="#{node["ids"][0]}" title="Link to this equation">¶</a>' if ids else ""
        translator.body.append(f'<span class="formula-number">({escape(str(number))}){link}</span>')
    translator.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Offer the renderer; `html_math_renderer = "svg"` chooses it."""
    app.add_html_math_renderer("svg", (inline, None), (display, None))
