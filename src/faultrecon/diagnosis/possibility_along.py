# SPDX-License-Identifier: BSD-3-Clause
"""What the measurements along one trajectory can tell about faults that hardly move while they are watched.

The state at the start and the faults are unknown, the model is exact: every sensor's reading is followed to first order
in both, and in every number of the plant.  Between samples inputs run in straight lines; with a sample time they are
held.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.diagnosis.possibility_model import Equations, Parameter, units
from faultrecon.finding import Inconclusive, InputError
from faultrecon.numerics.information import biases, indistinguishable, least_deviations, norms_of_products
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

REACH = 0.1
"""Largest |mode| h of a Runge-Kutta step: its remainder (|mode| h)^5/120 is then 1e-7."""
MOST_STEPS = 1000
"""Steps between two samples: more means that the samples are no trajectory of this plant."""
LOOKED_AT = 200
"""Points of a trajectory at which its modes are computed."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Times (N,), inputs (N, m) and states (N, n), absolute: where the plant went, or is expected to go."""

    t: Array
    u: Array
    x: Array

    @staticmethod
    def of(plant: Plant, given: Any) -> Trajectory:
        """From anything with t, u and x (a run, a truth, a table by these names, a triple); checked.

        Without x the model runs from the operating point under the inputs.  Raises InputError, Inconclusive.
        """
        if isinstance(given, Trajectory):
            return given
        t, u, x = (_part(given, name, k) for k, name in enumerate(("t", "u", "x")))
        if t is None or u is None:
            raise InputError("a trajectory has times t, inputs u and states x", remedies=("give a run, or (t, u, x)",))
        n, m = plant.n, len(plant.signals.u)
        t = np.asarray(t, dtype=float)
        u = np.asarray(u, dtype=float).reshape(len(t), -1) if m else np.zeros((len(t), 0))
        if t.ndim != 1 or len(t) < 2 or not np.isfinite(t).all() or np.any(np.diff(t) <= 0):
            raise InputError("the times of a trajectory are not strictly increasing", why="two are the least")
        x = model_run(plant, t, u) if x is None else np.asarray(x, dtype=float).reshape(len(t), -1)
        if u.shape[1] != m or x.shape[1] != n:
            raise InputError(f"the trajectory has {u.shape[1]} inputs and {x.shape[1]} states, the plant {m} and {n}")
        if not (np.isfinite(u).all() and np.isfinite(x).all()):
            raise InputError("the trajectory has values that are not finite", remedies=("cut the gaps out",))
        return Trajectory(t, u, x)


@dataclass(frozen=True, slots=True)
class Window:
    """From `start`, `length` long: the least standard deviation of each fault, by name; inf where none can be had."""

    start: float
    length: float
    deviation: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Contraction:
    """How a first-order error of the initial state fares without any correction, states in their ranges.

    peak: the largest factor by which it grows.  left: what is left of it at the end.  rate: -ln(left) over the time,
    per unit of time; positive where the model forgets.
    """

    start: float
    length: float
    peak: float
    left: float
    rate: float

    @property
    def forgets(self) -> bool:
        """Whether an error is smaller at the end than at the start, by a factor of e at least."""
        return self.left <= math.exp(-1.0)


