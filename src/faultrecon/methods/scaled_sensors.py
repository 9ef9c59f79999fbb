# SPDX-License-Identifier: BSD-3-Clause
"""What the observers for multiplicative sensor faults share: y = (1 + F f) h with h = C x, and their equations.

    y - ŷ = (1 + F f) C e_x + diag(ĥ) F e_f        e = (x - x̂, f - f̂),  ĥ what x̂ says the sensors should show

is exact, and linear in the error: f shows in the innovation as long as ĥ is not zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.function import Graph
from faultrecon.graph.observer import NonlinearTerm, Observer
from faultrecon.plant.plant import Plant
from faultrecon.plant.sector import Sector

Array = NDArray[np.float64]
Ends = tuple[float, float]
FADING = 0.01
"""Of the smallest reading in the box: below it a sensor shows nothing of its gain, and the estimate holds."""


# ---------------------------------------------------------------- intervals and corners


def interval(plant: Plant, name: str, size: float) -> Ends:
    """The interval of one fault."""
    return (-size, size) if plant.polytopic is None else plant.polytopic.fault_interval(name, size)


def readings(plant: Plant) -> list[Ends]:
    """What each healthy sensor shows while x and u stay in the box."""
    assert plant.polytopic is not None
    boxes = plant.polytopic.boxes
    low, high = np.array([*boxes["x"], *boxes["u"]]).T
    rest = np.array([*plant.point.x, *plant.point.u])
    M = np.hstack([plant.C, plant.D])
    up, down = np.maximum(M, 0.0), np.minimum(M, 0.0)
    y0 = np.array(plant.point.y)
    least, most = y0 + up @ (low - rest) + down @ (high - rest), y0 + up @ (high - rest) + down @ (low - rest)
    return list(zip(map(float, least), map(float, most), strict=True))


def gains_between(plant: Plant) -> list[Ends]:
    """1 + F f per sensor while the faults stay in their intervals."""
    ends = np.array([interval(plant, f.name, f.size) for f in plant.faults]).reshape(-1, 2)
    up, down = np.maximum(plant.F_f, 0.0), np.minimum(plant.F_f, 0.0)
    low, high = 1.0 + up @ ends[:, 0] + down @ ends[:, 1], 1.0 + up @ ends[:, 1] + down @ ends[:, 0]
    return list(zip(map(float, low), map(float, high), strict=True))


def own_rows(plant: Plant) -> list[int]:
    """The sensor that each fault sits on."""
    return [int(np.argmax(np.abs(column))) for column in plant.F_f.T]


def innovation_corners(plant: Plant, *, divided: bool) -> list[Array]:
    """H = [(1 + F f) C, diag(ĥ) F] at the corners of what it depends on, each (p, n + q).

    divided: rows of faulty sensors divided by ĥ, H = [(1 + F f)/ĥ C, F]: one interval instead of two.
    """
    rows: list[list[Array]] = []
    for i, (gain, shown) in enumerate(zip(gains_between(plant), readings(plant), strict=True)):
        C, F = plant.C[i], plant.F_f[i]
        if not F.any():
            rows.append([np.concatenate([C, F])])
        elif divided:
            ratios = [g / h for g in gain for h in shown]
            rows.append([np.concatenate([ratio * C, F]) for ratio in (max(ratios), min(ratios))])
        else:
            rows.append([np.concatenate([g * C, h * F]) for g in reversed(gain) for h in reversed(shown)])
    return [np.array(chosen) for chosen in product(*rows)]


def noise_intensity(plant: Plant, *, divided: bool) -> Array:
    """What unit white sources on the sensors count in the innovation, (p, k): sd times the root of its hold time for
    each sensor's noise, then the disturbances that act on sensors, in their sizes.

    divided: as `innovation_corners`; the smallest reading of the box then counts.
    """
    assert plant.noise is not None
    columns = [np.diag(math.sqrt(plant.noise.hold) * np.array(plant.noise.sd))]
    for disturbance in plant.disturbances:
        if any(disturbance.on.values()):
            column = np.zeros((plant.p, 1))
            for name, coefficient in disturbance.on.items():
                column[plant.signals.y.index(name)] = coefficient * disturbance.size
            columns.append(column)
    found = np.hstack(columns)
    if not divided:
        return found
    least = least_readings(plant)
    by = np.where(plant.F_f.any(axis=1) & (least > 0), least, 1.0)
    return found / by[:, None]


# ---------------------------------------------------------------- the equations


def innovation(plant: Plant, x: Any, f: Any, y: Any, u: Any, *, divided: bool) -> Any:
    """y - (1 + F f̂) ĥ, (p, 1) symbols; divided: by ĥ where a fault sits, and zero where ĥ has faded."""
    import casadi as ca

    h = expected(plant, x, u)
    nu = y - (1.0 + ca.DM(plant.F_f) @ f) * h
    if not divided:
        return nu
    parts = []
    for i, least in enumerate(faded(plant)):
        seen = ca.if_else(ca.fabs(h[i]) >= float(least), 1.0 / h[i], 0.0)
        parts.append(nu[i] * seen if plant.F_f[i].any() else nu[i])
    return ca.vertcat(*parts)


def memberships(sector: Sector, x: Any, u: Any) -> list[Any]:
    """The weight of every vertex at x̂ and u, symbols; premises beyond their bounds count as at the bound.

    The weights of faults are never kept anywhere: (1 + F f̂) ĥ is written as it is, for any f̂.
    """
    import casadi as ca

    z, found = sector.family.premises.symbolic(x, u), [ca.SX(1.0)]
    for k, (low, high) in enumerate(sector.ends):
        upper = (ca.fmin(ca.fmax(z[k], low), high) - low) / (high - low)
        found = [weight * share for weight in found for share in (upper, 1.0 - upper)]
    return found


def expected(plant: Plant, x: Any, u: Any) -> Any:
    """ĥ: what healthy sensors would show, (p, 1) symbols."""
    import casadi as ca

    h = ca.DM(plant.point.y) + ca.DM(plant.C) @ (x - ca.DM(plant.point.x))
    return h + ca.DM(plant.D) @ (u - ca.DM(plant.point.u)) if len(plant.signals.u) else h


def faded(plant: Plant) -> Array:
    """Readings below which a sensor shows nothing of its gain, (p,)."""
    return FADING * (np.abs(plant.point.y) if plant.polytopic is None else least_readings(plant))


def least_readings(plant: Plant) -> Array:
    """The smallest reading in the box, (p,)."""
    return np.array([min(abs(a), abs(b)) for a, b in readings(plant)])


def model(plant: Plant, x: Any, u: Any, t: Any) -> Any:
    """f(x̂, u, t), with φ kept in its domain."""
    import casadi as ca

    term = plant.nonlinearity
    out = ca.DM(plant.A) @ (x - ca.DM(plant.point.x))
    if len(plant.signals.u):
        out = out + ca.DM(plant.B) @ (u - ca.DM(plant.point.u))
    if term is None:
        return out
    read = ca.DM(plant.H) @ x
    for i, (low, high) in enumerate(zip(*term.limits, strict=True)):
        read[i] = ca.fmax(read[i], float(low)) if math.isfinite(low) else read[i]
        read[i] = ca.fmin(read[i], float(high)) if math.isfinite(high) else read[i]
    return out + ca.DM(term.into) @ term.phi.symbolic(read, u, t)


Correction = Callable[[Any, Any, Any, Any], Any]
"""What is added to (f(x̂, u), 0), (n + q, 1) symbols from x̂, f̂, y and u."""


def observer_of(plant: Plant, correction: Correction) -> Observer:
    """ẋ̂ = f(x̂, u) + ..., f̂' = ... with the corrections given: z = [x̂ - x0; f̂].

    The linear part is that of the whole at the operating point without fault, so that poles and exponentials mean
    something; the samples y enter through the nonlinear part alone.
    """
    n, q, (p, m) = plant.n, len(plant.faults), plant.D.shape

    def whole(a: Any, u: Any, t: Any) -> Any:
        import casadi as ca

        x, f, y = a[:n], a[n : n + q], a[n + q :]
        return ca.SX(ca.densify(ca.vertcat(model(plant, x, u, t), ca.SX.zeros(q, 1)) + correction(x, f, y, u)))

    sizes = {"x": n + q + p, "u": m, "t": 1}
    graph = Graph.trace(whole, sizes)
    at = np.concatenate([plant.point.x, np.zeros(q), plant.point.y])
    u0 = np.array(plant.point.u)
    A = graph.jacobian("x")(at, u0, [0.0])[:, : n + q]
    B = graph.jacobian("u")(at, u0, [0.0]) if m else np.zeros((n + q, 0))

    def rest(a: Any, u: Any, t: Any) -> Any:
        import casadi as ca

        line = ca.DM(A) @ (a[: n + q] - ca.DM(at[: n + q]))
        return graph.symbolic(a, u, t) - (line + ca.DM(B) @ (u - ca.DM(u0)) if m else line)

    endless = np.full(n + q + p, np.inf)
    reads, direct = np.eye(n + q + p, n + q), np.hstack([np.zeros((n + q + p, m)), np.eye(n + q + p, p, -(n + q))])
    term = NonlinearTerm(np.eye(n + q), reads, at, -endless, endless, Graph.trace(rest, sizes), direct)
    return Observer(
        A=A,
        B=np.hstack([B, np.zeros((n + q, p))]),
        Cx=np.eye(n, n + q),
        Dx=np.zeros((n, m + p)),
        Cf=np.eye(q, n + q, n),
        Df=np.zeros((q, m + p)),
        F=plant.F_f,
        x0=np.array(plant.point.x),
        u0=u0,
        y0=np.array(plant.point.y),
        nonlinear=term,
        scales=tuple(range(q)),
    )
