# SPDX-License-Identifier: BSD-3-Clause
"""What a method is tried on: small plants, the awkward cousins of a plant, and a trial that computes things once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import FaultreconError
from faultrecon.graph.function import Graph
from faultrecon.methods.base import Method, Theorem
from faultrecon.methods.registry import offered
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import Lipschitz
from faultrecon.plant.matrices import plant_from_matrices
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Noise, Signals

if TYPE_CHECKING:
    from faultrecon.runtime.estimator import Estimator
    from faultrecon.synthesis.result import Design

Array = NDArray[np.float64]

SETTLING = 4000
"""Steps in which an observer with injections settles on a constant fault."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A method on a plant that meets its assumptions; what several checks need is computed once."""

    method: Method
    plant: Plant

    @cached_property
    def design(self) -> Design:
        """The method's design; for a baseline that cannot be certified here, its gains without a proof."""
        return self._designed()

    def _designed(self) -> Design:
        from faultrecon.synthesis.pipeline import design

        with offered(self.method):
            try:
                return design(self.plant, self.method.name)
            except FaultreconError:
                if not self.method.baseline or self.method.gains_without_proof(self.plant) is None:
                    raise
                return design(self.plant, self.method.name, certify=False)

    @cached_property
    def theorem(self) -> Theorem:
        """The theorem for this plant, in the units of a design."""
        from faultrecon.synthesis.levels import scale

        return self.method.theorem(self.plant, scale(self.plant))

    @property
    def sample_time(self) -> float:
        """Seconds between the samples of `log`."""
        return 0.01 if self.plant.noise is None else self.plant.noise.hold

    @cached_property
    def estimator(self) -> Estimator:
        """The design's estimator."""
        with offered(self.method):
            return self.design.estimator(self.sample_time)

    @cached_property
    def constant_gain(self) -> Array:
        """From constant faults to their estimates once the observer has settled, (q, q), in declared sizes.

        Off the matrices of a linear part that decides it; an injection takes part in it, so the observer is then
        stepped for twelve of its slowest time constants.
        """
        o, plant = self.design.observer, self.plant
        size = np.array([f.size for f in plant.faults])
        if not o.injections:
            rest = np.eye(len(o.A)) - o.A if o.sample_time is not None else -o.A
            gain = o.Cf @ np.linalg.solve(rest, o.B[:, o.inputs :] @ o.F) + o.Df[:, o.inputs :] @ o.F
            return gain * size / size[:, None]
        h = 12.0 / float(np.abs(np.real(o.poles)).min()) / SETTLING
        with offered(self.method):
            estimator = self.design.estimator(h, hold="left")
        t, u, gain = h * np.arange(SETTLING), np.tile(o.u0, (SETTLING, 1)), np.empty((len(size), len(size)))
        for k, fault in enumerate(size):
            y = np.tile(o.y0 + fault * o.F[:, k], (SETTLING, 1))
            gain[:, k] = estimator.replay(t, u, y).fault[-1] / size
        return gain

    @cached_property
    def log(self) -> tuple[Array, Array, Array]:
        """Forty samples of no particular meaning, the same every time: t (N,), u (N, m), y (N, p)."""
        rng, N, point = np.random.default_rng(2011), 40, self.plant.point
        move = [rng.normal(size=(N, len(values))) for values in (point.u, point.y)]
        return (
            np.arange(N, dtype=float) * self.sample_time,
            np.array(point.u) + move[0],
            np.array(point.y) + 0.1 * move[1],
        )


def trial_plants() -> tuple[Plant, ...]:
    """Small plants with additive sensor faults, so that every kind of method finds one it can do.

    spring: linear, with a redundant sensor; pendulum: Lipschitz, about a point, with D and noise; cart: as many sensors
    as states; balance: unstable in a mode that only the faulty sensor sees; drive: an actuator fault, and a
    disturbance to decouple.
    """
    spring = plant_from_matrices(
        [[0, 1], [-10, -1]],
        [[0], [1]],
        [[1, 0], [1, 0], [0, 1]],
        np.zeros((3, 1)),
        name="spring",
        states=["position [m]", "velocity [m/s]"],
        inputs=["force [N]"],
        outputs=["position_a [m]", "position_b [m]", "speed [m/s]"],
        faults=[FaultChannel("drift", {"position_b": 1.0}, size=0.5)],
        disturbances=[
            Disturbance("push", {"velocity": 1.0}),
            Disturbance("hum", {}, {"position_a": 0.1, "speed": 0.1}),
        ],
    )
    return spring, _pendulum(spring), _cart(spring), _balance(), _drive()


