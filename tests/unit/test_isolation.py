# SPDX-License-Identifier: BSD-3-Clause
"""Which fault may excuse which test: by what it can do there, and no more."""

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

from faultrecon.graph.compiled import obstacle
from faultrecon.graph.observer import Observer
from faultrecon.numerics.discretise import foh, zoh
from faultrecon.numerics.peaks import BLOCK, Outputs
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.runtime.errors import error_system
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.runtime.isolation import LATER, LITTLE, _ask, _compiled, _over, _starts, isolation
from faultrecon.runtime.steps import observer_step
from faultrecon.runtime.watch import Batch, Findings
from faultrecon.runtime.watch import _compiled as compiled_watch
from faultrecon.runtime.watchloop import pass_over
from faultrecon.synthesis.bank import Bank


def twins():
    """Two plants that know nothing of each other, two sensors each."""
    A = np.kron(np.eye(2), np.array([[0.0, 1.0], [-1.0, -0.8]]))
    B = np.kron(np.ones((2, 1)), np.array([[0.0], [1.0]]))
    signals = Signals(Channels(("a", "b", "c", "d"), ranges=(2.0,) * 4), Channels(("u",), ranges=(2.0,)),
                      Channels(("ya", "yb", "yc", "yd"), ranges=(2.0,) * 4))  # fmt: skip
    return Plant("twins", signals, A, B, np.eye(4), np.zeros((4, 1)), noise=Noise(0.05, (0.01,) * 4))


def table_of(monitor):
    """excuse by hypothesis, watch, scale and row [faults; sensors]."""
    found, begins = [], monitor.isolation.begins[0].astype(int)
    for row in monitor.isolation.excuse:
        parts = [row[begins[i] : begins[i + 1]] for i in range(len(monitor.hypotheses))]
        found.append([p.reshape(len(h.watch.poles), -1) for p, h in zip(parts, monitor.hypotheses, strict=True)])
    return found


def test_a_fault_never_excuses_tests_of_a_plant_that_it_does_not_reach(by_hand):
    monitor = by_hand(twins()).monitor(spans=(0.5,), window=10)
    excuses = table_of(monitor)
    for fault, there in ((0, (2, 3)), (1, (2, 3)), (2, (0, 1)), (3, (0, 1))):
        for watch in range(4):
            for sensor in there:
                assert np.all(excuses[fault][watch][:, 1 + sensor] == 0.0)


def test_a_fault_excuses_what_its_own_reconstruction_says(cart_monitor):
    for i, table in enumerate(table_of(cart_monitor)):
        assert np.all(table[i][:, 0] > 0.0)


def test_a_fault_excuses_no_test_among_the_sensors_that_its_observer_reads(cart_monitor):
    for i, table in enumerate(table_of(cart_monitor)):
        assert np.all(table[i][:, 1:][np.isfinite(cart_monitor.hypotheses[i].watch.limits[:, 1:])] == 0.0)


@pytest.mark.parametrize("name", ["s1", "s2", "v1", "mix"])
@pytest.mark.parametrize("shape", ["steps", "short", "growing", "spikes"])
def test_the_true_explanation_never_fails(cart, cart_monitor, drive, name, shape):
    rng, rows = np.random.default_rng(3), 3000
    k = np.arange(rows)
    fault = {
        "steps": 3.0 * np.sign(np.sin(k / 90.0)) * (k > 400),
        "short": 20.0 * ((k > 500) & (k < 540)),
        "growing": 0.01 * np.maximum(k - 300, 0) * (k < 2000),
        "spikes": 50.0 * (rng.random(rows) < 0.01) * (k > 200),
    }[shape]
    t, u, y = drive(cart, rng, rows, faults={name: fault}, gaussian=False)
    looked = cart_monitor._look(cart_monitor.start(), t, u, y, np.ones(rows))
    true = [h.name for h in cart_monitor.hypotheses].index(name)
    assert looked.misfit[:, true].max() <= 1.0
    assert looked.failed.any()


def test_a_fault_that_is_over_excuses_what_slow_tests_remember_of_it(by_hand, cart, drive):
    """The filters forget within two samples, the observers only within twenty."""
    monitor, k = by_hand(cart).monitor(spans=(0.1,), window=10, crest=1.0), np.arange(1500)
    for i, name in enumerate(cart.signals.y):
        fault = 20.0 * ((k > 500) & (k < 540))
        t, u, y = drive(cart, np.random.default_rng(i), 1500, faults={name: fault}, gaussian=False)
        assert monitor._look(monitor.start(), t, u, y, np.ones(1500)).misfit[:, i].max() <= 1.0


