# SPDX-License-Identifier: BSD-3-Clause
"""What the sensors cannot see, and where a transfer matrix loses rank."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import qr

from faultrecon.numerics.pencil import (
    RANK_TOLERANCE,
    detectability_margin,
    invariant_zeros,
    undetectable_modes,
    unobservable_modes,
)

EPS = np.finfo(float).eps


def orthogonal(n: int, seed: int) -> np.ndarray:
    return np.asarray(qr(np.random.default_rng(seed).normal(size=(n, n)))[0])


def hidden(seed: int, seen: int, unseen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A model whose last block is invisible, in mixed orthogonal coordinates."""
    rng = np.random.default_rng(seed)
    n = seen + unseen.shape[0]
    A = np.zeros((n, n))
    A[:seen, :seen] = rng.normal(size=(seen, seen))
    A[seen:, seen:] = unseen
    A[seen:, :seen] = rng.normal(size=(unseen.shape[0], seen))
    C = np.zeros((2, n))
    C[:, :seen] = rng.normal(size=(2, seen))
    Q = orthogonal(n, seed)
    return Q @ A @ Q.T, C @ Q.T, Q[:, seen:]


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_a_hidden_block_is_found_with_its_eigenvalues_and_directions(seed: int, seen: int) -> None:
    A, C, space = hidden(seed, seen, np.array([[-0.5, 2.0], [-2.0, -0.5]]))
    modes = unobservable_modes(A, C)
    assert [round(m.value.imag, 6) for m in modes] == [2.0, -2.0]
    for mode in modes:
        # Each deflation multiplies the rounding by one singular value that may be small; what is below the tolerance of
        # a rank, in balanced units that differ by little here, counts as zero.
        assert np.linalg.norm(A @ mode.direction - mode.value * mode.direction) < 10 * RANK_TOLERANCE * np.linalg.norm(
            A
        )
        assert np.linalg.norm(C @ mode.direction) < 10 * RANK_TOLERANCE * np.linalg.norm(C)
        assert np.linalg.norm(space @ (space.T @ mode.direction)) > 1 - 1e-10
        assert mode.distance < 1e-13


def test_an_observable_model_has_no_unobservable_mode() -> None:
    rng = np.random.default_rng(3)
    assert unobservable_modes(rng.normal(size=(8, 8)), rng.normal(size=(2, 8))) == []


def test_without_sensors_every_mode_is_unobservable() -> None:
    values = sorted(m.value.real for m in unobservable_modes(np.diag([-1.0, -2.0, 3.0]), np.zeros((0, 3))))
    assert np.allclose(values, [-2, -1, 3], atol=1e-14)


def test_the_visible_half_of_a_jordan_block_does_not_hide_the_other_half() -> None:
    """Only the eigenvector of a defective eigenvalue is hidden: a rank test at computed eigenvalues misses it."""
    for k in (2, 3, 4):
        J = -0.7 * np.eye(k) + np.diag(np.ones(k - 1), 1)
        Q = orthogonal(k, k)
        C = np.zeros((1, k))
        C[0, 1] = 1.0
        modes = unobservable_modes(Q @ J @ Q.T, C @ Q.T)
        assert len(modes) == 1
        assert abs(modes[0].value + 0.7) < 1e-12
        assert abs(abs(modes[0].direction @ Q[:, 0]) - 1) < 1e-12


def test_a_hidden_double_integrator_is_one_undetectable_direction_at_exactly_zero() -> None:
    A, C, _ = hidden(5, 3, np.array([[0.0, 1.0], [0.0, 0.0]]))
    modes = undetectable_modes(A, C)
    assert len(modes) == 1
    # The two computed eigenvalues are +-1e-8; their mean is good to rounding.
    assert abs(modes[0].value) < 1e-13


def test_a_slow_hidden_mode_is_detectable_and_a_growing_one_is_not() -> None:
    A = np.diag([-1.0, -1e-5])
    C = np.array([[1.0, 0.0]])
    assert len(unobservable_modes(A, C)) == 1
    assert undetectable_modes(A, C) == []
    assert len(undetectable_modes(-A, C)) == 1


def test_sampled_modes_are_judged_against_the_unit_circle() -> None:
    A = np.diag([0.5, 0.99, 1.0, -1.2])
    C = np.array([[1.0, 0.0, 0.0, 0.0]])
    assert sorted(m.value.real for m in undetectable_modes(A, C, sampled=True)) == [-1.2, 1.0]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.lists(st.integers(-30, 30), min_size=5, max_size=5))
