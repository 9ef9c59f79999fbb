# SPDX-License-Identifier: BSD-3-Clause
"""The two tables of a plant file that hold formulas: [nonlinearity] with its Lipschitz constant, and [known]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import did_you_mean
from faultrecon.graph.function import Graph
from faultrecon.io.document import Node
from faultrecon.plant.lipschitz import Basis, KnownTerm, Lipschitz, combined, used_names
from faultrecon.plant.signals import NAME, Channels, Signals

Interval = tuple[float, float]


def nonlinearity(node: Node, signals: Signals) -> Lipschitz:
    """G φ(H x, u, t) from [nonlinearity], with the constant that is given or proved here."""
    entries = node.fields(("into", "phi", "lipschitz"), ("reads", "constants", "domain"))
    formulas = _formulas(entries["phi"])
    if "reads" in entries:
        reads = _reads(entries["reads"], signals.x)
        _check_reads(entries["phi"], reads, signals.x)
    else:
        reads = used_names(formulas, signals.x.names)
    phi = _graph(entries, "phi", {"x": reads, "u": signals.u.names, "t": ("t",)}, signals.x.names)
    into = _columns(entries["into"], signals.x, len(formulas))
    domain = _domain(entries["domain"], phi) if "domain" in entries else {}
    constant, basis, channels = _constant(entries["lipschitz"], phi, domain)
    kept = {name: ends for name, ends in domain.items() if name in reads}
    if kept != domain and entries["lipschitz"].value != "derive":
        other = next(name for name in domain if name not in kept)
        place = entries["domain"].table()[other]
        place.refuse(f"'{other}' is no state", 'its interval only serves lipschitz = "derive"', "remove it")
    with node.here():
        return Lipschitz(into, reads, phi, constant, basis, kept, channels)


def known_term(node: Node, signals: Signals) -> KnownTerm:
    """g(y, u, t) from [known]."""
    entries = node.fields(("into", "g"), ("constants",))
    g = _graph(entries, "g", {"y": signals.y.names, "u": signals.u.names, "t": ("t",)})
    with node.here():
        return KnownTerm(_columns(entries["into"], signals.x, g.n_outputs), g)


def _formulas(node: Node) -> list[str]:
    texts = [item.string() for item in node.items()]
    if not texts:
        node.refuse("holds no formula", "", "give one text per component, or leave the table out")
    return texts


def _graph(
    entries: Mapping[str, Node], key: str, inputs: Mapping[str, Sequence[str]], states: Sequence[str] = ()
) -> Graph:
    """The formulas as a graph; each is read where it stands first, so that a complaint has its line.

    states: further names that a misspelt one may stand for.
    """
    import casadi as ca

    from faultrecon.graph.parse import parse

    taken = [name for names in inputs.values() for name in names]
    constants = _constants(entries["constants"], taken) if "constants" in entries else {}
    symbols = {name: ca.SX.sym(name) for name in (*taken, *states) if name not in constants}
    texts = _formulas(entries[key])
    for item in entries[key].items():
        parse(item.string(), symbols, constants=constants, where=item.where)
    with entries[key].here():
        return Graph.from_texts(texts, inputs, constants)


def _constants(node: Node, taken: Sequence[str]) -> dict[str, float]:
    for name, entry in node.table().items():
        if not NAME.fullmatch(name):
            entry.refuse(f"{name!r} is no name", "", "use letters, digits and _, a letter first")
        if name in taken:
            entry.refuse(f"'{name}' is a signal already", "", "rename the constant")
    return {name: entry.number() for name, entry in node.table().items()}


def _reads(node: Node, states: Channels) -> tuple[str, ...]:
    reads = [item.name(states, "state") for item in node.items()]
    for item in node.items():
        if reads.count(item.string()) > 1:
            item.refuse(f"'{item.string()}' is read twice", "", "name each state once")
    return tuple(reads)


def _check_reads(formulas: Node, reads: Sequence[str], states: Channels) -> None:
    """A formula uses only the states it says it reads."""
    for item in formulas.items():
        for name in used_names([item.string()], states.names):
            if name not in reads:
                item.refuse(f"uses the state '{name}'", "nonlinearity.reads leaves it out", f"add '{name}' to reads")


def _columns(node: Node, states: Channels, width: int) -> NDArray[np.float64]:
    """The (n, m) matrix by which m components enter: each a state's name, or coefficients by state."""
    items = node.items()
    if len(items) != width:
        node.refuse(f"has {len(items)} entries for {width} formulas", "", "give one state or table per formula")
    matrix = np.zeros((len(states), width))
    for j, item in enumerate(items):
        table = item.numbers(states, "state") if isinstance(item.value, dict) else {item.name(states, "state"): 1.0}
        for name, coefficient in table.items():
            matrix[states.index(name), j] = coefficient
    return matrix


