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
from faultrecon.methods.sampled_plants import moves
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Prediction:
    """How far x moves in T seconds: T Φ (A x + B u + E f + g) and what φ adds.

    Φ (n, n).  stages: φ at the ends and in the middle of the interval as a graph in [x; f], u and t, all absolute;
    into (n, k) what they do.  Without stages φ is held, and moves x by T Φ times what enters.
    """

    Φ: Array
    stages: Graph | None = None
    into: Array | None = None


def runge_kutta(plant: Plant, T: float) -> Prediction:
    """One classical Runge-Kutta step with u and f held, its linear part in matrices.

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

    n, term = plant.n, plant.nonlinearity
    assert term is not None, "asked for where there is a φ"
    x0, u0 = ca.DM(plant.point.x), ca.DM(plant.point.u)
    A, B, E, G, H = (ca.sparsify(ca.DM(M)) for M in (plant.A, plant.B, plant.E_f, term.into, plant.H))
    low, high = (ca.DM(end) for end in term.limits)

    def moved(xf: Any, u: Any, t: Any) -> Any:
        x, rest = xf[:n], ca.mtimes(B, u - u0) + ca.mtimes(E, xf[n:])
        k, found = None, []
        for share in (0.0, 0.5, 0.5, 1.0):
            at = x if k is None else x + (share * T) * k
            found.append(term.phi.symbolic(ca.fmin(ca.fmax(ca.mtimes(H, at), low), high), u, t + share * T))
            k = ca.mtimes(A, at - x0) + rest + ca.mtimes(G, found[-1])
        return ca.vertcat(*found)

    return Graph.trace(moved, {"x": n + len(plant.faults), "u": len(plant.signals.u), "t": 1})


def assembled(
    plant: Plant, own: Channels, gains: Mapping[str, Array], prediction: Prediction, *, idempotent: bool = True
) -> Observer:
    """The observer whose state [z; d̂] moves as predicted from [x̂_a; d̂], and by T L r and T F r.

    gains: T (1, 1), H (n+k, p), L (n+k, p), F (r, p); k faults are carried in x_a, r of them, or their rates, are d.
    idempotent: z is the whole prediction and x̂_a = J z + H y; else z is J times it and x̂_a = z + H y.
    """
    n, (p, m), q, (k, r) = plant.n, plant.D.shape, len(plant.faults), own.sizes
    T, H, na = float(gains["T"].item()), gains["H"], plant.n + own.sizes[0]
    C = np.hstack([plant.C, plant.F_f @ own.carried])
    J, whole = np.eye(na) - H @ C, np.eye(na + r)
    if not idempotent:
        J, whole[:na, :na] = np.eye(na), J
    move = T * whole[:, :n] @ prediction.Φ  # what ẋ does to the state in one sample time
    K = T * np.vstack([gains["L"], gains["F"]])
    Cx = np.hstack([J, np.zeros((na, r))])  # x̂_a = Cx z + Dx v
    Dx = np.hstack([-H @ plant.D, H])
    Cr, Dr = -C @ Cx, np.hstack([-plant.D, np.eye(p)]) - C @ Dx  # r = Cr z + Dr v
    step = whole[:, :na] + move @ np.hstack([moves(plant, plant.A), plant.E_f @ own.carried])
    A, B = step @ Cx + K @ Cr, step @ Dx + K @ Dr
    drives = T * whole[:, n:na] @ own.carried.T if own.ramp else move @ plant.E_f
    A[:, na:] += np.eye(na + r, r, -na) + drives @ own.driven
    B[:, :m] += move @ plant.B
    faults = own.carried @ np.eye(k, na, n)
    Cf, Df = faults @ Cx + (0.0 if own.ramp else own.driven @ np.eye(r, na + r, na)), faults @ Dx
    point = deviations(plant)
    nonlinear, copied = point.pop("nonlinear"), point.pop("copied")
    if prediction.stages is not None and prediction.into is not None:
        reads, direct, free = np.vstack([Cx[:n], Cf]), np.vstack([Dx[:n], Df]), np.full(n + q, np.inf)
        offset = np.concatenate([point["x0"], np.zeros(q)])
        nonlinear = NonlinearTerm(whole[:, :n] @ prediction.into, reads, offset, -free, free, prediction.stages, direct)
    elif nonlinear is not None:
        sees = nonlinear.reads @ np.eye(n, na)
        ends = nonlinear.offset, nonlinear.lower, nonlinear.upper
        nonlinear = NonlinearTerm(move @ nonlinear.into, sees @ Cx, *ends, nonlinear.phi, sees @ Dx)
    return Observer(
        A=A,
        B=B,
        Cx=Cx[:n],
        Dx=Dx[:n],
        Cf=Cf,
        Df=Df,
        F=plant.F_f,
        nonlinear=nonlinear,
        copied=None if copied is None else CopiedTerm(move @ copied.into, copied.g),
        sample_time=T,
        prior=np.eye(n, na + r) if idempotent else None,
        **point,
    )
