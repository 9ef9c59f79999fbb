# SPDX-License-Identifier: BSD-3-Clause
"""What absences do is looked for when something is missing, and that changes no bit of what comes out."""

import math
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are

from faultrecon.graph.observer import Observer
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.runtime.bounds import Allowance, bounds
from faultrecon.runtime.errors import error_system
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.runtime.watch import Batch, Findings, Watch, filters

T, ROWS, FIRST = 0.05, 420, 260  # the row of the first gap


class Eager(Watch):
    """A watch that reads what absences do whether anything is missing or not."""

    @cached_property
    def _none_missing(self):
        return self._some_missing


def watch(kind=Watch):
    """A swinging plant with two sensors, the first of them at fault, and a Kalman filter for states and fault."""
    names = Signals(Channels(("a", "b"), ranges=(1.0, 1.0)), Channels(("u",), ranges=(1.0,)), Channels(("y0", "y1")))
    A, B, C = np.array([[0.0, 1.0], [-2.0, -0.6]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0], [1.0, 1.0]])
    faults = (FaultChannel("f", {"y0": 1.0}, size=1.0, rate=0.2),)
    noise, w = Noise(T, (0.01, 0.01)), (Disturbance("w", {"b": 1.0}, size=0.1),)
    plant = Plant("swing", names, A, B, C, np.zeros((2, 1)), faults, w, noise=noise)
    whole, seen = np.zeros((3, 3)), np.hstack([C, plant.F_f])
    whole[:2, :2] = A
    L = solve_continuous_are(whole.T, seen.T, np.diag([1.0, 1.0, 10.0]), np.eye(2)) @ seen.T
    observer = Observer(
        whole - L @ seen, np.hstack([np.vstack([B, np.zeros((1, 1))]), L]), np.eye(2, 3), np.zeros((2, 3)),
        np.eye(1, 3, 2), np.zeros((1, 3)), plant.F_f, np.zeros(2), np.zeros(1), np.zeros(2),
    )  # fmt: skip
    estimator = Estimator.build(observer, T, engine="casadi", prediction=Prediction(C, plant.D))
    poles = filters(T, [10 * T, 100 * T])
    return kind(plant, estimator, bounds(plant, estimator, error_system(plant, estimator), Allowance(), poles), poles)


def log():
    """Complete until `FIRST`; then rows, an input and sensors are missing, each by itself, and complete again."""
    rng = np.random.default_rng(3)
    t, u, y = np.arange(ROWS) * T, rng.normal(size=(ROWS, 1)), 0.05 * rng.normal(size=(ROWS, 2))
    u[FIRST + 20 : FIRST + 22] = math.nan
    y[FIRST + 40 : FIRST + 43, 1] = math.nan
    y[FIRST + 60, 0] = math.nan
    keep = np.ones(ROWS, dtype=bool)
    keep[FIRST : FIRST + 3] = False
    return t[keep], u[keep], y[keep]


def looked(one, pieces, resumed=None):
    """All that is written, and the state at the end, of a log in pieces; another watch goes on after the first."""
    t, u, y = log()
    waits = np.diff(t, prepend=t[0] - T) / T
    seen, _ = Findings.room(len(t), [one])
    for table in vars(seen).values():
        table[:] = 0.0
    live, before = one.init(), None
    edges = [0, *pieces, len(t)]
    for a, b in pairwise(edges):
        here = slice(a, b)
        trace = one.estimator.replay(t[here], u[here], y[here], state=before)
        part = Findings(*(table[here] for table in vars(seen).values()))
        live, before = one.look(live, Batch.of(u[here], y[here], waits[here]), trace, part), trace.end
        one = one if resumed is None else resumed
    return [*vars(seen).values(), live]


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(1, ROWS - 5), max_size=4, unique=True).map(sorted), st.booleans())
def test_late_gaps_give_the_same_bits_as_when_all_is_known_beforehand(pieces, compiled):
    """Wherever the log is cut; and where another watch, that knows nothing yet, goes on from what was kept."""
    wanted = looked(replace(EAGER, compiled=compiled), [])
    one, other = (replace(LAZY, bounds=fresh(), compiled=compiled) for _ in range(2))
    for found in (looked(one, pieces), looked(one, pieces, resumed=other)):
        for a, b in zip(found, wanted, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("missing", ["row", "input", "sensor"])
def test_absences_are_not_looked_for_before_something_is_missing(missing):
    one = replace(LAZY, bounds=fresh())
    u, y, waits = np.zeros((10, 1)), np.zeros((10, 2)), np.ones(10)
    trace, (seen, _) = one.estimator.replay(np.arange(10) * T, u, y), Findings.room(10, [one])
    live = one.look(one.init(), Batch.of(u, y, waits), trace, seen)
    assert "absences" not in vars(one.bounds)
    waits[4] += missing == "row"
    u[4] = math.nan if missing == "input" else 0.0
    y[4, 1] = math.nan if missing == "sensor" else 0.0
    one.look(live, Batch.of(u, y, waits), trace, seen)
    assert "absences" in vars(one.bounds)


def test_who_cannot_wait_finds_out_beforehand():
    one = replace(LAZY, bounds=fresh())
    one.ready()
    assert "absences" in vars(one.bounds)


def test_asking_what_is_assumed_finds_out_too():
    assert any("missing inputs and silent sensors" in said for said in fresh().assumptions)


def fresh():
    """Bounds that know nothing of absences yet."""
    return replace(LAZY.bounds)


LAZY, EAGER = watch(), watch(Eager)
