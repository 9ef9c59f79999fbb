# SPDX-License-Identifier: BSD-3-Clause
"""Sliding-mode observers at run time: exact where they should be, free of chatter, and robust to imperfect samples."""

import itertools
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag, solve_continuous_are
from scipy.optimize import brentq

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import CopiedTerm, Injection, NonlinearTerm, Observer
from faultrecon.numerics.discretise import zoh
from faultrecon.runtime import injecting
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction

# ADMIRE, Mach 0.22, 3000 m [Alwi, Edwards, Tan 2009]: alpha beta p q r from canard, two elevons, rudder; p q r read.
AIRCRAFT = (
    np.array(
        [[-0.5432, 0.0137, 0, 0.9778, 0], [0, -0.1179, 0.2215, 0, -0.9661], [0, -10.5128, -0.9967, 0, 0.6176],
         [2.6221, -0.0030, 0, -0.5057, 0], [0, 0.7075, -0.0939, 0, -0.2127]]
    ),
    np.array(
        [[0.0069, -0.0866, -0.0866, 0.0004], [0, 0.0119, -0.0119, 0.0287], [0, -4.2423, 4.2423, 1.4871],
         [1.6532, -1.2735, -1.2735, 0.0024], [0, -0.2805, 0.2805, -0.8823]]
    ),
    np.eye(5)[2:],
)  # fmt: skip
P_RATE, Q_RATE, R_RATE = 0, 1, 2  # measurements
# Masses 1 and 0.5 in a row on a wall, springs 4 and 2, dampers 0.4 and 0.2; both positions read, force on the first.
TWO_MASS = (
    np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-6, 2, -0.6, 0.2], [4, -4, 0.4, -0.4]], dtype=float),
    np.array([[0.0], [0.0], [1.0], [0.0]]),
    np.eye(2, 4),
)
H = 0.01
INVERTING = {"hold": "left"}  # the inputs below are held from one sample to the next


# ------------------------------------------------------------ observers and logs


def sliding(plant, faulty, *, level=None, **parts):
    """An observer for the faulty measurements in the coordinates (x, f), and its sliding motion (Ac, L2, Ce).

    L solves the filter Riccati equation of the reduced pair, with L2 = 0 unless a level is given; G_l = 10 G_n P⁻¹.
    """
    A, B, C = plant
    (n, m), p, q = B.shape, len(C), len(faulty)
    S = np.eye(p)[[i for i in range(p) if i not in faulty] + list(faulty)]  # healthy outputs first
    F, n1 = S[p - q :].T, n + q - p
    N = np.linalg.svd(C)[2][p:]
    T = np.block([[np.vstack([N, S[p - q :] @ C, S[: p - q] @ C]), np.zeros((n, q))], [S[p - q :] @ C, np.eye(q)]])
    At = T @ block_diag(A, np.zeros((q, q))) @ np.linalg.inv(T)
    A11, A21, Ce = At[:n1, :n1], At[n1:, :n1], np.hstack([np.zeros((q, n - p)), -np.eye(q)])
    L = np.zeros((n1, p))
    if level is None:
        L[:, : p - q] = filter_gain(A11, A21[: p - q], 0.1, 0 * Ce)
    else:
        L = filter_gain(A11, A21, np.r_[np.full(p - q, 0.1), np.ones(q)], Ce / level)
    weight = parts.pop("weight", np.eye(p))
    into = np.linalg.solve(T, np.vstack([-L, np.eye(p)]))
    linear = parts.pop("linear", 10.0 * into @ np.linalg.inv(weight))
    reads, direct = S @ np.hstack([C, F]), np.hstack([np.zeros((p, m)), -S])
    A_a, B_a = block_diag(A, np.zeros((q, q))), np.vstack([np.hstack([B, np.zeros((n, p))]), np.zeros((q, m + p))])
    observer = Observer(
        A_a - linear @ reads, B_a - linear @ direct, np.eye(n, n + q), np.zeros((n, m + p)), np.eye(q, n + q, n),
        np.zeros((q, m + p)), F, np.zeros(n), np.zeros(m), np.zeros(p),
        injections=(Injection(linear, into, reads, direct, weight, **({"bound": 1.0} | parts)),),
    )  # fmt: skip
    assert observer.poles.real.max() < 0
    return observer, (A11 + L @ A21, L[:, p - q :], Ce)


