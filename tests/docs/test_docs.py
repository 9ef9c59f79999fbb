# SPDX-License-Identifier: BSD-3-Clause
"""The documentation says what there is.  That its pages run is checked by building them, which takes a minute."""

import ast
import re
import sys
from functools import cache
from pathlib import Path

import pytest

import faultrecon as fr
from faultrecon.advise.reproductions import Comparison, Row
from faultrecon.cli.app import app
from faultrecon.methods.base import Unproved
from faultrecon.methods.registry import all_methods, method

ROOT = next(p for p in Path(__file__).parents if (p / "README.md").exists() and (p / "pyproject.toml").exists())
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "_ext"))

from faultrecon_docs import benchmarks, command_line, docstrings, door, papers  # noqa: E402 - the folder is no package
from faultrecon_docs.cells import undressed  # noqa: E402
from faultrecon_docs.pages import write  # noqa: E402
from faultrecon_docs.text import prose, table  # noqa: E402

OWN = [name for name, found in all_methods().items() if found.variant_of is None]
PROVED = [name for name in OWN if not isinstance(method(name), Unproved)]


def text(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def pages() -> list[Path]:
    """The pages that people write; what the build writes is ignored by Git and listed there."""
    ignored = re.findall(r"^/(.+\.md)$", text(".gitignore"), re.MULTILINE)
    folders = [DOCS, DOCS / "howto", DOCS / "reference"]
    found = [p for folder in folders for p in folder.glob("*.md") if str(p.relative_to(DOCS).as_posix()) not in ignored]
    return [*found, DOCS / "papers" / "index.md", DOCS / "why" / "index.md", DOCS / "why" / "sources.md"]


@cache
def paper(name: str) -> str:
    """The page of a method as it is generated; the tables of the whole paper are for the build."""
    row = Row("a number", 1.0, 1.0, 1e-6, note="it holds")
    return papers.paper_page(method(name), notes="A note.", numbers=[Comparison("A table", [row])])


# ---------------------------------------------------------------- complete


def test_every_page_is_in_a_table_of_contents():
    listed = {DOCS / "index.md"}
    for page in pages():
        for block in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            for entry in (line for line in block.splitlines() if line and not line.startswith(":")):
                listed |= set(page.parent.glob(f"{entry}.md"))
    assert [p for p in pages() if p not in listed] == []


def test_every_link_between_pages_leads_somewhere():
    made = {DOCS / "reference/python.md", DOCS / "reference/command_line.md"}
    made |= {DOCS / "why" / p.name for p in (ROOT / "adr").glob("*.md")}
    lost = []
    for page in [*pages(), *(DOCS / "papers" / "notes").glob("*.md")]:
        folder = page.parent.parent if page.parent.name == "notes" else page.parent  # notes are read one folder up
        for link in re.findall(r"\]\(([^)#:\s]+\.md)", page.read_text(encoding="utf-8")):
            target = (folder / link).resolve()
            if not target.exists() and target not in made:
                lost.append(f"{page.name}: {link}")
    assert lost == []


def test_every_public_name_is_in_the_reference():
    page = door.python_page()
    missing = [n for n in fr.__all__ if not n.startswith("__") and f":: faultrecon.{n}\n" not in page + "\n"]
    assert missing == []


def test_every_verb_and_option_is_in_the_reference():
    page = command_line.command_line_page()
    for name, command in command_line.verbs().items():
        section = page.partition(f"## faultrecon {name}\n")[2].partition("\n## ")[0]
        assert command.help.split(".")[0].split(":")[0] in section.replace("\\", "")
        options = {o for p in command.params for o in p.opts if o.startswith("--") and o != "--help"}
        assert {o for o in options if f"{o}`" not in section and f"{o}," not in section} == set()
    assert len(command_line.verbs()) == len(app.registered_commands)


def test_the_exit_codes_are_those_of_the_program():
    from faultrecon.cli.shell import FINE, INTERNAL, NEGATIVE, USAGE

    assert [*command_line.EXIT] == [FINE, NEGATIVE, USAGE, INTERNAL]
    page = text("reference/words.md")
    for name in ("InputError", "MissingExtra", "Impossible", "Inconclusive"):
        kind = getattr(__import__("faultrecon.finding", fromlist=[name]), name)
        assert f"| `{name}` | {kind.exit_code} |" in page


def plant_keys() -> set[str]:
    """The keys that the reader of plant files asks for: the names in its calls of `fields`, and those of the top."""
    from faultrecon.io import formulas, plantfile, polytopic

    found = {*plantfile._REQUIRED, *plantfile._OPTIONAL}
    for module in (plantfile, formulas, polytopic):
        assert module.__file__ is not None
        for call in ast.walk(ast.parse(Path(module.__file__).read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr == "fields":
                words = (node for argument in call.args for node in ast.walk(argument))
                found |= {n.value for n in words if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    return found


def test_every_key_of_a_plant_file_is_in_the_reference():
    page = text("reference/files.md").partition("## Design file")[0]
    keys = plant_keys()
    assert {"signals", "hold", "lipschitz", "role", "rate", "select"} <= keys
    words = set(re.findall(r"\w+", " ".join(re.findall(r"`[^`]+`", page))))
    assert sorted(keys - words) == []


def test_every_function_of_a_formula_is_in_the_reference():
    from faultrecon.graph.parse import FUNCTIONS

    page = text("reference/files.md")
    assert [name for name in FUNCTIONS if f"`{name}`" not in page] == []


def test_every_key_of_a_design_file_is_in_the_reference():
    from faultrecon.io.designfile import design_document

    page = text("reference/files.md").partition("## Design file")[2]
    document = design_document(fr.design(fr.library("lipschitz_polynomial")))
    keys = {*document, *document["certificate"]}
    assert [k for k in sorted(keys) if f"`{k}`" not in page] == []


def test_every_environment_variable_is_in_the_reference():
    sources = [p.read_text(encoding="utf-8") for p in (ROOT / "src").rglob("*.py")]
    used = {v for s in sources for v in re.findall(r"environ\.get\(\"(\w+)\"", s)}
    used |= {v for s in sources for v in re.findall(r"VARIABLE = \"(\w+)\"", s)}
    page = text("reference/words.md")
    assert used and [v for v in sorted(used) if f"`{v}`" not in page] == []


def test_every_call_on_the_pages_is_public():
    written = "\n".join(p.read_text(encoding="utf-8") for p in pages())
    assert set(re.findall(r"\bfr\.(\w+)", written)) <= set(fr.__all__)


def test_every_verb_on_the_pages_exists():
    for page in pages():
        for line in re.findall(r"^faultrecon (\w+)", page.read_text(encoding="utf-8"), re.MULTILINE):
            assert line in command_line.verbs(), page


def test_every_citation_has_an_entry_and_every_entry_is_cited():
    entries = set(re.findall(r"^@\w+\{(\w+),", text("references.bib"), re.MULTILINE))
    methods = set(re.findall(r"^@\w+\{(\w+),", papers.bibliography(), re.MULTILINE))
    written = "\n".join(p.read_text(encoding="utf-8") for p in [*pages(), *(DOCS / "papers/notes").glob("*.md")])
    cited = set(re.findall(r"\{cite:[pt]\}`(\w+)`", written))
    assert entries <= cited <= entries | methods
    assert {m.paper.key for m in all_methods().values()} == methods


# ---------------------------------------------------------------- the pages of the methods


@pytest.mark.parametrize("name", PROVED)
def test_the_page_of_a_method_shows_its_numbered_inequalities(name):
    found = method(name)
    _, plant = papers.example(found)
    from faultrecon.synthesis.levels import scale

    labels = [i.label for i in found.theorem(plant, scale(plant)).inequalities]
    numbers = [label.strip("()") for label in labels if label.startswith("(")]
    assert [n for n in numbers if rf"\tag{{{n}}}" not in paper(name)] == []
    assert paper(name).count("```{math}") >= len(labels)


@pytest.mark.parametrize("name", OWN)
def test_the_page_of_a_method_shows_every_reproduction_with_its_status(name):
    for r in method(name).reproductions:
        line = next(line for line in paper(name).splitlines() if line.startswith(f"| {prose(r.item)} |"))
        assert papers.STATUS[r.status] in line and prose(r.reason) in line
        assert "differs" not in line


@pytest.mark.parametrize("name", OWN)
def test_the_page_of_a_method_says_claim_scope_source_and_what_was_noted(name):
    found, page = method(name), paper(name)
    assert found.paper.title in page and f"{{cite:p}}`{found.paper.key}`" in page
    assert "## What is claimed" in page and "## Assumptions" in page and "A note." in page
    assert "1 of 1 numbers agree" in page


@pytest.mark.parametrize("name", [n for n, m in all_methods().items() if m.variant_of])
def test_a_variant_is_on_the_page_of_its_method(name):
    host = method(name).variant_of
    assert host is not None and f"## Variant: {name}" in paper(host)


def test_typeset_expressions_read_as_written_by_hand():
    assert papers.printed_latex(r"(-\beta) I") == r"-\beta I"
    assert (
        papers.printed_latex(r"\beta \alpha^{\mathrm{plant}} \alpha^{\mathrm{plant}} H") == r"\beta (\alpha^{p})^{2} H"
    )
    assert papers.printed_latex(r"\alpha^{\mathrm{plant}} 2 P") == r"2 \alpha^{p} P"
    assert papers.printed_latex(r"P \prec 0") == r"P \prec 0"


# ---------------------------------------------------------------- small parts


def test_plain_text_stays_plain_in_markdown_and_in_docstrings():
    assert prose("|a| < `x_y` * b_c") == r"\|a\| \< `x_y` \* b\_c"
    assert docstrings.marked("|a| and `x|y`") == r"\|a\| and ``x|y``"
    assert docstrings.restructured(["One:", "", "    x = 1"]) == ["One:", "", "::", "", "        x = 1", ""]


def test_cells_show_what_a_reader_types():
    assert undressed("%%bash --no-raise-error\nfaultrecon doctor") == ("faultrecon doctor", "bash")
    assert undressed("%%writefile plant.toml\nschema = 1") == ("# plant.toml\nschema = 1", "toml")
    assert undressed("import numpy") is None


def test_benchmark_results_become_tables(tmp_path):
    assert "No results" in benchmarks.results(tmp_path)
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "steps.json").write_text(
        '{"title": "Steps", "machine": "a PC", "rows": [{"engine": "numba", "seconds": 0.25}, {"engine": "casadi"}]}',
        encoding="utf-8",
    )
    (tmp_path / "results" / "table.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    page = benchmarks.results(tmp_path)
    assert "## Steps" in page and "| numba | 0.25 |" in page and "| casadi |  |" in page and "Machine: a PC" in page
    assert "## table" in page and "| 1 | 2 |" in page


def test_an_unchanged_page_is_left_alone(tmp_path):
    page = tmp_path / "page.md"
    write(page, "text")
    before = page.stat().st_mtime_ns
    write(page, "text")
    assert page.stat().st_mtime_ns == before


def test_a_table_has_a_line_per_row():
    assert table(["a", "b"], [["1", "2"]]).splitlines() == ["| a | b |", "| --- | --- |", "| 1 | 2 |"]
