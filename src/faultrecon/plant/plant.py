# SPDX-License-Identifier: BSD-3-Clause
"""The plant: one description from which every method reads.

    ẋ = A x + B u + G φ(H x, u, t) + g(y, u, t) + E_w w + E_f f_a
    y = C x + D u + F_w w + F_f f_s

A, B, C, D act on deviations from the operating point; φ and g read absolute values.  With a sample time the left side
is the next state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import KnownTerm, Lipschitz
from faultrecon.plant.polytopic import Polytopic
from faultrecon.plant.signals import Noise, Signals
from faultrecon.storage.hashing import canonical_digest

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """Absolute values of x, u and y about which the matrices act."""

    x: tuple[float, ...]
    u: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Plant:
    """A frozen plant.  Shapes: A (n, n), B (n, m), C (p, n), D (p, m); q faults, l disturbances.

    Raises InputError on shapes that do not fit, on entries that are not finite, and on names nobody declared.
    """

    name: str
    signals: Signals
    A: Array
    B: Array
    C: Array
    D: Array
    faults: tuple[FaultChannel, ...] = ()
    disturbances: tuple[Disturbance, ...] = ()
    nonlinearity: Lipschitz | None = None
    known: KnownTerm | None = None
    noise: Noise | None = None
    operating_point: OperatingPoint | None = None
    sample_time: float | None = None
    source: str = field(default="", compare=False)
    polytopic: Polytopic | None = None

    def __post_init__(self) -> None:
        n, m, p = len(self.signals.x), len(self.signals.u), len(self.signals.y)
        for letter, shape in {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}.items():
            object.__setattr__(self, letter, _matrix(letter, getattr(self, letter), shape))
        if n == 0 or p == 0:
            raise InputError(f"{self.name or 'the plant'} has {n} states and {p} measurements", why="it needs both")
        if self.sample_time is not None and not (math.isfinite(self.sample_time) and self.sample_time > 0):
            raise InputError(f"the sample time is {self.sample_time}", why="it is a positive number of seconds")
        point = self.operating_point or OperatingPoint((0.0,) * n, (0.0,) * m, (0.0,) * p)
        for group, size in (("x", n), ("u", m), ("y", p)):
            values = getattr(point, group)
            if len(values) != size or not all(math.isfinite(v) for v in values):
                raise InputError(f"operating_point.{group} is {values}", why=f"it takes {size} finite numbers")
        object.__setattr__(self, "operating_point", point)
        if self.noise is not None and len(self.noise.sd) != p:
            raise InputError(f"{len(self.noise.sd)} noise levels are given for {p} sensors")
        for owner, into in (("phi", self.nonlinearity), ("g", self.known)):
            if into is not None and into.into.shape[0] != n:
                raise InputError(f"{owner} enters {into.into.shape[0]} equations", why=f"there are {n} states")
        if self.polytopic is not None:
            _check_form(self.polytopic, self.signals)
        names = [c.name for c in (*self.faults, *self.disturbances)]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"'{name}' names two faults or disturbances")
        _ = self.F_f, self.E_f, self.E_w, self.F_w  # every channel names existing signals, or this raises

    # ------------------------------------------------------------ sizes and matrices

    @property
    def n(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    @property
    def p(self) -> int:
        """Number of measurements."""
        return self.C.shape[0]

    @property
    def point(self) -> OperatingPoint:
        """The operating point, zero when none was declared."""
        assert self.operating_point is not None
        return self.operating_point

    @cached_property
    def F_f(self) -> Array:
        """Sensor faults into the measurements, (p, q); an actuator fault has a zero column."""
        return _columns(self.signals.y, [f.on if f.site == "sensor" else {} for f in self.faults])

    @cached_property
    def E_f(self) -> Array:
        """Actuator faults into the states, (n, q): the column of B, signed; a sensor fault has a zero column."""
        on_inputs = _columns(self.signals.u, [f.on if f.site == "actuator" else {} for f in self.faults])
        return self.B @ on_inputs

    @cached_property
    def attenuated(self) -> tuple[Disturbance, ...]:
        """The disturbances that a level γ counts: every role except noise."""
        return tuple(d for d in self.disturbances if d.role != "noise")

    @cached_property
    def E_w(self) -> Array:
        """Counted disturbances into the states, (n, l), per physical unit."""
        return _columns(self.signals.x, [d.into for d in self.attenuated])

    @cached_property
    def F_w(self) -> Array:
        """Counted disturbances onto the measurements, (p, l), per physical unit."""
        return _columns(self.signals.y, [d.on for d in self.attenuated])

    @cached_property
    def G(self) -> Array:
        """The nonlinear terms into the states, (n, r); no columns for a linear plant."""
        return np.zeros((self.n, 0)) if self.nonlinearity is None else self.nonlinearity.into

    @cached_property
    def H(self) -> Array:
        """What the nonlinear terms read, (s, n); no rows for a linear plant."""
        if self.nonlinearity is None:
            return np.zeros((0, self.n))
        return self.nonlinearity.selection(self.signals.x)

    def letters(self) -> dict[str, Array]:
        """Every matrix of the plant by its letter; W and V are diagonal: size of each counted disturbance, 1/size of
        each fault; α is the Lipschitz constant (1, 1), α₁, α₂, ... (s, s) those of the components of φ, where known."""
        return {
            **{k: getattr(self, k) for k in ("A", "B", "C", "D", "E_w", "F_w", "E_f", "F_f", "G", "H")},
            "W": np.diag([d.size for d in self.attenuated]).reshape(2 * (len(self.attenuated),)),
            "V": np.diag([1.0 / f.size for f in self.faults]).reshape(2 * (len(self.faults),)),
            "α": np.array([[0.0 if self.nonlinearity is None else self.nonlinearity.constant]]),
            **({} if self.nonlinearity is None else self.nonlinearity.letters()),
        }

    # ------------------------------------------------------------ derived plants

    def with_faults(self, names: Sequence[str]) -> Plant:
        """The same plant with only the named faults; the others are taken to be healthy."""
        from faultrecon.finding import did_you_mean

        by_name = {f.name: f for f in self.faults}
        for name in names:
            if name not in by_name:
                raise InputError(f"there is no fault '{name}'", why=did_you_mean(name, by_name))
            if list(names).count(name) > 1:
                raise InputError(f"the fault '{name}' is asked for twice")
        return replace(self, faults=tuple(by_name[name] for name in names))

    def reading_all_states(self) -> Plant:
        """The same plant with φ declared to read the whole state: the structure is given away."""
        if self.nonlinearity is None:
            return self
        from faultrecon.graph.function import Graph

        old, names = self.nonlinearity, self.signals.x.names
        index = [names.index(name) for name in old.reads]
        sizes = {"x": self.n, "u": len(self.signals.u), "t": 1}
        phi = Graph.trace(lambda x, u, t: old.phi.symbolic(x[index], u, t), sizes)
        phi = replace(phi, inputs={"x": names, "u": self.signals.u.names, "t": ("t",)})
        return replace(self, nonlinearity=replace(old, reads=names, phi=phi, channels=None))

    # ------------------------------------------------------------ other people's systems

    @staticmethod
    def from_control(system: Any, **declared: Any) -> Plant:
        """A plant from a python-control system; see `interop.plant_from_control`."""
        from faultrecon.plant.interop import plant_from_control

        return plant_from_control(system, **declared)

    @staticmethod
    def from_scipy(system: Any, **declared: Any) -> Plant:
        """A plant from a scipy.signal system or (A, B, C, D[, dt]); see `interop.plant_from_scipy`."""
        from faultrecon.plant.interop import plant_from_scipy

        return plant_from_scipy(system, **declared)

    def to_control(self, **options: Any) -> Any:
        """A control.StateSpace; see `interop.plant_to_control`."""
        from faultrecon.plant.interop import plant_to_control

        return plant_to_control(self, **options)

    def to_scipy(self, **options: Any) -> Any:
        """A scipy.signal.StateSpace; see `interop.plant_to_scipy`."""
        from faultrecon.plant.interop import plant_to_scipy

        return plant_to_scipy(self, **options)

    # ------------------------------------------------------------ identity

    def to_dict(self) -> dict[str, Any]:
        """Everything the plant is, as plain values; numbers as hexadecimal floats, so that nothing is rounded."""
        return {
            "name": self.name,
            "signals": {g: _group(getattr(self.signals, g)) for g in ("x", "u", "y")},
            "matrices": {k: exact_matrix(v) for k, v in self.letters().items()},
            "faults": [
                {"name": f.name, "on": _hexed(f.on), "site": f.site, "effect": f.effect}
                | {"size": float(f.size).hex(), "rate": float(f.rate).hex()}
                for f in self.faults
            ],
            "disturbances": [
                {"name": d.name, "into": _hexed(d.into), "on": _hexed(d.on), "role": d.role}
                | {"size": float(d.size).hex()}
                for d in self.disturbances
            ],
            "nonlinearity": None if self.nonlinearity is None else _phi(self.nonlinearity),
            "known": None
            if self.known is None
            else {"into": exact_matrix(self.known.into), "g": self.known.g.to_dict()},
            "noise": None
            if self.noise is None
            else {"hold": float(self.noise.hold).hex(), "sd": [float(s).hex() for s in self.noise.sd]},
            "operating_point": {g: [float(v).hex() for v in getattr(self.point, g)] for g in ("x", "u", "y")},
            "sample_time": None if self.sample_time is None else float(self.sample_time).hex(),
            **({} if self.polytopic is None else {"polytopic": self.polytopic.to_dict()}),
        }

    def digest(self) -> str:
        """SHA-256 of `to_dict`: two plants with the same digest are the same plant to the last bit."""
        return canonical_digest(self.to_dict())

    def __repr__(self) -> str:
        kind = "polytopic" if self.polytopic else "Lipschitz" if self.nonlinearity is not None else "linear"
        faults = ", ".join(f.name for f in self.faults) or "no fault declared"
        return (
            f"Plant({self.name!r}: {kind}, {self.n} states, {len(self.signals.u)} inputs, {self.p} sensors; "
            f"faults: {faults})"
        )


def _matrix(letter: str, value: Any, shape: tuple[int, int]) -> Array:
    array = np.array(value, dtype=float)
    if array.size == 0:
        array = array.reshape(shape) if 0 in shape else array
    if array.shape != shape:
        raise InputError(f"matrices.{letter} is {array.shape}", why=f"the declared signals ask for {shape}")
    if not np.all(np.isfinite(array)):
        i, j = (int(k) for k in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"matrices.{letter}[{i}][{j}] is {array[i, j]}", why="every entry must be a finite number")
    array.setflags(write=False)
    return array


def _check_form(form: Polytopic, signals: Signals) -> None:
    """The polytopic form speaks of these signals."""
    n, m = len(signals.x), len(signals.u)
    for family, shape in ((form.sector, (n, n + m)), (form.slope, (n, n))):
        if family is None:
            continue
        if family.shape != shape:
            raise InputError(f"polytopic.{family.letter} is {family.shape}", why=f"the signals ask for {shape}")
        known = {"x": signals.x.names, "u": signals.u.names}
        if dict(family.premises.inputs) != known:
            raise InputError(f"the premises read {dict(family.premises.inputs)}", why=f"the signals are {known}")


def _columns(signals: Any, tables: Sequence[Any]) -> Array:
    out = np.zeros((len(signals), len(tables)))
    for j, table in enumerate(tables):
        for name, coefficient in table.items():
            out[signals.index(name), j] = coefficient
    out.setflags(write=False)
    return out


def exact_matrix(value: Array) -> dict[str, Any]:
    """A float matrix as its shape and hexadecimal entries, row by row."""
    return {"shape": list(value.shape), "hex": [float(v).hex() for v in value.ravel()]}


def _hexed(table: Any) -> dict[str, str]:
    return {name: float(v).hex() for name, v in table.items()}


def _group(group: Any) -> dict[str, Any]:
    ranges = [None if math.isnan(r) else float(r).hex() for r in group.ranges]
    limits = {name: [float(v).hex() for v in pair] for name, pair in group.limited().items()}
    told = {"limits": limits} if limits else {}  # absent where there are none: plants of before keep their digest
    return {"names": list(group.names), "units": list(group.units), "ranges": ranges} | told


def _phi(term: Lipschitz) -> dict[str, Any]:
    return {
        "into": exact_matrix(term.into),
        "reads": list(term.reads),
        "phi": term.phi.to_dict(),
        "constant": float(term.constant).hex(),
        "basis": term.basis,
        "domain": {k: [float(v[0]).hex(), float(v[1]).hex()] for k, v in term.domain.items()},
        **({} if term.channels is None else {"channels": [float(c).hex() for c in term.channels]}),
    }
