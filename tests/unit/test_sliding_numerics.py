# SPDX-License-Identifier: BSD-3-Clause
"""Sliding-mode coordinates, gains and levels against published numbers and against other ways to compute them.

Plant: ADMIRE linear, Mach 0.22, 3000 m, states alpha beta p q r (rad, rad/s), measured p q r.  Reference numbers of its
designs: Alwi, Edwards, Tan 2009, recomputed independently with conic solvers; printed digits are the tolerance.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from faultrecon.finding import Impossible, InputError
from faultrecon.numerics.hinf import frequency_response, hinf_norm
from faultrecon.numerics.interpolation import hidden_mode_floor
from faultrecon.numerics.sliding import (
    Canonical,
    canonical,
    fault_transfer,
    full_order_motion,
    high_frequency_gain,
    linear_gain,
    minimal_gamma0,
    peak_injection,
    reduced_riccati,
    sliding_motion,
    smallest_level,
)

Array = np.ndarray

# fmt: off
ADMIRE_A = np.array([[-.5432, .0137, 0, .9778, 0], [0, -.1179, .2215, 0, -.9661], [0, -10.5128, -.9967, 0, .6176],
                     [2.6221, -.0030, 0, -.5057, 0], [0, .7075, -.0939, 0, -.2127]])
ADMIRE_B = np.array([[.0069, -.0866, -.0866, .0004], [0, .0119, -.0119, .0287], [0, -4.2423, 4.2423, 1.4871],
                     [1.6532, -1.2735, -1.2735, .0024], [0, -.2805, .2805, -.8823]])
# fmt: on
ADMIRE_C = np.eye(5)[2:]
MODE = 1.076874746109  # of A, hidden from p and r
FLOOR = 1 / MODE
L2 = np.array([-2.569768, -0.000098, -4.232777])  # of the paper-equivalent design, in the order alpha, beta, q


def admire(faulty: int = 1, M: Array | None = None) -> Canonical:
    return canonical(ADMIRE_A, ADMIRE_B, ADMIRE_C, np.eye(3)[:, faulty : faulty + 1], M)


def norm(motion: tuple[Array, Array, Array]) -> float:
    return hinf_norm(*motion, np.zeros((motion[2].shape[0], motion[1].shape[1])), rtol=1e-11).value


def of_fault_rate(c: Canonical, L: Array) -> tuple[Array, Array, Array]:
    Ac, Bc, Cc = sliding_motion(c, L)
    return Ac, Bc[:, : c.q], Cc


def random_plant(seed: int, n: int, p: int, q: int) -> tuple[Array, Array, Array, Array, Array]:
    rng = np.random.default_rng(seed)
    A, B, C, F, M = (rng.normal(size=size) for size in ((n, n), (n, 2), (p, n), (p, q), (n, 3)))
    return A, B, C, F, M


def with_hidden_modes(hidden: Array, q: int, seed: int) -> tuple[Array, Array, Array]:
    """(A, C, F) in mixed coordinates whose healthy outputs do not see the block `hidden`, all eigenvalues unstable."""
    rng = np.random.default_rng(seed)
    k, p = len(hidden), q + 1
    n = k + p
    A = rng.normal(size=(n, n))
    A[k:, :k], A[:k, :k] = 0.0, hidden
    C, F = rng.normal(size=(p, n)), np.eye(p)[:, 1:]
    C[0, :k] = 0.0
    T, Y = np.linalg.qr(rng.normal(size=(n, n)))[0], np.linalg.qr(rng.normal(size=(p, p)))[0]
    return T @ A @ T.T, Y @ C @ T.T, Y @ F


# ---------------------------------------------------------------- coordinates


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 12), st.data())
def test_the_canonical_form_holds_to_rounding_for_any_plant(seed: int, n: int, data: st.DataObject) -> None:
    p = data.draw(st.integers(2, n))
    q = data.draw(st.integers(1, p - 1))
    A, B, C, F, M = random_plant(seed, n, p, q)
    c = canonical(A, B, C, F, M)
    N = n + q
    condition = np.linalg.cond(c.T) * np.linalg.cond(c.S)
    assume(condition < 1e6)  # beyond it the claim is about six digits
    tolerance = 1e-12 * condition
    zero = np.zeros((n, q))
    augmented = np.block([[A, zero], [np.zeros((q, N))]])
    assert np.allclose(c.T @ c.T_inverse, np.eye(N), rtol=0, atol=tolerance)
    assert np.allclose(c.S @ F, np.eye(p)[:, p - q :], rtol=0, atol=tolerance)
    assert np.allclose(c.S @ c.S_inverse, np.eye(p), rtol=0, atol=tolerance)
    assert np.allclose(c.S @ np.hstack([C, F]) @ c.T_inverse, c.C_a, rtol=0, atol=tolerance)
    assert np.allclose(c.T @ augmented @ c.T_inverse, c.A_a, rtol=0, atol=tolerance * np.linalg.norm(A, 2))
    assert np.allclose(c.T @ np.vstack([B, np.zeros((q, 2))]), c.B_a, rtol=0, atol=tolerance * np.linalg.norm(B, 2))
    assert np.allclose(c.T @ np.vstack([M, np.zeros((q, 3))]), c.M_a, rtol=0, atol=tolerance * np.linalg.norm(M, 2))
    assert np.allclose(c.T @ np.eye(N)[:, n:], c.F_a, rtol=0, atol=tolerance)
    assert np.allclose(c.C_f @ c.T, np.eye(N)[n:], rtol=0, atol=tolerance)


def test_the_parts_have_the_structure_the_sliding_motion_uses() -> None:
    c = canonical(*random_plant(3, 7, 4, 2)[:4])
    assert (c.n1, c.p, c.q) == (5, 4, 2)
    assert np.array_equal(c.C_e, np.hstack([np.zeros((2, 3)), -np.eye(2)]))
    assert np.array_equal(c.A212, -c.C_e @ c.A11)
    assert np.array_equal(c.A21, np.vstack([c.A211, c.A212]))
    assert not c.A12[:, -2:].any() and not c.A22[:, -2:].any()
    assert np.array_equal(np.block([[c.A11, c.A12], [c.A21, c.A22]]), c.A_a)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 9), st.data())
def test_selected_sensors_and_states_are_transformed_without_any_rounding(
    seed: int, n: int, data: st.DataObject
) -> None:
    """Entries 1, or powers of two: also the plant's own numbers are then only moved, and doubled or halved."""
    rng = np.random.default_rng(seed)
    p = data.draw(st.integers(2, n))
    q = data.draw(st.integers(1, p - 1))
    size = data.draw(st.sampled_from([0, 3]))
    C = np.eye(n)[rng.permutation(n)[:p]] * (rng.choice([-1, 1], p) * 2.0 ** rng.integers(-size, size + 1, p))[:, None]
    F = np.eye(p)[:, rng.permutation(p)[:q]] * 2.0 ** rng.integers(-size, size + 1, q)
    A = rng.normal(size=(n, n))
    c = canonical(A, np.zeros((n, 0)), C, F)
    augmented = np.block([[A, np.zeros((n, q))], [np.zeros((q, n + q))]])
    assert np.array_equal(c.T @ c.T_inverse, np.eye(n + q))
    assert np.array_equal(c.S @ c.S_inverse, np.eye(p))
    assert np.array_equal(c.S @ np.hstack([C, F]) @ c.T_inverse, c.C_a)
    assert np.array_equal(c.T @ augmented, c.A_a @ c.T)


