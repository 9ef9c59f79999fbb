# SPDX-License-Identifier: BSD-3-Clause
"""The reactor of Bezzaoucha et al. 2013 simulated, and every estimator on the same readings.

The paper prints neither a, nor the input, nor a fault, nor a gain, nor a length.  Chosen here: a = 0.5, which the
printed range of z2 implies; u(t) = 0.33 + 0.08 sin(2πt/17) + 0.04 sin(2πt/5.3); 140 h from (0.1, 1.5), the estimate
from (0.09, 2.3) and f̂ = 0; no fault before 60 h, then a step, a ramp or a sine.  Noise: sd 0.02 every 0.1 h, straight
lines in between.  Observers run on samples every 0.02 h, Kalman filters on those every 0.1 h.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.observer import Observer
from faultrecon.io.library import read_library
from faultrecon.methods.registry import all_methods
from faultrecon.methods.takagi_sugeno import TsPublished
from faultrecon.numerics.integrate import reference_solution
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Noise
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.simulation.chance import normal_samples, stream_seed
from faultrecon.synthesis.pipeline import design

Array = NDArray[Any]

STEP, EVERY, DURATION = 0.02, 5, 140.0
"""Sample time of the observers, h; samples of it between two of the sensor and of the filters; length, h."""
NOISE, SEEDS = 0.02, 2
X0, BELIEVED = (0.1, 1.5), (0.09, 2.3)
ONSET, FREE = 60.0, (40.0, 59.8)
CONSTANTS = {"a": 0.5, "b": 0.07, "c": 0.7, "d": 2.5}
SHAPES: Mapping[str, Callable[[Array], Array]] = {
    "step": lambda t: np.where(t < 60, 0.0, np.where(t < 100, 0.25, 0.5)),
    "ramp": lambda t: np.where(t < 60, 0.0, 0.125 + 0.5 * (t - 60) / 80),
    "sine": lambda t: np.where(t < 60, 0.0, 0.375 + 0.25 * np.sin(2 * np.pi * (t - 60) / 40)),
    "start": lambda t: np.full_like(t, 0.4),
}


# ---------------------------------------------------------------- plants


@cache
def reactor() -> Plant:
    """The library plant: a box around the operating point, noise and rates as declared."""
    return read_library("activated_sludge")


def boxed(
    plant: Plant,
    biomass: tuple[float, float],
    substrate: tuple[float, float],
    dilution: tuple[float, float],
    **more: Any,
) -> Plant:
    """The same plant for another box; more: further parts of the polytopic form."""
    box = {"biomass": biomass, "substrate": substrate, "dilution": dilution}
    assert plant.polytopic is not None, "the library plant has one"
    return replace(plant, polytopic=replace(plant.polytopic, box=box, **more))


def loud(plant: Plant, root: float) -> Plant:
    """The same plant with sd times the root of the hold time equal to `root`."""
    return replace(plant, noise=Noise(0.09, (root / 0.3,)))


def driven(plant: Plant, size: float, rate: float) -> Plant:
    """The same plant with disturbances of one size and faults of one rate."""
    return replace(
        plant,
        disturbances=tuple(replace(w, size=size) for w in plant.disturbances),
        faults=tuple(replace(f, rate=rate) for f in plant.faults),
    )


BOUNDS = {"z1": (-1.0, -0.2), "z2": (0.004, 15.0)}
WIDE = ((0.02, 3.6), (0.05, 2.4), (0.2, 1.0))
MIDDLE = ((2.3, 3.6), (0.04, 0.7), (0.21, 0.45))


@cache
def printed() -> Plant:
    """Section IV as printed: premise box and fault interval."""
    return boxed(reactor(), *WIDE, bounds=BOUNDS, faults={"fouling": (0.125, 0.625)})


@cache
def repaired() -> Plant:
    """R1: the printed vertices, x1 in [1, 3.6], f in [-0.05, 0.65], r_n = 6e-3."""
    return loud(boxed(reactor(), (1.0, 3.6), (0.05, 2.4), (0.2, 1.0), bounds=BOUNDS), 6e-3)


@cache
def narrow() -> Plant:
    """C1: the box of the library plant, r_n = 6e-3/3 after division by the reading."""
    return loud(reactor(), 6e-3)


# ---------------------------------------------------------------- the truth


def dilution(t: Any) -> Any:
    """u(t), 1/h."""
    return 0.33 + 0.08 * np.sin(2 * np.pi * t / 17) + 0.04 * np.sin(2 * np.pi * t / 5.3)


def right_side(x: Any, u: Any, k: Mapping[str, float]) -> list[Any]:
    """The plant's equation with constants of one's own."""
    g = k["a"] * x[1] / (x[1] + k["b"])
    return [(g - u) * x[0], -k["c"] * g * x[0] + (k["d"] - x[1]) * u]


def times() -> Array:
    """Every 0.02 h."""
    return STEP * np.arange(round(DURATION / STEP) + 1)


@lru_cache(maxsize=4)
def states(wrong: str = "") -> Array:
    """x (N, 2); wrong: the constant of the plant that is two percent larger than the model says."""
    k = {**CONSTANTS, **({wrong: 1.02 * CONSTANTS[wrong]} if wrong else {})}
    return reference_solution(
        lambda t, x: np.array(right_side(x, dilution(t), k)), list(X0), times(), rtol=1e-10, atol=1e-12
    )


@dataclass(frozen=True)
class Case:
    """What happens: shape of the fault, the constant that is off, and the seed of the noise or None."""

    shape: str
    wrong: str = ""
    seed: int | None = None

    @property
    def t(self) -> Array:
        """Times (N,), h."""
        return times()

    @property
    def f(self) -> Array:
        """The true fault (N,)."""
        return SHAPES[self.shape](times())

    @property
    def x(self) -> Array:
        """The true states (N, 2)."""
        return states(self.wrong)

    @property
    def y(self) -> Array:
        """What the sensor shows, (N, 1)."""
        y = (1.0 + self.f) * self.x[:, 0]
        if self.seed is not None:
            drawn = NOISE * normal_samples(stream_seed(self.seed, "noise/0"), (len(y) - 1) // EVERY + 1)
            y = y + np.interp(times(), times()[::EVERY], drawn)
        return y[:, None]


# ---------------------------------------------------------------- estimators


@dataclass(frozen=True, eq=False)
class Entry:
    """One row of the table: a letter, what it is, the method, its plant, what is fixed, and how it is run.

    method: None for gains by hand, which `observer` then gives.  sampled: whether it runs every 0.1 h and shows, at a
    sample, what it knew before it: its estimate is then read one sample later, as filters are by those who tune them.
    """

    row: str
    about: str
    method: str | None
    plant: Callable[[], Plant] = reactor
    fix: Mapping[str, Any] = field(default_factory=dict)
    observer: Callable[[], Observer] | None = None
    sampled: bool = False

    @property
    def there(self) -> bool:
        """Whether this installation has the method, and it takes the plant."""
        if self.method is None:
            return True
        known = all_methods()
        return self.method in known and not any(
            f.severity == "fatal" for f in known[self.method].assumptions(self.plant())
        )


def by_hand(L: tuple[float, float], K: float, alpha: float, plant: Plant | None = None) -> Observer:
    """The published observer (14) with gains of one's own, the same at every vertex."""
    gains = {f"L{i}": np.reshape(L, (2, 1)) for i in range(1, 5)}
    gains |= {f"K{i}": np.array([[K]]) for i in range(1, 5)} | {f"α{i}": np.array([[alpha]]) for i in range(1, 5)}
    return TsPublished().observer(plant or printed(), gains)


