# SPDX-License-Identifier: BSD-3-Clause
"""One regular sample time of a plant and of its observer, each as matrices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.discretise import foh, zoh
from faultrecon.plant.plant import Plant
from faultrecon.runtime.estimator import Estimator

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class ObserverStep:
    """z⁺ = Ad z + B0 v + B1 v⁺ + N φ over one sample time."""

    Ad: Array
    B0: Array
    B1: Array
    N: Array


@dataclass(frozen=True, eq=False)
class PlantStep:
    """x⁺ = Φ x + U0 u + U1 u⁺ + W w + F0 f + F1 f⁺ + G φ over one sample time.

    w and φ are constant inside it, faults run in straight lines, u runs as the estimator reads it.  W has a column for
    every disturbance of the plant, whatever its role.
    """

    Phi: Array
    U0: Array
    U1: Array
    W: Array
    F0: Array
    F1: Array
    G: Array


def observer_step(estimator: Estimator) -> ObserverStep:
    """The linear part of one regular step between complete samples, whichever scheme runs it."""
    return step_with(estimator, estimator.observer.A, estimator.observer.B)


def step_with(estimator: Estimator, A: Array, B: Array) -> ObserverStep:
    """The same with other matrices in place of the observer's own."""
    observer, T, hold, rk4 = estimator.observer, estimator.sample_time, estimator.hold, estimator.scheme == "rk4"
    N = np.zeros((A.shape[0], 0)) if observer.nonlinear is None else observer.nonlinear.into
    if estimator.scheme == "sampled":
        return ObserverStep(A, B, np.zeros_like(B), N)
    Ad, driven = (_rk4(A, N, T) if rk4 else zoh(A, N, T)) if A.size else (A, N)
    if hold == "linear":
        _, B0, B1 = _rk4_line(A, B, T) if rk4 else foh(A, B, T)
        return ObserverStep(Ad, B0, B1, driven)
    _, B0 = _rk4(A, B, T) if rk4 else zoh(A, B, T)
    if hold == "left":
        return ObserverStep(Ad, B0, np.zeros_like(B0), driven)
    return ObserverStep(Ad, 0.5 * B0, 0.5 * B0, driven)


def _rk4(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """One classical Runge-Kutta step of z' = A z + B v with v held: (Ad, Bd)."""
    one, H = np.eye(A.shape[0]), h * A
    integral = h * (one + H / 2.0 @ (one + H / 3.0 @ (one + H / 4.0)))
    return one + A @ integral, integral @ B


def _rk4_line(A: Array, B: Array, h: float) -> tuple[Array, Array, Array]:
    """The same with v in a straight line: (Ad, B0, B1); the stages read v0, (v0 + v1)/2 twice, and v1."""
    one, H = np.eye(A.shape[0]), h * A
    Ad, _ = _rk4(A, B, h)
    first, second = h / 6.0 * (one + H + H @ H / 2.0 + H @ H @ H / 4.0), h / 6.0 * (2.0 * one + H + H @ H / 2.0)
    third, last = h / 6.0 * (2.0 * one + H), h / 6.0 * one
    middle = 0.5 * (second + third) @ B
    return Ad, first @ B + middle, last @ B + middle


def plant_step(plant: Plant, estimator: Estimator) -> PlantStep:
    """One sample time of the plant, as the estimator samples it."""
    T, hold = estimator.sample_time, estimator.hold
    G = np.zeros((plant.n, 0)) if plant.nonlinearity is None else plant.nonlinearity.into
    E = disturbed(plant)[0]
    if plant.sample_time is not None:
        nothing = np.zeros_like(plant.E_f)
        return PlantStep(plant.A, plant.B, np.zeros_like(plant.B), E, plant.E_f, nothing, G)
    Phi, constant = zoh(plant.A, np.hstack([E, G]), T)
    W, N = np.split(constant, [E.shape[1]], axis=1)
    _, F0, F1 = foh(plant.A, plant.E_f, T)
    if hold == "linear":
        _, U0, U1 = foh(plant.A, plant.B, T)
    else:
        _, held = zoh(plant.A, plant.B, T)
        U0, U1 = (held, np.zeros_like(held)) if hold == "left" else (0.5 * held, 0.5 * held)
    return PlantStep(Phi, U0, U1, W, F0, F1, N)


def disturbed(plant: Plant) -> tuple[Array, Array]:
    """Every disturbance, of any role, into the states and onto the sensors: (n, l) and (p, l)."""
    E, F = np.zeros((plant.n, len(plant.disturbances))), np.zeros((plant.p, len(plant.disturbances)))
    for i, w in enumerate(plant.disturbances):
        for name, coefficient in w.into.items():
            E[plant.signals.x.index(name), i] = coefficient
        for name, coefficient in w.on.items():
            F[plant.signals.y.index(name), i] = coefficient
    return E, F
