# SPDX-License-Identifier: BSD-3-Clause
"""Alwi, Edwards, Tan 2009 where healthy sensors see every mode, and beside the scheme of 2003 it grew out of.

The plant on which both schemes apply is a chain of two masses under u = 0.5 sin t, whose second position sensor is at
fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.advise.papers._alwi2009_flights import (
    FAULTS,
    NOISE,
    Flight,
    aircraft,
    block_triangular,
    error_and_change,
    flight,
    form,
    motion,
    norm,
    reconstructed,
    rms,
)
from faultrecon.advise.reproductions import Comparison, Row
from faultrecon.graph.observer import Observer
from faultrecon.io.library import read_library
from faultrecon.lmi.expr import I, __, given, sym, unknown
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.solve import solve
from faultrecon.methods.sliding_letters import sliding_gain
from faultrecon.numerics.discretise import zoh
from faultrecon.numerics.pencil import unobservable_modes
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.pipeline import design

Array = NDArray[Any]

YAW_POLES = (-14.57, -1.059)
"""Sliding poles of the reference's design for the yaw gyro, which fix its gain; the third, of α, is `ALPHA_POLE`."""
ALPHA_POLE = -0.904
WRONG_START = (0.05, 0.05, 0.1, 0.05, 0.05)
CHAIN_POLES = (-0.3766, complex(-0.4601, 1.9670), complex(-0.4601, -1.9670))


def placed(A: Array, c: Array, poles: Sequence[complex]) -> Array:
    """The l (n,) that gives A + l c, observed by one row c (n,), these poles: Ackermann's formula."""
    n = len(A)
    observed = np.vstack([c @ np.linalg.matrix_power(A, k) for k in range(n)])
    wanted = np.eye(n)
    for s in poles:
        wanted = wanted @ (A - s * np.eye(n))
    return -np.real(wanted @ np.linalg.solve(observed, np.eye(n)[:, -1]))


@lru_cache(maxsize=1)
def frozen_yaw() -> tuple[Plant, Array]:
    """The aircraft with its yaw gyro at fault, and the L (3, 3), with L2 = 0, of the reference's sliding poles."""
    plant = aircraft("r")
    own = form(plant)
    alpha, lateral = [0], [1, 2]  # the states that are not measured: α, β, r
    roll, pitch = own.A211
    L = np.zeros((own.n1, own.p))
    L[lateral, 0] = placed(own.A11[np.ix_(lateral, lateral)], roll[lateral], YAW_POLES)
    L[alpha, 1] = placed(own.A11[np.ix_(alpha, alpha)], pitch[alpha], [ALPHA_POLE])
    return plant, L


def exact_cases(seed: int) -> Comparison:
    """Yaw and roll gyros: exact once it slides, from a wrong start as fast as the sliding poles allow."""
    plant, L = frozen_yaw()
    observer, rows = block_triangular(plant, L), [Row("yaw gyro: norm", norm(plant, L), 0.0, 1e-12, True)]
    flown = flight(0.01, 15.0)
    f = FAULTS["ramp"](flown.t)
    y = flown.outputs(plant.F_f, f)
    right = reconstructed(observer, flown, y) - f
    rows.append(Row("yaw gyro: largest error, right start", float(np.abs(right).max()), 0.0, 1e-12, True))
    wrong = reconstructed(observer, flown, y, -np.array(WRONG_START)) - f
    for second, reference in ((1, 4.0e-2), (2, 1.4e-2), (5, 5.8e-4), (10, 2.9e-6), (15, 1.5e-8)):
        found = float(abs(wrong[round(second / 0.01)]))
        rows.append(Row(f"yaw gyro: error {second} s after a wrong start", found, reference, 0.05))
    for h, reference in ((0.01, 3.1e-3), (0.001, 1.3e-3)):
        flown = flight(h, 25.0)
        f = FAULTS["ramp"](flown.t)
        error, _ = error_and_change(
            flown.t, reconstructed(observer, flown, flown.outputs(plant.F_f, f, NOISE, seed)), f
        )
        rows.append(Row(f"yaw gyro: RMSE with noise, {1e3 * h:g} ms", error, reference, 0.06))
    made = design(aircraft("p"), "sliding-mode-exact")
    rows.append(Row("roll gyro: norm", norm(made.plant, sliding_gain(made.plant, made.gains)), 0.0, 1e-12, True))
    poles = np.linalg.eigvals(motion(made.plant, sliding_gain(made.plant, made.gains))[0])
    remarks = [
        "yaw gyro with the sliding poles of the reference, which fix L1; a right start and model leave rounding alone",
        f"roll gyro: slowest sliding pole {poles.real.max():.3g} 1/s; without a demand on the decay the inequality has"
        " nothing to say about it, and one solver's choice was -0.076 1/s",
    ]
    return Comparison("Where healthy sensors see every mode, L2 = 0", rows, remarks)


