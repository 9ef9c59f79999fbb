# SPDX-License-Identifier: BSD-3-Clause
"""The implicit injection solves its inclusion, whatever the problem, and loses chatter without losing exactness."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.finding import InputError
from faultrecon.numerics.proximal import ImplicitMatrix, implicit_injection, implicit_matrix

Array = np.ndarray
ROUNDING = 1e-13  # a hundred roundings, relative to the output error


def matrix(w: Array, rng: np.random.Generator) -> ImplicitMatrix:
    """W with eigenvalues w and random eigenvectors."""
    U = np.linalg.qr(rng.normal(size=(w.size, w.size)))[0]
    return ImplicitMatrix(U * w @ U.T, w, U, 0.0)


def designed(seed: int, h: float) -> tuple[ImplicitMatrix, Array, Array]:
    """W of a design (47): P0 and R random and positive, C_a Gl = gamma0 P0^-1 R^-1."""
    rng = np.random.default_rng(seed)
    p = int(rng.integers(1, 6))
    P0, R = (X @ X.T + 0.1 * np.eye(p) for X in rng.normal(size=(2, p, p)))
    CaGl = 10.0 * np.linalg.inv(R @ P0)
    return implicit_matrix(P0, CaGl, h), P0, CaGl


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 100_000), st.integers(1, 8), st.floats(0, 9), st.floats(-6, 1), st.floats(-6, 6), st.booleans())
def test_the_residual_is_rounding_on_any_problem(
    seed: int, p: int, decades: float, strength: float, layer: float, smooth: bool
) -> None:
    rng = np.random.default_rng(seed)
    w = np.sort(10.0 ** (-decades * rng.random(p)))  # at most 1
    eh = rng.normal(size=p)
    size = float(np.linalg.norm(eh))
    found = implicit_injection(matrix(w, rng), eh, 0.01, 100 * size * 10**strength, 10**layer if smooth else 0.0)
    # W itself is rounded: with an s of size 1/w_min that alone leaves eps |W| |s| per entry.
    assert found.residual <= 1e-10 * size + 1e-15 * p * np.linalg.norm(found.s)
    assert np.linalg.norm(found.nu) <= 100 * size * 10**strength * (1 + ROUNDING)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 100_000), st.floats(-4, 0), st.sampled_from([0.0, 1e-3, 0.1]))
def test_the_step_solves_the_equation_of_the_observer(seed: int, step: float, delta: float) -> None:
    """(I + h C_a Gl) e - h nu = eh with nu from e = P0^-1 s: the definition, without W."""
    h = 10**step
    W, P0, CaGl = designed(seed, h)
    rng = np.random.default_rng(seed + 1)
    eh, rho = rng.normal(size=len(P0)), 0.3 / h
    found = implicit_injection(W, eh, h, rho, delta)
    e = np.linalg.solve(P0, found.s)
    tolerance = 1e-11 * max(np.linalg.cond(P0), 1.0)  # of e, through P0^-1 twice
    assert W.asymmetry <= 1e-12 * np.linalg.cond(P0) ** 2
    assert np.allclose((np.eye(len(P0)) + h * CaGl) @ e - h * found.nu, eh, atol=tolerance)
    if not found.inside:
        assert np.allclose(found.nu, -rho * P0 @ e / (np.linalg.norm(P0 @ e) + delta), atol=tolerance * rho)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 100_000), st.floats(0.0, 1.0))
def test_an_error_within_reach_is_removed_by_the_equivalent_injection(seed: int, share: float) -> None:
    h, rho = 0.01, 5.0
    W, P0, _ = designed(seed, h)
    eh = np.random.default_rng(seed).normal(size=len(P0))
    eh *= share * h * rho * (1 - ROUNDING) / np.linalg.norm(eh)
    found = implicit_injection(W, eh, h, rho)
    assert found.inside and found.residual == 0.0
    assert not found.s.any()
    assert np.array_equal(found.nu, -eh / h)


def test_no_error_needs_no_injection() -> None:
    for delta in (0.0, 0.1):
        found = implicit_injection(designed(1, 0.01)[0], np.zeros(len(designed(1, 0.01)[1])), 0.01, 1.0, delta)
        assert not found.s.any() and not found.nu.any()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 100_000), st.floats(-2, 2))
def test_as_the_layer_vanishes_the_injection_tends_to_the_set_valued_one(seed: int, strength: float) -> None:
    """From inside and from outside the reach of the injection, to first order in delta."""
    h = 0.01
    W, P0, _ = designed(seed, h)
    eh = np.random.default_rng(seed).normal(size=len(P0))
    rho = float(np.linalg.norm(eh)) / h * 10**strength
    exact = implicit_injection(W, eh, h, rho)
    scale = h * rho / W.w[0]  # of s
    misses = [np.linalg.norm(implicit_injection(W, eh, h, rho, d * scale).nu - exact.nu) / rho for d in (1e-6, 1e-12)]
    # Next to the border |eh| = h rho, s goes with the root of delta: 1e-3 and 1e-6, times the condition of W.
    spread = W.w[-1] / W.w[0]
    assert misses[0] <= 1e-2 * spread and misses[1] <= 1e-5 * spread


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 100_000), st.sampled_from([0.0, 0.05]))
def test_the_injection_is_monotone_and_continuous_in_the_error(seed: int, delta: float) -> None:
    """s is the resolvent of a maximal monotone operator: (s1 - s2)'(e1 - e2) >= w_min |s1 - s2|^2."""
    W, P0, _ = designed(seed, 0.01)
    a, b = 0.1 * np.random.default_rng(seed).normal(size=(2, len(P0)))
    s, t = (implicit_injection(W, eh, 0.01, 5.0, delta).s for eh in (a, b))
    assert (s - t) @ (a - b) >= W.w[0] * (s - t) @ (s - t) - 1e-12


