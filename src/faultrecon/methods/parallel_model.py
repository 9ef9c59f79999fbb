# SPDX-License-Identifier: BSD-3-Clause
"""A model that runs beside the plant and is never corrected: what holds of it, for every baseline that amounts to it.

x̂' = A x̂ + B u + G φ(H x̂), f̂ = F⁺ (y - C x̂ - D u): Khosrowjerdi 2011, section 4, with L = 0.
"""

from __future__ import annotations

import numpy as np

from faultrecon.diagnosis.existence import additive_sensor_findings, disturbance_findings, fault_findings
from faultrecon.finding import Finding
from faultrecon.graph.observer import Observer
from faultrecon.lmi.expr import I, __, given, let, sym, unknown
from faultrecon.methods.base import (
    Identity,
    Scaling,
    Theorem,
    deviations,
    letters,
    lipschitz_premises,
    lipschitz_scope,
)
from faultrecon.numerics.annihilator import left_inverse
from faultrecon.numerics.hinf import hinf_norm
from faultrecon.numerics.scaling import spectral_norm
from faultrecon.plant.plant import Plant

ROUNDING = 2.0**-46
"""Relative to |A|: an integrator's eigenvalue comes out as a few roundings on either side of zero."""


def parallel_findings(plant: Plant) -> list[Finding]:
    """Additive sensor faults with F of full column rank; a stable plant that outweighs its nonlinearity."""
    found = additive_sensor_findings(plant) or fault_findings(plant)
    if found:
        return found
    slowest = float(np.linalg.eigvals(plant.A).real.max())
    if slowest >= -ROUNDING * spectral_norm(plant.A):
        return [
            Finding(
                "the open loop forgets nothing",
                why=f"A has an eigenvalue with real part {slowest:.3g}, so an initial error never decays",
                evidence={"real part": slowest},
                remedies=("use a method with feedback, for example lipschitz-hinf",),
                see="Khosrowjerdi 2011, section 4",
            )
        ]
    return disturbance_findings(plant) + _small_gain(plant)


# fmt: off
def parallel_theorem(plant: Plant, scaling: Scaling, number: str) -> Theorem:
    """The bounded-real inequality of the error system with L = 0: the S-procedure term is that of (3.2)."""
    n, q, own = plant.n, len(plant.faults), letters(plant, scaling)
    s, T, Ti, U, Ui = own, own.T, own.Ti, own.U, own.Ui
    Fp, Vi = given("F⁺", left_inverse(plant.F_f)), given("V⁻¹", np.diag([f.size for f in plant.faults]))
    A,  Bφ = let("A", Ti@s["A"]@T),         let("B_φ", Ti@s["G"])
    Hφ, B  = let("H_φ", s["H"]@T),          let("B", Ti@s["E_w"]@s["W"])
    H1, H2 = let("H₁", -U*(s["V"]@Fp@s["C"]@T)), let("H₂", -U*(s["V"]@Fp@s["F_w"]@s["W"]))
    α      = s["α"]
    P, β, γ2, γ = unknown("P", n, n, symmetric=True), unknown("β"), unknown("γ²"), unknown("γ")
    b = let("β_U", U**2*β)
    lmi = sym([[ A.T@P + P@A + b*α**2*(Hφ.T@Hφ), P@Bφ            ,  P@B               ,  H1.T ],
               [ __                            , -b*I(Bφ.shape[1]),  0                 ,  0    ],
               [ __                            , __              , -γ2*I(B.shape[1])  ,  H2.T ],
               [ __                            , __              , __                 , -I(q) ]]) < 0
    return Theorem(
        number,
        [lmi.tagged("bounded real"), (P > 0).tagged("P > 0"), (β > 0).tagged("β > 0")],
        minimise=γ2, gains={}, prove_with={γ2: (U*γ)**2}, unit=2.0**scaling.error,
        fixed={} if Bφ.shape[1] else {"β": 1.0},
        lyapunov=P, drift=P@A, readout=H1, noise=P@given("no noise", np.zeros((n, 0))),
        identities=[
            Identity("T T⁻¹ = I", T@Ti - I(n)), Identity("U U⁻¹ = 1", U*Ui - I(1)),
            Identity("F⁺ F = I: faults pass with gain one", s["V"]@(Fp@s["F_f"] - I(q))@Vi, 2.0**-40),
        ],
        premises=lipschitz_premises(plant),
        claim="∫|f - f̂|² dt ≤ γ² ∫|w|² dt + V(e(0)) on every horizon, in declared sizes",
        scope=lipschitz_scope(plant),
    )
# fmt: on


def parallel_observer(plant: Plant) -> Observer:
    """x̂ follows the model; f̂ = F⁺ (y - C x̂ - D u)."""
    Fp, n, (p, m) = left_inverse(plant.F_f), plant.n, plant.D.shape
    return Observer(
        A=plant.A,
        B=np.hstack([plant.B, np.zeros((n, p))]),
        Cx=np.eye(n),
        Dx=np.zeros((n, m + p)),
        Cf=-Fp @ plant.C,
        Df=np.hstack([-Fp @ plant.D, Fp]),
        F=plant.F_f,
        **deviations(plant),
    )


def _small_gain(plant: Plant) -> list[Finding]:
    """α |H (sI - A)⁻¹ G|_∞ < 1 is necessary and sufficient for the inequality to have a solution at some level."""
    if plant.nonlinearity is None or plant.nonlinearity.constant == 0:
        return []
    no_direct = np.zeros((plant.H.shape[0], plant.G.shape[1]))
    gain = hinf_norm(plant.A, plant.G, plant.H, no_direct)
    loop = plant.nonlinearity.constant * gain.value
    if loop < 1:
        return []
    return [
        Finding(
            "the nonlinearity is too strong for a model that nothing corrects",
            why=f"α |H (sI - A)⁻¹ G| reaches {loop:.6g} at {gain.frequency:.4g} rad/s, and it has to stay below 1",
            evidence={"loop gain": loop, "frequency": gain.frequency},
            remedies=(
                f"shrink the domain until α is below {1 / gain.value:.6g}",
                "use a method with feedback, for example lipschitz-hinf",
            ),
            see="Khosrowjerdi 2011, section 4, re-derived",
        )
    ]
