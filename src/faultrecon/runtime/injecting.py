# SPDX-License-Identifier: BSD-3-Clause
"""The injections of a sliding-mode observer over one sampling interval, by the implicit Euler method.

The observer's drift, without its injections, is carried exactly to zp; with eh = reads zp + direct v at the new sample
the injection then solves, for e at the end of the interval [Acary & Brogliato 2010, Syst. Control Lett. 59, 284-293],

    (I + h reads linear) e + h ρ Q s/(|s| + δ) ∋ eh,    s = P e,    Q = reads into

and the state moves by -h linear e + h into ν.  Taken at the end of the interval, ν does not chatter: it is the
equivalent injection -Q⁻¹ eh/h as soon as that is no larger than ρ.  And no linear injection acts while time passes, so
an observer that starts right and has the right model stays right.

In terms of s the inclusion is W s + h ρ s/(|s| + δ) ∋ Q⁻¹ eh, W = Q⁻¹ (I + h reads linear) P⁻¹.  With W = V diag(w) Vᵀ,
b = diag(1/w) Vᵀ Q⁻¹ eh and κ = h ρ/w it leaves one equation in r = |s|,

    |x| = r/(r + δ),    x_i = b_i/(r + δ + κ_i),    ν = -ρ V x

and 1/|x| is concave and almost straight in r: replacing it by its tangent leaves a quadratic equation whose root never
exceeds r, so the iteration climbs to r from below without any bracket to be kept, and squares its error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.graph.observer import Injection, Observer

Array = NDArray[np.float64]

LONGEST = 1000  # sample times: up to such gaps the count of rounds is the one that the injection asks for
MOST = 21  # rounds, for the weights of nine decades: what is left undone then concerns injections below 1e-9 of ρ
HUGE = 1e40  # times h ρ: an innovation beyond it acts as this one does, so that no square overflows
EQUAL = 1e-7  # decades: they then leave r wrong by the square of that
TINY = 1e-300  # added to a sum that is zero only if its factor is


class Move(NamedTuple):
    """What an injection with k entries does over one interval, in numbers or in symbols.

    measure (k, k): b from eh;  knees (k,): κ;  pull (nz, k) of eh and push (nz, k) of x: what is added to the state.
    """

    measure: Any
    knees: Any
    pull: Any
    push: Any

    @staticmethod
    def shapes(injection: Injection) -> tuple[tuple[int, int], ...]:
        """Rows and columns of each part."""
        nz, k = injection.into.shape
        return (k, k), (k, 1), (nz, k), (nz, k)


def drift(observer: Observer) -> tuple[Array, Array]:
    """A (nz, nz) and B (nz, m+p) of an observer without its linear injections; what cancels is exactly zero."""
    A, B = observer.A, observer.B
    for one in observer.injections:
        A, B = _without(A, one.linear, one.reads), _without(B, one.linear, one.direct)
    return A, B


def move(injection: Injection, h: float) -> Move:
    """The implicit step of h seconds.

    Where W is not symmetric its symmetric part stands in for it, which changes ν by order h and only while |ν| = ρ: the
    sliding motion stays exact.  A linear injection that drives e away acts for half its time constant at most.
    """
    G, R, into, bound = injection.linear, injection.reads, injection.into, injection.bound
    linear, Q, inverse = R @ G, R @ into, np.linalg.inv(injection.weight)
    acting = min(h, 0.5 / away) if (away := _driven_away(linear)) > 0 else h
    eye = np.eye(len(R))
    w, V = np.linalg.eigh(
        _symmetric(np.linalg.solve(Q, inverse)) + acting * _pulling(np.linalg.solve(Q, linear @ inverse))
    )
    pulled = -acting * np.linalg.solve((eye + acting * linear).T, G.T).T
    measure = (V.T @ np.linalg.inv(Q)) / w[:, None]
    return Move(measure, h * bound / w, pulled, -bound * h * (into + pulled @ Q) @ V)


def rounds(knees: Array) -> int:
    """How many rounds bring r to 1e-13 of itself, whatever b: measured over 10⁶ problems per decade of max κ/min κ.

    Needed were 5, 9, 11, 13 for 1, 3, 5, 8 decades.  Where all κ are equal the first round is exact.
    """
    decades = math.log10(float(np.max(knees) / np.min(knees)))
    if decades < EQUAL:
        return 1
    return min(MOST, 3 + 2 * max(1, math.ceil(decades - 1e-9)))


def rounds_for_any(injection: Injection, sample_time: float) -> int:
    """The same for intervals of one to `LONGEST` sample times."""
    lengths = sample_time * np.geomspace(1.0, LONGEST, 4)
    return max(rounds(move(injection, float(h)).knees) for h in lengths)


def unit(b: Sequence[Any], knees: Sequence[Any], layer: float, count: int) -> list[Any]:
    """x, of which ν is -ρ V x, in `count` rounds; |x| <= 1 up to rounding."""
    import casadi as ca

    r: Any = ca.SX(0)
    for _ in range(count):
        f, g = ca.SX(0), ca.SX(0)  # |x|² and what its slope is made of
        for b_i, knee in zip(b, knees, strict=True):
            d = (r + layer) + knee
            x = b_i / d
            q = x * x
            f, g = f + q, g + q / d
        size = ca.sqrt(f)
        if layer == 0.0:
            r = r + ca.fmax(0.0, (f * (size - 1.0)) / (g + TINY))
            continue
        a, c = f * (1.0 - size) - g * r, layer * (f * size)  # g r² + a r - c = 0
        root = ca.sqrt(a * a + 4.0 * (g * c))
        r = ca.fmax(r, ca.if_else(a > 0.0, (2.0 * c) / (a + root + TINY), (root - a) / (2.0 * g + TINY)))
    return [b_i / ((r + layer) + knee) for b_i, knee in zip(b, knees, strict=True)]


def limited(b: Sequence[Any], knees: Sequence[Any]) -> list[Any]:
    """b as far as its squares are numbers."""
    import casadi as ca

    return [ca.fmin(ca.fmax(b_i, -(HUGE * knee)), HUGE * knee) for b_i, knee in zip(b, knees, strict=True)]


def settled(injections: Sequence[Injection], moves: Sequence[tuple[Move, int]], z: Any, v: Any) -> Any:
    """z after the injections, in turn: each reads what the ones before it have moved.  moves: each with its rounds."""
    import casadi as ca

    for one, (act, count) in zip(injections, moves, strict=True):
        e = times(one.reads, z) + times(one.direct, v)
        knees = [act.knees[i] for i in range(len(one.reads))]
        b = limited(ca.vertsplit(ca.densify(times(act.measure, e))), knees)
        z = z + times(act.pull, e) + times(act.push, ca.vertcat(*unit(b, knees, one.layer, count)))
    return z


def explicit(injection: Injection, e: Any) -> Any:
    """ν for a known e, (k, 1); zero at e = 0."""
    import casadi as ca

    s = ca.mtimes(ca.DM(injection.weight), e)
    size = ca.sqrt(ca.sumsqr(s)) + injection.layer
    return (-injection.bound / (size + TINY)) * s


def times(matrix: Any, vector: Any) -> Any:
    """Matrix times vector; the zeros of a constant matrix cost nothing."""
    import casadi as ca

    return ca.mtimes(ca.sparsify(ca.DM(matrix)) if isinstance(matrix, np.ndarray) else matrix, vector)


# ------------------------------------------------------------ what can be run


def check(observer: Observer, sample_time: float) -> None:
    """Whether every injection can be stepped; raises InputError."""
    for number, one in enumerate(observer.injections, start=1):
        _check_sizes(observer, one, number)
        _check_numbers(one, number)
        Q = one.reads @ one.into
        if not np.linalg.cond(Q) < 1 / np.finfo(float).eps:
            raise InputError(f"injection {number} does not move all that it reads", why="reads @ into is singular")
        base = _symmetric(np.linalg.solve(Q, np.linalg.inv(one.weight)))
        if not np.linalg.eigvalsh(base)[0] > 0:
            raise InputError(
                f"injection {number} drives what it reads away", why="inv(reads @ into) inv(weight) is not positive"
            )
        away = _driven_away(one.reads @ one.linear)
        if away * sample_time > 0.5:
            raise InputError(
                f"injection {number} cannot be stepped every {sample_time:g} s",
                why=f"its linear part drives e away at {away:.3g} 1/s",
                evidence={"rate": away, "largest_step": 0.5 / away},
                remedies=(f"sample every {0.5 / away:.3g} s or faster", "take a faster linear injection"),
            )


def overridden(observer: Observer, bound: Any, layer: Any) -> Observer:
    """The observer with other bounds ρ or layers δ: a number for all injections, or one for each."""
    from dataclasses import replace

    if bound is None and layer is None:
        return observer
    count = len(observer.injections)
    if count == 0:
        raise InputError(
            "this observer has no injection whose bound or layer could be set", remedies=("leave out bound and layer",)
        )
    bounds = [i.bound for i in observer.injections] if bound is None else _one_each(bound, count, "bound")
    layers = [i.layer for i in observer.injections] if layer is None else _one_each(layer, count, "layer")
    for name, values, fine in (("bound", bounds, min(bounds) > 0), ("layer", layers, min(layers) >= 0)):
        if not (fine and np.isfinite(values).all()):
            wanted = "positive" if name == "bound" else "zero or positive"
            raise InputError(f"the {name} of the injection is {min(values):g}", why=f"it is a {wanted} number")
    changed = [replace(i, bound=b, layer=d) for i, b, d in zip(observer.injections, bounds, layers, strict=True)]
    return replace(observer, injections=tuple(changed))


def _one_each(value: Any, count: int, name: str) -> list[float]:
    try:
        given = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"the {name} of the injection is {value!r}", why="it is a number") from error
    if given.shape not in ((), (count,)) or np.isnan(given).any():
        raise InputError(f"the {name} of the injection is {value!r}", why=f"it is a number, or one for each of {count}")
    return [float(x) for x in np.broadcast_to(given, (count,))]


def _check_sizes(observer: Observer, one: Injection, number: int) -> None:
    nz, inputs = observer.B.shape
    k = len(one.reads)
    wanted = {"linear": (nz, k), "into": (nz, k), "reads": (k, nz), "direct": (k, inputs), "weight": (k, k)}
    for name, shape in wanted.items():
        if k == 0 or getattr(one, name).shape != shape:
            raise InputError(
                f"{name} of injection {number} is {getattr(one, name).shape}", why=f"its other parts ask for {shape}"
            )
        if not np.isfinite(getattr(one, name)).all():
            raise InputError(f"{name} of injection {number} holds NaN or inf")


def _check_numbers(one: Injection, number: int) -> None:
    if not (math.isfinite(one.bound) and one.bound > 0):
        raise InputError(f"the bound of injection {number} is {one.bound:g}", why="it is a positive number")
    if not (math.isfinite(one.layer) and one.layer >= 0):
        raise InputError(f"the layer of injection {number} is {one.layer:g}", why="it is zero or a positive number")
    skew = np.abs(one.weight - one.weight.T).max()
    if skew > 1e-9 * np.abs(one.weight).max() or not np.linalg.eigvalsh(_symmetric(one.weight))[0] > 0:
        raise InputError(f"the weight of injection {number} is not symmetric and positive definite")


# ------------------------------------------------------------ pieces


def _without(whole: Array, linear: Array, reads: Array) -> Array:
    """whole + linear @ reads, and zero where that is no more than the rounding of the product."""
    left = whole + linear @ reads
    rounding = (len(reads) + 2) * np.finfo(float).eps * (np.abs(linear) @ np.abs(reads))
    return np.where(np.abs(left) <= rounding, 0.0, left)


def _symmetric(M: NDArray[Any]) -> Array:
    return 0.5 * (M + M.T)


def _pulling(M: NDArray[Any]) -> Array:
    """The symmetric part of M, less what of it is negative: the equation then has one solution for every h."""
    w, V = np.linalg.eigh(_symmetric(M))
    return _symmetric(M) if w[0] >= 0 else (V * np.maximum(w, 0.0)) @ V.T


def _driven_away(linear: Array) -> float:
    """How fast e grows under ė = -linear e alone, 1/s; zero or negative when it does not."""
    return -float(np.min(np.linalg.eigvals(linear).real))