def _pendulum(spring: Plant) -> Plant:
    """Lipschitz, about a point, with D and noise."""
    signals = Signals(spring.signals.x, spring.signals.u, Channels.declared(["position_a [m]", "position_b [m]"]))
    return replace(
        spring,
        name="pendulum",
        signals=signals,
        A=np.array([[0.0, 1.0], [-9.0, -2.0]]),
        C=np.array([[1.0, 0.0], [1.0, 0.25]]),
        D=np.array([[0.0], [0.5]]),
        disturbances=(Disturbance("push", {"velocity": 1.0}), Disturbance("hum", {}, {"position_a": 0.1})),
        nonlinearity=Lipschitz(
            np.array([[0.0], [1.0]]),
            ("position",),
            Graph.from_texts(["0.5 * sin(position)"], {"x": ["position"], "u": ["force"], "t": ["t"]}),
            0.5,
        ),
        noise=Noise(0.02, (1e-3, 2e-3)),
        operating_point=OperatingPoint((0.1, 0.0), (1.0,), (0.1, 0.6)),
    )


def _cart(spring: Plant) -> Plant:
    """As many sensors as states, and nothing that disturbs."""
    return replace(
        spring,
        name="cart",
        signals=Signals(spring.signals.x, spring.signals.u, Channels.declared(["position_b [m]", "speed [m/s]"])),
        C=np.array([[1.0, 0.0], [0.0, 1.0]]),
        D=np.zeros((2, 1)),
        disturbances=(),
        operating_point=None,
    )


def _balance() -> Plant:
    """Unstable in a mode that only the faulty sensor sees."""
    return plant_from_matrices(
        [[0, 1, 0], [4, -1, 0], [0, 0, -1]],
        [[0], [1], [1]],
        [[0, 1, 0], [0, 0, 1]],
        np.zeros((2, 1)),
        name="balance",
        states=["angle [rad]", "rate [rad/s]", "speed [m/s]"],
        inputs=["torque [N m]"],
        outputs=["gyro [rad/s]", "tacho [m/s]"],
        faults=[FaultChannel("drift", {"gyro": 1.0}, size=0.5)],
        disturbances=[Disturbance("hum", {}, {"tacho": 0.1})],
    )


def _drive() -> Plant:
    """An actuator fault, and a disturbance that the sensors show at once."""
    return plant_from_matrices(
        [[0, 1, 0], [-6, -1, 3], [0, -1, -4]],
        [[0], [0], [4]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        np.zeros((3, 1)),
        name="drive",
        states=["angle [rad]", "speed [rad/s]", "current [A]"],
        inputs=["voltage [V]"],
        outputs=["encoder [rad]", "tacho [rad/s]", "ammeter [A]"],
        faults=[FaultChannel("drop", {"voltage": 1.0}, site="actuator", size=0.5)],
        disturbances=[
            Disturbance("load", {"speed": 1.0}, role="decouple"),
            Disturbance("ripple", {"current": 0.1}),
        ],
        noise=Noise(0.02, (1e-3, 1e-2, 1e-2)),
    )


def awkward(plant: Plant) -> dict[str, Plant]:
    """The plant, and what becomes of it when somebody declares too much or too little."""
    sensors = [FaultChannel(f"fault {k}", {name: 1.0}) for k, name in enumerate(plant.signals.y.names)]
    found = {
        "the plant": plant,
        "no fault": replace(plant, faults=()),
        "every sensor faulty": replace(plant, faults=tuple(sensors)),
        "a fault twice": replace(plant, faults=(sensors[0], replace(sensors[0], name="again"))),
        "a multiplicative fault": replace(plant, faults=(replace(sensors[0], effect="multiplicative"),)),
        "no disturbance": replace(plant, disturbances=()),
        "an unstable plant": replace(plant, A=plant.A + (1.0 + np.abs(plant.A).sum()) * np.eye(plant.n)),
        "the other kind of time": replace(plant, sample_time=0.1 if plant.sample_time is None else None),
    }
    if len(plant.signals.u):
        fault = FaultChannel("leak", {plant.signals.u.names[0]: 1.0}, site="actuator")
        found["an actuator fault"] = replace(plant, faults=(fault,))
    return found


def reordered(plant: Plant, order: list[int]) -> Plant:
    """The same plant with its sensors listed in another order."""
    y, point = plant.signals.y, plant.point
    picked = Channels(
        tuple(y.names[k] for k in order),
        tuple(y.units[k] for k in order),
        tuple(y.ranges[k] for k in order),
        tuple(y.limits[k] for k in order),
    )
    known = plant.known
    if known is not None:
        g, back = known.g, [order.index(k) for k in range(plant.p)]
        sizes = {"y": plant.p, "u": len(plant.signals.u), "t": 1}
        moved = Graph.trace(lambda y, u, t: g.symbolic(y[back], u, t), sizes)
        inputs = {"y": picked.names, "u": plant.signals.u.names, "t": ("t",)}
        known = replace(known, g=replace(moved, inputs=inputs))
    return replace(
        plant,
        signals=replace(plant.signals, y=picked),
        known=known,
        C=plant.C[order],
        D=plant.D[order],
        noise=None if plant.noise is None else replace(plant.noise, sd=tuple(plant.noise.sd[k] for k in order)),
        operating_point=OperatingPoint(point.x, point.u, tuple(point.y[k] for k in order)),
    )