def test_the_table_does_not_depend_on_the_order_of_hypotheses(by_hand, cart):
    watches = [h.watch for h in by_hand(cart).monitor(spans=(0.5,)).hypotheses]
    systems = [error_system(w.plant, w.estimator) for w in watches]
    plants = [w.plant for w in watches]
    found = isolation(watches, systems, plants)
    turned = isolation(watches, systems, plants[::-1])
    np.testing.assert_allclose(turned.excuse, found.excuse[::-1], rtol=1e-12)


def test_compiled_and_interpreted_agree_to_the_last_bit(cart, cart_monitor, drive):
    assert not obstacle()
    t, u, y = drive(cart, np.random.default_rng(5), 900, faults={"s1": np.linspace(0.0, 1.0, 900)})
    y[100:120, 1] = y[300, :] = np.nan
    u[500] = np.nan
    waits = np.where(np.arange(900) == 700, 3.0, np.where(np.arange(900) == 750, 0.5, 1.0))
    watch = cart_monitor.hypotheses[0].watch
    trace = watch.estimator.replay(t, u, y)
    assert compiled_watch() is not pass_over
    found = [Findings.room(900, [watch])[0] for _ in range(2)]
    ends = [
        replace(watch, compiled=compiled).look(watch.init(), Batch.of(u, y, waits), trace, into)
        for compiled, into in zip((True, False), found, strict=True)
    ]
    np.testing.assert_array_equal(*ends)
    for name in ("peak", "own", "faded", "bound", "amplitude"):
        np.testing.assert_array_equal(*(getattr(one, name) for one in found))
    told = found[0].peak[:, 0] > 1.0
    assert told.any()
    np.testing.assert_array_equal(*(one.shares[told] for one in found))

    table = cart_monitor.isolation
    rng = np.random.default_rng(6)
    shares = rng.exponential(1.0, (400, table.excuse.shape[1]))
    amplitudes = rng.exponential(1.0, (400, len(table.excuse)))
    begins = table.begins[0].astype(int)
    silent = rng.integers(0, 500, table._silent.shape).astype(float)
    peaks = np.column_stack([shares[:, a:b].max(axis=1) for a, b in pairwise(begins)])
    found = [np.empty((400, table.first.shape[1])) for _ in range(2)]
    assert _compiled() is not _ask
    for ask, out in zip((_compiled(), _ask), found, strict=True):
        ask(shares, peaks, amplitudes, table.excuse, silent, table.first, table.begins, 37, out)
    np.testing.assert_array_equal(*found)


def tank(sample_time=None):
    """A slow tank with three equal level sensors: 20 s against samples at every tenth of a second."""
    ranges = {"ranges": (10.0,) * 3}
    signals = Signals(Channels(("x",), ranges=(10.0,)), Channels(("u",), ranges=(1.0,)), Channels("abc", **ranges))
    A, B = np.array([[-0.05]]), np.array([[1.0]])
    inflow, noise = Disturbance("w", {"x": 1.0}, size=0.002), Noise(0.1, (0.1,) * 3)
    if sample_time is not None:
        A, B = zoh(A, B, 0.1)
        inflow = replace(inflow, into={"x": float(B[0, 0])})
    return Plant("tank", signals, A, B, np.ones((3, 1)), np.zeros((3, 1)), disturbances=(inflow,), noise=noise,
                 sample_time=sample_time)  # fmt: skip


@dataclass(frozen=True)
class Sampled:
    """A sampled observer that predicts, and corrects with the sample at hand: z is what it expects before that.

    It hardly corrects, so that it forgets no faster than the plant; some certified designs do just that.
    """

    plant: Plant
    method: str = "by hand"
    gains: dict = field(default_factory=dict)

    @property
    def observer(self):
        plant, n, m = self.plant, self.plant.n, self.plant.B.shape[1]
        L = 1e-5 * plant.C.T * ~np.any(plant.F_f != 0, axis=1)
        keeps = np.eye(n) - L @ plant.C
        Cf, Df = -plant.F_f.T @ plant.C, np.hstack([np.zeros((len(plant.faults), m)), plant.F_f.T])
        Dx = np.hstack([np.zeros((n, m)), L])
        return Observer(
            plant.A @ keeps, np.hstack([plant.B, plant.A @ L]), keeps, Dx, Cf @ keeps, Df + Cf @ Dx, plant.F_f,
            np.zeros(n), np.zeros(m), np.zeros(plant.p), sample_time=0.1, prior=np.eye(n),
        )  # fmt: skip

    def estimator(self, sample_time, hold="linear", engine="auto"):
        prediction = Prediction(self.plant.C, self.plant.D)
        return Estimator.build(self.observer, sample_time, hold=hold, engine=engine, prediction=prediction)


