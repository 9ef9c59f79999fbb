# SPDX-License-Identifier: BSD-3-Clause
"""The oldest baseline: two sliding-mode observers in cascade, the second of a system in which the fault is an input.

After [Tan & Edwards 2002], whose abstract has the idea (fictitious systems in which the sensor fault appears as an
actuator fault, and a secondary observer that reconstructs it) and of which [Alwi, Edwards, Tan 2009, section 1] says
that the first variant ignores f' and asks for A nonsingular, the second for a stable A.  The rest is ours, built so that
just these conditions come out:

    x = K ξ1 + C⁺ ξ2,  G_n = C⁺ - K L        the first observer slides on all outputs, the faulty ones too: C e = F f, and
    e1' = Ac e1 + Bc F f                     Ac = A11 + L A21,  Bc = A12 + L A22 - Ac L
    -ν  = A21 e1 + Dc F f - F f'             Dc = A22 - A21 L

both variants    φ' = -a φ - a ν: the filter whose output is all that the second observer is given; it slides on it.
first variant    e1 = e* - Ac⁻¹Bc F f takes f out of the state: e*' = Ac e* + [Ac⁻¹Bc F f'], -ν = A21 e* + S F f - [F f'],
                 S = Dc - A21 Ac⁻¹Bc.  What is in brackets is ignored, f drives φ alone, and S is invertible iff A is.
                 A constant fault is reconstructed, a ramp with a constant bias, hidden modes or not.
stable variant   e' = A e + G_n ν: the fault drives e through ν alone, which the second injection repeats, and f̂ = F⁺C ê.
                 Nothing is ignored; but ê ends as fast as A decays, and ê = x̂ - (the model in parallel) makes this the
                 baseline open-loop in other words, exact at any sampling interval.

Ours too: L and the second L are Kalman gains, the linear injections multiples of the others, the injections bounded by ρ,
a = 20 1/s, and in the first variant a low pass of 25 + 25 ms: two stages, since the second reads the mean of the first and
so takes a sampled injection for what it is on average.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.existence import additive_sensor_findings, fault_findings
from faultrecon.finding import Finding
from faultrecon.graph.observer import Injection, Observer
from faultrecon.methods.base import Unproved
from faultrecon.methods.papers import TAN_2002
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
from faultrecon.numerics.hinf import hinf_norm
from faultrecon.numerics.pencil import RANK_TOLERANCE, undetectable_modes
from faultrecon.numerics.scaling import scale_states, spectral_norm, state_scaling
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

PROCESS = 1.0
"""Noise of the states over that of the outputs in the Kalman gains, in declared ranges.  Faster observers hide a constant
fault better (S against Dc), so that f̂ magnifies more noise: 10 in its place makes it several times as noisy."""


@dataclass(frozen=True, eq=False)
class Sliding:
    """The first observer in its sliding motion, in declared ranges and sizes: the letters of the module's text."""

    form: RegularForm
    F: Array
    L: Array

    @staticmethod
    def of(plant: Plant, Gn: Array | None = None) -> Sliding:
        """With the Kalman gain, or the one of this G_n (n, p) in the plant's units."""
        outputs = ranges(plant.signals.y.ranges)
        form = RegularForm.of(plant, plant.C, outputs)
        F = plant.F_f * np.array([f.size for f in plant.faults]) / outputs[:, None]
        return Sliding(form, F, kalman_gain(form.A11, form.A21, PROCESS) if Gn is None else form.gain(Gn))

    @property
    def Ac(self) -> Array:
        """How the hidden part of the error decays, (n - p, n - p)."""
        return self.form.A11 + self.L @ self.form.A21

    @property
    def Bc(self) -> Array:
        """What C e = F f does to it, (n - p, p)."""
        return self.form.A12 + self.L @ self.form.A22 - self.Ac @ self.L

    @property
    def Dc(self) -> Array:
        """What C e = F f does to the injection at once, (p, p)."""
        return self.form.A22 - self.form.A21 @ self.L

    @property
    def S(self) -> Array:
        """What a constant C e = F f does to the injection, (p, p); invertible iff A is."""
        return self.Dc - self.form.A21 @ np.linalg.solve(self.Ac, self.Bc)


@dataclass(frozen=True, eq=False)
class Second:
    """The second observer w' = A w + G ν₂, w = [φ̂; ...], in declared ranges and sizes, driven by e₂ = φ̂ - φ.

    f̂ = fault w;  x̂ = x̂₁ - error w.
    """

    A: Array
    G: Array
    fault: Array
    error: Array


