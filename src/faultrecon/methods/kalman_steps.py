# SPDX-License-Identifier: BSD-3-Clause
"""A Kalman filter as a map from one sample to the next: mean and covariance are the state of an observer.

The augmented state is s = [x - x0; f; d], faults and decoupled disturbances being random walks; the observer's state is
z = [s; P - P0], P by its lower triangle, so that a start at zero has the covariance P0.  Sensors are taken one after the
other, since their noises are independent: no matrix is inverted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.conditions import decoupled_into
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import NonlinearTerm, Observer
from faultrecon.methods.sampled_letters import ranges_or_one
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]
Kind = Literal["extended", "unscented"]

UNSEEN = 1e-9
"""Of a sensor's noise: an innovation below it says that the sample lacked the sensor and holds its prediction instead."""
CENTRE = 1 / 3
"""Weight of the central sigma point; positive, so that no covariance can turn indefinite."""
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Tuning:
    """Covariances: Q (N, N) of what moves s in one sample time, R (p,) of the sensors, P0 (N, N) at the start."""

    Q: Array
    R: Array
    P0: Array


def tuned(plant: Plant, T: float) -> Tuning:
    """All of it from what the plant declares.

    R: sd².  An attenuated disturbance is white, with the energy of its size at half a second of memory.  A fault walks
    by its declared rate, else by its size in ten seconds, a decoupled disturbance by its size, per square root of a
    second.  P0: ranges of the states, one where none is declared; sizes of faults and disturbances.
    """
    from faultrecon.numerics.discretise import van_loan_covariance

    A, n = drift(plant), plant.n
    attenuated = [d for d in plant.attenuated if d.role != "decouple"]
    into = plant.E_w[:, [d.role != "decouple" for d in plant.attenuated]] * [d.size for d in attenuated]
    walks = [min(f.rate, 1e150) if np.isfinite(f.rate) else f.size / np.sqrt(10.0) for f in plant.faults]
    walks += [d.size for d in plant.attenuated if d.role == "decouple"]
    noise = np.zeros((len(A), len(attenuated) + len(walks)))
    noise[:n, : len(attenuated)] = into * np.sqrt(0.5)
    noise[n:, len(attenuated) :] = np.diag(walks)
    _, Q = van_loan_covariance(A, noise, np.eye(noise.shape[1]), T)
    assert plant.noise is not None, "the assumptions ask for it"
    sd = np.array(plant.noise.sd)
    start = [*ranges_or_one(plant), *(f.size for f in plant.faults)]
    start += [d.size for d in plant.attenuated if d.role == "decouple"]
    return Tuning(Q, np.square(np.where(sd > 0, sd, sd.max() * 1e-3)), np.diag(np.square(start)))


def drift(plant: Plant) -> Array:
    """The linear part of ṡ, (N, N)."""
    drives = np.hstack([plant.E_f, decoupled_into(plant)])
    N = plant.n + drives.shape[1]
    A = np.zeros((N, N))
    A[: plant.n] = np.hstack([plant.A, drives])
    return A


def sensors(plant: Plant) -> Array:
    """What the sensors show of s, (p, N)."""
    return np.hstack([plant.C, plant.F_f, np.zeros((plant.p, decoupled_into(plant).shape[1]))])


def filtering(plant: Plant, T: float, tuning: Tuning, steady: tuple[Array, Array], kind: Kind) -> Observer:
    """The observer; steady: A (N, N) and B (N, m+p) of the filter at rest, which its linear part then is."""
    n, q, m, p = plant.n, len(plant.faults), len(plant.signals.u), plant.p
    N = len(tuning.Q)
    nz = N + N * (N + 1) // 2
    A, B = np.zeros((nz, nz)), np.zeros((nz, m + p))
    A[:N, :N], B[:N] = steady
    free = np.full(nz + p, np.inf)
    direct = np.vstack([np.zeros((nz, m + p)), np.eye(p, m + p, m)])
    graph = _graph(plant, T, tuning, steady, kind)
    return Observer(
        A=A,
        B=B,
        Cx=np.eye(n, nz),
        Dx=np.zeros((n, m + p)),
        Cf=np.eye(q, nz, n),
        Df=np.zeros((q, m + p)),
        F=plant.F_f,
        x0=np.array(plant.point.x),
        u0=np.array(plant.point.u),
        y0=np.array(plant.point.y),
        nonlinear=NonlinearTerm(np.eye(nz), np.eye(nz + p, nz), np.zeros(nz + p), -free, free, graph, direct),
        sample_time=T,
    )


