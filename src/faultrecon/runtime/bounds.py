# SPDX-License-Identifier: BSD-3-Clause
"""How sure: a bound on each reconstructed fault, and on each residual, that follows from what is declared.

Every sample carries  |f̂ - f| ≤ bound.  The bound has parts: disturbances within `crest` times their declared size,
faults that move no faster than their declared rate, signals that do between samples what the estimator takes them to
do, up to their declared ranges, a nonlinearity within its Lipschitz constant, noise, and what is left of an unknown
start.  Noise is either bounded (`Noise is "bounded"`: nothing beyond `noise_peak` standard deviations, and the bound
then holds for certain) or Gaussian (the bound holds for each sample with the probability that `noise_peak` stands for).

Sums and norms are floating point: the bounds are checked, not proved.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.peaks import Gains, gains
from faultrecon.plant.plant import Plant
from faultrecon.runtime.absences import Absences
from faultrecon.runtime.absent import Sizes
from faultrecon.runtime.beginning import ANYWHERE, Beginning
from faultrecon.runtime.errors import ErrorSystem, is_noise
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.fades import Fades, taller

Array = NDArray[Any]
NoiseModel = Literal["gaussian", "bounded"]

LEAST = 1e-2  # of the start: how small the unit of a ζ is at least, so that one that nothing drives has one


@dataclass(frozen=True, slots=True)
class Allowance:
    """What is taken for granted about the unknown.

    crest: how far disturbances may go beyond their declared size.  noise_peak: standard deviations that noise stays
    within, or that a Gaussian one is allowed.
    """

    crest: float = 1.0
    noise_peak: float = 5.0
    noise: NoiseModel = "gaussian"


@dataclass(frozen=True, eq=False)
class Bounds:
    """The steady bounds of one estimator, and how its start and its gaps fade.

    certain, random (scales, q + p): what declared bounds allow the errors f̂ - f and y - ŷ behind each low-pass filter,
    and the standard deviation that noise adds to it.
    What is left of an unknown start is counted in units of the steady bounds, by error; the last entry is for ζ itself.
    It has a quick and a slow part, (2, q + p + 1): `start` at the first sample, `blind` where that one lacks something,
    `rate` per sample.  What was missing adds to that; it takes longer to find out, and is not looked for before it is
    asked for: `absences`.
    said: what must be true of complete samples.
    """

    certain: Array
    random: Array
    start: Array
    blind: Array
    rate: Array
    look_for_absences: Callable[[], Absences]
    beginning: Beginning
    allowance: Allowance
    said: tuple[str, ...]
    faults: int

    @cached_property
    def absences(self) -> Absences:
        """What rows, inputs and sensors that are missing add."""
        return self.look_for_absences()

    @cached_property
    def assumptions(self) -> tuple[str, ...]:
        """What must be true for the bounds to hold, in sentences."""
        return (*self.said, *self.absences.said)

    @cached_property
    def anew(self) -> Array:
        """What is left, (2, q + p + 1), where nothing is known any more."""
        return np.maximum(self.start, self.blind)

    @cached_property
    def steady(self) -> Array:
        """The bound of every error when nothing is left of the start, by scale, (scales, q + p)."""
        return self.certain + self.allowance.noise_peak * self.random

    @cached_property
    def fault(self) -> Array:
        """The bound of every reconstructed fault when nothing is left of the start, (q,)."""
        return self.steady[0, : self.faults]


def bounds(
    plant: Plant,
    estimator: Estimator,
    system: ErrorSystem,
    allowance: Allowance | None = None,
    smoothing: tuple[float, ...] = (0.0,),
) -> Bounds:
    """The bounds of an estimator on its plant; smoothing: poles of the low-pass filters, the first of them 0."""
    allowance = allowance or Allowance()
    errors, states = _steady(system, allowance, smoothing)
    first, rows = Beginning.of(plant), system.faults + system.sensors
    box, blind = _boxes(first, estimator, system, allowance)
    least = LEAST * np.abs(_inner(system) @ box).sum(axis=1)
    units = np.append(errors.largest(allowance), np.nan_to_num(states.largest(allowance), posinf=0.0) + least)
    units = np.maximum(units, np.finfo(float).tiny)
    slipped = system.slope * float(np.linalg.norm(units[rows : len(system.C)]))
    zeta = units[len(system.C) :][: len(estimator.observer.A)]
    fades, start = Fades.of(system, units, box)
    return Bounds(
        errors.certain,
        errors.random,
        fades.errors(start),
        fades.errors(fades.begin(blind)),
        fades.errors(fades.rate),
        partial(Absences.of, plant, estimator, _sizes_of(plant, allowance, zeta, slipped), fades.afresh()),
        first,
        allowance,
        _assumptions(plant, estimator, system, allowance, first.undeclared),
        system.faults,
    )


@dataclass(frozen=True, eq=False)
class _Steady:
    """What outputs can get to behind each filter, (scales, r): for certain, and the deviation that noise adds."""

    found: Gains
    certain: Array
    random: Array

    @staticmethod
    def of(system: ErrorSystem, allowance: Allowance, C: Array, D: Array, smoothing: tuple[float, ...]) -> _Steady:
        """By what is declared, for outputs C ζ + D d; without what φ(x̂) - φ(x) adds."""
        found = _whichever(system, gains(system.M, system.B, C, D, smoothing))
        sizes, noise = _sizes(system, allowance)
        certain, random = _product(found.peak, sizes), np.sqrt(_product(np.square(found.noise), np.square(noise)))
        if allowance.noise == "bounded":
            return _Steady(found, certain + allowance.noise_peak * _product(found.peak, noise), np.zeros_like(random))
        return _Steady(found, certain, random)

    def through(self, system: ErrorSystem) -> Array:
        """What one unit of φ(x̂) - φ(x) adds, (scales, r)."""
        columns = [k for k, source in enumerate(system.sources) if source.kind == "nonlinearity"]
        return np.asarray(self.found.peak[:, :, columns].sum(axis=2))

    def largest(self, allowance: Allowance) -> Array:
        """With as much noise as is allowed, unfiltered, (r,)."""
        return self.certain[0] + allowance.noise_peak * self.random[0]

    def slips(self, system: ErrorSystem, allowance: Allowance) -> float:
        """How large φ(x̂) - φ(x) gets by the small-gain argument, where φ reads the first outputs; inf without bound."""
        if system.slope == 0.0:
            return 0.0
        reads = slice(0, len(system.C) - system.faults - system.sensors)
        alone = float(np.linalg.norm(self.largest(allowance)[reads]))
        gain = system.slope * float(np.linalg.norm(self.through(system)[0, reads]))
        return system.slope * alone / (1.0 - gain) if gain < 1.0 else math.inf

    def fed(self, system: ErrorSystem, slips: float) -> _Steady:
        """With what φ(x̂) - φ(x) adds."""
        through = self.through(system)
        more = np.multiply(through, slips, out=np.zeros_like(through), where=through > 0.0)
        return replace(self, certain=self.certain + more)


def _steady(system: ErrorSystem, allowance: Allowance, smoothing: tuple[float, ...]) -> tuple[_Steady, _Steady]:
    """Of the errors; and of what φ reads and of ζ, which nobody asks for behind filters."""
    rows, nz = system.faults + system.sensors, len(system.M)
    errors = _Steady.of(system, allowance, system.C[:rows], system.D[:rows], smoothing)
    still = np.vstack([system.D[rows:], np.zeros((nz, len(system.sources)))])
    states = _Steady.of(system, allowance, _inner(system), still, (0.0,))
    slips = states.slips(system, allowance)
    return errors.fed(system, slips), states.fed(system, slips)


def _inner(system: ErrorSystem) -> Array:
    """What φ reads, and ζ, as outputs of ζ."""
    return np.vstack([system.C[system.faults + system.sensors :], np.eye(len(system.M))])


def _whichever(system: ErrorSystem, found: Gains) -> Gains:
    """Of a disturbance that may show in the sample before or after, the larger gain counts; the other is zero."""
    peak, noise = found.peak.copy(), found.noise.copy()
    at = {source.name: k for k, source in enumerate(system.sources) if source.kind == "disturbance"}
    for k, source in enumerate(system.sources):
        late = at.get(source.name, k)
        if source.kind == "disturbance" and late != k:
            peak[..., late] = np.maximum(peak[..., late], peak[..., k])
            peak[..., k] = 0.0
    return Gains(peak, noise)


def _boxes(first: Beginning, estimator: Estimator, system: ErrorSystem, allowance: Allowance) -> tuple[Array, Array]:
    """ζ before anything is known but the first sample, and before that one is."""
    sizes, noise = _sizes(system, allowance)
    sizes = np.where(np.isfinite(sizes), sizes, 0.0) + allowance.noise_peak * noise
    fresh = np.hstack([system.fresh * sizes, system.waiting * sizes])
    own = system.start[: len(estimator.observer.A)]
    box = first.box(estimator.observer, own, allowance.crest, allowance.noise_peak)
    height = len(fresh)
    return np.hstack([taller(box, height), fresh]), np.hstack([taller(first.blind_box(own), height), fresh])


def _sizes_of(plant: Plant, allowance: Allowance, zeta: Array, slipped: float) -> Sizes:
    """What may happen within two samples, noise at its peak."""
    peak = allowance.noise_peak
    w = [(peak if w.role == "noise" else allowance.crest) * w.size for w in plant.disturbances]
    sd = np.zeros(plant.p) if plant.noise is None else np.array(plant.noise.sd)
    return Sizes(zeta, np.array(w), peak * sd, slipped)


def _sizes(system: ErrorSystem, allowance: Allowance) -> tuple[Array, Array]:
    """How large each source gets for certain, and its standard deviation if it is noise; (d,) each."""
    certain, noise = np.zeros(len(system.sources)), np.zeros(len(system.sources))
    for k, source in enumerate(system.sources):
        if source.kind == "noise":
            noise[k] = source.size
        elif source.kind == "disturbance":
            certain[k] = allowance.crest * source.size
        elif source.kind == "fault rate" or math.isfinite(source.size):
            certain[k] = source.size  # a range nobody declared is left out, and said among the assumptions
    return certain, noise


def _product(table: Array, sizes: Array) -> Array:
    """(scales, r, d) times (d,), where nothing times infinity is nothing."""
    with np.errstate(invalid="ignore"):
        each = table * sizes
    return np.nansum(each, axis=-1)


def _assumptions(
    plant: Plant, estimator: Estimator, system: ErrorSystem, allowance: Allowance, undeclared: tuple[str, ...]
) -> tuple[str, ...]:
    """What must be true for the bound to hold, in sentences."""
    kinds = {s.kind for s in system.sources}
    said = []
    if "disturbance" in kinds:
        times = "" if allowance.crest == 1.0 else f"{allowance.crest:g} times "
        said.append(f"every disturbance stays within {times}its declared size, constant from sample to sample")
    if "noise" in kinds:
        peak = allowance.noise_peak
        if allowance.noise == "bounded":
            said.append(f"noise stays within {peak:g} standard deviations")
        else:
            odds = math.erfc(peak / math.sqrt(2.0))
            said.append(f"noise is white and Gaussian; a sample lies outside with probability {odds:.1e} at most")
    rates = [s.name for s in system.sources if s.kind == "fault rate"]
    for name, rate in ((f.name, f.rate) for f in plant.faults if f.name in rates):
        said.append(
            f"{name} changes by no more than {rate:g} per second"
            if math.isfinite(rate)
            else f"no rate is declared for {name}: without one nothing bounds its error"
        )
    sampling = [s for s in system.sources if s.kind == "sampling"]
    declared = [s.name for s in sampling if math.isfinite(s.size)]
    if declared:
        said.append(f"{', '.join(declared)} stay within what is declared for them")
    if any(math.isinf(s.size) for s in sampling):
        open_ = ", ".join(s.name for s in sampling if math.isinf(s.size))
        said.append(f"signals run between samples as the estimator reads them (no range is declared for {open_})")
    elif plant.B.shape[1] and plant.sample_time is None:
        said.append(f"inputs run between samples as hold = '{estimator.hold}' says")
    if system.slope:
        said.append("the Lipschitz constant holds wherever state and estimate go")
    if undeclared:
        said.append(f"{', '.join(undeclared)} begin within {ANYWHERE:g} of the operating point (no range is declared)")
    for i, w in enumerate(plant.disturbances):
        if is_noise(plant, i):
            said.append(f"{w.name}, on one noisy sensor alone, is counted as its noise")
    said.append("samples come at regular times, or a whole number of sample times apart")
    said.append("the plant is the model")
    return tuple(said)
