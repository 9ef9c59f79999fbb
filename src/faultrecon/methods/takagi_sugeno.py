# SPDX-License-Identifier: BSD-3-Clause
"""State and multiplicative sensor fault by a Takagi-Sugeno observer, as published: kept for reference, and flagged.

The published inequality bounds the dependence of the innovation on f - f̂ as an uncertainty that multiplies x.  That
removes the only path from the fault error to the innovation.  Let D = diag(I, -I, I, -I, -I, I, I, I, I, I): every block
of the inequality is invariant under D · D except those that hold K, which change sign; the feasible set is convex, so
the mean of a point and its mirror image is feasible at the same β with K = 0.  Every optimum of a convex solver is that
mean.  And β > 1 in any case, while the estimator x̂ = 0, f̂ = 0 has the gain one.

Corrections to the printed text: M1 (10) sums over k with F_k; M2 (20) stacks C̃_j; M3 (20) E_C holds 2^q copies of I_n;
M4 (27), (28) have f' where f̂ is printed; M5 (41) I_(n+q); M6 (44) its block (3,3) is -Γ₁; M7 (46) the sign of E_C is
free; M8 (54) pairs F₁₁ with the upper bound; M9 (57) C̃_1 belongs to the upper bound; M10 Γ_k are unknowns, and β
bounds the squared gain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.limits import Floor
from faultrecon.finding import Finding
from faultrecon.graph.observer import Observer
from faultrecon.lmi.expr import Expr, I, Inequality, __, given, let, sym, unknown, zeros
from faultrecon.methods.base import Assumed, Identity, Method, Scaling, Theorem
from faultrecon.methods.papers import BEZZAOUCHA_2013
from faultrecon.methods.scaled_conditions import interval_warnings, premise_warnings, scaling_findings
from faultrecon.methods.scaled_sensors import innovation, interval, memberships, observer_of
from faultrecon.plant.fault import Disturbance
from faultrecon.plant.plant import Plant
from faultrecon.plant.polytopic import corners
from faultrecon.plant.sector import Sector

Array = NDArray[np.float64]

DISCONNECTED = "the fault estimate is disconnected from the measurement (K = 0): proved for this inequality"
ROUNDED = 2.0**-40
"""Of the largest entry: what rounding leaves of F Fᵀ - Σ A_i A_iᵀ."""


class TsPublished(Method):
    """Theorem 1, with its corrections: exact, and of no use as a fault estimator."""

    name = "ts-published"
    summary = (
        "reference: Takagi-Sugeno observer for multiplicative sensor faults as published; its estimate stays at zero"
    )
    paper = BEZZAOUCHA_2013
    uncertain_inputs: ClassVar[bool] = True

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Multiplicative sensor faults and an exact polytopic form; warned of: K = 0, and intervals without 0."""
        found = scaling_findings(plant)
        if found:
            return found
        sector = Sector.of(plant)
        return [_disconnected(plant), *interval_warnings(plant), *premise_warnings(sector), *sector.findings()]

    def counted(self, plant: Plant) -> tuple[Disturbance, ...] | None:
        """None: the level counts x, f, f' and u, which persist."""
        return None

    def floor(self, plant: Plant) -> Floor | None:
        """The estimator x̂ = 0, f̂ = 0 has e = (x, f), a part of ω: its gain is one, and no theorem is needed for it."""
        return None

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """Theorem 1 in the compressed form: P₁ [A_1 … A_r] enters through Σ A_i A_iᵀ alone, rows 3 and 6 stand alone."""
        s = Unknowns.of(plant)
        return self.stated(plant, s, compressed(s, self.uncertain_inputs))

    def theorem_1_as_printed(self, plant: Plant) -> Theorem:
        """Theorem 1 with its ten block rows as printed: the same optimum, in blocks that grow with r and 2^q."""
        s = Unknowns.of(plant)
        return self.stated(plant, s, as_printed(s))

    # fmt: off
    def stated(self, plant: Plant, s: Unknowns, inequalities: tuple[list[Inequality], list[Identity]]) -> Theorem:
        """What both forms of the inequality share."""
        β, γ, n, q = s.β, unknown("γ"), plant.n, len(plant.faults)
        P = let("P", sym([[s.P1, zeros(n, q)], [__, s.P2]]))
        drifts = [_blocks(s.P1@A - R@C, zeros(n, q), -Kb@C, -ab) for A, R, Kb, ab in zip(s.A, s.R, s.Kb, s.ab, strict=True) for C in s.C]
        L, K, α = ([unknown(f"{letter}{i+1}", *one.shape) for i, one in enumerate(many)] for letter, many in zip("LKα", (s.R, s.Kb, s.ab), strict=True))
        gains = {g: s.P1.inv()@R for g, R in zip(L, s.R, strict=True)}
        gains |= {g: s.P2.inv()@Kb for g, Kb in zip((*K, *α), (*s.Kb, *s.ab), strict=True)}
        back = {R: s.P1@g for g, R in zip(L, s.R, strict=True)} | {Kb: s.P2@g for g, Kb in zip((*K, *α), (*s.Kb, *s.ab), strict=True)}
        bounds = [(β*I(Γ.shape[0]) - Γ > 0).tagged(f"{Γ} < β") for Γ in s.Γ] + [(one > 0).tagged(f"{one} > 0") for one in (s.P1, s.P2, *s.λ)]
        sector = Sector.of(plant)
        return Theorem(
            "1", [*inequalities[0], *bounds], minimise=β, gains=gains, prove_with={**back, β: γ*γ}, lyapunov=P,
            drift=drifts[0], drifts=drifts, readout=given("J_f", np.eye(q, n + q, n)), noise=given("no noise", np.zeros((n + q, 0))), mildest=P,
            identities=inequalities[1],
            premises=[Assumed("exact form", f"A(z) x + B(z) u = f(x, u) {sector.agreement}", sector.agreement.verdict), _bounds(sector)],
            claim="∫|e|² dt ≤ γ² ∫(|x|² + |f|² + |f'|² + |u|²) dt + V(e(0)), e = (x - x̂, f - f̂); " + DISCONNECTED,
            scope="covers the continuous-time error system while every premise of x and of x̂ stays between its bounds and f and f̂ in"
                  f" {_intervals(plant)}; x and u persist, so it says nothing about convergence; does not cover sampling,"
                  " rounding at run time, or a plant that differs from the model",
        )
    # fmt: on

    def notes(self, plant: Plant, gains: Mapping[str, Array]) -> tuple[str, ...]:
        """How far from zero the fault gain is in these numbers."""
        largest = max(float(np.abs(v).max()) for k, v in gains.items() if k.startswith("K"))
        return (f"the largest entry of the fault gains K_i is {largest:.2g}",)

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """(14): gains weighted by the memberships of x̂ and u, whose premises are kept between their bounds."""
        import casadi as ca

        sector = Sector.of(plant)
        r = len(sector.vertices)

        def correction(x: Any, f: Any, y: Any, u: Any) -> Any:
            μ = memberships(sector, x, u)
            ν = innovation(plant, x, f, y, u, divided=False)
            L, K, α = (sum((μ[i] * ca.DM(gains[f"{c}{i + 1}"]) for i in range(r)), ca.SX(0)) for c in "LKα")
            return ca.vertcat(L @ ν, K @ ν - α @ f)

        return observer_of(plant, correction)