class CascadeSlidingMode(Unproved):
    """Two observers in cascade; the second takes f for an actuator fault and ignores f'."""

    name = "cascade-sliding-mode"
    summary = "baseline: two sliding-mode observers in cascade (2002), for slow faults; A nonsingular"
    paper = TAN_2002
    criterion = "Kalman gains of both sliding motions in declared ranges, filter 20 1/s, low pass 50 ms: our tuning"

    def assumptions(self, plant: Plant) -> list[Finding]:
        """A linear plant, additive faults, C of full row rank, (A, C) detectable, and what the variant asks of A."""
        found = additive_sensor_findings(plant) or fault_findings(plant) or linear_findings(plant)
        if found:
            return found
        return row_findings(plant, plant.C, "outputs") or _unseen(plant) or self.demanded_of_A(plant)

    def demanded_of_A(self, plant: Plant) -> list[Finding]:
        """A nonsingular: otherwise some constant fault leaves no trace in the injection."""
        e = state_scaling(plant.A, plant.B, plant.C)
        sigma = np.linalg.svd(scale_states(plant.A, plant.B, plant.C, e)[0], compute_uv=False)
        if sigma[-1] > RANK_TOLERANCE * sigma[0]:
            return []
        return [
            Finding(
                "A is singular",
                why="a fault that equals what the sensors show of an equilibrium leaves the injection at zero",
                evidence={"smallest singular value": float(sigma[-1]), "largest": float(sigma[0])},
                remedies=("leave out the state that only integrates others", "use filtered-sliding-mode"),
                see="Alwi 2009, section 1, on Tan & Edwards 2002",
            )
        ]

    def gains_without_proof(self, plant: Plant) -> dict[str, Array] | None:
        """Gn (n, p) with C Gn = I, the second observer's G2, its k2 beside k1, rho1, rho2 in 1/s, af in 1/s, tau in s."""
        first = Sliding.of(plant)
        form, a = first.form, FILTER
        G2 = form.states[:, None] * form.K @ self.second_gain(first, a)
        second = self.second(first, G2, a, LOW_PASS)
        # As large as ν is for a fault of its size that changes as fast as the filter passes.
        gain = hinf_norm(first.Ac, first.Bc @ first.F, form.A21, first.Dc @ first.F).value
        rho = SURE * np.sqrt(len(plant.faults)) * (gain + a * spectral_norm(first.F))
        return {"Gn": form.physical(form.injection(first.L)), "G2": G2} | scalars(
            k1=linear_gain(form.A, form.injection(first.L), form.C),
            k2=linear_gain(second.A, second.G, np.eye(*second.G.T.shape)),
            rho1=rho,
            rho2=SURE * a * rho,
            af=a,
            tau=LOW_PASS,
        )

    def second_gain(self, first: Sliding, a: float) -> Array:
        """L of the second observer (n - p, p) with L S F = 0: what corrects e* and f does not reach."""
        reached = first.S @ first.F
        N = np.linalg.qr(reached, mode="complete")[0][:, reached.shape[1] :].T
        return kalman_gain(first.Ac, N @ first.form.A21, PROCESS) @ N / a

    def second(self, first: Sliding, G2: Array, a: float, tau: float) -> Second:
        """w = [φ̂; ê*; two stages of the low pass]."""
        form, S, (p, q) = first.form, first.S, first.F.shape
        h, stage, eye = len(first.Ac), 2.0 / tau, np.eye(q)
        L2 = form.K.T @ (G2 / form.states[:, None])
        held = form.right - form.K @ (np.linalg.solve(first.Ac, first.Bc) + first.L)
        # fmt: off
        return Second(
            A=np.block([[-a * np.eye(p),   a * form.A21,     np.zeros((p, 2 * q))],
                        [np.zeros((h, p)), first.Ac,         np.zeros((h, 2 * q))],
                        [np.zeros((q, p)), np.zeros((q, h)), -stage * eye @ np.eye(q, 2 * q)],
                        [np.zeros((q, p)), np.zeros((q, h)), stage * np.hstack([eye, -eye])]]),
            G=np.vstack([np.eye(p), -L2, stage / a * np.asarray(np.linalg.pinv(S @ first.F), dtype=float), np.zeros((q, p))]),
            fault=np.eye(q, p + h + 2 * q, p + h + q),
            error=np.hstack([np.zeros((len(form.K), p)), form.K, np.zeros((len(form.K), q)), held @ first.F]),
        )
        # fmt: on

    def observer(self, plant: Plant, gains: Mapping[str, Array]) -> Observer:
        """States x̂₁ (n) in the plant's units, φ (p) and w in declared ranges."""
        k1, k2, rho1, rho2, a, tau = (float(gains[name][0, 0]) for name in ("k1", "k2", "rho1", "rho2", "af", "tau"))
        first = Sliding.of(plant, gains["Gn"])
        second, unit = self.second(first, gains["G2"], a, tau), first.form.outputs
        n, (p, m), nw = plant.n, plant.D.shape, len(second.A)
        eye, size = np.eye(p), np.diag([f.size for f in plant.faults])
        # fmt: off
        A = np.block([[plant.A,           np.zeros((n, p)),  np.zeros((n, nw))],
                      [np.zeros((p, n)),  -a * eye,          np.zeros((p, nw))],
                      [np.zeros((nw, n)), np.zeros((nw, p)), second.A]])
        B = np.vstack([np.hstack([plant.B, np.zeros((n, p))]), np.zeros((p + nw, m + p))])
        one = Injection(
            linear=np.zeros((n + p + nw, p)),
            into=np.vstack([gains["Gn"] * unit, -a * eye, np.zeros((nw, p))]),
            reads=np.hstack([plant.C / unit[:, None], np.zeros((p, p + nw))]),
            direct=np.hstack([plant.D, -eye]) / unit[:, None],
            weight=eye, bound=rho1,
        )
        two = Injection(
            linear=np.zeros((n + p + nw, p)),
            into=np.vstack([np.zeros((n + p, p)), second.G]),
            reads=np.hstack([np.zeros((p, n)), -eye, np.eye(p, nw)]),
            direct=np.zeros((p, m + p)),
            weight=eye, bound=rho2,
        )
        # fmt: on
        one, two = replace(one, linear=k1 * one.into), replace(two, linear=k2 * two.into)
        still = np.zeros((n, p))
        return Observer(
            A=A - one.linear @ one.reads - two.linear @ two.reads,
            B=B - one.linear @ one.direct,
            Cx=np.hstack([np.eye(n), still, -first.form.states[:, None] * second.error]),
            Dx=np.zeros((n, m + p)),
            Cf=np.hstack([np.zeros((len(size), n + p)), size @ second.fault]),
            Df=np.zeros((len(size), m + p)),
            F=plant.F_f,
            injections=(one, two),
            **linear_parts(plant, n + p + nw),
        )