def bank_of_samplers():
    plant = tank(0.1)
    faults = {name: FaultChannel(name, {name: 1.0}, size=10.0, rate=200.0) for name in "abc"}
    designs = {name: Sampled(replace(plant, faults=(fault,))) for name, fault in faults.items()}
    return Bank(replace(plant, faults=tuple(faults.values())), designs)


@pytest.fixture(scope="module")
def tanks(by_hand):
    """Monitors of the tank, continuous and sampled."""
    return {"continuous": by_hand(tank()).monitor(crest=1.0), "sampled": bank_of_samplers().monitor(crest=1.0)}


def filled(rng, rows, kind, fault, begins=0, x=0.0, used=1.0):
    """A log of the tank within bounds; sensor a is off by `fault` from row `begins` on, and so before the first."""
    A, B = zoh(np.array([[-0.05]]), np.array([[1.0]]), 0.1)
    _, U0, U1 = foh(np.array([[-0.05]]), np.array([[1.0]]), 0.1)
    u = 0.3 * np.sin(0.02 * np.arange(rows + 1))
    w = used * 0.002 * np.sign(rng.normal(size=rows // 50 + 1)).repeat(50)[:rows]
    levels = np.empty(rows)
    for k in range(rows):
        levels[k] = x
        driven = B * u[k] if kind == "sampled" else U0 * u[k] + U1 * u[k + 1]
        x = float((A * x + driven + B * w[k])[0, 0])
    y = levels[:, None] + used * rng.uniform(-0.2, 0.2, (rows, 3))
    y[begins:, 0] += fault
    return 0.1 * np.arange(rows), u[:rows, None], y


@pytest.mark.parametrize("kind", ["continuous", "sampled"])
@pytest.mark.parametrize("size", [0.5, 1.0, 5.0])
def test_a_fault_that_acts_before_the_first_sample_is_never_refuted(tanks, kind, size):
    monitor, rng = tanks[kind], np.random.default_rng(7)
    for sign in (-1.0, 1.0):
        log = filled(rng, 5000, kind, sign * 10.0 * size, x=float(rng.uniform(-10.0, 10.0)))
        looked = monitor._look(monitor.start(), *log, np.ones(5000))
        assert looked.misfit[:, 0].max() <= 1.0
        assert (looked.misfit[-100:, 1:] > 1.0).all()


@pytest.mark.parametrize("kind", ["continuous", "sampled"])
@pytest.mark.parametrize("lacks", ["a", "bc", "abc"])
def test_nor_is_one_of_which_the_first_sample_tells_only_a_part(tanks, kind, lacks):
    monitor, rng = tanks[kind], np.random.default_rng(8)
    t, u, y = filled(rng, 5000, kind, 10.0, x=2.0)
    y[0, ["abc".index(name) for name in lacks]] = np.nan
    assert monitor._look(monitor.start(), t, u, y, np.ones(5000)).misfit[:, 0].max() <= 1.0


def test_without_the_deaf_time_it_would_be(tanks):
    monitor = tanks["sampled"]
    deaf = monitor.isolation.deaf
    assert deaf.max() > 0.0
    hearing = replace(monitor, isolation=replace(monitor.isolation, deaf=np.zeros_like(deaf)))
    log = filled(np.random.default_rng(7), 3000, "sampled", 10.0)
    assert hearing._look(hearing.start(), *log, np.ones(3000)).misfit[:, 0].max() > 1.0


@pytest.mark.parametrize("kind", ["continuous", "sampled"])
def test_a_fault_that_begins_later_is_told_from_others_within_a_window(tanks, kind):
    """Ten seconds after it begins no wrong explanation holds, although their excuses have grown a little."""
    monitor, begins = tanks[kind], 100 + int(max(m.isolation.deaf.max() for m in tanks.values()))
    log = filled(np.random.default_rng(9), begins + 400, kind, 1.5, begins=begins)
    looked = monitor._look(monitor.start(), *log, np.ones(begins + 400))
    assert looked.misfit[:, 0].max() <= 1.0
    assert not looked.failed[:begins].any()
    assert (looked.misfit[begins + 100 :, 1:] > 1.0).all()


def test_the_deaf_time_counts_from_the_first_sample_wherever_the_samples_are_cut(tanks):
    table, rng = tanks["sampled"].isolation, np.random.default_rng(4)
    found, _ = Findings.room(4000, [h.watch for h in tanks["sampled"].hypotheses])
    for part in (found.shares, found.amplitude):
        part[:] = rng.exponential(1.0, part.shape)
    found.peak[:] = np.stack([found.shares[:, a:b].max(axis=1) for a, b in pairwise(table.begins[0].astype(int))]).T
    parts = [
        table.ask(Findings(*(part[a:b] for part in vars(found).values())), a)[0] for a, b in ((0, 1500), (1500, 4000))
    ]
    np.testing.assert_array_equal(np.vstack(parts), table.ask(found, 0)[0])


@pytest.mark.parametrize(("kind", "lacks"), [("continuous", ()), ("continuous", (1, 2)), ("sampled", ())])
def test_what_a_start_does_to_the_tests_is_what_is_computed(tanks, kind, lacks):
    """The errors with the fault minus those without, which is linear, against ζ from its first value on."""
    t, u, y = filled(np.random.default_rng(1), 300, kind, 0.0, x=1.0)
    y[0, lacks] = np.nan
    F = np.array([1.0, 0.0, 0.0])
    for h in tanks[kind].hypotheses:
        watch, system, errors = h.watch, error_system(h.watch.plant, h.watch.estimator), []
        for seen in (y, y + F):
            guess = watch.bounds.beginning.guess(u[0], seen[0])
            assert (guess is None) == bool(lacks)
            trace = watch.estimator.replay(t, u, seen, x=guess)
            errors.append(np.hstack([trace.fault, seen - trace.state @ watch.plant.C.T]))
        newest = observer_step(watch.estimator).B1
        zeta = _starts(watch, newest, len(system.M), FaultChannel("a", {"a": 1.0}))[:, 2 if lacks else 0]
        into, out = (part @ F for part in system.reading)
        shown = []
        for _ in range(300):
            shown.append((system.C @ zeta + out)[: system.faults + system.sensors])
            zeta = system.M @ zeta + into
        tested = np.isfinite(watch.limits[0])
        # sums of some hundred numbers of size 1
        np.testing.assert_allclose((errors[1] - errors[0])[1:, tested], np.array(shown)[1:, tested], atol=1e-11)


def test_a_start_is_over_when_a_loop_over_the_samples_says_so():
    """Slow enough that the filters carry what they hold through several blocks."""
    rng, rho, poles = np.random.default_rng(12), 0.9999, np.array([0.0, 0.99, 0.998])
    M, C = np.array([[0.995, 0.004], [-0.004, 0.995]]), rng.normal(size=(4, 2))
    starts, limits = rng.normal(size=(2, 3, 2)), rng.uniform(0.05, 0.2, (3, 4))
    share, sizes = rng.uniform(0.5, 2.0, (3, 4, 3)), np.array([1.0, 2.0, 5.0])
    done, left = _over(Outputs(M / rho, C), starts, poles, rho, limits, share, sizes)
    enough = np.maximum(LATER * share, LITTLE / sizes)

    rows, X, held = 20 * BLOCK, starts.reshape(2, 6), np.zeros((3, 4, 3))
    tests = np.empty((rows, 3, 4, 3))
    for k in range(rows):
        size = np.abs(C @ X).reshape(4, 3, 2).max(axis=2)
        held = (poles / rho)[:, None, None] * held + (1.0 - poles)[:, None, None] * size
        tests[k], X = held / limits[:, :, None], M / rho @ X
    last = [int(np.flatnonzero(np.any(tests[..., j] > enough[..., j], axis=(1, 2)))[-1]) + 1 for j in range(3)]
    assert min(last) > 2 * BLOCK
    assert done.tolist() == last
    for j, at in enumerate(last):
        np.testing.assert_allclose(left[..., j], tests[at:, ..., j].max(axis=0), rtol=1e-9)
