# SPDX-License-Identifier: BSD-3-Clause
"""What the polytopic designs with a guaranteed variance share: the inequality, its premises, and what they refuse.

    ė = (A_v - G H_w) e + [drives, -G noise] white       over the corners A_v of the plant and H_w of the innovation

One X = P⁻¹ that satisfies the Lyapunov inequality at every corner bounds the covariance of the error along every
trajectory between the corners.  The cost is the trace: an L2 gain from fault rate and noise to the error has no
minimiser, since the algebraic inverse of the sensor attains it with a gain without bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.limits import Floor
from faultrecon.finding import Finding, InputError
from faultrecon.lmi.expr import Expr, I, __, given, let, sym, unknown
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.solve import solve
from faultrecon.methods.base import Assumed, Identity, Method, Scaling, Theorem, letters
from faultrecon.methods.scaled_conditions import SEE, interval_warnings, premise_warnings, scaling_findings
from faultrecon.methods.scaled_sensors import innovation_corners, interval, noise_intensity
from faultrecon.plant.fault import Disturbance
from faultrecon.plant.plant import Plant
from faultrecon.plant.sector import Sector

Array = NDArray[np.float64]

NOT_COVERED = (
    "does not cover sampling, rounding at run time, a plant that differs from the model, or what leaves the box"
)
FROZEN = "the error equation with the premise frozen at its estimate; it is no stability proof of the nonlinear error,"
"""What the vertices of A(z) cover: the premise is that of x̂, and what that leaves out is taken for noise."""


class GuaranteedVariance(Method):
    """Gains of least guaranteed variance over the vertices of a box; a method says which vertices, and how many gains.

    divided: innovations of faulty sensors divided by what they should show.  covered: the error equation, in words.
    """

    # The optimum is attained here, so the back-off is room for the proof alone: the gains stay those of least cost.
    backoff = 1e-4
    level_of = "deviation"
    divided: ClassVar[bool] = False
    covered: ClassVar[str] = FROZEN + " and holds"
    error: ClassVar[str] = "e = (x - x̂, f - f̂)"

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Multiplicative sensor faults, a polytopic form that is the plant's own equation, noise, and a fault rate."""
        found = scaling_findings(plant) or self.channel_findings(plant) or _declarations(plant)
        if found:
            return found
        try:
            own = self.sector(plant).findings()
            hindrances = [f for f in own if f.severity == "fatal"] or self.quadratic_findings(plant)
        except InputError as error:
            return [error.finding]
        return hindrances or [*interval_warnings(plant), *premise_warnings(self.sector(plant)), *own]

    # ------------------------------------------------------------ what a method may say

    def channel_findings(self, plant: Plant) -> list[Finding]:
        """What else the method asks of the way faults reach sensors."""
        return []

    def sector(self, plant: Plant) -> Sector:
        """The family whose vertices the error equation runs through."""
        return Sector.of(plant)

    def gain_names(self, vertices: int) -> list[str]:
        """The gains by vertex: one name for all of them, or one for each."""
        return vertices * ["G"]

    def innovations(self, plant: Plant) -> list[Array]:
        """What the innovation shows of the error at the corners of what that depends on, each (p, n + q)."""
        return innovation_corners(plant, divided=self.divided)

    def fault_scale(self, plant: Plant) -> Array:
        """What one unit of each fault counts in the error, (q,)."""
        return np.ones(len(plant.faults))

    def premises(self, plant: Plant) -> list[Assumed]:
        """What the vertices rest on."""
        sector = self.sector(plant)
        varying = [name for name in sector.family.names if name not in sector.measured]
        found = [agreement(sector, "A(z) x + B(z) u = f(x, u)"), bounds(sector)]
        if varying:
            text = f"(A(z) - A(ẑ)) x + (B(z) - B(ẑ)) u for {', '.join(varying)} is taken for noise of the declared size"
            found.append(Assumed("frozen premise", text, "assumed"))
        return found

    # ------------------------------------------------------------ what all of them have

    def error_vertices(self, plant: Plant) -> Array:
        """The state matrix of the error equation at every corner, (k, n, n)."""
        sector = self.sector(plant)
        return sector.vertices[:, :, : plant.n]

    def counted(self, plant: Plant) -> tuple[Disturbance, ...] | None:
        """All of them, as white noise of their sizes."""
        return plant.disturbances

    def floor(self, plant: Plant) -> Floor | None:
        """None is known for a variance over a box."""
        return None

    def quadratic_findings(self, plant: Plant) -> list[Finding]:
        """Whether one P makes the error decay at every vertex: He(P A_v - Y H_w) < -I, P > I, up to scale."""
        n, N, p = plant.n, plant.n + len(plant.faults), plant.p
        J, P, vertices = given("J_x", np.eye(N, n)), unknown("P", N, N, symmetric=True), self.error_vertices(plant)
        names = self.gain_names(len(vertices))
        Y = {name: unknown(f"Y{name[1:]}", N, p) for name in dict.fromkeys(names)}
        H = [given(f"H{w + 1}", value) for w, value in enumerate(self.innovations(plant))]
        claims = [(P - I(N) > 0).tagged("P > I")]
        for v, vertex in enumerate(vertices):
            for w, Hw in enumerate(H):
                D = P @ (J @ given(f"A{v + 1}", vertex) @ J.T) - Y[names[v]] @ Hw
                claims.append((D + D.T + I(N) < 0).tagged(f"vertex {v + 1},{w + 1}"))
        outcome = solve(Problem(claims))
        if outcome.status != "infeasible":
            return []
        shares = np.array([np.trace(dual) for dual in outcome.duals[1:]])
        return [_not_quadratic(plant, self.sector(plant), len(claims) - 1, claims[1 + int(np.argmax(shares))].label)]

    # fmt: off
    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """One P for all vertices; X = P⁻¹ bounds the covariance of the error along every trajectory in the box."""
        n, q, p, own = plant.n, len(plant.faults), plant.p, letters(plant, scaling)
        N, s, T, Ti = n + q, own, own.T, own.Ti
        Jx, Jf = given("J_x", np.eye(N, n)), given("J_f", np.eye(N, q, -n))
        Vi     = given("V⁻¹", np.diag([f.size for f in plant.faults]).reshape(q, q))
        to, back = let("T_a", Jx@T@Jx.T + Jf@Vi@Jf.T), let("T_a⁻¹", Jx@Ti@Jx.T + Jf@s["V"]@Jf.T)
        drives, noise = self.drives(plant), noise_intensity(plant, divided=self.divided)
        κ      = 2.0 ** -round(float(np.log2(_expected(drives, noise))))
        Q, r   = let("Q", κ*(back@given("drives", drives))), given("r", κ*noise)
        E      = let("E", given("1/sizes", np.diag(1 / self.sizes(plant)))@to)
        vertices = self.error_vertices(plant)
        names  = self.gain_names(len(vertices))
        P, Z   = (unknown(letter, N, N, symmetric=True) for letter in "PZ")
        Y, G   = ({name: unknown(letter + name[1:], N, p) for name in dict.fromkeys(names)} for letter in "YG")
        γ2, γ, lmis, drifts = unknown("γ²"), unknown("γ"), [], []
        H = [let(f"H_{w+1}", given(f"H{w+1}", value)@to) for w, value in enumerate(self.innovations(plant))]
        for v, (vertex, name) in enumerate(zip(vertices, names, strict=True)):
            A, Yv = let(f"A_{v+1}", Jx@(Ti@given(f"A{v+1}", vertex)@T)@Jx.T), Y[name]
            for w, Hw in enumerate(H):
                D = P@A - Yv@Hw
                drifts.append(D)
                lmis.append((sym([[ D + D.T, P@Q              , Yv@r  ],
                                  [ __     , -I(drives.shape[1]), 0     ],
                                  [ __     , __               , -I(noise.shape[1]) ]]) < 0).tagged(f"vertex {v+1},{w+1}"))
        cost = let("tr Z", trace(Z))
        ends = [(sym([[Z, E], [__, P]]) > 0).tagged("Z > E P⁻¹ Eᵀ"), (γ2 - cost > 0).tagged("γ² > tr Z")]
        return Theorem(
            self.name, [*lmis, *ends], minimise=γ2, gains={G[k]: to@P.inv()@Y[k] for k in G},
            prove_with={**{Y[k]: P@back@G[k] for k in G}, γ2: (κ*γ)**2},
            unit=κ, lyapunov=P, drift=drifts[0], drifts=drifts, readout=Jf.T, noise=Y[names[0]]@r, mildest=cost,
            criterion="least tr Z, the bound itself",
            identities=[Identity("T T⁻¹ = I", T@Ti - I(n)), Identity("V V⁻¹ = I", s["V"]@Vi - I(q), 2.0**-40)],
            premises=self.premises(plant),
            claim="Σ var(e/size) ≤ γ² for white noise of the declared sizes, and"
                  f" e(t)ᵀP e(t) ≤ e(0)ᵀP e(0) + ∫(|w|² + |n|²) dt for any, {self.error}",
            scope=f"covers {self.covered}, {_where(plant)}; {NOT_COVERED}",
        )
    # fmt: on

    def drives(self, plant: Plant) -> Array:
        """What drives the error, a column per unit white source: the declared disturbances, and each fault's rate."""
        n, q = plant.n, len(plant.faults)
        columns = [np.zeros((n + q, 0))]
        for d in plant.disturbances:
            column = np.zeros((n + q, 1))
            for name, c in d.into.items():
                column[plant.signals.x.index(name)] = c * d.size
            if column.any():
                columns.append(column)
        rates = np.zeros((n + q, q))
        rates[n:] = np.diag([f.rate for f in plant.faults] * self.fault_scale(plant))
        return np.hstack([*columns, rates])

    def sizes(self, plant: Plant) -> Array:
        """What an error of each state and fault counts: declared ranges, 1 where there is none, and sizes."""
        ranges = np.array(plant.signals.x.ranges, float)
        faults = [f.size for f in plant.faults] * self.fault_scale(plant)
        return np.concatenate([np.where(np.isfinite(ranges), ranges, 1.0), faults])


