# SPDX-License-Identifier: BSD-3-Clause
"""A page per method, written from the method itself: what it says, what it assumes, its theorem, and its numbers.

The inequality on the page is the expression that is solved and proved, so the page cannot say anything else.  What a
docstring cannot hold, the story of a printed number that does not hold, is in `docs/papers/notes/<method>.md`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from faultrecon.advise.reproductions import Comparison, reproduce, reproducible
from faultrecon.finding import FaultreconError, Impossible, Inconclusive
from faultrecon.io.library import library_names, read_library
from faultrecon.lmi.expr import Inequality
from faultrecon.lmi.typeset import definitions_latex, inequality_latex, latex, letter_latex
from faultrecon.lmi.walk import leaves
from faultrecon.methods.base import Method, Paper, Theorem, Unproved
from faultrecon.methods.registry import all_methods
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.levels import scale
from faultrecon.synthesis.pipeline import optimum
from faultrecon_docs.rewriting import printed_latex, shipped_latex
from faultrecon_docs.text import (
    code,
    code_block,
    folded,
    formula,
    formulas,
    number,
    page,
    paragraphs,
    prose,
    sentence,
    table,
)

Warn = Callable[[str], None]
STATUS = {
    "as_printed": "as printed",
    "with_change": "with a change",
    "not_as_printed": "not as printed",
    "re_derived": "re-derived",
}
FURTHER = "All numbers of the paper, computed again"


def paper_page(
    method: Method, *, notes: str = "", numbers: Sequence[Comparison] = (), figures: str = "", warn: Warn = print
) -> str:
    """The page of a method.

    notes: Markdown about this method in particular; numbers: further tables of its paper; figures: Markdown that shows
    its figures; warn: told of every reproduction that does not come out as its reference.
    """
    return page(
        f"({anchor(method)})=\n# {method.name}",
        sentence(method.summary),
        f"Source: {source(method)}" + (" This is a baseline: something to compare with." if method.baseline else ""),
        f"```bash\nfaultrecon design plant.toml --method {method.name} --out design.json\n```",
        "## Notation",
        *_notation(method),
        "## Assumptions",
        prose(inspect.getdoc(type(method).assumptions) or ""),
        *_who_meets_them(method),
        *(_claims_nothing(method) if isinstance(method, Unproved) else _claims(method)),
        *_printed(method, warn),
        notes,
        *_variants(method),
        *_further(method.paper.key, numbers),
        figures,
    )


def _claims(method: Method) -> list[str]:
    """The theorem, what it promises, and on what."""
    name, plant = example(method)
    theorem = method.theorem(plant, scale(plant))
    return [
        _heading(theorem),
        prose(inspect.getdoc(_statement(method, theorem)) or ""),
        *_theorem(theorem),
        "## What is claimed",
        f"> {sentence(theorem.claim)}",
        f"The scope that every design states with it; here for the library plant {code(name)}:",
        f"> {sentence(theorem.scope)}",
        *_premises(theorem),
    ]


def _claims_nothing(method: Unproved) -> list[str]:
    """The gains of a baseline without a theorem."""
    return [
        "## The gains",
        prose(inspect.getdoc(type(method).gains_without_proof) or ""),
        f"They are picked by: {prose(method.criterion)}.",
        "## What is claimed",
        "> Nothing: a design by this baseline carries no certificate.",
    ]


def anchor(method: Method) -> str:
    """What other pages call this page."""
    return f"method-{method.name}"


def bibliography(cited: str = "") -> str:
    """The papers of all methods in BibTeX, from the methods, but for those that are cited elsewhere too."""
    papers = {m.paper.key: m.paper for m in all_methods().values() if f"{{{m.paper.key}," not in cited}
    return "% Written from the methods when the pages are built.\n" + "\n".join(_entry(p) for p in papers.values())


def example(method: Method) -> tuple[str, Plant]:
    """A library plant that the method takes, one of its own reproductions if it has any."""
    names = [r.plant for r in method.reproductions]
    names += sorted(library_names(), key=lambda n: (n == "airliner", n))
    for name in dict.fromkeys(names):
        plant = read_library(name)
        if not any(f.severity == "fatal" for f in method.assumptions(plant)):
            return name, plant
    raise LookupError(f"no library plant meets the assumptions of {method.name}")


def source(method: Method) -> str:
    """The reference, with a link where there is a DOI."""
    paper = method.paper
    doi = f" [doi:{paper.doi}](https://doi.org/{paper.doi})" if paper.doi else ""
    text = f"{paper.authors} ({paper.year}). *{prose(paper.title)}*. {prose(paper.venue)}."
    return f"{text}{doi} {{cite:p}}`{paper.key}`."


def _entry(paper: Paper) -> str:
    authors = " and ".join(author.strip() for author in paper.authors.split(";"))
    fields = {"author": authors, "year": str(paper.year), "title": f"{{{paper.title}}}", "journal": paper.venue}
    if paper.doi:
        fields["doi"] = paper.doi
    inner = ",\n".join(f"  {key} = {{{value}}}" for key, value in fields.items())
    return f"@article{{{paper.key},\n{inner}\n}}\n"


# ---------------------------------------------------------------- what the file says


def _notation(method: Method) -> list[str]:
    """The module's docstring: its prose, and the dictionary of letters as a table."""
    parts = []
    for text in paragraphs(inspect.getdoc(inspect.getmodule(type(method))) or ""):
        if text.split(maxsplit=1)[0] == "paper":
            parts.append(_dictionary(text))
        elif text.startswith("    "):
            parts.append(code_block(inspect.cleandoc(text)))
        elif "\n    " in text:
            parts.append(_terms(text))
        else:
            parts.append(prose(text))
    return parts