def test_the_iterates_rise_to_the_root_from_below() -> None:
    rng = np.random.default_rng(4)
    for delta in (0.0, 1e-2, 1.0):
        W = matrix(np.array([1e-6, 1e-3, 1.0]), rng)
        eh = np.array([0.3, -0.5, 0.8])
        size = [np.linalg.norm(implicit_injection(W, eh, 1.0, 0.9, delta, iterations=k).s) for k in range(21)]
        assert np.all(np.diff(size) >= -ROUNDING * size[-1])


def test_equal_eigenvalues_need_no_iteration() -> None:
    W = implicit_matrix(2.0 * np.eye(3), np.zeros((3, 3)), 0.01)
    for delta in (0.0, 0.1):
        assert implicit_injection(W, [0.3, -0.4, 0.1], 0.01, 5.0, delta, iterations=0).residual <= ROUNDING


def test_one_channel_gives_the_soft_threshold() -> None:
    W = implicit_matrix([[2.0]], [[0.0]], 0.1)
    found = implicit_injection(W, [0.5], 0.1, 3.0)
    assert found.s == pytest.approx([0.4]) and found.nu == pytest.approx([-3.0])  # 0.5 s = 0.5 - 0.3


def test_a_gain_that_is_not_symmetric_is_solved_approximately_and_says_so() -> None:
    P0, eh = np.diag([1.0, 2.0, 0.5]), np.array([0.3, -0.2, 0.25])
    skew = np.array([[4.0, 3.0, 0.0], [-3.0, 4.0, 1.0], [0.0, -1.0, 4.0]])
    residuals = []
    for h in (1e-2, 1e-3):
        W = implicit_matrix(P0, skew, h)
        found = implicit_injection(W, eh, h, 0.1 / h)
        assert W.asymmetry > 1e-3 * h / 1e-2
        honest = np.linalg.norm((np.eye(3) + h * skew) @ np.linalg.solve(P0, found.s) - h * found.nu - eh)
        assert found.residual == pytest.approx(honest, rel=1e-9)
        residuals.append(found.residual)
    # The part left out is h times the skew part of C_a Gl P0^-1: the residual falls with h.
    assert residuals[1] == pytest.approx(0.1 * residuals[0], rel=0.1)


def test_within_reach_also_a_gain_that_is_not_symmetric_is_solved_exactly() -> None:
    W = implicit_matrix(np.eye(2), [[1.0, 50.0], [-50.0, 1.0]], 0.01)
    assert implicit_injection(W, [0.01, 0.02], 0.01, 5.0).residual == 0.0


def test_a_sliding_output_does_not_chatter() -> None:
    """e' = d + nu with |d| < rho: after the reaching phase the error is zero at every sample, nu is -d of the last."""
    h, rho = 0.01, 1.0
    W = implicit_matrix(np.diag([0.3, 1.0, 4.0]), np.zeros((3, 3)), h)
    e, history = np.array([0.05, -0.02, 0.03]), []
    for k in range(200):
        eh = e + h * 0.5 * np.array([np.sin(0.05 * k), 0.3, np.cos(0.05 * k)])
        nu = implicit_injection(W, eh, h, rho).nu
        e = eh + h * nu
        history.append(np.linalg.norm(e))
    assert max(history[60:]) <= 1e-15
    assert np.all(np.diff(history[:20]) <= 0)


@pytest.mark.parametrize(("delta", "rho", "words"), [(-0.1, 1.0, "no step"), (0.0, 0.0, "no step")])
def test_a_step_without_meaning_is_refused(delta: float, rho: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        implicit_injection(implicit_matrix(np.eye(2), np.eye(2), 0.01), [1.0, 2.0], 0.01, rho, delta)


def test_a_matrix_that_is_not_monotone_is_refused() -> None:
    with pytest.raises(InputError, match="P0 is not symmetric"):
        implicit_matrix(-np.eye(2), np.eye(2), 0.01)
    with pytest.raises(InputError, match="not monotone"):
        implicit_matrix(np.eye(2), -200 * np.eye(2), 0.01)
    with pytest.raises(InputError, match="same p outputs"):
        implicit_matrix(np.eye(2), np.eye(3), 0.01)
