# SPDX-License-Identifier: BSD-3-Clause
"""The nonlinear part of a plant, G φ(H x, u, t), with the bound that holds for φ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.plant.signals import Channels

Basis = Literal["assumed", "proved"]
SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


@dataclass(frozen=True, eq=False)
class Lipschitz:
    """φ reads a few states and enters a few equations; |φ(a) - φ(b)| <= constant |a - b| on the domain.

    into: (n, m) matrix G.  reads: names of the s states that φ sees, H x.  phi: graph with inputs x (s), u, t.
    constant: with respect to H x in the plant's units.  basis: who says so, "assumed" or "proved".
    domain: interval per state read, absolute; outside it nothing is claimed.
    channels: one constant per component, |φ_i(a) - φ_i(b)| <= channels[i] |a - b| over the states that φ_i reads; None
    where none is known.  A method that has one multiplier for all of φ uses the one constant.
    """

    into: NDArray[np.float64]
    reads: tuple[str, ...]
    phi: Graph
    constant: float
    basis: Basis = "assumed"
    domain: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    channels: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.constant) and self.constant >= 0):
            raise InputError(f"the Lipschitz constant is {self.constant}", why="it is finite and not negative")
        _finite("phi", self.into)
        if self.into.shape[1] != self.phi.n_outputs:
            raise InputError(
                f"phi has {self.phi.n_outputs} components and enters through {self.into.shape[1]} columns",
                remedies=("give one entry of 'into' per component of phi",),
            )
        _check_channels(self.channels, self.phi.n_outputs)
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

    @cached_property
    def sees(self) -> NDArray[np.bool_]:
        """Which component of φ reads which of the states, (m, s)."""
        return states_seen(self.phi)

    @cached_property
    def separate(self) -> bool:
        """Whether each of several components has a constant of its own."""
        return self.channels is not None and len(self.channels) > 1

    def letters(self) -> dict[str, NDArray[np.float64]]:
        """α₁, α₂, ..., (s, s): |φ_i(a) - φ_i(b)| <= |α_i (a - b)|; none where there is one constant for all."""
        if self.channels is None or not self.separate:
            return {}
        return {
            "α" + str(i + 1).translate(SUBSCRIPTS): np.diag(constant * seen)
            for i, (constant, seen) in enumerate(zip(self.channels, self.sees, strict=True))
        }

    def at(self, constant: float) -> Lipschitz:
        """The same with another constant; those of the components change in proportion."""
        share = constant / self.constant if self.constant > 0 else math.nan
        scaled = None if self.channels is None or math.isnan(share) else tuple(share * c for c in self.channels)
        return replace(self, constant=constant, channels=scaled)

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


def states_seen(phi: Graph) -> NDArray[np.bool_]:
    """Which component of φ reads which state, (m, s)."""
    seen, at = np.zeros((phi.n_outputs, len(phi.inputs["x"])), dtype=bool), list(phi.inputs).index("x")
    for i in range(phi.n_outputs):
        for node in phi.channel(i).nodes:
            if node[0] == "input" and node[1] == at:
                seen[i, int(node[2])] = True
    return seen


def combined(channels: Sequence[float], phi: Graph) -> float:
    """A constant for all of φ from those of its components, rounded up.

    |φ(a) - φ(b)|² is at most the sum over states of what each moves: for each, the squares of those that read it.
    """
    totals = [0.0]
    for column in states_seen(phi).T:
        readers = [c for c, sees in zip(channels, column, strict=True) if sees and c > 0]
        # hypot errs by less than the last digit, and not at all for one number.
        totals.append(math.hypot(*readers) if len(readers) < 2 else math.nextafter(math.hypot(*readers), math.inf))
    return max(totals)


def _check_channels(channels: tuple[float, ...] | None, width: int) -> None:
    if channels is None:
        return
    if len(channels) != width:
        raise InputError(
            f"{len(channels)} Lipschitz constants are given for {width} components of phi",
            remedies=("give one number for all, or one per component",),
        )
    for constant in channels:
        if not (math.isfinite(constant) and constant >= 0):
            raise InputError(f"a Lipschitz constant is {constant}", why="it is finite and not negative")


def _finite(owner: str, into: NDArray[np.float64]) -> None:
    if not np.all(np.isfinite(into)):
        raise InputError(f"{owner} enters an equation with a coefficient that is not finite")


def used_names(texts: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Which of `names` occur in the formulas, in the order of `names`."""
    import re

    # The lookbehind keeps the exponent of a number such as 1e3 from counting as a name.
    words = {word for text in texts for word in re.findall(r"(?<![\w.])[A-Za-z_]\w*", text)}
    return tuple(name for name in names if name in words)