def filter_gain(A, C, noise, E):
    """-Y C' R⁻¹ from A Y + Y A' + 1e-4 I + Y (E'E - C' R⁻¹ C) Y = 0, the stabilising solution, R = noise²."""
    n, M = len(A), C.T @ (C / np.square(noise).reshape(-1, 1) if np.ndim(noise) else C / noise**2) - E.T @ E
    poles, V = np.linalg.eig(np.block([[A.T, -M], [-1e-4 * np.eye(n), -A]]))
    V = V[:, poles.real < 0]
    return -np.real(V[n:] @ np.linalg.inv(V[:n])) @ (C.T / np.square(noise))


def prediction(plant):
    return Prediction(plant[2], np.zeros((len(plant[2]), plant[1].shape[1])))


def flight(plant, F, f, t, noise=0.0):
    """u, y and x of the plant under state feedback with doublets on its first and last input; f (N, q)."""
    A, B, C = plant
    n, m = B.shape
    K = B.T @ solve_continuous_are(A, B, np.eye(n), np.eye(m))
    doublet = 0.05 * (np.sign(np.clip(t - 1, 0, None)) * (t < 2) - (t > 2) * (t < 3))
    x, u, steps = np.zeros((len(t), n)), np.zeros((len(t), m)), {}
    for k, h in enumerate(np.append(np.diff(t), H)):
        u[k] = -K @ x[k]
        u[k, [0, -1]] += doublet[k], doublet[max(0, k - len(t) // 4)]
        if k + 1 < len(t):
            key = float(np.round(h, 12))
            Ad, Bd = steps[key] if key in steps else steps.setdefault(key, zoh(A, B, h))
            x[k + 1] = Ad @ x[k] + Bd @ u[k]
    return u, x @ C.T + f @ F.T + noise * np.random.default_rng(1).normal(size=(len(t), len(C))), x


def ramp(t):
    return 0.01 * np.clip(t - 5, 0, 10)[:, None]


def wave(t):
    return 0.1 * np.sin(0.3 * t)[:, None]


def ideal(motion, f, h):
    """F(s) f at the samples: the exact response of the sliding motion to straight lines from sample to sample."""
    Ac, L2, Ce = motion
    Ad, Bd = zoh(Ac, -L2, h)
    e, out = np.zeros(len(Ac)), [f[0]]
    for before, after in itertools.pairwise(f):
        e = Ad @ e + Bd @ ((after - before) / h)
        out.append(after + Ce @ e)
    return np.array(out)


def rms(a):
    return float(np.sqrt(np.mean(np.square(a))))


def estimates(estimator, t, u, y, **start):
    state, out = estimator.init(**start), []
    for row in zip(t, u, y, strict=True):
        state, estimate = estimator.step(state, *row)
        out.append(estimate)
    return state, out


# ------------------------------------------------------------ exactness


@pytest.mark.parametrize(
    ("plant", "faulty"), [(AIRCRAFT, [R_RATE]), (AIRCRAFT, [P_RATE]), (AIRCRAFT, [P_RATE, R_RATE]), (TWO_MASS, [1])]
)
@pytest.mark.parametrize("layer", [0.0, 0.01])
def test_with_a_minimum_phase_fault_a_right_model_and_a_right_start_nothing_is_left_of_the_error(plant, faulty, layer):
    """With a layer only while the fault stands still: a moving one needs an injection, and then e != 0."""
    observer, _ = sliding(plant, faulty)
    t = np.arange(1500) * H
    f = np.outer(ramp(t) if layer == 0 else 0.1 + 0 * t, np.linspace(1, 0.5, len(faulty)))
    u, y, x = flight(plant, observer.F, f, t)
    trace = Estimator.build(observer, H, layer=layer, **INVERTING).replay(t, u, y, x=x[0])
    assert np.abs(trace.fault - f).max() < 1e-12
    assert np.abs(trace.state - x).max() < 1e-12


def test_it_stays_exact_over_irregular_intervals_and_long_gaps():
    observer, _ = sliding(AIRCRAFT, [R_RATE])
    rng = np.random.default_rng(2)
    t = np.cumsum(np.where(rng.random(400) < 0.5, H, rng.choice([0.003, 0.017, 0.02, 0.5], size=400)))
    u, y, x = flight(AIRCRAFT, observer.F, wave(t), t)
    trace = Estimator.build(observer, H, bound=5.0, **INVERTING).replay(t, u, y, x=x[0])
    # Irregular lengths are rounded to a millionth of the sample time: 1e-8 s of the state's own motion, at most
    # |xdot| < 0.5 here, and it is corrected rather than summed up.
    assert np.abs(trace.fault - wave(t)).max() < 1e-8
    assert np.abs(trace.state - x).max() < 1e-8


def test_one_odd_interval_is_a_step_of_the_estimator_for_that_interval():
    observer, _ = sliding(AIRCRAFT, [Q_RATE], level=1.25, bound=0.3, layer=0.001)
    rng = np.random.default_rng(3)
    u, y, start = rng.normal(size=(2, 4)), 0.02 * rng.normal(size=(2, 3)), rng.normal(size=5) * 0.01
    for h in (0.002, 0.013, 0.4):
        odd, regular = (
            estimates(Estimator.build(observer, T, hold="linear"), [0.0, h], u, y, x=start)[1][-1] for T in (H, h)
        )
        # two exponentials and eigendecompositions of the same matrices: rounding, times |z| < 1
        np.testing.assert_allclose(odd.state, regular.state, atol=1e-12)
        np.testing.assert_allclose(odd.fault, regular.fault, atol=1e-12)


def test_a_start_that_is_told_finds_the_fault_that_is_there():
    observer, _ = sliding(AIRCRAFT, [R_RATE])
    x = np.array([0.1, 0.0, 0.2, -0.1, 0.3])
    estimator = Estimator.build(observer, H)
    _, estimate = estimator.step(estimator.init(x=x), 0.0, np.zeros(4), x[2:] + [0.0, 0.0, 0.07])
    np.testing.assert_allclose(estimate.fault, [0.07], atol=1e-15)
    np.testing.assert_allclose(estimate.state, x, atol=1e-15)


def test_a_scheme_for_smooth_equations_is_refused_in_one_sentence():
    observer, _ = sliding(AIRCRAFT, [Q_RATE], level=1.25, weight=np.diag([0.5, 1.0, 2.0]))
    with pytest.raises(InputError, match="which does neither, or scheme='explicit', to see it chatter"):
        Estimator.build(observer, 0.01, scheme="rk4")


# ------------------------------------------------------------ convergence and chatter


@pytest.fixture(scope="module")
def pitch():
    """A fault of the pitch rate gyro, which no estimator can follow exactly; distances to the ideal response."""
    observer, motion = sliding(AIRCRAFT, [Q_RATE], level=1.25, weight=np.diag([0.5, 1.0, 2.0]))
    found = {}
    for h in (0.02, 0.01, 0.005):
        t = np.arange(round(20 / h)) * h
        u, y, _ = flight(AIRCRAFT, observer.F, ramp(t), t)
        response = ideal(motion, ramp(t), h)
        for scheme, layer in (("implicit", 0.0), ("explicit", 0.0), ("explicit", 0.1), ("implicit", 0.1)):
            trace = Estimator.build(observer, h, scheme=scheme, layer=layer, **INVERTING).replay(t, u, y, x=np.zeros(5))
            chatter = rms(np.diff(trace.fault, axis=0)) / rms(np.diff(response, axis=0))
            found[scheme, layer, h] = rms(trace.fault - response), chatter
    return found


def test_implicit_steps_reach_the_ideal_response_with_order_one(pitch):
    errors = [pitch["implicit", 0.0, h][0] for h in (0.02, 0.01, 0.005)]
    # The next term is of order h times a pole of 3.7/s: 7 % at 20 ms.
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.07)
    assert errors[1] / errors[2] == pytest.approx(2, rel=0.04)
    assert errors[1] < 1e-4


def test_implicit_steps_do_not_chatter_and_explicit_ones_do(pitch):
    assert all(pitch["implicit", 0.0, h][1] <= 1.02 for h in (0.02, 0.01, 0.005))
    assert pitch["explicit", 0.0, 0.01][1] > 10


def test_a_layer_calms_the_explicit_scheme_at_the_price_of_a_bias_that_small_steps_do_not_remove(pitch):
    assert all(pitch["explicit", 0.1, h][1] < 1.1 for h in (0.02, 0.01, 0.005))
    for scheme in ("explicit", "implicit"):
        coarse, fine = (pitch[scheme, 0.1, h][0] for h in (0.02, 0.005))
        assert fine > 0.5 * coarse  # were it of order one, 0.25


def test_a_wrong_start_is_mended_at_the_pace_of_the_bound_in_finite_time():
    """Alone, and with weight I, the injection takes h ρ off |e| in every step, and then all that is left."""
    into = np.eye(3)
    injection = Injection(0 * into, into, into, -np.eye(3), np.eye(3), bound=0.5)
    estimator = Estimator.build(still(injection), H)
    start = np.array([0.03, 0.0, -0.04])
    _, rows = estimates(estimator, np.arange(15) * H, np.zeros((15, 0)), np.zeros((15, 3)), x=start)
    left = np.maximum(0.05 - 0.5 * H * np.arange(15), 0)
    np.testing.assert_allclose([row.state for row in rows], np.outer(left, start / 0.05), atol=1e-15)


# ------------------------------------------------------------ one step


def still(injection):
    """An observer that does nothing but inject, and shows all of its state; y is what direct reads."""
    nz, k = injection.into.shape
    zero = np.zeros((nz, k))
    return Observer(
        -injection.linear @ injection.reads, -injection.linear @ injection.direct, np.eye(nz), zero, np.zeros((0, nz)),
        np.zeros((0, k)), np.zeros((k, 0)), np.zeros(nz), np.zeros(0), np.zeros(k), injections=(injection,),
    )  # fmt: skip


def problem(rng, k, decades, layer):
    """An injection with reads linear inv(weight) symmetric, its weights spread over so many decades."""
    nz = k + int(rng.integers(0, 4))

    def spread():
        V = np.linalg.qr(rng.normal(size=(k, k)))[0]
        return (V * 10 ** rng.uniform(-decades / 2, decades / 2, k)) @ V.T

    weight, X, reads = spread(), spread(), rng.normal(size=(k, nz))
    weight = 0.5 * (weight + weight.T)
    own = np.linalg.pinv(reads)
    free = rng.normal(size=(nz, k)) - own @ reads @ rng.normal(size=(nz, k)) if nz > k else 0.0
    free = free - own @ (reads @ free) if nz > k else np.zeros((nz, k))
    bound = 10 ** rng.uniform(-2, 2)
    injection = Injection(own @ X @ weight + free, own + free, reads, -np.eye(k), weight, bound, layer)
    return injection, nz


def step_of(injection, h, start, y, every=None):
    """z after one interval of h seconds at whose end y is read; with another sample time `every`, an odd interval."""
    estimator = Estimator.build(still(injection), every or h)
    state, _ = estimator.step(estimator.init(x=start), 0.0, [], 0 * y)
    return estimator.step(state, h, [], y)[1].state


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    k=st.integers(1, 5),
    decades=st.sampled_from([0.0, 1.0, 2.0, 4.0]),
    layer=st.sampled_from([0.0, 0.01, 0.3, 10.0]),
    odd=st.booleans(),
)
def test_the_implicit_equation_holds_to_ten_digits(seed, k, decades, layer, odd):
    """layer: in units of what the bound does to s in one step."""
    rng = np.random.default_rng(seed)
    injection, nz = problem(rng, k, decades, 0.0)
    h = 10 ** rng.uniform(-4, -1)
    step = h * injection.bound
    injection = replace(injection, layer=layer * step * np.linalg.norm(injection.weight, 2))
    y = rng.normal(size=k)
    y *= step * 10 ** rng.uniform(-3, 3) / np.linalg.norm(y)
    e_hat = -y
    e = injection.reads @ step_of(injection, h, np.zeros(nz), y, every=2 * h if odd else None) - y
    if layer == 0.0 and np.linalg.norm(e_hat) <= step:
        assert np.linalg.norm(e) <= 1e-12 * np.linalg.norm(e_hat)  # 0 up to the rounding of weights of four decades
        return
    s = injection.weight @ e
    pulled = e + h * injection.reads @ injection.linear @ e
    residual = e_hat - pulled - step * s / (np.linalg.norm(s) + injection.layer)
    assert np.linalg.norm(residual) <= 1e-10 * np.linalg.norm(e_hat)


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), k=st.integers(1, 4), layer=st.sampled_from([0.0, 1e-3, 0.3]))
def test_one_step_is_what_dense_algebra_and_bisection_find(seed, k, layer):
    rng = np.random.default_rng(seed)
    injection, nz = problem(rng, k, 1.0, layer)
    h, start = 0.02, rng.normal(size=nz)
    G, R, P, into = injection.linear, injection.reads, injection.weight, injection.into
    y = R @ start - h * injection.bound * rng.uniform(0, 4) * (v := rng.normal(size=k)) / np.linalg.norm(v)
    e_hat, step = R @ start - y, h * injection.bound
    W = np.linalg.inv(P) + h * R @ G @ np.linalg.inv(P)

    def s_of(r):
        return np.linalg.solve((r + layer) * W + step * np.eye(k), (r + layer) * e_hat)

    top = np.linalg.norm(e_hat) / np.linalg.eigvalsh(0.5 * (W + W.T))[0]
    inside = layer == 0.0 and np.linalg.norm(e_hat) <= step
    r = 0.0 if inside else brentq(lambda r: np.linalg.norm(s_of(r)) - r, 1e-12 * top, 2 * top, xtol=1e-15 * top)
    e = np.zeros(k) if inside else np.linalg.solve(P, s_of(r))
    ν = -e_hat / h if inside else -injection.bound * (P @ e) / (r + layer)
    expected = np.linalg.solve(np.eye(nz) + h * G @ R, start + h * G @ y + h * into @ ν)
    np.testing.assert_allclose(step_of(injection, h, start, y), expected, atol=1e-9 * np.abs(expected).max())


