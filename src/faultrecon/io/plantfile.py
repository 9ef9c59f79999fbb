# SPDX-License-Identifier: BSD-3-Clause
"""Read a plant from its TOML file; whatever is wrong in it is named by file, line and key.

The format is version 1 of the plant schema: [signals], [noise], [operating_point], [matrices], [nonlinearity],
[known], [polytopic], [[disturbance]] and [[fault]].  Formulas are parsed, never evaluated.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import did_you_mean
from faultrecon.io.document import Node, document, read_text
from faultrecon.io.formulas import known_term, nonlinearity
from faultrecon.io.polytopic import polytopic
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Noise, Signals

SCHEMA = 1
_REQUIRED = ("schema", "name", "signals", "matrices")
_OPTIONAL = (
    *("source", "sample_time", "noise", "operating_point", "nonlinearity", "known", "polytopic"),
    *("disturbance", "fault"),
)
_GROUPS = ("x", "u", "y")
_KINDS = {"x": "state", "u": "input", "y": "sensor"}
Channel = TypeVar("Channel", FaultChannel, Disturbance)


def read_plant(path: str | os.PathLike[str]) -> Plant:
    """The plant that a TOML file describes.  Raises InputError with file, line and key."""
    return parse_plant(read_text(path), os.fspath(path))


def parse_plant(text: str, source: str = "plant.toml") -> Plant:
    """The plant that a TOML text describes; `source` is the file name that messages begin with."""
    root = document(text, source)
    _check_schema(root)
    top = root.fields(_REQUIRED, _OPTIONAL)
    signals = _signals(top["signals"])
    matrices = _matrices(top["matrices"], signals)
    faults = _channels(top, "fault", lambda node: _fault(node, signals))
    disturbances = _channels(top, "disturbance", lambda node: _disturbance(node, signals))
    _check_unlike([*(top[k] for k in ("fault", "disturbance") if k in top)])
    sample_time = None
    if "sample_time" in top:
        sample_time = top["sample_time"].number()
        if sample_time <= 0:
            top["sample_time"].refuse(f"is {sample_time}", "", "give a positive number of seconds, or leave it out")
    with root.here():
        return Plant(
            name=top["name"].string(),
            signals=signals,
            **matrices,
            faults=faults,
            disturbances=disturbances,
            nonlinearity=nonlinearity(top["nonlinearity"], signals) if "nonlinearity" in top else None,
            known=known_term(top["known"], signals) if "known" in top else None,
            noise=_noise(top["noise"], signals.y) if "noise" in top else None,
            operating_point=_operating_point(top["operating_point"], signals) if "operating_point" in top else None,
            sample_time=sample_time,
            source=top["source"].string() if "source" in top else "",
            polytopic=polytopic(top["polytopic"], signals, faults) if "polytopic" in top else None,
        )


def _check_schema(root: Node) -> None:
    """The file says which version of the format it is written in, and this release reads it."""
    entries = root.table()
    if "schema" not in entries:
        near = did_you_mean("schema", entries) if entries else ""
        misspelt = near if near.startswith("did you mean") else ""
        root.refuse("the key 'schema' is missing", "", misspelt, f"begin the file with: schema = {SCHEMA}")
    node = entries["schema"]
    if isinstance(node.value, bool) or not isinstance(node.value, int) or node.value < 1:
        node.refuse(f"is {node.value!r:.40}", "a schema is a whole number", f"write: schema = {SCHEMA}")
    if node.value > SCHEMA:
        node.refuse(f"is {node.value}", f"this release reads schema {SCHEMA}", "use a newer release of faultrecon")


# ---------------------------------------------------------------- signals


def _signals(node: Node) -> Signals:
    entries = node.fields(("x", "y"), ("u", "range", "limits"))
    texts = {group: entries[group].items() if group in entries else [] for group in _GROUPS}
    names = {group: _names(items) for group, items in texts.items()}
    for group in ("x", "y"):
        if not names[group]:
            entries[group].refuse(f"declares no {_KINDS[group]}", "a plant needs at least one")
    for index, name in enumerate(names["u"]):
        for group in ("x", "y"):
            if name in names[group]:
                texts["u"][index].refuse(f"'{name}' is both an input and a {_KINDS[group]}", "", "rename one of them")
    ranges = _ranges(entries["range"], names) if "range" in entries else {group: {} for group in _GROUPS}
    limits = _limits(entries["limits"], names) if "limits" in entries else {}
    mine = {g: {name: limits[name] for name in names[g] if name in limits and g != "x"} for g in _GROUPS}
    with node.here():
        return Signals(*(Channels.declared([item.value for item in texts[g]], ranges[g], mine[g]) for g in _GROUPS))


def _names(items: Sequence[Node]) -> list[str]:
    """The names of one group, each checked where it stands."""
    names: list[str] = []
    for item in items:
        text = item.string()
        with item.here():
            name = Channels.declared([text]).names[0]
        if name in names:
            item.refuse(f"'{name}' is declared twice", "", "rename one of them")
        if name in ("t", "time"):
            item.refuse(f"'{name}' names the time", "", "rename the signal")
        names.append(name)
    return names


def _ranges(node: Node, names: Mapping[str, Sequence[str]]) -> dict[str, dict[str, float]]:
    """Expected deviations by group: by signal name, or by group and name where x and y share a name."""
    ranges: dict[str, dict[str, float]] = {group: {} for group in _GROUPS}
    for key, entry in node.table().items():
        if key in _GROUPS and isinstance(entry.value, dict):
            for name, value in entry.by_name(names[key], _KINDS[key]).items():
                ranges[key][name] = _positive(value)
            continue
        owners = [group for group in _GROUPS if key in names[group]]
        if not owners:
            everything = [name for group in _GROUPS for name in names[group]]
            entry.refuse(f"there is no signal '{key}'", "", did_you_mean(key, everything))
        for group in owners:
            ranges[group][key] = _positive(entry)
    return ranges


def _limits(node: Node, names: Mapping[str, Sequence[str]]) -> dict[str, tuple[float, float]]:
    """The lowest and highest value that an input or a sensor can take, by name."""
    limits: dict[str, tuple[float, float]] = {}
    for name, pair in node.by_name([*names["u"], *names["y"]], "input or sensor").items():
        ends = [end.number(infinite=True) for end in pair.items()]
        if len(ends) != 2 or not ends[0] < ends[1]:
            pair.refuse(f"is {ends}", "", "give [low, high]; -inf or inf where there is none")
        with pair.here():
            limits[name] = Channels((name,), limits=((ends[0], ends[1]),)).limits[0]
    return limits


def _positive(node: Node) -> float:
    value = node.number()
    if value <= 0:
        node.refuse(f"is {value}", "", "give a positive number")
    return value


def _noise(node: Node, y: Channels) -> Noise:
    entries = node.fields(("hold", "sd"))
    levels = entries["sd"].by_name(y, "sensor")
    for name in y:
        if name not in levels:
            entries["sd"].refuse(f"gives no level for '{name}'", "", f"add {name} = 0.0 if its noise is negligible")
        if levels[name].number() < 0:
            levels[name].refuse(f"is {levels[name].value}", "a standard deviation is not negative")
    return Noise(_positive(entries["hold"]), tuple(levels[name].number() for name in y))


def _operating_point(node: Node, signals: Signals) -> OperatingPoint:
    entries = node.fields((), _GROUPS)
    points = []
    for group in _GROUPS:
        channels = getattr(signals, group)
        given = entries[group].numbers(channels, _KINDS[group]) if group in entries else {}
        points.append(tuple(given.get(name, 0.0) for name in channels))
    return OperatingPoint(*points)


# ---------------------------------------------------------------- matrices


def _matrices(node: Node, signals: Signals) -> dict[str, NDArray[np.float64]]:
    n, m, p = len(signals.x), len(signals.u), len(signals.y)
    entries = node.fields(("A", "B", "C") if m else ("A", "C"), ("D",) if m else ("B", "D"))
    names = {"A": ("x", "x"), "B": ("x", "u"), "D": ("y", "u")}
    shapes = {"A": (n, n), "B": (n, m), "D": (p, m)}
    found = {
        letter: _matrix(entries[letter], shape, names[letter]) if letter in entries else np.zeros(shape)
        for letter, shape in shapes.items()
    }
    chosen = isinstance(entries["C"].value, dict)
    found["C"] = _selection(entries["C"], signals) if chosen else _matrix(entries["C"], (p, n), ("y", "x"))
    return found


def _matrix(node: Node, shape: tuple[int, int], groups: tuple[str, str]) -> NDArray[np.float64]:
    """Rows of numbers; the first row or entry that does not fit is the one named."""
    rows = node.items()
    counts = [f"{count} {_KINDS[group]}{'s' * (count != 1)}" for count, group in zip(shape, groups, strict=True)]
    if not rows and 0 in shape:
        return np.zeros(shape)
    for row in rows:
        width = len(row.items())
        if width != shape[1]:
            row.refuse(f"has {width} entries", f"signals.{groups[1]} declares {counts[1]}", f"give {shape[1]} entries")
    if len(rows) != shape[0]:
        node.refuse(f"has {len(rows)} rows", f"signals.{groups[0]} declares {counts[0]}", f"give {shape[0]} rows")
    return np.array([[entry.number() for entry in row.items()] for row in rows], dtype=float).reshape(shape)


def _selection(node: Node, signals: Signals) -> NDArray[np.float64]:
    """C = { select = [...] }: each sensor reads one state."""
    items = node.fields(("select",))["select"].items()
    C = np.zeros((len(signals.y), len(signals.x)))
    if len(items) != len(signals.y):
        sensors = signals.y.names
        lost = (
            f"'{sensors[len(items)]}' has none" if len(items) < len(sensors) else f"signals.y declares {len(sensors)}"
        )
        node.refuse(f"selects {len(items)} states for {len(sensors)} sensors", lost, "name one state per sensor")
    for row, item in enumerate(items):
        C[row, signals.x.index(item.name(signals.x, "state"))] = 1.0
    return C


# ---------------------------------------------------------------- faults and disturbances


def _channels(top: Mapping[str, Node], key: str, read: Callable[[Node], Channel]) -> tuple[Channel, ...]:
    if key not in top:
        return ()
    if isinstance(top[key].value, dict):
        top[key].refuse("is one table, not a list of them", "", f"write [[{key}]]")
    return tuple(read(node) for node in top[key].items())


def _fault(node: Node, signals: Signals) -> FaultChannel:
    entries = node.fields(("name",), ("sensor", "actuator", "on", "effect", "size", "rate"))
    places = [key for key in ("sensor", "actuator", "on") if key in entries]
    if len(places) != 1:
        what = f"has {' and '.join(places)}" if places else "sits nowhere"
        node.refuse(what, "", "give one of sensor = NAME, actuator = NAME, on = { NAME = coefficient }")
    place = entries[places[0]]
    if places[0] == "on":
        known = [*signals.y, *signals.u]
        on = place.numbers(known, "sensor or input")
        site = "actuator" if on and all(name in signals.u.names for name in on) else "sensor"
        mixed = [name for name in on if (name in signals.u.names) != (site == "actuator")]
        if mixed:
            place.refuse(f"mixes sensors and inputs ('{mixed[0]}')", "", "declare one fault for each")
    else:
        site = "actuator" if places[0] == "actuator" else "sensor"
        on = {place.name(*((signals.u, "input") if site == "actuator" else (signals.y, "sensor"))): 1.0}
    effect = entries["effect"].choice(("additive", "multiplicative")) if "effect" in entries else "additive"
    rate = entries["rate"].number(infinite=True) if "rate" in entries else float("inf")
    if rate <= 0:
        entries["rate"].refuse(f"is {rate}", "", "give a positive number")
    with node.here():
        return FaultChannel(
            _title(entries["name"]),
            on,
            site=site,
            effect="additive" if effect == "additive" else "multiplicative",
            size=_positive(entries["size"]) if "size" in entries else 1.0,
            rate=rate,
        )


def _disturbance(node: Node, signals: Signals) -> Disturbance:
    entries = node.fields(("name",), ("into", "on", "role", "size"))
    into = entries["into"].numbers(signals.x, "state") if "into" in entries else {}
    on = entries["on"].numbers(signals.y, "sensor") if "on" in entries else {}
    role = entries["role"].choice(("attenuate", "decouple", "noise")) if "role" in entries else "attenuate"
    with node.here():
        return Disturbance(
            _title(entries["name"]),
            into,
            on,
            role="decouple" if role == "decouple" else "noise" if role == "noise" else "attenuate",
            size=_positive(entries["size"]) if "size" in entries else 1.0,
        )


def _title(node: Node) -> str:
    if not node.string().strip():
        node.refuse("is empty", "", "give the channel a name")
    return node.string()


def _check_unlike(lists: Sequence[Node]) -> None:
    """No two faults or disturbances share a name; the second one is named."""
    seen: set[str] = set()
    for node in (channel.table()["name"] for several in lists for channel in several.items()):
        if node.string() in seen:
            node.refuse(f"'{node.string()}' names two faults or disturbances", "", "rename one of them")
        seen.add(node.string())
