# SPDX-License-Identifier: BSD-3-Clause
"""What the observers for multiplicative sensor faults share: y = (1 + F f) h with h = C x, their scope and equations.

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

from faultrecon.diagnosis.existence import fault_findings
from faultrecon.finding import Finding, InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import NonlinearTerm, Observer
from faultrecon.plant.plant import Plant
from faultrecon.plant.sector import Sector

Array = NDArray[np.float64]
Ends = tuple[float, float]
SEE = "Bezzaoucha 2013, re-derived"
FADING = 0.01
"""Of the smallest reading in the box: below it a sensor shows nothing of its gain, and the estimate holds."""


def scaling_findings(plant: Plant, *, form: bool = True) -> list[Finding]:
    """What takes a plant out of the scope: sampled, faults that do not multiply, no polytopic form, readings near zero.

    form: whether a polytopic form is needed at all.
    """
    if plant.sample_time is not None:
        return [
            Finding(
                f"the plant is sampled every {plant.sample_time:g} s",
                why="the method is stated for continuous time",
                evidence={"sample_time": plant.sample_time},
                remedies=("write the plant in continuous time, without sample_time",),
                see=SEE,
            )
        ]
    for f in plant.faults:
        if f.site == "actuator" or f.effect == "additive":
            return [
                Finding(
                    f"fault '{f.name}' is {f.effect} on a{'n' if f.site[0] == 'a' else ''} {f.site}",
                    why="the method reconstructs the lost gain of a sensor, a multiplicative fault",
                    evidence={"fault": f.name, "site": f.site, "effect": f.effect},
                    remedies=('declare effect = "multiplicative" if the sensor loses gain', "use lipschitz-hinf"),
                    see=SEE,
                )
            ]
    found = fault_findings(plant)
    if found:
        return found
    if plant.known is not None:
        return [
            Finding(
                "the plant has a known term g(y, u, t)",
                why="the method writes the whole right-hand side as a function of x and u",
                evidence={"terms": plant.known.g.n_outputs},
                remedies=("write the term in [nonlinearity], with the states that y reads",),
                see=SEE,
            )
        ]
    return (_form_findings(plant) or _reading_findings(plant)) if form else []


def _form_findings(plant: Plant) -> list[Finding]:
    if plant.polytopic is None:
        return [
            Finding(
                f"{plant.name} declares no polytopic form",
                why="the method is about the vertices of A(z) with z between its bounds",
                evidence={"states": plant.n},
                remedies=("add a [polytopic] table to the plant file",),
                see=SEE,
            )
        ]
    term = plant.nonlinearity
    for name, (low, high) in {} if term is None else term.domain.items():
        least, most = plant.polytopic.box[name]
        if least < low or most > high:
            return [
                Finding(
                    f"the box of {name} is [{least:g}, {most:g}], the domain of phi [{low:g}, {high:g}]",
                    why="the observer keeps what phi reads in its domain, so beyond it the vertices are not its own",
                    evidence={"state": name, "box": [least, most], "domain": [low, high]},
                    remedies=("shrink polytopic.box", "widen nonlinearity.domain"),
                    see=SEE,
                )
            ]
    try:
        return [f for f in Sector.of(plant).findings() if f.severity == "fatal"]
    except InputError as error:
        return [error.finding]


def _reading_findings(plant: Plant) -> list[Finding]:
    """A sensor that reads zero shows nothing of its gain."""
    for i, (low, high) in enumerate(readings(plant)):
        if plant.F_f[i].any() and low <= 0 <= high:
            name = plant.signals.y.names[i]
            return [
                Finding(
                    f"{name} may read zero in the box: there its gain cannot be seen",
                    why=f"it reads between {low:.4g} and {high:.4g}, and a multiplicative fault moves zero by nothing",
                    evidence={"sensor": name, "low": low, "high": high},
                    remedies=("shrink the box of [polytopic]", f"add a sensor to compare {name} with"),
                    see=SEE,
                )
            ]
    return []


def interval_warnings(plant: Plant) -> list[Finding]:
    """Fault intervals that leave the healthy plant out."""
    found = []
    for f in plant.faults:
        low, high = interval(plant, f.name, f.size)
        if not low <= 0.0 <= high:
            found.append(
                Finding(
                    f"the interval [{low:g}, {high:g}] of '{f.name}' does not contain 0",
                    why="the healthy plant, and the estimate before the first sample, lie outside: nothing is covered"
                    " there",
                    evidence={"fault": f.name, "low": low, "high": high},
                    remedies=(f"declare polytopic.faults.{f.name} = [{min(low, 0.0):g}, {max(high, 0.0):g}]",),
                    see="Bezzaoucha 2013, section IV",
                    severity="warning",
                )
            )
    return found


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
    least = np.array([min(abs(a), abs(b)) for a, b in readings(plant)])
    by = np.where(plant.F_f.any(axis=1) & (least > 0), least, 1.0)
    return found / by[:, None]


# ---------------------------------------------------------------- the equations


def innovation(plant: Plant, x: Any, f: Any, y: Any, u: Any, *, divided: bool) -> Any:
    """y - (1 + F f̂) ĥ, (p, 1) symbols; divided: by ĥ where a fault sits, and zero where ĥ has faded."""
    import casadi as ca

    h = ca.DM(plant.point.y) + ca.DM(plant.C) @ (x - ca.DM(plant.point.x))
    if len(plant.signals.u):
        h = h + ca.DM(plant.D) @ (u - ca.DM(plant.point.u))
    nu = y - (1.0 + ca.DM(plant.F_f) @ f) * h
    if not divided:
        return nu
    parts = []
    for i, (low, high) in enumerate(readings(plant)):
        least = FADING * min(abs(low), abs(high))
        seen = ca.if_else(ca.fabs(h[i]) >= least, 1.0 / h[i], 0.0)
        parts.append(nu[i] * seen if plant.F_f[i].any() else nu[i])
    return ca.vertcat(*parts)


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
