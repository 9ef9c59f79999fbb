# SPDX-License-Identifier: BSD-3-Clause
"""Plants from plants: sampled ones from continuous ones, linear ones about a point, linear ones from array code.

Whatever is approximate or left out is said: a point that is no equilibrium in a `FindingWarning`, a step that would
turn a decaying mode into a growing one by an InputError.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import Finding, Inconclusive, InputError, did_you_mean
from faultrecon.graph.function import Graph
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.matrices import input_columns, plant_from_matrices, tell
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Noise

Array = NDArray[np.float64]
Hold = Literal["zoh", "euler", "foh"]

AT_REST = float(np.sqrt(np.finfo(float).eps))
"""Relative size of a residual that counts as none: trim points are given to about half the digits of a double."""


# ---------------------------------------------------------------- sampling


def discretised(plant: Plant, h: float, how: Hold = "zoh") -> Plant:
    """The sampled plant x⁺ = Ad x + Bd u + ... for a step of h seconds.

    zoh    exact for inputs, disturbances and faults that are held over the step; φ and g are held too, which is exact
           where they are constant over a step and errs by O(h²) per step otherwise
    euler  x⁺ = x + h ẋ, as papers on Euler-discretised plants write it: O(h²) per step for everything
    foh    exact for inputs that run in straight lines between samples, disturbances held.  Its state is x - B1 (u - u0)
           and its D is D + C B1: estimates of it are not estimates of x.  Linear plants without actuator faults only

    Sensor faults, names, units and sizes stay.  Noise: a sensor draws a new sample every max(h, hold) seconds.  Time in
    φ and g stays in seconds.  Raises InputError: sampled already, h not positive, Euler unstable for a decaying mode.
    """
    if plant.sample_time is not None:
        raise InputError(f"{plant.name} is sampled already", why=f"its sample time is {plant.sample_time:g} s")
    if not (isinstance(h, int | float) and math.isfinite(h) and h > 0):
        raise InputError(f"the step is {h}", why="it is a positive number of seconds")
    if how not in ("zoh", "euler", "foh"):
        raise InputError(f"there is no way '{how}' to discretise", why=did_you_mean(str(how), ("zoh", "euler", "foh")))
    step = {"zoh": _zoh, "euler": _euler, "foh": _foh}[how]
    W, _, _ = input_columns(plant, "disturbances")
    terms = [W, plant.G, np.zeros((plant.n, 0)) if plant.known is None else plant.known.into]
    A, B, D, (W, G, M) = step(plant, float(h), terms)
    noise = None if plant.noise is None else replace(plant.noise, hold=max(plant.noise.hold, float(h)))
    return replace(
        plant,
        A=A,
        B=B,
        D=D,
        disturbances=_moved(plant, W),
        nonlinearity=None if plant.nonlinearity is None else replace(plant.nonlinearity, into=G),
        known=None if plant.known is None else replace(plant.known, into=M),
        noise=noise,
        sample_time=float(h),
        polytopic=None,  # it describes the continuous plant
        source=_note(plant, f"discretised: {how}, {h:g} s"),
    )


Sampled = tuple[Array, Array, Array, list[Array]]


def _zoh(plant: Plant, h: float, terms: Sequence[Array]) -> Sampled:
    from faultrecon.numerics.discretise import zoh

    Ad, every = zoh(plant.A, np.hstack([plant.B, *terms]), h)
    B, *rest = _parted(every, [plant.B, *terms])
    return Ad, B, plant.D, rest


def _euler(plant: Plant, h: float, terms: Sequence[Array]) -> Sampled:
    poles: NDArray[np.complex128] = np.linalg.eigvals(plant.A).astype(np.complex128)
    decaying = poles[poles.real < 0]
    limits = -2.0 * decaying.real / np.abs(decaying) ** 2  # |1 + h s| < 1
    if limits.size and h >= limits.min():
        s = complex(decaying[np.argmin(limits)])
        raise InputError(
            f"Euler steps of {h:g} s are too long for {plant.name}",
            why=f"its mode at s = {s:.4g} decays, and would grow for steps of {limits.min():.4g} s and more",
            evidence={"step": h, "largest": float(limits.min()), "mode": [s.real, s.imag]},
            remedies=(f"use a step below {limits.min():.3g} s", "use how='zoh'"),
        )
    return np.eye(plant.n) + h * plant.A, h * plant.B, plant.D, [h * term for term in terms]


def _foh(plant: Plant, h: float, terms: Sequence[Array]) -> Sampled:
    from faultrecon.numerics.discretise import foh, zoh

    blocked = [
        *(["φ is nonlinear"] if plant.nonlinearity is not None else []),
        *(["g is nonlinear"] if plant.known is not None else []),
        *(f"'{f.name}' is an actuator fault" for f in plant.faults if f.site == "actuator"),
    ]
    if blocked:
        raise InputError(
            f"{plant.name} cannot be discretised by foh",
            why=f"its sampled state is x - B1 (u - u0), and {blocked[0]}",
            remedies=("use how='zoh'",),
        )
    Ad, B0, B1 = foh(plant.A, plant.B, h)
    _, every = zoh(plant.A, np.hstack(terms), h)
    return Ad, B0 + Ad @ B1, plant.D + plant.C @ B1, _parted(every, terms)


def _parted(columns: Array, like: Sequence[Array]) -> list[Array]:
    """The columns cut into matrices as wide as these."""
    return np.split(columns, np.cumsum([part.shape[1] for part in like])[:-1], axis=1)


def _moved(plant: Plant, into: Array) -> tuple[Disturbance, ...]:
    """The disturbances with other columns (n, k) into the states; a zero is left out."""

    def table(channels: Channels, column: Array) -> Mapping[str, float]:
        return {name: float(v) for name, v in zip(channels, column, strict=True) if v != 0}

    return tuple(replace(d, into=table(plant.signals.x, into[:, j])) for j, d in enumerate(plant.disturbances))


def _note(plant: Plant, word: str) -> str:
    return f"{plant.source}; {word}" if plant.source else word


# ---------------------------------------------------------------- about a point


def linearised(plant: Plant, x: ArrayLike, u: ArrayLike = (), *, t: float = 0.0) -> Plant:
    """The linear plant about (x, u), absolute values: φ and g give their Jacobians to A and B, and g its to E_w.

    The operating point becomes (x, u, y0 + C (x - x0) + D (u - u0)); t is the time at which φ and g are read, s.
    Warns with a `FindingWarning` when the point is no equilibrium: the drift is left out.  Raises InputError where a
    sensor fault would enter the states through g, and where a derivative does not exist.
    """
    x, u = _point(plant, x, u)
    A, B, W = _slopes(plant, x, u, t)
    tell(_not_at_rest(plant.signals.x.names, drift(plant, x, u, t=t), _slack(A, B, x, u)))
    return replace(
        plant,
        A=A,
        B=B,
        disturbances=_moved(plant, W),
        nonlinearity=None,
        known=None,
        polytopic=None,
        operating_point=OperatingPoint(_floats(x), _floats(u), _floats(_output(plant, x, u))),
        source=_note(plant, "linearised"),
    )


def drift(plant: Plant, x: ArrayLike, u: ArrayLike = (), *, t: float = 0.0) -> Array:
    """How the state moves at (x, u), absolute values, without disturbances and faults: ẋ, or x⁺ - x, (n,)."""
    x, u = _point(plant, x, u)
    dx, du = x - plant.point.x, u - plant.point.u
    out = plant.A @ dx + plant.B @ du - (dx if plant.sample_time is not None else 0.0)
    if plant.nonlinearity is not None:
        out = out + plant.G @ plant.nonlinearity.phi(plant.H @ x, u, [t])
    if plant.known is not None:
        out = out + plant.known.into @ plant.known.g(_output(plant, x, u), u, [t])
    return out


def equilibrium(plant: Plant, u: ArrayLike = (), *, guess: ArrayLike | None = None, t: float = 0.0) -> Array:
    """A state where the plant stays under the input u (m,), absolute: Newton's method from `guess` or x0, (n,).

    Where a whole line of states is at rest, one near the guess is found.  Raises Inconclusive after 50 steps.
    """
    x, u = _point(plant, plant.point.x if guess is None else guess, u)
    rest = drift(plant, x, u, t=t)
    for _ in range(50):  # Newton doubles the digits with each step once it is near; far off it may never arrive
        A, B, _ = _slopes(plant, x, u, t)
        if np.all(np.abs(rest) <= _slack(A, B, x, u, 1e-12)):
            return x
        slope = A - np.eye(plant.n) if plant.sample_time is not None else A
        x = x - np.linalg.lstsq(slope, rest, rcond=None)[0]
        if not np.isfinite(x).all():
            break
        rest = drift(plant, x, u, t=t)
    raise Inconclusive(
        f"no equilibrium of {plant.name} was found",
        why=f"after 50 steps of Newton's method the state still moves by {np.abs(rest).max():.3g}",
        remedies=("give a guess nearer to one", "check that this input can hold the plant"),
    )


def _slopes(plant: Plant, x: Array, u: Array, t: float) -> tuple[Array, Array, Array]:
    """A (n, n), B (n, m) and all disturbance columns (n, k), with the Jacobians of φ and g at the point."""
    A, B = plant.A, plant.B
    W, onto, _ = input_columns(plant, "disturbances")
    if plant.nonlinearity is not None:
        phi, at = plant.nonlinearity.phi, (plant.H @ x, u, np.array([t]))
        A = A + plant.G @ _jacobian(phi, "x", at, "phi") @ plant.H
        B = B + plant.G @ _jacobian(phi, "u", at, "phi")
    if plant.known is not None:
        M, g, at = plant.known.into, plant.known.g, (_output(plant, x, u), u, np.array([t]))
        by_y = M @ _jacobian(g, "y", at, "g")
        for fault, column in zip(plant.faults, (by_y @ plant.F_f).T, strict=True):
            if column.any():
                raise InputError(
                    f"fault '{fault.name}' would enter the states through g",
                    why="g reads the sensor it sits on, and a plant has sensor faults on sensors alone",
                    remedies=("write g with healthy sensors", "move the term into phi with the state it stands for"),
                )
        A, B, W = A + by_y @ plant.C, B + M @ _jacobian(g, "u", at, "g") + by_y @ plant.D, W + by_y @ onto
    return A, B, W


def _jacobian(graph: Graph, by: str, at: Sequence[Array], name: str) -> Array:
    if not graph.inputs[by]:
        return np.zeros((graph.n_outputs, 0))
    value = graph.jacobian(by)(*at)
    if not np.isfinite(value).all():
        raise InputError(
            f"{name} has no derivative by {by} at this point",
            why=f"it is {value[~np.isfinite(value)][0]}",
            remedies=("move the point", "write the term so that it is smooth there"),
        )
    return value


def _output(plant: Plant, x: Array, u: Array) -> Array:
    return np.array(plant.point.y) + plant.C @ (x - plant.point.x) + plant.D @ (u - plant.point.u)


def _point(plant: Plant, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
    """x (n,) and u (m,) as finite floats; an empty u means the operating point's."""
    given = {"x": x, "u": plant.point.u if np.size(u) == 0 else u}
    out = []
    for group, value in given.items():
        array, size = np.array(value, dtype=float).ravel(), len(getattr(plant.signals, group))
        if array.shape != (size,) or not np.isfinite(array).all():
            raise InputError(f"the point has {group} = {value!r:.60}", why=f"it takes {size} finite numbers")
        out.append(array)
    return out[0], out[1]


