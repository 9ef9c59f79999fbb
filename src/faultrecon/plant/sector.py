# SPDX-License-Identifier: BSD-3-Clause
"""The sector transformation at work: vertices, weights, how exact the form is, and how far a trajectory is inside."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import Finding, InputError
from faultrecon.graph.function import Graph
from faultrecon.plant.plant import Plant
from faultrecon.plant.polytopic import MANY, MOST, Family, Polytopic, Premise, corners, weights

Array = NDArray[np.float64]

EXACT = 1e-12
"""Residual, beside the sizes of the terms, up to which a form counts as exact: rounded constants leave 1e-16 or so."""
POINTS = 10_000


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far a form is from the plant's own equations over the box, and how that is known.

    bound: of the absolute error.  verdict: "proved" in rational arithmetic, or "checked" at random points, the worst
    of which stood at `at`.
    """

    bound: float
    verdict: Literal["proved", "checked"]
    at: tuple[float, ...] = ()

    @property
    def exact(self) -> bool:
        """Whether only rounding is left."""
        return self.bound <= EXACT

    def __str__(self) -> str:
        how = "in rational arithmetic, not rechecked here" if self.verdict == "proved" else f"at {POINTS} random points"
        return f"up to {self.bound:.2g} on the box: {self.verdict} {how}"


