# SPDX-License-Identifier: BSD-3-Clause
"""Holds, step limits and held noise against independent arithmetic."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov, solve_discrete_lyapunov

from faultrecon.finding import Impossible, InputError
from faultrecon.numerics.discretise import (
    continuous_covariance,
    discrete_covariance,
    foh,
    held_noise_covariance,
    rk4_polynomial_limit,
    van_loan_covariance,
    zoh,
)

EPS = np.finfo(float).eps


def stable(n: int, m: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    return A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n), rng.normal(size=(n, m))


def fine_rk4(A: np.ndarray, B: np.ndarray, u, x: np.ndarray, h: float, steps: int) -> np.ndarray:
    d = h / steps
    for k in range(steps):
        t = k * d
        k1 = A @ x + B @ u(t)
        k2 = A @ (x + d / 2 * k1) + B @ u(t + d / 2)
        k3 = A @ (x + d / 2 * k2) + B @ u(t + d / 2)
        k4 = A @ (x + d * k3) + B @ u(t + d)
        x = x + d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def test_a_held_input_is_integrated_exactly() -> None:
    A, B = stable(5, 2, 0)
    Ad, Bd = zoh(A, B, 0.3)
    # With A invertible the integral has a closed form; its condition number is that of A.
    closed = np.linalg.solve(A, (expm(0.3 * A) - np.eye(5)) @ B)
    assert np.allclose(Ad, expm(0.3 * A), rtol=0, atol=100 * EPS)
    assert np.allclose(Bd, closed, rtol=0, atol=100 * EPS * np.linalg.cond(A))


def test_an_integrator_needs_no_inverse() -> None:
    Ad, Bd = zoh(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), 0.5)
    assert np.allclose(Ad, [[1, 0.5], [0, 1]], rtol=0, atol=2 * EPS)
    assert np.allclose(Bd, [[0.125], [0.5]], rtol=0, atol=2 * EPS)


def test_two_half_steps_make_one_step() -> None:
    A, B = stable(4, 3, 1)
    Ad, Bd = zoh(A, B, 0.2)
    Ah, Bh = zoh(A, B, 0.1)
    assert np.allclose(Ah @ Ah, Ad, rtol=0, atol=200 * EPS)
    assert np.allclose(Ah @ Bh + Bh, Bd, rtol=0, atol=200 * EPS * np.linalg.norm(B))


def test_an_input_in_straight_lines_is_integrated_exactly() -> None:
    A, B = stable(4, 2, 2)
    x0, a, b, h = np.ones(4), np.array([1.0, -2.0]), np.array([0.5, 3.0]), 0.4
    Ad, B0, B1 = foh(A, B, h)
    # 200 RK4 steps of 2 ms on a system with |A| about 4: local error (8e-3)^5/120 each, 5e-11 in all.
    reference = fine_rk4(A, B, lambda t: a + (b - a) * t / h, x0, h, 200)
    assert np.allclose(Ad @ x0 + B0 @ a + B1 @ b, reference, rtol=0, atol=1e-10)


def test_a_constant_input_is_the_same_under_both_holds() -> None:
    A, B = stable(4, 2, 3)
    Ad, Bd = zoh(A, B, 0.7)
    Af, B0, B1 = foh(A, B, 0.7)
    assert np.allclose(Ad, Af, rtol=0, atol=100 * EPS)
    assert np.allclose(B0 + B1, Bd, rtol=0, atol=200 * EPS * np.linalg.norm(B))


def test_badly_chosen_units_do_not_cost_accuracy() -> None:
    A, B = stable(4, 1, 4)
    t = np.ldexp(1.0, np.array([30, -25, 0, 12]))
    Ad, Bd = zoh(A, B, 0.3)
    As, Bs = zoh(A * t / t[:, None], B / t[:, None], 0.3)
    assert np.array_equal(As, Ad * t / t[:, None])
    assert np.array_equal(Bs, Bd / t[:, None])


def test_rk4_reaches_2_7853_on_the_real_axis_and_2_8284_beside_the_imaginary_one() -> None:
    # Real axis: the real root of R(z) = 1, z^3 + 4 z^2 + 12 z + 24 = 0.
    real = -min(np.roots([1, 4, 12, 24]), key=lambda z: abs(z.imag)).real
    assert abs(rk4_polynomial_limit([-1.0]) - real) < 1e-12
    assert abs(rk4_polynomial_limit([-2105.0]) * 2105 - real) < 1e-9
    assert abs(rk4_polynomial_limit([-1e-13 + 1j]) - np.sqrt(8)) < 1e-6


def test_just_inside_the_limit_rk4_decays_and_just_outside_it_grows() -> None:
    s = np.array([-1 + 2j, -1 - 2j, -3.0, -0.01 + 5j, -0.01 - 5j, 0.4])
    h = rk4_polynomial_limit(s)

    def growth(h: float) -> float:
        z = h * s[:-1]
        return float(np.max(np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)))

    assert growth(0.999 * h) < 1
    assert growth(1.001 * h) > 1


def test_without_a_decaying_mode_there_is_no_limit() -> None:
    assert rk4_polynomial_limit([0.0, 1.0, 2j]) == np.inf


def test_held_noise_on_a_first_order_lag_has_its_textbook_variance() -> None:
    a, s2, h = 3.0, 0.7, 0.05
    P = held_noise_covariance([[-a]], [[a]], [s2], h)
    d = np.exp(-a * h)
    assert abs(P[0, 0] - s2 * (1 - d) ** 2 / (1 - d**2)) < 10 * EPS


def test_held_noise_tends_to_white_noise_of_intensity_variance_times_hold_time() -> None:
    A, B = stable(4, 2, 5)
    white = continuous_covariance(A, B, np.diag([2.0, 3.0]))
    h = 1e-5
    held = held_noise_covariance(A, B, np.array([2.0, 3.0]) / h, h)
    # The difference is of order h |A|, about 1e-4.
    assert np.linalg.norm(held - white) < 20 * h * np.linalg.norm(A) * np.linalg.norm(white)


def test_the_covariance_solves_its_own_equation() -> None:
    A, B = stable(6, 3, 6)
    Ad, Bd = zoh(A, B, 0.1)
    P = held_noise_covariance(A, B, np.ones(3), 0.1)
    oracle = solve_discrete_lyapunov(Ad, Bd @ Bd.T)
    assert np.allclose(P, oracle, rtol=0, atol=1e-11 * np.linalg.norm(P))
    assert np.linalg.eigvalsh(P)[0] >= -EPS * np.linalg.norm(P)


def test_a_measured_sequence_has_the_predicted_variance() -> None:
    A, B = np.array([[0.0, 1.0], [-4.0, -1.0]]), np.array([[0.0], [1.0]])
    P = held_noise_covariance(A, B, [1.0], 0.1)
    Ad, Bd = zoh(A, B, 0.1)
    rng = np.random.default_rng(0)
    x, total, count = np.zeros((2, 2000)), np.zeros(2), 0
    for k in range(400):
        x = Ad @ x + Bd @ rng.normal(size=(1, 2000))
        if k >= 200:  # e^(-0.5 * 20 s): the start is forgotten
            total, count = total + np.sum(x**2, axis=1), count + 2000
    # 2000 independent runs of 20 s, correlation time about 1 s: 2000*20/2 = 2e4 independent samples, sd 1 %.
    assert np.allclose(total / count, np.diag(P), rtol=0.04)


def test_van_loan_agrees_with_quadrature_also_over_a_step_far_longer_than_the_fast_modes() -> None:
    A, B = np.array([[-2000.0, 5.0], [0.0, -1.0]]), np.eye(2)
    W = np.diag([3.0, 0.5])
    Ad, Q = van_loan_covariance(A, B, W, 0.5)
    P = solve_continuous_lyapunov(A, -B @ W @ B.T)
    E = expm(0.5 * A)
    assert np.allclose(Ad, E, rtol=0, atol=1e-13)
    assert np.allclose(Q, P - E @ P @ E.T, rtol=0, atol=1e-13)  # P of order 0.25


def test_noise_on_a_mode_that_does_not_decay_has_no_stationary_covariance() -> None:
    with pytest.raises(Impossible, match="no stationary covariance"):
        held_noise_covariance([[0.0]], [[1.0]], [1.0], 0.1)
    with pytest.raises(Impossible, match="no stationary covariance"):
        continuous_covariance([[0.1]], [[1.0]], [[1.0]])
    with pytest.raises(Impossible, match="no stationary covariance"):
        discrete_covariance([[1.0]], [[1.0]])


def test_a_hold_time_or_variance_that_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="hold time"):
        held_noise_covariance([[-1.0]], [[1.0]], [1.0], 0.0)
    with pytest.raises(InputError, match="negative"):
        held_noise_covariance([[-1.0]], [[1.0]], [-1.0], 0.1)
