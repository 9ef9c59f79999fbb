# SPDX-License-Identifier: BSD-3-Clause
"""The error of an estimator from one sample to the next, driven by nothing but what is declared to be unknown.

A plant and an observer, both sampled, are one linear system.  With ζ = z - Π x - Π_f f, minus what the newest sample
has put into z directly,

    ζ⁺ = M ζ + B d,    [f̂ - f; y - ŷ] = C ζ + D d

in which the entries of d are: each disturbance, constant from one sample to the next, the noise of each sensor, the
change of each fault, and, where the observer does not follow the plant exactly between samples, x, u, f and φ
themselves.  Π says which z belongs to a plant state: for any Π the identity holds, and the best one leaves the last
group empty.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Impossible
from faultrecon.graph.observer import Observer
from faultrecon.plant.plant import Plant
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.steps import ObserverStep, PlantStep, disturbed, observer_step, plant_step

Array = NDArray[Any]
Kind = Literal["disturbance", "noise", "fault rate", "sampling", "nonlinearity"]

NOTHING = 1e-9  # of a typical coefficient: what solving for Π leaves of a zero


@dataclass(frozen=True, slots=True)
class Source:
    """One entry of d: what it is, and how large one of it is by declaration; infinite where nobody said."""

    kind: Kind
    name: str
    size: float


class Column(NamedTuple):
    """A source, and what one unit of it puts into ζ, into out at once, and into z at once; into z a sample later."""

    source: Source
    into: Array
    out: Array
    fresh: Array
    later: Array | None = None


@dataclass(frozen=True, eq=False)
class ErrorSystem:
    """ζ⁺ = M ζ + B d, out = C ζ + D d.

    out: f̂ - f (q rows), y - ŷ (p rows), and what the nonlinearity reads, H (x̂ - x) (s rows).
    start (nz, n+q): [Π, Π_f].  slope: Lipschitz constant of φ with respect to H x; 0 without one.
    reading: what one unit in each measurement does, into ζ (nz, p) and out at once.  moved (nz, n): what a change of
    the plant's state that the observer knows nothing of does to ζ.  fresh (nz, d): what the newest d has put into z,
    which ζ leaves out; waiting (nz, d): a d before the first sample.  Disturbances that wait are the last entries of ζ.
    """

    M: Array
    B: Array
    C: Array
    D: Array
    sources: tuple[Source, ...]
    faults: int
    sensors: int
    start: Array
    slope: float
    reading: tuple[Array, Array]
    moved: Array
    fresh: Array
    waiting: Array

    @cached_property
    def unbounded(self) -> tuple[Source, ...]:
        """Sources that matter and whose size nobody declared."""
        return tuple(s for s in self.sources if math.isinf(s.size))


def error_system(plant: Plant, estimator: Estimator) -> ErrorSystem:
    """The error system of an estimator on its plant, for complete samples at regular times.

    Raises Impossible, with the reason, for observers whose error is not of this form: those with discontinuous
    injections, with faults that multiply, and with a known term that reads measurements.
    """
    _demand_known_form(plant, estimator.observer)
    pair = Pair.of(plant, estimator)
    columns = [*_disturbances(pair), *_noise(pair), *_faults(pair), *_states(pair), *_inputs(pair), *_nonlinear(pair)]
    slope = 0.0 if plant.nonlinearity is None else plant.nonlinearity.constant
    return _assembled(columns, pair, slope)


@dataclass(frozen=True, eq=False)
class Pair:
    """A plant and an observer, both sampled; Π and Π_f say which z belongs to a state and to a constant fault.

    y0, y1, u0, u1: what the older and the newer sample of y and u put into z.  C, Dy, Du: out = C z + Du u + Dy y.
    read (nz, n): what a change of x puts into ζ.
    """

    plant: Plant
    estimator: Estimator
    goes: PlantStep
    Ad: Array
    y0: Array
    y1: Array
    u0: Array
    u1: Array
    N: Array
    C: Array
    Dy: Array
    Du: Array
    Pi: Array
    Pi_f: Array
    read: Array

    @staticmethod
    def of(plant: Plant, estimator: Estimator) -> Pair:
        """Both over one sample time."""
        observer, step, goes = estimator.observer, observer_step(estimator), plant_step(plant, estimator)
        m = observer.inputs
        Pi, Pi_f = _coordinates(plant, observer, step, goes.Phi, goes.F0 + goes.F1)
        C, D = _outputs(plant, observer)
        inputs = step.B0[:, m:], step.B1[:, m:], step.B0[:, :m], step.B1[:, :m]
        read = step.B1[:, m:] @ plant.C - Pi
        return Pair(plant, estimator, goes, step.Ad, *inputs, step.N, C, D[:, m:], D[:, :m], Pi, Pi_f, read)

    @property
    def at_sample(self) -> Array:
        """What one unit in each measurement does to ζ, (nz, p)."""
        return self.Ad @ self.y1 + self.y0

    @property
    def shown(self) -> Array:
        """What it shows at once, (rows, p)."""
        return self.C @ self.y1 + self.Dy


def _disturbances(o: Pair) -> Iterator[Column]:
    """Disturbances.  One that acts on states and sensors both has two columns, only one of which is true.

    What it is between two samples shows in the sensors at the later one, or at the earlier one.
    """
    _, on = disturbed(o.plant)
    for i, w in enumerate(o.plant.disturbances):
        if is_noise(o.plant, i):
            continue
        source = Source("noise" if w.role == "noise" else "disturbance", w.name, w.size)
        moved, shown = o.read @ o.goes.W[:, i], o.y1 @ on[:, i]
        into, out = o.at_sample @ on[:, i], o.shown @ on[:, i]
        if not (moved.any() and on[:, i].any() and o.plant.sample_time is not None):
            yield Column(source, o.Ad @ moved + into, o.C @ moved + out, moved + shown)
        if moved.any() and on[:, i].any():
            yield Column(source, into, out, shown, moved)


def _noise(o: Pair) -> Iterator[Column]:
    for j, sd in enumerate(o.plant.noise.sd if o.plant.noise is not None else ()):
        yield Column(Source("noise", o.plant.signals.y.names[j], sd), o.at_sample[:, j], o.shown[:, j], o.y1[:, j])


def _faults(o: Pair) -> Iterator[Column]:
    """A change over one sample time, what it may do in between beside a straight line, and a constant."""
    F, T = o.plant.F_f, o.estimator.sample_time
    nothing, none = np.zeros(len(o.C)), np.zeros(len(o.Ad))
    for j, fault in enumerate(o.plant.faults):
        step = o.y1 @ F[:, j] - o.Pi_f[:, j] + o.read @ o.goes.F1[:, j]
        yield Column(Source("fault rate", fault.name, T * fault.rate), step, nothing, none)
        driven = o.goes.F0[:, j] + o.goes.F1[:, j]
        if o.plant.sample_time is None and driven.any():  # a detour at that rate encloses a triangle of area rate T²/4
            yield Column(Source("fault rate", fault.name, T * fault.rate / 4.0), o.read @ driven, nothing, none)
        left = o.Ad @ o.Pi_f[:, j] + (o.y0 + o.y1) @ F[:, j] - o.Pi_f[:, j] + o.read @ driven
        out = o.C @ o.Pi_f[:, j] + o.Dy @ F[:, j] + _of_faults(o.plant)[:, j]
        yield Column(Source("sampling", fault.name, fault.size), left, out, none)


def _states(o: Pair) -> Iterator[Column]:
    """What the plant's own motion between samples does, as far as Π does not follow it."""
    C, Phi = o.plant.C, o.goes.Phi
    into = o.Ad @ o.Pi + o.y0 @ C + o.y1 @ C @ Phi - o.Pi @ Phi
    out = o.C @ o.Pi + o.Dy @ C + _of_states(o.plant)
    for i, name in enumerate(o.plant.signals.x.names):
        yield Column(
            Source("sampling", name, _range(o.plant.signals.x.ranges[i])), into[:, i], out[:, i], np.zeros(len(o.Ad))
        )