def at_rest(plant: Plant, T: float, tuning: Tuning) -> tuple[Array, Array] | None:
    """A and B of the filter at the operating point when its covariance has settled; None where it does not."""
    import casadi as ca
    from scipy.linalg import solve_discrete_are

    s, u, y = ca.SX.sym("s", len(tuning.Q)), ca.SX.sym("u", len(plant.signals.u)), ca.DM(plant.point.y)
    moved = flow(plant, T, s, u, y, ca.SX(0))
    slopes = ca.Function("slopes", [s, u], [ca.jacobian(moved, s), ca.jacobian(moved, u)])
    F, G = (np.array(M, dtype=float) for M in slopes(np.zeros(len(tuning.Q)), np.array(plant.point.u)))
    C = sensors(plant)
    try:
        P = solve_discrete_are(F.T, C.T, tuning.Q, np.diag(tuning.R))
        K = F @ P @ C.T @ np.linalg.inv(C @ P @ C.T + np.diag(tuning.R))
    except (np.linalg.LinAlgError, ValueError):
        return None
    A = F - K @ C
    if not np.isfinite(A).all() or np.abs(np.linalg.eigvals(A)).max() >= 1.0:
        return None
    return A, np.hstack([G - K @ plant.D, K])


def flow(plant: Plant, T: float, s: Any, u: Any, y: Any, t: Any) -> Any:
    """s after one classical Runge-Kutta step; u, y absolute and held, faults and disturbances too."""
    import casadi as ca

    n, term, known = plant.n, plant.nonlinearity, plant.known
    A, B, H = (ca.sparsify(ca.DM(M)) for M in (drift(plant)[:n], plant.B, plant.H))
    x0 = ca.DM(plant.point.x)

    def slope(x: Any, at: Any) -> Any:
        out = ca.mtimes(A, ca.vertcat(x, s[n:])) + ca.mtimes(B, u - ca.DM(plant.point.u))
        if known is not None:
            out = out + ca.mtimes(ca.DM(known.into), known.g.symbolic(y, u, t))
        if term is None:
            return out
        low, high = (ca.DM(end) for end in term.limits)
        read = ca.fmin(ca.fmax(ca.mtimes(H, x + x0), low), high)
        return out + ca.mtimes(ca.DM(term.into), term.phi.symbolic(read, u, at))

    x = s[:n]
    k1 = slope(x, t)
    k2 = slope(x + 0.5 * T * k1, t + 0.5 * T)
    k3 = slope(x + 0.5 * T * k2, t + 0.5 * T)
    k4 = slope(x + T * k3, t + T)
    return ca.vertcat(x + (T / 6.0) * (k1 + 2.0 * k2 + 2.0 * k3 + k4), s[n:])


# ---------------------------------------------------------------- the graph


