# SPDX-License-Identifier: BSD-3-Clause
"""Sensor-fault reconstruction for Lipschitz plants with a guaranteed H-infinity level [Khosrowjerdi 2011].

Read it with the paper: M. J. Khosrowjerdi, "Robust sensor fault reconstruction for Lipschitz nonlinear systems",
Mathematical Problems in Engineering, 2011, 146038.  From the plant's letters to the paper's:

    paper        here                      plant
    A            T⁻¹ A T                   A                  states in scaled units x = T x_s
    B_φ, φ(x)    T⁻¹ G, φ(H x)             G, H               the structure G φ(H x) is kept
    B, E         T⁻¹ E_w W, F_w W          E_w, F_w, W        w in units of its declared sizes
    C1, E1       R⁻¹ N C T, ...            C, N F_f = 0       healthy outputs
    C2, E2, F2   V F⁺ C T, ..., I          F⁺ F_f = I, V      faulty outputs, f in units of its declared sizes
    e_f, γ       U e_f, U γ                                   a power of two that brings γ near one

The fault never enters the error dynamics: healthy outputs drive the observer, faulty ones only read the fault.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.existence import (
    additive_sensor_findings,
    detectability_findings,
    disturbance_findings,
    fault_findings,
)
from faultrecon.finding import Finding
from faultrecon.graph.observer import Observer
from faultrecon.lmi.expr import I, __, given, let, sym, unknown
from faultrecon.methods.base import (
    Identity,
    Method,
    Reproduction,
    Scaling,
    Theorem,
    deviations,
    letters,
    lipschitz_premises,
    lipschitz_scope,
)
from faultrecon.methods.papers import KHOSROWJERDI_2011
from faultrecon.numerics.annihilator import annihilator, left_inverse
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

ROUNDING = 2.0**-40
"""N F = 0 and F⁺ F = I hold exactly for faults on single sensors; for mixed ones to rounding, far below this.  Both are
stated in declared sizes, so that units cannot make the tolerance meaningless."""


class LipschitzHinf(Method):
    """Theorem 3.1 with γ², β and K₁ joint unknowns and without the bound (2.10), which its proof does not use."""

    name = "lipschitz-hinf"
    summary = "H-infinity observer from the healthy sensors; Lipschitz or linear plants, additive sensor faults"
    paper = KHOSROWJERDI_2011

    def assumptions(self, plant: Plant) -> list[Finding]:
        """F of full column rank on the sensors, a healthy output left over, (A, C1) detectable, continuous time."""
        found = additive_sensor_findings(plant) or fault_findings(plant)
        if found:
            return found
        if len(plant.faults) == plant.p:
            return [
                Finding(
                    f"all {plant.p} sensors are declared faulty",
                    why="no healthy output is left to drive the observer, so L does not exist",
                    remedies=("declare fewer faults at a time (faults=[...] or --fault)", "use the baseline open-loop"),
                    see="Khosrowjerdi 2011, (2.4): p > q",
                )
            ]
        return detectability_findings(plant) + disturbance_findings(plant)

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """Theorem 3.1 for this plant."""
        return self.theorem_3_1(plant, scaling)

    # fmt: off
    def theorem_3_1(self, plant: Plant, scaling: Scaling) -> Theorem:
        """Theorem 3.1: the block matrix (3.1), (3.2) with its H'H terms unfolded so that K₁ may be unknown."""
        n, q = plant.n, len(plant.faults)
        s, T, Ti, R, Ri = (own := letters(plant, scaling)), own.T, own.Ti, own.R, own.Ri
        U, Ui = own.U, own.Ui
        N, Fp = given("N", annihilator(plant.F_f)), given("F⁺", left_inverse(plant.F_f))
        p1, Vi = N.shape[0], given("V⁻¹", np.diag([f.size for f in plant.faults]))

        A,  Bφ = let("A", Ti@s["A"]@T),     let("B_φ", Ti@s["G"])
        Hφ, B  = let("H_φ", s["H"]@T),      let("B", Ti@s["E_w"]@s["W"])
        C1, E1 = let("C₁", Ri@N@s["C"]@T),  let("E₁", Ri@N@s["F_w"]@s["W"])
        C2, E2 = let("C₂", s["V"]@Fp@s["C"]@T), let("E₂", s["V"]@Fp@s["F_w"]@s["W"])
        α      = s["α"]

        P,  Z  = unknown("P", n, n, symmetric=True), unknown("Z", n, p1)
        β,  γ2 = unknown("β"), unknown("γ²")
        K1     = unknown("K₁", q, p1)
        H1, H2 = let("H₁", -U*(K1@C1 + C2)), let("H₂", -U*(K1@E1 + E2))                                  # (2.14)
        b      = let("β_U", U**2*β)                                                        # β in the error's unit
        Ω      = let("Ω", A.T@P + P@A - C1.T@Z.T - Z@C1 + b*α**2*(Hφ.T@Hφ))                              # (3.2)
        lmi_3_1 = sym([[ Ω ,  P@Bφ            , P@B - Z@E1        ,  H1.T ],
                       [ __, -b*I(Bφ.shape[1]), 0                 ,  0    ],
                       [ __,  __              , -γ2*I(B.shape[1]) ,  H2.T ],
                       [ __,  __              , __                , -I(q) ]]) < 0                         # (3.1)

        L, K1_ships, γ = unknown("L", n, p1), unknown("K1", q, p1), unknown("γ")
        also = self.also(let("P_x", Ui**2*(Ti.T@P@Ti)), α, n)
        noise = given("noise", _noise_columns(plant, np.asarray(N.args[1])))
        return Theorem(
            "3.1",
            [lmi_3_1.tagged("(3.1)"), (P > 0).tagged("P > 0"), (β > 0).tagged("β > 0"), *also],
            minimise=γ2,
            gains={L: T@P.inv()@Z@Ri, K1_ships: Vi@K1@Ri},                                                 # (3.3)
            prove_with={Z: P@Ti@L@R, K1: s["V"]@K1_ships@R, γ2: (U*γ)**2},
            lyapunov=P, drift=P@A - Z@C1, readout=H1, noise=Z@Ri@noise,
            identities=[
                Identity("T T⁻¹ = I", T@Ti - I(n)), Identity("R R⁻¹ = I", R@Ri - I(p1)),
                Identity("U U⁻¹ = 1", U*Ui - I(1)),
                Identity("N F = 0: healthy outputs carry no fault", Ri@N@s["F_f"]@Vi, ROUNDING),
                Identity("F⁺ F = I: faults pass with gain one", s["V"]@(Fp@s["F_f"] - I(q))@Vi, ROUNDING),
            ],
            premises=lipschitz_premises(plant),
            claim=_claim(plant),
            scope=lipschitz_scope(plant),
            fixed={"K₁": 0.0} | ({} if Bφ.shape[1] else {"β": 1.0}), unit=2.0**scaling.error,
            filter=None if also else {"A": A, "Bphi": Bφ, "B": B, "C1": C1, "E1": E1, "H1": H1, "H2": H2, "G": Hφ, "alpha": α},
        )
    # fmt: on

    def also(self, P, α, n) -> list:
        """Further inequalities of a variant, in the P of unscaled states; none here."""
        return []

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """(2.5), (2.11): a copy of the plant driven by y1 - C1 x̂ - D1 u, and f̂ = K (y - C x̂ - D u)."""
        N, Fp = annihilator(plant.F_f), left_inverse(plant.F_f)
        LN, K = gains["L"] @ N, gains["K1"] @ N + Fp
        A, B, C, D = plant.A, plant.B, plant.C, plant.D
        n, m, p = plant.n, B.shape[1], plant.p
        return Observer(
            A=A - LN @ C,
            B=np.hstack([B - LN @ D, LN]),
            Cx=np.eye(n),
            Dx=np.zeros((n, m + p)),
            Cf=-K @ C,
            Df=np.hstack([-K @ D, K]),
            F=plant.F_f,
            **deviations(plant),
        )