def test_a_vanishing_layer_is_no_layer():
    rng = np.random.default_rng(5)
    injection, nz = problem(rng, 3, 1.0, 0.0)
    direction = rng.normal(size=3)
    for size in (0.3, 0.999, 1.001, 5.0):  # of h ρ
        y = 0.02 * injection.bound * size * direction / np.linalg.norm(direction)
        without = step_of(injection, 0.02, np.zeros(nz), y)
        gaps = [
            np.abs(step_of(replace(injection, layer=d), 0.02, np.zeros(nz), y) - without).max()
            for d in (1e-4, 1e-8, 1e-12)
        ]
        assert gaps[0] > gaps[1] >= gaps[2]
        assert gaps[2] < 1e-8  # r = O(sqrt(δ)) at the very edge |e_hat| = h ρ, O(δ) elsewhere


@pytest.mark.parametrize("layer", [0.0, 0.1])
def test_a_sample_at_rest_or_beyond_reason_leaves_numbers(layer):
    injection, nz = problem(np.random.default_rng(6), 3, 1.0, layer)
    np.testing.assert_array_equal(step_of(injection, 0.02, np.zeros(nz), np.zeros(3)), np.zeros(nz))
    for size in (1e-320, 1e-200, 1e30, 1e200):
        assert np.isfinite(step_of(injection, 0.02, np.zeros(nz), size * np.ones(3))).all()


