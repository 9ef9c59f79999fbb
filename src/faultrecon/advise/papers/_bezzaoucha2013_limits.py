# SPDX-License-Identifier: BSD-3-Clause
"""What nobody can do on the reactor of Bezzaoucha et al. 2013, and what the printed observer does wrong, in numbers."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.advise.papers._bezzaoucha2013_runs import (
    CONSTANTS,
    NOISE,
    STEP,
    X0,
    Case,
    by_hand,
    dilution,
    printed,
    reactor,
    right_side,
    states,
    times,
)
from faultrecon.advise.reproductions import Comparison, Row
from faultrecon.methods.takagi_sugeno import faulty_outputs
from faultrecon.numerics.integrate import reference_solution
from faultrecon.plant.polytopic import weights
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction

Array = NDArray[Any]

WINDOWS = (5.0, 10.0, 20.0, 40.0)
CRLB = {
    0.0: (65.87, 8.416, 0.07588, 5.265e-4),
    10.0: (3.559, 0.1454, 1.173e-3, 4.02e-4),
    20.0: (0.05828, 1.890e-3, 6.70e-4, 3.60e-4),
    30.0: (2.767e-3, 1.078e-3, 5.29e-4, 3.30e-4),
    60.0: (3.110e-3, 1.124e-3, 5.59e-4, 3.37e-4),
}
"""Least standard deviation of f by start and length of the window, h."""
CONSTANT_INPUT = (2.584e-3, 9.88e-4, 5.19e-4, 3.26e-4)


def information() -> Comparison:
    """Cramér-Rao bounds: no prior, exact model, f constant, sd 0.02 every 0.1 h."""
    rows = []
    for start, values in CRLB.items():
        x = states()[round(start / STEP)]
        rows += [
            Row(f"from {start:g} h (x2 = {x[1]:.3g}), {T:g} h", sd, value, 0.01)
            for T, sd, value in zip(WINDOWS, bounds(x, start, dilution), values, strict=True)
        ]
    still = bounds(np.array(reactor().point.x), 60.0, lambda t: 0.33)
    rows += [
        Row(f"at rest, u = 0.33, {T:g} h", sd, value, 0.01, note=MODEL)
        for T, sd, value in zip(WINDOWS, still, CONSTANT_INPUT, strict=True)
    ]
    return Comparison("Least standard deviation of f that any unbiased estimator has", rows, (BEFORE,))


MODEL = "a constant input is as good as a rich one: what tells f apart is the model, not excitation"
BEFORE = "within the first 20 h no estimator tells a quarter of the gain from nothing: g' is flat where x2 is large"


def bounds(x: Array, start: float, u: Callable[[float], float]) -> list[float]:
    """The bounds for windows from `start`, the state there x, by the information about (x, f) at f = 0."""
    t, Phi, path = sensitivities(x, start, WINDOWS[-1], u)
    found = []
    for T in WINDOWS:
        k = (t <= start + T + 1e-9) & (np.arange(len(t)) % 5 == 0)
        S = np.column_stack([Phi[k, 0, :], path[k, 0]]) / NOISE
        # Scaled by columns: the directions differ by 1e5, which R of a QR keeps and SᵀS would lose.
        size = np.linalg.norm(S, axis=0)
        R = np.asarray(np.linalg.qr(S / size, mode="r"))
        found.append(float(np.linalg.norm(np.linalg.solve(R.T, np.eye(3)[2])) / size[2]))
    return found


def sensitivities(x: Array, start: float, length: float, u: Callable[[float], float]) -> tuple[Array, Array, Array]:
    """Times (N,), ∂x(t)/∂x(start) (N, 2, 2) and x (N, 2) every 0.02 h."""
    a, b, c = CONSTANTS["a"], CONSTANTS["b"], CONSTANTS["c"]

    def rate(t: float, s: Array) -> Array:
        x1, x2, Phi, v = s[0], s[1], s[2:].reshape(2, 2), u(start + t)
        g, h = a * x2 / (x2 + b), a * b * x1 / (x2 + b) ** 2
        J = np.array([[g - v, h], [-c * g, -c * h - v]])
        return np.concatenate([right_side(s[:2], v, CONSTANTS), (J @ Phi).ravel()])

    t = STEP * np.arange(round(length / STEP) + 1)
    s = reference_solution(rate, [*x, 1.0, 0.0, 0.0, 1.0], t, rtol=1e-10, atol=1e-13)
    return start + t, s[:, 2:].reshape(-1, 2, 2), s[:, :2]


# ---------------------------------------------------------------- the open loop, gauges


def open_loop() -> Comparison:
    """How fast the model forgets where it started, and what it makes of a wrong start before."""
    _, Phi, _ = sensitivities(np.array(X0), 0.0, 40.0, dilution)
    sizes = np.linalg.norm(Phi, 2, axis=(1, 2))
    _, late, _ = sensitivities(states()[round(60.0 / STEP)], 60.0, 80.0, dilution)
    x2 = states()[[round(10.0 / STEP), round(30.0 / STEP)], 1]
    a, b, c = CONSTANTS["a"], CONSTANTS["b"], CONSTANTS["c"]
    told = c * a * x2 / (x2 + b) * (a * b / (x2 + b) ** 2) ** 2
    rows = [
        Row("largest |Φ(t, 0)|", float(sizes.max()), 22.74, 1e-3, note="an error of the start grows first"),
        Row("|Φ(40, 0)|", float(sizes[-1]), 5.3e-6, 0.02),
        Row("mean rate of -ln |Φ| from 60 to 140 h", float(-np.log(np.linalg.norm(late[-1], 2)) / 80), 0.3126, 1e-3),
        Row("c g g'² at 10 h, x2 = 2.26", float(told[0]), 1.4e-5, 0.02, note=LIE),
        Row("c g g'² at 30 h, x2 = 0.056", float(told[1]), 0.749, 0.002, note=LIE),
    ]
    return Comparison("The model that nothing corrects", rows)


LIE = "the determinant of the Lie derivatives of log y by (x1, x2, f) is this over 1 + f: small where x2 is large"


def gauges() -> Comparison:
    """Constants that are a gain of the sensor: readings differ by rounding alone."""
    s, t = 1.3, STEP * np.arange(round(40.0 / STEP) + 1)
    plain = states()[: len(t), 0]
    rows = []
    for name, x0, changed in (
        ("(x1, c, 1 + f) to (s x1, c/s, (1 + f)/s)", (s * X0[0], X0[1]), {"c": CONSTANTS["c"] / s}),
        ("(x1, x2, b, d) to s times, (1 + f)/s", (s * X0[0], s * X0[1]), {k: s * CONSTANTS[k] for k in "bd"}),
    ):
        k = {**CONSTANTS, **changed}
        x = reference_solution(
            lambda at, v, k=k: np.array(right_side(v, dilution(at), k)), list(x0), t, rtol=1e-12, atol=1e-14
        )
        rows.append(Row(f"{name}, s = 1.3", float(np.abs(x[:, 0] / s - plain).max()), 0.0, 1e-8, True, note=SAME))
    return Comparison("Exact gauges: largest difference of the readings", rows)


SAME = "two integrations with a tolerance of 1e-10; as rational functions the two are equal"


# ---------------------------------------------------------------- the printed observer


def printed_observer() -> Comparison:
    """Swapped vertices of the fault, weights outside their interval, and the bias of the leak."""
    ends = [_form().faults["fouling"]]
    upper, lower = map(float, weights([[0.0]], ends)[0])
    C, f = faulty_outputs(printed()), 0.4
    literal = sum(w * one[0, 0] for w, one in zip(weights([[f]], ends)[0], reversed(C), strict=True))
    rows = [
        Row("weight of the upper bound at f = 0", upper, -0.25, 1e-12, True, note=OUTSIDE),
        Row("weight of the lower bound at f = 0", lower, 1.25, 1e-12, True, note=OUTSIDE),
        Row(
            "gain at f = 0.4 with (57) as printed",
            float(literal),
            1 + 0.125 + 0.625 - f,
            1e-12,
            True,
            printed=1 + f,
            status="not_as_printed",
            note=SWAPPED,
        ),
        Row("f̂ beyond 10 with (57) as printed, at h", runaway(), 4.86, 0.01, status="not_as_printed", note=SWAPPED),
    ]
    x1 = reactor().point.x[0]
    for alpha, value in ((0.1, 0.497095), (1.0, 0.472395), (10.0, 0.315589)):
        formula = 0.5 * 5 * x1 / (alpha + 5 * x1)
        rows.append(
            Row(f"f̂ of f = 0.5 with leak α = {alpha:g}", leaking(alpha), value, 1e-4, expected=formula, note=LEAK)
        )
    return Comparison("The printed observer", rows)


OUTSIDE = "the printed interval [0.125, 0.625] leaves the healthy sensor out: weights are not convex there"
SWAPPED = (
    "M9: C̃_1 and C̃_2 of (57) belong to the other bound; as printed the gain is 1 + f_lo + f_hi - f̂ and the loop runs"
    " away"
)
LEAK = "the leak -α f̂ biases a constant fault: f̂ = f K x1/(α + K x1); the reference had another x1"


def _form() -> Any:
    form = printed().polytopic
    assert form is not None
    return form


@lru_cache(maxsize=1)
def runaway() -> float:
    """When |f̂| passes 10 with L = 0, K = 5, α = 0 and the vertices of the fault swapped as printed, h."""
    y, t = Case("step").y[:, 0], times()

    def rate(at: float, z: Array) -> Array:
        slope = right_side(z[:2], dilution(at), CONSTANTS)
        return np.array([*slope, 5.0 * (np.interp(at, t, y) - (1 + 0.125 + 0.625 - z[2]) * z[0])])

    z, h, now = np.array([0.09, 2.3, 0.0]), 0.002, 0.0
    while abs(z[2]) <= 10.0 and now < 20.0:
        z = z + h * rate(now + 0.5 * h, z + 0.5 * h * rate(now, z))
        now += h
    return now


def leaking(alpha: float) -> float:
    """Where f̂ settles when f = 0.5, by the structure with L = 0 and K = 5."""
    plant = reactor()
    observer = by_hand((0.0, 0.0), 5.0, alpha, plant)
    estimator = Estimator.build(observer, STEP, prediction=Prediction(plant.C, plant.D))
    t = STEP * np.arange(2000)
    y = np.full((2000, 1), 1.5 * plant.point.x[0])
    u = np.tile(np.array(plant.point.u), (2000, 1))
    return float(estimator.replay(t, u, y, x=plant.point.x).fault[-1, 0])