class StableCascadeSlidingMode(CascadeSlidingMode):
    """Two observers in cascade; the second keeps f' and every output for faulty, and decays as the open loop does."""

    name = "cascade-sliding-mode-stable"
    summary = "baseline: two sliding-mode observers in cascade (2002), second variant; stable plants"
    variant_of = "cascade-sliding-mode"
    criterion = "Kalman gain of the first sliding motion in declared ranges, filter 20 1/s, low pass 50 ms: our tuning"

    def demanded_of_A(self, plant: Plant) -> list[Finding]:
        """A stable: the second sliding motion has its poles."""
        poles = np.linalg.eigvals(plant.A)
        worst = complex(poles[int(np.argmax(poles.real))])
        if worst.real < 0:
            return []
        return [
            Finding(
                f"the open loop does not settle: A has the mode {worst.real:.6g}"
                + (f" ± {abs(worst.imag):.6g}j" if worst.imag else ""),
                why="the second observer of the cascade forgets its errors as the open loop does",
                evidence={"mode": [worst.real, worst.imag]},
                remedies=("use filtered-sliding-mode or sliding-mode, which ask less",),
                see="Alwi 2009, section 1, on Tan & Edwards 2002",
            )
        ]

    def second_gain(self, first: Sliding, a: float) -> Array:
        """None: everything that the filter shows is taken for the fault."""
        return np.zeros((len(first.Ac), len(first.F)))

    def second(self, first: Sliding, G2: Array, a: float, tau: float) -> Second:
        """w = [φ̂; ê]: the second injection is -a times the first, and drives a copy of the error system."""
        form, p = first.form, len(first.F)
        n = len(form.A)
        return Second(
            A=np.block([[-a * np.eye(p), np.zeros((p, n))], [np.zeros((n, p)), form.A]]),
            G=np.vstack([np.eye(p), -form.injection(first.L) / a]),
            fault=np.hstack(
                [np.zeros((first.F.shape[1], p)), np.asarray(np.linalg.pinv(first.F), dtype=float) @ form.C]
            ),
            error=np.eye(n, p + n, p),
        )


def _unseen(plant: Plant) -> list[Finding]:
    """The first observer needs every mode that does not decay in some output, healthy or not."""
    modes = undetectable_modes(plant.A, plant.C)
    if not modes:
        return []
    worst = modes[0]
    return [
        Finding(
            f"no sensor sees the mode at s = {worst.value.real:.4g}, which does not decay",
            why="(A, C) is not detectable",
            evidence={"mode": [worst.value.real, worst.value.imag]},
            remedies=("add a sensor that sees it",),
            see="Alwi 2009, section 2",
        )
    ]
