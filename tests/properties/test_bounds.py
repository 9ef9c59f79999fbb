# SPDX-License-Identifier: BSD-3-Clause
"""The promise of a bound: as long as its assumptions hold, no sample of any reconstructed fault lies outside it."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are, solve_discrete_are

from faultrecon.graph.function import Graph
from faultrecon.graph.observer import NonlinearTerm, Observer
from faultrecon.numerics.discretise import foh, zoh
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import Lipschitz
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.runtime.bounds import Allowance, bounds
from faultrecon.runtime.errors import error_system
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.runtime.watch import Batch, Findings, Watch, filters

ROUNDING = 1e-9  # relative: sums of some thousand terms in double precision
SD = 0.01


def channels(letter, count, reach=None):
    names = tuple(f"{letter}{i}" for i in range(count))
    return Channels(names, ranges=() if reach is None else (reach,) * count)


def random_plant(rng, *, sampled=False, noisy=True):
    """n to 6, unstable now and then; faults on some sensors and perhaps on an input; w on states and on sensors."""
    n, p, m = int(rng.integers(1, 7)), int(rng.integers(2, 5)), 1
    A = rng.normal(size=(n, n)) / math.sqrt(n) - rng.uniform(0.2, 1.5) * np.eye(n)
    B, C = rng.normal(size=(n, m)), rng.normal(size=(p, n))
    x, y, u = channels("x", n, 5.0), channels("y", p), channels("u", m, 1.0)
    faults = [FaultChannel("s0", {"y0": 1.0}, size=3.0, rate=0.5)]
    faults += [FaultChannel("a", {"u0": 1.0}, "actuator", size=3.0, rate=0.3)] if rng.random() < 0.5 and p > 2 else []
    into = dict(zip(x.names, rng.normal(size=n), strict=True))
    w = [Disturbance("w0", into, size=0.2), Disturbance("w1", {}, {"y0": 0.5, "y1": 0.5}, size=0.1)]
    w += [Disturbance("both", {"x0": 1.0}, {y.names[-1]: 1.0}, size=0.1)] if rng.random() < 0.5 else []
    noise = Noise(0.05, (SD,) * p) if noisy else None
    own = None
    if sampled:
        own, A, B = 0.1, zoh(A, B, 0.1)[0], zoh(A, B, 0.1)[1]
    return Plant("random", Signals(x, u, y), A, B, C, rng.normal(size=(p, m)), tuple(faults), tuple(w), noise=noise,
                 sample_time=own)  # fmt: skip


def integrating(plant, speed=30.0):
    """A Kalman filter for states and constant faults."""
    n, q, p, m = plant.n, len(plant.faults), plant.p, plant.B.shape[1]
    one = plant.sample_time is not None
    A = np.block([[plant.A, plant.E_f], [np.zeros((q, n)), np.eye(q) if one else np.zeros((q, q))]])
    C = np.hstack([plant.C, plant.F_f])
    Q = np.diag([1.0] * n + [speed] * q)
    P = (solve_discrete_are if one else solve_continuous_are)(A.T, C.T, Q, np.eye(p))
    L = A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + np.eye(p)) if one else P @ C.T
    B = np.vstack([plant.B, np.zeros((q, m))])
    return Observer(
        A - L @ C, np.hstack([B - L @ plant.D, L]), np.eye(n, n + q), np.zeros((n, m + p)), np.eye(q, n + q, n),
        np.zeros((q, m + p)), plant.F_f, np.zeros(n), np.zeros(m), np.zeros(p), sample_time=plant.sample_time,
    )  # fmt: skip


def looking(plant):
    """A Luenberger observer on the other sensors; the fault of sensor 0 is what that sensor shows beyond it."""
    n, p, m = plant.n, plant.p, plant.B.shape[1]
    C = plant.C * np.arange(p)[:, None].astype(bool)
    solve = solve_continuous_are if plant.sample_time is None else solve_discrete_are
    P = solve(plant.A.T, C.T, np.eye(n), np.eye(p))
    L = P @ C.T if plant.sample_time is None else plant.A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + np.eye(p))
    L[:, 0] = 0.0
    F = plant.F_f
    return Observer(
        plant.A - L @ C, np.hstack([plant.B - L @ plant.D, L]), np.eye(n), np.zeros((n, m + p)), -F.T @ plant.C,
        np.hstack([-F.T @ plant.D, F.T]), F, np.zeros(n), np.zeros(m), np.zeros(p), sample_time=plant.sample_time,
    )  # fmt: skip


def estimator_of(plant, observer, T, hold):
    return Estimator.build(observer, T, hold=hold, engine="casadi", prediction=Prediction(plant.C, plant.D))


@dataclass(frozen=True)
class Flight:
    """t, u, y, f: what the estimator gets and what it should find; x: the states."""

    t: np.ndarray
    u: np.ndarray
    y: np.ndarray
    f: np.ndarray
    x: np.ndarray


def zigzag(rng, shape, step):
    """Within ±1, by `step` from row to row, up or down for a while."""
    walk = np.cumsum(step * np.sign(rng.normal(size=shape) + 0.5 * np.sin(np.arange(shape[0]) / 40.0)[:, None]), axis=0)
    return np.abs((walk + 1.0) % 4.0 - 2.0) - 1.0


def switching(rng, shape):
    """Within ±1: at one end or the other for seven rows, and anywhere in between now and then."""
    ends = np.repeat(np.sign(rng.normal(size=(shape[0] // 7 + 1, *shape[1:]))), 7, axis=0)[: shape[0]]
    return np.where(rng.random(shape) < 0.7, ends, rng.uniform(-1.0, 1.0, shape))


def kept_small(plant):
    """K of u = -K x + something, so that an unstable plant stays within bounds."""
    n, m = plant.B.shape
    if plant.sample_time is None:
        return plant.B.T @ solve_continuous_are(plant.A, plant.B, np.eye(n), np.eye(m))
    P = solve_discrete_are(plant.A, plant.B, np.eye(n), np.eye(m))
    return np.linalg.solve(np.eye(m) + plant.B.T @ P @ plant.B, plant.B.T @ P @ plant.A)


def motion(plant, T, hold):
    """(Φ, W, F0, F1, U0, U1, w onto y): x⁺ = Φ x + W w + F0 f + F1 f⁺ + U0 u + U1 u⁺, exactly."""
    E, on = np.zeros((plant.n, len(plant.disturbances))), np.zeros((plant.p, len(plant.disturbances)))
    for i, d in enumerate(plant.disturbances):
        E[:, i] = [d.into.get(name, 0.0) for name in plant.signals.x]
        on[:, i] = [d.on.get(name, 0.0) for name in plant.signals.y]
    if plant.sample_time is not None:
        return plant.A, E, plant.E_f, 0.0 * plant.E_f, plant.B, 0.0 * plant.B, on
    Phi, W = zoh(plant.A, E, T)
    _, F0, F1 = foh(plant.A, plant.E_f, T)
    _, U0, U1 = foh(plant.A, plant.B, T)
    if hold != "linear":
        _, held = zoh(plant.A, plant.B, T)
        U0, U1 = (held, 0.0 * held) if hold == "left" else (0.5 * held, 0.5 * held)
    return Phi, W, F0, F1, U0, U1, on


def fly(plant, T, hold, rng, rows, runs, *, late=False, faulty=True, noise_peak=3.0, gaussian=False, crest=1.0):
    """`runs` flights at once.  late: what disturbs between two samples shows in the sensors at the later one."""
    n, p = plant.n, plant.p
    Phi, W, F0, F1, U0, U1, on = motion(plant, T, hold)
    K = kept_small(plant)
    w = switching(rng, (rows, runs, W.shape[1])) * [crest * d.size for d in plant.disturbances]
    sizes, rates = ([getattr(d, name) for d in plant.faults] for name in ("size", "rate"))
    steps = [T * rate / size for rate, size in zip(rates, sizes, strict=True)]
    f = np.stack([size * zigzag(rng, (rows, runs), step) for size, step in zip(sizes, steps, strict=True)], axis=2)
    f = f * faulty
    wanted = np.sin(np.arange(rows)[:, None, None] * T * rng.uniform(0.2, 3.0, (1, runs, 1)))
    x, u = np.empty((rows, runs, n)), np.empty((rows, runs, plant.B.shape[1]))
    x[0] = rng.uniform(-1.0, 1.0, (runs, n))
    u[0] = wanted[0] - x[0] @ K.T
    closed = np.linalg.inv(np.eye(n) + U1 @ K).T  # u⁺ reads x⁺
    for k in range(rows - 1):
        free = x[k] @ Phi.T + w[k + late] @ W.T + f[k] @ F0.T + f[k + 1] @ F1.T + u[k] @ U0.T + wanted[k + 1] @ U1.T
        x[k + 1] = free @ closed
        u[k + 1] = wanted[k + 1] - x[k + 1] @ K.T
    v = rng.normal(size=(rows, runs, p)) if gaussian else noise_peak * switching(rng, (rows, runs, p))
    sd = np.zeros(p) if plant.noise is None else np.array(plant.noise.sd)
    y = x @ plant.C.T + u @ plant.D.T + f @ plant.F_f.T + w @ on.T + v * sd
    t = np.arange(rows) * T
    return [Flight(t, u[:, r], y[:, r], f[:, r], x[:, r]) for r in range(runs)]


def with_ranges(plant, flights):
    """The plant, declaring the ranges of states and inputs that these flights stay within."""
    reach = {group: max(np.abs(getattr(one, group)).max() for one in flights) for group in ("x", "u")}
    reach = {group: max(size, 1e-9) for group, size in reach.items()}
    x, u = channels("x", plant.n, float(reach["x"])), channels("u", plant.B.shape[1], float(reach["u"]))
    return replace(plant, signals=replace(plant.signals, x=x, u=u))


def watch_of(plant, estimator, allowance, spans=(10.0, 100.0)):
    poles = filters(estimator.sample_time, [span * estimator.sample_time for span in spans])
    system = error_system(plant, estimator)
    return Watch(plant, estimator, bounds(plant, estimator, system, allowance, poles), poles)


def looked(watch, flight):
    """Estimates, what the watch says about them, and the shares of all its tests where one fails (N, scales, q + p)."""
    guess = watch.bounds.beginning.guess(flight.u[0], flight.y[0])
    trace = watch.estimator.replay(flight.t, flight.u, flight.y, x=guess)
    waits = np.diff(flight.t, prepend=flight.t[0] - watch.estimator.sample_time) / watch.estimator.sample_time
    seen, _ = Findings.room(len(flight.t), [watch])
    watch.look(watch.init(blind=guess is None), Batch.of(flight.u, flight.y, waits), trace, seen)
    shares = np.where(seen.peak > 1.0, seen.shares, 0.0)
    return trace, seen, shares.reshape(len(flight.t), len(watch.poles), -1)


def outside(watch, flight):
    """How many estimates lie outside their bounds, of how many; and the worst share of a test that says nothing wrong.

    While a fault acts, the tests of the estimate itself say that it does.
    """
    trace, seen, shares = looked(watch, flight)
    error = np.abs(trace.fault - flight.f)
    told = np.isfinite(error)
    q = watch.bounds.faults
    healthy = shares[:, :, q:] if flight.f.any() else shares
    return int(np.sum(error[told] > (1.0 + ROUNDING) * seen.bound[told])), int(told.sum()), healthy.max()


def cases(seed, count):
    """Random plants with an observer, sampled in every way."""
    rng = np.random.default_rng(seed)
    for case in range(count):
        plant = random_plant(rng, sampled=case % 5 == 4)
        T = plant.sample_time or float(rng.choice([0.02, 0.1]))
        hold = ("left", "midpoint", "linear")[case % 3]
        make = looking if case % 2 else integrating
        try:
            estimator = estimator_of(plant, make(plant), T, hold)
        except np.linalg.LinAlgError:  # nothing can be reconstructed there
            continue
        yield case, plant, estimator, rng


def test_no_sample_of_a_million_lies_outside_its_bound():
    counted, wrong, worst, unstable = 0, 0, 0.0, 0
    for case, plant, estimator, rng in cases(1, 46):
        late = case % 4 < 2 and plant.sample_time is None
        flights = fly(plant, estimator.sample_time, estimator.hold, rng, 3000, 8, late=late, faulty=case % 7 != 6)
        watch = watch_of(with_ranges(plant, flights), estimator, Allowance(noise_peak=3.0, noise="bounded"))
        grows = np.linalg.eigvals(plant.A).real.max() > 0 if plant.sample_time is None else False
        unstable += bool(grows)
        for flight in flights:
            off, rows, share = outside(watch, flight)
            counted, wrong, worst = counted + rows, wrong + off, max(worst, share)
    assert counted >= 1_000_000
    assert unstable >= 5
    assert wrong == 0
    assert worst <= 1.0 + ROUNDING


@pytest.mark.parametrize("pattern", ["now and then", "long", "every second row", "whole rows", "at first"])
def test_no_sample_lies_outside_while_sensors_are_silent(pattern):
    for _, plant, estimator, rng in cases(2, 24):
        flights = fly(plant, estimator.sample_time, estimator.hold, rng, 1500, 3)
        watch = watch_of(with_ranges(plant, flights), estimator, Allowance(noise_peak=3.0, noise="bounded"))
        for flight in flights:
            y = flight.y.copy()
            if pattern == "now and then":
                y[rng.random(y.shape) < 0.02] = math.nan
            elif pattern == "long":
                y[300:340, 0] = y[700:1000, 1] = math.nan
            elif pattern == "every second row":
                y[::2, 1] = math.nan
            elif pattern == "whole rows":
                y[rng.random(len(y)) < 0.05] = math.nan
            else:
                y[0] = math.nan
            off, _, share = outside(watch, replace(flight, y=y))
            assert off == 0
            assert share <= 1.0 + ROUNDING


def one_disturbance(name):
    """A plant with a constant fault and just one thing that disturbs: a force, a sensor, both at once, or noise."""
    signals = Signals(channels("x", 2, 1.0), channels("u", 1, 1.0), channels("y", 2))
    A, B, C = np.array([[0.0, 1.0], [-2.0, -0.6]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0], [1.0, 1.0]])
    w = {
        "force": (Disturbance("w", {"x1": 1.0}, size=0.3),),
        "sensor": (Disturbance("w", {}, {"y1": 1.0}, size=0.3),),
        "both": (Disturbance("w", {"x1": 1.0}, {"y1": 0.5}, size=0.3),),
        "noise": (),
    }[name]
    noise = Noise(0.05, (0.0, 0.1)) if name == "noise" else None
    faults = (FaultChannel("f", {"y0": 1.0}, rate=1e-12),)
    return Plant(name, signals, A, B, C, np.zeros((2, 1)), faults, w, noise=noise)


def worst_reached(plant, estimator, size, late):
    """The largest error at the last row, by the worst signs of the one thing that disturbs."""
    T, rows = estimator.sample_time, 900
    Phi, W, *_, on = motion(plant, T, estimator.hold)

    def errors(d):
        x, y = np.zeros(2), np.zeros((rows, 2))
        for k in range(rows):
            if not plant.disturbances:
                y[k, 1] = d[k]
                continue
            x = Phi @ x + W[:, 0] * (d[k] if late else d[k - 1] if k else 0.0)
            y[k] = plant.C @ x + on[:, 0] * d[k]
        return estimator.replay(np.arange(rows) * T, np.zeros((rows, 1)), y).fault[:, 0]

    response = errors(np.eye(1, rows, 1)[0])[1:]  # from the second row on: the first is where it begins
    return abs(errors(size * np.append(0.0, np.sign(response[::-1])))[-1])


@pytest.mark.parametrize("name", ["force", "sensor", "both", "noise"])
@pytest.mark.parametrize("make", [integrating, looking])
def test_the_worst_signs_of_one_disturbance_nearly_reach_the_bound(name, make):
    plant = one_disturbance(name)
    estimator = estimator_of(plant, make(plant), 0.04, "linear")  # lines between samples cost next to nothing then
    bound = watch_of(plant, estimator, Allowance(noise_peak=3.0, noise="bounded")).bounds.fault[0]
    reached = max(worst_reached(plant, estimator, 0.3, late) for late in (True, False))
    assert 0.8 * bound <= reached <= (1.0 + ROUNDING) * bound


@pytest.mark.parametrize("peak", [1.0, 2.0])
def test_gaussian_noise_lies_outside_no_more_often_than_is_said(peak):
    """Over separate flights of noise alone, each of them one draw: their mean is known to four deviations."""
    plant = one_disturbance("noise")
    A, B = zoh(plant.A, plant.B, 0.1)
    plant = replace(plant, A=A, B=B, sample_time=0.1, noise=Noise(0.1, (0.02, 0.1)))
    estimator, rng = estimator_of(plant, integrating(plant), 0.1, "linear"), np.random.default_rng(4)
    limit = watch_of(plant, estimator, Allowance(noise_peak=peak)).bounds.fault[0]
    rates = []
    for flight in fly(plant, 0.1, "linear", rng, 2500, 200, gaussian=True, faulty=False):
        trace = estimator.replay(flight.t, flight.u, flight.y)
        rates.append(np.mean(np.abs(trace.fault[500:, 0]) > limit))  # the start has died out
    odds = math.erfc(peak / math.sqrt(2.0))
    assert np.mean(rates) <= odds + 4.0 * np.std(rates) / math.sqrt(len(rates))
    assert np.mean(rates) >= 0.5 * odds  # and what is said is not said for want of looking


def pendulum(constant=0.5):
    """x1'' = -2 x1 - 0.9 x1' + 0.5 sin(x1) + w, two sensors, the fault on the first."""
    import casadi as ca

    phi = Graph.trace(lambda x, u, t: constant * ca.sin(x), {"x": 1, "u": 1, "t": 1})
    phi = replace(phi, inputs={"x": ("x0",), "u": ("u0",), "t": ("t",)})
    term = Lipschitz(np.array([[0.0], [1.0]]), ("x0",), phi, constant)
    plant = replace(one_disturbance("force"), A=np.array([[0.0, 1.0], [-2.0, -0.9]]), nonlinearity=term)
    return replace(plant, faults=(FaultChannel("f", {"y0": 1.0}, size=3.0, rate=0.5),), noise=Noise(0.05, (SD, SD)))


