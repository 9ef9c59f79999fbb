# SPDX-License-Identifier: BSD-3-Clause
"""The aircraft of Alwi, Edwards, Tan 2009, section 4, flown with its pitch-rate sensor at fault, and what is recovered.

The paper states neither noise nor sample time, gains or how its nonlinear aircraft is controlled.  Chosen here: the
linear model under u = r - K x on the true states, K the LQR of unit weights, r doublets in pitch and roll, held from
one sample to the next; ρ = 1 as in the paper; noise white from sample to sample.  Faults, in rad/s: a ramp of
0.01 rad/s² from 5 to 15 s, 0.1 sin 0.3 t, a step of 0.1 through a slope of 0.5 s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.observer import Observer
from faultrecon.io.library import read_library
from faultrecon.methods.registry import method
from faultrecon.methods.sliding_letters import injection_gain
from faultrecon.methods.sliding_mode import coordinates
from faultrecon.numerics.discretise import zoh
from faultrecon.numerics.hinf import hinf_norm
from faultrecon.numerics.sliding import Canonical, linear_gain, sliding_motion
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.runtime.estimator import Estimator
from faultrecon.simulation.chance import normal_samples, stream_seed
from faultrecon.synthesis.certify import shipped
from faultrecon.synthesis.levels import pose
from faultrecon.synthesis.pipeline import design
from faultrecon.synthesis.result import Design

Array = NDArray[Any]

CHOSEN: dict[str, Any] = {"γ₀": 10.0, "w_y": 1.0}
"""The paper's γ0 = 10 and D1 = I."""
RHO = 1.0
"""The paper's bound of the injection, rad/s²."""
NOISE = 0.002
"""Standard deviation of the noise of each gyro, rad/s, independent from sample to sample."""
SETTLED = 1.0
"""Seconds that are left out of a root mean square."""
SENSOR = {"p": "roll_rate", "q": "pitch_rate", "r": "yaw_rate"}

FAULTS: dict[str, Callable[[Array], Array]] = {
    "ramp": lambda t: 0.01 * np.clip(t - 5.0, 0.0, 10.0),
    "sine": lambda t: 0.1 * np.sin(0.3 * t),
    "step": lambda t: 0.1 * np.clip((t - 5.0) / 0.5, 0.0, 1.0),
}


def aircraft(*faulty: str) -> Plant:
    """The library's plant with the gyros of these axes (p, q, r) at fault."""
    plant = read_library("admire")
    return replace(plant, faults=tuple(FaultChannel(f"f_{axis}", {SENSOR[axis]: 1.0}) for axis in faulty))


@lru_cache(maxsize=4)
def paper_design() -> Design:
    """The mildest P at a level that puts the norm of the sliding motion at the printed 1.2212."""
    return design(aircraft("q"), "sliding-mode", level=1.268376, fix=CHOSEN | {"p_min": 0.01}, pole_bound=None)


@lru_cache(maxsize=16)
def at_the_optimum(p_min: float) -> tuple[float, dict[str, Array]]:
    """The least level with P >= p_min I, and the gains where a solver stops on the way to it: one stage, no proof."""
    posed = pose(method("sliding-mode"), aircraft("q"), fix=CHOSEN | {"p_min": p_min})
    outcome = posed.optimum()
    return posed.theorem.level(outcome.objective), shipped(posed.theorem, outcome.values)


def form(plant: Plant) -> Canonical:
    """Its canonical coordinates, in which L is given."""
    return coordinates(plant).form


def motion(plant: Plant, L: Array) -> tuple[Array, Array, Array]:
    """(Ac, Bc, Cc) of [f'; ψ] -> f̂ - f in sliding."""
    return sliding_motion(form(plant), L)


def norm(plant: Plant, L: Array) -> float:
    """The gain from f' to f̂ - f in sliding, s."""
    Ac, Bc, Cc = motion(plant, L)
    q = len(plant.faults)
    return hinf_norm(Ac, Bc[:, :q], Cc, np.zeros((q, q))).value


def block_triangular(plant: Plant, L: Array, decay: float = 10.0) -> Observer:
    """The observer of a given L without a semidefinite program: errors of the outputs fall with exp(-decay t)."""
    own = form(plant)
    Gl = own.T_inverse @ linear_gain(own, L, -decay * np.eye(plant.p)) @ own.S
    return method("sliding-mode").observer(plant, {"G_n": injection_gain(plant, L), "G_l": Gl, "P0": np.eye(plant.p)})


# ---------------------------------------------------------------- flying


