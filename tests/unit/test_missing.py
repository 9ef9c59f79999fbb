# SPDX-License-Identifier: BSD-3-Clause
"""What a gap does to an estimator is what is said of it: no more, and where signals conspire no less."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are, solve_discrete_are

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.graph.observer import NonlinearTerm, Observer
from faultrecon.numerics.discretise import foh, zoh
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import Lipschitz
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.runtime.absent import Sizes, absences
from faultrecon.runtime.bounds import Allowance, bounds
from faultrecon.runtime.errors import error_system
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.runtime.missing import gaps, inputs_missing
from faultrecon.runtime.samples import State

ROUNDING = 1e-9  # relative: sums of some hundred terms in double precision
T, SD, PEAK, REACH = 0.05, 0.01, 3.0, 1.0
HOLDS = st.sampled_from(["left", "midpoint", "linear"])
few = settings(max_examples=12, deadline=None)  # each builds kernels


def named(letter, count):
    return tuple(f"{letter}{i}" for i in range(count))


def random_plant(rng, *, both=True, sampled=False):
    """Stable, n to 4, one input, three sensors; w on states, on sensors, and perhaps on both."""
    n, p = int(rng.integers(1, 5)), 3
    A = rng.normal(size=(n, n)) / math.sqrt(n)
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.3, 1.5)) * np.eye(n)
    B, C, D = rng.normal(size=(n, 1)), rng.normal(size=(p, n)), rng.normal(size=(p, 1))
    w = [Disturbance("w0", dict(zip(named("x", n), rng.normal(size=n), strict=True)), size=0.2)]
    w += [Disturbance("w1", {}, {"y0": 0.5, "y1": 0.5}, size=0.1)]
    w += [Disturbance("both", {"x0": 1.0}, {"y2": float(rng.normal())}, size=0.1)] if both else []
    x, u, y = Channels(named("x", n)), Channels(("u0",), ranges=(REACH,)), Channels(named("y", p))
    if sampled:
        A, B = zoh(A, B, T)
    faults = (FaultChannel("f", {"y0": 1.0}, size=3.0, rate=0.5),)
    own = T if sampled else None
    return Plant("random", Signals(x, u, y), A, B, C, D, faults, tuple(w), noise=Noise(T, (SD,) * p), sample_time=own)


def following(plant):
    """A Kalman filter for states and a constant fault."""
    n, q, p, m = plant.n, len(plant.faults), plant.p, plant.B.shape[1]
    one = plant.sample_time is not None
    A = np.block([[plant.A, plant.E_f], [np.zeros((q, n)), np.eye(q) * one]])
    C, Q = np.hstack([plant.C, plant.F_f]), np.diag([1.0] * n + [10.0] * q)
    P = (solve_discrete_are if one else solve_continuous_are)(A.T, C.T, Q, np.eye(p))
    L = A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + np.eye(p)) if one else P @ C.T
    B = np.vstack([plant.B, np.zeros((q, m))])
    return Observer(
        A - L @ C, np.hstack([B - L @ plant.D, L]), np.eye(n, n + q), np.zeros((n, m + p)), np.eye(q, n + q, n),
        np.zeros((q, m + p)), plant.F_f, np.zeros(n), np.zeros(m), np.zeros(p), sample_time=plant.sample_time,
    )  # fmt: skip


def looking(plant):
    """A Luenberger observer on the other sensors; the fault is what sensor 0 shows beyond it."""
    n, p, m, F = plant.n, plant.p, plant.B.shape[1], plant.F_f
    healthy = plant.C * np.arange(p)[:, None].astype(bool)
    L = solve_continuous_are(plant.A.T, healthy.T, np.eye(n), np.eye(p)) @ healthy.T
    return Observer(
        plant.A - L @ plant.C, np.hstack([plant.B - L @ plant.D, L]), np.eye(n), np.zeros((n, m + p)), -F.T @ plant.C,
        np.hstack([-F.T @ plant.D, F.T]), F, np.zeros(n), np.zeros(m), np.zeros(p),
    )  # fmt: skip


def estimator_of(plant, observer, hold, scheme="auto"):
    with_sensors = Prediction(plant.C, plant.D)
    try:
        return Estimator.build(observer, T, hold=hold, scheme=scheme, engine="casadi", prediction=with_sensors)
    except InputError:  # RK4 is not stable there
        assume(False)


@dataclass(frozen=True)
class Flight:
    """t, u, x, f, and what the sensors show: of x, u, f and what acts on both; of w on sensors alone; and noise."""

    t: np.ndarray
    u: np.ndarray
    x: np.ndarray
    f: np.ndarray
    clean: np.ndarray
    sensed: np.ndarray
    noise: np.ndarray

    @property
    def y(self):
        return self.clean + self.sensed + self.noise


def motion(plant, hold):
    """(Φ, U0, U1, W, w onto y) over one sample time, exactly."""
    E, on = np.zeros((plant.n, len(plant.disturbances))), np.zeros((plant.p, len(plant.disturbances)))
    for i, d in enumerate(plant.disturbances):
        E[:, i] = [d.into.get(name, 0.0) for name in plant.signals.x]
        on[:, i] = [d.on.get(name, 0.0) for name in plant.signals.y]
    if plant.sample_time is not None:
        return plant.A, plant.B, 0.0 * plant.B, E, on
    Phi, W = zoh(plant.A, E, T)
    _, U0, U1 = foh(plant.A, plant.B, T)
    if hold != "linear":
        _, held = zoh(plant.A, plant.B, T)
        U0, U1 = (held, 0.0 * held) if hold == "left" else (0.5 * held, 0.5 * held)
    return Phi, U0, U1, W, on


def moved(plant, hold, x0, u, f, w, noise, late=True):
    """A flight from what acts, by rows; late: w shows in the sensors after it has acted, else before."""
    Phi, U0, U1, W, on = motion(plant, hold)
    x = np.zeros((len(u), plant.n))
    x[0] = x0
    for k in range(len(u) - 1):
        x[k + 1] = Phi @ x[k] + U0 @ u[k] + U1 @ u[k + 1] + W @ w[k + late]
    acts = np.any(W != 0, axis=0)
    clean = x @ plant.C.T + u @ plant.D.T + f @ plant.F_f.T + (w * acts) @ on.T
    return Flight(np.arange(len(u)) * T, u, x, f, clean, (w * ~acts) @ on.T, noise)


def wild(plant, hold, rng, rows, late=True):
    """All of it at one end of its range or the other, now for a while, now from row to row."""

    def ends(*shape):
        length = int(rng.integers(1, 8))
        return np.repeat(rng.choice([-1.0, 1.0], size=(rows // length + 1, *shape)), length, axis=0)[:rows]

    w = ends(len(plant.disturbances)) * [d.size for d in plant.disturbances]
    f = np.cumsum(0.5 * T * ends(1), axis=0) % 4.0
    f = np.minimum(f, 4.0 - f)  # within its size, and no faster than its rate
    return moved(plant, hold, np.zeros(plant.n), REACH * ends(1), f, w, PEAK * SD * ends(plant.p), late)


def declaring(plant, *flights):
    """The plant with the ranges of the states that these flights stay within."""
    reach = np.max([np.abs(flight.x).max(axis=0) for flight in flights], axis=0)
    x = replace(plant.signals.x, ranges=tuple(float(r) for r in np.maximum(reach, 1e-9)))
    return replace(plant, signals=replace(plant.signals, x=x))


def sizes_of(plant, zeta, sd=SD):
    return Sizes(zeta, np.array([d.size for d in plant.disturbances]), PEAK * sd * np.ones(plant.p), 0.0)


def imagined(flight, first, last, estimator):
    """The readings with those inside the gap as they may be thought: without noise, and w as the estimator reads it."""
    y = flight.y.copy()
    for j in range(first + 1, last):
        part = (j - first) / (last - first)
        older, newer = {"left": (1.0, 0.0), "midpoint": (0.5, 0.5), "linear": (1.0 - part, part)}[estimator.hold]
        if estimator.scheme == "sampled":
            older = newer = 0.0
        y[j] = flight.clean[j] + older * flight.sensed[first] + newer * flight.sensed[last]
    return y


def apart(estimator, flight, first, rows, z=None):
    """z at the end of a gap, less z of the same estimator that got the samples; and z where the gap began."""
    last = first + rows + 1
    y = imagined(flight, first, last, estimator)
    state = estimator.replay(flight.t[: first + 1], flight.u[: first + 1], y[: first + 1]).end
    if z is not None:
        row = state._row.copy()
        row[: len(z)] = z
        state = State(row, state._layout)
    some, every = [last], np.arange(first + 1, last + 1)
    ends = [estimator.replay(flight.t[k], flight.u[k], y[k], state=state).end.z for k in (some, every)]
    return ends[0] - ends[1], state.z


def within(difference, columns, rng):
    """Whether no direction tells a difference from those that the columns allow."""
    c = np.vstack([np.eye(len(difference)), rng.normal(size=(50, len(difference)))])
    return np.all(np.abs(c @ difference) <= (1.0 + ROUNDING) * np.abs(c @ columns).sum(axis=1) + 1e-12)


# ---------------------------------------------------------------- rows


@few
@given(st.integers(0, 10**6), HOLDS, st.sampled_from(["zoh", "rk4"]))
def test_a_gap_moves_the_observer_no_further_than_its_columns_reach(seed, hold, scheme):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng)
    estimator = estimator_of(plant, (following, looking)[seed % 2](plant), hold, scheme)
    flights = [wild(plant, hold, rng, 120, late) for late in (True, False)]
    plant = declaring(plant, *flights)
    allowed = gaps(plant, estimator, sizes_of(plant, np.zeros(len(estimator.observer.A))))
    for flight in flights:
        for rows in (1, 2, 5, 8):
            difference, _ = apart(estimator, flight, int(rng.integers(20, 100)), rows)
            assert within(difference, allowed[rows - 1].later, rng)


def each_alone(plant, estimator, rows, zeta, before):
    """The difference that every single thing that is unknown makes, by running the estimator with nothing else."""
    end, Pi, found = rows + 1, error_system(plant, estimator).start[: len(zeta)], []

    def acts(name, k, size, z=None):
        parts = {"x0": np.zeros(plant.n), "u": np.zeros((end + 1, 1)), "f": np.zeros((end + 1, 1)),
                 "w": np.zeros((end + 1, len(plant.disturbances))), "noise": np.zeros((end + 1, plant.p))}  # fmt: skip
        parts[name][k] = size
        z = np.zeros(len(zeta)) if z is None else z
        found.append(apart(estimator, moved(plant, estimator.hold, **parts, late=not before), 0, rows, z)[0])

    for i in range(len(zeta)):
        acts("x0", 0, 0.0, zeta * np.eye(len(zeta))[i])
    for i, reach in enumerate(plant.signals.x.ranges):
        acts("x0", i, reach, Pi[:, i] * reach)
    acts("f", slice(None), 3.0, Pi[:, plant.n] * 3.0)
    for i, d in enumerate(plant.disturbances):
        acting = any(d.into.values())
        for k in range(end + 1) if acting else (0, end):
            acts("w", (k, i), d.size)
        if before and acting:  # the last one to reach the state before the gap, which the observer does not know of yet
            acts("x0", 0, 0.0, -Pi[:, : plant.n] @ motion(plant, "left")[3][:, i] * d.size)
    for k in range(end + 1):
        acts("u", (k, 0), REACH)
        if k > 0:
            acts("f", (slice(k, None), 0), 0.5 * T)
    for i in range(plant.p):
        acts("noise", (0, i), PEAK * SD)
        acts("noise", (end, i), PEAK * SD)
    return np.array(found).T


@few
@given(st.integers(0, 10**6), st.sampled_from(["left", "midpoint", "linear", "sampled"]), st.integers(1, 8))
def test_the_columns_reach_exactly_as_far_as_the_worst_signals_do(seed, kind, rows):
    rng, sampled = np.random.default_rng(seed), kind == "sampled"
    plant, hold = random_plant(rng, both=False, sampled=sampled), "left" if sampled else kind
    plant = declaring(plant, wild(plant, hold, rng, 50))
    estimator = estimator_of(plant, following(plant), hold)
    zeta = rng.uniform(0.0, 1.0, len(estimator.observer.A)) * sampled
    alone = each_alone(plant, estimator, rows, zeta, before=sampled)
    allowed = gaps(plant, estimator, sizes_of(plant, zeta), rows)[-1]
    c = rng.normal(size=(20, len(zeta)))
    reached = np.abs(c @ alone).sum(axis=1)
    np.testing.assert_allclose(np.abs(c @ allowed.later).sum(axis=1), reached, rtol=1e-8, atol=1e-12)


@few
@given(st.integers(0, 10**6), HOLDS, st.booleans())
def test_what_acts_on_states_and_sensors_reaches_no_further_whenever_it_shows(seed, hold, before):
    """On sensors above all, so that the worst of it comes close to what is allowed."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, both=False)
    plant = replace(plant, disturbances=(Disturbance("both", {"x0": 0.1}, {"y2": 1.0}, size=0.1),))
    plant = declaring(plant, wild(plant, hold, rng, 50))
    estimator = estimator_of(plant, following(plant), hold)
    zeta = np.zeros(len(estimator.observer.A))
    alone = each_alone(plant, estimator, 3, zeta, before)
    allowed, c = gaps(plant, estimator, sizes_of(plant, zeta), 3)[-1], rng.normal(size=(20, len(zeta)))
    most, reached = np.abs(c @ allowed.later).sum(axis=1), np.abs(c @ alone).sum(axis=1)
    assert np.all(reached <= (1.0 + ROUNDING) * most)
    assert np.all(reached >= 0.9 * most)