def test_the_plant_of_the_case_study_is_only_permuted() -> None:
    c = admire()
    assert set(np.unique(c.T)) == {0.0, 1.0} and set(np.unique(c.S)) == {0.0, 1.0}
    assert np.array_equal(c.A11, ADMIRE_A[np.ix_([0, 1, 3], [0, 1, 3])])


def test_measuring_in_degrees_leaves_the_identities_exact_where_floats_allow() -> None:
    degrees = 180 / np.pi
    c = canonical(ADMIRE_A, ADMIRE_B, degrees * ADMIRE_C, np.eye(3)[:, 1:2])
    assert np.array_equal(c.T @ c.T_inverse, np.eye(6))
    assert np.array_equal(np.hstack([degrees * ADMIRE_C, np.eye(3)[:, 1:2]]) @ c.T_inverse, c.S_inverse @ c.C_a)


MISFITS = {
    "3 faults on 3 outputs": {"F": np.eye(3)},
    "F lacks column rank": {"F": np.ones((3, 2))},
    "C lacks row rank": {"C": np.ones((3, 5))},
    "B is": {"B": np.zeros((4, 1))},
    "not finite": {"A": np.full((5, 5), np.nan)},
    "not two-dimensional": {"M": np.zeros(5)},
}


@pytest.mark.parametrize("words", MISFITS)
def test_a_plant_that_does_not_fit_is_refused_by_name(words: str) -> None:
    plant = {"A": ADMIRE_A, "B": ADMIRE_B, "C": ADMIRE_C, "F": np.eye(3)[:, 1:2]} | MISFITS[words]
    with pytest.raises(InputError, match=words):
        canonical(**plant)


# ---------------------------------------------------------------- the smallest levels


