# SPDX-License-Identifier: BSD-3-Clause
"""The robot of the sampled-observer paper: reference designs, variants, and a truth of its own that needs no solver."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

import faultrecon as fr
from faultrecon.lmi.solve import Outcome
from faultrecon.methods.euler_pi import EulerPi, EulerPiEuler, EulerPiRk4, attenuating
from faultrecon.plant.fault import Disturbance
from faultrecon.plant.plant import Plant
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.synthesis.certify import shipped
from faultrecon.synthesis.levels import Posed, pose

LIBRARY = fr.library("flexible_joint_sampled")
PLANT = replace(
    LIBRARY,
    faults=tuple(replace(f, size=1.0) for f in LIBRARY.faults),
    disturbances=tuple(replace(d, size=1.0) for d in LIBRARY.disturbances),
)
"""The robot as the reference tables have it: a unit for the size of everything."""
WEIGHTS = {"α": 2.0, "c₁": 10.0, "c₂": 3000.0, "c₃": 10.0}
"""The reference design minimises 10 γ₁² + 3000 γ₂² + 10 γ₃² at a decay of 2 1/s, with the default state weight."""
FINE = 2.5e-4
"""Step of the truth in s: its error against an adaptive integrator of order eight is below 1e-9."""


class PlainEuler(EulerPiEuler):
    """The paper mode, in which M = (C D₁)⁺ already."""


class PlainHeld(EulerPi):
    """The exact hold, with the left inverse of the reference tables."""

    def left_inverse(self, plant, CD):
        return np.linalg.pinv(CD)


class PlainRk4(EulerPiRk4):
    """The Runge-Kutta prediction, likewise."""

    left_inverse = PlainHeld.left_inverse


class WithoutEuler(EulerPiEuler):
    """J = I, H = 0 on Euler's model."""

    def theorem(self, plant, scaling):
        return self.theorem_reduced(attenuating(plant), scaling)


class WithoutHeld(EulerPi):
    """J = I, H = 0 on the exact hold."""

    theorem = WithoutEuler.theorem


@cache
def reference(kind: type[EulerPi], T: float = 0.01) -> tuple[Posed, Outcome, dict[str, np.ndarray]]:
    """The problem of the reference design, its optimum, and the gains there."""
    posed = pose(kind(T), PLANT, fix=WEIGHTS)
    found = posed.optimum()
    return posed, found, shipped(posed.theorem, found.values)


@cache
def estimator(kind: type[EulerPi], gains_of: type[EulerPi] | None = None, T: float = 0.01) -> Estimator:
    """The reference design of `gains_of` with the prediction of `kind`."""
    plant = attenuating(PLANT) if gains_of in (WithoutEuler, WithoutHeld) else PLANT
    observer = kind(T).observer(plant, reference(gains_of or kind, T)[2])
    return Estimator.build(observer, T, prediction=Prediction(PLANT.C, PLANT.D))


def decoupling(*into: dict[str, float]) -> Plant:
    """The robot with these disturbances to decouple in place of the frame's."""
    made = [Disturbance(f"frame{k}", one, role="decouple") for k, one in enumerate(into)]
    return replace(PLANT, disturbances=(*made, PLANT.disturbances[1]))


# ---------------------------------------------------------------- what happens


def fault(shape: str, t, after: float = 0.0):
    """The fault at times t; after: the end of which interval, so that a step at its beginning has happened."""
    τ = np.maximum(t - 4.0, 0.0)
    if shape == "const":
        return np.where(t - after >= 4.0 - 1e-9, 0.2, 0.0)
    return 0.15 * np.sin(1.5 * τ) + 0.1 * (1.0 - np.exp(-τ))


@cache
def truth(shape: str, a: float, T: float = 0.01, load: float = 0.3):
    """t (N,), u (N, 1), x (N, 4), f (N,) over 12 s: Runge-Kutta steps of `FINE`, u held, f one-sided at its step."""
    import casadi as ca

    x, k = ca.SX.sym("x", 4), ca.SX.sym("k", 8)  # u, share of the step, f and d at the beginning, middle and end
    A, B, E = ca.DM(PLANT.A), ca.DM(PLANT.B), ca.DM(PLANT.E_w)

    def slope(x, f, d):
        pull = ca.vertcat(0, 0, 0, -3.33 * ca.sin(x[2]))
        return A @ x + pull + B @ (k[0] + f) + E @ d

    f, d = (
        (k[1], k[2], k[3]),
        tuple(ca.vertcat(a * ca.sin(5 * k[i]), load * ca.sin(1.3 * k[i] + 0.5)) for i in (4, 5, 6)),
    )
    k1 = slope(x, f[0], d[0])
    k2 = slope(x + 0.5 * FINE * k1, f[1], d[1])
    k3 = slope(x + 0.5 * FINE * k2, f[1], d[1])
    k4 = slope(x + FINE * k3, f[2], d[2])
    step = ca.Function("step", [x, k], [x + FINE / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    N, per = round(12.0 / T), round(T / FINE)
    t = FINE * np.arange(N * per)
    u = 0.3 * np.sin(3 * T * (np.arange(N * per) // per))
    stages = t, t + 0.5 * FINE, t + FINE
    # At its end an interval still has the fault of its beginning when that steps, see `after`.
    faults = [fault(shape, s, after) for s, after in zip(stages, (0.0, 0.5 * FINE, FINE), strict=True)]
    rows = np.column_stack([u, *faults, *stages, u])
    fine = np.array(step.mapaccum(len(t))([0.1, 0.0, -0.1, 0.0], rows.T)).T
    states = np.vstack([[0.1, 0.0, -0.1, 0.0], fine[per - 1 :: per]])
    at = T * np.arange(N + 1)
    return at, 0.3 * np.sin(3 * at)[:, None], states, fault(shape, at)


def errors(est: Estimator, run, noise=None, start: float = 6.0, x=None):
    """f̂ - f (M,) and x̂ - x (M, 4) from `start` on; the observer starts at zero."""
    t, u, states, f = run
    y = states @ PLANT.C.T + (0.0 if noise is None else noise)
    trace, late = est.replay(t, u, y, x=x), t >= start - 1e-9
    return (trace.fault[:, 0] - f)[late], (trace.state - states)[late]


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def noise(seed: int, rows: int = 1201):
    return np.random.default_rng(seed).standard_normal((rows, 3)) @ np.diag([1e-3, 1e-2, 1e-3])
