# SPDX-License-Identifier: BSD-3-Clause
"""What a sample that lacks one channel does to the error: what stood in for the reading was only a prediction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.plant.plant import Plant
from faultrecon.runtime.errors import Pair, sizes_of_phi
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import reads_directly
from faultrecon.runtime.steps import ObserverStep, disturbed, step_with

Array = NDArray[Any]

NEUTRAL = 1e-9  # per sample: growth that is none, as of the constant faults that an observer remembers


@dataclass(frozen=True, eq=False)
class Sizes:
    """How large things may be: ζ (nz,), disturbances (l,), noise (p,), and φ(x̂) - φ(x)."""

    zeta: Array
    disturbances: Array
    noise: Array
    slipped: float


@dataclass(frozen=True, eq=False)
class Absence:
    """at_once (rows,) or (rows + nz,): how far the outputs, and z, may be moved at the sample itself.  later (nz, k):
    columns of which any |share| ≤ 1 may be added to ζ at the next.
    """

    at_once: Array
    later: Array


@dataclass(frozen=True, eq=False)
class _Unknown:
    """Two samples in a row, by all that is unknown: z and v = [u; y] of the first, v of the second, φ in between.

    Z, N (nz, k), V0, V1 (m + p, k); every column may be taken ± size times.
    """

    Z: Array
    V0: Array
    V1: Array
    N: Array
    size: Array


def absences(plant: Plant, estimator: Estimator, sizes: Sizes) -> list[Absence]:
    """By channel, for a sample that lacks it; the one before may have lacked it too."""
    pair = Pair.of(plant, estimator)
    unknown = _unknown(pair, sizes)
    complete = estimator._general.stepper(_mask(plant.p, None), _mask(plant.p, None))
    whole = step_with(estimator, complete.A, complete.B)
    return [_absence(pair, unknown, whole, i) for i in range(plant.p)]


def diverging(estimator: Estimator) -> Array:
    """1 for each channel without which the error grows, else 0; the last is for all of them."""
    p, found = len(estimator.observer.y0), []
    for lacking in (*(_mask(p, i) for i in range(p)), np.ones(p, dtype=bool)):
        if estimator.scheme == "sampled":
            observer = estimator.observer
            A = observer.A + observer.B @ estimator._general.stepper(_mask(p, None), lacking).after.from_z
            largest = np.log(max(float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)), np.finfo(float).tiny))
        else:
            A = estimator._general.stepper(lacking, lacking).A * estimator.sample_time
            largest = float(np.linalg.eigvals(A).real.max(initial=-np.inf))
        found.append(float(largest > NEUTRAL))
    return np.array(found)


def _absence(o: Pair, unknown: _Unknown, whole: ObserverStep, i: int) -> Absence:
    """z⁺ with the channel lacking, less z⁺ with it, from the same z; then once more, since v⁺ stays."""
    m = o.plant.B.shape[1]
    row = m + i
    estimator, Z, V0, V1 = o.estimator, unknown.Z, unknown.V0, unknown.V1
    here, after = (_step(estimator, *lacking, whole) for lacking in ((None, i), (i, None)))
    filling = estimator._general.stepper(_mask(o.plant.p, None), _mask(o.plant.p, i)).after

    def followed(Z: Array, V0: Array, V1: Array, N: Array) -> tuple[Array, Array, Array]:
        """What is missing from z at the sample, what from v, and what from z at the next."""
        taken = V1.copy()
        taken[row] = V0[row]  # the last value, until the prediction takes its place
        short = (here.Ad - whole.Ad) @ Z + (here.B0 - whole.B0) @ V0 + here.B1 @ taken - whole.B1 @ V1
        z = whole.Ad @ Z + whole.B0 @ V0 + whole.B1 @ V1 + N + short
        filled = V1.copy()
        filled[row] = filling.from_z[row] @ z + filling.from_v[row] @ taken
        return (
            short,
            filled[row] - V1[row],
            whole.Ad @ short + (after.Ad - whole.Ad) @ z + after.B0 @ filled - (whole.B0 @ V1),
        )

    short, off, later = followed(Z, V0, V1, unknown.N)
    nz, k = Z.shape[0], len(V0)
    before = followed(np.zeros((nz, 1)), np.eye(k)[:, row : row + 1], np.zeros((k, 1)), np.zeros((nz, 1)))
    again = float(np.abs(before[1][0]))
    far = float(np.abs(off) @ unknown.size) / (1.0 - again) if again < 1.0 else np.inf
    short, off, later = (np.column_stack(both) for both in zip((short, off[None], later), before, strict=True))
    size = np.append(unknown.size, far)
    moved = times(np.abs(o.C @ short + np.outer(o.Dy[:, i], off[0])), size).sum(axis=1)
    silent = np.append(reads_directly(estimator.observer)[:, i], np.arange(o.plant.p) == i)
    moved[: len(silent)][silent] = 0.0  # those rows say nothing at this sample
    return Absence(np.append(moved, np.abs(times(short, size)).sum(axis=1)), that_matter(times(later, size)))


def times(table: Array, size: Array) -> Array:
    """Columns times their sizes, where nothing times infinity is nothing."""
    with np.errstate(invalid="ignore"):
        return np.where(table == 0.0, 0.0, table * size)


def that_matter(columns: Array) -> Array:
    """Without those that are zero."""
    return np.asarray(columns[:, np.any(columns != 0.0, axis=0)])


def _unknown(o: Pair, sizes: Sizes) -> _Unknown:
    plant, goes = o.plant, o.goes
    nz, n, m, p, q = len(o.Ad), plant.n, plant.B.shape[1], plant.p, len(plant.faults)
    C, D, F, on = plant.C, plant.D, plant.F_f, disturbed(plant)[1]
    T, driven = o.estimator.sample_time, goes.F0 + goes.F1
    rates = np.array([T * f.rate for f in plant.faults])
    columns: list[list[Array]] = []

    def add(size: Any, k: int, Z: Any = 0.0, u0: Any = 0.0, y0: Any = 0.0, u1: Any = 0.0, y1: Any = 0.0, N: Any = 0.0):
        heights = (nz, m, p, m, p, nz)
        known = np.broadcast_to(np.where(np.isfinite(size), size, 0.0), (k,))
        parts = zip(heights, (Z, u0, y0, u1, y1, N), strict=True)
        columns.append([known, *(np.broadcast_to(part, (height, k)) for height, part in parts)])

    add(sizes.zeta, nz, np.eye(nz))
    add(np.array(plant.signals.x.ranges), n, o.Pi, y0=C, y1=C @ goes.Phi)
    reach = np.array(plant.signals.u.ranges)
    add(reach, m, o.u1 + o.y1 @ D + o.read @ goes.U1, np.eye(m), D, y1=C @ goes.U0)
    add(reach, m, u1=np.eye(m), y1=D + C @ goes.U1)
    add([f.size for f in plant.faults], q, o.Pi_f, y0=F, y1=F + C @ driven)
    add(rates, q, y1=F + C @ goes.F1)
    add(rates / 4.0, q, y1=C @ driven)
    # what a disturbance does to states, and what it shows: it may show before it acts, so that one is not the other
    add(sizes.disturbances, on.shape[1], o.read @ goes.W)
    add(sizes.disturbances, on.shape[1], o.y1 @ on, y0=on)
    add(sizes.disturbances, on.shape[1], y1=C @ goes.W)
    add(sizes.disturbances, on.shape[1], y1=on)
    add(sizes.noise, p, o.y1, y0=np.eye(p))
    add(sizes.noise, p, y1=np.eye(p))
    if plant.nonlinearity is not None:
        add(sizes_of_phi(plant), goes.G.shape[1], y1=C @ goes.G, N=o.N)
        add(sizes.slipped, goes.G.shape[1], N=o.N)
    size = np.concatenate([column[0] for column in columns])
    Z, u0, y0, u1, y1, N = (np.hstack([column[i] for column in columns]) for i in range(1, 7))
    return _Unknown(Z, np.vstack([u0, y0]), np.vstack([u1, y1]), N, size)


def _step(estimator: Estimator, before: int | None, after: int | None, whole: ObserverStep) -> ObserverStep:
    """One step of the observer between samples of which one lacks a channel; `whole` where nothing is filled in."""
    p = len(estimator.observer.y0)
    stepper = estimator._general.stepper(_mask(p, before), _mask(p, after))
    return step_with(estimator, stepper.A, stepper.B) if stepper.during.predicted else whole


def _mask(p: int, lacking: int | None) -> NDArray[np.bool_]:
    return np.arange(p) == (-1 if lacking is None else lacking)
