# SPDX-License-Identifier: BSD-3-Clause
"""The pitch loop that keeps the unstable airframe flying, what corrects its sensor, and the linear analysis of both.

The loop reads the pitch rate and nothing else: elevator = kp (q - command) + ki (its integral).  Without the integral
no gain stabilises the aircraft: pitch rate over elevator has a zero at s = 0 (q is the derivative of pitch), so the
constant term of the characteristic polynomial keeps the sign that the one unstable pole gives it.

A corrector is a callable (t, u, y) -> y, called once per sample with what the sensors show; the loop uses its answer.
"""

import numpy as np
from scipy.linalg import eigvals, expm
from scipy.signal import place_poles

KP, KI = 0.5, 0.5  # rad of elevator per rad/s and per rad
YAW_DAMPER = 0.3  # rad of rudder per rad/s
LAG, RATE, TRAVEL = 1 / 20.2, np.deg2rad(60), np.deg2rad(25)  # s, rad/s, rad: F-16 actuators, Stevens and Lewis
LONGITUDINAL = [0, 1, 4, 7]  # V, alpha, q, theta among the states
FAST = 20.0  # 1/s, the estimator's pole that smooths measurement noise


def corrector_none():
    """The faulty sensor goes into the loop as it is."""
    return lambda t, u, y: y


def corrector_oracle(fault, sensor):
    """Takes the true fault out: fault is a function of time.  What perfect knowledge would do."""

    def correct(t, u, y):
        y = y.copy()
        y[sensor] -= fault(t)
        return y

    return correct


def corrector_linear(A, B, x0, u0, step, *, speed=1.0, sensor=1):
    """A linear observer of (V, alpha, q, theta, f) that sees the elevator, the core speed and the faulty sensor only.

    speed: how fast it forgets what the unstable mode did, in units of that mode; see `observer_gain`.
    """
    E, L, inputs = _observer(A, B, speed)
    big = np.zeros((8, 8))
    big[:5, :5], big[:5, 5:7], big[:5, 7:] = E, inputs, L
    Phi = expm(big * step)[:5]  # exact for inputs held from sample to sample; their mean stands for the straight line
    z, last = np.zeros(5), None

    def correct(t, u, y):
        nonlocal z, last
        now = np.array([*(u - u0)[:2], y[sensor]])
        if last is not None:
            z = Phi @ np.concatenate([z, (now + last) / 2])
        last = now
        y = y.copy()
        y[sensor] -= z[4]
        return y

    return correct


def corrector_design(design, step, x0):
    """The estimator of a design of faultrecon, one sample at a time."""
    estimator = design.estimator(sample_time=step)
    memory = estimator.init(x=x0)

    def correct(t, u, y):
        nonlocal memory
        memory, estimate = estimator.step(memory, t, u, y)
        return np.array(estimate.corrected)

    return correct


def observer_gain(A, speed):
    """Gain (5, 1) of the observer of (V, alpha, q, theta, f) from the pitch rate, by pole placement.

    The stable modes of the airframe stay where they are (no healthy sensor sees them, so moving them buys nothing);
    the unstable mode lam is answered by a pole at -speed lam, and the last pole is at -FAST.  Then f -> f_hat is
    F(s) = -(speed FAST)(s - lam)/((s + speed lam)(s + FAST)): F(lam) = 0 as it must, F(0) = 1.
    """
    M = A[np.ix_(LONGITUDINAL, LONGITUDINAL)]
    lam, stable = max(eigvals(M).real), [s for s in eigvals(M) if s.real < 0]
    Aa, Ca = np.zeros((5, 5)), np.array([[0.0, 0, 1, 0, 1]])
    Aa[:4, :4] = M
    return place_poles(Aa.T, Ca.T, [*stable, -speed * lam, -FAST], rtol=1e-9, maxiter=100).gain_matrix.T


def _observer(A, B, speed):
    """Error dynamics E (5, 5), gain L (5, 1) and inputs (5, 2) from core speed and elevator."""
    L = observer_gain(A, speed)
    E = np.zeros((5, 5))
    E[:4, :4] = A[np.ix_(LONGITUDINAL, LONGITUDINAL)]
    inputs = np.vstack([B[LONGITUDINAL][:, :2], np.zeros((1, 2))])
    return E - L @ np.array([[0.0, 0, 1, 0, 1]]), L, inputs


def closed_loop(A, B, speed=None, *, truth=None, gain=1.0, kp=KP, ki=KI):
    """The linear loop with its actuator, integrator and, where speed is given, observer and correction.

    States: V, alpha, q, theta; elevator; integral; estimator's five.  truth: another (A, B) that flies while
    observer and loop know these; gain: of the pitch-rate sensor.
    """
    At, Bt = truth or (A, B)
    n = 6 if speed is None else 11
    M, qc = np.zeros((n, n)), np.zeros(n)
    M[:4, :4], M[:4, 4] = At[np.ix_(LONGITUDINAL, LONGITUDINAL)], Bt[LONGITUDINAL, 1]
    qc[2] = gain
    if speed is not None:
        E, L, inputs = _observer(A, B, speed)
        M[6:, 6:], M[6:, 2], M[6:, 4] = E, gain * L[:, 0], inputs[:, 1]
        qc[10] = -1.0
    M[4] = kp / LAG * qc
    M[4, 4] -= 1 / LAG
    M[4, 5] += ki / LAG
    M[5] = qc
    return M


def slowest(M):
    """Largest real part of the eigenvalues but for the one nearest 0, and that one.

    It is zero by structure: the integral of the pitch rate and the pitch angle may differ by a constant for ever.
    """
    s = eigvals(M)
    nearest = np.argmin(abs(s))
    return float(np.delete(s, nearest).real.max()), float(abs(s[nearest]))


def at_the_sensor(A, B, speed=None, **gains):
    """Peak sensitivity at the pitch-rate sensor, its frequency (rad/s), and the compensator's rightmost pole."""
    M1, M0 = closed_loop(A, B, speed, **gains), closed_loop(A, B, speed, gain=0.0, **gains)
    b, n = M1[:, 2] - M0[:, 2], len(M0)
    w = np.logspace(-2.5, 2.3, 800)
    S = abs(1 / (1 - np.array([np.linalg.solve(1j * x * np.eye(n) - M0, b)[2] for x in w])))
    inner = np.delete(np.delete(M0, range(4), 0), range(4), 1)
    return float(S.max()), float(w[S.argmax()]), float(max(eigvals(inner).real))


def gain_limits(A, B, speed=None, **gains):
    """Between which gains of the sensor the loop stays stable, to 0.01, up to 3."""
    grid = np.arange(1, 301) / 100
    fine = np.array([slowest(closed_loop(A, B, speed, gain=g, **gains))[0] < 1e-6 for g in grid])
    low = 0 if fine[:99].all() else np.flatnonzero(~fine[:99])[-1] + 1
    high = 299 if fine[99:].all() else 99 + np.flatnonzero(~fine[99:])[0] - 1
    return float(grid[low]), float(grid[high])


def survivors(A, B, speed=None, *, spread=0.2, tries=300, **gains):
    """Share of random aircraft, each derivative off by up to `spread`, that the loop made for (A, B) holds stable."""
    rng, held = np.random.default_rng(0), 0
    for _ in range(tries):
        At, Bt = (M * (1 + spread * rng.uniform(-1, 1, M.shape)) for M in (A, B))
        At[7] = A[7]  # kinematics
        held += slowest(closed_loop(A, B, speed, truth=(At, Bt), **gains))[0] < 1e-6
    return held / tries
