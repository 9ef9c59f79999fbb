# SPDX-License-Identifier: BSD-3-Clause
"""A Kalman filter as a map from one sample to the next: mean and covariance are the state of an observer.

The augmented state is s = [x - x0; f; d], faults and decoupled disturbances being random walks; the observer's state is
z = [s; P - P0], P by its lower triangle, so that a start at zero has the covariance P0.  Sensors are taken one after the
other, since their noises are independent: no matrix is inverted.  A sensor whose gain is at fault shows
(1 + F_m f) h, with h what it would show healthy; all others are linear in s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.conditions import decoupled_into
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import NonlinearTerm, Observer
from faultrecon.methods.sampled_letters import ranges_or_one
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

UNSEEN = 1e-9
"""Of a sensor's noise: an innovation below it says that the sample lacked the sensor and holds its prediction instead."""
CENTRE = 1 / 3
"""Weight of the central sigma point; positive, so that no covariance can turn indefinite."""
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Tuning:
    """Covariances: Q (N, N) of what moves s in one sample time, R (p,) of the sensors, P0 (N, N) at the start.

    gate: innovations whose square is more than this many of their variances are taken for a jump of the faults on that
    sensor, whose variances then grow by that of the start; infinite: none is.
    """

    Q: Array
    R: Array
    P0: Array
    gate: float = math.inf


def tuned(plant: Plant, T: float) -> Tuning:
    """All of it from what the plant declares.

    R: see `_shown_variances`.  An attenuated disturbance moves the states as white noise, with the energy of its size at
    half a second of memory; one with role "noise" is white of its size as it is.  A fault walks by its declared rate,
    else by its size in ten seconds, a decoupled disturbance by its size, per square root of a second.  P0: ranges of the
    states, one where none is declared; sizes of faults and disturbances.
    """
    from faultrecon.numerics.discretise import van_loan_covariance

    A, n = drift(plant), plant.n
    attenuated = [d for d in plant.attenuated if d.role != "decouple"]
    into = plant.E_w[:, [d.role != "decouple" for d in plant.attenuated]] * [d.size for d in attenuated]
    walks = [min(f.rate, 1e150) if np.isfinite(f.rate) else f.size / np.sqrt(10.0) for f in plant.faults]
    walks += [d.size for d in plant.attenuated if d.role == "decouple"]
    white = np.hstack([into * np.sqrt(0.5), _noises(plant)])
    noise = np.zeros((len(A), white.shape[1] + len(walks)))
    noise[:n, : white.shape[1]] = white
    noise[n:, white.shape[1] :] = np.diag(walks)
    _, Q = van_loan_covariance(A, noise, np.eye(noise.shape[1]), T)
    start = [*ranges_or_one(plant), *(f.size for f in plant.faults)]
    start += [d.size for d in plant.attenuated if d.role == "decouple"]
    return Tuning(Q, _shown_variances(plant), np.diag(np.square(start)))


def _shown_variances(plant: Plant) -> Array:
    """What varies in each sensor from sample to sample, (p,): the diagonal of diag(sd²) + F diag(size²) Fᵀ.

    A disturbance on one sensor and on nothing else is the noise of that sensor declared once more: the larger of the two
    counts.  Left out, since sensors are taken one after the other as independent: that one gust shows in several sensors
    (off the diagonal), and that it moves the states in the same sample time.  On the airliner this costs a sixth.
    """
    assert plant.noise is not None, "the assumptions ask for it"
    own, shared = np.zeros(plant.p), np.zeros(plant.p)
    for d in plant.disturbances:
        on = {plant.signals.y.index(name): c for name, c in d.on.items() if c and d.role != "decouple"}
        counted = shared if len(on) > 1 or any(d.into.values()) else own
        for i, c in on.items():
            counted[i] += np.square(c * d.size)
    sd = np.array(plant.noise.sd)
    return np.maximum(np.square(np.where(sd > 0, sd, sd.max() * 1e-3)), own) + shared


def drift(plant: Plant) -> Array:
    """The linear part of ṡ, (N, N)."""
    drives = np.hstack([plant.E_f, decoupled_into(plant)])
    N = plant.n + drives.shape[1]
    A = np.zeros((N, N))
    A[: plant.n] = np.hstack([plant.A, drives])
    return A


def _noises(plant: Plant) -> Array:
    """What disturbances with role "noise" do to the states, (n, k), in their sizes."""
    found = np.zeros((plant.n, len(plant.disturbances)))
    for column, d in zip(found.T, plant.disturbances, strict=True):
        for name, c in d.into.items() if d.role == "noise" else ():
            column[plant.signals.x.index(name)] = c * d.size
    return found[:, found.any(axis=0)]


def scaling_faults(plant: Plant) -> NDArray[np.bool_]:
    """Which faults multiply what their sensors show, (q,)."""
    return np.array([f.effect == "multiplicative" and f.site == "sensor" for f in plant.faults], dtype=bool)