def _inputs(o: Pair) -> Iterator[Column]:
    D = o.plant.D
    older, newer = o.u0 + o.y0 @ D + o.read @ o.goes.U0, o.u1 + o.y1 @ D + o.read @ o.goes.U1
    into, out = o.Ad @ newer + older, o.C @ newer + o.Du + o.Dy @ D + _of_inputs(o.plant)
    for i, name in enumerate(o.plant.signals.u.names):
        yield Column(Source("sampling", name, _range(o.plant.signals.u.ranges[i])), into[:, i], out[:, i], newer[:, i])


def _nonlinear(o: Pair) -> Iterator[Column]:
    """φ(x̂) - φ(x), whose size follows from the small gain, and φ(x) itself, as far as its samples do not say it all."""
    term, nothing, none = o.plant.nonlinearity, np.zeros(len(o.C)), np.zeros(len(o.Ad))
    if term is None:
        return
    left = o.N + o.read @ o.goes.G
    for i, size in enumerate(sizes_of_phi(o.plant)):
        yield Column(Source("nonlinearity", f"phi[{i}]", 0.0), o.N[:, i], nothing, none)
        yield Column(Source("sampling", f"phi[{i}]", size), left[:, i], nothing, none)


def sizes_of_phi(plant: Plant) -> list[float]:
    """How large each component of φ gets while the states it reads, and the inputs, stay within their ranges."""
    term, point = plant.nonlinearity, plant.point
    assert term is not None, "asked of Lipschitz plants alone"
    middle = plant.H @ np.array(point.x)
    at_rest = np.abs(term.phi(middle, np.array(point.u), np.zeros(1)))
    reach = plant.H @ np.array(plant.signals.x.ranges)
    low, high = term.limits
    reach = np.where(np.isnan(reach), np.maximum(high - middle, middle - low), reach)
    at = list(term.phi.inputs).index("x")
    driven = any(node[0] == "input" and node[1] != at for node in term.phi.nodes)  # by u or t: nobody knows how far
    more = math.inf if driven else term.constant * float(np.linalg.norm(reach)) if term.constant else 0.0
    return [float(size) + more for size in at_rest]


