# SPDX-License-Identifier: BSD-3-Clause
"""The table [polytopic] of a plant file: premises, the entries of A and B in them, the box, and [polytopic.slope]."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.io.document import Node
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.polytopic import Ends, Family, Polytopic
from faultrecon.plant.signals import NAME, Signals


def polytopic(node: Node, signals: Signals, faults: Sequence[FaultChannel]) -> Polytopic:
    """The polytopic form from [polytopic]."""
    needed = ("premises", "A", "box") + (("B",) if len(signals.u) else ())
    entries = node.fields(needed, ("bounds", "faults", "constants", "slope"))
    n, m = len(signals.x), len(signals.u)
    constants = {k: v.number() for k, v in entries["constants"].table().items()} if "constants" in entries else {}
    A = _texts(entries["A"], n, n)
    B = _texts(entries["B"], n, m) if m else [[] for _ in range(n)]
    rows = [cell for left, right in zip(A, B, strict=True) for cell in (*left, *right)]
    sector = _family(entries["premises"], rows, (n, n + m), "[A B]", signals, constants)
    slope = None
    if "slope" in entries:
        parts = entries["slope"].fields(("premises", "J"))
        cells = [cell for row in _texts(parts["J"], n, n) for cell in row]
        slope = _family(parts["premises"], cells, (n, n), "J", signals, constants)
    scaled = [f.name for f in faults if f.effect == "multiplicative"]
    premises = [*sector.names, *(slope.names if slope is not None else ())]
    tables = {
        "box": _ends(entries["box"], [*signals.x, *signals.u], "state or input"),
        "bounds": _ends(entries["bounds"], premises, "premise") if "bounds" in entries else {},
        "faults": _ends(entries["faults"], scaled, "multiplicative fault") if "faults" in entries else {},
    }
    with node.here():
        return Polytopic(sector, slope=slope, **tables)


def _texts(node: Node, rows: int, columns: int) -> list[list[Node]]:
    """A matrix of numbers and formulas."""
    found = [row.items() for row in node.items()]
    for row, cells in zip(node.items(), found, strict=True):
        if len(cells) != columns:
            row.refuse(f"has {len(cells)} entries", "", f"give {columns}")
    if len(found) != rows:
        node.refuse(f"has {len(found)} rows", "", f"give {rows}")
    return found


def _text(cell: Node) -> str:
    return cell.string() if isinstance(cell.value, str) else repr(cell.number())


def _family(
    premises: Node,
    cells: Sequence[Node],
    shape: tuple[int, int],
    letter: str,
    signals: Signals,
    constants: Mapping[str, float],
) -> Family:
    """Premises and entries as graphs; each formula is read where it stands first, so that a complaint has its line."""
    named = premises.table()
    if not named:
        premises.refuse("names no premise", "", "a linear plant needs no polytopic form: leave the table out")
    for name, entry in named.items():
        if not NAME.fullmatch(name):
            entry.refuse(f"{name!r} is no name", "", "use letters, digits and _, a letter first")
    inputs = {"x": signals.x.names, "u": signals.u.names}
    _read([(e, e.string()) for e in named.values()], [*signals.x, *signals.u], constants)
    _read([(c, c.string()) for c in cells if isinstance(c.value, str)], list(named), constants)
    with premises.here():
        z = Graph.from_texts([e.string() for e in named.values()], inputs, constants)
        return Family(z, Graph.from_texts([_text(c) for c in cells], {"z": tuple(named)}, constants), shape, letter)


def _read(formulas: Sequence[tuple[Node, str]], names: Sequence[str], constants: Mapping[str, float]) -> None:
    import casadi as ca

    from faultrecon.graph.parse import parse

    symbols = {name: ca.SX.sym(name) for name in names if name not in constants}
    for node, text in formulas:
        parse(text, symbols, constants=constants, where=node.where)


def _ends(node: Node, known: Sequence[str], kind: str) -> dict[str, Ends]:
    """Intervals by declared name."""
    found = {}
    for name, entry in node.by_name(known, kind).items():
        items = entry.items()
        if len(items) != 2:
            entry.refuse(f"has {len(items)} ends", "", f"write {name} = [low, high]")
        low, high = (item.number() for item in items)
        if not low < high:
            entry.refuse(f"is [{low}, {high}]", "it is empty", "give the lower end first")
        found[name] = (low, high)
    return found


Spell = tuple[Callable[[float], str], Callable[[str], str], Callable[[Mapping[str, float]], str]]
"""How a number, a text and a table of numbers are written."""


def polytopic_lines(form: Polytopic, spell: Spell) -> list[str]:
    """The form as lines of TOML."""
    number, quoted, table = spell
    n = form.sector.shape[0]
    lines = ["", "[polytopic]", *_premises(form.sector, quoted)]
    width = form.sector.shape[1]
    texts = _rows(form.sector)
    lines += [f"A = [{', '.join('[' + ', '.join(quoted(t) for t in row[:n]) + ']' for row in texts)}]"]
    if width > n:
        lines += [f"B = [{', '.join('[' + ', '.join(quoted(t) for t in row[n:]) + ']' for row in texts)}]"]
    for key, ends in (("box", form.box), ("bounds", form.bounds), ("faults", form.faults)):
        if ends:
            inside = ", ".join(f"{quoted(k)} = [{number(a)}, {number(b)}]" for k, (a, b) in ends.items())
            lines.append(f"{key} = {{ {inside} }}")
    constants = dict(form.sector.premises.constants)
    if constants:
        lines.append(f"constants = {table(constants)}")
    if form.slope is not None:
        rows = ("[" + ", ".join(quoted(t) for t in row) + "]" for row in _rows(form.slope))
        lines += ["[polytopic.slope]", *_premises(form.slope, quoted), f"J = [{', '.join(rows)}]"]
    return lines


def _premises(family: Family, quoted: Callable[[str], str]) -> list[str]:
    _demand_texts(family)
    pairs = zip(family.names, family.premises.texts, strict=True)
    return [f"premises = {{ {', '.join(f'{name} = {quoted(text)}' for name, text in pairs)} }}"]


def _rows(family: Family) -> list[tuple[str, ...]]:
    _demand_texts(family)
    columns = family.shape[1]
    texts = family.entries.texts
    return [texts[i : i + columns] for i in range(0, len(texts), columns)]


def _demand_texts(family: Family) -> None:
    if not (family.premises.texts and family.entries.texts):
        raise InputError(
            f"the form {family.letter} was not built from formulas, so it cannot be written as a plant file",
            remedies=("build its graphs with Graph.from_texts",),
        )