def _graph(plant: Plant, T: float, tuning: Tuning, steady: tuple[Array, Array], kind: Kind) -> Graph:
    """z at the next sample less its linear part, of [z; y - y0], u and t."""
    import casadi as ca

    N, m = len(tuning.Q), len(plant.signals.u)
    triangle = [(i, j) for i in range(N) for j in range(i + 1)]
    nz, carry = N + len(triangle), {"extended": _extended, "unscented": _unscented}[kind]
    A, B = (ca.DM(M) for M in steady)

    def moved(argument: Any, u: Any, t: Any) -> Any:
        s, y = argument[:N], argument[nz:]
        P = ca.SX.zeros(N, N)
        for k, (i, j) in enumerate(triangle):
            P[i, j] = P[j, i] = argument[N + k] + float(tuning.P0[i, j])
        du = u - ca.DM(plant.point.u)
        linear = ca.mtimes(A, s) + ca.mtimes(B, ca.vertcat(du, y) if m else y)
        s, P = _corrected(plant, tuning, s, P, y - ca.mtimes(ca.DM(plant.D), du))
        s, P = carry(plant, T, s, P, u, y + ca.DM(plant.point.y), t)
        P = P + ca.DM(tuning.Q - tuning.P0)
        return ca.vertcat(s - linear, *(P[i, j] for i, j in triangle))

    return Graph.trace(moved, {"x": nz + plant.p, "u": m, "t": 1})


def _corrected(plant: Plant, tuning: Tuning, s: Any, P: Any, y: Any) -> tuple[Any, Any]:
    """Mean and covariance after the measurements y - D u; a sensor that the sample lacked corrects nothing."""
    import casadi as ca

    for i, row in enumerate(sensors(plant)):
        c = ca.sparsify(ca.DM(row)).T
        off, Pc = y[i] - ca.mtimes(c, s), ca.mtimes(P, c.T)
        seen = ca.if_else(ca.fabs(off) > UNSEEN * float(np.sqrt(tuning.R[i])), 1.0, 0.0)
        share = seen / (ca.mtimes(c, Pc) + float(tuning.R[i]))
        s, P = s + Pc * (share * off), _symmetric(P - share * ca.mtimes(Pc, Pc.T))
    return s, P


def _extended(plant: Plant, T: float, s: Any, P: Any, u: Any, y: Any, t: Any) -> tuple[Any, Any]:
    """The mean by the flow, the covariance by its slope there."""
    import casadi as ca

    at = ca.SX.sym("at", s.numel())
    moved = flow(plant, T, at, u, y, t)
    slope = ca.jacobian(moved, at)
    here, F = ca.substitute([moved, slope], [at], [s])
    return here, _symmetric(ca.mtimes(ca.mtimes(F, P), F.T))


def _unscented(plant: Plant, T: float, s: Any, P: Any, u: Any, y: Any, t: Any) -> tuple[Any, Any]:
    """Mean and covariance of 2 N + 1 points, each moved by the flow."""
    import casadi as ca

    N = s.numel()
    spread = _cholesky(P) * float(np.sqrt(N / (1.0 - CENTRE)))
    points = [s, *(s + spread[:, i] for i in range(N)), *(s - spread[:, i] for i in range(N))]
    weights = [CENTRE, *(2 * N * [(1.0 - CENTRE) / (2 * N)])]
    moved = [flow(plant, T, point, u, y, t) for point in points]
    mean = sum(w * point for w, point in zip(weights, moved, strict=True))
    off = [point - mean for point in moved]
    return mean, _symmetric(sum(w * ca.mtimes(e, e.T) for w, e in zip(weights, off, strict=True)))


def _cholesky(P: Any) -> Any:
    """The lower factor of P; a pivot that rounding has turned negative counts as nothing."""
    import casadi as ca

    N = P.shape[0]
    L = ca.SX.zeros(N, N)
    for j in range(N):
        pivot = ca.sqrt(ca.fmax(P[j, j] - sum((L[j, k] * L[j, k] for k in range(j)), ca.SX(0)), TINY))
        L[j, j] = pivot
        for i in range(j + 1, N):
            L[i, j] = (P[i, j] - sum((L[i, k] * L[j, k] for k in range(j)), ca.SX(0))) / pivot
    return L


def _symmetric(P: Any) -> Any:
    """The lower triangle, mirrored: rounding cannot make the two halves drift apart."""
    import casadi as ca

    return ca.tril2symm(ca.tril(ca.densify(P)))