class LipschitzHinfThau(LipschitzHinf):
    """The theorem with the bound (2.10) that is printed with it; kept to compare, it can only cost."""

    name = "lipschitz-hinf-thau"
    summary = "lipschitz-hinf with the printed extra bound P < I/(2α) of Thau; reference only"
    variant_of = "lipschitz-hinf"
    reproductions = ()  # those below are of the theorem without (2.10)

    def also(self, P, α, n) -> list:
        """(2.10), multiplied by 2α."""
        return [(sym([[I(n), 2 * α * P], [__, I(n)]]) > 0).tagged("(2.10)")]


def _noise_columns(plant: Plant, N: Array) -> Array:
    """N times the square root of the sensor noise intensity sd² · hold, (p1, p); unit intensity where none is declared."""
    if plant.noise is None:
        return N
    return N @ np.diag(np.sqrt(plant.noise.hold) * np.array(plant.noise.sd))


def _claim(plant: Plant) -> str:
    unit = all(c.size == 1.0 for c in (*plant.faults, *plant.attenuated))
    sizes = "" if unit else ", faults and disturbances each in units of its declared size"
    return (
        "∫|f - f̂|² dt ≤ γ² ∫|w|² dt + V(e(0)) on every horizon"
        f"{sizes}; the error e = x - x̂ tends to zero when w = 0, whatever the fault does"
    )


_HARD_FLOOR = (
    "the printed level lies below {floor}, which no estimator with these sensors can beat; it becomes possible only with a"
    " smaller weight on the measurement noise than the printed E"
)
LipschitzHinf.reproductions = (
    Reproduction(
        "Example 4.1, γ at α = 1, β = 0.01",
        "lipschitz_aircraft",
        0.3,
        3.996695,
        1e-5,
        "not_as_printed",
        _HARD_FLOOR.format(floor="0.487601"),
        {"fix": {"β": 0.01}, "all_states": True},
    ),
    Reproduction(
        "Example 4.1, γ at α = 1, β free",
        "lipschitz_aircraft",
        0.3,
        3.52469,
        1e-5,
        "not_as_printed",
        _HARD_FLOOR.format(floor="0.487601"),
        {"all_states": True},
    ),
    Reproduction(
        "Example 4.2, γ at α = 1.17, β = 3",
        "lipschitz_polynomial",
        0.38,
        3.4222394,
        1e-6,
        "not_as_printed",
        _HARD_FLOOR.format(floor="0.587324"),
        {"fix": {"β": 3.0}},
    ),
    Reproduction(
        "Example 4.2, γ at α = 1.17, β free",
        "lipschitz_polynomial",
        0.38,
        3.4178246,
        1e-6,
        "not_as_printed",
        _HARD_FLOOR.format(floor="0.587324"),
    ),
)
