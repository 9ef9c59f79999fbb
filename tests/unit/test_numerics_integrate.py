# SPDX-License-Identifier: BSD-3-Clause
"""Reference trajectories against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from faultrecon.finding import Inconclusive, InputError
from faultrecon.numerics.integrate import reference_solution


def test_a_linear_system_follows_its_exponential() -> None:
    A = np.array([[0.0, 1.0], [-4.0, -0.3]])
    t = np.linspace(0.0, 10.0, 41)
    X = reference_solution(lambda _, x: A @ x, [1.0, -1.0], t)
    exact = np.array([expm(A * s) @ [1.0, -1.0] for s in t])
    # rtol 1e-10 per step, some hundred steps.
    assert np.allclose(X, exact, rtol=0, atol=1e-8)


def test_a_jump_at_a_breakpoint_is_not_smeared() -> None:
    t = np.array([0.0, 0.5, 1.0, 2.0])
    X = reference_solution(lambda s, _: [1.0 if s >= 1 / 3 else 0.0], [0.0], t, breakpoints=[1 / 3])
    # The right-hand side is constant on both pieces: only roundings are left.
    assert np.allclose(X[:, 0], np.maximum(t - 1 / 3, 0), rtol=0, atol=1e-14)


def test_samples_held_between_breakpoints_are_integrated_sample_by_sample() -> None:
    h, u = 0.1, np.random.default_rng(0).normal(size=50)
    t = h * np.arange(51)
    X = reference_solution(
        lambda s, x: -x + u[min(int(np.searchsorted(t, s, side="right")) - 1, 49)],
        [0.0],
        t,
        breakpoints=t[1:-1].tolist(),
    )
    exact = [0.0]
    for value in u:
        exact.append(np.exp(-h) * exact[-1] + (1 - np.exp(-h)) * value)
    assert np.allclose(X[:, 0], exact, rtol=0, atol=1e-10)


def test_a_grid_of_one_time_returns_the_start() -> None:
    assert np.array_equal(reference_solution(lambda _, x: x, [2.0, 3.0], [5.0]), [[2.0, 3.0]])


def test_a_trajectory_that_escapes_in_finite_time_is_inconclusive_and_says_where() -> None:
    with pytest.raises(Inconclusive, match=r"no reference solution between t = 0\.5 and 2"):
        reference_solution(lambda _, x: x**2, [1.0], [0.0, 2.0], breakpoints=[0.5])


@pytest.mark.parametrize("grid", [[0.0, 0.0], [1.0, 0.0], [], [0.0, np.nan]])
def test_a_grid_that_does_not_increase_is_refused(grid: list[float]) -> None:
    with pytest.raises(InputError, match="not strictly increasing"):
        reference_solution(lambda _, x: x, [1.0], grid)