@few
@given(st.integers(0, 10**6))
def test_a_sampled_observer_that_predicts_its_rows_stays_within_too(seed):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, sampled=True)
    estimator = estimator_of(plant, following(plant), "left")
    flight = wild(plant, "left", rng, 120, late=False)
    plant = declaring(plant, flight)
    start = error_system(plant, estimator).start[: plant.n + 1]
    for rows in (1, 2, 4, 8):
        first = int(rng.integers(30, 90))
        difference, z = apart(estimator, flight, first, rows)
        zeta = np.abs(z - start @ np.append(flight.x[first], flight.f[first]))
        allowed = gaps(plant, estimator, sizes_of(plant, zeta), rows)[-1]
        assert within(difference, allowed.later, rng)


@few
@given(st.integers(0, 10**6), HOLDS)
def test_no_error_after_gaps_lies_outside_the_steady_bound_and_what_fades(seed, hold):
    """With all that is declared at its worst, noise inside the gaps included; gaps that follow each other add up."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng)
    estimator = estimator_of(plant, (following, looking)[seed % 2](plant), hold)
    flight = wild(plant, hold, rng, 600, late=bool(seed % 3))
    plant = declaring(plant, flight)
    system = error_system(plant, estimator)
    limits = bounds(plant, estimator, system, Allowance(noise_peak=PEAK, noise="bounded"))
    allowed = gaps(plant, estimator, sizes_of(plant, np.zeros(len(estimator.observer.A))))
    missing = {int(k): int(rng.integers(1, 9)) for k in (200, 230, 245, 400)}
    keep = np.ones(600, dtype=bool)
    for k, rows in missing.items():
        keep[k : k + rows] = False
    guess = limits.beginning.guess(flight.u[0], flight.y[0])
    trace = estimator.replay(flight.t[keep], flight.u[keep], flight.y[keep], x=guess)
    error = np.full((600, 4), np.nan)
    error[keep, :1] = trace.fault - flight.f[keep]
    error[keep, 1:] = flight.y[keep] - trace.state @ plant.C.T - flight.u[keep] @ plant.D.T
    error[keep, 1:] -= trace.fault @ plant.F_f.T
    left = np.array([(limits.start[:, :4] * limits.rate[:, :4] ** k).sum(axis=0) for k in range(600)])
    bound = limits.steady[0] * (1.0 + left)
    for k, rows in missing.items():
        box = np.zeros((len(system.M), allowed[rows - 1].later.shape[1]))
        box[: len(estimator.observer.A)] = allowed[rows - 1].later
        for row in range(k + rows, 600):
            bound[row] += np.abs(system.C[:4] @ box).sum(axis=1)
            box = system.M @ box
    assert np.all(np.abs(error[keep]) <= (1.0 + ROUNDING) * bound[keep] + 1e-12)


def left(limits, t, u, y, whole):
    """What is left of the start and of all that is missing, in bounds, (N, q + p); sample by sample, as it is meant."""
    absent, found = limits.absences, []
    rate = np.vstack([limits.rate, absent.rate])
    parts = np.vstack([limits.start / limits.rate, np.zeros_like(absent.rate)])
    for k in range(len(t)):
        before, parts = 1.0 + parts[:, -1].sum(), parts * rate
        rows = round((t[k] - t[k - 1]) / T) - 1 if k else 0
        if rows:
            assert whole[k - 1]
            assert whole[k]
            parts[2:] += absent.skipped[rows - 1] * (before if absent.scales else 1.0)
        for i in np.flatnonzero(np.isnan(u[k])):
            parts[2:] += absent.unfed[i]
        for i in np.flatnonzero(np.isnan(y[k])):
            parts[2:] += absent.lost[i] * before
        found.append(parts[:, :-1].sum(axis=0))
    return np.array(found)


@few
@given(st.integers(0, 10**6), HOLDS, st.booleans())
def test_no_error_lies_outside_what_is_said_to_be_left_of_all_that_was_missing(seed, hold, sampled):
    """Rows, inputs and sensors, from the start on, and of any sensor for up to six rows in a row."""
    rng = np.random.default_rng(seed)
    plant, hold = random_plant(rng, sampled=sampled), "left" if sampled else hold
    make = looking if seed % 2 and not sampled else following
    estimator = estimator_of(plant, make(plant), hold)
    flight = wild(plant, hold, rng, 400, late=bool(seed % 3) and not sampled)
    plant = declaring(plant, flight)
    limits = bounds(plant, estimator, error_system(plant, estimator), Allowance(noise_peak=PEAK, noise="bounded"))
    u, y, keep = flight.u.copy(), flight.y.copy(), np.ones(400, dtype=bool)
    for k in range(3, 380, 10):  # what is missing keeps two rows away from all else that is
        kind, rows = rng.choice(["row", "input", "sensor", "nothing"]), int(rng.integers(1, 7))
        keep[k : k + rows] = kind != "row"
        u[k : k + rows] = math.nan if kind == "input" else u[k : k + rows]
        if kind == "sensor":
            y[k : k + rows, rng.integers(plant.p)] = math.nan
    whole = np.isfinite(u).all(axis=1) & np.isfinite(y).all(axis=1)
    trace = estimator.replay(flight.t[keep], u[keep], y[keep], x=limits.beginning.guess(u[0], y[0]))
    shown = trace.state @ plant.C.T + flight.u[keep] @ plant.D.T + trace.fault @ plant.F_f.T
    error = np.hstack([trace.fault - flight.f[keep], y[keep] - shown])
    error[np.isnan(u[keep]).any(axis=1), 1:] = math.nan  # nobody knows what the sensors should show
    allowed = limits.steady[0] * (1.0 + left(limits, flight.t[keep], u[keep], y[keep], whole[keep]))
    assert np.isfinite(allowed).all()
    told = np.isfinite(error)
    assert np.all(np.abs(error[told]) <= (1.0 + ROUNDING) * allowed[told] + 1e-12)


@few
@given(st.integers(0, 10**6), HOLDS)
def test_while_a_sensor_is_silent_what_acts_and_what_shows_are_two_things(seed, hold):
    """A disturbance that shows before it acts shows one value where another has just acted."""
    rng = np.random.default_rng(seed)
    plant, on = random_plant(rng, both=False), rng.choice([-1.0, 1.0])
    both = (Disturbance("both", {"x0": 1.0}, {"y2": on}, size=0.1),)
    each = (Disturbance("acts", {"x0": 1.0}, size=0.1), Disturbance("shows", {}, {"y2": on}, size=0.1))
    found = []
    for w in (both, each):
        one = replace(plant, disturbances=w)
        zeta = np.zeros(plant.n + 1)
        found.append(absences(one, estimator_of(one, following(one), hold), sizes_of(one, zeta))[2])
    one, other = found
    np.testing.assert_allclose(one.at_once, other.at_once, rtol=1e-9)
    np.testing.assert_allclose(np.abs(one.later).sum(axis=1), np.abs(other.later).sum(axis=1), rtol=1e-9)


def test_what_is_left_of_gaps_and_silence_fades_at_its_own_pace():
    """Against the slow part of the start, in which a gap would count for what the slowest mode makes of it."""
    plant = random_plant(np.random.default_rng(0))
    plant = declaring(plant, wild(plant, "linear", np.random.default_rng(0), 200))
    estimator = estimator_of(plant, following(plant), "linear")
    limits = bounds(plant, estimator, error_system(plant, estimator), Allowance(noise_peak=PEAK))
    one = (limits.absences.skipped[0] / (1.0 - limits.absences.rate)).sum(axis=0)
    assert np.all(one[:1] < 0.2 * (limits.start / (1.0 - limits.rate)).sum(axis=0)[:1])


def test_what_is_not_known_is_infinite_and_said_to_be_assumed():
    plant = random_plant(np.random.default_rng(1))
    estimator = estimator_of(plant, following(plant), "linear")
    limits = bounds(plant, estimator, error_system(plant, estimator))
    assert np.isinf(limits.absences.skipped).all()
    assert np.isfinite(limits.absences.unfed).all()
    assert any("missing inputs and silent sensors are accounted for" in one for one in limits.assumptions)
    assert any("no larger than that of an observer at rest" in one for one in limits.assumptions)


def test_what_runs_in_straight_lines_costs_nothing():
    """A position at constant speed, read without noise through a gap: the estimator makes up what there was."""
    signals = Signals(Channels(("s", "v"), ranges=(9.0, 2.0)), Channels(()), Channels(("y0", "y1")))
    A, C = np.array([[0.0, 1.0], [0.0, 0.0]]), np.eye(2)
    plant = Plant("cart", signals, A, np.zeros((2, 0)), C, np.zeros((2, 0)), (FaultChannel("f", {"y1": 1.0}),))
    estimator = estimator_of(plant, following(replace(plant, faults=())), "linear")
    (found,) = gaps(replace(plant, faults=()), estimator, Sizes(np.zeros(2), np.zeros(0), np.zeros(2), 0.0), 1)
    assert found.at_once.max() <= 1e-12


def test_a_fault_that_moves_the_plant_may_do_so_on_a_detour():
    """By hand: x' = f, y = x, z' = -z + y; how far the reading within the gap may be from the line through it."""
    signals = Signals(Channels(("x0",), ranges=(1.0,)), Channels(("u0",), ranges=(1e-15,)), Channels(("y0",)))
    one, none, rate = np.ones((1, 1)), np.zeros((1, 1)), 0.7
    plant = Plant("tank", signals, none, one, one, none, (FaultChannel("f", {"u0": 1.0}, "actuator", rate=rate),))
    observer = Observer(-one, np.array([[0.0, 1.0]]), one, np.zeros((1, 2)), none, np.zeros((1, 2)), none,
                        *np.zeros((3, 1)))  # fmt: skip
    (found,) = gaps(plant, estimator_of(plant, observer, "linear"), sizes_of(plant, np.zeros(1), sd=0.0), 1)
    Ad, B0, B1 = foh(-one, one, T)
    changes, detours = rate * T**2 / 2.0, rate * T**2 / 4.0
    assert np.abs(found.later).sum() == pytest.approx(float((Ad @ B1 + B0)[0, 0]) * (changes + detours), rel=1e-9)


def test_a_range_that_nobody_declared_leaves_nothing_known_after_a_gap():
    plant = random_plant(np.random.default_rng(1))
    estimator = estimator_of(plant, following(plant), "linear")
    found = gaps(plant, estimator, sizes_of(plant, np.zeros(len(estimator.observer.A))), 2)
    assert all(np.isinf(one.at_once).all() for one in found)


def test_a_fault_of_any_rate_costs_nothing_where_no_gain_but_rounding_reads_its_sensor():
    rng = np.random.default_rng(5)
    plant = random_plant(rng)
    plant = replace(declaring(plant, wild(plant, "linear", rng, 50)), faults=(FaultChannel("f", {"y0": 1.0}),))
    observer = looking(plant)
    B = observer.B.copy()
    B[:, 1] = 1e-15 * np.abs(B).max()
    observer = replace(observer, A=observer.A + observer.B[:, 1:2] @ plant.C[:1], B=B)
    sizes = sizes_of(plant, np.zeros(plant.n))
    assert np.isfinite(gaps(plant, estimator_of(plant, observer, "linear"), sizes, 2)[1].at_once).all()


def test_without_a_range_a_line_through_the_gap_still_costs_nothing():
    """Integrators need no range: their own motion is the straight line that the estimator reads."""
    signals = Signals(Channels(("s",)), Channels(("u0",), ranges=(1.0,)), Channels(("y0",)))
    plant = Plant("tank", signals, np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), ())
    estimator = estimator_of(plant, following(plant), "linear")
    found = gaps(plant, estimator, Sizes(np.zeros(1), np.zeros(0), np.zeros(1), 0.0), 3)
    assert all(0.0 < one.at_once.max() < math.inf for one in found)


# ---------------------------------------------------------------- inputs


@few
@given(st.integers(0, 10**6), HOLDS, st.sampled_from(["zoh", "rk4", "sampled"]))
def test_an_input_that_is_missing_moves_no_more_than_is_said(seed, hold, scheme):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, sampled=scheme == "sampled")
    make = looking if seed % 2 and scheme != "sampled" else following
    estimator = estimator_of(plant, make(plant), hold, scheme)
    (allowed,), system = inputs_missing(plant, estimator), error_system(plant, estimator)
    flight, nz = wild(plant, estimator.hold, rng, 60), len(estimator.observer.A)
    for rows in (1, 3):
        lost = flight.u.copy()
        lost[40 : 40 + rows] = math.nan
        runs = [
            estimator.replay(flight.t[: 41 + rows], u[: 41 + rows], flight.y[: 41 + rows]) for u in (flight.u, lost)
        ]
        columns = allowed.later
        for _ in range(rows - 1):  # those before have gone through regular steps since
            columns = np.hstack([system.M[:nz, :nz] @ columns, allowed.later])
        assert within(runs[1].end.z - runs[0].end.z, columns, rng)
        shown = runs[1].fault[40] - runs[0].fault[40]
        assert np.all(np.abs(shown) <= (1.0 + ROUNDING) * allowed.at_once[:1] + 1e-12)


def test_an_input_from_one_end_of_its_range_to_the_other_uses_all_that_is_allowed():
    plant = random_plant(np.random.default_rng(3))
    estimator = estimator_of(plant, following(plant), "linear")
    (allowed,) = inputs_missing(plant, estimator)
    t, y, u = np.arange(4) * T, np.zeros((4, 3)), np.array([[-REACH], [-REACH], [REACH], [0.0]])
    lost = u.copy()
    lost[2] = math.nan
    z = [estimator.replay(t, one, y).end.z for one in (u, lost)]
    np.testing.assert_allclose(np.abs(z[1] - z[0]), np.abs(allowed.later).sum(axis=1), rtol=1e-9)


def test_an_input_without_a_range_leaves_nothing_known():
    plant = random_plant(np.random.default_rng(3))
    plant = replace(plant, signals=replace(plant.signals, u=Channels(("u0",))))
    (found,) = inputs_missing(plant, estimator_of(plant, following(plant), "linear"))
    assert np.isinf(found.later).any()


# ---------------------------------------------------------------- nonlinear


def pendulum(reads="x"):
    """x1'' = -2 x1 - 0.9 x1' + 0.5 sin(x1) + w + u, two sensors, and its observer."""
    import casadi as ca

    law = {"x": lambda x, u, t: 0.5 * ca.sin(x), "u": lambda x, u, t: 0.5 * ca.sin(x + u)}[reads]
    phi = Graph.trace(law, {"x": 1, "u": 1, "t": 1})
    phi = replace(phi, inputs={"x": ("x0",), "u": ("u0",), "t": ("t",)})
    term = Lipschitz(np.array([[0.0], [1.0]]), ("x0",), phi, 0.5)
    signals = Signals(Channels(("x0", "x1")), Channels(("u0",), ranges=(REACH,)), Channels(("y0", "y1")))
    A, B, C = np.array([[0.0, 1.0], [-2.0, -0.9]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0], [1.0, 1.0]])
    w, f = (Disturbance("w", {"x1": 1.0}, size=0.3),), (FaultChannel("f", {"y0": 1.0}, size=3.0, rate=0.5),)
    plant = Plant("pendulum", signals, A, B, C, np.zeros((2, 1)), f, w, noise=Noise(T, (SD, SD)), nonlinearity=term)
    return plant, replace(
        looking(plant), nonlinear=NonlinearTerm(term.into, np.eye(1, 2), np.zeros(1), *term.limits, phi)
    )