def swing(plant, T, rng, rows, fine=20):
    """The pendulum by Runge-Kutta in steps of T/20; noise within three deviations."""
    A, k = plant.A, plant.nonlinearity.constant
    w = 0.3 * switching(rng, (rows, 1))[:, 0]
    x = np.zeros((rows, 2))
    x[0] = rng.uniform(-1.0, 1.0, 2)

    def slope(z, force):
        return A @ z + np.array([0.0, k * math.sin(z[0]) + force])

    for j in range(rows - 1):
        z, h = x[j], T / fine
        for _ in range(fine):
            k1 = slope(z, w[j])
            k2 = slope(z + h / 2 * k1, w[j])
            k3 = slope(z + h / 2 * k2, w[j])
            z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(z + h * k3, w[j]))
        x[j + 1] = z
    f = 3.0 * zigzag(rng, (rows, 1), T * 0.5 / 3.0)
    y = x @ plant.C.T + f @ plant.F_f.T + 3.0 * switching(rng, (rows, 2)) * np.array(plant.noise.sd)
    return Flight(np.arange(rows) * T, np.zeros((rows, 1)), y, f, x)


@pytest.mark.parametrize("hold", ["left", "linear"])
@pytest.mark.parametrize("T", [0.02, 0.1])
def test_no_sample_of_a_nonlinear_plant_lies_outside(hold, T):
    plant, rng = pendulum(), np.random.default_rng(8)
    plain = looking(plant)
    term = plant.nonlinearity
    observer = replace(plain, nonlinear=NonlinearTerm(term.into, np.eye(1, 2), np.zeros(1), *term.limits, term.phi))
    estimator = estimator_of(plant, observer, T, hold)
    flights = [swing(plant, T, rng, 900) for _ in range(3)]
    watch = watch_of(with_ranges(plant, flights), estimator, Allowance(noise_peak=3.0, noise="bounded"))
    assert np.isfinite(watch.bounds.fault).all()
    for flight in flights:
        flight.y[400:420, 0] = math.nan
        off, _, share = outside(watch, flight)
        assert off == 0
        assert share <= 1.0 + ROUNDING


