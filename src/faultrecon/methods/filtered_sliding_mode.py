# SPDX-License-Identifier: BSD-3-Clause
"""The older baseline: filter the faulty sensors, so that the fault becomes an unknown input, and read it off the injection.

Scheme of [Tan & Edwards 2003] without uncertainty, as [Alwi, Edwards, Tan 2009] sum it up:

    zf' = -a zf + a F⁺ y           a filter of our own, so that the fault drives a state:  zf' = -a zf + a (F⁺C x + f)
    [x; zf] is measured by [N y; zf], N F = 0, and a sliding-mode observer of it slides on both, with L2 = 0:
    ξ1' = (A11 + L1 A21) ξ1        the error of what N y does not show; stable iff (A, N C) is detectable
    ν -> a f                       the injection into zf that keeps it there, once ξ1 has decayed

L2 = 0 leaves no other choice: a mode that the healthy sensors miss defeats this scheme, where the augmented one of 2009
trades exactness for it.  And f̂ is an injection, a derivative of the samples: raw, it is several times as noisy as theirs.

Ours: everything that is tuned.  L1 is a Kalman gain, see `PROCESS`; the linear injection is a multiple k of G_n; f̂ is the
injection, its linear part included, through a low pass of 50 ms; a = 20 1/s; and ρ.  Sampled implicitly every h seconds,
injection and low pass err by the factors 1 ∓ a h/2 and 1 ± h/2τ: with a τ = 1 a constant fault is found exactly.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.existence import additive_sensor_findings, detectability_findings, fault_findings
from faultrecon.finding import Finding
from faultrecon.graph.observer import Injection, Observer
from faultrecon.methods.base import Unproved
from faultrecon.methods.papers import TAN_2003
from faultrecon.methods.regular_form import (
    FILTER,
    LOW_PASS,
    SURE,
    RegularForm,
    kalman_gain,
    linear_findings,
    linear_gain,
    linear_parts,
    ranges,
    row_findings,
    scalars,
)
from faultrecon.numerics.annihilator import annihilator, left_inverse
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

PROCESS = 10.0
"""Noise of the states over that of the outputs in the Kalman gain, in declared ranges: with it the two-mass chain shows
the noise of the reference comparison; 1 in its place makes the estimate four times quieter and half as fast."""


class FilteredSlidingMode(Unproved):
    """Filtered faulty outputs, a sliding-mode observer with L2 = 0, and the fault from its low-passed injection."""

    name = "filtered-sliding-mode"
    summary = "baseline: sliding-mode observer of filtered outputs (2003); only where healthy sensors see every mode"
    paper = TAN_2003
    criterion = "Kalman gain of the sliding motion in declared ranges, filter 20 1/s, low pass 50 ms: our tuning"

    def assumptions(self, plant: Plant) -> list[Finding]:
        """A linear plant, additive faults, healthy outputs that do not repeat each other, (A, C1) detectable."""
        found = additive_sensor_findings(plant) or fault_findings(plant) or linear_findings(plant)
        if found:
            return found
        return row_findings(plant, annihilator(plant.F_f) @ plant.C, "healthy outputs") + detectability_findings(plant)

    def gains_without_proof(self, plant: Plant) -> dict[str, Array] | None:
        """Gn (n, p - q) with N C Gn = I, k in 1/s, rho in 1/s and declared sizes, af in 1/s, tau in s."""
        N, unit = healthy(plant)
        form = RegularForm.of(plant, N @ plant.C, unit)
        Gn = form.injection(kalman_gain(form.A11, form.A21, PROCESS))
        k = linear_gain(form.A, Gn, form.C)
        rho = SURE * FILTER * np.sqrt(len(plant.faults))
        return {"Gn": form.physical(Gn)} | scalars(k=k, rho=rho, af=FILTER, tau=LOW_PASS)

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """States x̂ (n), ẑf (q), zf (q) and the low-passed injection (q), which is f̂."""
        n, q, (p, m) = plant.n, len(plant.faults), plant.D.shape
        k, rho, af, tau = (float(gains[name][0, 0]) for name in ("k", "rho", "af", "tau"))
        (N, unit), Fp = healthy(plant), left_inverse(plant.F_f)
        size, eye, none = np.diag([f.size for f in plant.faults]), np.eye(q), np.zeros((q, q))
        # fmt: off
        reads  = np.block([[N @ plant.C / unit[:, None], np.zeros((len(N), 3 * q))],
                           [np.zeros((q, n)), np.linalg.inv(size) @ np.hstack([eye, -eye, none])]])
        direct = np.vstack([np.hstack([N @ plant.D, -N]) / unit[:, None], np.zeros((q, m + p))])
        into   = np.block([[gains["Gn"] * unit,        np.zeros((n, q))],
                           [np.zeros((q, len(N))),     size],
                           [np.zeros((q, len(N) + q))],
                           [np.zeros((q, len(N))),     size / (af * tau)]])
        A = np.block([[plant.A,           np.zeros((n, 3 * q))],
                      [af * Fp @ plant.C, -af * eye, none,      none],
                      [np.zeros((q, n)),  none,      -af * eye, none],
                      [np.zeros((q, n)),  none,      none,      -eye / tau]])
        B = np.vstack([np.hstack([plant.B, np.zeros((n, p))]), np.zeros((q, m + p)),
                       af * np.hstack([-Fp @ plant.D, Fp]),    np.zeros((q, m + p))])
        # fmt: on
        injection = Injection(k * into, into, reads, direct, np.eye(len(reads)), rho)
        return Observer(
            A=A - k * into @ reads,
            B=B - k * into @ direct,
            Cx=np.eye(n, n + 3 * q),
            Dx=np.zeros((n, m + p)),
            Cf=np.hstack([np.zeros((q, n + 2 * q)), eye]),
            Df=np.zeros((q, m + p)),
            F=plant.F_f,
            injections=(injection,),
            **linear_parts(plant, n + 3 * q),
        )


def healthy(plant: Plant) -> tuple[Array, Array]:
    """N (p - q, p) with N F = 0, and the range of each of the outputs N y."""
    N = annihilator(plant.F_f)
    return N, np.linalg.norm(N * ranges(plant.signals.y.ranges), axis=1)