def swung(plant, hold, rng, rows, fine=20):
    """The pendulum in steps of T/20, exactly but for φ, which stays for a step."""
    u, w = (rng.choice([-1.0, 1.0], size=(rows, 1)) * size for size in (REACH, 0.3))
    Phi, G = zoh(plant.A, np.array([[0.0], [1.0]]), T / fine)
    x = np.zeros((rows, 2))
    for k in range(rows - 1):
        z = x[k]
        for i in range(fine):
            s = {"left": 0.0, "midpoint": 0.5, "linear": (i + 0.5) / fine}[hold]
            z = Phi @ z + G[:, 0] * ((1.0 - s) * u[k] + s * u[k + 1] + w[k] + 0.5 * math.sin(z[0]))
        x[k + 1] = z
    noise, nothing = PEAK * SD * rng.choice([-1.0, 1.0], size=(rows, 2)), np.zeros((rows, 2))
    return Flight(np.arange(rows) * T, u, x, np.zeros((rows, 1)), x @ plant.C.T, nothing, noise)


@few
@given(st.integers(0, 10**6), HOLDS, st.sampled_from(["zoh", "rk4"]))
def test_a_gap_moves_a_nonlinear_observer_no_further_than_its_columns_reach(seed, hold, scheme):
    rng, (plant, observer) = np.random.default_rng(seed), pendulum()
    estimator, flight = estimator_of(plant, observer, hold, scheme), swung(plant, hold, rng, 120)
    plant = declaring(plant, flight)
    allowed = gaps(plant, estimator, sizes_of(plant, np.zeros(2)))
    for rows in (1, 4, 8):
        difference, _ = apart(estimator, flight, int(rng.integers(20, 100)), rows)
        assert np.isfinite(allowed[rows - 1].later).all()
        assert within(difference, allowed[rows - 1].later, rng)


