# SPDX-License-Identifier: BSD-3-Clause
"""The published inequality of Bezzaoucha et al. 2013 in numbers: its optimum, variants of it, and why K is zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from faultrecon.advise.papers._bezzaoucha2013_runs import MIDDLE, WIDE, boxed, loud, made, narrow, printed, repaired
from faultrecon.advise.reproductions import Comparison, Row
from faultrecon.finding import Impossible
from faultrecon.graph.ranges import ranges
from faultrecon.lmi.expr import Expr, I, Inequality, __, given, sym, zeros
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.solve import Outcome, solve
from faultrecon.lmi.walk import leaves, value_of
from faultrecon.methods.registry import method
from faultrecon.methods.takagi_sugeno import TsPublished, Unknowns, as_printed, compressed
from faultrecon.plant.sector import Sector
from faultrecon.synthesis.levels import pose
from faultrecon.synthesis.pipeline import optimum


def sector_form() -> Comparison:
    """Vertices and premise bounds, printed and computed."""
    sector = Sector.of(printed())
    A = [[-0.2, 15, 0, -10.7], [-0.2, 0.004, 0, -0.2028], [-1, 15, 0, -11.5], [-1, 0.004, 0, -1.0028]]
    rows = [
        Row(f"A_{i + 1}, entry {k}", float(sector.A[i].flat[k - 1]), v, 1e-14, True, printed=v, status="as_printed")
        for i, entries in enumerate(A)
        for k, v in enumerate(entries, start=1)
        if v
    ]
    box = {"x": [(0.02, 3.6), (0.05, 2.4)], "u": [(0.2, 1.0)]}
    family = sector.family
    (z2,) = ranges(family.premises.channel(1), box)
    rows += [
        Row("z2, lower bound", z2.low, 0.0040485829959514169, 1e-5, printed=0.004, status="as_printed", note=A_MISSING),
        Row("z2, upper bound", z2.high, 15.0, 1e-5, printed=15.0, status="as_printed", note=A_MISSING),
    ]
    free = Sector.of(replace(printed(), polytopic=replace(_form(), bounds={})))
    rows.append(Row("largest difference from the equation, 10,000 points", free.verify(10_000), 0.0, 1e-12, True))
    return Comparison("The sector form", rows, (ORDER,))


A_MISSING = "a is not printed: a = 0.5 on x1 in [0.02, 3.6], x2 in [0.05, 2.4] gives the printed bounds to their digits"
ORDER = (
    "M8: (54) pairs the weights with the wrong bounds; with z1 = F11 z1_max + F12 z1_min the printed A_i belong to (55)"
)


def _form() -> Any:
    form = printed().polytopic
    assert form is not None
    return form


# ---------------------------------------------------------------- the published theorem


@lru_cache(maxsize=1)
def printed_solved() -> tuple[Any, Outcome]:
    """The ten block rows as printed, with the corrections, and their optimum."""
    theorem = TsPublished().theorem_1_as_printed(printed())
    return theorem, solve(Problem(theorem.inequalities, theorem.minimise))


def published() -> Comparison:
    """Its optimum in three forms, and that its fault gain is zero there."""
    theorem, outcome = printed_solved()
    assert outcome.solved and outcome.objective is not None
    squared = optimum(printed(), "ts-published") ** 2
    K = max(float(np.abs(outcome.values[f"K̄{i}"]).max()) for i in range(1, 5))
    worst = max(-float(np.linalg.eigvalsh(value_of(i.positive, outcome.values)).min()) for i in theorem.inequalities)
    largest = np.linalg.eigh(outcome.values["P₁"])[1][:, 1]
    above = float(np.linalg.eigvalsh(outcome.values["Γ2"]).min() > 1)
    posed = pose(method("ts-published"), printed()).theorem.inequalities
    small = float(max(i.expr.shape[0] for i in posed if i.label.startswith("M_")))
    rows = [
        Row("β, compressed", squared, 2874.9845, 2e-5),
        Row("γ = √β", float(np.sqrt(squared)), 53.619, 2e-5, note=SQUARED),
        Row("β, ten block rows as printed", outcome.objective, 2874.9851, 2e-5),
        Row("β without the blocks of ΔB", optimum(printed(), "ts-published-known-input") ** 2, 380.352, 3e-5),
        Row("largest entry of K̄ at the optimum", K, 0.0, 1e-6, True, note=WHY),
        Row("change of the spectra when every K̄ turns its sign", _turned(), 0.0, 1e-12, True, note=WHY),
        Row("least eigenvalue of Γ2 less 1 is positive", above, 1.0, 0, True, note=WORSE),
        Row("worst violation over β", max(worst, 0.0) / squared, 0.0, 1e-6, True),
        Row("direction of P₁, second entry over first", float(largest[1] / largest[0]), 1 / 0.7, 0.02, note=NEARLY),
        Row("size of a block as printed", float(theorem.inequalities[0].expr.shape[0]), 28, 0, True),
        Row("size of a block, compressed", small, 10, 0, True),
    ]  # fmt: skip
    return Comparison("The published theorem", rows)


SQUARED = "M10: β bounds the squared gain"
WHY = (
    "the inequality is invariant under a change of sign of every K_i and its feasible set is convex: at the mean of a"
    " point and its mirror image K = 0, at the same β"
)
WORSE = "so β > 1 at every feasible point, while the estimator x̂ = 0, f̂ = 0 has the gain one"
NEARLY = "P₁ is nearly c, 1 times itself: L is no reproducible number, (1, -c) is its direction"


def _turned() -> float:
    """Largest relative change of an eigenvalue for random unknowns."""
    inequalities, _ = as_printed(Unknowns.of(printed()))
    rng, values, worst = np.random.default_rng(3), {}, 0.0
    for name, leaf in leaves([i.expr for i in inequalities], "unknown").items():
        M = rng.normal(size=leaf.shape)
        values[name] = M + M.T if leaf.args[1] else M
    other = {k: -v if k.startswith("K̄") else v for k, v in values.items()}
    for inequality in inequalities:
        a, b = (np.linalg.eigvalsh(value_of(inequality.expr, v)) for v in (values, other))
        worst = max(worst, float(np.abs(a - b).max() / np.abs(a).max()))
    return worst


# ---------------------------------------------------------------- variants


def variants() -> Comparison:
    """A rate of decay, bounds on L, and gains that are forced not to be zero."""
    rows = [
        Row(f"decay rate {rate:g}", _least(s := Unknowns.of(printed()), _decaying(s, rate)), value, 1e-4)
        for rate, value in ((0.1, 11365.92), (0.15, 45207.4))
    ]
    for bound, value in ((1.0, 5356.65), (10.0, 3325.35), (100.0, 3076.39)):
        rows.append(Row(f"P₁ > 1, |R_i| < {bound:g}", _bounded(bound)[0], value, 5e-5))
    rows.append(Row("P₁ > 1, R = 0", _forced(None), 71965.9, 1e-4, note="open loop"))
    for K, value in ((0.1, 5.80e5), (1.0, 5.09e7)):
        rows.append(Row(f"K = {K:g} forced, α < 0.05, R = 0", _forced(K), value, 0.01, note=ANTI))
    return Comparison("β of variants of the published inequality", rows)


ANTI = "the larger β, the better the estimate: with L = 0 and these K the fault is reconstructed, with the optimum not"


def _least(s: Unknowns, inequalities: Sequence[Inequality]) -> float | None:
    outcome = _outcome(s, inequalities)
    return outcome.objective if outcome.solved else None


def _outcome(s: Unknowns, inequalities: Sequence[Inequality]) -> Outcome:
    bounds = [(s.β * I(G.shape[0]) - G > 0) for G in s.Γ] + [(one > 0) for one in (s.P1, s.P2, *s.λ)]
    return solve(Problem([*inequalities, *bounds], s.β))


def _decaying(s: Unknowns, rate: float) -> list[Inequality]:
    n, q = s.P1.shape[0], s.P2.shape[0]
    found = []
    for one in compressed(s, True)[0]:
        if one.label.startswith("M_"):
            N = one.expr.shape[0]
            Jx, Jf = given("J_x", np.eye(N, n)), given("J_f", np.eye(N, q, -n))
            one = one.expr + 2 * rate * (Jx @ s.P1 @ Jx.T + Jf @ s.P2 @ Jf.T) < 0
        found.append(one)
    return found


@lru_cache(maxsize=4)
def _bounded(bound: float) -> tuple[float | None, Any]:
    """β with P₁ > 1 and |R_i| below a bound, and the values."""
    s = Unknowns.of(printed())
    n = s.P1.shape[0]
    more = [(s.P1 - I(n) > 0), *((_norm(R, bound) > 0) for R in s.R)]
    outcome = _outcome(s, [*compressed(s, True)[0], *more])
    return (outcome.objective if outcome.solved else None), outcome.values


def bounded_gains(bound: float) -> dict[str, np.ndarray]:
    """L_i, K_i and α_i of the published observer with P₁ > 1 and |R_i| below a bound."""
    values = _bounded(bound)[1]
    gains = {}
    for i in range(1, 5):
        gains[f"L{i}"] = np.linalg.solve(values["P₁"], values[f"R{i}"])
        gains[f"K{i}"] = np.linalg.solve(values["P₂"], values[f"K̄{i}"])
        gains[f"α{i}"] = np.linalg.solve(values["P₂"], values[f"ᾱ{i}"])
    return gains


def _norm(R: Expr, bound: float) -> Expr:
    """Positive when the Frobenius norm of R, a column here, is below the bound."""
    return sym([[bound * I(R.shape[1]), R.T], [__, bound * I(R.shape[0])]])


def _forced(K: float | None) -> float | None:
    """β with L = 0 and P₁ > 1; K: the same fault gain at every vertex, with α at most 0.05."""
    s = Unknowns.of(printed())
    n = s.P1.shape[0]
    s = replace(s, R=[zeros(n, 1)] * len(s.R))
    more = [s.P1 - I(n) > 0]
    if K is not None:
        s = replace(s, Kb=[K * s.P2] * len(s.Kb))
        more = [(0.1 * s.P2 - ab - ab.T > 0) for ab in s.ab]
    return _least(s, [*compressed(s, True)[0], *more])


# ---------------------------------------------------------------- tighter descriptions, repaired designs


def factors() -> Comparison:
    """How large the published description of the mismatch is, and what an affine one needs."""
    sector = Sector.of(printed())
    published_factor = float(np.linalg.norm(np.hstack(list(sector.A)), 2) * np.sqrt(len(sector.A)))
    width = sector.ends[1][1] - sector.ends[1][0]
    at = sector.family.at([[-0.5, 1.0], [-0.5, 0.0]])[:, :, :2]
    affine = float(width * np.linalg.norm(at[0] - at[1], 2))
    rows = [
        Row("|[A_1 … A_4]| √4, as published", published_factor, 52.84893, 1e-6),
        Row("affine in the premise that is not measured", affine, 18.30495, 1e-6),
        Row("premises that are measured", float(len(sector.measured)), 1, 0, True, note="z1 = -u: Δz1 = 0"),
        Row("limit of the state part with K = 0", (1 + 0.7**2) * (0.5 / 1.125) ** 2, 0.2943210, 1e-6, note=CLOSED),
    ]
    return Comparison("Descriptions of the mismatch", rows)


CLOSED = "(1 + c²)(width/(1 + f))²: what the unknown f alone does to x1 = y/(1 + f̂) and to x2 by mass balance"


def repaired_designs() -> Comparison:
    """Gains, deviations and boxes of the designs whose innovation keeps diag(ĥ) F."""
    r1, c1 = made(repaired(), "ts-guaranteed-cost"), made(narrow(), "ts-mean-value")
    rows = [
        Row(f"R1, G, entry {k + 1}", float(r1.gains["G"][k, 0]), v, 0.01)
        for k, v in enumerate((-0.0958, 0.0204, 2.0409))
    ]
    rows += [
        Row(f"C1, G, entry {k + 1}", float(c1.gains["G"][k, 0]), v, 0.012)
        for k, v in enumerate((0.03915, -0.04356, 3.87750))
    ]
    posed = pose(method("ts-mean-value"), narrow())
    sd = np.sqrt(np.diag(np.linalg.inv(posed.optimum().values["P"]))) / posed.theorem.unit
    rows += [
        Row(f"C1, bound on the deviation of {name}", float(sd[k]), v, 2e-3)
        for k, (name, v) in enumerate((("x1", 0.00700), ("x2", 0.00416), ("f", 0.01060)))
    ]
    proved = {"proved": 2.0, "checked": 1.0}
    for name, one, verdict in (("R1, certificate", r1, 0.0), ("C1, certificate", c1, 2.0)):
        rows.append(Row(name, proved.get(one.verification.verdict, 0.0), verdict, 0, True, note=VERDICTS))
    for name, box in (("x1 in [2.3, 3.6], x2 in [0.04, 0.7]", MIDDLE), ("the whole box", WIDE)):
        rows.append(Row(f"C, gains on {name}", _on(box), None, 0, note="no constant gain serves every vertex"))
    return Comparison("The repaired designs", rows)


VERDICTS = "2 proved, 1 checked, 0 assumed: R1 takes the mismatch of the frozen premise for noise of the declared size"


def _on(box: tuple[Any, ...]) -> float | None:
    """The deviation that the mean-value design proves on another box, None where it has no gains."""
    try:
        return made(loud(boxed(narrow(), *box), 6e-3), "ts-mean-value").level
    except Impossible:
        return None
