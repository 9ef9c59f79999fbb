# SPDX-License-Identifier: BSD-3-Clause
"""Peak gains and the floor under every estimator."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.numerics.hinf import estimator_floor, frequency_response, hinf_norm

# Khosrowjerdi 2011, Examples 4.1 and 4.2: healthy rows first.
# fmt: off
A41 = np.array([[-1.05, -2.55, 0, 0, -169, -.0091], [2.55, -1.05, 0, 0, 57.09, .0017], [0, 0, -77.53, 39.57, 0, 0],
                [0, 0, 0, -20.2, 0, 0], [0, 0, -8.8, 0, -20.2, 0], [0, 0, 0, 0, 0, -.1]])
C41 = np.array([[-.01, .09, .07, 0, 0, 0], [-.48, -.59, 0, 0, -49.51, -.0026],
                [.03, .09, -.06, 0, 0, 0], [.26, -.07, .01, 0, 0, 0]])
B41 = np.array([[1.0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0]])
E41 = np.array([[0.0, 1, 0], [0, 0, 1], [0, 0, 0], [0, 0, 0]])
# fmt: on
A42, C42 = np.array([[0.0, 1], [-1, -1]]), np.eye(2)
B42, E42 = np.array([[1.0, 0], [1, 0]]), np.array([[0.0, 1], [0, 0]])


def stable(n: int, m: int, p: int, seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A = A - (np.linalg.eigvals(A).real.max() + 0.05) * np.eye(n)
    return A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m))


def test_a_resonance_peaks_where_the_textbook_says() -> None:
    z = 0.01
    A, B, C = np.array([[0.0, 1], [-1, -2 * z]]), np.array([[0.0], [1]]), np.array([[1.0, 0]])
    peak = hinf_norm(A, B, C, [[0.0]])
    assert peak.value == pytest.approx(1 / (2 * z * np.sqrt(1 - z**2)), rel=1e-9)
    # The gain is flat to second order at its peak: the frequency is known to the square root of rtol, times 10.
    assert peak.frequency == pytest.approx(np.sqrt(1 - 2 * z**2), rel=1e-5)


def test_the_peak_of_the_aircraft_nonlinearity_path_is_the_published_one() -> None:
    Bf = np.array([[0.0, 1, 0, 0, 1, 0]]).T
    assert hinf_norm(A41, Bf, np.eye(6), np.zeros((6, 1))).value == pytest.approx(6.343159, abs=1e-6)
    assert hinf_norm(A41, Bf, np.eye(6)[:1], [[0.0]]).value == pytest.approx(5.176406, abs=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_no_frequency_of_a_dense_grid_beats_the_norm(seed: int) -> None:
    A, B, C, D = stable(6, 2, 3, seed)
    peak = hinf_norm(A, B, C, D)
    grid = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 4000)])
    values = np.linalg.norm(frequency_response(A, B, C, D, grid), 2, axis=(1, 2))
    assert values.max() <= peak.value * (1 + 2e-9)
    at_peak = np.linalg.norm(frequency_response(A, B, C, D, [peak.frequency])[0], 2)
    assert at_peak == pytest.approx(peak.value, rel=1e-10)


def test_the_norm_does_not_depend_on_the_units_of_the_states() -> None:
    A, B, C, D = stable(5, 2, 2, 7)
    t = np.ldexp(1.0, np.array([40, -30, 3, 0, -12]))
    assert hinf_norm(A * t / t[:, None], B / t[:, None], C * t, D) == hinf_norm(A, B, C, D)


def test_an_unstable_or_undamped_system_has_no_finite_norm() -> None:
    assert hinf_norm([[0.1]], [[1.0]], [[1.0]], [[0.0]]).value == np.inf
    undamped = hinf_norm([[0.0, 2], [-2, 0]], [[1.0], [0]], [[1.0, 0]], [[0.0]])
    assert undamped.value == np.inf
    assert undamped.frequency == pytest.approx(2.0)


def test_a_gain_that_grows_towards_infinite_frequency_is_its_feedthrough() -> None:
    peak = hinf_norm([[-1.0]], [[1.0]], [[-1.0]], [[1.0]])  # s/(s+1)
    assert peak.value == pytest.approx(1.0, rel=1e-12)
    assert hinf_norm(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[3.0, 4.0]]).value == pytest.approx(5.0)
    assert hinf_norm([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0))).value == 0.0


def test_the_floors_of_both_published_examples() -> None:
    peak = estimator_floor(A41, B41, C41[:2], E41[:2], C41[2:], E41[2:])
    assert peak.value == pytest.approx(0.487601, abs=1e-6)
    assert peak.frequency == pytest.approx(1.469, abs=1e-3)
    peak = estimator_floor(A42, B42, C42[:1], E42[:1], C42[1:], E42[1:])
    assert peak.value == pytest.approx(0.587324, abs=1e-6)
    assert peak.frequency == pytest.approx(1.204, abs=1e-3)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_no_frequency_of_a_dense_grid_beats_the_floor(seed: int) -> None:
    A, B, C, E = stable(6, 4, 4, seed)
    floor = estimator_floor(A, B, C[:2], E[:2], C[2:], E[2:])
    w = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 2000)])
    Y = frequency_response(A, B, C, E, w)
    value = [np.linalg.norm(y[2:] - y[2:] @ np.linalg.pinv(y[:2]) @ y[:2], 2) for y in Y]
    assert max(value) <= floor.value * (1 + 1e-8)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_any_observer_stays_above_the_floor_and_an_extra_healthy_sensor_never_raises_it(seed: int) -> None:
    A, B, C, E = stable(5, 4, 4, seed)
    one = estimator_floor(A, B, C[:1], E[:1], C[3:], E[3:]).value
    two = estimator_floor(A, B, C[:2], E[:2], C[3:], E[3:]).value
    assert two <= one * (1 + 1e-8)
    L = np.random.default_rng(seed).normal(size=(5, 2)) * 0.1
    loop = A - L @ C[:2]
    if np.linalg.eigvals(loop).real.max() < 0:
        assert hinf_norm(loop, B - L @ E[:2], -C[3:], -E[3:]).value >= two * (1 - 1e-9)


def test_without_healthy_sensors_the_floor_is_the_plain_gain() -> None:
    A, B, C, E = stable(5, 2, 2, 11)
    floor = estimator_floor(A, B, np.zeros((0, 5)), np.zeros((0, 2)), C, E)
    assert floor.value == pytest.approx(hinf_norm(A, B, C, E).value, rel=1e-8)


def test_a_narrow_peak_between_broad_ones_is_found() -> None:
    blocks, B, C1, C2 = [], [], [], []
    for k, (w, z) in enumerate([(1.0, 0.3), (7.3, 1e-4), (31.0, 0.2)]):
        blocks.append(np.array([[0, 1], [-(w**2), -2 * z * w]]))
        B += [0.0, 1.0]
        C1 += [0.1 * (k != 1), 0.0]
        C2 += [1.0, 0.0]
    A = np.zeros((6, 6))
    for k, M in enumerate(blocks):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = M
    B = np.column_stack([B, np.zeros(6)])
    floor = estimator_floor(A, B, [C1], [[0.0, 1.0]], [C2], [[0.0, 0.0]])
    assert floor.frequency == pytest.approx(7.3, rel=1e-3)
    assert floor.value == pytest.approx(1 / (2 * 1e-4 * 7.3**2), rel=0.02)  # 1/(2 z w^2), the others add 2 %


def test_an_integrator_seen_by_both_sensors_leaves_a_finite_floor() -> None:
    # y1 = x + v1, y2 = x + v2, x' = w: at low frequency y2 - y1 is best and leaves |(v2, -v1)| = sqrt 2.
    floor = estimator_floor([[0.0]], [[1.0, 0, 0]], [[1.0]], [[0, 1.0, 0]], [[1.0]], [[0, 0, 1.0]])
    assert floor.value == pytest.approx(np.sqrt(2), rel=1e-4)
    assert floor.value <= np.sqrt(2) * (1 + 1e-6)


def test_a_duplicated_healthy_sensor_changes_nothing() -> None:
    """Y1 then has dependent rows; the direction that is only rounding must not count as explained."""
    once = estimator_floor(A42, B42, C42[:1], E42[:1], C42[1:], E42[1:]).value
    C1, E1 = np.vstack([C42[:1], 3 * C42[:1]]), np.vstack([E42[:1], 3 * E42[:1]])
    assert estimator_floor(A42, B42, C1, E1, C42[1:], E42[1:]).value == pytest.approx(once, rel=1e-9)


def test_the_floor_of_a_static_model_is_attained_at_every_frequency() -> None:
    none = np.zeros((0, 0))
    floor = estimator_floor(none, np.zeros((0, 2)), np.zeros((1, 0)), [[1.0, 1.0]], np.zeros((1, 0)), [[1.0, 0.0]])
    assert floor.value == pytest.approx(np.sqrt(0.5), rel=1e-12)
