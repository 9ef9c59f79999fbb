# SPDX-License-Identifier: BSD-3-Clause
"""What happens to a plant: inputs, faults, disturbances, noise, where it starts, and the seed of everything random.

    Scenario.step("pitch_rate", size=0.4, at=5.0).with_input("elevator", Doublet(0.02, 1.0).starting(2.0))

A scenario is a value and knows no plant; names are checked when it meets one.  How random signals are drawn is said in
`faultrecon.simulation.chance`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError, did_you_mean
from faultrecon.plant.plant import Plant
from faultrecon.simulation.chance import Table, held_edges, held_index, normal_samples, stream_seed
from faultrecon.simulation.composition import Shape
from faultrecon.simulation.shapes import Loss, Ramp, Sine, Step, Stuck, Waveform

Array = NDArray[Any]
Signal = Shape | Callable[[Array], Any] | Sequence[float] | NDArray[Any]
State = Mapping[str, float] | Sequence[float] | NDArray[Any] | None

PER_TIME_CONSTANT = 20.0
"""Samples per time constant of a plant's fastest mode, where neither the scenario nor the plant says a sample time."""
NOTHING = Step(0.0)
"""The waveform of a signal that a scenario leaves alone."""
SNAP = 1e-9
"""Of a sample time: an onset this close to a sample is on it."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """What happens, for `duration` seconds sampled every `sample_time` (the plant's noise hold by default).

    faults, inputs, disturbances: by name, a shape, a function of time, or one number per sample; in physical units,
    inputs as deviations from the operating point.  noise: whether the plant's declared sensor noise acts.
    x0: where the plant starts, by state name or in full, absolute (None: the operating point).  initial_error:
    x - x̂ at the start.  input_hold: "continuous", or "sample" when a digital controller holds u between samples.
    """

    duration: float = 20.0
    sample_time: float | None = None
    faults: Mapping[str, Signal] = field(default_factory=dict)
    inputs: Mapping[str, Signal] = field(default_factory=dict)
    disturbances: Mapping[str, Signal] = field(default_factory=dict)
    noise: bool = True
    seed: int = 0
    x0: State = None
    initial_error: State = None
    input_hold: Literal["continuous", "sample"] = "continuous"
    name: str = ""

    def __post_init__(self) -> None:
        for key, value in (("duration", self.duration), ("sample time", self.sample_time)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise InputError(f"the {key} is {value}", why="it is a positive number of seconds")
        if self.input_hold not in ("continuous", "sample"):
            raise InputError(f"inputs cannot be held '{self.input_hold}'", remedies=("use continuous or sample",))
        for group in ("faults", "inputs", "disturbances"):
            object.__setattr__(self, group, MappingProxyType(dict(getattr(self, group))))

    # ------------------------------------------------------------ constructors

    @staticmethod
    def healthy(**options: Any) -> Scenario:
        """No fault at all; options are the fields of a scenario."""
        return Scenario(**{"name": "healthy", **options})

    @staticmethod
    def fault(name: str, shape: Signal, **options: Any) -> Scenario:
        """One fault of any shape."""
        return Scenario(**{"name": f"{_word(shape)} on {name}", **options, "faults": {name: shape}})

    @staticmethod
    def step(name: str, *, size: float, at: float = 0.0, **options: Any) -> Scenario:
        """A bias of `size` from time `at` on."""
        return Scenario.fault(name, Step(size).starting(at), **options)

    @staticmethod
    def ramp(name: str, *, size: float, over: float, at: float = 0.0, **options: Any) -> Scenario:
        """An incipient fault that grows to `size` within `over` seconds."""
        return Scenario.fault(name, Ramp(size, over).starting(at), **options)

    @staticmethod
    def sine(name: str, *, amplitude: float, omega: float, at: float = 0.0, **options: Any) -> Scenario:
        """An oscillating fault, omega in rad/s, from a zero crossing at time `at` on."""
        return Scenario.fault(name, Sine(amplitude, omega).starting(at), **options)

    @staticmethod
    def loss(name: str, *, fraction: float, at: float = 0.0, **options: Any) -> Scenario:
        """The sensor loses a fraction of its effectiveness."""
        return Scenario.fault(name, Loss(fraction).starting(at), **options)

    @staticmethod
    def stuck(name: str, *, at: float, value: float | None = None, **options: Any) -> Scenario:
        """The sensor freezes, at a value or at the last thing it showed."""
        return Scenario.fault(name, Stuck(value).starting(at), **options)

    # ------------------------------------------------------------ variations

    def with_fault(self, name: str, shape: Signal) -> Scenario:
        """The same with one more fault."""
        return replace(self, faults={**self.faults, name: shape})

    def with_input(self, name: str, shape: Signal) -> Scenario:
        """The same with one more input."""
        return replace(self, inputs={**self.inputs, name: shape})

    def with_disturbance(self, name: str, shape: Signal) -> Scenario:
        """The same with one more disturbance."""
        return replace(self, disturbances={**self.disturbances, name: shape})

    def with_seed(self, seed: int) -> Scenario:
        """The same with other random signals."""
        return replace(self, seed=seed)

    def quiet(self) -> Scenario:
        """The same without sensor noise."""
        return replace(self, noise=False)

    def __repr__(self) -> str:
        parts = [f"{self.duration:g} s"]
        for word, group in (("faults", self.faults), ("inputs", self.inputs), ("disturbances", self.disturbances)):
            if group:
                parts.append(f"{word}: " + ", ".join(f"{k} ({_word(v)})" for k, v in group.items()))
        parts.append(f"noise {'on' if self.noise else 'off'}, seed {self.seed}")
        return f"Scenario({self.name + ': ' if self.name else ''}{'; '.join(parts)})"


@dataclass(frozen=True, eq=False)
class Schedule:
    """A scenario that has met its plant: sampling times (N,), and a seeded shape per signal in the plant's order.

    noise: (N, p) as the sensors would add it.  x0, x_hat0: (n,) absolute.  hold: how long sensor noise is constant.
    """

    plant: Plant
    t: Array
    inputs: tuple[Shape, ...]
    faults: tuple[Shape, ...]
    disturbances: tuple[Shape, ...]
    noise: Array
    noise_seeds: tuple[int, ...]
    x0: Array
    x_hat0: Array
    input_hold: Literal["continuous", "sample"]

    @property
    def end(self) -> float:
        """The last sampling time."""
        return float(self.t[-1])

    def noise_at(self, t: float) -> Array:
        """Sensor noise at one instant, (p,), for a plant that feeds measurements back through g."""
        noise = self.plant.noise
        if noise is None or not self.noise_seeds:
            return np.zeros(self.plant.p)
        k = int(held_index(np.array(t), noise.hold))
        return np.array([sd * normal_samples(s, k + 1)[k] for sd, s in zip(noise.sd, self.noise_seeds, strict=True)])


def schedule(plant: Plant, scenario: Scenario) -> Schedule:
    """Names checked, shapes seeded, onsets put on the sampling grid.  Raises InputError on names nobody declared."""
    h = scenario.sample_time or default_sample_time(plant)
    if plant.sample_time is not None and abs(h - plant.sample_time) > SNAP * h:
        raise InputError(f"the scenario samples every {h:g} s", why=f"the plant steps every {plant.sample_time:g} s")
    steps = math.floor(scenario.duration / h + SNAP)
    if steps < 1:
        raise InputError(f"{scenario.duration:g} s hold no sample of {h:g} s")
    held = scenario.input_hold == "sample" or plant.sample_time is not None

    def draw(label: str) -> int:
        return stream_seed(scenario.seed, label)

    groups = {
        "inputs": (plant.signals.u.names, scenario.inputs, "input"),
        "faults": (tuple(f.name for f in plant.faults), scenario.faults, "fault"),
        "disturbances": (tuple(d.name for d in plant.disturbances), scenario.disturbances, "disturbance"),
    }
    shapes = {key: _shapes(*group, h, draw) for key, group in groups.items()}
    t = h * np.arange(steps + 1)
    edges = [s for group in shapes.values() for shape in group for s in shape.breakpoints(t[-1])]
    acts = scenario.noise and plant.noise is not None and any(plant.noise.sd)
    if acts and plant.noise is not None:
        edges += held_edges(plant.noise.hold, t[-1])
    t = _snapped(t, edges, h)
    seeds = tuple(draw(f"noise/{name}") for name in plant.signals.y) if acts else ()
    noise = np.zeros((len(t), plant.p))
    if acts and plant.noise is not None:
        index = held_index(t, plant.noise.hold)
        for j, (sd, seed) in enumerate(zip(plant.noise.sd, seeds, strict=True)):
            noise[:, j] = sd * normal_samples(seed, int(index[-1]) + 1)[index]
    x0 = _state(plant, scenario.x0, np.array(plant.point.x), "x0")
    error = _state(plant, scenario.initial_error, np.zeros(plant.n), "initial_error")
    groups_of = (shapes["inputs"], shapes["faults"], shapes["disturbances"])
    return Schedule(plant, t, *groups_of, noise, seeds, x0, x0 - error, "sample" if held else "continuous")


def default_sample_time(plant: Plant) -> float:
    """The plant's own, or its noise's hold, or a twentieth of its fastest time constant rounded down to 1, 2, 5."""
    if plant.sample_time is not None:
        return plant.sample_time
    if plant.noise is not None:
        return plant.noise.hold
    fastest = float(np.abs(np.linalg.eigvals(plant.A)).max())
    wanted = 1.0 / (PER_TIME_CONSTANT * fastest) if fastest > 0 else 0.01
    decade = 10.0 ** math.floor(math.log10(wanted))
    return float(f"{max(k for k in (1, 2, 5) if k * decade <= wanted * (1 + 1e-9)) * decade:.12g}")


def as_shape(signal: Signal, sample_time: float) -> Shape:
    """A shape from whatever a scenario may be given: one number per sample runs in straight lines between."""
    if isinstance(signal, Shape):
        return signal
    if callable(signal):
        return Waveform(signal)
    return Table.sampled(np.asarray(signal, dtype=float), sample_time)


def _shapes(
    names: Sequence[str], given: Mapping[str, Signal], what: str, h: float, draw: Callable[[str], int]
) -> tuple[Shape, ...]:
    for name in given:
        if name not in names:
            raise InputError(f"there is no {what} '{name}'", why=did_you_mean(name, names))
    return tuple(
        as_shape(given[name], h).seeded(lambda s, name=name: draw(f"{what}/{name}/{s}")) if name in given else NOTHING
        for name in names
    )


def _snapped(t: Array, edges: Sequence[float], h: float) -> Array:
    """The grid with every onset that lies on it up to rounding set to the onset exactly."""
    t = t.copy()
    for s in sorted(set(edges)):
        k = round(s / h)
        if 0 <= k < len(t) and abs(s - k * h) <= SNAP * h + 4 * math.ulp(s):
            t[k] = s
    return t


def _state(plant: Plant, given: State, rest: Array, what: str) -> Array:
    if given is None:
        return rest
    if isinstance(given, Mapping):
        out = rest.copy()
        for name, value in given.items():
            out[plant.signals.x.index(name)] = value
    else:
        out = np.array(given, dtype=float)
    if out.shape != (plant.n,) or not np.isfinite(out).all():
        raise InputError(f"{what} is {given!r}", why=f"it takes {plant.n} finite numbers, or a table by state name")
    return out


def _word(signal: Signal) -> str:
    """What to call a waveform in one word."""
    if isinstance(signal, Shape):
        inner = signal
        while hasattr(inner, "shape"):
            inner = inner.shape  # type: ignore[attr-defined]  # Shifted and Windowed wrap one
        return type(inner).__name__.lower()
    return "function" if callable(signal) else "table"
