# SPDX-License-Identifier: BSD-3-Clause
"""The solver-free optimum and its gains against published numbers, the inequality itself, and a conic solver.

Reference numbers: Khosrowjerdi 2011 Examples 4.1 and 4.2, computed by two independent routes; those of 4.2 are good to
1e-7, those of 4.1 to the six or seven digits printed.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from faultrecon.finding import FaultreconError, Impossible, Inconclusive
from faultrecon.numerics.hinf import estimator_floor, hinf_norm
from faultrecon.numerics.riccati import LevelSolution, central_gain, filter_riccati, optimal_level

M = np.ndarray
Problem = tuple[M, M, M, M, M, M, M, M, float]  # A, Bphi, B, C1, E1, H1, H2, G, alpha

# fmt: off
A41 = np.array([[-1.05, -2.55, 0, 0, -169, -.0091], [2.55, -1.05, 0, 0, 57.09, .0017], [0, 0, -77.53, 39.57, 0, 0],
                [0, 0, 0, -20.2, 0, 0], [0, 0, -8.8, 0, -20.2, 0], [0, 0, 0, 0, 0, -.1]])
C41 = np.array([[-.01, .09, .07, 0, 0, 0], [-.48, -.59, 0, 0, -49.51, -.0026],
                [.03, .09, -.06, 0, 0, 0], [.26, -.07, .01, 0, 0, 0]])
B41 = np.array([[1.0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0]])
E41 = np.array([[0.0, 1, 0], [0, 0, 1], [0, 0, 0], [0, 0, 0]])
F41 = np.array([[0.0, 1, 0, 0, 1, 0]]).T
# fmt: on
A42, B42 = np.array([[0.0, 1], [-1, -1]]), np.array([[1.0, 0], [1, 0]])


def example_4_1(alpha: float = 1.0, noise: float = 1.0, rows: int = 6) -> Problem:
    E = noise * E41
    return A41, F41, B41, C41[:2], E[:2], -C41[2:], -E[2:], np.eye(6)[:rows], alpha


def example_4_2(alpha: float = 1.17, noise: float = 1.0) -> Problem:
    E = noise * np.array([[0.0, 1], [0, 0]])
    return A42, np.eye(2), B42, np.array([[1.0, 0]]), E[:1], np.array([[0.0, -1]]), -E[1:], np.eye(2), alpha


def random_problem(n: int, seed: int) -> Problem:
    """Stable plants, n/2 outputs, two nonlinearities, noise on every output."""
    rng = np.random.default_rng(seed)
    p = max(2, n // 2)
    p1 = p - p // 2
    A = rng.normal(size=(n, n)) / np.sqrt(n)
    A -= (np.max(np.linalg.eigvals(A).real) + 0.3) * np.eye(n)
    B = np.hstack([rng.normal(size=(n, 2)), np.zeros((n, p))])
    C, E = rng.normal(size=(p, n)), np.hstack([np.zeros((p, 2)), 0.3 * np.eye(p)])
    return A, rng.normal(size=(n, 2)), B, C[:p1], E[:p1], -C[p1:], -E[p1:], np.eye(n), 0.15 / np.sqrt(n)


def solved(problem: Problem) -> LevelSolution:
    """The optimum; the example is dropped when none exists."""
    try:
        return optimal_level(*problem)
    except Impossible:
        assume(False)
        raise


def inequality(problem: Problem, P: np.ndarray, L: np.ndarray, beta: float, gamma: float) -> np.ndarray:
    """The block matrix of Theorem 3.1 with Z = P L; negative semidefinite when the level holds."""
    A, Bf, B, C1, E1, H1, H2, G, alpha = problem
    Z = P @ L
    m, w, q = Bf.shape[1], B.shape[1], H1.shape[0]
    top = A.T @ P + P @ A - C1.T @ Z.T - Z @ C1 + beta * alpha**2 * G.T @ G
    side = P @ B - Z @ E1
    return np.block(
        [
            [top, P @ Bf, side, H1.T],
            [Bf.T @ P, -beta * np.eye(m), np.zeros((m, w)), np.zeros((m, q))],
            [side.T, np.zeros((w, m)), -(gamma**2) * np.eye(w), H2.T],
            [H1, np.zeros((q, m)), H2, -np.eye(q)],
        ]
    )


def largest_relative_eigenvalue(M: np.ndarray) -> float:
    """Of M after scaling its diagonal to one: the sign is the same, and rounding is measured in that scale."""
    d = 1 / np.sqrt(np.abs(np.diag(M)))
    return float(np.linalg.eigvalsh(M * np.outer(d, d))[-1])


OPTIMA_4_2 = [
    (1.17, 1.0, 3.0, 3.4222394),
    (1.17, 1.0, None, 3.4178246),
    (0.5, 1.0, None, 1.0688802),
    (1.0, 1.0, None, 2.1857568),
    (1.17, 0.1, 3.0, 0.3556786),
    (1.17, 0.1, None, 0.3551882),
]


@pytest.mark.parametrize(("alpha", "noise", "beta", "gamma"), OPTIMA_4_2)
def test_the_optima_of_example_4_2(alpha: float, noise: float, beta: float | None, gamma: float) -> None:
    assert optimal_level(*example_4_2(alpha, noise), beta=beta).gamma == pytest.approx(gamma, rel=1e-6)


OPTIMA_4_1 = [
    (1.0, 1.0, 6, 0.01, 3.996695),
    (1.0, 1.0, 1, 0.01, 3.797576),
    (0.1, 1.0, 6, None, 0.9669007),
    (1.0, np.sqrt(0.05), 6, 0.01, 0.956919),
    (1.0, np.sqrt(0.05), 6, None, 0.852483),
]


@pytest.mark.parametrize(("alpha", "noise", "rows", "beta", "gamma"), OPTIMA_4_1)
def test_the_optima_of_example_4_1(alpha: float, noise: float, rows: int, beta: float | None, gamma: float) -> None:
    assert optimal_level(*example_4_1(alpha, noise, rows), beta=beta).gamma == pytest.approx(gamma, rel=1e-5)


@pytest.mark.parametrize("alpha", [1.0, 5.0, 50.0])
def test_where_the_best_beta_is_zero_the_lipschitz_constant_does_not_matter(alpha: float) -> None:
    assert optimal_level(*example_4_1(alpha)).gamma == pytest.approx(3.52469, rel=1e-5)


def test_the_best_beta_is_found_as_well() -> None:
    # The level is flat there: it is known to 1e-8, so beta to the square root, 1e-4.
    assert optimal_level(*example_4_2(1.17)).beta == pytest.approx(2.9013, abs=1e-3)
    assert optimal_level(*example_4_2(0.5)).beta == pytest.approx(1.3066, abs=1e-3)
    assert optimal_level(*example_4_1(0.1)).beta == pytest.approx(0.5395, abs=1e-3)


def test_a_pair_of_eigenvalues_on_the_axis_is_not_taken_for_a_solution() -> None:
    """Counting stable eigenvalues alone accepts 1.0631 here; a conic solver gives 1.2224142."""
    problem = example_4_2(0.5)
    assert optimal_level(*problem, beta=3.0).gamma == pytest.approx(1.222414, rel=1e-6)
    assert central_gain(*problem, 3.0, 1.0631) is None
    assert central_gain(*problem, 3.0, 1.15) is None


def test_beyond_root_two_no_level_exists_for_example_4_2_and_close_below_it_does() -> None:
    with pytest.raises(Impossible, match="no level gamma"):
        optimal_level(*example_4_2(1.42))
    assert optimal_level(*example_4_2(1.4)).gamma == pytest.approx(50.485, rel=1e-4)


def test_without_nonlinearity_the_optimum_of_example_4_2_is_the_floor_of_every_estimator() -> None:
    A, _, B, C1, E1, H1, H2, _, _ = example_4_2()
    floor = estimator_floor(A, B, C1, E1, -H1, -H2).value
    no_channel: Problem = A, np.zeros((2, 0)), B, C1, E1, H1, H2, np.zeros((0, 2)), 1.0
    for problem in (example_4_2(0.0), no_channel):
        found = optimal_level(*problem)
        assert found.beta is None
        assert found.gamma == pytest.approx(floor, rel=2e-8)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 7))
def test_the_optimum_is_attained_just_above_and_not_just_below(seed: int, n: int) -> None:
    """`central_gain` shares no algebra with the search, and checks its own closed loop."""
    problem = random_problem(n, seed)
    found = solved(problem)
    assert found.beta is not None
    assert found.gamma / found.lower - 1 < 1e-6
    assert central_gain(*problem, found.beta, found.gamma * (1 + 1e-5)) is not None
    for beta in (found.beta, 1.1 * found.beta, found.beta / 1.1):
        assert central_gain(*problem, beta, found.lower * (1 - 1e-5)) is None


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_an_extra_healthy_sensor_never_raises_gamma_and_gamma_is_never_below_the_floor(seed: int) -> None:
    A, Bf, B, C1, E1, H1, H2, G, alpha = random_problem(6, seed)
    more = solved((A, Bf, B, C1, E1, H1[:1], H2[:1], G, alpha)).gamma
    fewer = solved((A, Bf, B, C1[:1], E1[:1], H1[:1], H2[:1], G, alpha)).gamma
    assert more <= fewer * (1 + 1e-6)
    assert more >= estimator_floor(A, B, C1, E1, -H1[:1], -H2[:1]).value * (1 - 1e-8)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_gamma_squared_is_a_convex_function_of_beta(seed: int) -> None:
    problem = random_problem(4, seed)
    best = solved(problem).beta
    assert best is not None
    betas = best * np.linspace(0.8, 3.0, 7)
    values = np.array([optimal_level(*problem, beta=float(b)).gamma ** 2 for b in betas])
    # Each value is known to 2e-8 of itself; a second difference combines four.
    assert np.min(np.diff(values, 2)) >= -1e-7 * np.max(values)


def test_units_of_the_states_change_nothing() -> None:
    problem = random_problem(5, 3)
    A, Bf, B, C1, E1, H1, H2, G, alpha = problem
    t = np.ldexp(1.0, np.array([20, -15, 0, 7, -3]))
    scaled = A * t / t[:, None], Bf / t[:, None], B / t[:, None], C1 * t, E1, H1 * t, H2, G * t, alpha
    assert optimal_level(*scaled) == optimal_level(*problem)


def test_a_conic_solver_finds_the_same_level() -> None:
    import cvxpy as cp

    A, Bf, B, C1, E1, H1, H2, G, alpha = problem = random_problem(4, 1)
    n, m, w, q = 4, 2, B.shape[1], H1.shape[0]
    P, Z = cp.Variable((n, n), symmetric=True), cp.Variable((n, C1.shape[0]))
    beta, g = cp.Variable(), cp.Variable()
    top = A.T @ P + P @ A - C1.T @ Z.T - Z @ C1 + beta * alpha**2 * G.T @ G
    side = P @ B - Z @ E1
    block = cp.bmat(
        [
            [top, P @ Bf, side, H1.T],
            [Bf.T @ P, -beta * np.eye(m), np.zeros((m, w)), np.zeros((m, q))],
            [side.T, np.zeros((w, m)), -g * np.eye(w), H2.T],
            [H1, np.zeros((q, m)), H2, -np.eye(q)],
        ]
    )
    task = cp.Problem(cp.Minimize(g), [(block + block.T) / 2 << 0, P >> 0])
    task.solve(solver="CLARABEL")
    # The interior-point method stops inside by about 1e-8 of g where it converges cleanly; 1e-6 leaves two digits.
    assert optimal_level(*problem).gamma == pytest.approx(float(np.sqrt(g.value)), rel=1e-6)


def test_the_joint_optimum_takes_at_most_a_hundred_schur_forms_also_for_thirty_states() -> None:
    counts = [optimal_level(*random_problem(30, seed)).schur_count for seed in range(2)]
    counts += [optimal_level(*random_problem(8, seed)).schur_count for seed in range(10)]
    assert max(counts) <= 100


def test_the_gain_of_example_4_1() -> None:
    found = central_gain(*example_4_1(), 0.01, 4.2)
    assert found is not None
    # fmt: off
    expected = np.array([[70.8359, -6.9764], [58.8556, -51.6172], [-.000784, -.021616], [0, 0], [-1.29575, -41.4104],
                         [1.41586, -.23428]])
    # fmt: on
    assert np.allclose(found.L, expected, rtol=0, atol=5.1e-5)  # as printed


def test_the_gain_and_the_lyapunov_matrix_of_example_4_2() -> None:
    found = central_gain(*example_4_2(), 3.0, 3.6)
    assert found is not None and found.P is not None
    assert np.allclose(found.L.ravel(), [5.060278, 3.572168], rtol=0, atol=6e-7)
    assert np.allclose(found.P, [[3.678969, -1.583522], [-1.583522, 2.243193]], rtol=0, atol=6e-7)


@pytest.mark.parametrize(("share", "L", "pole"), [(1.01, (8.6275, 8.2076), 7.12), (1.05, (5.0547, 3.6061), 3.11)])
def test_backing_off_shrinks_the_gain_as_published(share: float, L: tuple[float, float], pole: float) -> None:
    problem = example_4_2()
    best = optimal_level(*problem)
    found = central_gain(*problem, best.beta, share * best.gamma)
    assert found is not None
    # L grows like 1/(share - 1): an error of 1e-6 in gamma and 1e-4 in beta shows as 2e-4 of L.
    assert np.allclose(found.L.ravel(), L, rtol=3e-4)
    fastest = np.max(np.abs(np.linalg.eigvals(problem[0] - found.L @ problem[3])))
    assert fastest == pytest.approx(pole, abs=0.005 + 0.002)  # printed digits, and those of L


@pytest.mark.parametrize(("share", "size", "pole"), [(1.01, 442, 2023), (1.05, 115, 2103), (1.1, 83.6, 2203)])
def test_backing_off_shrinks_the_gain_of_example_4_1_as_published(share: float, size: float, pole: float) -> None:
    problem = example_4_1()
    found = central_gain(*problem, 0.01, share * optimal_level(*problem, beta=0.01).gamma)
    assert found is not None
    assert np.linalg.norm(found.L) == pytest.approx(size, rel=5e-3)
    assert np.max(np.abs(np.linalg.eigvals(A41 - found.L @ C41[:2]))) == pytest.approx(pole, abs=0.6)


@pytest.mark.parametrize("problem", [example_4_2(), example_4_2(0.5), example_4_1(0.1), random_problem(6, 0)])
def test_the_returned_p_satisfies_the_inequality_with_the_returned_gain(problem: Problem) -> None:
    best = optimal_level(*problem)
    gamma = 1.05 * best.gamma
    found = central_gain(*problem, best.beta, gamma)
    assert found is not None and found.P is not None and best.beta is not None
    assert np.linalg.eigvalsh(found.P)[0] > 0
    # P = Q^-1 solves the equation, so the largest eigenvalue is zero up to the residual of the Riccati solution.
    assert largest_relative_eigenvalue(inequality(problem, found.P, found.L, best.beta, gamma)) < 1e-8


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_the_real_gain_of_the_linear_part_stays_below_gamma(seed: int) -> None:
    problem = random_problem(5, seed)
    A, _, B, C1, E1, H1, H2, _, _ = problem
    best = solved(problem)
    found = central_gain(*problem, best.beta, 1.05 * best.gamma)
    assert found is not None
    loop = A - found.L @ C1
    assert hinf_norm(loop, B - found.L @ E1, H1, H2).value <= 1.05 * best.gamma


def test_a_state_nothing_disturbs_does_not_spoil_the_certificate() -> None:
    """Its Q is zero, so Q^-1 does not exist; P then comes from a little noise added to every state."""
    A = np.array([[-1.0, 0.5], [0.0, -0.2]])
    found = filter_riccati(A, [[1.0, 0], [0, 0]], [[1.0, 0]], [[0, 1.0]], [[0.5, 0.5]], [[0.0, 0]])
    assert found is not None and found.P is not None
    assert np.allclose(found.Q[1], 0, atol=1e-12)
    assert np.linalg.eigvalsh(found.P)[0] > 0


def test_without_healthy_outputs_the_filter_is_the_bounded_real_test() -> None:
    A, B, C, D = np.array([[-1.0]]), np.array([[1.0]]), np.array([[1.0]]), np.zeros((1, 1))
    none, level = np.zeros((0, 1)), np.zeros((0, 1))
    assert filter_riccati(A, B, none, level, 0.999 * C, D) is not None
    assert filter_riccati(A, B, none, level, 1.001 * C, D) is None
    found = optimal_level(A, np.zeros((1, 0)), B, none, level, C, D, np.zeros((0, 1)), 0.0)
    assert found.gamma == pytest.approx(1.0, rel=1e-7)


def test_a_healthy_output_without_noise_is_refused_by_name() -> None:
    A, Bf, B, C1, E1, H1, H2, G, alpha = example_4_2()
    with pytest.raises(Inconclusive, match="E1 lacks row rank"):
        optimal_level(A, Bf, B, C1, 0 * E1, H1, H2, G, alpha)
    with pytest.raises(Inconclusive, match="E1 lacks row rank"):
        central_gain(A, Bf, B, C1, 0 * E1, H1, H2, G, alpha, 3.0, 3.6)


def test_a_hidden_growing_mode_is_impossible_before_anything_is_solved() -> None:
    _, Bf, B, C1, E1, H1, H2, G, alpha = example_4_2()
    with pytest.raises(Impossible, match="not seen by the healthy outputs"):
        optimal_level(np.diag([-1.0, 0.5]), Bf, B, C1, E1, H1, H2, G, alpha)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_every_outcome_is_a_level_or_a_finding(seed: int) -> None:
    """Unstable plants, sparse disturbances, feedthrough to faulty rows, strong nonlinearities: no exception leaks."""
    rng = np.random.default_rng(seed)
    n, m, p1, q = (int(k) for k in rng.integers([1, 0, 0, 1], [7, 3, 3, 3]))
    w = p1 + int(rng.integers(0, 3))
    E = rng.normal(size=(p1 + q, w)) * (rng.random((p1 + q, w)) < 0.6)
    B = rng.normal(size=(n, w)) * (rng.random((n, w)) < 0.6)
    A, Bf, C = rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(p1 + q, n))
    problem = A, Bf, B, C[:p1], E[:p1], -C[p1:], -E[p1:], np.eye(n), float(rng.uniform(0, 0.6))
    try:
        found = optimal_level(*problem)
    except FaultreconError:
        return
    assert 0 < found.lower <= found.gamma < np.inf