def test_units_that_are_powers_of_two_change_no_mode(seed: int, exponents: list[int]) -> None:
    A, C, _ = hidden(seed, 3, np.diag([-0.3, 0.4]))
    t = np.ldexp(1.0, np.array(exponents))
    before, after = unobservable_modes(A, C), unobservable_modes(A * t / t[:, None], C * t)
    # Dense random models are linked to the sensors, so balancing undoes the units bit for bit.
    assert [m.value for m in before] == [m.value for m in after]
    assert [m.distance for m in before] == [m.distance for m in after]


def test_the_margin_measures_how_small_a_coupling_keeps_a_mode_in_sight() -> None:
    def margin(coupling: float) -> float:
        return detectability_margin(np.array([[-1.0, coupling], [0.0, 0.2]]), np.array([[1.0, 0.0]]))

    assert margin(0.0) < 1e-14
    values = [margin(c) for c in (1e-12, 1e-8, 1e-4)]
    # Balancing restores a small coupling by choosing the unit of that state, as it should: nothing hides there.
    assert all(v > 1e-3 for v in values)


def test_two_nearly_equal_modes_seen_by_one_sensor_hold_by_a_hair() -> None:
    """One sensor cannot tell apart two unstable modes that coincide: the margin shrinks with their distance."""

    def margin(gap: float) -> float:
        return detectability_margin(np.diag([1.0, 1.0 + gap]), np.array([[1.0, 1.0]]))

    assert margin(0.0) < 1e-14
    for gap in (1e-2, 1e-5, 1e-8):
        # Merging them at the midpoint is a change of gap/2 in each: that is the distance to first order.
        assert 0.3 * gap < margin(gap) < 1.0 * gap


def test_the_margin_of_a_stable_unseen_mode_is_its_distance_from_the_axis() -> None:
    A = np.diag([-1.0, -0.01])
    assert abs(detectability_margin(A, np.array([[1.0, 0.0]])) - 0.01) < 1e-6


def test_zeros_of_a_square_system_are_those_of_its_numerator() -> None:
    # (s + 2)(s^2 + 9)/(s + 1)^4 in controllable form
    den, num = np.poly([-1, -1, -1, -1]), np.poly([-2, 3j, -3j]).real
    A = np.diag(np.ones(3), 1)
    A[-1] = -den[:0:-1]
    B = np.eye(4)[:, 3:]
    z = invariant_zeros(A, B, num[::-1][None, :], np.zeros((1, 1)))
    assert np.allclose(sorted(z, key=lambda s: s.imag), [-3j, -2, 3j], atol=1e-10)


def test_a_tall_system_keeps_only_the_zeros_its_outputs_share() -> None:
    A, B = np.diag([-1.0, -2.0, -3.0]), np.ones((3, 1))
    # Partial fractions with residues r: numerators share the zero s = 5 when r is chosen so.
    basis = np.array([[1 / (5 + 1.0), 1 / (5 + 2.0), 1 / (5 + 3.0)]])
    C = np.linalg.svd(basis)[2][1:]
    assert np.allclose(invariant_zeros(A, B, C, np.zeros((2, 1))), [5.0], atol=1e-9)
    assert invariant_zeros(A, B, np.eye(3), np.zeros((3, 1))).size == 0


def test_unobservable_and_uncontrollable_modes_are_invariant_zeros() -> None:
    A, B, C = np.diag([-1.0, -2.0, 4.0]), np.array([[1.0], [1.0], [0.0]]), np.array([[1.0, 1.0, 1.0]])
    assert np.allclose(invariant_zeros(A, B, C, np.zeros((1, 1))), [-1.5, 4.0], atol=1e-10)


def test_a_transfer_matrix_that_is_rank_deficient_everywhere_reports_no_spurious_zero() -> None:
    rng = np.random.default_rng(0)
    A, b, C = rng.normal(size=(5, 5)), rng.normal(size=(5, 1)), rng.normal(size=(3, 5))
    assert invariant_zeros(A, np.hstack([b, 2 * b]), C, np.zeros((3, 2))).size == 0


def test_direct_feedthrough_gives_as_many_zeros_as_states() -> None:
    rng = np.random.default_rng(1)
    A, B, C, D = rng.normal(size=(4, 4)), rng.normal(size=(4, 2)), rng.normal(size=(2, 4)), np.eye(2)
    exact = np.linalg.eigvals(A - B @ C)
    assert np.allclose(np.sort_complex(invariant_zeros(A, B, C, D)), np.sort_complex(exact), atol=1e-10)
