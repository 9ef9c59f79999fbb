# SPDX-License-Identifier: BSD-3-Clause
"""Both plants of Huang, Gao, Liu 2024 simulated, and the fault as an observer sees it.

The paper states no noise, no sample time and no initial signs.  Chosen here: samples every 0.5 ms, straight lines in
between; all of x(0) positive, the observer at rest; the loss is f = -0.2 x1; nothing is said of 25 to 35 s, so the slow
sine goes on; the square wave is ±1 with a period of 2 s; K_y = (-0.05, -0.02), since the plant is unstable with +0.05.
Noise: standard deviation 1e-3 on every output, held for 1 ms, not fed back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.advise.papers._huang2024_designs import Which, plant_of
from faultrecon.graph.observer import Observer
from faultrecon.numerics.discretise import zoh
from faultrecon.numerics.integrate import reference_solution
from faultrecon.runtime.estimator import Estimator
from faultrecon.simulation.chance import normal_samples, stream_seed

Array = NDArray[Any]

STEP = 5e-4
"""Sample time, s."""
NOISE, HELD = 1e-3, 2
"""Standard deviation of the noise on every output, and the samples for which one value of it stays."""
FEEDBACK = np.array([-0.05, -0.02, 0.0])
"""K_y of u = K_y y + 0.5; its signs are lost."""
SETTLED, EDGE = 1.0, 0.3
"""Seconds left out after each change of the kind of fault, and after each edge of the square wave."""
SEGMENTS = {
    "bias": (0.0, 5.0),
    "incipient": (5.0, 10.0),
    "loss": (10.0, 20.0),
    "slow sine": (20.0, 35.0),
    "fast sine": (35.0, 40.0),
    "square": (40.0, 50.0),
}
"""Kinds of fault of the robot and when they act, s."""
WINDOWS = {"2 to 5 s": (2.0, 5.0), "5.5 to 10 s": (5.5, 10.0), "10.5 to 20 s": (10.5, 20.0), "40 to 60 s": (40.0, 60.0)}
"""Windows of the aircraft: no fault, ramp, sin 2t twice; its slowest mode takes 26 s."""


@dataclass(frozen=True, eq=False)
class Log:
    """Times (N,), inputs (N, m), states (N, n), fault (N,), measurements (N, p), and which samples count where."""

    t: Array
    u: Array
    x: Array
    f: Array
    y: Array
    where: Mapping[str, Array]


@dataclass(frozen=True)
class Marks:
    """Root mean square and largest size of the error of one stretch."""

    rmse: float
    peak: float


def robot_fault(t: float, x1: float) -> float:
    """Table 1 of the paper."""
    if t < 5.0:
        return 1.0
    if t < 10.0:
        return 0.1 * (t - 5.0) + 1.0
    if t < 20.0:
        return -0.2 * x1
    if t < 35.0:
        return float(np.sin(0.5 * t))
    return float(np.sin(12.0 * t)) if t < 40.0 else 1.0 - 2.0 * (int(t - 40.0 + 1e-9) % 2)


@lru_cache(maxsize=2)
def robot_log(step: float = STEP) -> Log:
    """The robot for 50 s under u = K_y y + 0.5, its first sensor failing in six ways."""
    plant = plant_of("robot")
    A, B, E, F = plant.A, plant.B[:, 0], plant.E_w, plant.F_f[:, 0]

    def rate(t: float, x: Array) -> Array:
        y = x[:3] + F * robot_fault(t, x[0])
        w = np.array([np.sin(4.0 * np.pi * t), 0.5 * np.sin(np.pi * t)])
        return A @ x + B * (FEEDBACK @ y + 0.5) + E @ w - np.array([0.0, 0.0, 0.0, 0.333 * np.sin(x[2])])

    t = step * np.arange(round(50.0 / step) + 1)
    edges = [5.0, 10.0, 20.0, 35.0, *np.arange(40.0, 50.0)]
    x = reference_solution(rate, [2.0, 40.0, 10.0, 0.5], t, breakpoints=edges, rtol=1e-9, atol=1e-10)
    f = np.array([robot_fault(s, x1) for s, x1 in zip(t, x[:, 0], strict=True)])
    y = x @ plant.C.T + f[:, None] * F
    where = {name: _within(t, a + SETTLED, b) for name, (a, b) in SEGMENTS.items()}
    where["square"] = _within(t, 40.0, 50.0) & ((t - 40.0 + 1e-9) % 1.0 >= EDGE)
    return Log(t, (y @ FEEDBACK + 0.5)[:, None], x, f, y, where)


@lru_cache(maxsize=1)
def aircraft_log() -> Log:
    """The aircraft for 60 s, every sample exact: sines and constants are states of one larger linear system."""
    plant = plant_of("aircraft")
    n, frequencies = plant.n, (10.0, 20.0, np.pi)
    whole = np.zeros((n + 7, n + 7))
    whole[:n, :n] = plant.A
    for k, w in enumerate(frequencies):
        whole[n + 2 * k, n + 2 * k + 1], whole[n + 2 * k + 1, n + 2 * k] = w, -w
    whole[:n, n], whole[:n, n + 2] = plant.E_w.T
    whole[:n, n + 4], whole[:n, n + 6] = 2.0 * plant.B.T
    Ad, _ = zoh(whole, np.zeros((n + 7, 0)), STEP)
    t = STEP * np.arange(round(60.0 / STEP) + 1)
    X = np.empty((len(t), n + 7))
    X[0] = [0.1, 5.0, 0.1, 0.1, *(0.0, 1.0) * 3, 1.0]
    for k in range(len(t) - 1):
        X[k + 1] = Ad @ X[k]
    f = np.where(t < 5.0, 0.0, np.where(t < 10.0, 0.2 * (t - 5.0), np.sin(2.0 * t)))
    u = np.stack([2.0 * np.sin(np.pi * t), np.full(len(t), 2.0)], axis=1)
    y = X[:, :n] @ plant.C.T + f[:, None] * plant.F_f[:, 0]
    return Log(t, u, X[:, :n], f, y, {name: _within(t, a, b) for name, (a, b) in WINDOWS.items()})


@lru_cache(maxsize=4)
def log_of(which: Which, noisy: bool = False, seed: int = 0) -> Log:
    """The run of a plant, with noise on its sensors when asked."""
    log = robot_log() if which == "robot" else aircraft_log()
    if not noisy:
        return log
    count = len(log.t) // HELD + 1
    held = [np.repeat(normal_samples(stream_seed(seed, f"noise/{j}"), count), HELD) for j in range(log.y.shape[1])]
    return replace(log, y=log.y + NOISE * np.stack(held, axis=1)[: len(log.t)])


def estimates(observer: Observer, log: Log, scheme: Any = "auto") -> tuple[Array, Array]:
    """f̂ (N,) and x̂ (N, n), the observer at rest at the start."""
    step = float(log.t[1] - log.t[0])
    trace = Estimator.build(observer, step, scheme=scheme, engine="casadi").replay(log.t, log.u, log.y)
    return trace.fault[:, 0], trace.state


def marks(observer: Observer, log: Log, scheme: Any = "auto") -> dict[str, Marks]:
    """Root mean square and peak of the error, stretch by stretch."""
    error = np.abs(estimates(observer, log, scheme)[0] - log.f)
    parts = {name: error[counts] for name, counts in log.where.items()}
    return {name: Marks(float(np.sqrt(np.mean(e**2))), float(e.max())) for name, e in parts.items()}


def finer(log: Log, parts: int) -> Log:
    """The straight lines between the samples of a run, sampled `parts` times as often."""
    step = float(log.t[1] - log.t[0]) / parts
    t = step * np.arange(parts * (len(log.t) - 1) + 1)

    def lines(values: Array) -> Array:
        return np.stack([np.interp(t, log.t, column) for column in values.T], axis=1)

    return Log(t, lines(log.u), lines(log.x), np.interp(t, log.t, log.f), lines(log.y), {})


def until(log: Log, end: float) -> Log:
    """The run up to a time."""
    k = int(np.searchsorted(log.t, end + 1e-9))
    where = {name: counts[:k] for name, counts in log.where.items()}
    return Log(log.t[:k], log.u[:k], log.x[:k], log.f[:k], log.y[:k], where)


def _within(t: Array, start: float, end: float) -> Array:
    return (t >= start - 1e-9) & (t < end - 1e-9)
