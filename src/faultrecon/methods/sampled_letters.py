# SPDX-License-Identifier: BSD-3-Clause
"""What the sampled proportional-integral observers are made of: the decoupling, the discretised model, their letters.

The plant is augmented by its sensor faults, x_a = [x; f_s], which only their unknown rate moves, so that sensor and
actuator faults are reconstructed by one observer; where faults are modelled as ramps, by all of them, and what drives is
their rate.  Disturbances with role "decouple" are D₁, the attenuated ones D₂.

    x_a⁺ = x_a + T Φ₁ (A x_a + B u + B_φ φ(H_φ x_a) + E f_a + D₁ d₁ + D₂ d₂) + T [0; f_s']       y = C x_a + D u + F₂ d₂ + N η

Φ₁ = I is Euler's model, Φ₁ = (1/T) ∫ e^(As) ds the one that is exact while everything but x is held over a sample time.
A plant that comes sampled has A - I in place of A and Φ₁ = I/T, see `sampled_plants`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.lmi.expr import Expr, I, as_expr, given, let, unknown
from faultrecon.methods.base import Identity, Scaling
from faultrecon.methods.sampled_plants import moves, own_map, own_map_identities, sampled_decay_rate
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

ROUNDING = 2.0**-40
"""Decoupling, bases and the discretised model hold to rounding, far below this, in scaled units."""
TERMS = 16
"""Of the series of Φ₁ at |A T| <= 1: the rest is below 1/17! = 3e-15, and 16! is an exact double."""


@dataclass(frozen=True, eq=False)
class Channels:
    """The plant's channels sorted by what the observer does with them, as columns of selection matrices.

    carried (q, k): faults that are states of the augmented plant.  driven (q, r): faults whose integrator drives it, or
    with `ramp` the faults whose rate does.  decouple, attenuate (l, .): which counted disturbances.
    """

    carried: Array
    driven: Array
    decouple: Array
    attenuate: Array
    ramp: bool = False

    @staticmethod
    def of(plant: Plant, *, ramp: bool = False) -> Channels:
        """Disturbances by role; sensor faults are carried, actuator faults drive; as ramps all are carried."""
        on_sensor = np.array([f.site == "sensor" for f in plant.faults], dtype=bool)
        decoupled = np.array([d.role == "decouple" for d in plant.attenuated], dtype=bool)
        q, l = np.eye(len(on_sensor)), np.eye(len(decoupled))
        sorted_faults = (q, q) if ramp else (q[:, on_sensor], q[:, ~on_sensor])
        return Channels(*sorted_faults, l[:, decoupled], l[:, ~decoupled], ramp)

    @property
    def sizes(self) -> tuple[int, int]:
        """How many are carried, how many drive."""
        return self.carried.shape[1], self.driven.shape[1]


def augmented(plant: Plant, own: Channels) -> tuple[Array, Array]:
    """D₁ (n+k, q₁) of what is decoupled, in declared sizes, and C (p, n+k) of the augmented plant, in floating point."""
    D1 = plant.E_w @ plant.letters()["W"] @ own.decouple
    return np.vstack([D1, np.zeros((own.sizes[0], D1.shape[1]))]), np.hstack([plant.C, plant.F_f @ own.carried])


def noise_weighted_inverse(plant: Plant, CD: Array) -> Array:
    """M with M C D₁ = I and the least noise in M y: (CD' R⁻¹ CD)⁻¹ CD' R⁻¹, R the variances of the sensors."""
    R = np.ones(plant.p) if plant.noise is None else np.square(plant.noise.sd)
    if not R.all():  # a sensor without noise would take all the weight, and its small errors with it
        R = np.where(R > 0, R, R[R > 0].min() if R.any() else 1.0)
    weighted = CD.T / R
    return np.asarray(np.linalg.solve(weighted @ CD, weighted), dtype=float)


def averaged(plant: Plant, T: float) -> Array:
    """Φ₁ = (1/T) ∫₀ᵀ e^(As) ds, (n, n); of a sampled plant I/T, its own map."""
    from faultrecon.numerics.discretise import zoh

    if plant.sample_time is not None:
        return own_map(plant.n, T)
    return np.asarray(zoh(plant.A, np.eye(plant.n), T)[1] / T, dtype=float)


@dataclass(frozen=True, eq=False)
class Multiplier:
    """How an inequality uses what is known of δ = φ(x) - φ(x̂), Δ what φ reads of x - x̂: Δ'(...)Δ - δ'Λδ >= 0.

    unknowns: λ for |δ| <= ℓ |Δ|, or one λ_i per component for |δ_i| <= |α_i Δ|.  minus: -Λ.  weighs: each weight with
    its α_i, None where the weight says it all.  moving: the components of φ that change with x, None for all.
    """

    unknowns: tuple[Expr, ...]
    minus: Expr
    weighs: tuple[tuple[Expr, Expr | None], ...]
    moving: Expr | None = None

    @staticmethod
    def of(plant: Plant) -> Multiplier:
        """One λ, unless the plant knows a constant for each of several components."""
        letters, term = plant.letters(), plant.nonlinearity
        if term is None or term.channels is None or not term.separate or not any(term.channels):
            λ = unknown("λ")
            return Multiplier((λ,), -λ*I(plant.G.shape[1]), ((let("λℓ²", λ*given("plant.α", letters["α"])**2), None),))  # fmt: skip
        moving = [i for i, constant in enumerate(term.channels) if constant > 0]
        names = [(name, name[1:]) for i, name in enumerate(term.letters()) if i in moving]
        λs = tuple(unknown("λ" + digits) for _, digits in names)
        αs = [given(f"plant.{name}", letters[name]) for name, _ in names]
        picks = [given("J_φ" + digits, np.eye(1, len(names), k)) for k, (_, digits) in enumerate(names)]
        minus = total([-λ * (J.T @ J) for λ, J in zip(λs, picks, strict=True)])
        pick = None if len(moving) == len(term.channels) else given("J_φ", np.eye(len(term.channels))[:, moving])
        return Multiplier(λs, minus, tuple(zip(λs, αs, strict=True)), pick)

    def entering(self, columns: Expr) -> Expr:
        """The columns of the components that change with x."""
        return columns if self.moving is None else columns@self.moving  # fmt: skip

    def bound(self, left: Expr, right: Expr) -> Expr:
        """What Λ weighs on the other side, between two of Δ's coefficients."""
        return total([w*(left.T@right) if α is None else w*((α@left).T@(α@right)) for w, α in self.weighs])  # fmt: skip


@dataclass(frozen=True, eq=False)
class SampledLetters:
    """The letters of the reduced error system in scaled units: ζ = [ε; e_f], e = W ε - H ν, ν = F₂ d₂ + N η.

    A, B_phi, C, R: of ζ;  E_w, F_w, R_w: of w = [d₂; η; ḟ];  faults, states: what is counted as error, of ζ.
    Πx: what a push of the plant's states (n,) does to ζ.  Λ: what is known of φ.
    inputs: width of each part of w.  K: from what ships to [W'L; F].  ship: from K to what ships.
    gains: what ships, by letter.
    """

    nz: int
    inputs: tuple[int, int, int]
    parts: tuple[Expr, Expr, Expr]
    A: Expr
    Bφ: Expr
    C: Expr
    R: Expr
    Ew: Expr
    Fw: Expr
    Rw: Expr
    faults: Expr
    states: Expr
    Πx: Expr
    Λ: Multiplier
    K: Expr
    ship: tuple[Expr, Expr, Expr]
    gains: dict[str, Expr]
    identities: tuple[Identity, ...]


def gains_of(plant: Plant, own: Channels) -> dict[str, Expr]:
    """The letters that ship: T in s, H and Φ₁ of the model, L and F per second."""
    (k, r), p = own.sizes, plant.p
    return {
        "T": unknown("T"),
        "H": unknown("H", plant.n + k, p),
        "Φ₁": unknown("Φ₁", plant.n, plant.n),
        "L": unknown("L", plant.n + k, p),
        "F": unknown("F", r, p),
    }


# fmt: off
def sampled_letters(
    plant: Plant, own: Channels, scaling: Scaling, H0: Array, rates: Array, T: float, *, idempotent: bool = True
) -> SampledLetters:
    """The letters for a decoupling H0 (n+k, p), in declared sizes; rates (q,): what one unit of ḟ is, of f̈ for ramps.

    idempotent: J² = J, so that the error lives in the range of J.  Where it does not, W = I and J - I per sample is
    part of the drift: z is then J times the prediction.
    """
    n, p, (k, r), na = plant.n, plant.p, own.sizes, plant.n + own.sizes[0]
    s = {k: given(f"plant.{k}", v) for k, v in plant.letters().items()}
    x, a = _units(plant, own, scaling, rates)
    S, Si, Sf, Sfi = (given(k, np.diag(v).reshape(2*(len(v),))) for k, v in (("S", x), ("S⁻¹", 1/x), ("S_f", a), ("S_f⁻¹", 1/a)))
    Jx, Jc = given("J_x", np.eye(na, n)), given("J_c", np.eye(na, k, -n))
    Qc, Qd = given("Q_c", own.carried), given("Q_d", own.driven)
    Q1, Q2 = given("Q_1", own.decouple), given("Q_2", own.attenuate)
    ship, Λ = gains_of(plant, own), Multiplier.of(plant)
    C  = let("C_a", (s["C"]@Jx.T + s["F_f"]@Qc@Jc.T)@S)
    H  = let("H_s", Si@ship["H"])
    J  = let("J", I(na) - H@C)
    Φ  = let("Φ_a", Si@(Jx@ship["Φ₁"]@Jx.T + Jc@Jc.T)@S)
    rank = na - own.decouple.shape[1] if idempotent else na
    W0 = range_of((np.eye(na) - H0@augmented(plant, own)[1]) * x / x[:, None], rank)
    W  = given("W", W0)
    nε, nz = W0.shape[1], W0.shape[1] + r
    Jε, Jf = given("J_ε", np.eye(nz, nε)), given("J_f", np.eye(nz, r, -nε))
    Π  = let("Π", W.T@J@Φ)                                                     # what moves x_a moves ε by Π times it
    A, G = let("A_a", Si@Jx@(moves(plant, s["A"])@Jx.T + s["E_f"]@Qc@Jc.T)@S), Λ.entering(Si@Jx@s["G"])
    E  = Si@(Jc@Qc.T if own.ramp else Jx@s["E_f"])@Qd@Sf
    D1, D2 = Si@Jx@s["E_w"]@s["W"]@Q1, Si@Jx@s["E_w"]@s["W"]@Q2
    Hφ = s["H"]@Jx.T@S
    widths, (J1, J2, J3), ν = _inputs(plant, own, s)
    Θ  = given("Θ", np.diag(rates).reshape(2*(len(rates),)))
    Ω  = given("Ω", np.diag(1 / ranges_or_one(plant)))
    Ef = Jf@(Sfi@Qd.T@Θ@J3.T) + (0 if own.ramp else Jε@(Π@Si@Jc@Qc.T@Θ@J3.T))
    faults = s["V"]@Qc@Jc.T@S@W@Jε.T
    back = let("I - CH", I(p) - C@H)
    M, A_r, ν_r, more = W.T@J@Si@ship["L"], Π@A@W, Π@A@H, _projector(H, J, W)
    if not idempotent:
        τ = given("T⁻¹", 1.0 / T)
        M, A_r, ν_r = Si@ship["L"], A_r - τ*(H@C), ν_r + τ*(J@H)
        more = (Identity("T T⁻¹ = 1", τ*ship["T"] - 1.0, ROUNDING),)
    return SampledLetters(
        nz, widths, (J1, J2, J3),
        A=let("A_r", Jε@A_r@Jε.T + Jε@(Π@E)@Jf.T),
        Bφ=let("B_r", Jε@(Π@G)),
        C=let("C_r", C@W@Jε.T),
        R=let("R_ζ", Hφ@W@Jε.T),
        Ew=let("E_r", Jε@(Π@D2@J1.T - ν_r@ν) + Ef),
        Fw=let("F_r", back@ν),
        Rw=let("R_w", -(Hφ@H@ν)),
        faults=let("C_f", faults if own.ramp else faults + s["V"]@Qd@Sf@Jf.T),
        states=let("C_x", Ω@Jx.T@S@W@Jε.T),
        Πx=let("Π_x", Jε@(W.T@J@Si@Jx)),
        Λ=Λ,
        K=let("K", Jε@M + Jf@(Sfi@ship["F"])),
        ship=(S@W@Jε.T, Sf@Jf.T, back if idempotent else I(p)),
        gains=ship,
        identities=(*_identities((S, Si, Sf, Sfi), (Jc, H), J@Φ@D1), *more),
    )
# fmt: on


def held_model(plant: Plant, scaling: Scaling, ship: Mapping[str, Expr], T: float) -> tuple[Identity, ...]:
    """Φ₁ is (1/T) ∫ e^(As) ds of the T that ships: by its Taylor series at |A T| ≤ 1, else by doubling from there."""
    if plant.sample_time is not None:
        return own_map_identities(ship, plant.n, ROUNDING)
    x = np.exp2(scaling.state.astype(float))
    n = plant.n
    S, Si = given("S_x", np.diag(x)), given("S_x⁻¹", np.diag(1 / x))
    X = let("A_T", ship["T"] * (Si @ given("plant.A", plant.A) @ S))
    norm = float(np.linalg.norm(plant.A * x / x[:, None], 1)) * T
    halvings = max(0, math.ceil(math.log2(norm))) if norm > 0 else 0
    Φ = [let("Φ", Si @ ship["Φ₁"] @ S)]
    Φ += [given(f"Φ_{2**j}", averaged(plant, T / 2**j) * x / x[:, None]) for j in range(1, halvings + 1)]
    found = [Identity("S_x S_x⁻¹ = I", S @ Si - I(n))]
    for j in range(halvings):
        half = Φ[j + 1]
        doubled = half @ (I(n) + as_expr(2.0 ** -(j + 2)) * (X @ half))
        found.append(Identity(f"Φ₁ of T/{2**j} is that of half as much, doubled", Φ[j] - doubled, ROUNDING))
    Y, series = let("Ξ", as_expr(2.0**-halvings) * X), I(n)
    for k in range(TERMS - 1, 0, -1):
        series = Y @ series + as_expr(float(math.factorial(TERMS) // math.factorial(k))) * I(n)
    whole = as_expr(float(math.factorial(TERMS)))
    scale = as_expr(2.0 ** -math.floor(math.log2(math.factorial(TERMS))))  # 1/16! is no dyadic number, this nearly is
    label = "Φ₁ = (1/T) ∫ e^(As) ds by 16 terms of its series, the rest below 3e-15"
    return (*found, Identity(label, scale * (whole * Φ[-1] - series), ROUNDING))


def ranges_or_one(plant: Plant) -> Array:
    """The declared ranges of the states (n,), one where none is declared."""
    ranges = np.array(plant.signals.x.ranges)
    return np.where(np.isfinite(ranges) & (ranges > 0), ranges, 1.0)


def range_of(J: Array, rank: int) -> Array:
    """An orthonormal basis (n, rank) of the range of J; the identity where J has full rank."""
    if rank == len(J):
        return np.eye(rank)
    return np.ascontiguousarray(np.linalg.svd(J)[0][:, :rank])


# fmt: off
def _inputs(
    plant: Plant, own: Channels, s: Mapping[str, Expr]
) -> tuple[tuple[int, int, int], tuple[Expr, Expr, Expr], Expr]:
    """The widths of w = [d₂; η; ḟ], the columns that pick each, and ν = F₂ d₂ + N η of w."""
    widths = own.attenuate.shape[1], plant.p, len(plant.faults)
    J1, J2, J3 = (given(f"J_{i + 1}", np.eye(sum(widths), w, -sum(widths[:i]))) for i, w in enumerate(widths))
    N = given("N", np.diag(np.zeros(plant.p) if plant.noise is None else plant.noise.sd))
    return widths, (J1, J2, J3), let("ν", s["F_w"]@s["W"]@given("Q_2", own.attenuate)@J1.T + N@J2.T)


def _identities(units: tuple[Expr, ...], parts: tuple[Expr, Expr], left: Expr) -> tuple[Identity, ...]:
    """What the error system rests on: units, and that what is decoupled is."""
    (S, Si, Sf, Sfi), (Jc, H) = units, parts
    return (
        Identity("S S⁻¹ = I", S@Si - I(S.shape[0])),
        Identity("S_f S_f⁻¹ = I", Sf@Sfi - I(Sf.shape[0])),
        Identity("J Φ₁ D₁ = 0: what is decoupled does not reach the error", left, ROUNDING),
        *([Identity("no fault is read through H", Jc.T@H, ROUNDING)] if Jc.shape[1] else []),
    )


def _projector(H: Expr, J: Expr, W: Expr) -> tuple[Identity, ...]:
    """J projects onto the range of W, and takes H with it."""
    return (
        Identity("J H = 0", J@H, ROUNDING),
        Identity("Wᵀ J W = I", W.T@J@W - I(W.shape[1]), ROUNDING),
        Identity("W Wᵀ J = J: W spans what is left", W@W.T@J - J, ROUNDING),
    )
# fmt: on


def _units(plant: Plant, own: Channels, scaling: Scaling, rates: Array) -> tuple[Array, Array]:
    """Powers of two: the sizes of states and carried faults (n+k,), and of what drives (r,).

    Only the ratios of the states' matter; the largest is given the size of the faults, which the program counts in.
    """
    size = np.array([f.size for f in plant.faults])
    shares = np.exp2((scaling.state - scaling.state.max()).astype(float))
    return np.concatenate([shares, _near(own.carried.T @ size)]), _near(own.driven.T @ (rates if own.ramp else size))


def _near(sizes: Array) -> Array:
    return np.exp2(np.rint(np.log2(sizes))) if len(sizes) else np.zeros(0)


STATE_WEIGHT = 0.1
"""Of the state error, in declared ranges, against the fault error, in declared sizes: without it gains drift off."""
NOISE_WEIGHT = 10.0
"""c₂ over c₁ and c₃: a disturbance may sit at its worst frequency, noise never does.  On the flexible joint the errors
of reconstructed faults are least between 1 and 10."""


def held_fixed(plant: Plant, m: SampledLetters) -> dict[str, Any]:
    """What is chosen before the program: decay rate, weights, and λ where there is no nonlinearity."""
    fixed: dict[str, Any] = {"α": decay_rate(plant), "c_x": STATE_WEIGHT}
    fixed |= {f"c{k}": c for k, c, J in zip("₁₂₃", (1.0, NOISE_WEIGHT, 1.0), m.parts, strict=True) if J.shape[1]}
    return fixed if m.Bφ.shape[1] else fixed | {"λ": 1.0}


def decay_rate(plant: Plant) -> float:
    """α in 1/s that every plant allows: a quarter of its slowest mode that moves, half of the slowest fixed zero."""
    from faultrecon.diagnosis.conditions import minimum_phase

    if plant.sample_time is not None:
        return sampled_decay_rate(plant)
    rates = np.abs(np.linalg.eigvals(plant.A))
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    slowest = 0.25 * float(rates.min()) if rates.size else 0.25
    zero = minimum_phase(plant).where
    return slowest if zero is None else min(slowest, -0.5 * zero.real)


def total(terms: list[Expr]) -> Expr:
    """Their sum, of one or more."""
    found = terms[0]
    for term in terms[1:]:
        found = found + term
    return found