def scaled(plant: Plant) -> NDArray[np.bool_]:
    """Which sensors have a gain at fault, (p,)."""
    return np.asarray((plant.F_f[:, scaling_faults(plant)] != 0).any(axis=1))


def sensors(plant: Plant) -> Array:
    """What the sensors show of s, (p, N); of a gain at fault, to first order at the operating point."""
    F = plant.F_f * np.where(scaling_faults(plant), np.array(plant.point.y)[:, None], 1.0)
    return np.hstack([plant.C, F, np.zeros((plant.p, decoupled_into(plant).shape[1]))])


def filtering(steps: Extended, steady: tuple[Array, Array]) -> Observer:
    """The observer; steady: A (N, N) and B (N, m+p) of the filter at rest, which its linear part then is."""
    plant, tuning = steps.plant, steps.tuning
    n, q, m, p = plant.n, len(plant.faults), len(plant.signals.u), plant.p
    N = len(tuning.Q)
    nz = N + N * (N + 1) // 2
    A, B = np.zeros((nz, nz)), np.zeros((nz, m + p))
    A[:N, :N], B[:N] = steady
    direct = np.vstack([np.zeros((nz, m + p)), np.eye(p, m + p, m)])
    free = np.full(nz + p, np.inf)
    term = NonlinearTerm(
        np.eye(nz), np.eye(nz + p, nz), np.zeros(nz + p), -free, free, _graph(steps, steady), direct, flat=True
    )
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
        nonlinear=term,
        sample_time=steps.T,
        scales=tuple(int(j) for j in np.flatnonzero(scaling_faults(plant))),
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


def _graph(steps: Extended, steady: tuple[Array, Array]) -> Graph:
    """z at the next sample less its linear part, of [z; y - y0], u and t."""
    import casadi as ca

    plant = steps.plant
    N, m = len(steps.tuning.Q), len(plant.signals.u)
    triangle = [(i, j) for i in range(N) for j in range(i + 1)]
    nz, start = N + len(triangle), steps.start()
    A, B = (ca.DM(M) for M in steady)

    def moved(argument: Any, u: Any, t: Any) -> Any:
        s, y = argument[:N], argument[nz:]
        P = ca.SX.zeros(N, N)
        for k, (i, j) in enumerate(triangle):
            P[i, j] = P[j, i] = argument[N + k] + float(start[i, j])
        du = u - ca.DM(plant.point.u)
        linear = ca.mtimes(A, s) + ca.mtimes(B, ca.vertcat(du, y) if m else y)
        direct = ca.mtimes(ca.DM(plant.D), du)
        s, P = steps.corrected(s, P, direct, y - direct)
        s, P = steps.carried(s, P, u, y + ca.DM(plant.point.y), t)
        P = P + (steps.drive(s) - ca.DM(start))
        return ca.vertcat(s - linear, *(P[i, j] for i, j in triangle))

    return Graph.trace(moved, {"x": nz + plant.p, "u": m, "t": 1})


# ---------------------------------------------------------------- the two halves of a step


