# SPDX-License-Identifier: BSD-3-Clause
"""The robot of Jia 2015: its reference designs, the observers of the tables, and a truth that needs no solver."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Inconclusive
from faultrecon.io.library import read_library
from faultrecon.lmi.solve import Outcome
from faultrecon.methods.base import Scaling, Theorem
from faultrecon.methods.euler_pi import EulerPi, EulerPiEuler, EulerPiRk4, attenuating
from faultrecon.methods.sampled_limits import PracticalBound, practical_bound, practical_bound_in_box
from faultrecon.methods.sampled_mismatch import seen_mismatch
from faultrecon.plant.plant import Plant
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.synthesis.certify import shipped
from faultrecon.synthesis.levels import Posed, pose

Array = NDArray[Any]
Run = tuple[Array, Array, Array, Array]

WEIGHTS = {"α": 2.0, "c₁": 10.0, "c₂": 3000.0, "c₃": 10.0}
"""The reference design minimises 10 γ₁² + 3000 γ₂² + 10 γ₃² at a decay of 2 1/s, with the default state weight."""
FINE = 2.5e-4
"""Step of the truth in s: its error against an adaptive integrator of order eight is below 1e-8."""
END, ONSET = 12.0, 4.0
RANGES = (1.5, 1.8, 1.5, 1.8, 0.3)
"""Of the states and the voltage.  The runs with a constant fault reach 1.41, 1.69, 1.38, 1.73 and 0.3."""


@cache
def library() -> Plant:
    """The robot as it is in the library."""
    return read_library("flexible_joint_sampled")


@cache
def robot() -> Plant:
    """The robot as the reference tables have it: a unit for the size of everything."""
    plant = library()
    faults = tuple(replace(f, size=1.0) for f in plant.faults)
    return replace(plant, faults=faults, disturbances=tuple(replace(d, size=1.0) for d in plant.disturbances))


@cache
def ranged() -> Plant:
    """The robot as it is in the library, with ranges that the runs stay in."""
    plant = library()
    x = replace(plant.signals.x, ranges=RANGES[:4])
    return replace(plant, signals=replace(plant.signals, x=x, u=replace(plant.signals.u, ranges=RANGES[4:])))


# ---------------------------------------------------------------- observers


class PlainEuler(EulerPiEuler):
    """The paper mode, in which M = (C D₁)⁺ already."""


class PlainHeld(EulerPi):
    """The exact hold, with the left inverse of the reference tables."""

    def left_inverse(self, plant: Plant, CD: Array) -> Array:
        """(C D₁)⁺."""
        return np.asarray(np.linalg.pinv(CD), dtype=float)


class PlainRk4(EulerPiRk4):
    """The Runge-Kutta prediction, likewise."""

    left_inverse = PlainHeld.left_inverse


class WithoutEuler(EulerPiEuler):
    """J = I, H = 0 on Euler's model."""

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """That of the plant in which nothing is to be decoupled."""
        return self.theorem_reduced(attenuating(plant), scaling)


class WithoutHeld(EulerPi):
    """J = I, H = 0 on the exact hold."""

    theorem = WithoutEuler.theorem


OBSERVERS: dict[str, tuple[type[EulerPi], type[EulerPi]]] = {
    "Euler": (PlainEuler, PlainEuler),
    "held": (PlainHeld, PlainHeld),
    "Runge-Kutta": (PlainRk4, PlainHeld),
    "Runge-Kutta, Euler's D₁": (PlainRk4, PlainEuler),
    "Euler, J = I": (PlainEuler, WithoutEuler),
    "Runge-Kutta, J = I": (PlainRk4, WithoutHeld),
}
"""By name: whose prediction, and whose gains."""


@cache
def reference(kind: type[EulerPi], T: float = 0.01) -> tuple[Posed, Outcome, dict[str, Array]]:
    """The problem of the reference design, its optimum, and the gains there.  Raises Inconclusive without one."""
    posed = pose(kind(T), robot(), fix=WEIGHTS)
    found = posed.optimum()
    if not found.solved:
        raise Inconclusive(f"no reference design of {kind.__name__} at {T:g} s", why=found.solver)
    return posed, found, shipped(posed.theorem, found.values)


@cache
def estimator(kind: type[EulerPi], gains_of: type[EulerPi] | None = None, T: float = 0.01) -> Estimator:
    """The reference design of `gains_of` with the prediction of `kind`."""
    gains = reference(gains_of or kind, T)[2]
    return Estimator.build(kind(T).observer(robot(), gains), T, prediction=Prediction(robot().C, robot().D))


def at_sample_time(kind: type[EulerPi], T: float, longest: float) -> tuple[dict[str, Array], Estimator]:
    """The observer at T with L and F per second of the Euler design at `longest`, and its gains."""
    one = (PlainHeld if issubclass(kind, EulerPiRk4) else kind)(T)
    model = one.model(robot(), T)
    more = {"T": np.array([[T]]), "Φ₁": model, "H": one.decoupling(robot(), model)}
    gains = {**reference(PlainEuler, longest)[2], **more}
    made = Estimator.build(kind(T).observer(robot(), gains), T, prediction=Prediction(robot().C, robot().D))
    return gains, made


