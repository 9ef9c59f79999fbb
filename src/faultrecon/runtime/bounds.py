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
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.peaks import Gains, fading, gains
from faultrecon.plant.plant import Plant
from faultrecon.runtime.absent import Absence, Sizes, absences, diverging
from faultrecon.runtime.beginning import ANYWHERE, Beginning
from faultrecon.runtime.errors import ErrorSystem, is_noise
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.missing import gaps, inputs_missing

Array = NDArray[Any]
NoiseModel = Literal["gaussian", "bounded"]

LEAST = 1e-2  # of the start: how small the unit of a ζ is at least, so that one that nothing drives has one
QUICKEST = 1e-2  # rate per sample: below it an error is gone in any case
SUDDEN = 0.3  # the same for what counts from one sample before: at rate ρ it adds up to 1/ρ/(1 - ρ)


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
    What is left of an unknown start, and of what was missing, is counted in units of the steady bounds, by error; the
    last entry is for ζ itself.  Of both there is a quick and a slow part, which makes four, (4, q + p + 1): `start` at
    the first sample, `blind` where that one lacks something, `rate` per sample; those of what was missing begin at 0.
    To these two add, (each, 2, q + p + 1): `skipped` at the sample after 1, 2, ... missing rows, `unfed` and `lost` at
    a sample that lacks this input, or this sensor.  `lost` counts so many times as 1 and what is left in ζ at the
    sample before; so does `skipped` if it `scales`.  A gap lies between samples that lack nothing, and no sensor is
    silent at, before or after a sample that lacks an input: of all else, and of what is infinite, nothing is known.
    diverges (p + 1,): 1 for each sensor without which the error grows, the last without several.
    """

    certain: Array
    random: Array
    start: Array
    blind: Array
    rate: Array
    skipped: Array
    unfed: Array
    lost: Array
    scales: bool
    diverges: Array
    beginning: Beginning
    allowance: Allowance
    assumptions: tuple[str, ...]
    faults: int

    @cached_property
    def anew(self) -> Array:
        """What is left, (4, q + p + 1), where nothing is known any more."""
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
    rows, nz = system.faults + system.sensors, len(system.M)
    every = np.vstack([system.C, np.eye(nz)])
    found = gains(system.M, system.B, every, np.vstack([system.D, np.zeros((nz, system.D.shape[1]))]), smoothing)
    found = _whichever(system, found)
    sizes, noise = _sizes(system, allowance)
    certain = _product(found.peak, sizes)
    spread = np.sqrt(_product(np.square(found.noise), np.square(noise)))
    if allowance.noise == "bounded":
        certain, spread = certain + allowance.noise_peak * _product(found.peak, noise), np.zeros_like(spread)
    certain = certain + _nonlinearity(system, found.peak, certain[0] + allowance.noise_peak * spread[0])
    steady = certain[0] + allowance.noise_peak * spread[0]
    first = Beginning.of(plant)
    box, blind = _boxes(first, estimator, system, allowance)
    units = np.nan_to_num(steady, posinf=0.0) + LEAST * np.abs(every @ box).sum(axis=1)
    units = np.maximum(np.append(steady[:rows], units[rows:]), np.finfo(float).tiny)
    slipped = system.slope * float(np.linalg.norm(units[rows : len(system.C)]))
    zeta = units[len(system.C) :][: len(estimator.observer.A)]
    missing = _Missing.of(plant, estimator, _sizes_of(plant, allowance, zeta, slipped))
    fades = _Fades.of(system, every, units, box, missing.usual)
    skipped = fades.tables([fades.come(one) for one in missing.gaps])
    unfed, lost = (fades.tables([fades.follow(one) for one in each]) for each in (missing.inputs, missing.sensors))
    return Bounds(
        certain[:, :rows],
        spread[:, :rows],
        fades.outputs(np.vstack([fades.start, np.zeros_like(fades.start)])),
        fades.outputs(np.vstack([fades.begin(blind), np.zeros_like(fades.start)])),
        fades.outputs(fades.rate),
        skipped,
        unfed,
        lost,
        estimator.scheme == "sampled",
        diverging(estimator),
        first,
        allowance,
        (*_assumptions(plant, estimator, system, allowance, first.undeclared), *_of_missing(skipped, unfed, lost)),
        system.faults,
    )


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
    return _with(box, fresh), _with(first.blind_box(own), fresh)


def _with(box: Array, fresh: Array) -> Array:
    """Columns for the observer's own states beside columns for all of ζ."""
    return np.hstack([np.vstack([box, np.zeros((len(fresh) - len(box), box.shape[1]))]), fresh])