def _terms(text: str) -> str:
    """Terms that begin a line, each with its text beside it, as a list."""
    items: list[str] = []
    for line in text.splitlines():
        if line.startswith(" ") and items:
            items[-1] += f" {line.strip()}"
        else:
            term, _, said = line.partition("  ")
            items.append(f"- *{prose(term)}*: {prose(said.strip())}" if said else f"- {prose(term)}")
    return "\n".join(items)


def _dictionary(text: str) -> str:
    """A dictionary of letters: cells under a heading belong to it, others are remarks."""
    head, *lines = text.splitlines()
    heads = {cell.start(): cell[0] for cell in CELL.finditer(head)}
    rows = []
    for line in lines:
        cells = [(cell.start(), cell[0]) for cell in CELL.finditer(line)]
        under = [code(dict(cells).get(start, "")) for start in heads]
        rows.append([*under, prose("; ".join(cell for start, cell in cells if start not in heads))])
    return table([*heads.values(), "remark"], rows)


CELL = re.compile(r"\S+(?: \S+)*")  # words with single blanks between them


def _who_meets_them(method: Method) -> list[str]:
    rows = []
    for name in library_names():
        found = method.assumptions(read_library(name))
        rows.append([code(name), "<br>".join(prose(str(f)) for f in found) or "meets them"])
    return ["The plants of the library:", table(["plant", "answer"], rows)]


def _statement(method: Method, theorem: Theorem) -> Callable[..., Theorem]:
    """The function that states the theorem: theorem_3_1 for Theorem 3.1, else `theorem`."""
    return getattr(type(method), f"theorem_{theorem.number.replace('.', '_')}", type(method).theorem)


def _heading(theorem: Theorem) -> str:
    """Theorems are numbered within sections, 3.1; a plain number is that of an inequality."""
    if not theorem.number[:1].isdigit():
        return "## The inequality"
    return f"## Theorem {theorem.number}" if "." in theorem.number else f"## Inequality ({theorem.number})"


# ---------------------------------------------------------------- the theorem


def _held(letter: str, value: Any) -> str:
    """A number that is held fixed, or the letter of a matrix that is."""
    size = getattr(value, "size", 1)
    return f"${letter} = {float(value):g}$" if size == 1 else f"${letter}$ as the plant asks for"


