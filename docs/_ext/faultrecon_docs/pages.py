# SPDX-License-Identifier: BSD-3-Clause
"""The pages that are generated, and where they go; a page that has not changed is left alone."""

from __future__ import annotations

from pathlib import Path

from faultrecon.methods.base import Method
from faultrecon.methods.registry import all_methods
from faultrecon_docs import benchmarks, command_line, door, papers
from faultrecon_docs.papers import Warn
from faultrecon_docs.text import page


def write_bibliography(docs: Path) -> None:
    """Write the papers of all methods in BibTeX, into the documentation's folder."""
    write(docs / "papers" / "papers.bib", papers.bibliography((docs / "references.bib").read_text(encoding="utf-8")))


def write_pages(docs: Path, warn: Warn) -> None:
    """Write every generated page into the documentation's folder; warn is told what does not come out as it should."""
    for method in all_methods().values():
        if method.variant_of is None:
            write(docs / "papers" / f"{method.name}.md", _paper(docs, method, warn))
    write(docs / "reference" / "python.md", door.python_page())
    write(docs / "reference" / "command_line.md", command_line.command_line_page())
    write(docs / "benchmarks" / "results.md", benchmarks.results(docs.parent / "benchmarks"))
    for decision in sorted((docs.parent / "adr").glob("[0-9]*.md")):
        write(docs / "why" / decision.name, f"```{{include}} ../../adr/{decision.name}\n```\n")


def write(path: Path, text: str) -> None:
    """Write a page if it says anything new, so that Sphinx reads again what has to be read again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _paper(docs: Path, method: Method, warn: Warn) -> str:
    notes = docs / "papers" / "notes" / f"{method.name}.md"
    folder = docs / "papers" / "figures" / method.paper.key
    numbers, figures = papers.computed_again(method, folder, warn)
    shown = [f"```{{figure}} figures/{method.paper.key}/{f.name}\n:alt: {f.stem}\n```" for f in figures]
    return papers.paper_page(
        method,
        notes=notes.read_text(encoding="utf-8") if notes.exists() else "",
        numbers=numbers,
        figures=page("## Figures", *shown) if shown else "",
        warn=warn,
    )