def trace(expr: Expr) -> Expr:
    """The trace of a square expression as a (1, 1) expression."""
    n = expr.shape[0]
    e = [given(f"e{k + 1}", np.eye(n)[:, [k]]) for k in range(n)]
    total = e[0].T @ expr @ e[0]
    for one in e[1:]:
        total = total + one.T @ expr @ one
    return total


def agreement(sector: Sector, equation: str) -> Assumed:
    """That the polytopic form is the plant's own equation, as far as it is."""
    return Assumed("exact form", f"{equation} {sector.agreement}", sector.agreement.verdict)


def bounds(sector: Sector) -> Assumed:
    """The bounds of the premises, as strong as the weakest of them."""
    basis = "assumed" if any(p.basis == "assumed" for p in sector.premises) else "proved"
    text = ", ".join(f"{p.name} in [{p.low:.6g}, {p.high:.6g}] ({p.basis})" for p in sector.premises)
    return Assumed("premise bounds", f"{text}: by interval arithmetic over the box where proved", basis)


def _expected(drives: Array, noise: Array) -> float:
    """About the size of the error: the root of drive times noise, as for one integrator behind one sensor."""
    return float(np.sqrt(np.abs(drives).max() * np.abs(noise).max()))


def _where(plant: Plant) -> str:
    assert plant.polytopic is not None
    ends: Sequence[tuple[str, tuple[float, float]]] = [
        *plant.polytopic.box.items(),
        *((f.name, interval(plant, f.name, f.size)) for f in plant.faults),
    ]
    return "while x, x̂ and u, f and f̂ stay in " + ", ".join(f"{k} in [{a:g}, {b:g}]" for k, (a, b) in ends)