# ---------------------------------------------------------------- the scheme of 2003


def zeros_and_margins() -> Comparison:
    """What stops the scheme of 2003 is what makes L2 = 0 impossible: modes that the healthy gyros miss."""
    rows = []
    for axis, modes, margin in (("q", (1.076874746, -2.125774746), 0.0216), ("r", (), -1.0), ("p", (), -1.0)):
        plant = aircraft(axis)
        own = form(plant)
        found = [m.value.real for m in unobservable_modes(plant.A, _healthy(plant))]
        if not modes:
            rows.append(Row(f"{axis} faulty: number of zeros", float(len(found)), 0.0, 0.0, True))
        for k, s in enumerate(modes):
            rows.append(Row(f"{axis} faulty: zero {k + 1}", found[k], s, 1e-8))
        rows.append(Row(f"{axis} faulty: margin of L2 = 0", _margin(own.A11, own.A211), margin, 0.01, True))
    remark = (
        "margin: least t with X11 < t I for 0.01 I < P11 < I, |Y| < 1000, and t > -1; L2 = 0 is possible where t < 0"
    )
    return Comparison("Where the scheme of 2003 applies", rows, [remark])


def _healthy(plant: Plant) -> Array:
    return plant.C[~plant.F_f.any(axis=1)]


def _margin(A11: Array, A211: Array) -> float | None:
    """The least t of the remark above."""
    n, k = A11.shape[0], A211.shape[0]
    P, Y, t = unknown("P11", n, n, symmetric=True), unknown("Y", n, k), unknown("t")
    A, C = given("A11", A11), given("A211", A211)
    X = P @ A + A.T @ P + Y @ C + C.T @ Y.T
    bound = sym([[1e3 * I(n), Y], [__, 1e3 * I(k)]])
    inequalities = [t * I(n) - X > 0, P - 0.01 * I(n) > 0, I(n) - P > 0, bound > 0, (t + 1.0) > 0]
    found = solve(Problem(inequalities, t))
    return found.objective if found.solved else None


@lru_cache(maxsize=8)
def chain(h: float) -> Flight:
    """The chain of two masses under a held sine force, 25 s."""
    plant = read_library("two_mass")
    Ad, Bd = zoh(plant.A, plant.B, h)
    t = h * np.arange(round(25.0 / h) + 1)
    u = 0.5 * np.sin(t)[:, None]
    x = np.zeros((len(t), plant.n))
    for k in range(len(t) - 1):
        x[k + 1] = Ad @ x[k] + Bd @ u[k]
    return Flight(t, u, x, x @ plant.C.T)


@lru_cache(maxsize=1)
def schemes() -> dict[str, Observer]:
    """The augmented observer with the reference's sliding poles, and the two older ones as this package tunes them."""
    plant = read_library("two_mass")
    own = form(plant)
    L = np.zeros((own.n1, own.p))
    L[:, 0] = placed(own.A11, own.A211[0], CHAIN_POLES)
    names = {"2003": "filtered-sliding-mode", "2002": "cascade-sliding-mode"}
    older = {year: design(plant, name).observer for year, name in names.items()}
    return {"augmented": block_triangular(plant, L), **older}


