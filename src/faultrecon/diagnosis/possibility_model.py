# SPDX-License-Identifier: BSD-3-Clause
"""The equations of a plant with its faults as constants and with every number that could be wrong as a symbol.

    ẋ = f(x, u, faults, p, t),   y_i = (1 + F f)_i h_i(x, u)      p: relative changes of the plant's numbers, zero

Additive sensor faults add to y, actuator faults to u (or scale it).  With a sample time the left side is the next
state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]
Kind = Literal["constant", "entry", "input", "sensor"]
MOST_ENTRIES = 16
"""Entries of A and B that are looked at one by one, the strongest first: a table that somebody reads."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number of the plant that may be wrong by a percentage.

    kind: a "constant" of φ, an "entry" of A or B, the scale of an "input" as recorded, the gain of a healthy "sensor".
    """

    name: str
    kind: Kind
    index: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Equations:
    """A plant, and which of its numbers are symbols."""

    plant: Plant
    parameters: tuple[Parameter, ...]

    @staticmethod
    @lru_cache(maxsize=8)
    def of(plant: Plant) -> Equations:
        """Every constant of φ, every entry of A and B, the scale of inputs, the gain of sensors that stay healthy."""
        found = [Parameter(name, "constant") for name, value in _constants(plant).items() if value]
        found += _entries(plant)
        found += [Parameter(f"{name} as recorded", "input", (i,)) for i, name in enumerate(plant.signals.u)]
        reached = {name for f in plant.faults if f.site == "sensor" for name, c in f.on.items() if c}
        found += [
            Parameter(f"gain of {name}", "sensor", (i,))
            for i, name in enumerate(plant.signals.y)
            if name not in reached
        ]
        return Equations(plant, tuple(found))

    @property
    def q(self) -> int:
        """How many faults."""
        return len(self.plant.faults)

    def sx(self) -> dict[str, Any]:
        """Fresh symbols x, u, f, p, t."""
        import casadi as ca

        sizes = {"x": self.plant.n, "u": len(self.plant.signals.u), "f": self.q, "p": len(self.parameters), "t": 1}
        return {name: ca.SX.sym(name, size) for name, size in sizes.items()}

    def right(self, x: Any, u: Any, f: Any, p: Any, t: Any) -> Any:
        """ẋ, or the next state, (n, 1)."""
        import casadi as ca

        plant, (x0, u0) = self.plant, (ca.DM(self.plant.point.x), ca.DM(self.plant.point.u))
        m = len(plant.signals.u)
        u = self._reaching(u, f, p)
        A, B = ca.SX(ca.DM(plant.A)), ca.SX(ca.DM(plant.B)) if m else None
        for k, one in enumerate(self.parameters):
            if one.kind == "entry":
                i, j = one.index
                if j < plant.n:
                    A[i, j] = A[i, j] * (1 + p[k])
                elif B is not None:
                    B[i, j - plant.n] = B[i, j - plant.n] * (1 + p[k])
        out = A @ (x - x0) + (x0 if plant.sample_time is not None else 0)
        if B is not None:
            out = out + B @ (u - u0)
        if plant.nonlinearity is not None:
            out = out + ca.DM(plant.nonlinearity.into) @ self._phi(x, u, p, t)
        if plant.known is not None:
            out = out + ca.DM(plant.known.into) @ self._known(x, u, t)
        return ca.densify(out)

    def healthy(self, x: Any, u: Any) -> Any:
        """h (p, 1): what sensors without fault show."""
        import casadi as ca

        plant = self.plant
        out = ca.DM(plant.point.y) + ca.DM(plant.C) @ (x - ca.DM(plant.point.x))
        if len(plant.signals.u):
            out = out + ca.DM(plant.D) @ (u - ca.DM(plant.point.u))
        return ca.densify(ca.SX(out))

    def shown(self, x: Any, u: Any, f: Any, p: Any) -> Any:
        """y (p, 1): what the sensors show, faults included."""
        import casadi as ca

        h = self.healthy(x, self._reaching(u, f, p))
        scaled, added = self.scaling, self.adding
        y = h * (1 + ca.DM(scaled) @ f) + ca.DM(added) @ f
        for k, one in enumerate(self.parameters):
            if one.kind == "sensor":
                y[one.index[0]] = y[one.index[0]] * (1 + p[k])
        return y

    @cached_property
    def scaling(self) -> Array:
        """F (p, q) of the faults that multiply."""
        return self.plant.F_f * np.array([f.effect == "multiplicative" for f in self.plant.faults])

    @cached_property
    def adding(self) -> Array:
        """F (p, q) of the faults that add."""
        return self.plant.F_f - self.scaling

    def _reaching(self, u: Any, f: Any, p: Any) -> Any:
        """What the inputs really do: as recorded, times its scale, with the actuator faults."""
        import casadi as ca

        out = ca.SX(u)
        for k, one in enumerate(self.parameters):
            if one.kind == "input":
                out[one.index[0]] = out[one.index[0]] * (1 + p[k])
        meant = ca.SX(out)
        for j, fault in enumerate(self.plant.faults):
            for name, coefficient in fault.on.items() if fault.site == "actuator" else ():
                i = self.plant.signals.u.index(name)
                out[i] = out[i] + coefficient * f[j] * (meant[i] if fault.effect == "multiplicative" else 1)
        return out

    def _phi(self, x: Any, u: Any, p: Any, t: Any) -> Any:
        import casadi as ca

        term = self.plant.nonlinearity
        assert term is not None
        names = [one.name for one in self.parameters if one.kind == "constant"]
        read = ca.DM(self.plant.H) @ x
        if not names:
            return term.phi.symbolic(read, u, t)
        places = [k for k, one in enumerate(self.parameters) if one.kind == "constant"]
        values = [term.phi.constants[name] * (1 + p[k]) for name, k in zip(names, places, strict=True)]
        return _opened(term.phi, tuple(names)).symbolic(read, u, t, ca.vertcat(*values))

    def _known(self, x: Any, u: Any, t: Any) -> Any:
        known = self.plant.known
        assert known is not None
        given = {"y": self.healthy(x, u), "u": u, "t": t}
        return known.g.symbolic(*(given[name] for name in known.g.inputs))


def _constants(plant: Plant) -> Mapping[str, float]:
    """The named numbers in φ; none where φ was not written as text, or where one has to be a number (an exponent)."""
    term = plant.nonlinearity
    if term is None or not term.phi.texts:
        return {}
    try:
        _opened(term.phi, tuple(name for name, value in term.phi.constants.items() if value))
    except InputError:
        return {}
    return term.phi.constants


@lru_cache(maxsize=8)
def _opened(phi: Graph, names: tuple[str, ...]) -> Graph:
    """φ with these constants as a further input."""
    others = {k: v for k, v in phi.constants.items() if k not in names}
    return Graph.from_texts(phi.texts, {**phi.inputs, "constants": names}, others)


def _entries(plant: Plant) -> list[Parameter]:
    """The entries of A and B that are not zero, the strongest first where there are many."""
    M, m = np.hstack([plant.A, plant.B]), len(plant.signals.u)
    unit = units(plant)
    reach = np.array([1.0 if np.isnan(r) else r for r in plant.signals.u.ranges]).reshape(m)
    strength = np.abs(M) * np.concatenate([unit, reach]) / unit[:, None]
    places = [(int(i), int(j)) for i, j in np.argwhere(strength > 0)]
    places = sorted(places, key=lambda at: -strength[at])[:MOST_ENTRIES]
    x, u = plant.signals.x.names, plant.signals.u.names
    named = {(i, j): f"A[{x[i]}, {x[j]}]" if j < plant.n else f"B[{x[i]}, {u[j - plant.n]}]" for i, j in places}
    return [Parameter(named[at], "entry", at) for at in sorted(places)]


def units(plant: Plant) -> Array:
    """What counts as one of each state: its range, else how wide its box or domain is, else its value, else one."""
    form, term = plant.polytopic, plant.nonlinearity
    boxes = {**({} if term is None else term.domain), **({} if form is None else form.box)}
    found = []
    for name, reach, value in zip(plant.signals.x, plant.signals.x.ranges, plant.point.x, strict=True):
        low, high = boxes.get(name, (np.nan, np.nan))
        choices = [reach, 0.5 * (high - low), abs(value) or np.nan, 1.0]
        found.append(next(c for c in choices if np.isfinite(c)))
    return np.array(found)
