# SPDX-License-Identifier: BSD-3-Clause
"""From gains to an observer that is a map: its prediction of the next sample, and what that is corrected by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.function import Graph
from faultrecon.graph.observer import CopiedTerm, NonlinearTerm, Observer
from faultrecon.methods.base import deviations
from faultrecon.methods.sampled_letters import Channels
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Prediction:
    """How far x moves in T seconds: T Φ (A x + B u + E f_a + g) and what φ adds.

    Φ (n, n).  stages: φ at the ends and in the middle of the interval as a graph in [x; f_a], u and t, all absolute;
    into (n, k) what they do.  Without stages φ is held, and moves x by T Φ times what enters.
    """

    Φ: Array
    stages: Graph | None = None
    into: Array | None = None


def runge_kutta(plant: Plant, T: float) -> Prediction:
    """One classical Runge-Kutta step with u and f_a held, its linear part in matrices.

    The argument of φ stays within its domain.
    """
    n, h = plant.n, T * plant.A
    I = np.eye(n)
    Φ = I + h @ (I / 2 + h @ (I / 6 + h / 24))
    if plant.nonlinearity is None:
        return Prediction(Φ)
    G = plant.G * (T / 6)
    into = np.hstack([(I + h @ (I + h @ (I / 2 + h / 4))) @ G, (2 * I + h @ (I + h / 2)) @ G, (2 * I + h) @ G, G])
    return Prediction(Φ, _stages(plant, T), into)


def _stages(plant: Plant, T: float) -> Graph:
    """φ at the four stages of a Runge-Kutta step, (4 r,)."""
    import casadi as ca

    n, faulty, term = plant.n, Channels.of(plant).actuator, plant.nonlinearity
    assert term is not None, "asked for where there is a φ"
    x0, u0 = ca.DM(plant.point.x), ca.DM(plant.point.u)
    A, B, E, G, H = (ca.sparsify(ca.DM(M)) for M in (plant.A, plant.B, plant.E_f @ faulty, term.into, plant.H))
    low, high = (ca.DM(end) for end in term.limits)

    def moved(xf: Any, u: Any, t: Any) -> Any:
        x, rest = xf[:n], ca.mtimes(B, u - u0) + ca.mtimes(E, xf[n:])
        k, found = None, []
        for share in (0.0, 0.5, 0.5, 1.0):
            at = x if k is None else x + (share * T) * k
            found.append(term.phi.symbolic(ca.fmin(ca.fmax(ca.mtimes(H, at), low), high), u, t + share * T))
            k = ca.mtimes(A, at - x0) + rest + ca.mtimes(G, found[-1])
        return ca.vertcat(*found)

    return Graph.trace(moved, {"x": n + faulty.shape[1], "u": len(plant.signals.u), "t": 1})


def assembled(plant: Plant, gains: Mapping[str, Array], prediction: Prediction) -> Observer:
    """The observer whose state [z; f̂_a] moves as predicted from [x̂; f̂_a], and by T L r and T F r.

    gains: T (1, 1), H (n+s, p), L (n+s, p), F (r, p); s sensor faults, r actuator faults.
    """
    own, n, (p, m) = Channels.of(plant), plant.n, plant.D.shape
    T, H = float(gains["T"].item()), gains["H"]
    ns, r = own.sensor.shape[1], own.actuator.shape[1]
    na = n + ns
    C = np.hstack([plant.C, plant.F_f @ own.sensor])
    move = T * np.vstack([prediction.Φ, np.zeros((ns + r, n))])  # what ẋ does to the state in one sample time
    K = T * np.vstack([gains["L"], gains["F"]])
    Cx = np.hstack([np.eye(na) - H @ C, np.zeros((na, r))])  # x̂_a = Cx z + Dx v
    Dx = np.hstack([-H @ plant.D, H])
    Cr, Dr = -C @ Cx, np.hstack([-plant.D, np.eye(p)]) - C @ Dx  # r = Cr z + Dr v
    step = np.eye(na + r, na) + move @ plant.A @ np.eye(n, na)
    A, B = step @ Cx + K @ Cr, step @ Dx + K @ Dr
    A[:, na:] += np.eye(na + r, r, -na) + move @ plant.E_f @ own.actuator
    B[:, :m] += move @ plant.B
    point = deviations(plant)
    nonlinear, copied = point.pop("nonlinear"), point.pop("copied")
    if prediction.stages is not None and prediction.into is not None:
        reads = np.vstack([Cx[:n], np.eye(r, na + r, na)])
        direct, free = np.vstack([Dx[:n], np.zeros((r, m + p))]), np.full(n + r, np.inf)
        offset = np.concatenate([point["x0"], np.zeros(r)])
        into = np.vstack([prediction.into, np.zeros((ns + r, prediction.into.shape[1]))])
        nonlinear = NonlinearTerm(into, reads, offset, -free, free, prediction.stages, direct)
    elif nonlinear is not None:
        sees = nonlinear.reads @ np.eye(n, na)
        ends = nonlinear.offset, nonlinear.lower, nonlinear.upper
        nonlinear = NonlinearTerm(move @ nonlinear.into, sees @ Cx, *ends, nonlinear.phi, sees @ Dx)
    faults = own.sensor @ np.eye(ns, na, n)
    return Observer(
        A=A,
        B=B,
        Cx=Cx[:n],
        Dx=Dx[:n],
        Cf=faults @ Cx + own.actuator @ np.eye(r, na + r, na),
        Df=faults @ Dx,
        F=plant.F_f,
        nonlinear=nonlinear,
        copied=None if copied is None else CopiedTerm(move @ copied.into, copied.g),
        sample_time=T,
        prior=np.eye(n, na + r),
        **point,
    )