def _theorem(theorem: Theorem) -> list[str]:
    minimised = printed_latex(latex(theorem.minimise))
    unknowns = leaves([i.expr for i in theorem.inequalities], "unknown")
    free = [
        printed_latex(letter_latex(n)) for n in (node.args[0] for node in unknowns.values()) if n not in theorem.fixed
    ]
    fixed = [_held(printed_latex(letter_latex(k)), v) for k, v in theorem.fixed.items()]
    text = f"Minimise ${minimised}$ over ${', '.join(free)}$"
    text += f", with {', '.join(fixed)} unless it is set free with `free=`," if fixed else ","
    own = [f"{shipped_latex(latex(k), theorem)} = {printed_latex(latex(v))}" for k, v in theorem.gains.items()]
    shipped = [f"{printed_latex(latex(k))} = {shipped_latex(latex(v), theorem)}" for k, v in theorem.prove_with.items()]
    return [
        f"{text} subject to",
        *(formula(printed_latex(inequality_latex(i))) for i in theorem.inequalities),
        "where",
        formulas(printed_latex(line) for line in definitions_latex(theorem.inequalities)),
        _letters_explained(theorem),
        *(["The gains are", formulas(own)] if own else ["There is no gain to choose."]),
        ("They are rounded to what runs. Then the" if own else "The")
        + " inequalities are proved once more in exact arithmetic, about "
        + ("the rounded gains and the level that ships" if own else "the level that ships")
        + ", with "
        + ", ".join(f"${line}$" for line in shipped)
        + ". A raised $s$ marks what ships, in the plant's units; the same letters without it are unknowns above.",
    ]


EXPLAINED = {
    "T": "$T$ is diagonal and scales the states by powers of two",
    "R⁻¹": "$R$ does the same for the healthy outputs",
    "U": r"$U$ is a power of two that brings $\gamma$ near one",
    "N": "$N$ picks the healthy outputs, $N F = 0$",
    "F⁺": "$F^{+}$ is a left inverse of the fault matrix, $F^{+} F = I$",
    "plant.W": "$W^{p}$ holds the declared sizes of the disturbances",
    "plant.V": "$V^{p}$ holds one over the declared sizes of the faults",
    "plant.α": r"$\alpha^{p}$ is the Lipschitz constant",
}


def _letters_explained(theorem: Theorem) -> str:
    nodes = [i.expr for i in theorem.inequalities] + list(theorem.gains.values())
    present = {node.args[0] for node in leaves(nodes, "given").values()}
    known = [text for letter, text in EXPLAINED.items() if letter in present]
    return "A raised $p$ marks a letter of the [plant file](../reference/files.md). " + "; ".join(known) + "."


def _premises(theorem: Theorem) -> list[str]:
    found = [f"- {prose(p.label)} ({p.verdict}): {prose(p.text)}" for p in theorem.premises]
    return ["Taken from elsewhere, and marked so in the certificate:", "\n".join(found)] if found else []


# ---------------------------------------------------------------- numbers


def _printed(method: Method, warn: Warn) -> list[str]:
    if not method.reproductions:
        return []
    rows = []
    for r in method.reproductions:
        printed = "none" if r.printed is None else number(r.printed)
        computed = _level_or_none(r.plant, method, r.options)
        agrees = computed is not None and abs(computed - r.expected) <= r.rtol * abs(r.expected)
        if not agrees:
            warn(f"{method.name}, {r.item}: computed {computed}, reference {r.expected}")
        shown = number(computed) if agrees else f"**{number(computed)}, differs**"
        rows.append([prose(r.item), printed, shown, number(r.expected), STATUS[r.status], prose(r.reason)])
    head = ["item", "printed", "computed now", "our reference", "status", "reason"]
    about = (
        "*Printed* is the paper's number; *computed now* came out when this page was built; *our reference* is from an"
        " independent implementation. The status says what holds of the printed number."
    )
    return ["## Printed and computed", about, table(head, rows, kind="wide")]