def _assembled(columns: Sequence[Column], o: Pair, slope: float) -> ErrorSystem:
    """The columns that matter side by side; those that are zero but for rounding are left out."""
    kept = _that_matter(columns, o)
    late = [(k, column.later) for k, column in enumerate(kept) if column.later is not None]
    nz, waits = len(o.Ad), len(late)
    moved = _beside([later for _, later in late], nz)
    M = np.block([[o.Ad, o.Ad @ moved], [np.zeros((waits, nz + waits))]])
    waiting = np.zeros((nz + waits, len(kept)))
    B = _taller(_beside([column.into for column in kept], nz), waits)
    for i, (k, later) in enumerate(late):
        waiting[:, k] = np.append(-later, np.eye(waits)[i])
        B[nz + i, k] = 1.0
    D = _beside([column.out for column in kept], len(o.C))
    return ErrorSystem(
        M,
        B,
        np.hstack([o.C, o.C @ moved]),
        D,
        tuple(column.source for column in kept),
        len(o.plant.faults),
        o.plant.p,
        _taller(np.hstack([o.Pi, o.Pi_f]), waits),
        slope,
        (_taller(o.at_sample, waits), o.shown),
        _taller(o.read, waits),
        _taller(_beside([column.fresh for column in kept], nz), waits),
        waiting,
    )


def _that_matter(columns: Sequence[Column], o: Pair) -> list[Column]:
    kept = []
    scales = [float(np.abs(part).max(initial=0.0)) for part in (o.at_sample, o.shown)]
    for column in columns:
        parts = zip((column.into, column.out), scales, strict=True)
        nothing = all(np.all(np.abs(part) <= NOTHING * scale) for part, scale in parts)
        if not (nothing and column.source.kind in ("sampling", "fault rate")):
            kept.append(column)
    return kept


def _taller(part: Array, by: int) -> Array:
    return np.vstack([part, np.zeros((by, part.shape[1]))])


def _beside(columns: Sequence[Array], height: int) -> Array:
    return np.column_stack(columns) if columns else np.zeros((height, 0))


def _demand_known_form(plant: Plant, observer: Observer) -> None:
    reasons = {
        "its injections are discontinuous": bool(observer.injections),
        "a fault that multiplies makes its error nonlinear": bool(observer.scales) or observer.readout is not None,
        "it copies a known term that reads measurements, noise and faults included": observer.copied is not None,
        "the plant's nonlinearity is not in the observer": plant.nonlinearity is not None
        and observer.nonlinear is None
        and bool(np.any(plant.nonlinearity.into)),
    }
    for why, applies in reasons.items():
        if applies:
            raise Impossible(
                f"no bound per sample is known for this observer of {plant.name}",
                why=why,
                remedies=("design with 'lipschitz-hinf', 'adaptive-uio' or 'euler-pi'",),
            )


