# SPDX-License-Identifier: BSD-3-Clause
"""A plant back from the plain values of `Plant.to_dict`, to the last bit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import KnownTerm, Lipschitz
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.polytopic import Polytopic
from faultrecon.plant.signals import UNLIMITED, Channels, Noise, Signals
from faultrecon.storage.hashing import canonical_digest

_number = float.fromhex


def plant_from_dict(stored: Mapping[str, Any]) -> Plant:
    """The plant that `to_dict` described.  Raises InputError on a part that is missing, malformed or contradictory."""
    try:
        plant = _plant(stored)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("the stored plant is damaged", why=f"{type(error).__name__}: {error}") from error
    if plant.digest() != canonical_digest(stored):
        raise InputError(
            "the stored plant contradicts itself",
            why="its matrices are not those that its channels describe",
            remedies=("make the design again from the plant file",),
        )
    return plant


def _plant(s: Mapping[str, Any]) -> Plant:
    matrices = s["matrices"]
    phi, known, noise, point = s["nonlinearity"], s["known"], s["noise"], s["operating_point"]
    return Plant(
        name=s["name"],
        signals=Signals(*(_channels(s["signals"][g]) for g in ("x", "u", "y"))),
        A=stored_matrix(matrices["A"]),
        B=stored_matrix(matrices["B"]),
        C=stored_matrix(matrices["C"]),
        D=stored_matrix(matrices["D"]),
        faults=tuple(
            FaultChannel(f["name"], _table(f["on"]), f["site"], f["effect"], _number(f["size"]), _number(f["rate"]))
            for f in s["faults"]
        ),
        disturbances=tuple(
            Disturbance(d["name"], _table(d["into"]), _table(d["on"]), d["role"], _number(d["size"]))
            for d in s["disturbances"]
        ),
        nonlinearity=None if phi is None else _lipschitz(phi),
        known=None if known is None else KnownTerm(stored_matrix(known["into"]), Graph.from_dict(known["g"])),
        noise=None if noise is None else Noise(_number(noise["hold"]), tuple(_number(v) for v in noise["sd"])),
        operating_point=OperatingPoint(*(tuple(_number(v) for v in point[g]) for g in ("x", "u", "y"))),
        sample_time=None if s["sample_time"] is None else _number(s["sample_time"]),
        polytopic=Polytopic.from_dict(s["polytopic"]) if "polytopic" in s else None,
    )


def _channels(s: Mapping[str, Any]) -> Channels:
    ranges = tuple(math.nan if r is None else _number(r) for r in s["ranges"])
    limits = {name: (_number(low), _number(high)) for name, (low, high) in s.get("limits", {}).items()}
    names = tuple(s["names"])
    return Channels(names, tuple(s["units"]), ranges, tuple(limits.get(name, UNLIMITED) for name in names))


def _table(s: Mapping[str, str]) -> dict[str, float]:
    return {name: _number(value) for name, value in s.items()}


def stored_matrix(s: Mapping[str, Any]) -> NDArray[np.float64]:
    """A matrix from its shape and hexadecimal entries."""
    rows, columns = s["shape"]
    return np.array([_number(v) for v in s["hex"]], dtype=float).reshape(rows, columns)


def _lipschitz(s: Mapping[str, Any]) -> Lipschitz:
    if s["basis"] not in ("assumed", "proved"):
        raise InputError(f"a Lipschitz constant cannot be '{s['basis']}'")
    return Lipschitz(
        stored_matrix(s["into"]),
        tuple(s["reads"]),
        Graph.from_dict(s["phi"]),
        _number(s["constant"]),
        s["basis"],
        {name: (_number(a), _number(b)) for name, (a, b) in s["domain"].items()},
        tuple(_number(c) for c in s["channels"]) if "channels" in s else None,
    )
