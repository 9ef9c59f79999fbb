# SPDX-License-Identifier: BSD-3-Clause
"""Tables of the benchmark results that are committed beside the scripts that write them.

`benchmarks/results/<name>.json` holds {"title", "about", "command", "machine", "date", "rows": [{column: value}]}, of
which only `rows` is needed; `<name>.csv` holds the rows alone.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from faultrecon_docs.text import code, page, prose, table

NONE_YET = (
    "No results are committed yet. Run the scripts in `benchmarks/`;"
    " what they write to `benchmarks/results/` is shown here."
)


def results(folder: Path) -> str:
    """A section per results file, or how to make them."""
    files = sorted(p for p in (folder / "results").glob("*") if p.suffix in (".json", ".csv"))
    return page(*(section(path) for path in files)) if files else NONE_YET + "\n"


def section(path: Path) -> str:
    """The table of one file under its title."""
    about, rows = read(path)
    facts = [f"{word}: {prose(str(about[key]))}" for key, word in FACTS.items() if about.get(key)]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    cells = [[shown(row.get(column)) for column in columns] for row in rows]
    return page(
        f"## {prose(str(about.get('title') or path.stem.replace('_', ' ')))}",
        prose(str(about.get("about", ""))),
        table([prose(c) for c in columns], cells, kind="numbers") if rows else "The file holds no rows.",
        ". ".join(facts) + "." if facts else "",
        f"Made by {code(str(about['command']))}." if about.get("command") else "",
    )


FACTS = {"machine": "Machine", "date": "Date", "version": "Version"}


def read(path: Path) -> tuple[Mapping[str, Any], Sequence[Mapping[str, Any]]]:
    """What is said about the results, and their rows."""
    if path.suffix == ".csv":
        with path.open(encoding="utf-8", newline="") as file:
            return {}, list(csv.DictReader(file))
    document = json.loads(path.read_text(encoding="utf-8"))
    if isinstance(document, list):
        return {}, document
    return {k: v for k, v in document.items() if k != "rows"}, document.get("rows", [])


def shown(value: Any) -> str:
    """A cell: numbers in four digits, nothing for nothing."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else prose(str(value))
