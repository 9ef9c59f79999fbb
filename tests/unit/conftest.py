# SPDX-License-Identifier: BSD-3-Clause
"""Small plants under a monitor: hand-made observers, so that nothing has to be designed."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from faultrecon.graph.observer import Observer
from faultrecon.numerics.discretise import foh, zoh
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction

SIZE = 0.05  # of the force that disturbs the cart


@dataclass(frozen=True)
class Made:
    """As much of a design as a monitor needs."""

    plant: Plant
    observer: Observer
    method: str = "by hand"
    gains: dict = field(default_factory=dict)

    def estimator(self, sample_time, hold="linear", engine="auto"):
        C, D = self.plant.C, self.plant.D
        return Estimator.build(self.observer, sample_time, hold=hold, engine=engine, prediction=Prediction(C, D))


def healthy_observer(plant):
    """A Kalman filter on the sensors that no fault reaches; each fault is what its sensor shows beyond it."""
    from scipy.linalg import solve_continuous_are

    n, p, m = plant.n, plant.p, plant.B.shape[1]
    F = plant.F_f
    C = plant.C * ~np.any(F != 0, axis=1)[:, None]
    L = solve_continuous_are(plant.A.T, C.T, np.eye(n), 0.3 * np.eye(p)) @ C.T / 0.3
    return Observer(
        plant.A - L @ C, np.hstack([plant.B - L @ plant.D, L]), np.eye(n), np.zeros((n, m + p)), -F.T @ plant.C,
        np.hstack([-F.T @ plant.D, F.T]), F, *(np.array(v) for v in (plant.point.x, plant.point.u, plant.point.y)),
    )  # fmt: skip


def cart_plant(sd=0.01, ranges=(2.0, 2.0)):
    """A mass on a spring: two position sensors, a speed sensor, and a mix of both."""
    signals = Signals(
        Channels(("s", "v"), ranges=ranges),
        Channels(("force",), ranges=(2.0,)),
        Channels(("s1", "s2", "v1", "mix"), ranges=(2.0, 2.0, 2.0, 2.0)),
    )
    A, B = np.array([[0.0, 1.0], [-1.0, -0.8]]), np.array([[0.0], [1.0]])
    C = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    push = Disturbance("push", {"v": 1.0}, size=SIZE)
    noise = Noise(0.05, (sd,) * 4)
    return Plant("cart", signals, A, B, C, np.zeros((4, 1)), disturbances=(push,), noise=noise)


def bank_by_hand(plant, sensors=None, together=()):
    """A bank of hand-made observers: one for each sensor, and for sets of them."""
    from faultrecon.synthesis.bank import Bank

    names = plant.signals.y.names if sensors is None else sensors
    sets = [(name,) for name in names] + [tuple(one) for one in together]
    faults = {name: FaultChannel(name, {name: 1.0}, size=2.0) for name in plant.signals.y.names}
    designs = {}
    for one in sets:
        own = replace(plant, faults=tuple(faults[name] for name in one))
        designs[" + ".join(one)] = Made(own, healthy_observer(own))
    return Bank(replace(plant, faults=tuple(faults[name] for name in names)), designs)


def sampled(plant, rng, rows, T=0.05, faults=None, gaussian=True, crest=1.0, start=None):
    """A log (t, u, y) with noise and disturbances within bounds; faults: sensor to values (rows,)."""
    E = np.array([[w.into.get(name, 0.0) for w in plant.disturbances] for name in plant.signals.x])
    Phi, W = zoh(plant.A, E, T)
    _, U0, U1 = foh(plant.A, plant.B, T)
    t = np.arange(rows) * T
    u = np.sin(0.7 * t)[:, None] * np.ones(plant.B.shape[1])
    w = crest * np.repeat(np.sign(rng.normal(size=(rows // 9 + 1, E.shape[1]))), 9, axis=0)[:rows]
    w = w * [d.size for d in plant.disturbances]
    driven = w @ W.T + u @ U0.T
    driven[:-1] += u[1:] @ U1.T
    x = np.zeros((rows, plant.n))
    x[0] = 0.0 if start is None else start
    for k in range(rows - 1):
        x[k + 1] = Phi @ x[k] + driven[k]
    v = rng.normal(size=(rows, plant.p)) if gaussian else rng.uniform(-1.7, 1.7, (rows, plant.p))
    y = x @ plant.C.T + u @ plant.D.T + v * np.array(plant.noise.sd)
    for name, values in (faults or {}).items():
        y[:, plant.signals.y.index(name)] += values
    return t, u, y


@pytest.fixture
def cart():
    return cart_plant()


@pytest.fixture(scope="session")
def cart_monitor():
    """Every sensor of the cart may fail; the answer of a second."""
    return bank_by_hand(cart_plant()).monitor(spans=(0.5, 2.5), window=10, crest=1.0, false_alarms=0.01)


@pytest.fixture(scope="session")
def drive():
    """`drive(plant, rng, rows, ...)`: a log of a plant; see `sampled`."""
    return sampled


@pytest.fixture(scope="session")
def by_hand():
    """`by_hand(plant, sensors, together)`: a bank of hand-made observers."""
    return bank_by_hand
