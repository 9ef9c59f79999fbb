# SPDX-License-Identifier: BSD-3-Clause
"""Which fault may excuse which test: by what it can do there, and no more."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from faultrecon.graph.compiled import obstacle
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.runtime.errors import error_system
from faultrecon.runtime.isolation import _ask, _compiled, isolation
from faultrecon.runtime.watch import Batch, Findings
from faultrecon.runtime.watch import _compiled as compiled_watch
from faultrecon.runtime.watchloop import pass_over


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
    peaks = np.column_stack([shares[:, a:b].max(axis=1) for a, b in pairwise(begins)])
    found = [np.empty((400, table.first.shape[1])) for _ in range(2)]
    assert _compiled() is not _ask
    for ask, out in zip((_compiled(), _ask), found, strict=True):
        ask(shares, peaks, amplitudes, table.excuse, table.first, table.begins, out)
    np.testing.assert_array_equal(*found)
