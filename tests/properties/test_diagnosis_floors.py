# SPDX-License-Identifier: BSD-3-Clause
"""Floors are properties of the plant: no coordinates, no estimator and no second algorithm gets round them."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from faultrecon.diagnosis.existence import detectability_findings
from faultrecon.diagnosis.limits import reconstruction_floor, reconstruction_floors, slow_fault_floor
from faultrecon.finding import Impossible, Inconclusive
from faultrecon.numerics.annihilator import annihilator, left_inverse
from faultrecon.numerics.decay import distance_at_least
from faultrecon.numerics.hinf import estimator_floor, frequency_response, hinf_norm, imitated
from faultrecon.numerics.interpolation import hidden_mode_floor
from faultrecon.numerics.pencil import SlowModes, detectability_margin
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Signals
from faultrecon.synthesis.pipeline import optimum

SEEDS = st.integers(0, 2**32 - 1)


def orthogonal(rng, n):
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


def hidden(rng, n, k, q, p1=1, growing=True):
    """(A, C1, C2): the first k states grow (or decay) at 0.3 or more, drive nothing else and are unseen by C1."""
    A = rng.standard_normal((n, n)) / np.sqrt(n)
    A[k:, k:] -= 2.5 * np.eye(n - k)
    rates = np.linalg.eigvals(A[:k, :k]).real
    shift = 0.3 - rates.min() if growing else -0.3 - rates.max()
    A[:k, :k] += shift * np.eye(k)
    A[k:, :k] = 0.0
    C1, C2 = rng.standard_normal((p1, n)), rng.standard_normal((q, n))
    C1[:, :k] = 0.0
    return A, C1, C2


def riccati_floor(A, C1, C2):
    """Smallest |G~| of the sliding mode observer by bisection on a Riccati equation with fictitious noise 1e-3."""
    from scipy.linalg import null_space, solve_continuous_are

    n, q, p1 = A.shape[0], C2.shape[0], C1.shape[0]
    T = np.vstack([null_space(np.vstack([C1, C2])).T, C2, C1])
    Ab = T @ A @ np.linalg.inv(T)
    N, n1 = n + q, n - p1
    Aa = np.zeros((N, N))
    Aa[:n, :n], Aa[n:, :n] = Ab, Ab[n1 - q : n1]
    A11, A211, A212 = Aa[:n1, :n1], Aa[n1:n, :n1], Aa[n:, :n1]
    Ce = np.hstack([np.zeros((q, n1 - q)), -np.eye(q)])
    d, ep = 1e-3, 1e-4

    def reached(gamma):
        B = np.vstack([A212, A211 / d, Ce / gamma]).T
        try:
            Y = solve_continuous_are(
                A11.T, B, ep**2 * np.eye(n1), np.diag([1.0] * n + [-1.0] * q)[n - q - p1 :, n - q - p1 :]
            )
        except (np.linalg.LinAlgError, ValueError):
            return False
        return bool(np.linalg.eigvalsh(0.5 * (Y + Y.T)).min() > -1e-12)

    low, high = 1e-3, 1e3
    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if reached(middle) else (middle, high)
    return high


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("k", "q"), [(1, 1), (2, 1), (2, 2), (3, 2)])
def test_the_closed_form_is_what_a_riccati_bisection_finds(seed, k, q):
    A, C1, C2 = hidden(np.random.default_rng([seed, k, q]), 5, k, q)
    # The fictitious noise raises the bisection by about its relative size squared times gains of a few units.
    assert riccati_floor(A, C1, C2) == pytest.approx(hidden_mode_floor(A, C1, C2).value, rel=1e-5)


@given(SEEDS, st.integers(1, 4), st.integers(1, 3), st.integers(0, 8))
@example(29669573, 4, 1, 3)  # a mode that the faulty output sees 10^7 times less than the others
@settings(max_examples=60, deadline=None)
def test_state_and_output_transformations_leave_the_hidden_floor_alone(seed, k, q, rest):
    rng = np.random.default_rng(seed)
    A, C1, C2 = hidden(rng, k + rest, k, q, p1=min(rest, 2))
    floor = hidden_mode_floor(A, C1, C2).value
    assume(0 < floor < 1e3)
    T = orthogonal(rng, k + rest) @ np.diag(rng.uniform(0.5, 2.0, k + rest)) @ orthogonal(rng, k + rest)
    S = rng.standard_normal((C1.shape[0], C1.shape[0])) + 3 * np.eye(C1.shape[0])
    mixed = C2 + rng.standard_normal((q, C1.shape[0])) @ C1  # f read with any share of the healthy outputs
    Ti = np.linalg.inv(T)
    again = hidden_mode_floor(Ti @ A @ T, S @ C1 @ T, orthogonal(rng, q) @ mixed @ T).value
    # The modes are only as well known as their eigenvectors: rounding times the condition of X^(1/2).
    assert again == pytest.approx(floor, rel=1e-9 * max(1.0, _spread(A[:k, :k], C2[:, :k]) / 1e4))


def test_a_mode_that_is_hardly_seen_costs_what_exact_arithmetic_says():
    A, C1, C2 = hidden(np.random.default_rng(29669573), 7, 4, 1, p1=2)
    # Pick matrix of the four unstable eigenvalues in arithmetic of 60 digits; the matrix itself has condition 10^14.
    assert hidden_mode_floor(A, C1, C2).value == pytest.approx(9.32387730633132, rel=1e-8)


def _spread(L, W):
    from scipy.linalg import solve_continuous_lyapunov

    return np.sqrt(np.linalg.cond(solve_continuous_lyapunov(L.T, W.T @ W)))


def linear(A, B, C, E, faulty):
    """A plant with one disturbance per column of [B; E], faults on the named sensors."""
    n, p = A.shape[0], C.shape[0]
    x, y = tuple(f"x{i}" for i in range(n)), tuple(f"y{i}" for i in range(p))
    disturbances = tuple(
        Disturbance(f"w{j}", dict(zip(x, B[:, j], strict=True)), dict(zip(y, E[:, j], strict=True)))
        for j in range(B.shape[1])
    )
    faults = tuple(FaultChannel(f"f{j}", {y[j]: 1.0}) for j in faulty)
    signals = Signals(Channels(x), Channels(()), Channels(y))
    return Plant("random", signals, A, np.zeros((n, 0)), C, np.zeros((p, 0)), faults=faults, disturbances=disturbances)


def random_plant(rng, n, p, q, stable):
    A = rng.standard_normal((n, n)) / np.sqrt(n) - (1.5 if stable else 0.3) * np.eye(n)
    width = p + 1  # more disturbances than sensors: nothing is known exactly
    B, C, E = rng.standard_normal((n, width)), rng.standard_normal((p, n)), 0.3 * rng.standard_normal((p, width))
    return linear(A, B, C, E, range(q))


@given(SEEDS, st.integers(1, 12), st.integers(2, 5))
@settings(max_examples=40, deadline=None)
def test_no_estimator_with_any_gains_goes_below_the_floor(seed, n, p):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n, p, q := int(rng.integers(1, p)), stable=True)
    floor = reconstruction_floor(plant).value
    C1, C2, E1, E2 = plant.C[q:], plant.C[:q], plant.F_w[q:], plant.F_w[:q]
    for size in (0.0, 0.1, 1.0):
        L, K = size * rng.standard_normal((n, p - q)), size * rng.standard_normal((q, p - q))
        gain = hinf_norm(plant.A - L @ C1, plant.E_w - L @ E1, C2 - K @ C1, E2 - K @ E1)
        assert gain.value >= floor * (1 - 1e-6)


def noisy(rng, n, p, stable=True):
    """A random plant with noise of its own on every sensor and a fault on each."""
    A = rng.standard_normal((n, n)) / np.sqrt(n) - (1.5 if stable else 0.3) * np.eye(n)
    B = np.hstack([rng.standard_normal((n, 2)), np.zeros((n, p))])
    E = np.hstack([0.3 * rng.standard_normal((p, 2)), np.diag(10.0 ** rng.uniform(-2, 0, p))])
    return linear(A, B, rng.standard_normal((p, n)), E, range(p))


@given(SEEDS, st.integers(1, 12), st.integers(2, 5), st.booleans())
@settings(max_examples=30, deadline=None)
def test_floors_asked_together_are_those_asked_alone(seed, n, p, stable):
    rng = np.random.default_rng(seed)
    plant = noisy(rng, n, p, stable)
    names = [f.name for f in plant.faults]
    sets = [plant.with_faults([name]) for name in names] + [plant.with_faults(names[:2])]
    for one, found in zip(sets, reconstruction_floors(sets), strict=True):
        if found.kind != "disturbance":
            continue
        N, K = annihilator(one.F_f), left_inverse(one.F_f)
        C, E = one.C, one.F_w
        alone = estimator_floor(one.A, one.E_w, N @ C, N @ E, K @ C, K @ E).value
        # Each is within 2e-9 of the supremum, from below, and evaluated with rounding below 1e-6 of itself.
        assert found.value == pytest.approx(alone, rel=1e-6)


@given(SEEDS, st.integers(1, 12), st.integers(2, 5))
@settings(max_examples=30, deadline=None)
def test_the_floor_of_a_set_is_above_every_frequency_of_a_dense_grid(seed, n, p):
    plant = noisy(np.random.default_rng(seed), n, p)
    one = plant.with_faults([plant.faults[0].name])
    floor = reconstruction_floor(one).value
    Y = frequency_response(one.A, one.E_w, one.C, one.F_w, np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 2000)]))
    S = np.linalg.inv(Y @ Y.conj().transpose(0, 2, 1))
    assert np.sqrt(1 / S[:, 0, 0].real.min()) <= floor * (1 + 1e-8)  # a covariance of 10 decades keeps half its digits


@given(SEEDS, st.integers(1, 10), st.integers(1, 3), st.booleans(), st.booleans())
@settings(max_examples=40, deadline=None)
def test_the_certain_distance_never_exceeds_the_one_that_is_found_by_search(seed, n, p, stable, sampled):
    from scipy.linalg import expm

    plant = random_plant(np.random.default_rng(seed), n, p + 1, 1, stable)
    A, C = (expm(plant.A) if sampled else plant.A), plant.C[:p]
    slow = SlowModes.of(A, C, sampled=sampled)
    certain = distance_at_least(slow)
    # The search reports an upper bound, so the certain bound lies below it, in the same balanced units.
    assert 0 <= certain <= detectability_margin(A, C, sampled=sampled) * (1 + 1e-9)


def test_a_well_behaved_model_needs_no_search():
    rng = np.random.default_rng(0)
    for growing in (0, 2):
        A, C1, C2 = hidden(rng, 12, 2, 1, p1=3, growing=bool(growing))
        assert distance_at_least(SlowModes.of(A, np.vstack([C1, C2]))) > 1e-4


@given(SEEDS, st.integers(1, 8), st.integers(2, 4), st.floats(0.0, 10.0))
@settings(max_examples=30, deadline=None)
def test_what_disturbances_imitate_is_what_the_best_estimate_leaves(seed, n, p, w):
    """For faults on sensors the null space of the pencil and the projection of the response are one number."""
    plant = noisy(np.random.default_rng(seed), n, p).with_faults(["f0"])
    found = imitated(plant.A, plant.E_w, plant.C, plant.F_w, plant.E_f, plant.F_f, 1j * w)
    Y = frequency_response(plant.A, plant.E_w, plant.C, plant.F_w, [w])[0]
    S = np.linalg.inv(Y @ Y.conj().T)
    assert found == pytest.approx(1 / np.sqrt(S[0, 0].real), rel=1e-6)


def leaking(plant, B):
    """The plant with one input, whose actuator may fail, in place of its other faults."""
    signals = replace(plant.signals, u=Channels(("u",)))
    leak = FaultChannel("leak", {"u": 1.0}, site="actuator")
    D = np.zeros((plant.p, 1))
    return replace(plant, signals=signals, B=B, D=D, faults=(leak,), operating_point=None)


@given(SEEDS, st.integers(2, 8), st.integers(2, 4))
@settings(max_examples=30, deadline=None)
def test_no_estimator_that_follows_a_constant_actuator_fault_goes_below_its_floor(seed, n, p):
    rng = np.random.default_rng(seed)
    plant = noisy(rng, n, p)
    plant = leaking(plant, rng.standard_normal((n, 1)))
    floor = slow_fault_floor(plant)
    steady = -np.linalg.solve(plant.A, np.hstack([plant.B, plant.E_w]))
    gain, Y = plant.C @ steady[:, 0], plant.C @ steady[:, 1:] + plant.F_w
    for _ in range(5):
        M = rng.standard_normal(p)
        M = M / (M @ gain)  # any readout at rest that shows the fault in its size
        assert np.linalg.norm(M @ Y) >= floor.value * (1 - 1e-6)
    assert floor.kind == "slow fault"
    assert slow_fault_floor(replace(plant, faults=(replace(plant.faults[0], rate=2.0),))).value >= floor.value * (
        1 - 1e-9
    )


def test_an_actuator_fault_of_an_integrator_has_a_floor_at_rest_although_its_response_is_infinite_there():
    # x' = f + w1, y = x + w2: at rest w1 = -f hides the fault, and nothing else does.
    plant = linear(np.zeros((1, 1)), np.array([[1.0, 0.0]]), np.ones((1, 1)), np.array([[0.0, 1.0]]), [])
    plant = leaking(plant, np.ones((1, 1)))
    assert slow_fault_floor(plant).value == pytest.approx(1.0, rel=1e-12)


@given(SEEDS, st.integers(1, 12), st.booleans())
@settings(max_examples=8, deadline=None)
def test_no_design_reports_an_optimum_below_the_floor(seed, n, stable):
    plant = random_plant(np.random.default_rng(seed), n, 3, 1, stable)
    try:
        best = optimum(plant)
    except (Impossible, Inconclusive):
        return
    assert best >= reconstruction_floor(plant).value * (1 - 1e-5)  # the solver's gap


@given(SEEDS, st.integers(1, 3), st.integers(0, 6), st.booleans())
@settings(max_examples=50, deadline=None)
def test_the_hidden_floor_is_zero_exactly_when_the_healthy_part_is_detectable(seed, k, rest, growing):
    rng = np.random.default_rng(seed)
    A, C1, C2 = hidden(rng, k + rest, k, 1, p1=min(rest, 1), growing=growing)
    assume(np.abs(np.linalg.eigvals(A).real).min() > 1e-3)
    C = np.vstack([C2, C1])
    plant = linear(A, np.zeros((k + rest, 1)), C, np.ones((C.shape[0], 1)), [0])
    undetectable = any(f.severity == "fatal" for f in detectability_findings(plant))
    assert undetectable == growing
    assert (hidden_mode_floor(A, C1, C2).value > 0) == growing


@given(SEEDS, st.integers(1, 3))
@settings(max_examples=20, deadline=None)
def test_fast_sampling_leaves_the_hidden_floor_of_the_continuous_plant(seed, k):
    from scipy.linalg import expm

    A, C1, C2 = hidden(np.random.default_rng(seed), k + 2, k, 1)
    floor = hidden_mode_floor(A, C1, C2).value
    assume(0 < floor < 1e2)
    T = 1e-4
    # A held rate over T moves the floor by about T/2; two seconds' worth of other modes bound the factor.
    assert hidden_mode_floor(expm(A * T), C1, C2, sample_time=T).value == pytest.approx(floor, abs=50 * T * (1 + floor))


@pytest.mark.parametrize("solver", ["CLARABEL", "SCS"])
@given(SEEDS, st.integers(1, 5), st.booleans())
@settings(max_examples=10, deadline=None)
def test_a_refused_assumption_is_an_infeasible_inequality_for_a_second_solver(solver, seed, rest, growing):
    import cvxpy as cp

    rng = np.random.default_rng(seed)
    A, C1, C2 = hidden(rng, 1 + rest, 1, 1, growing=growing)
    T = orthogonal(rng, 1 + rest)
    A, C1, C2 = T.T @ A @ T, C1 @ T, C2 @ T
    plant = linear(A, np.zeros((1 + rest, 1)), np.vstack([C2, C1]), np.ones((2, 1)), [0])
    refused = any(f.severity == "fatal" for f in detectability_findings(plant))
    P, Z = cp.Variable(A.shape, symmetric=True), cp.Variable((A.shape[0], 1))
    X = P @ A + A.T @ P - Z @ C1 - C1.T @ Z.T
    # Homogeneous, so P >= I and X <= -I are no loss; modes are 0.3 or more from the axis, so no case is near the line.
    problem = cp.Problem(cp.Minimize(cp.trace(P)), [P >> np.eye(A.shape[0]), X << -np.eye(A.shape[0])])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an inaccurate point is judged below by its own eigenvalues
        problem.solve(solver=solver)
    assert refused == growing
    # A solver's word is no verdict: its point, if it has one, satisfies both inequalities or it does not.
    point = P.value is not None and np.linalg.eigvalsh(P.value).min() > 0.5 and np.linalg.eigvalsh(X.value).max() < -0.5
    assert point != refused