class TsPublishedKnownInput(TsPublished):
    """Theorem 1 without the blocks of ΔB, where all B_i are equal: ΔB is then zero, and keeping them costs β."""

    name = "ts-published-known-input"
    summary = "reference: ts-published without the blocks of ΔB, for plants whose B(z) is constant"
    variant_of = "ts-published"
    uncertain_inputs = False

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of ts-published, and one B for all vertices."""
        found = super().assumptions(plant)
        if any(f.severity == "fatal" for f in found):
            return found
        spread = float(np.ptp(Sector.of(plant).B, axis=0).max(initial=0.0))
        if spread == 0:
            return found
        return [
            Finding(
                "B(z) varies from vertex to vertex",
                why=f"its entries differ by up to {spread:.4g}, so that ΔB is not zero",
                evidence={"spread": spread},
                remedies=("use ts-published",),
                see="Bezzaoucha 2013, theorem 1",
            )
        ]


# ---------------------------------------------------------------- the inequality


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The letters of theorem 1: vertices A_i, B_i, C̃_j and what is to be found."""

    A: Sequence[Expr]
    B: Sequence[Expr]
    C: Sequence[Expr]
    P1: Expr
    P2: Expr
    R: Sequence[Expr]
    Kb: Sequence[Expr]
    ab: Sequence[Expr]
    Γ: Sequence[Expr]
    λ: Sequence[Expr]
    β: Expr

    @staticmethod
    def of(plant: Plant) -> Unknowns:
        """For one plant; the first premise changes slowest and the upper bound comes first (M8, M9)."""
        sector = Sector.of(plant)
        n, m, p, q, r = plant.n, len(plant.signals.u), plant.p, len(plant.faults), len(sector.vertices)
        return Unknowns(
            [given(f"A_{i + 1}", A) for i, A in enumerate(sector.A)],
            [given(f"B_{i + 1}", B) for i, B in enumerate(sector.B)],
            [given(f"C_{j + 1}", C) for j, C in enumerate(faulty_outputs(plant))],
            unknown("P₁", n, n, symmetric=True),
            unknown("P₂", q, q, symmetric=True),
            [unknown(f"R{i + 1}", n, p) for i in range(r)],
            [unknown(f"K̄{i + 1}", q, p) for i in range(r)],
            [unknown(f"ᾱ{i + 1}", q, q) for i in range(r)],
            [unknown(f"Γ{k}", size, size, symmetric=True) for k, size in enumerate((n, q, q, m), start=1)],
            [unknown(name) for name in ("λ₁", "λ_B", "λ₁C", "λ₂C")],
            unknown("β"),
        )