# (fault, h, noise): RMSE and change of the augmented observer, of the raw injection of 2003, of its low-passed one
OLDER = {
    ("ramp", 0.01, 0.0): ((1.8e-4, None), (4.0e-3, None), (4.1e-3, None)),
    ("ramp", 0.001, 0.0): ((2.5e-6, None), (4.1e-4, None), (6.5e-4, None)),
    ("ramp", 0.01, NOISE): ((2.05e-3, 2.9e-3), (1.75e-2, 2.5e-2), (6.1e-3, 3.3e-3)),
    ("ramp", 0.001, NOISE): ((1.40e-3, 1.3e-3), (1.83e-2, 2.6e-2), (1.7e-3, 3.7e-4)),
    ("step", 0.001, NOISE): ((1.40e-3, 1.3e-3), (1.83e-2, 2.6e-2), (2.3e-3, 3.7e-4)),
}


def compared(fault: str, h: float, noise: float, seed: int) -> dict[str, tuple[float, float]]:
    """RMSE from 5 s on and change per sample of each scheme."""
    plant, flown = read_library("two_mass"), chain(h)
    f = FAULTS[fault](flown.t)
    y = flown.outputs(plant.F_f, f, noise, seed)
    keep = flown.t >= 5.0 - 1e-9
    found = {}
    for name, observer in schemes().items():
        # The older schemes have their own bounds, in their own units.
        bound = 1.0 if name == "augmented" else None
        found[name] = reconstructed(observer, flown, y, bound=bound)
    tau = 0.05
    kept = np.exp(-h / tau) * found["2003"][:-1]  # the low pass of one sample, undone: what was injected in it
    found["2003, raw"] = np.append(0.0, (found["2003"][1:] - kept) * tau / h)
    return {name: (rms((one - f)[keep]), rms(np.diff(one)[keep[1:]])) for name, one in found.items()}


def older_schemes(seed: int) -> Comparison:
    """The chain of two masses: a fault that is a state beside one that is read off an injection."""
    rows, remarks = [], []
    for (fault, h, noise), references in OLDER.items():
        label = f"{fault}, {1e3 * h:g} ms, " + (f"noise {noise:g}" if noise else "no noise")
        found = compared(fault, h, noise, seed)
        for name, (error, change) in zip(COMPARED, references, strict=True):
            exact = name == "augmented" and not noise
            within, note = _how_near(name, h, noise)
            target = 0.0 if exact else None
            rows.append(Row(f"{label}: {name}", found[name][0], error, within, exact, target, note=note))
            if change is not None:
                rows.append(Row(f"{label}: {name}, change", found[name][1], change, max(within, 0.12), note=note))
        error, change = found["2002"]
        remarks.append(
            f"{label}: the cascade of 2002, which the reference leaves out: {error:.2g}, change {change:.2g}"
        )
    remarks.append("an injection is a derivative of the samples: raw, it carries 9 to 13 times the noise")
    return Comparison("Two masses: RMSE of the augmented observer and of the scheme of 2003", rows, remarks)


COMPARED = ("augmented", "2003, raw", "2003")
EXACT = "exact here, since no injection acts while time passes; the reference's variant held y in an exponential of G_l"
FULL = "at 1 ms noise exceeds h ρ, so that P0 and G_l decide, which are not the reference's: here they smooth more"
OURS = "the tuning of the scheme of 2003 is each implementation's own; the low pass here undoes its own lag"
HALF = (
    "held samples of y make the raw injection of a filter of 20 1/s too large by 10 h; the reference shows half of that"
)


def _how_near(name: str, h: float, noise: float) -> tuple[float, str]:
    """How near to the reference, relative but for what is exact, and why no nearer."""
    if name == "augmented":
        return (1e-12, EXACT) if not noise else (0.5, FULL) if h < 2e-3 else (0.06, "")
    if name == "2003":
        return 0.85, OURS
    return (0.12, OURS) if noise else (1.0, HALF)


def other_cases(seed: int) -> list[Comparison]:
    """All tables of this file."""
    return [exact_cases(seed), zeros_and_margins(), older_schemes(seed)]
