# SPDX-License-Identifier: BSD-3-Clause
"""What the plant really did: its states, and what every sensor showed, exact enough to measure estimators against.

    ẋ = A x + B u + G φ(H x, u, t) + g(y, u, t) + E_w w + E_f f_a
    y = (I + diag f_m)(C x + D u + F_w w) + F_f f_s + noise

A plant whose equations are linear is carried by e^(Ah) and Gauss-Legendre quadrature of what drives it, a nonlinear one
by DOP853 that restarts at every jump and kink.  φ is evaluated where the plant is, outside its declared domain too.
g reads what the sensors show, faults and noise included, as the plant's equation says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Inconclusive
from faultrecon.numerics.integrate import reference_solution
from faultrecon.plant.plant import Plant
from faultrecon.simulation.chance import held_edges
from faultrecon.simulation.composition import Shape
from faultrecon.simulation.scenario import NOTHING, Scenario, Schedule, schedule

Array = NDArray[Any]

STAGES = 6
"""Gauss points per substep: the remainder h^13 (6!)^4 f^(12)/(13 (12!)^3) is 2e-16 at |A| h = 1 and slow drive f."""
REACH = 1.0
"""Largest |A| h of a substep."""
BUDGET = 2_000_000
"""Evaluations of a nonlinear plant, about two minutes: more is needed only by one that diverges or is very stiff."""
RTOL, ATOL = 1e-10, 1e-12


@dataclass(frozen=True, eq=False)
class Truth:
    """N samples of what happened: t (N,), u (N, m), w (N, l) every disturbance, f (N, q) every fault of the plant,
    x (N, n), healthy (N, p) what sensors would show without faults and noise, y (N, p) what they showed.

    x_hat0 (n,): what the estimator believes at the start.  noise (N, p): what sensor noise added, part of y.
    """

    plant: Plant
    scenario: Scenario
    t: Array
    u: Array
    w: Array
    f: Array
    x: Array
    healthy: Array
    y: Array
    x_hat0: Array
    noise: Array

    def left_domain(self) -> tuple[str, ...]:
        """The states that left the domain on which the bound of φ is claimed."""
        term = self.plant.nonlinearity
        if term is None:
            return ()
        low, high = term.limits
        read = self.x @ self.plant.H.T
        gone = np.any((read < low) | (read > high), axis=0)
        return tuple(name for name, out in zip(term.reads, gone, strict=True) if out)


def true_run(plant: Plant, scenario: Scenario, *, inside: bool = False) -> Truth:
    """Simulate the plant.

    inside: give up as soon as it leaves the domain of φ.  Raises InputError on unknown names, Inconclusive when the
    state diverges or the integration is given up.
    """
    s = schedule(plant, scenario)
    s = _remembered(s)
    x = _states(s, s.t, inside)
    u, w = _inputs(s, s.t), _values(s.disturbances, s.t)
    healthy = _healthy(plant, x, u, w)
    f = _faults(s, s.t, healthy, u)
    noise = _noise_gain(s, s.t) * s.noise
    y = healthy + _fault_effect(plant, f, healthy) + noise
    return Truth(plant, scenario, s.t, u, w, f, x, healthy, y, s.x_hat0, noise)


# ---------------------------------------------------------------- signals


def _values(shapes: tuple[Shape, ...], t: Array) -> Array:
    """Shapes that need no reading at times (N,): (N, k)."""
    out = np.zeros((len(t), len(shapes)))
    for j, shape in enumerate(shapes):
        if shape != NOTHING:
            out[:, j] = shape(t)
    return out


def _inputs(s: Schedule, t: Array) -> Array:
    """Absolute inputs (N, m)."""
    at = t if s.input_hold == "continuous" else s.t[np.maximum(np.searchsorted(s.t, t, side="right") - 1, 0)]
    return np.array(s.plant.point.u) + _values(s.inputs, at)


def _healthy(plant: Plant, x: Array, u: Array, w: Array) -> Array:
    """What the sensors would show without faults and noise, (N, p), absolute."""
    point = plant.point
    return (
        np.array(point.y) + (x - np.array(point.x)) @ plant.C.T + (u - np.array(point.u)) @ plant.D.T + w @ _F(plant).T
    )


def _faults(s: Schedule, t: Array, healthy: Array, u: Array) -> Array:
    """Fault signals (N, q); a shape that acts on the healthy signal becomes the waveform that does the same."""
    out = np.zeros((len(t), len(s.faults)))
    for j, (channel, shape) in enumerate(zip(s.plant.faults, s.faults, strict=True)):
        if not shape.relative:
            out[:, j] = shape(t)
            continue
        name, coefficient = next((k, c) for k, c in channel.on.items() if c)
        sensor = channel.site == "sensor"
        index = (s.plant.signals.y if sensor else s.plant.signals.u).index(name)
        reading = (healthy if sensor else u)[:, index]
        wanted = np.asarray(shape(t, reading))
        if channel.effect == "multiplicative":
            coefficient = coefficient * np.where(reading == 0, 1.0, reading)
        out[:, j] = wanted / coefficient
    return out


def _fault_effect(plant: Plant, f: Array, healthy: Array) -> Array:
    """What faults add to the sensors, (N, p)."""
    out = np.zeros_like(healthy)
    for j, channel in enumerate(plant.faults):
        if channel.site == "sensor":
            by = f[:, [j]] * plant.F_f[:, j]
            out += by * healthy if channel.effect == "multiplicative" else by
    return out


def _noise_gain(s: Schedule, t: Array) -> Array:
    out = np.ones((len(t), s.plant.p))
    for j, (channel, shape) in enumerate(zip(s.plant.faults, s.faults, strict=True)):
        if channel.site == "sensor":
            reached = s.plant.F_f[:, j] != 0
            out[:, reached] = np.minimum(out[:, reached], np.asarray(shape.noise_gain(t))[:, None])
    return out


def _remembered(s: Schedule) -> Schedule:
    """Shapes that freeze the last reading are told it: the earliest first, since a frozen sensor may feed back."""
    while True:
        open_onsets = [(t, j) for j, shape in enumerate(s.faults) for t in shape.onsets() if t <= s.end]
        if not open_onsets:
            return s
        onset, j = min(open_onsets)
        channel = s.plant.faults[j]
        x = s.x0[None] if onset == 0 else _states(s, np.array([0.0, onset]))[-1:]
        at = np.array([np.nextafter(onset, -1.0) if onset > 0 else 0.0])
        u = _inputs(s, at)
        if channel.site == "sensor":
            name = next(k for k, c in channel.on.items() if c)
            value = _healthy(s.plant, x, u, _values(s.disturbances, at))[0, s.plant.signals.y.index(name)]
        else:
            value = u[0, s.plant.signals.u.index(next(k for k, c in channel.on.items() if c))]
        told = s.faults[j].remembering(float(value), onset)
        s = replace(s, faults=(*s.faults[:j], told, *s.faults[j + 1 :]))


# ---------------------------------------------------------------- states


def _E(plant: Plant) -> Array:
    """All disturbances into the states, noise channels among them, (n, l)."""
    out = np.zeros((plant.n, len(plant.disturbances)))
    for j, d in enumerate(plant.disturbances):
        for name, c in d.into.items():
            out[plant.signals.x.index(name), j] = c
    return out


def _F(plant: Plant) -> Array:
    """All disturbances onto the sensors, (p, l)."""
    out = np.zeros((plant.p, len(plant.disturbances)))
    for j, d in enumerate(plant.disturbances):
        for name, c in d.on.items():
            out[plant.signals.y.index(name), j] = c
    return out


def _states(s: Schedule, t: Array, inside: bool = False) -> Array:
    """Absolute states at increasing times t (N,) from t[0] = 0 on: (N, n)."""
    with np.errstate(over="ignore", invalid="ignore"):  # a plant that diverges is told below
        if s.plant.sample_time is not None:
            x = _sampled(s)[np.searchsorted(s.t, t, side="right") - 1]
        elif s.plant.nonlinearity is None and s.plant.known is None:
            x = _linear(s, t)
        else:
            x = _nonlinear(s, t, inside)
    if not np.isfinite(x).all():
        k = int(np.argmin(np.isfinite(x).all(axis=1)))
        raise Inconclusive(f"the plant diverges at t = {t[k]:g} s", remedies=("shorten the scenario",))
    return x


def _breakpoints(s: Schedule, end: float) -> list[float]:
    """Where the right-hand side jumps or kinks; signals that do not reach the states are left out."""
    plant, out = s.plant, []
    if s.input_hold == "sample":
        out += [float(v) for v in s.t]
    else:
        out += [v for shape in s.inputs for v in shape.breakpoints(end)]
    reads_y = plant.known is not None
    for channel, shape in zip(plant.faults, s.faults, strict=True):
        if channel.site == "actuator" or reads_y:
            out += shape.breakpoints(end)
    out += [v for shape in _reaching(s).disturbances for v in shape.breakpoints(end)]
    if reads_y and s.noise_seeds and plant.noise is not None:
        out += held_edges(plant.noise.hold, end)
    return sorted({v for v in out if 0 < v < end})


def _drive(s: Schedule, t: Array) -> Array:
    """Everything but A x in the state equation of a linear plant, (N, n)."""
    u = _inputs(s, t)
    f = _faults(s, t, np.zeros((len(t), s.plant.p)), u) if s.plant.E_f.any() else np.zeros((len(t), len(s.faults)))
    du = u - np.array(s.plant.point.u)
    return du @ s.plant.B.T + _values(s.disturbances, t) @ _E(s.plant).T + f @ s.plant.E_f.T


def _linear(s: Schedule, t: Array) -> Array:
    """The variation-of-constants formula, substep by substep between sampling times and breakpoints."""
    from scipy.linalg import expm

    A, x0 = s.plant.A, np.array(s.plant.point.x)
    edges = np.unique(np.concatenate((t, _breakpoints(s, float(t[-1])))))
    length = np.diff(edges)
    parts = np.maximum(1, np.ceil(np.linalg.norm(A, 2) * length / REACH).astype(int))
    steps = np.repeat(length / parts, parts)
    within = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    starts = np.repeat(edges[:-1], parts) + within * steps
    nodes, weights = np.polynomial.legendre.leggauss(STAGES)
    nodes, weights = 0.5 * (nodes + 1), 0.5 * weights
    drive = _drive(s, (starts[:, None] + steps[:, None] * nodes).ravel()).reshape(len(starts), STAGES, -1)
    pairs = list(zip(nodes, weights, strict=True))
    flows: dict[float, tuple[Array, Array]] = {}
    x, out = s.x0 - x0, np.empty((len(starts) + 1, s.plant.n))
    out[0] = x
    for k, h in enumerate(steps):
        key = float(f"{h:.12e}")  # lengths that differ by rounding share one exponential
        if key not in flows:
            flows[key] = expm(A * key), np.stack([w * key * expm(A * key * (1 - c)) for c, w in pairs])
        Ad, kernel = flows[key]
        x = Ad @ x + np.einsum("sij,sj->i", kernel, drive[k])
        out[k + 1] = x
    rows = np.concatenate(([0], np.cumsum(parts)))[np.searchsorted(edges, t)]
    return x0 + out[rows]


def _nonlinear(s: Schedule, t: Array, inside: bool) -> Array:
    """DOP853 between breakpoints, by `reference_solution`, within a budget of evaluations."""
    slope, H, evaluations = _right_hand_side(s), s.plant.H, 0
    low, high = s.plant.nonlinearity.limits if inside and s.plant.nonlinearity else (-np.inf, np.inf)

    def rhs(at: float, x: Array) -> Array:
        nonlocal evaluations
        evaluations += 1
        read = H @ x
        if evaluations > BUDGET or np.any(read < low) or np.any(read > high):
            raise Inconclusive(
                f"the plant was not simulated beyond t = {at:.4g} s",
                why="it leaves the domain of phi" if evaluations <= BUDGET else f"{BUDGET} evaluations were not enough",
                remedies=("let less happen to it", "check that it stays bounded"),
            )
        return slope(at, x)

    return reference_solution(rhs, s.x0, t, breakpoints=_breakpoints(s, float(t[-1])), rtol=RTOL, atol=ATOL)


def _reaching(s: Schedule) -> Schedule:
    """The schedule without the disturbances that never reach a state."""
    reads_y = s.plant.known is not None
    pairs = zip(s.plant.disturbances, s.disturbances, strict=True)
    return replace(s, disturbances=tuple(w if d.into or (reads_y and d.on) else NOTHING for d, w in pairs))


def _right_hand_side(s: Schedule) -> Callable[[float, Array], Array]:
    """ẋ at one instant, from absolute states."""
    plant, s = s.plant, _reaching(s)
    x0, u0, E = np.array(plant.point.x), np.array(plant.point.u), _E(plant)
    term, known = plant.nonlinearity, plant.known

    def rhs(t: float, x: Array) -> Array:
        at = np.array([t])
        u, w = _inputs(s, at), _values(s.disturbances, at)
        out = plant.A @ (x - x0) + plant.B @ (u[0] - u0) + E @ w[0]
        if term is not None:
            out = out + term.into @ term.phi(plant.H @ x, u[0], at)
        if known is not None or plant.E_f.any():
            healthy = _healthy(plant, x[None], u, w)
            f = _faults(s, at, healthy, u)
            out = out + plant.E_f @ f[0]
            if known is not None:
                shown = healthy + _fault_effect(plant, f, healthy) + _noise_gain(s, at) * s.noise_at(t)
                out = out + known.into @ known.g(shown[0], u[0], at)
        return out

    return rhs


def _sampled(s: Schedule) -> Array:
    """x⁺ from x, sample by sample, at the scheduled times."""
    plant, x0, rhs = s.plant, np.array(s.plant.point.x), _right_hand_side(s)
    x = np.empty((len(s.t), plant.n))
    x[0] = s.x0
    for k, t in enumerate(s.t[:-1]):
        x[k + 1] = x0 + rhs(float(t), x[k])
    return x
