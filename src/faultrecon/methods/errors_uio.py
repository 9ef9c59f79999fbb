# SPDX-License-Identifier: BSD-3-Clause
"""The error system that all unknown-input observers for slowly varying sensor faults share, in letters.

    e' = (A_e - K_e C_e) e + (B_e - K_e D_e) ω + G_e δφ,    e = [x - x̂ + M F₂ w; f - f̂],    ω = [f'; w]

with A_e = diag(J A, 0) and C_e = [C, D]: an observer is an output injection K_e.  Huang 2024, section 2, with sensor noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.decoupling import attenuated_selection, decoupled_selection, unknown_input_gain
from faultrecon.graph.observer import CopiedTerm, Observer
from faultrecon.lmi.expr import Expr, I, Inequality, __, given, let, sym, unknown
from faultrecon.methods.base import Identity, Scaling, deviations, letters, lipschitz_scope
from faultrecon.methods.fault_state import below, padded
from faultrecon.numerics.scaling import spectral_norm, state_scaling
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

ROUNDING = 2.0**-40
"""J E_d = 0 holds to rounding, relative to the largest entry of E_d in declared sizes; in the plant's own units, so that
no choice of the scaling T, which is free, can make it true."""


AT_MOST = 15.0
"""How many times faster than the plant's fastest mode an observer may be, unless its samples come faster: the infimum
would ask for gains without bound, and within this bound the optimum is found to 1e-7 instead of 1e-4."""
STEP_SHARE = 2.0
"""Fastest pole times the time for which a noise sample is held, inside the 2.785 of classical Runge-Kutta."""


BASES = ("S", "S⁻¹", "Φ", "Φ⁻¹")
"""Units of outputs and faults: any serve that are inverse to each other."""


@dataclass(frozen=True, eq=False)
class ErrorLetters:
    """Letters in scaled units: states x = T x_s, outputs y = S y_s, faults f = Φ f_s; w and f' in declared sizes.

    E2, F2: attenuated disturbances (and noise that is priced) into the states, onto the outputs.  MD, Ff:
    how f' enters the two errors, e_x' = ... - MD ν and e_s' = ... + Ff ν.  V: the fault error in declared sizes.
    """

    n: int
    q: int
    p: int
    T: Expr
    Ti: Expr
    S: Expr
    Si: Expr
    Φ: Expr
    Φi: Expr
    J: Expr
    M: Expr
    A: Expr
    C: Expr
    D: Expr
    E2: Expr
    F2: Expr
    MD: Expr
    Ff: Expr
    V: Expr
    V_plant: Expr
    Vi_plant: Expr
    G: Expr
    H: Expr
    α: Expr
    Wx: Expr
    noise: Expr
    identities: tuple[Identity, ...]


# fmt: off
def error_letters(plant: Plant, scaling: Scaling, *, noise_counts: bool = False) -> ErrorLetters:
    """The letters for a plant; noise_counts: sensor noise, in standard deviations, is one more disturbance."""
    n, q, p = plant.n, len(plant.faults), plant.p
    scaling = replace(scaling, state=_state_units(plant))
    s = letters(plant, scaling)
    T, Ti = s.T, s.Ti
    S,  Si  = _units("S", _output_units(plant, scaling))
    Φ,  Φi  = _units("Φ", np.array([f.size for f in plant.faults]))
    V_plant, Vi_plant = s["V"], given("V⁻¹", np.diag([f.size for f in plant.faults]))
    M_plant, Id = given("M", unknown_input_gain(plant)), given("I_d", decoupled_selection(plant))
    Iw, Nv = _columns(plant, noise_counts)

    M  = let("M_s", Ti@M_plant@S)
    C  = let("C", Si@s["C"]@T)
    J  = let("J", I(n) - M@C)                                                        # T of the paper
    A  = let("A", Ti@s["A"]@T)
    E2 = let("E₂", Ti@s["E_w"]@s["W"]@Iw)
    F2 = let("F₂", Si@s["F_w"]@s["W"]@Iw + Si@Nv) if noise_counts else let("F₂", Si@s["F_w"]@s["W"]@Iw)
    return ErrorLetters(
        n=n, q=q, p=p, T=T, Ti=Ti, S=S, Si=Si, Φ=Φ, Φi=Φi, J=J, M=M, A=A,
        C=C, D=let("D", Si@s["F_f"]@Φ), E2=E2, F2=F2,
        MD=let("M_D", M@Si@s["F_f"]@Vi_plant), Ff=let("F_ν", Φi@Vi_plant), V=let("V_Φ", V_plant@Φ),
        V_plant=V_plant, Vi_plant=Vi_plant,
        G=let("G", Ti@s["G"]), H=let("H", s["H"]@T), α=s["α"],
        Wx=let("W_T", unknown("W_x", n, n)@T), noise=given("noise", _intensity(plant)),
        identities=(
            Identity("T T⁻¹ = I", T@Ti - I(n)), Identity("S S⁻¹ = I", S@Si - I(p)), Identity("Φ Φ⁻¹ = I", Φ@Φi - I(q)),
            Identity("J E_d = 0: what is decoupled does not enter", (I(n) - M_plant@s["C"])@s["E_w"]@s["W"]@Id, ROUNDING*_size(plant)),
        ),
    )
# fmt: on


def _units(name: str, size: Array) -> tuple[Expr, Expr]:
    """A diagonal of powers of two near the sizes, and its inverse, which is exact."""
    unit = np.exp2(np.rint(np.log2(np.where(size > 0, size, 1.0))))
    k = len(unit)
    return given(name, np.diag(unit).reshape(k, k)), given(f"{name}⁻¹", np.diag(1 / unit).reshape(k, k))


def _state_units(plant: Plant) -> NDArray[np.int64]:
    """Exponents of two for the states.  Faults drive this error system, so a sensor shows what its fault is worth."""
    weights = plant.letters()
    drives = np.hstack([plant.E_w @ weights["W"], plant.G])
    shown = np.hstack([plant.F_f * [f.size for f in plant.faults], plant.F_w @ weights["W"]])
    worth = np.abs(shown).max(axis=1, initial=0.0)
    usual = np.max(worth[worth > 0], initial=0.0) or 1.0
    C = plant.C / np.where(worth > 0, worth, usual)[:, None]
    return state_scaling(plant.A, drives if drives.any() else plant.B, C, np.array(plant.signals.x.ranges))


def _output_units(plant: Plant, scaling: Scaling) -> Array:
    """What each output shows of states, faults and counted disturbances of size one."""
    weights = plant.letters()
    sizes = np.array([f.size for f in plant.faults])
    rows = np.hstack([plant.C * np.exp2(scaling.state.astype(float)), plant.F_f * sizes, plant.F_w @ weights["W"]])
    return np.abs(rows).max(axis=1, initial=0.0)


def _columns(plant: Plant, noise_counts: bool) -> tuple[Expr, Expr]:
    """I_w picks the attenuated disturbances; N_v adds a column of one standard deviation per noisy sensor."""
    chosen = attenuated_selection(plant)
    sd = np.zeros(0) if plant.noise is None or not noise_counts else np.array(plant.noise.sd)
    onto = np.diag(sd)[:, sd > 0] if sd.size else np.zeros((plant.p, 0))
    into = np.hstack([chosen, np.zeros((len(chosen), onto.shape[1]))])
    return given("I_w", into), given("N_v", np.hstack([np.zeros((plant.p, chosen.shape[1])), onto]))


def _size(plant: Plant) -> float:
    """The largest entry of E_d for disturbances of their declared sizes; 1 where nothing is decoupled."""
    E = plant.E_w @ plant.letters()["W"] @ decoupled_selection(plant)
    return float(np.abs(E).max(initial=0.0)) or 1.0


def _intensity(plant: Plant) -> Array:
    """The square root of the sensor noise intensity sd² · hold, (p, p); one where none is declared."""
    if plant.noise is None:
        return np.eye(plant.p)
    return np.diag(np.sqrt(plant.noise.hold) * np.array(plant.noise.sd))


def times_identity(value: float, q: int) -> float | Array:
    """What an unknown (q, q) is held at: a number where it is one, so that it reads as one."""
    return value if q == 1 else value * np.eye(q)


def scope(plant: Plant) -> str:
    """What a guarantee for the error system covers."""
    said = lipschitz_scope(plant)
    names = [d.name for d in plant.attenuated if d.role == "decouple"]
    return said if not names else f"{said}; {', '.join(names)}: decoupled, of any size, up to the rounding of J E_d = 0"


def unknown_input_observer(plant: Plant, L1: Array, follow: Array, drives: Array, reads: Array) -> Observer:
    """The executable observer of any of these methods: z' = N z + L y + J B u - L1 F_f f̂ + J G φ, x̂ = z + M y.

    The fault model is σ' = drives σ + follow (y - C x̂ - F_f f̂), f̂ = reads σ: follow (k, p), drives (k, k), reads (q, k).
    L1 (n, p).  The first state of the model enters x̂ through -M F_f f̂' unless f̂' is an innovation alone.
    """
    A, B, C, D, F = plant.A, plant.B, plant.C, plant.D, plant.F_f
    M = unknown_input_gain(plant)
    J = np.eye(plant.n) - M @ C
    N, rest = J @ A - L1 @ C, np.eye(plant.p) - C @ M
    L = L1 + N @ M
    # f̂' of the model, without its innovation, moves M F_f f̂, which is part of x̂ - z.
    carried = -M @ F @ reads @ drives
    k, m = len(drives), B.shape[1]
    zero = np.zeros((plant.n, k))
    made = Observer(
        A=np.block([[N, -L1 @ F @ reads + carried], [-follow @ C, drives - follow @ F @ reads]]),
        B=np.block([[J @ B - L @ D, L], [-follow @ rest @ D, follow @ rest]]),
        Cx=np.hstack([np.eye(plant.n), zero]),
        Dx=np.hstack([-M @ D, M]),
        Cf=np.hstack([np.zeros((F.shape[1], plant.n)), reads]),
        Df=np.zeros((F.shape[1], m + plant.p)),
        F=F,
        **deviations(plant),
    )
    return _with_terms(made, J, k)


def _with_terms(made: Observer, J: Array, k: int) -> Observer:
    """φ reads x̂, samples among them, and enters through J; g likewise."""
    term, copied = made.nonlinear, made.copied
    if term is not None:
        H = term.reads
        term = replace(term, into=below(J @ term.into, k), reads=H @ made.Cx, direct=H @ made.Dx)
    if copied is not None:
        copied = padded(CopiedTerm(J @ copied.into, copied.g), k)
    return replace(made, nonlinear=term, copied=copied)


# ---------------------------------------------------------------- one inequality for any output injection


@dataclass(frozen=True, eq=False)
class InjectionErrors:
    """e' = (A - K C) e + (B - K D) ω + G δφ with |δφ| ≤ α |H e - Hw ω|, and z = Z e - Zw ω counts.

    gain: P K = Y, to be substituted by the gains that ship.
    """

    A: Expr
    C: Expr
    B: Expr
    D: Expr
    G: Expr
    H: Expr
    Hw: Expr
    Z: Expr
    Zw: Expr
    α: Expr


# fmt: off
def injection_inequality(o: InjectionErrors, P: Expr, Y: Expr, ε: Expr, r2: Expr) -> Inequality:
    """∫|z|² ≤ r² ∫|ω|² + V(e(0)) with V = e' P e, P full and Y = P K: the bounded real lemma with an S-procedure term."""
    t, k, r, z = ε*o.α**2, o.B.shape[1], o.G.shape[1], o.Z.shape[0]
    Ω = let("Ω", P@o.A + o.A.T@P - Y@o.C - o.C.T@Y.T + t*(o.H.T@o.H))
    return sym([[ Ω , P@o.B - Y@o.D - t*(o.H.T@o.Hw)    , P@o.G  , o.Z.T   ],
                [ __, -r2*I(k) + t*(o.Hw.T@o.Hw)        , 0      , -o.Zw.T ],
                [ __, __                                , -ε*I(r), 0       ],
                [ __, __                                , __     , -I(z)   ]]) < 0
# fmt: on


# ---------------------------------------------------------------- how fast an observer may be


def within_reach(drift: Expr, lyapunov: Expr) -> Inequality:
    """|λ| < ρ for every pole: A' P A < ρ² P.  A bound on the real part alone leaves oscillations of any frequency."""
    reach = unknown("ρ") * lyapunov
    return (sym([[reach, drift], [__, reach]]) > 0).tagged("|λ| < ρ")


def slower(drift: Expr, lyapunov: Expr) -> Inequality:
    """Re λ > -ρ for every pole: the cheaper half of `within_reach`."""
    return (drift + drift.T + 2 * unknown("ρ") * lyapunov > 0).tagged("Re λ > -ρ")


def fastest(plant: Plant) -> float:
    """ρ in rad/s, a power of two; the norm of A stands in where every mode is slow."""
    modes = float(np.abs(np.linalg.eigvals(plant.A)).max())
    wanted = AT_MOST * max(modes, 1e-3 * spectral_norm(plant.A), 1e-6)
    if plant.noise is not None:
        wanted = max(wanted, STEP_SHARE / plant.noise.hold)
    return float(2.0 ** np.ceil(np.log2(wanted)))