def _domain(node: Node, phi: Graph) -> dict[str, Interval]:
    """Low and high end by name, for what φ reads."""
    domain: dict[str, Interval] = {}
    for name, entry in node.table().items():
        if name not in _arguments(phi):
            entry.refuse(f"phi does not read '{name}'", "", did_you_mean(name, _arguments(phi)))
        ends = entry.items()
        if len(ends) != 2:
            entry.refuse(f"has {len(ends)} ends", "", f"write {name} = [low, high]")
        low, high = (end.number(infinite=True) for end in ends)
        if not low < high:
            entry.refuse(f"is [{low}, {high}]", "it is empty", "give the lower end first")
        domain[name] = (low, high)
    return domain


Constants = tuple[float, Basis, tuple[float, ...] | None]


def _constant(node: Node, phi: Graph, domain: Mapping[str, Interval]) -> Constants:
    """The constant, who says so, and those of the components: numbers are assumed, 'derive' has them proved."""
    if isinstance(node.value, str) and node.value != "derive":
        node.refuse(f"is '{node.value}'", "", 'give a number, or "derive" to have it proved on the domain')
    if isinstance(node.value, list):
        items = node.items()
        if len(items) != phi.n_outputs:
            node.refuse(f"has {len(items)} numbers for {phi.n_outputs} formulas", "", "give one number per formula")
        channels = tuple(_not_negative(item) for item in items)
        return combined(channels, phi), "assumed", channels
    if node.value != "derive":
        return _not_negative(node), "assumed", None
    if not phi.inputs["x"]:
        return 0.0, "proved", None  # what reads no state cannot differ between two states
    unbounded = [name for name in _arguments(phi) if not np.all(np.isfinite(domain.get(name, (-np.inf, np.inf))))]
    if unbounded:
        node.refuse(
            f"cannot be derived: phi reads {', '.join(unbounded)}, which the domain does not bound",
            "",
            f"add {unbounded[0]} = [low, high] to nonlinearity.domain",
            "give a number",
        )
    return _derived(node, phi, domain)


def _not_negative(node: Node) -> float:
    value = node.number()
    if value < 0:
        node.refuse(f"is {value}", "", "a Lipschitz constant is not negative")
    return value


def _derived(node: Node, phi: Graph, domain: Mapping[str, Interval]) -> Constants:
    """The bound proved by interval arithmetic, and those of several components each.

    The noun keeps the domain of the states alone.  A bound that leans on intervals of u or t holds under a condition
    that is then not on record, so it is not passed on as proved, nor are those of the components.
    """
    from faultrecon.graph.enclose import lipschitz_bound, lipschitz_per_channel

    # A group that φ does not look at may be anywhere: one point stands for all.
    others = {group: [domain.get(name, (0.0, 0.0)) for name in phi.inputs[group]] for group in ("u", "t")}
    with node.here():
        box = [domain[name] for name in phi.inputs["x"]]
        bound = lipschitz_bound(phi, "x", box, others=others)
        if set(_arguments(phi)) > set(phi.inputs["x"]):
            return bound.value, "assumed", None
        several = lipschitz_per_channel(phi, "x", box, others=others) if phi.n_outputs > 1 else ()
    return bound.value, "proved", tuple(one.value for one in several) or None


def _arguments(phi: Graph) -> tuple[str, ...]:
    """Every state declared as read, and the inputs and the time where a formula uses them."""
    groups = list(phi.inputs)
    used = [(groups[int(node[1])], int(node[2])) for node in phi.nodes if node[0] == "input"]
    others = [phi.inputs[g][i] for g in ("u", "t") for i in range(len(phi.inputs[g])) if (g, i) in used]
    return (*phi.inputs["x"], *others)
