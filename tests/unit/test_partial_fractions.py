# SPDX-License-Identifier: BSD-3-Clause
"""Sums over poles: their values, their minima, and the claim that nothing anywhere is lower."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.numerics.hinf import estimator_floor
from faultrecon.numerics.partial_fractions import PartialFractions, partial_fractions
from faultrecon.numerics.shared_floor import NoisyOutputs

SEEDS = st.integers(0, 2**32 - 1)


def outputs(seed: int, n: int, p: int, sharp: float = 0.3) -> NoisyOutputs:
    """A plant whose slowest mode decays at `sharp`, with noise on every output."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n)) / np.sqrt(n)
    A -= (np.linalg.eigvals(A).real.max() + sharp) * np.eye(n)
    B, E = np.hstack([rng.normal(size=(n, 1)), np.zeros((n, p))]), np.hstack([np.zeros((p, 1)), 0.1 * np.eye(p)])
    found = NoisyOutputs.of(A, B, rng.normal(size=(p, n)), E)
    assert found is not None
    return found


def information(model: NoisyOutputs) -> PartialFractions:
    """The diagonal of (Y Y*)^-1, which is what a fault on one sensor meets."""
    found = partial_fractions(model.H, model.into, model.out, model.through)
    assert found is not None
    poles, into, out = found
    return PartialFractions(poles, into * out.T, np.diag(model.through))


GRID = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 4000), [np.inf]])


@given(SEEDS, st.integers(1, 12), st.integers(2, 5))
@settings(max_examples=30, deadline=None)
def test_partial_fractions_are_the_inverse_of_the_spectrum(seed: int, n: int, p: int) -> None:
    model = outputs(seed, n, p)
    Y = model.response(GRID)
    direct = np.diagonal(np.linalg.inv(Y @ Y.conj().transpose(0, 2, 1)), axis1=1, axis2=2).real
    # Eigenvectors of a random matrix of order 24 have a condition of about 1e4 at worst: 1e-16 * 1e4, squared margins.
    np.testing.assert_allclose(information(model).values(GRID), direct, rtol=1e-7)


@given(SEEDS, st.integers(1, 12), st.integers(2, 5), st.floats(0.05, 1.0))
@settings(max_examples=40, deadline=None)
def test_what_is_shown_never_to_be_below_is_never_below_on_a_dense_grid(
    seed: int, n: int, p: int, sharp: float
) -> None:
    f = information(outputs(seed, n, p, sharp))
    values = f.values(GRID)
    k = np.argmin(values, axis=0)
    least = values[k, np.arange(p)]
    rng = np.random.default_rng(seed)
    for level in (least * (1 - 1e-3), least * rng.uniform(0.9, 1.1, p), least * (1 + 1e-9)):
        shown = f.never_below(level, GRID[k], np.zeros(p))
        assert np.all(values[:, shown] > level[shown])


@given(SEEDS, st.integers(1, 12), st.integers(2, 5))
@settings(max_examples=30, deadline=None)
def test_a_level_just_below_the_lowest_minimum_is_shown(seed: int, n: int, p: int) -> None:
    f = information(outputs(seed, n, p))
    w = np.concatenate([[0.0], np.geomspace(1e-3, 1e2, 600), [np.inf]])
    at = f.lowest(w, f.values(w))
    least = np.diagonal(f.values(at))
    reached = least <= f.values(GRID).min(axis=0)  # Newton's minimum is lower than the best of a grid, if the right one
    assert np.all(f.never_below(least * (1 - 4e-9), at, np.zeros(p)) == reached)


def test_a_narrow_dip_elsewhere_is_found() -> None:
    poles = np.array([-1.0, 1.0, -1e-4 + 30j, -1e-4 - 30j, 1e-4 + 30j, 1e-4 - 30j], dtype=np.complex128)
    # 1 + 1/(w^2 + 1) is lowest at infinity; the resonances take another 2e-6/1e-4 off it within 1e-4 of w = 30.
    residues = np.array([[-0.5], [0.5], [1e-6], [1e-6], [-1e-6], [-1e-6]], dtype=np.complex128)
    f, nothing = PartialFractions(poles, residues, np.array([1.0])), np.zeros(1)
    dip = float(f.values(np.array([30.0]))[0, 0])
    assert dip < 0.99
    assert not f.never_below(np.array([0.995]), np.array([np.inf]), nothing)[0]
    assert f.never_below(np.array([dip * (1 - 1e-6)]), np.array([30.0]), nothing)[0]


def test_a_doubt_about_the_values_takes_the_claim_back() -> None:
    f = PartialFractions(np.array([-1.0 + 0j, 1.0]), np.array([[0.5], [-0.5]], dtype=complex), np.array([2.0]))
    at, level = np.zeros(1), np.array([0.999])  # 2 - 1/(w^2 + 1) is 1 at w = 0
    assert f.never_below(level, at, np.array([1e-6]))[0]
    assert not f.never_below(level, at, np.array([2e-3]))[0]


def test_a_pole_on_the_axis_shows_nothing() -> None:
    f = PartialFractions(np.array([2j, -2j]), np.array([[1.0], [-1.0]], dtype=complex), np.array([1.0]))
    assert not f.never_below(np.array([-1e3]), np.zeros(1), np.zeros(1))[0]


@pytest.mark.parametrize("seed", range(4))
def test_the_floors_of_many_single_faults_are_settled_without_an_eigenvalue_problem_each(seed: int) -> None:
    p = 6
    model = outputs(seed, 10, p)
    eye = np.eye(p)
    sets = [(np.delete(eye, j, axis=0), eye[j : j + 1]) for j in range(p)]
    settled = model._single(
        [(N * model.size, K * model.size) for N, K in sets], [eye[:, j : j + 1] / s for j, s in enumerate(model.size)]
    )
    assert len(settled) == p
    for (N, K), found in zip(sets, model.floors(sets), strict=True):
        A, B, C, E = model.A, model.B, model.C * model.size[:, None], model.E * model.size[:, None]
        alone = estimator_floor(A, B, N @ C, N @ E, K @ C, K @ E).value
        assert found is not None
        assert found.value == pytest.approx(alone, rel=1e-8)  # each within 2e-9 of the supremum, from below