# fmt: off
def as_printed(s: Unknowns) -> tuple[list[Inequality], list[Identity]]:
    """(44) to (47) with the corrections: ten block rows for every i and j."""
    (Γ1, Γ2, Γ3, Γ4), (l1, lB, l1C, l2C) = s.Γ, s.λ
    n, q, m, r = s.P1.shape[0], s.P2.shape[0], Γ4.shape[0], len(s.A)
    EA, EB, EC = (given(name, np.hstack([one.args[1] for one in many])) for name, many in (("[A_i]", s.A), ("[B_i]", s.B), ("[C̃_j]", s.C)))
    wA, wB, wC = EA.shape[1], EB.shape[1], EC.shape[1]
    found = []
    for i, (A, R, Kb, ab) in enumerate(zip(s.A, s.R, s.Kb, s.ab, strict=True)):
        for j, C in enumerate(s.C):
            X = s.P1@A - R@C
            found.append((sym([
                [ X + X.T + I(n), -C.T@Kb.T        , 0                                 , 0  , 0   , 0             , s.P1@EA  , s.P1@EB  , R@EC      , 0         ],
                [ __            , -ab - ab.T + I(q), 0                                 , ab , s.P2, 0             , 0        , 0        , 0         , Kb@EC     ],
                [ __            , __               , -Γ1 + (r*l1 + len(s.C)*(l1C + l2C))*I(n), 0  , 0   , 0       , 0        , 0        , 0         , 0         ],
                [ __            , __               , __                                , -Γ2, 0   , 0             , 0        , 0        , 0         , 0         ],
                [ __            , __               , __                                , __ , -Γ3 , 0             , 0        , 0        , 0         , 0         ],
                [ __            , __               , __                                , __ , __  , -Γ4 + r*lB*I(m), 0      , 0        , 0         , 0         ],
                [ __            , __               , __                                , __ , __  , __            , -l1*I(wA), 0        , 0         , 0         ],
                [ __            , __               , __                                , __ , __  , __            , __       , -lB*I(wB), 0         , 0         ],
                [ __            , __               , __                                , __ , __  , __            , __       , __       , -l1C*I(wC), 0         ],
                [ __            , __               , __                                , __ , __  , __            , __       , __       , __        , -l2C*I(wC)],
            ]) < 0).tagged(f"M_{i+1}{j+1}"))
    return found, []