@pytest.mark.parametrize(
    ("d1", "ep", "level"), [(0.1, 0.01, 0.928677), (0.01, 0.001, 0.92861376), (0.001, 0.0001, 0.92861312)]
)
def test_the_levels_of_the_case_study_tend_to_one_over_the_hidden_mode(d1: float, ep: float, level: float) -> None:
    found = smallest_level(admire(), d1, ep)
    assert found == pytest.approx(level, rel=1.2e-6)  # the level is confirmed up to 1e-6
    assert found >= FLOOR


CASES = {
    "two modes, one fault": (np.array([[0.5, 0.3], [0.0, 1.2]]), 1),
    "two modes, two faults": (np.array([[0.5, 0.3], [0.0, 1.2]]), 2),
    "a complex pair": (np.array([[0.3, 2.0], [-2.0, 0.3]]), 1),
    "a pair, two faults": (np.array([[0.3, 2.0], [-2.0, 0.3]]), 2),
    "three modes, two faults": (np.array([[0.5, 0.3, 0.1], [0.0, 1.2, 0.4], [0.0, 0.0, 2.0]]), 2),
}


def hidden_case(name: str, seed: int) -> tuple[Canonical, float]:
    A, C, F = with_hidden_modes(*CASES[name], seed=seed)
    c = canonical(A, np.zeros((len(A), 0)), C, F)
    return c, hidden_mode_floor(A, *np.split(c.S @ C, [c.p - c.q])).value


@pytest.mark.parametrize("name", CASES)
def test_the_closed_form_floor_is_what_the_riccati_equation_tends_to(name: str) -> None:
    c, floor = hidden_case(name, seed=4)
    # Each level is reached, so none is below the floor; the excess goes with d1 ep until rounding takes over.
    levels = [smallest_level(c, d1, 0.1 * d1) for d1 in (3e-2, 3e-3, 3e-4)]
    assert min(levels) >= floor * (1 - 1e-6)
    assert min(levels) == pytest.approx(floor, rel=1e-5)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(sorted(CASES)))
def test_no_gain_falls_below_the_floor(seed: int, name: str) -> None:
    c, floor = hidden_case(name, seed)
    L = reduced_riccati(c, 1.001 * smallest_level(c, 0.1, 0.01), 0.1, 0.01)
    assert L is not None
    assert norm(of_fault_rate(c, L)) >= floor * (1 - 1e-9)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_the_floor_does_not_depend_on_the_coordinates_of_states_and_outputs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, Y = np.linalg.qr(rng.normal(size=(5, 5)))[0] @ np.diag(2.0 ** rng.integers(-2, 3, 5)), rng.normal(size=(3, 3))
    assume(np.linalg.cond(Y) < 30)  # 1e-9 leaves six digits for T, Y and the deflation together
    A, C, F = T @ ADMIRE_A @ np.linalg.inv(T), Y @ ADMIRE_C @ np.linalg.inv(T), 2.5 * Y[:, 1:2]
    c = canonical(A, T @ ADMIRE_B, C, F)
    assert hidden_mode_floor(A, *np.split(c.S @ C, [2])).value == pytest.approx(FLOOR, rel=1e-9)


@pytest.mark.parametrize("faulty", [0, 2])
def test_a_detectable_plant_has_no_floor(faulty: int) -> None:
    levels = [smallest_level(admire(faulty), d1, 0.1 * d1) for d1 in (1e-1, 1e-2, 1e-3)]
    assert levels[2] < 1.2e-2 * levels[0]  # proportional to the noises


def test_a_fault_that_looks_like_an_equilibrium_is_impossible() -> None:
    with pytest.raises(Impossible):
        smallest_level(canonical(np.diag([0.0, -1.0]), np.zeros((2, 0)), np.eye(2), [[1.0], [0.0]]), 0.1, 0.01)


# fmt: off
FAMILY = {.93: (.92997, 702), .95: (.94966, 44.1), 1.0: (.99717, 13.5), 1.2: (1.16154, 3.99), 1.5: (1.34259, 2.24),
          2.0: (1.52781, 1.55)}
# fmt: on


@pytest.mark.parametrize("gamma", FAMILY)
def test_the_family_of_gains_buys_a_small_error_with_noise(gamma: float) -> None:
    c, (expected, gain) = admire(), FAMILY[gamma]
    L = reduced_riccati(c, gamma, 0.1, 0.01)
    assert L is not None
    assert norm(of_fault_rate(c, L)) == pytest.approx(expected, abs=6e-6)
    assert abs(high_frequency_gain(c, L)[0, 0]) == pytest.approx(gain, rel=4e-3)  # three digits printed