@dataclass(frozen=True, eq=False)
class Course:
    """A plant along a trajectory: how each step and each reading changes with state, faults and numbers.

    rate: samples of the sensors per sample of the trajectory, where that was thinned out.
    """

    equations: Equations
    path: Trajectory
    rate: float = 1.0

    @property
    def plant(self) -> Plant:
        """The plant."""
        return self.equations.plant

    @cached_property
    def steps(self) -> tuple[Array, Array]:
        """∂x(k+1)/∂x(k), (N-1, n, n), and by faults and numbers, (N-1, n, q + l)."""
        return _stepped(self.equations, self.path)[1:]

    @cached_property
    def readings(self) -> tuple[Array, Array, Array]:
        """h (N, p), ∂y/∂x (N, p, n), ∂y/∂(faults, numbers) (N, p, q + l)."""
        function, N = _reading(self.equations), len(self.path.t)
        h, by_x, by_z = (np.array(part) for part in function(self.path.x.T, self.path.u.T))
        n, p, width = self.plant.n, self.plant.p, self.equations.q + len(self.equations.parameters)
        return h.T, _blocks(by_x, N, p, n), _blocks(by_z, N, p, width)

    def sensitivity(self, start: float, length: float, every: float) -> tuple[Array, Array, Array, Array]:
        """Readings in a window, in units of their noise, by the state at its start, the faults, and the numbers.

        Samples every so often, both ends included: their times (K,), then (K, p, n), (K, p, q), (K, p, l); the state
        in its units.
        """
        t, n, q = self.path.t, self.plant.n, self.equations.q
        first = int(np.argmin(np.abs(t - start)))
        count = math.floor(length / every + 1e-9)
        wanted = t[first] + every * np.arange(count + 1)
        after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
        picked = np.unique(np.where(wanted - t[after - 1] < t[after] - wanted, after - 1, after))
        picked = np.unique(np.maximum(picked, first))
        F, G = self.steps
        _, by_x, by_z = self.readings
        S, k, rows = np.hstack([np.eye(n), np.zeros((n, by_z.shape[2]))]), first, []
        for i in map(int, picked):
            for step in range(k, i):
                S = F[step] @ S
                S[:, n:] += G[step]
            k = i
            rows.append(S)
        J = by_x[picked] @ np.array(rows)
        J[:, :, n:] += by_z[picked]
        J = J / self._noise[:, None]
        return t[picked], J[:, :, :n] * units(self.plant), J[:, :, n : n + q], J[:, :, n + q :]

    def windows(self, wanted: Sequence[tuple[float, float]], every: float) -> tuple[Window, ...]:
        """The least deviations of constant faults from each window (start, length); those of one start at once."""
        names, found = [f.name for f in self.plant.faults], {}
        for start in dict.fromkeys(start for start, _ in wanted):
            lengths = [length for begun, length in wanted if begun == start]
            t, Jx, Jf, _ = self.sensitivity(start, max(lengths), every)
            J = np.concatenate([Jx, Jf], axis=2)
            for length in lengths:
                inside = t <= t[0] + length + 0.5 * every
                least = least_deviations(J[inside].reshape(-1, J.shape[2]))[self.plant.n :]
                deviation = dict(zip(names, map(float, least), strict=True))
                found[start, length] = Window(start, length, deviation)
        return tuple(found[pair] for pair in wanted)

    def budget(self, start: float, length: float, every: float) -> tuple[Array, list[list[dict[int, float]]]]:
        """Error of the faults per relative error of each number, (q, l), and the exact gauges of each fault.

        A number's error is what the truth is higher than the model.  A gauge: relative changes of numbers that do to
        the readings what a change of the fault by one undoes, whatever the initial state.
        """
        _, *parts = self.sensitivity(start, length, every)
        Jx, Jf, Jp = (part.reshape(-1, part.shape[2]) for part in parts)
        off = biases(np.hstack([Jx, Jf]), Jp)[self.plant.n :]
        gauges = [
            indistinguishable(np.hstack([Jx, np.delete(Jf, j, axis=1)]), Jf[:, j], Jp) for j in range(Jf.shape[1])
        ]
        return off, gauges

    def contraction(self, start: float | None = None, length: float | None = None) -> Contraction:
        """What an error of the initial state becomes where nothing corrects the model."""
        t = self.path.t
        first = 0 if start is None else int(np.argmin(np.abs(t - start)))
        last = len(t) - 1 if length is None else int(np.argmin(np.abs(t - t[first] - length)))
        scale = units(self.plant)
        logs = norms_of_products(self.steps[0][first:last] * scale / scale[:, None])
        span = float(t[last] - t[first])
        end = float(logs[-1]) if logs.size else 0.0
        peak = math.exp(min(max(0.0, float(logs.max(initial=0.0))), 700.0))
        return Contraction(float(t[first]), span, peak, math.exp(min(end, 700.0)), -end / span if span else 0.0)

    @property
    def _noise(self) -> Array:
        """The deviation of one sample of the trajectory, (p,); one where none is declared."""
        noise = self.plant.noise
        sd = np.ones(self.plant.p) if noise is None or not all(noise.sd) else np.array(noise.sd)
        return sd / math.sqrt(self.rate)