def compressed(s: Unknowns, uncertain_inputs: bool) -> tuple[list[Inequality], list[Identity]]:
    """The same with F Fᵀ = Σ A_i A_iᵀ in place of [A_1 … A_r], and rows 3 and 6 by themselves: blocks of fixed size."""
    (Γ1, Γ2, Γ3, Γ4), (l1, lB, l1C, l2C) = s.Γ, s.λ
    n, q, m, r = s.P1.shape[0], s.P2.shape[0], Γ4.shape[0], len(s.A)
    FA, FB, FC = _factor("F_A", s.A), _factor("F_B", s.B if uncertain_inputs else []), _factor("F_C", s.C)
    kB = FB.shape[1] if FB is not None else 0
    PB = s.P1@FB if FB is not None else zeros(n, 0)
    assert FA is not None and FC is not None
    found = []
    for i, (A, R, Kb, ab) in enumerate(zip(s.A, s.R, s.Kb, s.ab, strict=True)):
        for j, C in enumerate(s.C):
            X = s.P1@A - R@C
            found.append((sym([
                [ X + X.T + I(n), -C.T@Kb.T        , 0  , 0   , s.P1@FA             , PB       , R@FC                , 0                   ],
                [ __            , -ab - ab.T + I(q), ab , s.P2, 0                   , 0        , 0                   , Kb@FC               ],
                [ __            , __               , -Γ2, 0   , 0                   , 0        , 0                   , 0                   ],
                [ __            , __               , __ , -Γ3 , 0                   , 0        , 0                   , 0                   ],
                [ __            , __               , __ , __  , -l1*I(FA.shape[1])  , 0        , 0                   , 0                   ],
                [ __            , __               , __ , __  , __                  , -lB*I(kB), 0                   , 0                   ],
                [ __            , __               , __ , __  , __                  , __       , -l1C*I(FC.shape[1]) , 0                   ],
                [ __            , __               , __ , __  , __                  , __       , __                  , -l2C*I(FC.shape[1]) ],
            ]) < 0).tagged(f"M_{i+1}{j+1}"))
    found.append((Γ1 - (r*l1 + len(s.C)*(l1C + l2C))*I(n) > 0).tagged("row 3"))
    if m and FB is not None:
        found.append((Γ4 - r*lB*I(m) > 0).tagged("row 6"))
    pairs = [(FA, s.A), (FB, s.B), (FC, s.C)]
    return found, [_same_square(F, many) for F, many in pairs if F is not None]
# fmt: on


def faulty_outputs(plant: Plant) -> list[Array]:
    """C̃_j = (1 + F f_j) C at the corners of the fault intervals, (6) and (7): upper bounds first."""
    ends = [interval(plant, f.name, f.size) for f in plant.faults]
    return [np.diag(1.0 + plant.F_f @ f) @ plant.C for f in corners(ends)]


def _factor(name: str, many: Sequence[Expr]) -> Expr | None:
    """F with F Fᵀ = Σ M_i M_iᵀ and as few columns as can be; None where the sum is zero."""
    if not many or not many[0].shape[1]:
        return None
    stacked = np.hstack([one.args[1] for one in many])
    left, sizes, _ = np.linalg.svd(stacked, full_matrices=False)
    rank = int(np.count_nonzero(sizes > 1e-13 * sizes.max(initial=0.0)))
    return given(name, left[:, :rank] * sizes[:rank]) if rank else None


def _same_square(F: Expr, many: Sequence[Expr]) -> Identity:
    total = F @ F.T
    for one in many:
        total = total - one @ one.T
    size = float(np.square(np.hstack([one.args[1] for one in many])).sum())
    return Identity(f"{F} {F}ᵀ = Σ", total, ROUNDED * max(1.0, size))


def _blocks(a: Expr, b: Expr, c: Expr, d: Expr) -> Expr:
    return Expr("block", (((a, b), (c, d)),), (a.shape[0] + c.shape[0], a.shape[1] + b.shape[1]))


def _bounds(sector: Sector) -> Assumed:
    basis = "assumed" if any(p.basis == "assumed" for p in sector.premises) else "proved"
    text = ", ".join(f"{p.name} in [{p.low:.6g}, {p.high:.6g}] ({p.basis})" for p in sector.premises)
    return Assumed("premise bounds", f"{text}: by interval arithmetic over the box where proved", basis)


def _intervals(plant: Plant) -> str:
    ends = [(f.name, *interval(plant, f.name, f.size)) for f in plant.faults]
    return ", ".join(f"[{low:g}, {high:g}] ({name})" for name, low, high in ends)


def _disconnected(plant: Plant) -> Finding:
    return Finding(
        DISCONNECTED,
        why="the inequality is invariant under a change of sign of every K_i, and its feasible set is convex",
        evidence={"gain of the estimator x̂ = 0, f̂ = 0": 1.0, "faults": [f.name for f in plant.faults]},
        remedies=("use ts-mean-value or ts-guaranteed-cost", "take this one for reference only"),
        see="Bezzaoucha 2013, theorem 1",
        severity="warning",
    )