@pytest.mark.parametrize("scheme", ["zoh", "rk4"])
def test_what_the_nonlinearity_makes_of_a_gap_is_counted_in_full(scheme):
    """x' = -4 x + φ(x) + u with φ(x) = 3 x, and an observer that reads no sensor: the worst input reaches it all."""
    phi = replace(Graph.trace(lambda x, u, t: 3.0 * x, {"x": 1, "u": 1, "t": 1}),
                  inputs={"x": ("x0",), "u": ("u0",), "t": ("t",)})  # fmt: skip
    signals = Signals(Channels(("x0",), ranges=(1.0,)), Channels(("u0",), ranges=(REACH,)), Channels(("y0",)))
    one, none = np.ones((1, 1)), np.zeros((1, 1))
    plant = Plant("drain", signals, -4.0 * one, one, one, none, (FaultChannel("f", {"y0": 1.0}, rate=1.0),),
                  nonlinearity=Lipschitz(one, ("x0",), phi, 3.0))  # fmt: skip
    observer = replace(looking(plant), A=-4.0 * one, B=np.array([[1.0, 0.0]]))
    observer = replace(observer, nonlinear=NonlinearTerm(one, one, np.zeros(1), *plant.nonlinearity.limits, phi))
    estimator = estimator_of(plant, observer, "left", scheme)
    u = np.concatenate([[[REACH]], np.full((9, 1), -REACH)])
    flight = Flight(np.arange(10) * T, u, np.zeros((10, 1)), np.zeros((10, 1)), *np.zeros((3, 10, 1)))
    (reached,), _ = apart(estimator, flight, 0, 8)
    allowed = gaps(plant, estimator, Sizes(np.zeros(1), np.zeros(0), np.zeros(1), 0.0))[-1]
    most = np.abs(allowed.later).sum()
    assert reached <= (1.0 + ROUNDING) * most
    assert reached >= 0.99 * most  # the stages of RK4 are bounded one by one, h |A| (h φ')²/6 of them for nothing