def bound_at(T: float, longest: float) -> tuple[float, PracticalBound | None]:
    """Largest |f̂ - f| on [8, 12] of the Euler observer at T, and the bound proved for what Euler's model misses."""
    gains, est = at_sample_time(PlainEuler, T, longest)
    run = truth("const", 0.0, T, 0.0)
    t, u, x, f = run
    off = seen_mismatch(robot(), np.eye(4), t, u, x, f[:, None])[t[:-1] >= ONSET]
    reach = np.abs(off).max(axis=0)
    reach = reach * np.sqrt(((off / reach) ** 2).sum(axis=1).max())
    worst = float(np.abs(errors(est, run, start=8.0)[0]).max())
    return worst, practical_bound(PlainEuler(T), robot(), gains, reach, (2, 3, 4, 5, 6, 7))


def bound_in_domain(kind: type[EulerPi], T: float, longest: float) -> float | None:
    """The bound on |f̂ - f| of the same observers that is proved for the declared domain, without looking at a run."""
    plant = ranged()
    gains, _ = at_sample_time(kind, T, longest)
    off = kind(T).mismatch(plant, T).size
    bound = None if off is None else practical_bound_in_box(kind(T), plant, gains, off, (2, 3, 4, 5, 6, 7))
    return None if bound is None else bound.value * plant.faults[0].size


# ---------------------------------------------------------------- what happens


def fault(shape: str, t: Array, after: float = 0.0) -> Array:
    """The fault at times t (N,), "const" or "vary"; after: since when a step at t has happened, in s before t."""
    since = np.maximum(t - ONSET, 0.0)
    if shape == "const":
        return np.where(t - after >= ONSET - 1e-9, 0.2, 0.0)
    return 0.15 * np.sin(1.5 * since) + 0.1 * (1.0 - np.exp(-since))


@cache
def truth(shape: str, a: float, T: float = 0.01, load: float = 0.3) -> Run:
    """t (N,), u (N, 1), x (N, 4), f (N,): Runge-Kutta steps of `FINE`, u held, f one-sided at its step.

    a: amplitude of the frame's disturbance, load: of the load torque.
    """
    import casadi as ca

    x, k = ca.SX.sym("x", 4), ca.SX.sym("k", 7)  # u; f and the time at the beginning, in the middle and at the end
    A, B, E = ca.DM(robot().A), ca.DM(robot().B), ca.DM(robot().E_w)

    def slope(x: Any, i: int) -> Any:
        pull = ca.vertcat(0, 0, 0, -3.33 * ca.sin(x[2]))
        d = ca.vertcat(a * ca.sin(5 * k[4 + i]), load * ca.sin(1.3 * k[4 + i] + 0.5))
        return A @ x + pull + B @ (k[0] + k[1 + i]) + E @ d

    k1 = slope(x, 0)
    k2 = slope(x + 0.5 * FINE * k1, 1)
    k3 = slope(x + 0.5 * FINE * k2, 1)
    k4 = slope(x + FINE * k3, 2)
    step = ca.Function("step", [x, k], [x + FINE / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    N, per = round(END / T), round(T / FINE)
    t = FINE * np.arange(N * per)
    u = 0.3 * np.sin(3 * T * (np.arange(N * per) // per))
    stages, shares = (t, t + 0.5 * FINE, t + FINE), (0.0, 0.5 * FINE, FINE)
    faults = [fault(shape, s, share) for s, share in zip(stages, shares, strict=True)]
    rows = np.column_stack([u, *faults, *stages])
    fine = np.array(step.mapaccum(len(t))([0.1, 0.0, -0.1, 0.0], rows.T)).T
    at = T * np.arange(N + 1)
    states = np.vstack([[0.1, 0.0, -0.1, 0.0], fine[per - 1 :: per]])
    return at, 0.3 * np.sin(3 * at)[:, None], states, fault(shape, at)


def errors(
    est: Estimator, run: Run, noise: Array | None = None, start: float = 6.0, x: Any = None
) -> tuple[Array, Array]:
    """f̂ - f (M,) and x̂ - x (M, 4) from `start` on; the observer starts at zero unless told x."""
    t, u, states, f = run
    y = states @ robot().C.T + (0.0 if noise is None else noise)
    trace, late = est.replay(t, u, y, x=x), t >= start - 1e-9
    return (trace.fault[:, 0] - f)[late], (trace.state - states)[late]


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def noise(seed: int, rows: int = 1201) -> Array:
    """Sensor noise (rows, 3) of the tables."""
    return np.random.default_rng(seed).standard_normal((rows, 3)) @ np.diag([1e-3, 1e-2, 1e-3])


def noisy(est: Estimator, shape: str, a: float, seed: int = 0) -> float:
    """The error of the fault in noise, mean of four seeds from `seed` on."""
    return float(np.mean([rms(errors(est, truth(shape, a), noise(seed + k))[0]) for k in range(4)]))