# ---------------------------------------------------------------- what they refuse


def _declarations(plant: Plant) -> list[Finding]:
    """What a plant has to declare for a covariance: noise of every sensor, a rate of every fault, one way in each."""
    if plant.noise is None or not all(plant.noise.sd):
        return [_no_noise(plant)]
    still = [f.name for f in plant.faults if not np.isfinite(f.rate)]
    if still:
        return [
            Finding(
                f"no rate is declared for {', '.join(still)}",
                why="how fast the gain may drift, beside the noise, is what decides how fast the estimate is",
                evidence={"faults": still},
                remedies=(f"add rate = ... to the [[fault]] table of '{still[0]}'",),
                see=SEE,
            )
        ]
    both = [d.name for d in plant.disturbances if any(d.into.values()) and any(d.on.values())]
    return [_both_ways(both)] if both else []


def _both_ways(names: Sequence[str]) -> Finding:
    return Finding(
        f"{names[0]} acts on states and on sensors at once",
        why="noise and drive are taken to be independent of each other",
        evidence={"disturbances": list(names)},
        remedies=(f"split {names[0]} into two disturbances",),
        see=SEE,
    )


def _not_quadratic(plant: Plant, sector: Sector, blocks: int, hardest: str) -> Finding:
    """Farkas: the solver's dual excludes every P and G; it was checked in floating point."""
    ends = {p.name: [p.low, p.high] for p in sector.premises}
    what = f"no constant gain makes the error of {plant.name} decay at every vertex of the box"
    why = f"{blocks} inequalities contradict each other for every P and G, {hardest} above all (checked by its dual)"
    remedies = (
        "shrink the box of [polytopic]",
        "add a healthy sensor",
        "declare the slope in premises that vary alike",
    )
    return Finding(what, why, {"vertices": blocks, "hardest": hardest, "premises": ends}, remedies, SEE)


def _no_noise(plant: Plant) -> Finding:
    return Finding(
        f"{plant.name} declares no noise for some sensor",
        why="without noise the best gain is infinite",
        evidence={"sd": [] if plant.noise is None else list(plant.noise.sd)},
        remedies=("add a [noise] table with a positive sd for every sensor",),
        see=SEE,
    )