@dataclass(frozen=True, eq=False)
class Sector:
    """A family of matrices of a plant between the bounds of its premises."""

    plant: Plant
    form: Polytopic
    family: Family

    @staticmethod
    @lru_cache(maxsize=32)
    def of(plant: Plant) -> Sector:
        """[A B] of the plant's polytopic form.  Raises InputError where it declares none."""
        form = _form(plant)
        return Sector(plant, form, form.sector)

    @staticmethod
    @lru_cache(maxsize=32)
    def slope_of(plant: Plant) -> Sector:
        """∂f/∂x of the plant: in the premises it declares, else in its own entries, each by itself."""
        form = _form(plant)
        return Sector(plant, form, entrywise(plant) if form.slope is None else form.slope)

    @cached_property
    def premises(self) -> tuple[Premise, ...]:
        """The premises between their bounds."""
        return self.form.premises(self.family)

    @cached_property
    def ends(self) -> list[tuple[float, float]]:
        """Lower and upper bound of each premise."""
        return [(p.low, p.high) for p in self.premises]

    @cached_property
    def vertices(self) -> Array:
        """The matrix at every corner, (2**p, rows, columns): the first premise changes slowest, upper bound first."""
        return self.family.at(corners(self.ends))

    @property
    def A(self) -> Array:
        """The state matrix at every corner, (2**p, n, n)."""
        return self.vertices[:, :, : self.plant.n]

    @property
    def B(self) -> Array:
        """The input matrix at every corner, (2**p, n, m); no columns for a slope."""
        return self.vertices[:, :, self.plant.n :]

    def premise_values(self, x: ArrayLike, u: ArrayLike) -> Array:
        """The premises along a trajectory: x (N, n), u (N, m), absolute; (N, p) back."""
        n, m = self.family.premises.sizes
        return self.family.premises.many(np.asarray(x, float).reshape(-1, n), np.asarray(u, float).reshape(-1, m))

    def weights(self, x: ArrayLike, u: ArrayLike) -> Array:
        """The weight of every vertex along a trajectory, (N, 2**p), never clipped."""
        return weights(self.premise_values(x, u), self.ends)

    def combined(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Σ μ_i M_i along a trajectory, (N, rows, columns)."""
        return np.einsum("ki,irc->krc", self.weights(x, u), self.vertices)

    def membership_margin(self, x: ArrayLike, u: ArrayLike) -> Array:
        """How far inside its bounds the nearest premise is at every sample, (N,), as a part of their distance.

        One half is the middle; below zero the combination is no longer convex, and what was certified for the vertices
        is void.
        """
        z = self.premise_values(x, u)
        low, high = np.array(self.ends).T
        return (np.minimum(z - low, high - z) / (high - low)).min(axis=1)

    def verify(self, points: int = POINTS, seed: int = 0) -> float:
        """The largest error of Σ μ_i M_i against the plant's own equations at random points of the box."""
        return _checked(self, points, seed).bound

    @cached_property
    def agreement(self) -> Agreement:
        """How exact the form is: proved where everything is rational and the same, else checked at random points."""
        from faultrecon.graph.rational import NotRationalError

        try:
            bound = _rational_residual(self)
        except NotRationalError:
            return _checked(self, POINTS, 0)
        # A difference that does not vanish is bounded crudely there; a point where it shows says more.
        return Agreement(bound, "proved") if bound <= EXACT else _checked(self, POINTS, 0)

    @cached_property
    def measured(self) -> tuple[str, ...]:
        """The premises that read no state: they are known, so they do not count as uncertain."""
        nodes = [self.family.premises.channel(k).nodes for k in range(len(self.family.names))]
        pairs = zip(self.family.names, nodes, strict=True)
        return tuple(name for name, own in pairs if not any(node[:2] == ("input", 0) for node in own))

    def findings(self) -> list[Finding]:
        """What speaks against the form: not the plant, or many vertices."""
        found, p = [], len(self.family.names)
        letter = self.family.letter
        if not self.agreement.exact:
            found.append(
                Finding(
                    f"the polytopic form {letter} is not the plant's own equation",
                    why=f"they differ by {self.agreement.bound:.4g} on the box ({self.agreement.verdict})",
                    evidence={"difference": self.agreement.bound, "at": list(self.agreement.at)},
                    remedies=("mend the premises or entries of [polytopic]", "mend phi in [nonlinearity]"),
                )
            )
        if p >= MANY:
            found.append(
                Finding(
                    f"{p} premises make {2**p} vertices",
                    why="every inequality is stated for each of them",
                    evidence={"premises": p, "vertices": 2**p, "measured": list(self.measured)},
                    remedies=("give a premise that hardly varies its value", "expect a minute of solving"),
                    severity="warning",
                )
            )
        return found


def right_side(plant: Plant) -> Graph:
    """f(x, u) of ẋ = f(x, u) as one graph of absolute x and u, without disturbances and faults.

    Raises InputError where the plant has a known term or depends on time.
    """
    term = plant.nonlinearity
    if plant.known is not None:
        raise InputError("a known term has no place in a polytopic form", remedies=("write it in phi",))
    if term is not None and any(node[:2] == ("input", 2) for node in term.phi.nodes):
        raise InputError("phi depends on time", why="a polytopic form is a function of x and u")

    def f(x: Any, u: Any) -> Any:
        import casadi as ca

        out = ca.DM(plant.A) @ (x - ca.DM(plant.point.x))
        if len(plant.signals.u):
            out = out + ca.DM(plant.B) @ (u - ca.DM(plant.point.u))
        if term is not None:
            out = out + ca.DM(term.into) @ term.phi.symbolic(ca.DM(plant.H) @ x, u, ca.SX(0.0))
        return ca.SX(ca.densify(out))

    graph = Graph.trace(f, {"x": plant.n, "u": len(plant.signals.u)})
    return replace(graph, inputs={"x": plant.signals.x.names, "u": plant.signals.u.names})


def entrywise(plant: Plant) -> Family:
    """∂f/∂x with each entry that varies as a premise of its own: no structure between them is used.

    Raises InputError where more than six entries vary.
    """
    entries = right_side(plant).jacobian("x").graph
    varying = [k for k in range(entries.n_outputs) if any(node[0] == "input" for node in entries.channel(k).nodes)]
    if len(varying) > MOST:
        raise InputError(
            f"{len(varying)} entries of df/dx vary",
            why=f"each would be a premise, and {MOST} are the most",
            remedies=("declare the slope in a few premises: [polytopic.slope]",),
        )
    names = tuple(f"slope_{k // plant.n + 1}_{k % plant.n + 1}" for k in varying)
    inputs = {"x": plant.signals.x.names, "u": plant.signals.u.names}
    outputs = tuple(entries.outputs[k] for k in varying)
    premises = Graph(inputs, entries.nodes, outputs)
    constants = entries(np.zeros(plant.n) + 1.0, np.zeros(len(plant.signals.u)) + 1.0)
    texts = [names[varying.index(k)] if k in varying else repr(float(constants[k])) for k in range(entries.n_outputs)]
    return Family(premises, Graph.from_texts(texts, {"z": names}), (plant.n, plant.n), "J")


def _form(plant: Plant) -> Polytopic:
    if plant.polytopic is None:
        raise InputError(
            f"{plant.name} declares no polytopic form",
            remedies=("add a [polytopic] table to the plant file", "ask for candidates: factorisations(plant)"),
        )
    return plant.polytopic


def _rational_residual(sector: Sector) -> float:
    """The largest |M(z(x, u)) [x; u] - f(x, u)|, or |M(z(x, u)) - ∂f/∂x|, over the box, in exact arithmetic."""
    from faultrecon.graph.rational import Ring

    plant, family = sector.plant, sector.family
    names = [*plant.signals.x, *plant.signals.u]
    ring, n = Ring(names), plant.n
    both = ring.variables
    x, u = both[:n], both[n:]
    f = ring.read(right_side(plant), x, u)
    M = ring.read(family.entries, ring.read(family.premises, x, u))
    box = [*sector.form.boxes["x"], *sector.form.boxes["u"]]
    if family.shape[1] == n and family is not sector.form.sector:
        rest = [M[i * n + j] - f[i].derivative(j) for i in range(n) for j in range(n)]
    else:
        width, rest = family.shape[1], []
        for i in range(n):
            total = -f[i]
            for j in range(width):
                total = total + M[i * width + j] * both[j]
            rest.append(total)
    return max((one.bound(box) for one in rest), default=0.0)


def _checked(sector: Sector, points: int, seed: int) -> Agreement:
    """The same at random points of the box, in floating point."""
    plant, form = sector.plant, sector.form
    rng = np.random.default_rng(seed)
    x, u = (np.array(form.boxes[g]).reshape(-1, 2) for g in ("x", "u"))
    x, u = (ends[:, 0] + rng.random((points, len(ends))) * (ends[:, 1] - ends[:, 0]) for ends in (x, u))
    f, M = right_side(plant), sector.combined(x, u)
    if sector.family is form.sector:
        error = np.abs(np.einsum("krc,kc->kr", M, np.hstack([x, u])) - f.many(x, u)).max(axis=1)
    else:
        error = np.abs(M - f.jacobian("x").many(x, u)).reshape(points, -1).max(axis=1)
    worst = int(np.argmax(error))
    return Agreement(float(error[worst]), "checked", (*map(float, x[worst]), *map(float, u[worst])))
