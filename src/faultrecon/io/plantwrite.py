# SPDX-License-Identifier: BSD-3-Clause
"""Write a plant as the TOML that people edit, such that reading it gives the same plant to the last bit."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.io.plantfile import SCHEMA, parse_plant
from faultrecon.io.polytopic import polytopic_lines
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import KnownTerm, Lipschitz
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Signals
from faultrecon.storage.atomic import write_text

Lines = list[str]
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\r": "\\r", "\t": "\\t"}


def write_plant(plant: Plant, path: str | os.PathLike[str]) -> None:
    """Write the plant's TOML, whole or not at all.  Raises InputError as `plant_text` does."""
    write_text(path, plant_text(plant))


def plant_text(plant: Plant) -> str:
    """The plant as TOML: numbers in the shortest form that reads back exactly, one matrix row per line.

    A Lipschitz constant with basis "proved" is written as "derive": a file claims no proof, reading it proves again.
    Raises InputError when a term was not built from formulas, or when something in the plant has no place in a file.
    """
    lines = [f"schema = {SCHEMA}", f"name = {_quoted(plant.name)}"]
    if plant.source:
        lines.append(f"source = {_quoted(plant.source)}")
    if plant.sample_time is not None:
        lines.append(f"sample_time = {_number(plant.sample_time)}")
    lines += _signals(plant.signals)
    if plant.noise is not None:
        levels = zip(plant.signals.y, plant.noise.sd, strict=True)
        lines += ["", "[noise]", f"hold = {_number(plant.noise.hold)}", f"sd = {_table(dict(levels))}"]
    lines += _operating_point(plant)
    lines += _matrices(plant)
    if plant.nonlinearity is not None:
        lines += _nonlinearity(plant.nonlinearity, plant.signals)
    if plant.known is not None:
        lines += _known(plant.known, plant.signals)
    if plant.polytopic is not None:
        lines += polytopic_lines(plant.polytopic, (_number, _quoted, _table))
    for disturbance in plant.disturbances:
        lines += _disturbance(disturbance)
    for fault in plant.faults:
        lines += _fault(fault)
    text = "\n".join(lines) + "\n"
    _check_reads_back(plant, text)
    return text


def _check_reads_back(plant: Plant, text: str) -> None:
    """What is handed out is what was asked for: the text is read and compared before anybody relies on it."""
    try:
        again = parse_plant(text, "the file")
    except InputError as error:
        raise InputError(
            f"the plant '{plant.name}' cannot be written as a file", why=str(error), see="the plant file format"
        ) from error
    if plant.nonlinearity is not None and again.nonlinearity is not None:
        ours, theirs = plant.nonlinearity, again.nonlinearity
        if (ours.constant, ours.basis) != (theirs.constant, theirs.basis):
            raise InputError(
                f"the {ours.basis} Lipschitz constant {ours.constant!r} cannot be written",
                why=f'a file says "derive" for proved, which is {theirs.constant!r} ({theirs.basis}) on this domain'
                if ours.basis == "proved"
                else f"a file gives it or those of the components, from which {theirs.constant!r} follows",
                remedies=("use that constant", 'declare yours with basis "assumed"'),
            )
        if ours.channels != theirs.channels:
            raise InputError(
                f"the Lipschitz constants {ours.channels} of the components of phi cannot be written",
                why=f'a file says "derive" for proved, which gives {theirs.channels} on this domain',
                remedies=("use those constants", 'declare yours with basis "assumed"'),
            )
    written, read = plant.to_dict(), again.to_dict()
    lost = [key for key in written if written[key] != read.get(key)]
    if lost:
        raise InputError(f"the plant '{plant.name}' cannot be written as a file", why=f"{lost[0]} would change")


# ---------------------------------------------------------------- values


def _number(value: float) -> str:
    return repr(float(value))


def _quoted(text: str) -> str:
    """A TOML basic string."""
    out = "".join(_ESCAPES.get(c, c if c.isprintable() else f"\\U{ord(c):08x}") for c in text)
    return f'"{out}"'


def _key(name: str) -> str:
    return name if _BARE_KEY.fullmatch(name) else _quoted(name)


def _table(values: Mapping[str, float]) -> str:
    inside = ", ".join(f"{_key(name)} = {_number(value)}" for name, value in values.items())
    return f"{{ {inside} }}" if inside else "{}"


def _list(texts: Iterable[str]) -> str:
    return f"[{', '.join(_quoted(text) for text in texts)}]"


def _rows(key: str, matrix: NDArray[np.float64]) -> Lines:
    return [f"{key} = [", *(f"  [{', '.join(_number(v) for v in row)}]," for row in matrix), "]"]


def _says_something(value: float) -> bool:
    """Not plain zero, which is what an absent entry means; minus zero is another number to the last bit."""
    return value != 0 or math.copysign(1.0, value) < 0


# ---------------------------------------------------------------- tables


