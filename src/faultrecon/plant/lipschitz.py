# SPDX-License-Identifier: BSD-3-Clause
"""The nonlinear part of a plant, G φ(H x, u, t), with the bound that holds for φ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.plant.signals import Channels

Basis = Literal["assumed", "proved"]


@dataclass(frozen=True, eq=False)
class Lipschitz:
    """φ reads a few states and enters a few equations; |φ(a) - φ(b)| <= constant |a - b| on the domain.

    into: (n, m) matrix G.  reads: names of the s states that φ sees, H x.  phi: graph with inputs x (s), u, t.
    constant: with respect to H x in the plant's units.  basis: who says so, "assumed" or "proved".
    domain: interval per state read, absolute; outside it nothing is claimed.
    """

    into: NDArray[np.float64]
    reads: tuple[str, ...]
    phi: Graph
    constant: float
    basis: Basis = "assumed"
    domain: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.constant) and self.constant >= 0):
            raise InputError(f"the Lipschitz constant is {self.constant}", why="it is finite and not negative")
        _finite("phi", self.into)
        if self.into.shape[1] != self.phi.n_outputs:
            raise InputError(
                f"phi has {self.phi.n_outputs} components and enters through {self.into.shape[1]} columns",
                remedies=("give one entry of 'into' per component of phi",),
            )
        if self.phi.inputs["x"] != self.reads:
            raise InputError(f"phi reads {self.phi.inputs['x']}", why=f"its declared states are {self.reads}")
        for name, (low, high) in self.domain.items():
            if name not in self.reads:
                raise InputError(f"the domain bounds {name}", why=f"phi reads {', '.join(self.reads)} only")
            if not low < high:
                raise InputError(f"the domain of {name} is [{low}, {high}]", why="it is empty")

    @cached_property
    def limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper end of the domain per state read, infinite where none is declared: two (s,) arrays."""
        ends = [self.domain.get(name, (-math.inf, math.inf)) for name in self.reads]
        return np.array([e[0] for e in ends]), np.array([e[1] for e in ends])

    def selection(self, states: Channels) -> NDArray[np.float64]:
        """The (s, n) matrix H that picks the states read."""
        H = np.zeros((len(self.reads), len(states)))
        for row, name in enumerate(self.reads):
            H[row, states.index(name)] = 1.0
        return H


@dataclass(frozen=True, eq=False)
class KnownTerm:
    """The term g(y, u, t) that the observer can copy, through the (n, k) matrix `into`; it reads absolute values."""

    into: NDArray[np.float64]
    g: Graph

    def __post_init__(self) -> None:
        _finite("g", self.into)
        if self.into.shape[1] != self.g.n_outputs:
            raise InputError(f"g has {self.g.n_outputs} components and enters through {self.into.shape[1]} columns")


def _finite(owner: str, into: NDArray[np.float64]) -> None:
    if not np.all(np.isfinite(into)):
        raise InputError(f"{owner} enters an equation with a coefficient that is not finite")


def used_names(texts: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Which of `names` occur in the formulas, in the order of `names`."""
    import re

    # The lookbehind keeps the exponent of a number such as 1e3 from counting as a name.
    words = {word for text in texts for word in re.findall(r"(?<![\w.])[A-Za-z_]\w*", text)}
    return tuple(name for name in names if name in words)