def model_run(plant: Plant, t: ArrayLike, u: ArrayLike, x0: ArrayLike | None = None) -> Array:
    """The states (N, n) of the model under inputs (N, m), from the operating point unless told otherwise."""
    t, u = np.asarray(t, dtype=float), np.asarray(u, dtype=float)
    equations = Equations.of(plant)
    start = np.array(plant.point.x if x0 is None else x0, dtype=float)
    function = _next(equations)
    pieces = _pieces(equations, t, u, np.tile(start, (len(t), 1)))
    out = np.empty((len(t), plant.n))
    out[0] = start
    for k in range(len(t) - 1):
        x = out[k]
        for j in range(pieces):
            x = np.array(function(x, *_piece(t[k : k + 2], u[k : k + 2], j, pieces))).ravel()
        out[k + 1] = x
    if not np.isfinite(out).all():
        raise Inconclusive(
            f"the model of {plant.name} diverges from its operating point under these inputs",
            why="nothing corrects it",
            remedies=("give the states x of the trajectory",),
        )
    return out


# ---------------------------------------------------------------- steps


def _stepped(equations: Equations, path: Trajectory) -> tuple[Array, Array, Array]:
    """Next states (N-1, n) and their derivatives by state, and by faults and numbers."""
    n, N = equations.plant.n, len(path.t) - 1
    width = equations.q + len(equations.parameters)
    function, pieces = _step(equations), _pieces(equations, path.t, path.u, path.x)
    x, F, G = path.x[:-1], np.tile(np.eye(n), (N, 1, 1)), np.zeros((N, n, width))
    for j in range(pieces):
        x1, by_x, by_z = (np.array(p) for p in function(x.T, *_piece(path.t, path.u, j, pieces)))
        one = _blocks(by_x, N, n, n)
        x, F, G = x1.T, one @ F, one @ G + _blocks(by_z, N, n, width)
    if not (np.isfinite(F).all() and np.isfinite(G).all()):
        raise Inconclusive(
            f"the equations of {equations.plant.name} have no finite slope along this trajectory",
            why="a formula is undefined, or has a corner, where it goes",
            remedies=("keep to where the equations hold",),
        )
    return x, F, G


def _piece(t: Array, u: Array, j: int, pieces: int) -> tuple[Any, ...]:
    """Inputs at both ends, time and length of the j-th of equal pieces of every interval, as rows."""
    dt, du = np.diff(t), np.diff(u, axis=0)
    left, right = u[:-1] + du * (j / pieces), u[:-1] + du * ((j + 1) / pieces)
    return left.T, right.T, (t[:-1] + dt * (j / pieces))[None, :], (dt / pieces)[None, :]


def _pieces(equations: Equations, t: Array, u: Array, x: Array) -> int:
    """Runge-Kutta steps per interval, by the fastest mode along the way."""
    plant = equations.plant
    if plant.sample_time is not None:
        return 1
    k = np.unique(np.linspace(0, len(t) - 1, LOOKED_AT).astype(int))
    fastest = float(np.abs(slopes(equations, x[k], u[k], t[k])[1]).max(initial=0.0))
    wanted = fastest * float(np.diff(t).max()) / REACH
    if not wanted <= MOST_STEPS:
        raise Inconclusive(
            f"samples {np.diff(t).max():.4g} apart do not follow {plant.name}",
            why=f"its fastest mode along the way has a time constant of {1.0 / fastest:.4g}",
            evidence={"interval": float(np.diff(t).max()), "fastest": 1.0 / fastest},
            remedies=("give a denser trajectory", "leave the fast mode out of the model"),
        )
    return max(1, math.ceil(wanted))