def _signals(signals: Signals) -> Lines:
    groups: dict[str, Channels] = {"x": signals.x, "u": signals.u, "y": signals.y}
    lines = ["", "[signals]"]
    lines += [f"{group} = {_list(channels.texts())}" for group, channels in groups.items() if len(channels)]
    ranges = {
        group: {n: r for n, r in zip(channels.names, channels.ranges, strict=True) if not math.isnan(r)}
        for group, channels in groups.items()
    }
    limits = {name: pair for group in (signals.u, signals.y) for name, pair in group.limited().items()}
    bounded = [f"{_key(name)} = [{_number(a)}, {_number(b)}]" for name, (a, b) in limits.items()]
    after = ["", "[signals.limits]", *bounded] if bounded else []
    if not any(ranges.values()):
        return lines + after
    # A name that both a state and a sensor bear needs the longer form, which says whose range it is.
    if set(signals.x.names) & set(signals.y.names):
        given = {group: table for group, table in ranges.items() if table}
        told = [f"{group} = {_table(table)}" for group, table in given.items()]
        return lines + ["", "[signals.range]", *told, *after]
    flat = [f"{_key(name)} = {_number(r)}" for table in ranges.values() for name, r in table.items()]
    return lines + ["", "[signals.range]", *flat, *after]


def _operating_point(plant: Plant) -> Lines:
    lines = []
    for group in ("x", "u", "y"):
        values = dict(zip(getattr(plant.signals, group), getattr(plant.point, group), strict=True))
        told = {name: value for name, value in values.items() if _says_something(value)}
        if told:
            lines.append(f"{group} = {_table(told)}")
    return ["", "[operating_point]", *lines] if lines else []


def _matrices(plant: Plant) -> Lines:
    lines = ["", "[matrices]", *_rows("A", plant.A)]
    if len(plant.signals.u):
        lines += _rows("B", plant.B)
    chosen = _selected(plant.C, plant.signals.x.names)
    lines += _rows("C", plant.C) if chosen is None else [f"C = {{ select = {_list(chosen)} }}"]
    if any(_says_something(v) for v in plant.D.flat):
        lines += _rows("D", plant.D)
    return lines


def _selected(C: NDArray[np.float64], states: Sequence[str]) -> list[str] | None:
    """The state that each row of C reads with coefficient one; None when C does anything else."""
    told = [[j for j, value in enumerate(row) if _says_something(value)] for row in C]
    if all(len(columns) == 1 and row[columns[0]] == 1.0 for row, columns in zip(C, told, strict=True)):
        return [states[columns[0]] for columns in told]
    return None


def _into(matrix: NDArray[np.float64], states: Sequence[str]) -> str:
    """One entry per column: a state's name where that says it all, else coefficients by state."""
    entries = []
    for column in matrix.T:
        table = {name: value for name, value in zip(states, column, strict=True) if _says_something(value)}
        plain = list(table.values()) == [1.0]
        entries.append(_quoted(next(iter(table))) if plain else _table(table))
    return f"[{', '.join(entries)}]"


def _formulas(key: str, graph: Graph, inputs: Mapping[str, tuple[str, ...]]) -> Lines:
    """The formulas a graph was built from; a traced one has none, and its instructions are no text for people."""
    if not graph.texts:
        raise InputError(
            f"{key} was not built from formulas, so it cannot be written as a plant file",
            remedies=("build it with Graph.from_texts", "save the design, which stores the expression graph"),
        )
    if dict(graph.inputs) != dict(inputs) or list(graph.inputs) != list(inputs):
        raise InputError(f"{key} is a function of {dict(graph.inputs)}", why=f"a plant file gives it {dict(inputs)}")
    lines = [f"{key} = [", *(f"  {_quoted(text)}," for text in graph.texts), "]"]
    return [*lines, f"constants = {_table(graph.constants)}"] if graph.constants else lines


def _nonlinearity(term: Lipschitz, signals: Signals) -> Lines:
    lines = ["", "[nonlinearity]", f"into = {_into(term.into, signals.x.names)}"]
    lines += _formulas("phi", term.phi, {"x": term.reads, "u": signals.u.names, "t": ("t",)})
    lines.append(f"reads = {_list(term.reads)}")
    if term.domain:
        ends = [f"{_key(name)} = [{_number(a)}, {_number(b)}]" for name, (a, b) in term.domain.items()]
        lines.append(f"domain = {{ {', '.join(ends)} }}")
    if term.basis == "proved":
        return [*lines, 'lipschitz = "derive"']
    each = None if term.channels is None else ", ".join(_number(c) for c in term.channels)
    return [*lines, f"lipschitz = {_number(term.constant)}" if each is None else f"lipschitz = [{each}]"]


def _known(term: KnownTerm, signals: Signals) -> Lines:
    lines = ["", "[known]", f"into = {_into(term.into, signals.x.names)}"]
    return lines + _formulas("g", term.g, {"y": signals.y.names, "u": signals.u.names, "t": ("t",)})


def _disturbance(disturbance: Disturbance) -> Lines:
    lines = ["", "[[disturbance]]", f"name = {_quoted(disturbance.name)}"]
    lines += [f"{key} = {_table(t)}" for key, t in (("into", disturbance.into), ("on", disturbance.on)) if t]
    return [*lines, f"role = {_quoted(disturbance.role)}", f"size = {_number(disturbance.size)}"]


def _fault(fault: FaultChannel) -> Lines:
    lines = ["", "[[fault]]", f"name = {_quoted(fault.name)}"]
    if list(fault.on.values()) == [1.0]:
        lines.append(f"{fault.site} = {_quoted(next(iter(fault.on)))}")
    else:
        lines.append(f"on = {_table(fault.on)}")
    lines += [f"effect = {_quoted(fault.effect)}", f"size = {_number(fault.size)}"]
    return [*lines, f"rate = {_number(fault.rate)}"] if math.isfinite(fault.rate) else lines