def test_a_linear_part_that_is_not_symmetric_changes_nothing_while_it_slides():
    observer, _ = sliding(AIRCRAFT, [R_RATE])
    (injection,) = observer.injections
    skew = injection.into @ np.array([[0.0, 3.0, 0.0], [-1.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
    changed = replace(
        observer, A=observer.A - skew @ injection.reads, B=observer.B - skew @ injection.direct,
        injections=(replace(injection, linear=injection.linear + skew),),
    )  # fmt: skip
    t = np.arange(800) * H
    u, y, x = flight(AIRCRAFT, observer.F, wave(t), t, noise=1e-3)
    one, other = (Estimator.build(o, H, **INVERTING).replay(t, u, y, x=x[0]) for o in (observer, changed))
    np.testing.assert_allclose(one.state, other.state, atol=1e-12)  # noise of 1e-3 is inside h ρ = 1e-2


# ------------------------------------------------------------ missing samples


@pytest.mark.parametrize("gone", [P_RATE, Q_RATE, R_RATE])
@pytest.mark.parametrize("hold", ["left", "midpoint", "linear"])
def test_a_missing_sensor_drives_neither_the_state_nor_the_faults(gone, hold):
    """The same as a sensor that reads exactly what the observer expects: wrong start, noise, ν at its bound."""
    observer, _ = sliding(AIRCRAFT, [R_RATE], bound=0.05, weight=np.array([[2, 0.3, 0], [0.3, 1, 0.2], [0, 0.2, 1]]))
    t = np.arange(300) * H
    u, y, _ = flight(AIRCRAFT, observer.F, wave(t), t, noise=2e-3)
    start = [0.05, 0.05, 0.1, 0.05, 0.05]
    Ad, Bd = zoh(AIRCRAFT[0], AIRCRAFT[1], H)
    y[100:200, gone] = np.nan
    if hold != "left":
        u[:] = u[0]  # the input then is the same under every hold
    estimator = Estimator.build(observer, H, hold=hold, prediction=prediction(AIRCRAFT))
    trace = estimator.replay(t, u, y, x=start)
    told = y.copy()
    for k in range(100, 200):
        told[k, gone] = ((Ad @ trace.state[k - 1] + Bd @ u[k - 1])[2:] + observer.F @ trace.fault[k - 1])[gone]
    expected = estimator.replay(t, u, told, x=start)
    np.testing.assert_allclose(trace.state, expected.state, atol=1e-12)
    np.testing.assert_allclose(trace.fault, expected.fault, atol=1e-12)
    assert not trace.ok[100:200, gone].any()
    assert trace.ok[:100].all()


def test_while_a_healthy_sensor_is_missing_the_reconstruction_stays_exact():
    observer, _ = sliding(AIRCRAFT, [R_RATE])
    t = np.arange(1200) * H
    u, y, x = flight(AIRCRAFT, observer.F, wave(t), t)
    y[[0, *range(300, 700)], P_RATE] = np.nan
    trace = Estimator.build(observer, H, prediction=prediction(AIRCRAFT), **INVERTING).replay(t, u, y, x=x[0])
    assert np.abs(trace.fault - wave(t)).max() < 1e-12
    np.testing.assert_allclose(trace.corrected[300:700, P_RATE], x[300:700, 2], atol=1e-12)


def test_while_the_faulty_sensor_is_missing_its_fault_stays_where_it_was():
    observer, _ = sliding(AIRCRAFT, [R_RATE])
    t = np.arange(1200) * H
    u, y, x = flight(AIRCRAFT, observer.F, wave(t), t)
    y[300:700, R_RATE] = np.nan
    trace = Estimator.build(observer, H, prediction=prediction(AIRCRAFT), **INVERTING).replay(t, u, y, x=x[0])
    np.testing.assert_allclose(trace.fault[300:700, 0], trace.fault[299, 0], atol=1e-12)
    assert np.abs(trace.state - x).max() < 1e-12


@pytest.mark.parametrize("scheme", ["implicit", "explicit"])
@pytest.mark.parametrize("curved", [False, True])
def test_a_log_is_its_samples_one_by_one_to_the_last_bit(scheme, curved):
    observer, _ = sliding(AIRCRAFT, [Q_RATE], level=1.25, layer=0.01 * curved)
    if curved:
        observer = replace(observer, nonlinear=wing_rock(), copied=product_of_rates())
    rng = np.random.default_rng(8)
    t = np.cumsum(np.where(rng.random(300) < 0.1, 0.017, H))
    u, y, _ = flight(AIRCRAFT, observer.F, wave(t), t, noise=5e-3)
    y[np.repeat(rng.random((60, 3)) < 0.2, 5, axis=0)] = np.nan
    u[rng.random(u.shape) < 0.02] = np.nan
    estimator = Estimator.build(observer, H, scheme=scheme, prediction=prediction(AIRCRAFT))
    trace = estimator.replay(t, u, y)
    state, rows = estimates(estimator, t, u, y)
    for name in ("fault", "state", "corrected", "ok"):
        np.testing.assert_array_equal(getattr(trace, name), [getattr(row, name) for row in rows])
    np.testing.assert_array_equal(trace.end.z, state.z)


# ------------------------------------------------------------ together with other terms


def wing_rock():
    phi = Graph.trace(lambda x, u, t: x - x**3, {"x": 1, "u": 4, "t": 1})
    reads = np.zeros((1, 6))
    reads[0, 1] = 1.0
    into = np.zeros((6, 1))
    into[2] = 0.5
    return NonlinearTerm(into, reads, np.zeros(1), -np.ones(1), np.ones(1), phi)


def product_of_rates():
    g = Graph.trace(lambda y, u, t: y[0] * y[2], {"y": 3, "u": 4, "t": 1})
    into = np.zeros((6, 1))
    into[3] = 0.3
    return CopiedTerm(into, g)


def test_with_a_nonlinear_term_the_estimate_still_converges_with_order_one():
    """The fault-free aircraft with a nonlinear roll, from a wrong start; against steps sixteen times finer."""
    observer, _ = sliding(AIRCRAFT, [R_RATE], layer=0.05)
    observer = replace(observer, nonlinear=wing_rock(), copied=product_of_rates())

    def end(h):
        t = np.arange(round(2 / h) + 1) * h
        y = np.column_stack([0.2 * np.sin(3 * t), 0.1 * np.cos(t), 0.1 * np.sin(2 * t)])
        u = np.column_stack([0.05 * np.sin(t)] * 4)
        return Estimator.build(observer, h, layer=0.05).replay(t, u, y, x=np.full(5, 0.1)).state[-1]

    fine = end(H / 32)
    coarse, half = (np.linalg.norm(end(h) - fine) for h in (2 * H, H))
    # against 1/32 the ratio of order one is (2 - 1/32)/(1 - 1/32) = 2.03; the next term adds h times 10/s
    assert coarse / half == pytest.approx(2.03, rel=0.15)


def test_a_second_injection_reads_what_the_first_has_moved():
    observer, _ = sliding(AIRCRAFT, [R_RATE], bound=0.5)
    (one,) = observer.injections
    quiet = replace(one, linear=0 * one.linear, bound=3.0)
    y = np.array([0.004, 0.0, 0.003])
    for first, second in ((one, quiet), (quiet, one)):
        linear = first.linear + second.linear
        both = replace(
            observer, A=observer.A + (one.linear - linear) @ one.reads, injections=(first, second)
        )  # fmt: skip
        alone, two = (
            estimates(Estimator.build(o, H), [0.0, H], np.zeros((2, 4)), [0 * y, y])[0].z
            for o in (replace(both, A=observer.A + (one.linear - first.linear) @ one.reads,
                              B=observer.B + (one.linear - first.linear) @ one.direct, injections=(first,)), both)
        )  # fmt: skip
        # |eh| = 5e-3 = h 0.5: whichever comes first has it all, so nothing is left for the second
        np.testing.assert_allclose(two, alone, atol=1e-15)


# ------------------------------------------------------------ options and refusals


def test_bound_and_layer_can_be_set_and_travel_with_the_estimator():
    observer, _ = sliding(TWO_MASS, [1])
    estimator = Estimator.build(observer, H, bound=0.2, layer=[0.05])
    (one,) = estimator.observer.injections
    assert (one.bound, one.layer, estimator.scheme) == (0.2, 0.05, "implicit")
    assert (observer.injections[0].bound, observer.injections[0].layer) == (1.0, 0.0)
    t = np.arange(50) * H
    y = np.column_stack([np.sin(t), np.cos(t)])
    again = pickle.loads(pickle.dumps(estimator))
    assert again.observer.injections[0].bound == 0.2
    np.testing.assert_array_equal(
        again.replay(t, 0 * t, y).state, Estimator.build(observer, H, bound=0.2, layer=0.05).replay(t, 0 * t, y).state
    )


@pytest.mark.parametrize(
    "options",
    [{"bound": 0.0}, {"bound": -1}, {"bound": np.inf}, {"bound": np.nan}, {"bound": "much"}, {"bound": [1.0, 2.0]},
     {"layer": -1e-3}, {"layer": np.inf}, {"scheme": "zoh"}, {"scheme": "rk4"}, {"scheme": "euler"}],
)  # fmt: skip
def test_what_cannot_be_stepped_is_refused(options):
    with pytest.raises(InputError):
        Estimator.build(sliding(TWO_MASS, [1])[0], H, **options)


@pytest.mark.parametrize("options", [{"scheme": "implicit"}, {"scheme": "explicit"}, {"bound": 1.0}, {"layer": 0.0}])
def test_an_observer_without_injections_takes_none_of_their_options(options):
    with pytest.raises(InputError):
        Estimator.build(replace(sliding(TWO_MASS, [1])[0], injections=()), H, **options)


@pytest.mark.parametrize(
    "change",
    [{"weight": np.array([[1.0, 2.0], [2.0, 1.0]])}, {"weight": np.array([[1.0, 0.5], [0.0, 1.0]])},
     {"weight": np.eye(3)}, {"bound": 0.0}, {"layer": -1.0}, {"into": np.zeros((5, 2))}, {"reads": np.zeros((2, 4))},
     {"linear": np.full((5, 2), np.nan)}],
)  # fmt: skip
def test_an_injection_that_makes_no_sense_is_refused(change):
    observer, _ = sliding(TWO_MASS, [1])
    with pytest.raises(InputError):
        Estimator.build(replace(observer, injections=(replace(observer.injections[0], **change),)), H)


def test_a_linear_injection_that_drives_the_error_away_is_refused_where_steps_are_too_long_for_it():
    observer, _ = sliding(TWO_MASS, [1])
    (one,) = observer.injections
    away = replace(one, linear=-30.0 * one.into)
    changed = replace(observer, injections=(away,))
    with pytest.raises(InputError, match="30"):
        Estimator.build(changed, 0.02)
    # Longer gaps than that are fine: it acts for no longer than it may.
    estimator = Estimator.build(changed, H)
    state, _ = estimator.step(estimator.init(), 0.0, [0.0], [0.0, 0.0])
    assert np.isfinite(estimator.step(state, 1 / 30, [0.0], [0.1, 0.1])[1].state).all()


def test_weights_of_many_decades_take_more_rounds_and_equal_ones_take_one():
    assert injecting.rounds(np.ones(1)) == 1
    assert injecting.rounds(np.ones(4) + 1e-15 * np.arange(4)) == 1
    assert injecting.rounds(np.array([1.0, 1.001])) == 5
    assert injecting.rounds(np.array([1.0, 1e3])) == 9
    assert injecting.rounds(np.array([1e-20, 1.0])) == injecting.MOST