def _floats(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _slack(A: Array, B: Array, x: Array, u: Array, share: float = AT_REST) -> Array:
    """The motion per state that counts as none, (n,): a share of the terms that should balance.

    Beside it the rounding of a small state that was solved for together with large ones.
    """
    rounding = 8 * np.finfo(float).eps * np.abs(x).max()
    return share * (np.abs(A) @ np.abs(x) + np.abs(B) @ np.abs(u)) + rounding * np.abs(A).sum(axis=1)


def _not_at_rest(names: Sequence[str], residual: Array, slack: Array) -> list[Finding]:
    """A finding when the state moves at the point by more than counts as none."""
    moves = [int(i) for i in np.flatnonzero(~(np.abs(residual) <= slack))]
    if not moves:
        return []
    told = ", ".join(f"{names[i]} by {residual[i]:.4g}" for i in moves[:4])
    return [
        Finding(
            "the point is no equilibrium",
            why=f"there the state moves, {told}; the linear model leaves this drift out",
            evidence={"residual": {names[i]: float(residual[i]) for i in moves}},
            remedies=("take an equilibrium: equilibrium(plant, u)", "declare the drift as a disturbance"),
            severity="warning",
        )
    ]


# ---------------------------------------------------------------- from array code


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A linear plant, the residual at its point (ẋ, or x⁺ - x) (n,), and what is to be said about it."""

    plant: Plant
    residual: Array
    findings: tuple[Finding, ...] = ()

    @property
    def at_rest(self) -> bool:
        """Whether the point is an equilibrium, to about half the digits of a double."""
        return not self.findings


def linearise(
    rhs: Callable[..., Any],
    output: Callable[..., Any],
    x0: ArrayLike,
    u0: ArrayLike = (),
    *,
    name: str = "linearised model",
    states: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    faults: Sequence[FaultChannel | str] = (),
    disturbances: Sequence[str] = (),
    noise: Noise | None = None,
    sample_time: float | None = None,
) -> Linearisation:
    """The linear plant of ẋ = rhs(x, u), y = output(x, u) about (x0, u0), by tracing array code and differentiating it.

    With sample_time in s, rhs gives the next state.  Names as "theta [rad]".  disturbances: names; both functions then
    take a third vector w with as many entries, which is zero at the point.  faults: channels, or names of sensors.
    The residual is reported, not raised.  Raises InputError where the functions do not fit or have no derivative.
    """
    at = [np.array(v, dtype=float).ravel() for v in (x0, u0)] + [np.zeros(len(disturbances))] * bool(disturbances)
    sizes = dict(zip("xuw", (v.size for v in at), strict=False))
    f, h = Graph.trace(rhs, sizes), Graph.trace(output, sizes)
    n = at[0].size
    if f.n_outputs != n:
        raise InputError(f"rhs gives {f.n_outputs} numbers", why=f"x0 has {n}")
    fs, hs = ({by: _jacobian(graph, by, at, word) for by in sizes} for graph, word in ((f, "rhs"), (h, "output")))
    both = [np.hstack([part["u"], part.get("w", np.zeros((len(part["u"]), 0)))]) for part in (fs, hs)]
    known = [f"u{k + 1}" for k in range(at[1].size)] if inputs is None else list(inputs)
    plant = plant_from_matrices(
        fs["x"],
        both[0],
        hs["x"],
        both[1],
        sample_time=sample_time,
        name=name,
        states=states,
        inputs=[*known, *disturbances],
        outputs=outputs,
        faults=faults,
        disturbances=disturbances,
        noise=noise,
        operating_point=OperatingPoint(_floats(at[0]), _floats(at[1]), _floats(h(*at))),
        source="linearised from array code",
    )
    residual = f(*at) - (at[0] if sample_time is not None else 0.0)
    slack = _slack(fs["x"], fs["u"], at[0], at[1])
    return Linearisation(plant, residual, tuple(_not_at_rest(plant.signals.x.names, residual, slack)))