def _outputs(plant: Plant, observer: Observer) -> tuple[Array, Array]:
    """[f̂; y - ŷ; H x̂] = C z + D v, with ŷ = C x̂ + D u + F f̂."""
    m, p = observer.inputs, plant.p
    reads = np.zeros((0, plant.n))
    if plant.nonlinearity is not None:
        reads = plant.nonlinearity.selection(plant.signals.x)
    C = np.vstack([observer.Cf, -plant.C @ observer.Cx - plant.F_f @ observer.Cf, reads @ observer.Cx])
    y = np.hstack([-plant.D, np.eye(p)]) - plant.C @ observer.Dx - plant.F_f @ observer.Df
    if observer.nonlinear is not None and plant.nonlinearity is not None:
        term = observer.nonlinear  # the argument that is really used, which need not be H x̂
        C[len(C) - len(reads) :] = term.reads
        last = np.zeros((len(reads), m + p)) if term.direct is None else term.direct
        return C, np.vstack([observer.Df, y, last])
    return C, np.vstack([observer.Df, y, reads @ observer.Dx])


def _of_states(plant: Plant) -> Array:
    """What a true state counts for in the three errors."""
    reads = np.zeros((0, plant.n))
    if plant.nonlinearity is not None:
        reads = plant.nonlinearity.selection(plant.signals.x)
    return np.vstack([np.zeros((len(plant.faults), plant.n)), np.zeros((plant.p, plant.n)), -reads])


def _of_faults(plant: Plant) -> Array:
    q, s = len(plant.faults), 0 if plant.nonlinearity is None else len(plant.nonlinearity.reads)
    return np.vstack([-np.eye(q), np.zeros((plant.p + s, q))])


def _of_inputs(plant: Plant) -> Array:
    s = 0 if plant.nonlinearity is None else len(plant.nonlinearity.reads)
    return np.zeros((len(plant.faults) + plant.p + s, plant.B.shape[1]))


def _coordinates(plant: Plant, observer: Observer, step: ObserverStep, Phi: Array, Gf: Array) -> tuple[Array, Array]:
    """Π and Π_f: the observer state that belongs to a plant state and to a constant fault, by least squares.

    With G the step of [x; f] and S = [C, F] what is measured of it,  Ad Π + B0 S + B1 S G = Π G  and  what is read off
    z is [x; f].  Interpolated samples cannot have both exactly; what is left in the first adds up over the memory of
    the observer and weighs so much more.
    """
    m, n, q = observer.inputs, plant.n, len(plant.faults)
    goes = np.block([[Phi, Gf], [np.zeros((q, n)), np.eye(q)]])
    seen = np.hstack([plant.C, plant.F_f])
    reads = np.vstack([observer.Cx, observer.Cf])
    wanted = np.eye(n + q) - np.vstack([observer.Dx[:, m:], observer.Df[:, m:]]) @ seen
    nz, N = step.Ad.shape[0], n + q
    if nz == 0:
        return np.zeros((0, n)), np.zeros((0, q))
    scale = _sizes(plant)
    goes, seen, wanted = goes * scale / scale[:, None], seen * scale, wanted * scale
    slowest = float(np.abs(np.linalg.eigvals(step.Ad)).max())
    memory = 1.0 / max(1.0 - slowest, 1e-6)
    # unknowns by columns: vec(Ad X - X G) = (I ⊗ Ad - G' ⊗ I) vec X
    flow = np.kron(np.eye(N), step.Ad) - np.kron(goes.T, np.eye(nz))
    system = np.vstack([memory * flow, np.kron(np.eye(N), reads)])
    driven = step.B0[:, m:] @ seen + step.B1[:, m:] @ seen @ goes
    target = np.concatenate([-memory * driven.ravel(order="F"), wanted.ravel(order="F")])
    X = np.linalg.lstsq(system, target, rcond=None)[0].reshape((nz, N), order="F") / scale
    return X[:, :n], X[:, n:]


def _sizes(plant: Plant) -> Array:
    """How large the entries of [x; f] are expected to be; 1 where nobody said."""
    x = [r if math.isfinite(r) else 1.0 for r in plant.signals.x.ranges]
    return np.array([*x, *(f.size for f in plant.faults)])


def is_noise(plant: Plant, i: int) -> bool:
    """Whether a disturbance is the noise of one sensor under another name, which is counted once."""
    into, on = (np.flatnonzero(part[:, i]) for part in disturbed(plant))
    return plant.noise is not None and len(on) == 1 and len(into) == 0 and plant.noise.sd[on[0]] > 0


def _range(declared: float) -> float:
    return declared if math.isfinite(declared) else math.inf