def _sizes_of(plant: Plant, allowance: Allowance, zeta: Array, slipped: float) -> Sizes:
    """What may happen within two samples, noise at its peak."""
    peak = allowance.noise_peak
    w = [(peak if w.role == "noise" else allowance.crest) * w.size for w in plant.disturbances]
    sd = np.zeros(plant.p) if plant.noise is None else np.array(plant.noise.sd)
    return Sizes(zeta, np.array(w), peak * sd, slipped)


@dataclass(frozen=True, eq=False)
class _Missing:
    """What rows, inputs and sensors that are missing do to the error."""

    gaps: list[Absence]
    inputs: list[Absence]
    sensors: list[Absence]

    @staticmethod
    def of(plant: Plant, estimator: Estimator, sizes: Sizes) -> _Missing:
        """While ζ is within its steady bound."""
        return _Missing(
            gaps(plant, estimator, sizes), inputs_missing(plant, estimator), absences(plant, estimator, sizes)
        )

    @property
    def usual(self) -> Array:
        """One row or one sensor, (nz, k), as far as anything is known."""
        each = [one.later for one in (self.gaps[0], *self.sensors)]
        known = [one for one in each if _known(one)]
        return np.hstack(known) if known else np.zeros((len(each[0]), 0))


def _known(later: Array) -> bool:
    return bool(np.isfinite(later).all())