def slopes(equations: Equations, x: Array, u: Array, t: Array) -> tuple[Array, NDArray[np.complex128]]:
    """∂f/∂x (N, n, n) at points, and its eigenvalues (N, n)."""
    n, N = equations.plant.n, len(x)
    J = _blocks(np.array(_slope(equations)(x.T, u.T, np.asarray(t)[None, :])), N, n, n)
    if not np.isfinite(J).all():
        return J, np.zeros((N, n), dtype=complex)
    return J, np.linalg.eigvals(J).astype(complex)


@lru_cache(maxsize=8)
def _slope(equations: Equations) -> Any:
    import casadi as ca

    s = equations.sx()
    zero = ca.SX.zeros(equations.q), ca.SX.zeros(len(equations.parameters))
    J = ca.densify(ca.jacobian(equations.right(s["x"], s["u"], *zero, s["t"]), s["x"]))
    return ca.Function("slope", [s["x"], s["u"], s["t"]], [J])


@lru_cache(maxsize=8)
def _step(equations: Equations) -> Any:
    """x, both ends' inputs, time, length to the next state and its derivatives by x and by (faults, numbers)."""
    import casadi as ca

    s = equations.sx()
    x, u, f, p, t = (s[name] for name in ("x", "u", "f", "p", "t"))
    v, h = ca.SX.sym("v", u.numel()), ca.SX.sym("h")

    def rate(at: Any, part: float) -> Any:
        return equations.right(at, u + part * (v - u), f, p, t + part * h)

    if equations.plant.sample_time is not None:
        after = rate(x, 0.0)
    else:
        k1 = rate(x, 0.0)
        k2 = rate(x + h / 2 * k1, 0.5)
        k3 = rate(x + h / 2 * k2, 0.5)
        k4 = rate(x + h * k3, 1.0)
        after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    z = ca.vertcat(f, p)
    outputs = [ca.densify(after), ca.densify(ca.jacobian(after, x)), ca.densify(ca.jacobian(after, z))]
    return _nominal("step", [x, u, v, t, h], outputs, f, p)


@lru_cache(maxsize=8)
def _next(equations: Equations) -> Any:
    """The next state alone, of the same arguments."""
    import casadi as ca

    arguments = _step(equations).sx_in()
    return ca.Function("next", arguments, [_step(equations)(*arguments)[0]])


@lru_cache(maxsize=8)
def _reading(equations: Equations) -> Any:
    """x, u to h, ∂y/∂x and ∂y/∂(faults, numbers)."""
    import casadi as ca

    s = equations.sx()
    y = equations.shown(s["x"], s["u"], s["f"], s["p"])
    z = ca.vertcat(s["f"], s["p"])
    outputs = [equations.healthy(s["x"], s["u"]), ca.densify(ca.jacobian(y, s["x"])), ca.densify(ca.jacobian(y, z))]
    return _nominal("reading", [s["x"], s["u"]], outputs, s["f"], s["p"])


def _nominal(name: str, inputs: Sequence[Any], outputs: Sequence[Any], f: Any, p: Any) -> Any:
    """A function without faults and with every number as the plant has it."""
    import casadi as ca

    z = ca.vertcat(f, p)
    return ca.Function(name, list(inputs), [ca.densify(ca.substitute(o, z, ca.DM.zeros(z.numel()))) for o in outputs])


def _blocks(flat: Array, N: int, rows: int, columns: int) -> Array:
    """Matrices side by side, (rows, N columns), as (N, rows, columns)."""
    return flat.reshape(rows, N, columns).transpose(1, 0, 2)


def _part(given: Any, name: str, k: int) -> Any:
    if isinstance(given, Mapping):
        return given.get(name)
    if isinstance(given, tuple | list):
        return given[k] if k < len(given) else None
    return getattr(given, name, None)


def named(parameters: Sequence[Parameter], gauge: Mapping[int, float]) -> dict[str, float]:
    """A gauge by the names of its numbers."""
    return {parameters[j].name: value for j, value in gauge.items()}