# ---------------------------------------------------------------- what is said when an assumption does not hold


def test_a_disturbance_of_ten_times_its_size_breaks_the_bound():
    plant, rng = one_disturbance("force"), np.random.default_rng(2)
    estimator = estimator_of(plant, looking(plant), 0.1, "linear")
    wild = fly(plant, 0.1, "linear", rng, 3000, 1, crest=10.0)[0]
    watch = watch_of(with_ranges(plant, [wild]), estimator, Allowance())
    off, rows, share = outside(watch, wild)
    assert off > rows / 10
    assert share > 1.0
    assert "every disturbance stays within its declared size" in watch.bounds.assumptions[0]


def test_without_a_rate_an_observer_that_follows_slowly_promises_nothing_and_says_why():
    plant = replace(one_disturbance("force"), faults=(FaultChannel("f", {"y0": 1.0}),))
    limits = watch_of(plant, estimator_of(plant, integrating(plant), 0.1, "linear"), Allowance()).bounds
    assert np.isinf(limits.fault[0])
    assert "no rate is declared for f: without one nothing bounds its error" in limits.assumptions


def test_without_a_rate_an_observer_that_looks_at_the_sensor_needs_none():
    plant = replace(one_disturbance("force"), faults=(FaultChannel("f", {"y0": 1.0}),))
    limits = watch_of(plant, estimator_of(plant, looking(plant), 0.1, "linear"), Allowance()).bounds
    assert np.isfinite(limits.fault[0])
    assert not [said for said in limits.assumptions if "rate" in said]