def test_below_the_floor_there_is_no_gain() -> None:
    assert reduced_riccati(admire(), 0.9999 * FLOOR, 1e-3, 1e-4) is None


@pytest.mark.parametrize(("d", "gamma0"), [(1.0, 1.765237), (0.3, 1.199080), (0.1, 1.024176)])
def test_the_smallest_gamma0_of_the_linear_part(d: float, gamma0: float) -> None:
    assert minimal_gamma0(admire(), d**2 * np.eye(3)) == pytest.approx(gamma0, rel=2e-6)


def test_a_plant_with_an_integrator_has_a_smallest_gamma0_too() -> None:
    """Its pole at the origin is not reached by the fault: without noise on the states the Hamiltonian has it twice."""
    c = canonical([[0.0, 0.0], [1.0, -1.0]], np.zeros((2, 0)), np.eye(2), [[0.0], [1.0]])
    assert 0 < minimal_gamma0(c, np.eye(2)) < 10


# ---------------------------------------------------------------- the sliding motion


@pytest.mark.parametrize("gamma", [0.95, 1.25, 2.0])
def test_three_routes_give_the_same_norm(gamma: float) -> None:
    import control

    c = admire()
    L = reduced_riccati(c, gamma, 0.1, 0.01)
    assert L is not None
    reduced = of_fault_rate(c, L)
    full = full_order_motion(c, L, linear_gain(c, L, -10 * np.eye(3)))
    value = norm(reduced)
    assert norm(full) == pytest.approx(value, rel=1e-8)
    for motion in (reduced, full):
        peak = control.norm(control.ss(*motion, 0), "inf", tol=1e-9)  # type: ignore[arg-type]  # annotated int only
        assert peak == pytest.approx(value, rel=1e-8)


def test_eliminating_the_injection_in_the_coordinates_of_the_plant_gives_the_same_response() -> None:
    """Nothing but A, C, F and the transformed gain: e_y' = 0 solved for the injection."""
    c = admire()
    L = reduced_riccati(c, 1.25, 0.1, 0.01)
    assert L is not None
    A = np.pad(ADMIRE_A, (0, 1))
    C, Fa = np.hstack([ADMIRE_C, np.eye(3)[:, 1:2]]), np.eye(6)[:, 5:]
    Gn = c.T_inverse @ np.vstack([-L, np.eye(3)])
    project = np.eye(6) - Gn @ np.linalg.solve(C @ Gn, C)
    w = np.geomspace(1e-2, 1e2, 9)
    direct = frequency_response(project @ A, -project @ Fa, np.eye(6)[5:], [[0.0]], w)
    assert np.allclose(direct, frequency_response(*of_fault_rate(c, L), [[0.0]], w), rtol=1e-9)


def test_the_paper_equivalent_design_has_its_norm_gain_and_poles() -> None:
    c, L = admire(), np.column_stack([np.zeros((3, 2)), L2])
    # Six decimals of L2 move the norm by about 5e-6; L1 is not needed, it acts on the lateral part alone.
    assert norm(of_fault_rate(c, L)) == pytest.approx(1.2212000932, abs=1e-5)
    assert high_frequency_gain(c, L)[0, 0] == pytest.approx(-3.232777, abs=1e-9)
    poles = np.linalg.eigvals(sliding_motion(c, L)[0])
    for pole in (-2.067973, -3.579036):
        assert np.min(np.abs(poles - pole)) < 1e-3


def test_a_constant_fault_is_reconstructed_and_the_response_is_one_plus_s_times_the_error_gain() -> None:
    c, w = admire(), np.array([0.0, 0.3, 2.0, 1e3])
    L = reduced_riccati(c, 1.25, 0.1, 0.01)
    assert L is not None
    error, F = frequency_response(*of_fault_rate(c, L), [[0.0]], w), frequency_response(*fault_transfer(c, L), w)
    assert np.allclose(F, 1 + 1j * w[:, None, None] * error, atol=1e-12 * 1e3)
    assert F[0] == pytest.approx(1.0, abs=1e-12)
    assert np.array_equal(fault_transfer(c, L)[3], high_frequency_gain(c, L))


def test_the_hidden_mode_is_a_zero_of_the_fault_response() -> None:
    c = admire()
    L = reduced_riccati(c, 1.25, 0.1, 0.01)
    assert L is not None
    A, B, C, D = fault_transfer(c, L)
    assert (C @ np.linalg.solve(MODE * np.eye(3) - A, B) + D).item() == pytest.approx(0.0, abs=1e-9)


