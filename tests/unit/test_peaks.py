# SPDX-License-Identifier: BSD-3-Clause
"""Peak gains, noise gains and fading, against sums that are written out."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from faultrecon.numerics.peaks import OVER, Outputs, fading, gains

TRUNCATED = 20 * OVER  # relative: what a sum that ends where a block adds less than OVER may lack, slow modes included


def system(rng, n=4, r=3, d=2, radius=0.9):
    M = rng.normal(size=(n, n))
    M *= radius / np.abs(np.linalg.eigvals(M)).max()
    return M, rng.normal(size=(n, d)), rng.normal(size=(r, n)), rng.normal(size=(r, d))


def responses(M, B, C, D, pole, rows):
    """h₀, h₁, ... behind a filter, (rows, r, d)."""
    h, X = [D], B
    for _ in range(rows - 1):
        h.append(C @ X)
        X = M @ X
    out, held = [], np.zeros_like(D)
    for one in h:
        held = pole * held + (1.0 - pole) * one
        out.append(held)
    return np.array(out)


@pytest.mark.parametrize("seed", range(8))
def test_gains_are_the_sums_of_the_impulse_response(seed):
    rng = np.random.default_rng(seed)
    parts = system(rng, radius=rng.uniform(0.3, 0.97))
    poles = (0.0, 0.8, 0.98)
    found = gains(*parts, poles)
    for i, pole in enumerate(poles):
        h = responses(*parts, pole, 4000)
        np.testing.assert_allclose(found.peak[i], np.abs(h).sum(axis=0), rtol=TRUNCATED)
        np.testing.assert_allclose(found.noise[i], np.sqrt(np.square(h).sum(axis=0)), rtol=TRUNCATED)


@pytest.mark.parametrize("seed", range(4))
def test_the_noise_gain_is_the_deviation_that_lyapunov_finds(seed):
    M, B, C, D = system(np.random.default_rng(seed))
    found = gains(M, B, C, D).noise[0]
    for j in range(B.shape[1]):
        P = solve_discrete_lyapunov(M, np.outer(B[:, j], B[:, j]))
        np.testing.assert_allclose(found[:, j] ** 2, np.diag(C @ P @ C.T) + D[:, j] ** 2, rtol=TRUNCATED)


@pytest.mark.parametrize("slow", [0.999, 0.99999, 1.0 - 1e-6])
def test_a_mode_that_lasts_longer_than_the_sum_is_counted_to_its_end(slow):
    one = np.eye(1)
    found = gains(slow * one, one, one, 0.0 * one)
    assert found.peak[0, 0, 0] == pytest.approx(1.0 / (1.0 - slow), rel=1e-3)  # STEADY: how well the ratio is known
    assert found.noise[0, 0, 0] == pytest.approx(np.sqrt(1.0 / (1.0 - slow**2)), rel=1e-3)


def test_a_slow_mode_behind_quick_ones_is_not_cut_off():
    M, B, C = np.diag([0.2, 0.99995]), np.array([[1.0], [1e-3]]), np.array([[1.0, 1.0]])
    found = gains(M, B, C, np.zeros((1, 1)))
    assert found.peak[0, 0, 0] == pytest.approx(1.0 / 0.8 + 1e-3 / 5e-5, rel=1e-3)


def test_only_outputs_that_see_a_mode_that_does_not_decay_are_unbounded():
    M, B, C = np.diag([1.01, 0.5]), np.eye(2), np.eye(2)
    found = gains(M, B, C, np.zeros((2, 2)))
    assert np.isinf(found.peak[0, 0, 0])
    assert np.isinf(found.noise[0, 0, 0])
    assert np.isfinite(found.peak[0, 0, 1])


@pytest.mark.parametrize(("n", "r", "d"), [(0, 2, 2), (3, 0, 2), (3, 2, 0)])
def test_nothing_has_no_gain(n, r, d):
    D = np.ones((r, d))
    found = gains(np.zeros((n, n)), np.zeros((n, d)), np.zeros((r, n)), D)
    np.testing.assert_array_equal(found.peak[0], D)


def test_without_a_state_a_filter_passes_as_much_as_comes_in():
    nothing = np.zeros((0, 1))
    found = gains(np.zeros((0, 0)), nothing, nothing.T, np.ones((1, 1)), (0.0, 0.9))
    np.testing.assert_allclose(found.peak[:, 0, 0], [1.0, 1.0], rtol=TRUNCATED)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("given", [False, True])
def test_what_fades_stays_below_its_two_parts_until_it_has_faded(seed, given):
    rng = np.random.default_rng(seed)
    M, box, C, _ = system(rng, n=5, d=4, radius=rng.uniform(0.1, 0.995))
    units = np.array([1e-3, 1.0, 50.0])
    slowest = np.abs(np.linalg.eigvals(M)).max()
    rate = np.array([[0.4], [0.5 * (1.0 + slowest)]]) * np.ones(3) if given else None
    found = fading(Outputs(M, C), box, units, rate)
    X = box
    for k in range(6000):
        size = np.abs(C @ X).sum(axis=1) / units
        assert np.all(size <= (found.first * found.rate**k).sum(axis=0) * (1 + 1e-9) + 1e-4)  # FADED
        X = M @ X


def test_what_does_not_fade_is_said_to_last():
    found = fading(Outputs(np.eye(1), np.eye(1)), np.eye(1), np.ones(1))
    assert np.all(np.isinf(found.first))
    assert np.all(found.rate == 1.0)


def test_with_given_rates_both_parts_share_what_fades():
    """A quick mode and a slow one a hundredth as large: in the slow part alone they would count for a hundred times."""
    M, C, box, rate = np.diag([0.3, 0.99]), np.ones((1, 2)), np.array([[1.0], [0.01]]), np.array([[0.4], [0.991]])
    found = fading(Outputs(M, C), box, np.ones(1), rate)
    np.testing.assert_array_equal(found.rate, rate)
    assert (found.first / (1.0 - rate)).sum() <= 2.0 * (1.0 / 0.7 + 0.01 / 0.01)


def test_of_pairs_with_the_same_sum_the_slow_part_alone_is_taken():
    """At two equal rates all pairs add up to the same; rounding does not choose between them, output by output."""
    rng = np.random.default_rng(3)
    M, box, C, _ = system(rng, n=5, d=4, radius=0.95)
    found = fading(Outputs(M, C), box, np.ones(3), np.full((2, 3), 0.97))
    np.testing.assert_array_equal(found.first[0], 0.0)
    assert np.isfinite(found.first).all()