def test_states_without_a_range_are_named_and_begin_far_away():
    plant = one_disturbance("force")
    bare = replace(plant, signals=replace(plant.signals, x=channels("x", 2)))
    limits = [watch_of(p, estimator_of(p, looking(p), 0.1, "linear"), Allowance()).bounds for p in (plant, bare)]
    assert np.all(limits[1].start.sum(axis=0)[:1] > limits[0].start.sum(axis=0)[:1])
    assert np.isfinite(limits[1].start).all()
    assert any(said.startswith("x0, x1 begin within") for said in limits[1].assumptions)


def test_noise_under_the_name_of_a_disturbance_is_counted_once():
    plant = replace(one_disturbance("sensor"), noise=Noise(0.05, (0.0, 0.1)))
    bare = replace(plant, disturbances=())
    found = [watch_of(p, estimator_of(p, looking(p), 0.1, "linear"), Allowance()).bounds.fault for p in (plant, bare)]
    np.testing.assert_array_equal(*found)


def test_a_disturbance_declared_as_noise_is_random():
    plant = one_disturbance("force")
    loud = replace(plant, disturbances=(*plant.disturbances, Disturbance("gusts", {"x0": 1.0}, role="noise", size=0.2)))
    limits = [watch_of(p, estimator_of(p, looking(p), 0.1, "linear"), Allowance()).bounds for p in (plant, loud)]
    np.testing.assert_allclose(limits[1].certain, limits[0].certain)
    assert limits[1].random[0, 0] > limits[0].random[0, 0]