@dataclass(frozen=True, eq=False)
class Extended:
    """The extended filter for one plant, sample time T and tuning; other filters override what differs.

    Symbols: s (N, 1), P (N, N), direct (p, 1) = D (u - u0), y (p, 1) measurements less y0 and `direct`.
    """

    plant: Plant
    T: float
    tuning: Tuning

    def start(self) -> Array:
        """P before the first sample, (N, N)."""
        return self.tuning.P0

    def drive(self, s: Any) -> Any:
        """What one sample time adds to P, (N, N)."""
        import casadi as ca

        return ca.DM(self.tuning.Q)

    def corrected(self, s: Any, P: Any, direct: Any, y: Any) -> tuple[Any, Any]:
        """Mean and covariance after the measurements; a sensor that the sample lacked corrects nothing."""
        import casadi as ca

        before = s
        for i, variance in enumerate(self.tuning.R):
            lacking = y[i] - self.shown(i, before, direct)
            seen = ca.if_else(ca.fabs(lacking) > UNSEEN * float(np.sqrt(variance)), 1.0, 0.0)
            s, P = self.corrected_by(i, s, P, direct, y[i], seen)
        return s, P

    def corrected_by(self, i: int, s: Any, P: Any, direct: Any, y: Any, seen: Any) -> tuple[Any, Any]:
        """Mean and covariance after sensor i; seen: 1, or 0 where it is to correct nothing."""
        import casadi as ca

        off, Pc, S = self.innovation(i, s, P, direct, y)
        jumps = self.jumps(i, s)
        if math.isfinite(self.tuning.gate) and jumps is not None:
            jumped = seen * ca.if_else(off * off > self.tuning.gate * S, 1.0, 0.0)
            P = P + jumped * jumps
            off, Pc, S = self.innovation(i, s, P, direct, y)
        share = seen / S
        return self.pushed(s, Pc * (share * off)), symmetric(P - share * ca.mtimes(Pc, Pc.T))

    def jumps(self, i: int, s: Any) -> Any:
        """What a jump of its faults adds to P when sensor i shows one, (N, N); None where it has none."""
        import casadi as ca

        n, own = self.plant.n, np.zeros(len(self.tuning.Q))
        own[n : n + len(self.plant.faults)] = self.plant.F_f[i] != 0
        return ca.diag(ca.DM(own * np.diag(self.tuning.P0))) if own.any() else None

    def pushed(self, s: Any, by: Any) -> Any:
        """The mean after a correction."""
        return s + by

    def shown(self, i: int, s: Any, direct: Any) -> Any:
        """What sensor i should show at s, less y0 and D (u - u0)."""
        import casadi as ca

        if not scaled(self.plant)[i]:
            return ca.mtimes(row(sensors(self.plant)[i]), s)
        n, q = self.plant.n, len(self.plant.faults)
        h, gain = self.healthy(i, s, direct), self.gain(i, s)
        added = row(self.plant.F_f[i] * ~scaling_faults(self.plant))
        return gain * h + ca.mtimes(added, s[n : n + q]) - float(self.plant.point.y[i]) - direct[i]

    def healthy(self, i: int, s: Any, direct: Any) -> Any:
        """What sensor i would show without faults, absolute."""
        import casadi as ca

        return float(self.plant.point.y[i]) + direct[i] + ca.mtimes(row(self.plant.C[i]), s[: self.plant.n])

    def gain(self, i: int, s: Any) -> Any:
        """1 + F_m f of sensor i."""
        import casadi as ca

        n, F = self.plant.n, self.plant.F_f[i] * scaling_faults(self.plant)
        return 1.0 + ca.mtimes(row(F), s[n : n + len(F)])

    def innovation(self, i: int, s: Any, P: Any, direct: Any, y: Any) -> tuple[Any, Any, Any]:
        """Of sensor i: the innovation, its covariance with s (N, 1), and its variance."""
        import casadi as ca

        c = row(sensors(self.plant)[i])
        if scaled(self.plant)[i]:
            at = ca.SX.sym("at", s.numel())
            c = ca.substitute(ca.jacobian(self.shown(i, at, direct), at), at, s)
        Pc = ca.mtimes(P, c.T)
        return y - self.shown(i, s, direct), Pc, ca.mtimes(c, Pc) + float(self.tuning.R[i])

    def carried(self, s: Any, P: Any, u: Any, y: Any, t: Any) -> tuple[Any, Any]:
        """The mean by the flow, the covariance by its slope there; without what drives it."""
        import casadi as ca

        at = ca.SX.sym("at", s.numel())
        moved = flow(self.plant, self.T, at, u, y, t)
        slope = ca.jacobian(moved, at)
        here, F = ca.substitute([moved, slope], [at], [s])
        return here, symmetric(ca.mtimes(ca.mtimes(F, P), F.T))


class Unscented(Extended):
    """The unscented filter: 2 N + 1 points, each moved by the flow, and shown by sensors whose gain is at fault."""

    def innovation(self, i: int, s: Any, P: Any, direct: Any, y: Any) -> tuple[Any, Any, Any]:
        """Of the points that lie around s; a linear sensor needs none."""
        if not scaled(self.plant)[i]:
            return super().innovation(i, s, P, direct, y)
        points, weights = _points(s, P)
        read = [self.shown(i, point, direct) for point in points]
        mean = sum(w * one for w, one in zip(weights, read, strict=True))
        Pc = sum(w * (one - mean) * (point - s) for w, one, point in zip(weights, read, points, strict=True))
        S = sum(w * (one - mean) * (one - mean) for w, one in zip(weights, read, strict=True))
        return y - mean, Pc, S + float(self.tuning.R[i])

    def carried(self, s: Any, P: Any, u: Any, y: Any, t: Any) -> tuple[Any, Any]:
        """Mean and covariance of the points, each moved by the flow."""
        import casadi as ca

        points, weights = _points(s, P)
        moved = [flow(self.plant, self.T, point, u, y, t) for point in points]
        mean = sum(w * point for w, point in zip(weights, moved, strict=True))
        off = [point - mean for point in moved]
        return mean, symmetric(sum(w * ca.mtimes(e, e.T) for w, e in zip(weights, off, strict=True)))


def _points(s: Any, P: Any) -> tuple[list[Any], list[float]]:
    """2 N + 1 points around s with the covariance P, and their weights."""
    N = s.numel()
    spread = _cholesky(P) * float(np.sqrt(N / (1.0 - CENTRE)))
    points = [s, *(s + spread[:, i] for i in range(N)), *(s - spread[:, i] for i in range(N))]
    return points, [CENTRE, *(2 * N * [(1.0 - CENTRE) / (2 * N)])]


def row(values: Array) -> Any:
    """A row of numbers, its zeros left out."""
    import casadi as ca

    return ca.sparsify(ca.DM(values)).T


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


def symmetric(P: Any) -> Any:
    """The lower triangle, mirrored: rounding cannot make the two halves drift apart."""
    import casadi as ca

    return ca.tril2symm(ca.tril(ca.densify(P)))