def _variants(method: Method) -> list[str]:
    parts: list[str] = []
    for other in all_methods().values():
        if other.variant_of != method.name:
            continue
        more = [] if isinstance(other, Unproved) else _added(method, other)
        parts += [
            f"## Variant: {other.name}",
            sentence(other.summary),
            prose(inspect.getdoc(type(other)) or ""),
            "`faultrecon methods --variants` lists it.",
            *(["It adds"] if more else []),
            *(formula(printed_latex(inequality_latex(i))) for i in more),
            *(["where", formulas(map(printed_latex, letters))] if (letters := definitions_latex(more)) else []),
            *_compared(method, other),
        ]
    return parts


def _added(method: Method, other: Method) -> list[Inequality]:
    """The inequalities of a variant that the method itself does not have, by their labels."""
    _, plant = example(other)
    base = {i.label for i in method.theorem(plant, scale(plant)).inequalities}
    return [i for i in other.theorem(plant, scale(plant)).inequalities if i.label not in base]


def _compared(method: Method, other: Method) -> list[str]:
    if isinstance(method, Unproved) or isinstance(other, Unproved):
        return []
    plants = dict.fromkeys(r.plant for r in method.reproductions)
    rows = [[code(p), *(_answer(p, m) for m in (method, other))] for p in plants]
    return ["Smallest level:", table(["plant", method.name, other.name], rows)] if rows else []


def _level_or_none(plant: str, method: Method, options: Mapping[str, Any] | None = None) -> float | None:
    """The smallest level; None where there is no solution."""
    try:
        return optimum(read_library(plant), method.name, **(options or {}))
    except Impossible:
        return None


def _answer(plant: str, method: Method) -> str:
    try:
        return number(_level_or_none(plant, method))
    except Inconclusive:
        return "the solver cannot tell"


def _further(key: str, numbers: Sequence[Comparison]) -> list[str]:
    if not numbers:
        return []
    rows = [row for comparison in numbers for row in comparison.rows]
    good = sum(row.agrees for row in rows)
    parts = [
        f"## {FURTHER}",
        f"```bash\nfaultrecon reproduce {key}\n```",
        f"{good} of {len(rows)} numbers agree with our references within the tolerances stated. *Predicted* is what"
        " theory says about a number that depends on random noise; the computed one is then compared with it.",
    ]
    for comparison in numbers:
        predicted = any(row.expected is not None for row in comparison.rows)
        head = ["", "our reference", *(["predicted"] if predicted else []), "computed now", "within", ""]
        rows = [
            [
                prose(row.item),
                number(row.reference),
                *([number(row.expected) if row.expected is not None else ""] if predicted else []),
                number(row.computed),
                f"{row.tolerance:.2g}" + ("" if row.absolute else " rel."),
                "agrees" if row.agrees else "**differs**",
            ]
            for row in comparison.rows
        ]
        notes = dict.fromkeys([*(row.note for row in comparison.rows if row.note), *comparison.remarks])
        body = [*(sentence(note) for note in notes), folded(f"{len(rows)} numbers", table(head, rows, kind="numbers"))]
        parts += [f"### {prose(comparison.title)}", *body]
    return parts


def computed_again(method: Method, folder: Path | None, warn: Warn) -> tuple[Sequence[Comparison], Sequence[Path]]:
    """The tables and figures of a method's paper; none for a baseline or where no reproduction is written."""
    if method.baseline or method.variant_of or method.paper.key not in reproducible():
        return (), ()
    try:
        found = reproduce(method.paper.key, folder)
    except FaultreconError as error:  # the warning fails the build; the other pages can still be looked at
        warn(f"{method.paper.key} cannot be reproduced: {error}")
        return (), ()
    told = {r.item for r in method.reproductions}  # these stand in a table of their own
    return [table for table in found.tables if {row.item for row in table.rows} - told], found.figures
