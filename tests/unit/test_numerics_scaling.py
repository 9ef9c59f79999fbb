# SPDX-License-Identifier: BSD-3-Clause
"""Units as exact powers of two."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.finding import InputError
from faultrecon.numerics.scaling import scale_states, state_scaling

Model = tuple[np.ndarray, np.ndarray, np.ndarray]


def model(seed: int, n: int = 5) -> Model:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.6)
    return A, rng.normal(size=(n, 2)), rng.normal(size=(1, n)) * (rng.random((1, n)) < 0.5)


def in_units(
    model: tuple[np.ndarray, np.ndarray, np.ndarray], k: list[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return scale_states(*model, np.array(k, dtype=np.int64))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.lists(st.integers(-15, 15), min_size=5, max_size=5))
def test_a_change_of_units_moves_the_exponents_by_exactly_that_much(seed: int, k: list[int]) -> None:
    assert np.array_equal(state_scaling(*in_units(model(seed), k)), state_scaling(*model(seed)) - np.array(k))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.lists(st.integers(-15, 15), min_size=5, max_size=5))
def test_declared_ranges_move_with_the_units_too(seed: int, k: list[int]) -> None:
    ranges = np.array([3.0, np.nan, 0.01, np.nan, np.nan])
    before = state_scaling(*model(seed), ranges=ranges)
    after = state_scaling(*in_units(model(seed), k), ranges=ranges / np.ldexp(1.0, np.array(k)))
    assert np.array_equal(after, before - np.array(k))


def test_a_declared_range_fixes_its_exponent() -> None:
    e = state_scaling(*model(1), ranges=[1000.0, np.nan, 0.3, np.nan, 1.0])
    assert (e[0], e[2], e[4]) == (10, -2, 0)


def test_scaling_loses_no_bit() -> None:
    A, B, C = model(2)
    e = state_scaling(A, B, C)
    back = scale_states(*scale_states(A, B, C, e), -e)
    assert all(np.array_equal(x, y) for x, y in zip(back, (A, B, C), strict=True))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.lists(st.integers(-18, 18), min_size=6, max_size=6))
def test_badly_chosen_units_are_mended(seed: int, k: list[int]) -> None:
    """The balanced model is no larger than the one the bad units were applied to (rounded exponents: factor 4)."""
    rng = np.random.default_rng(seed)
    good = rng.uniform(0.5, 2, size=(6, 6)), rng.uniform(0.5, 2, size=(6, 1)), rng.uniform(0.5, 2, size=(1, 6))
    bad = in_units(good, k)
    mended = scale_states(*bad, state_scaling(*bad))
    assert max(np.abs(M).max() for M in mended) <= 4 * 4


def test_a_triangular_chain_does_not_drift_without_bound() -> None:
    n = 12
    A = np.triu(np.ones((n, n)))
    e = state_scaling(A, np.zeros((n, 0)), np.zeros((0, n)))
    # Nothing links the first state back to the last: plain balancing would drive the ends apart
    # for ever; 2^-3 a link is enough.
    assert np.ptp(e) <= 3 * (n - 1)


def test_states_linked_to_nothing_are_left_alone() -> None:
    assert np.array_equal(state_scaling(np.diag([1.0, 1e6]), np.zeros((2, 0)), np.zeros((0, 2))), [0, 0])


def test_an_entry_that_is_rounding_noise_does_not_decide_the_units() -> None:
    A, B, C = np.array([[-1.0, 1.0], [1.0, -2.0]]), np.array([[1.0], [0.0]]), np.array([[0.0, 1.0]])
    clean = state_scaling(A, B, C)
    noisy = state_scaling(A, B + [[0.0], [1e-17]], C)
    assert np.max(np.abs(clean - noisy)) <= 1


@pytest.mark.parametrize("size", [0.0, -1.0, np.inf])
def test_a_range_that_is_not_positive_is_refused_with_the_state_named(size: float) -> None:
    with pytest.raises(InputError, match="range of state 2"):
        state_scaling(*model(1), ranges=[1, size, 1, 1, 1])