@dataclass(frozen=True, eq=False)
class _Fades:
    """How every output and every ζ fades, in units: start (2, rows + nz), by a quick and by a slow part.

    rate (4, rows + nz): of the start, and of what was missing.
    What fades is fed on by φ(x̂) - φ(x), which goes back to what φ reads: by the small-gain argument for outputs that
    are weighed with rate^-k.  through (rows + nz,): what one unit of it adds then; back: what it makes of one unit.
    """

    system: ErrorSystem
    every: Array
    units: Array
    start: Array
    rate: Array
    through: Array
    back: float

    @staticmethod
    def of(system: ErrorSystem, every: Array, units: Array, box: Array, missing: Array) -> _Fades:
        """From a box of ζ to begin with, and one of what is added where something is missing."""
        rows, columns = len(every), [k for k, s in enumerate(system.sources) if s.kind == "nonlinearity"]
        if not columns or system.slope == 0.0:
            begins = fading(system.M, every, box, units)
            later = fading(system.M, every, _with(missing, np.zeros((len(system.M), 0))), units)
            rate = np.vstack([np.maximum(begins.rate, QUICKEST), np.maximum(later.rate, SUDDEN)])
            return _Fades(system, every, units, begins.first, rate, np.zeros(rows), 0.0)
        slowest = float(np.abs(np.linalg.eigvals(system.M)).max(initial=0.0))
        reads = slice(system.faults + system.sensors, len(system.C))
        for rate in 1.0 - (1.0 - slowest) * 0.5 ** np.arange(1, 12) if slowest < 1.0 else ():
            peak = gains(system.M / rate, system.B[:, columns] / rate, every, np.zeros((rows, len(columns)))).peak[0]
            through = peak.sum(axis=1)
            gain = system.slope * float(np.linalg.norm(through[reads]))
            if gain < 1.0:
                rates, nothing = np.full((4, rows), max(rate, QUICKEST)), np.zeros((2, rows))
                fades = _Fades(system, every, units, nothing, rates, through, system.slope / (1.0 - gain))
                return replace(fades, start=fades.begin(box))
        return _Fades(system, every, units, np.full((2, rows), math.inf), np.ones((4, rows)), np.zeros(rows), math.inf)

    def begin(self, box: Array) -> Array:
        """From another box, (2, rows + nz)."""
        if math.isinf(self.back):
            return self.start
        return self.fed(fading(self.system.M, self.every, box, self.units, self.rate[:2]).first)

    def come(self, absence: Absence) -> Array:
        """What is added at the sample at which ζ is another, (2, rows + nz)."""
        return self._after(absence, lambda first: first)

    def follow(self, absence: Absence) -> Array:
        """What is added at the sample before that, and lasts until then, (2, rows + nz)."""
        at_once = np.zeros(len(self.units))
        at_once[: len(absence.at_once)] = absence.at_once

        def before(first: Array) -> Array:
            earlier = first / self.rate[2:]
            earlier[0] += np.maximum(at_once / self.units - earlier.sum(axis=0), 0.0)
            return earlier

        return self._after(absence, before)

    def _after(self, absence: Absence, counted: Callable[[Array], Array]) -> Array:
        if math.isinf(self.back) or not _known(absence.later):
            return np.full(self.start.shape, math.inf)
        box = _with(absence.later, np.zeros((len(self.system.M), 0)))
        return self.fed(counted(fading(self.system.M, self.every, box, self.units, self.rate[2:]).first))

    def fed(self, first: Array) -> Array:
        """With what the nonlinearity makes of it; first (2, rows + nz)."""
        if self.back == 0.0:
            return first
        reads = slice(self.system.faults + self.system.sensors, len(self.system.C))
        size = self.back * float(np.linalg.norm((first * self.units).sum(axis=0)[reads]))
        return first + np.vstack([np.zeros(len(self.units)), self.through * size / self.units])

    def outputs(self, table: Array) -> Array:
        """The errors' columns, and as the last the largest of those of ζ and of what the nonlinearity reads."""
        rows = self.system.faults + self.system.sensors
        return np.column_stack([table[:, :rows], table[:, rows:].max(axis=1, initial=0.0)])

    def tables(self, each: list[Array]) -> Array:
        """The same of several, (each, 2, ...)."""
        rows = self.system.faults + self.system.sensors
        return np.array([self.outputs(one) for one in each]).reshape(len(each), 2, rows + 1)


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


def _nonlinearity(system: ErrorSystem, peak: Array, alone: Array) -> Array:
    """What φ(x̂) - φ(x) adds to each error, by the small-gain argument: (scales, r); inf where that finds no bound."""
    columns = [k for k, s in enumerate(system.sources) if s.kind == "nonlinearity"]
    reads = slice(system.faults + system.sensors, len(system.C))
    if not columns or system.slope == 0.0:
        return np.zeros(peak.shape[:2])
    through = peak[:, :, columns].sum(axis=2)
    gain = system.slope * float(np.linalg.norm(through[0, reads]))
    if not gain < 1.0:
        return np.where(through > 0, math.inf, 0.0)
    return through * (system.slope * float(np.linalg.norm(alone[reads])) / (1.0 - gain))


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


def _of_missing(skipped: Array, unfed: Array, lost: Array) -> tuple[str, ...]:
    """What is accounted for where something is missing, and what must be true of the rest, in sentences."""
    rows, inputs, sensors = (int(np.isfinite(each).all(axis=(1, 2)).sum()) for each in (skipped, unfed, lost))
    parts = [f"gaps of up to {rows} row{'s' * (rows > 1)}"] if rows else []
    parts += ["missing inputs"] if inputs and inputs == len(unfed) else []
    parts += ["silent sensors"] if sensors and sensors == len(lost) else []
    said = [f"{' and '.join(parts)} are accounted for where they do not meet each other"] if parts else []
    when = "beyond that" if parts else "where rows, inputs or sensors are missing"
    return (*said, f"{when} the error is no larger than that of an observer at rest")