@pytest.mark.parametrize("scheme", ["zoh", "rk4"])
def test_where_the_nonlinearity_reads_an_input_nothing_is_known_without_it(scheme):
    plant, observer = pendulum("u")
    plant = declaring(plant, swung(plant, "linear", np.random.default_rng(1), 50))
    estimator = estimator_of(plant, observer, "linear", scheme)
    assert np.isinf(inputs_missing(plant, estimator)[0].later).any()
    assert np.isinf(gaps(plant, estimator, sizes_of(plant, np.zeros(2)), 1)[0].later).any()


@few
@given(st.integers(0, 10**6), st.sampled_from([1, 4, 8]))
def test_a_sampled_nonlinear_observer_that_predicts_its_rows_stays_within_too(seed, rows):
    rng, (plant, _) = np.random.default_rng(seed), pendulum()
    A, B = zoh(plant.A, plant.B, T)
    term = replace(plant.nonlinearity, into=B)
    plant = replace(plant, A=A, B=B, sample_time=T, nonlinearity=term, disturbances=(Disturbance("w", {"x1": T}),))
    L = np.array([[0.0, 0.2], [0.0, 0.3]])
    healthy = looking(replace(plant, A=A - np.eye(2)))  # for its outputs; the equations are below
    observer = replace(
        healthy, A=A - L @ plant.C, B=np.hstack([B, L]), sample_time=T,
        nonlinear=NonlinearTerm(B, np.eye(1, 2), np.zeros(1), *term.limits, term.phi),
    )  # fmt: skip
    estimator, x, u, w = estimator_of(plant, observer, "left"), np.zeros((60, 2)), *rng.uniform(-1, 1, (2, 60, 1))
    for k in range(59):
        x[k + 1] = A @ x[k] + B[:, 0] * (u[k] + 0.5 * math.sin(x[k, 0])) + [0.0, T * w[k, 0]]
    noise, nothing = PEAK * SD * rng.choice([-1.0, 1.0], size=(60, 2)), np.zeros((60, 2))
    flight = Flight(np.arange(60) * T, u, x, np.zeros((60, 1)), x @ plant.C.T, nothing, noise)
    plant = declaring(plant, flight)
    Pi, read = error_system(plant, estimator).start[:, :2], estimator.replay(flight.t, u, flight.y).state
    difference, z = apart(estimator, flight, 30, rows)
    regular = estimator.replay(flight.t, u, imagined(flight, 30, 31 + rows, estimator)).state
    slipped = 0.5 * max(np.abs(some - x)[30:, 0].max() for some in (read, regular))
    sizes = Sizes(np.abs(z - Pi @ x[30]), np.ones(1), PEAK * SD * np.ones(2), slipped)
    assert within(difference, gaps(plant, estimator, sizes, rows)[-1].later, rng)