def test_gusts_enter_beside_the_rate_of_the_fault() -> None:
    """psi drives x' = A x + M psi: seen from the plant, e' = ... - M_a psi, with e1 = [I L] T e."""
    M = ADMIRE_A[:, :1]
    c, L = admire(M=M), np.arange(9.0).reshape(3, 3)
    _, Bc, _ = sliding_motion(c, L)
    e1 = np.hstack([np.eye(3), L]) @ c.T
    assert np.allclose(Bc, -e1 @ np.column_stack([np.eye(6)[:, 5], np.append(M, 0.0)]), atol=1e-13)


def test_the_linear_part_has_the_poles_of_the_sliding_motion_and_those_asked_for() -> None:
    c = admire()
    L = reduced_riccati(c, 1.25, 0.1, 0.01)
    assert L is not None
    Gl = linear_gain(c, L, -10 * np.eye(3))
    assert norm(of_fault_rate(c, L)) == pytest.approx(1.19668, abs=6e-6)
    assert np.linalg.norm(Gl) == pytest.approx(61.2, abs=0.06)
    TL = np.block([[np.eye(3), L], [np.zeros((3, 3)), np.eye(3)]])
    closed = TL @ (c.A_a - Gl @ c.C_a) @ np.linalg.inv(TL)
    assert np.allclose(closed[:, 3:], np.vstack([np.zeros((3, 3)), -10 * np.eye(3)]), atol=1e-11)
    assert np.sort(np.linalg.eigvals(closed[:3, :3]).real) == pytest.approx([-3.7300, -2.1259, -1.0602], abs=6e-5)


def test_gains_of_the_wrong_shape_or_sign_are_refused() -> None:
    c, L = admire(), np.zeros((3, 3))
    with pytest.raises(InputError, match="not stable"):
        linear_gain(c, L, np.eye(3))
    with pytest.raises(InputError, match="L is"):
        sliding_motion(c, np.zeros((2, 3)))
    with pytest.raises(InputError, match="not positive definite"):
        minimal_gamma0(c, -np.eye(3))
    with pytest.raises(InputError, match="fictitious"):
        reduced_riccati(c, 1.0, 0.0, 0.1)
    with pytest.raises(Impossible, match="real part 1"):
        peak_injection(c, L)


# ---------------------------------------------------------------- the injection


def test_the_injection_bound_is_the_integral_of_the_impulse_response() -> None:
    """One hidden mode: e1' = -a e1 - l xi, l = -(lambda + a)/lambda, nu = -lambda e1 + xi in the faulty channel."""
    mode, a = 0.8, 2.0
    c = canonical([[mode, 0.0], [0.0, -1.0]], np.zeros((2, 0)), [[0.0, 1.0], [1.0, 0.0]], [[0.0], [1.0]])
    L = np.array([[0.0, -(mode + a) / mode]])
    found = peak_injection(c, L)
    exact = 1 + mode * (mode + a) / mode / a
    assert exact <= found.value <= exact + found.slack
    assert found.slack <= 1e-3 * found.value


def test_the_injection_bound_covers_bounded_fault_rates_also_for_stiff_motions() -> None:
    c = admire()
    rng = np.random.default_rng(0)
    for gamma in (0.95, 1.25, 2.0):
        L = reduced_riccati(c, gamma, 0.1, 0.01)
        assert L is not None
        Ac, Bc, _ = of_fault_rate(c, L)
        bound = peak_injection(c, L)
        assert bound.slack <= 1e-3 * bound.value
        h, step = 1e-3, np.linalg.inv(np.eye(3) - 0.5e-3 * Ac)  # the trapezoidal rule keeps every steady state
        e, worst = np.zeros(3), 0.0
        for xi in np.repeat(rng.choice([-1.0, 1.0], 40), 250):
            e = step @ ((np.eye(3) + 0.5 * h * Ac) @ e + h * Bc[:, 0] * xi)
            worst = max(worst, float(np.linalg.norm(-c.A21 @ e + np.array([0.0, 0.0, xi]))))
        assert 0.3 * bound.value < worst <= bound.value


def test_without_l2_the_injection_is_the_rate_itself() -> None:
    c = canonical(-np.eye(2), np.zeros((2, 0)), np.eye(2), [[0.0], [1.0]])
    assert peak_injection(c, np.zeros((1, 2))).value == pytest.approx(1.0, abs=1e-3)


def test_the_ramp_of_the_case_study_needs_less_injection_than_the_bound() -> None:
    """Measured after a ramp of 0.01 rad/s^2 stops: 0.0131 = lambda * 1.2212 * 0.01."""
    L = np.column_stack([np.zeros((3, 2)), L2])
    assert 0.0131 < 0.01 * peak_injection(admire(), L).value < 0.03