@dataclass(frozen=True, eq=False)
class Flight:
    """Times (N,), inputs (N, m), states (N, n) and healthy outputs (N, p) of a flight without fault or noise."""

    t: Array
    u: Array
    x: Array
    healthy: Array

    def outputs(self, F: Array, f: Array, noise: float = 0.0, seed: int = 0) -> Array:
        """What the sensors show, (N, p): with the faults f (N,) or (N, q), and noise of that standard deviation."""
        y = self.healthy + f.reshape(len(self.t), -1) @ F.T
        if noise:
            columns = [normal_samples(stream_seed(seed, f"noise/{j}"), len(self.t)) for j in range(y.shape[1])]
            y = y + noise * np.stack(columns, axis=1)
        return y


@lru_cache(maxsize=32)
def flight(h: float, duration: float, A: bytes | None = None, B: bytes | None = None) -> Flight:
    """The aircraft under its nominal control; A, B: the bytes of matrices that are really there instead."""
    from scipy.linalg import solve_continuous_are

    plant = read_library("admire")
    n, m = plant.B.shape
    K = plant.B.T @ solve_continuous_are(plant.A, plant.B, np.eye(n), np.eye(m))
    real = (plant.A if A is None else np.frombuffer(A).reshape(n, n), plant.B if B is None else np.frombuffer(B))
    Ad, Bd = zoh(real[0], real[1].reshape(n, m), h)
    t = h * np.arange(round(duration / h) + 1)
    r = _doublets(t)
    closed, drive = Ad - Bd @ K, r @ Bd.T
    x = np.zeros((len(t), n))
    for k in range(len(t) - 1):
        x[k + 1] = closed @ x[k] + drive[k]
    return Flight(t, r - x @ K.T, x, x @ plant.C.T)


def _doublets(t: Array) -> Array:
    """Pitch from 1 to 3 s by canard and elevons, roll from 8 to 10 s by the elevons; rad, (N, 4)."""

    def doublet(start: float) -> Array:
        return 1.0 * ((t >= start) & (t < start + 1.0)) - 1.0 * ((t >= start + 1.0) & (t < start + 2.0))

    pitch, roll = 0.045 * doublet(1.0), 0.03 * doublet(8.0)
    return np.stack([pitch, roll - pitch, -roll - pitch, 0.0 * t], axis=1)


def reconstructed(observer: Observer, flown: Flight, y: Array, start: Array | None = None, **options: Any) -> Array:
    """f̂ (N,) of the first fault, from the inputs that were held and the samples y; ρ = 1 unless said otherwise.

    start: the observer's first idea of the states, the true one by default.
    """
    h = float(flown.t[1] - flown.t[0])
    settings: dict[str, Any] = {"bound": RHO, **options}
    estimator = Estimator.build(observer, h, hold="left", **settings)
    return estimator.replay(flown.t, flown.u, y, x=np.zeros(flown.x.shape[1]) if start is None else start).fault[:, 0]


def ideal(plant: Plant, L: Array, f: Array, h: float) -> Array:
    """F(s) f at the samples (N,): what the sliding motion makes of straight lines from sample to sample."""
    Ac, Bc, Cc = motion(plant, L)
    Ad, Bd = zoh(Ac, Bc[:, :1], h)
    e, out = np.zeros(len(Ac)), np.zeros(len(f))
    drive = np.diff(f)[:, None] / h * Bd[:, 0]
    for k, d in enumerate(drive):
        e = Ad @ e + d
        out[k + 1] = Cc[0] @ e
    return f + out


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def error_and_change(t: Array, found: Array, f: Array) -> tuple[float, float]:
    """The root mean squares of f̂ - f and of what f̂ moves by from sample to sample, once settled."""
    keep = t >= SETTLED - 1e-9
    return rms((found - f)[keep]), rms(np.diff(found)[keep[1:]])


def wrong_models(seed: int, count: int = 12) -> Sequence[tuple[bytes, bytes]]:
    """(A, B) with every entry 10 % off, signs at random, where the nominal control still holds the aircraft."""
    from scipy.linalg import solve_continuous_are

    plant = read_library("admire")
    n, m = plant.B.shape
    K = plant.B.T @ solve_continuous_are(plant.A, plant.B, np.eye(n), np.eye(m))
    rng, found = np.random.default_rng(stream_seed(seed, "mismatch")), []
    while len(found) < count:
        A, B = (M * (1.0 + 0.1 * rng.choice([-1.0, 1.0], M.shape)) for M in (plant.A, plant.B))
        if np.linalg.eigvals(A - B @ K).real.max() < 0:
            found.append((A.tobytes(), B.tobytes()))
    return found
