# SPDX-License-Identifier: BSD-3-Clause
"""What missing rows and missing inputs do to the error of an estimator.

Beside the estimator that met a gap think of one that did not: from the same z it takes the samples that nobody
received, one by one.  Its error is that of complete, regular samples, so it stays within the steady bound and what
fades, over all the sample times of the gap.  The estimator at work differs from it by what is computed here: how far
the samples that it made up for itself are from those that there would have been.  So its error is the sum of both, and
the difference fades like any other once the samples are complete again.  The samples that nobody received are anything
that the declared bounds allow: where only their noise is open, they are those without noise.
A row that lacks an input is the same story: beside the estimator is one that knows the input.

None of this covers rows that lack a sensor beside a gap or beside a missing input: there nothing is known any more.
Bounds are by the same rules as in `errors`, but a range that nobody declared is infinite here: what a signal does over
several samples cannot be taken for granted.  Sums are floating point: the columns are checked, not proved.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.plant.plant import Plant
from faultrecon.runtime.absent import Absence, Sizes, that_matter, times
from faultrecon.runtime.errors import NOTHING, Pair, is_noise, sizes_of_phi
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.stepping import Hold, Stepper
from faultrecon.runtime.steps import disturbed

Array = NDArray[Any]


def gaps(plant: Plant, estimator: Estimator, sizes: Sizes, most: int = 8) -> list[Absence]:
    """By number of missing rows, 1 to `most`: what a gap adds to the error, between two complete samples.

    The interval is as many sample times as rows are missing, and one more, as closely as a regular one is one.
    `later` is added to ζ at the sample that ends the gap, on top of what the regular steps of the gap make of ζ, and
    `at_once` is what that does to the outputs there: it counts once.  Columns are infinite where nothing bounds them.
    A sampled observer predicts all sensors of a missing row from its own state: its columns hold while ζ, and
    φ(x̂) - φ(x), are within `sizes`, and grow with them; those of the others do not depend on ζ.
    """
    pair = Pair.of(plant, estimator)
    if estimator.observer.injections:
        return [_nothing_known(pair)] * most
    over = _across_sampled if estimator.scheme == "sampled" else _across
    found = []
    for rows in range(1, most + 1):
        path = _path(pair, sizes, rows)
        apart = over(pair, path)
        found.append(Absence(_reach(pair.C @ apart.z, apart.size), _columns(apart)))
    return found


def inputs_missing(plant: Plant, estimator: Estimator) -> list[Absence]:
    """By input, for a sample that lacks it: the last known value stands in, old as it may be.

    `later` is added to ζ at the next sample, and `at_once` is what the outputs at the sample itself are moved by; both
    add up over rows and inputs that are missing.
    """
    pair, held = Pair.of(plant, estimator), []
    for i, reach in enumerate(plant.signals.u.ranges):
        if estimator.observer.injections:
            held.append(_nothing_known(pair))
            continue
        size = 2.0 * reach if math.isfinite(reach) else math.inf  # from one end of the range to the other
        wrong = np.eye(estimator.observer.B.shape[1])[:, i : i + 1]
        apart = _Apart(np.zeros((len(pair.Ad), 1)), np.array([size]))
        apart = _further(pair, apart, _stages(estimator.hold, 0.0 * wrong, wrong))
        shown = pair.C @ apart.z
        shown[:, 0] += pair.Du[:, i]
        at_once = _reach(shown, apart.size)
        held.append(Absence(at_once, _columns(_further(pair, apart, _stages(estimator.hold, wrong, 0.0 * wrong)))))
    return held


@lru_cache(maxsize=1)
def _matrices(whole: Stepper, sample_time: float) -> tuple[Array, ...]:
    """Of one step; a gap takes the same one over and over."""
    return whole.matrices(sample_time)


# ---------------------------------------------------------------- how far two observers are apart


@dataclass(frozen=True, eq=False)
class _Apart:
    """z of one observer less z of another, (nz, k), by columns, each of which may be taken ± its size."""

    z: Array
    size: Array

    def read(self, term_reads: Array, v: Array) -> Array:
        """What is read of both, by rows at most."""
        return _reach(term_reads @ self.z + _wide(v, len(self.size)), self.size)

    def wider(self, into: Array, size: float) -> _Apart:
        """With new unknowns of one size, which go into z."""
        z = np.hstack([self.z, into])
        return _Apart(z, np.append(self.size, np.full(into.shape[1], size)))


def _further(o: Pair, apart: _Apart, stages: tuple[Array, Array, Array]) -> _Apart:
    """One sample time on.  stages: v of one less v of the other, at the beginning, the middle and the end."""
    whole, T = _whole(o.estimator), o.estimator.sample_time
    first, middle, last = stages
    if whole.scheme == "rk4":
        return _runge_kutta(o, whole, apart, (first, middle, middle, last))
    if whole.scheme == "sampled":
        slips = _slips(o, apart, first)
        z = whole.A @ apart.z + whole.B @ _wide(first, len(apart.size))
        return _Apart(z, apart.size).wider(whole.N, slips)
    Ad, B0, B1, N0, N1 = _matrices(whole, T)
    driven = _wide(B0 @ first + B1 @ last, len(apart.size))
    begins = _slips(o, apart, first)
    linear = _Apart(Ad @ apart.z + driven, apart.size)
    ends = _slips(o, linear.wider(N0 + N1, begins), last)
    return linear.wider(N0, begins).wider(N1, ends)


def _runge_kutta(o: Pair, whole: Stepper, apart: _Apart, stages: Sequence[Array]) -> _Apart:
    """The same for the four stages of the classical scheme."""
    h, at, slopes = o.estimator.sample_time, apart, []
    for v, share in zip(stages, (0.5, 0.5, 1.0, 0.0), strict=True):
        slope = _Apart(whole.A @ at.z + whole.B @ _wide(v, len(at.size)), at.size).wider(whole.N, _slips(o, at, v))
        slopes.append(slope.z)
        k = len(slope.size)
        at = _Apart(_wide(apart.z, k) + share * h * slope.z, slope.size)
    k = len(at.size)
    weighed = sum(w * _wide(slope, k) for w, slope in zip((1.0, 2.0, 2.0, 1.0), slopes, strict=True))
    return _Apart(_wide(apart.z, k) + h / 6.0 * weighed, at.size)


def _slips(o: Pair, apart: _Apart, v: Array) -> float:
    """How large each component of the difference of both φ may be; infinite where φ reads an input that is wrong."""
    term, plants = o.estimator.observer.nonlinear, o.plant.nonlinearity
    if term is None:
        return 0.0
    m = o.estimator.observer.inputs
    order = list(term.phi.inputs)
    reads_inputs = "u" in order and any(node[0] == "input" and node[1] == order.index("u") for node in term.phi.nodes)
    if plants is None or (reads_inputs and np.any(v[:m])):
        return math.inf
    direct = np.zeros((len(term.reads), v.shape[1])) if term.direct is None else term.direct @ v
    far = float(np.linalg.norm(apart.read(term.reads, direct)))
    return plants.constant * far if plants.constant else 0.0


def _whole(estimator: Estimator) -> Stepper:
    """What steps complete samples."""
    complete = np.zeros(len(estimator.observer.y0), dtype=bool)
    return estimator._general.stepper(complete, complete)


def _stages(hold: Hold, older: Array, newer: Array) -> tuple[Array, Array, Array]:
    """The samples as they are read at the beginning, the middle and the end of an interval."""
    if hold == "left":
        return older, older, older
    middle = 0.5 * (older + newer)
    return (middle, middle, middle) if hold == "midpoint" else (older, middle, newer)


# ---------------------------------------------------------------- what may happen during a gap


@dataclass(frozen=True, eq=False)
class _Unknown:
    """One vector of all that is unknown, each entry of a size, and where things are in it, by name and by sample."""

    places: dict[tuple[str, int], slice]
    size: Array

    @staticmethod
    def of(parts: Sequence[tuple[str, int, int, Any]]) -> _Unknown:
        """From (name, first sample, last sample, sizes)."""
        places, found, k = {}, [np.zeros(0)], 0
        for name, first, last, each in parts:
            each = np.asarray(each, dtype=float)
            for i in range(first, last + 1):
                places[name, i] = slice(k, k + len(each))
                found.append(each)
                k += len(each)
        return _Unknown(places, np.concatenate(found))

    def pick(self, name: str, i: int = 0) -> Array:
        """The matrix that takes one part out of the vector."""
        place = self.places[name, i]
        return np.eye(place.stop - place.start, len(self.size), place.start)


@dataclass(frozen=True, eq=False)
class _Path:
    """The samples that there would have been, by all that is unknown: v (m + p, k) from the one before the gap on.

    z (nz, k): of a sampled observer, which has not seen the first of them.  driven: what its φ does to it after each.
    """

    v: list[Array]
    z: Array
    driven: list[Array]
    size: Array


def _path(o: Pair, sizes: Sizes, rows: int) -> _Path:
    """A plant within its declared bounds, from the sample before the gap to the one after it."""
    plant, goes, a = o.plant, o.goes, _unknown(o, sizes, rows)
    end = rows + 1
    shown = _shown(o, a, rows)
    f, x = a.pick("f"), a.pick("x")
    v, held = [], goes.F0 + goes.F1
    for j in range(end + 1):
        v.append(np.vstack([a.pick("u", j), plant.C @ x + plant.D @ a.pick("u", j) + plant.F_f @ f + shown[j]]))
        if j == end:
            break
        newer = f + a.pick("rate", j)
        x = goes.Phi @ x + goes.U0 @ a.pick("u", j) + goes.U1 @ a.pick("u", j + 1) + goes.W @ a.pick("w", j)
        x = x + goes.F0 @ f + goes.F1 @ newer + held @ a.pick("detour", j) + goes.G @ a.pick("phi", j)
        f = newer
    z = a.pick("zeta") + o.Pi @ a.pick("x") + o.Pi_f @ a.pick("f") + o.read @ goes.W @ a.pick("w", -1)
    driven = [o.N @ (a.pick("phi", j) + a.pick("slipped", j)) for j in range(end)]
    return _Path(v, z, driven, a.size)


def _unknown(o: Pair, sizes: Sizes, rows: int) -> _Unknown:
    """All that is unknown from the sample before a gap to the one after it."""
    plant, T, end, phi = o.plant, o.estimator.sample_time, rows + 1, o.goes.G.shape[1]
    rates = np.array([T * fault.rate for fault in plant.faults])
    return _Unknown.of(
        [
            ("zeta", 0, 0, sizes.zeta),
            ("x", 0, 0, _ranges(plant.signals.x.ranges)),
            ("u", 0, end, _ranges(plant.signals.u.ranges)),
            ("f", 0, 0, [fault.size for fault in plant.faults]),
            ("rate", 0, rows, rates),
            ("detour", 0, rows, rates / 4.0 if plant.sample_time is None else np.zeros_like(rates)),  # as in `errors`
            ("w", -1, rows, sizes.disturbances),
            ("shown", 0, end, sizes.disturbances),
            ("noise", 0, end, sizes.noise),
            ("phi", 0, rows, sizes_of_phi(plant) if plant.nonlinearity is not None else np.zeros(phi)),
            ("slipped", 0, rows, np.full(phi, sizes.slipped)),
        ]
    )


def _shown(o: Pair, a: _Unknown, rows: int) -> list[Array]:
    """What disturbances and noise put on the sensors, by sample.

    Of a disturbance that acts on states too, a sensor shows what it is before or after the sample: anything, that is.
    Those on sensors alone are no more than the samples that nobody received may be thought to have: as much as the
    estimator itself makes up, if they are bounded, and nothing if they are noise.
    """
    moves, on = disturbed(o.plant)
    sensed = [i for i in range(on.shape[1]) if on[:, i].any() and not is_noise(o.plant, i)]
    both = [i for i in sensed if moves[:, i].any()]
    steady = [i for i in sensed if i not in both and o.plant.disturbances[i].role != "noise"]
    ends = [on[:, sensed] @ a.pick("shown", j)[sensed] + a.pick("noise", j) for j in (0, rows + 1)]
    first, last = (on[:, steady] @ a.pick("shown", j)[steady] for j in (0, rows + 1))
    inner = []
    for j in range(1, rows + 1):
        older, newer = _shares(o.estimator, j / (rows + 1))
        inner.append(on[:, both] @ a.pick("shown", j)[both] + older * first + newer * last)
    return [ends[0], *inner, ends[1]]


def _shares(estimator: Estimator, part: float) -> tuple[float, float]:
    """What the estimator takes a sample inside a gap for: so much of the one before, and of the one after."""
    if estimator.scheme == "sampled":
        return 0.0, 0.0
    return {"left": (1.0, 0.0), "midpoint": (0.5, 0.5), "linear": (1.0 - part, part)}[estimator.hold]


def _across(o: Pair, path: _Path) -> _Apart:
    """Over a gap through which the estimator integrates: it reads a line, or what its hold makes of both ends."""
    v, parts, hold = path.v, len(path.v) - 1, o.estimator.hold
    apart = _Apart(np.zeros(path.z.shape), path.size)
    for j in range(parts):
        a, b = (v[0] + (v[-1] - v[0]) * (i / parts) for i in (j, j + 1))
        a, b = {"left": (v[0], v[0]), "midpoint": (v[0], v[-1]), "linear": (a, b)}[hold]
        pairs = zip(_stages(hold, a, b), _stages(hold, v[j], v[j + 1]), strict=True)
        first, middle, last = (_off(o, made_up, true, path.size) for made_up, true in pairs)
        apart = _further(o, apart, (first, middle, last))
    return apart


def _across_sampled(o: Pair, path: _Path) -> _Apart:
    """Over a gap whose rows are predicted one by one, each from what the observer has come to by then."""
    observer, nothing = o.estimator.observer, np.ones(o.plant.p, dtype=bool)
    filling = o.estimator._general.stepper(np.zeros_like(nothing), nothing).after
    z, made_up = path.z, path.v[0]
    apart = _Apart(np.zeros(z.shape), path.size)
    for j, true in enumerate(path.v[:-1]):
        if j > 0:
            k = len(apart.size)
            made_up = filling.from_z @ (_wide(z, k) + apart.z) + filling.from_v @ _wide(made_up, k)
        off = _off(o, made_up, _wide(true, made_up.shape[1]), apart.size)
        apart = _further(o, apart, (off, off, off))
        z = observer.A @ z + observer.B @ true + path.driven[j]
    return apart


# ---------------------------------------------------------------- columns


def _off(o: Pair, made_up: Array, true: Array, size: Array) -> Array:
    """How far a sample is off, of which mere rounding is nothing where it would count as infinite.

    So is what does not reach the observer, but for rounding: a fault of any rate on a sensor that it does not read.
    """
    whole, term = _whole(o.estimator), o.estimator.observer.nonlinear
    direct = np.zeros((0, len(true))) if term is None or term.direct is None else term.direct
    found, reads = made_up - true, np.vstack([whole.B, direct])
    endless = np.isinf(size[: found.shape[1]])
    scale = np.maximum(np.abs(made_up).max(axis=0, initial=0.0), np.abs(true).max(axis=0, initial=0.0))
    found[(np.abs(found) <= NOTHING * scale) & endless] = 0.0
    reached = np.abs(reads @ found).max(axis=0, initial=0.0)
    found[:, endless & (reached <= NOTHING * np.abs(reads).max(initial=0.0) * scale)] = 0.0
    return found


def _wide(table: Array, k: int) -> Array:
    """With zero columns up to k."""
    return np.hstack([table, np.zeros((len(table), k - table.shape[1]))])


def _reach(table: Array, size: Array) -> Array:
    """The largest of each row."""
    return np.asarray(np.abs(times(table, size)).sum(axis=1))


def _columns(apart: _Apart) -> Array:
    """Columns of which any |share| ≤ 1 may be had; those of nothing are left out."""
    return that_matter(times(apart.z, apart.size))


def _ranges(declared: Sequence[float]) -> Array:
    return np.where(np.isfinite(declared), declared, np.inf)


def _nothing_known(o: Pair) -> Absence:
    return Absence(np.full(len(o.C), np.inf), np.full((len(o.Ad), 1), np.inf))