def made(plant: Plant, name: str, fix: Mapping[str, Any] | None = None) -> Any:
    """A design, remembered while the tables are made."""
    return _made(plant, name, tuple(sorted((fix or {}).items())))


@lru_cache(maxsize=32)
def _made(plant: Plant, name: str, fix: tuple[tuple[str, Any], ...]) -> Any:
    return design(plant, name, fix=dict(fix)) if fix else design(plant, name)


@lru_cache(maxsize=32)
def observer_of(entry: Entry) -> Observer:
    """The observer of a row."""
    if entry.observer is not None:
        return entry.observer()
    assert entry.method is not None, "a row has a method or gains by hand"
    return made(entry.plant(), entry.method, entry.fix).observer


def estimated(entry: Entry, case: Case) -> tuple[Array, Array]:
    """f̂ (N,) and x̂ (N, 2) every 0.02 h."""
    plant, t, sampled = reactor(), case.t, entry.sampled
    every = EVERY if sampled else 1
    estimator = Estimator.build(observer_of(entry), STEP * every, prediction=Prediction(plant.C, plant.D))
    # A filter holds the input it is given over its sample: the value in the middle of it is what acts on average.
    u = dilution(t[::every] + (0.5 * STEP * every if sampled else 0.0))[:, None]
    trace = estimator.replay(t[::every], u, case.y[::every], x=BELIEVED)
    if not sampled:
        return trace.fault[:, 0], trace.state
    # The fault of the next prediction is the estimate with this sample: a random walk is predicted to stay.
    later = np.append(trace.fault[1:, 0], trace.fault[-1, 0])
    x = np.stack([np.interp(t, t[::every], column) for column in trace.state.T], axis=1)
    return np.interp(t, t[::every], later), x


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def error(entry: Entry, case: Case, window: tuple[float, float] = (ONSET, DURATION)) -> float:
    """RMSE of f in a window, its end left out."""
    t = case.t
    inside = (t >= window[0] - 1e-9) & (t < window[1] - 1e-9)
    return rms((estimated(entry, case)[0] - case.f)[inside])
