# SPDX-License-Identifier: BSD-3-Clause
"""Arithmetic on intervals that never loses a point: every end is rounded outwards.

Many intervals at once, in NumPy arrays. Sums, products, quotients and square roots use that IEEE 754 rounds correctly;
every other function is evaluated at the ends by ball arithmetic (Arb, through python-flint). Ends, not balls, because
the 30-bit radius of a ball cannot hold the 0 of the box [0, 0.3], and sqrt, log and max turn on exactly that 0.

An interval on which a function leaves its domain becomes NaN, stays NaN through all that follows, and is remembered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Inconclusive

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Interval:
    """All numbers from lo to hi, element by element; NaN at both ends means: not defined on the whole box."""

    lo: Array
    hi: Array

    @staticmethod
    def point(value: float | Array) -> Interval:
        """The interval of one number."""
        array = np.asarray(value, dtype=float)
        return Interval(array, array)


@dataclass(frozen=True, slots=True)
class Failure:
    """Where a function left its domain, or jumped: which boxes, and the argument it had there."""

    what: str
    boxes: Mask
    argument: Interval


def require_ieee() -> None:
    """Make sure this process rounds to nearest and keeps subnormal numbers; a library may have changed that.

    Raises Inconclusive: without it no enclosure is a proof.
    """
    tiny, half = np.array([5e-324]), np.array([2.0**-53])
    nearest = (1.0 + half == 1.0) & (1.0 + 1.5 * half > 1.0) & (-1.0 - half == -1.0) & (-1.0 - 1.5 * half < -1.0)
    if not (nearest & (tiny * 1.0 > 0.0) & (np.array([2.0**-1000]) * 2.0**-60 > 0.0))[0]:
        raise Inconclusive(
            "enclosures cannot be proved in this process",
            why="the processor is set to flush small numbers to zero or not to round to nearest",
            remedies=("look for an imported library that was compiled with -ffast-math",),
        )


def _sum_down(a: Array, b: Array) -> Array:
    """The largest double not above a + b: the error of a rounded sum is itself a double (Knuth)."""
    s = a + b
    t = s - a
    error = (a - (s - t)) + (b - t)
    return np.where(error >= 0.0, s, np.nextafter(s, -np.inf))


def _product_down(a: Array, b: Array) -> Array:
    """A double not above a b, exact where a factor is 0 or 1; 0 times infinity is 0, an end being a bound only."""
    zero = (a == 0.0) | (b == 0.0)
    p = np.where(zero, 0.0, a * b)
    exact = zero | (np.abs(a) == 1.0) | (np.abs(b) == 1.0)
    down = np.where(exact, p, np.nextafter(p, -np.inf))
    return np.where((a >= 0.0) == (b >= 0.0), np.maximum(down, 0.0), down)


def _quotient_down(a: Array, b: Array) -> Array:
    """A double not above a / b, b not zero; infinity over infinity is left to the other three corners."""
    q = np.where(np.isinf(a) & np.isinf(b), 0.0, a / b)
    down = np.where((a == 0.0) | (np.abs(b) == 1.0), q, np.nextafter(q, -np.inf))
    return np.where((a >= 0.0) == (b > 0.0), np.maximum(down, 0.0), down)


def _corners(a: Interval, b: Interval, down: Callable[[Array, Array], Array]) -> Interval:
    """Least and greatest of an operation over the four corners; for NaN on either side, NaN."""
    al, ah, bl, bh = np.broadcast_arrays(a.lo, a.hi, b.lo, b.hi)
    left, right = np.stack([al, al, ah, ah]), np.stack([bl, bh, bl, bh])
    lo, hi = down(left, right).min(axis=0), -down(-left, right).min(axis=0)
    bad = np.isnan(al) | np.isnan(bl)
    return Interval(np.where(bad, np.nan, lo), np.where(bad, np.nan, hi))


def hull(a: Interval, b: Interval) -> Interval:
    """The smallest interval that holds both."""
    return Interval(np.minimum(a.lo, b.lo), np.maximum(a.hi, b.hi))


def choose(where: Mask, a: Interval, b: Interval) -> Interval:
    """a where the mask is set, b elsewhere."""
    return Interval(np.where(where, a.lo, b.lo), np.where(where, a.hi, b.hi))


def _magnitudes(x: Interval) -> Interval:
    """The range of |x|."""
    across = (x.lo <= 0.0) & (x.hi >= 0.0)
    low, high = np.abs(x.lo), np.abs(x.hi)
    return Interval(np.where(across, 0.0, np.minimum(low, high)), np.maximum(low, high))


def _ball_ends(ball: Any) -> tuple[float, float]:
    """Doubles at or below, and at or above, everything in an Arb ball."""
    if not ball.is_finite():
        return -np.inf, np.inf
    low, high = float(ball.lower()), float(ball.upper())
    if ball.is_exact() and ball == low:
        return low, low
    # float() rounds to nearest, hence at most half a step the wrong way.
    return float(np.nextafter(low, -np.inf)), float(np.nextafter(high, np.inf))


def _by_balls(function: Callable[[Any], Any], at: Array) -> Interval:
    """An enclosure of function(x) at each x of an array, one Arb evaluation per distinct x."""
    import flint

    points, back = np.unique(at, return_inverse=True)
    with flint.ctx.workprec(64):
        ends = [(np.nan, np.nan) if np.isnan(p) else _ball_ends(function(flint.arb(float(p)))) for p in points]
    both = np.array(ends, dtype=float).reshape(-1, 2)[back.reshape(at.shape)]
    return Interval(both[..., 0], both[..., 1])


def _rising(function: Callable[[Any], Any], x: Interval, least: float = -np.inf, most: float = np.inf) -> Interval:
    """An increasing function of an interval, cut to the range it is known to have."""
    low, high = _by_balls(function, x.lo).lo, _by_balls(function, x.hi).hi
    return Interval(np.clip(low, least, most), np.clip(high, least, most))


def _falling(function: Callable[[Any], Any], x: Interval, least: float = -np.inf, most: float = np.inf) -> Interval:
    """A decreasing function of an interval."""
    low, high = _by_balls(function, x.hi).lo, _by_balls(function, x.lo).hi
    return Interval(np.clip(low, least, most), np.clip(high, least, most))


def _meets_integer(x: Interval, per: float, phase: float) -> Mask:
    """Whether x / per - phase may be a whole number somewhere; in doubt, yes."""
    low, high = x.lo / per - phase, x.hi / per - phase
    # Quotient, period and difference err by less than 5e-16 (1 + |t|) together.
    return np.floor(high + 1e-15 * (1.0 + np.abs(high))) >= np.ceil(low - 1e-15 * (1.0 + np.abs(low)))


def _wave(function: Callable[[Any], Any], x: Interval, crest: float) -> Interval:
    """sin or cos: the ends, unless a crest or a trough lies between them."""
    left, right = _by_balls(function, x.lo), _by_balls(function, x.hi)
    ends = Interval(
        np.clip(np.minimum(left.lo, right.lo), -1.0, 1.0), np.clip(np.maximum(left.hi, right.hi), -1.0, 1.0)
    )
    period = 2.0 * np.pi
    return Interval(
        np.where(_meets_integer(x, period, crest + 0.5), -1.0, ends.lo),
        np.where(_meets_integer(x, period, crest), 1.0, ends.hi),
    )


_ONE = Interval.point(1.0)


@dataclass
class IntervalAlgebra:
    """The operations of a graph on intervals; `failures` collects where one is not defined."""

    failures: list[Failure] = field(default_factory=list)

    def refuse(self, what: str, where: Mask, x: Interval) -> Interval:
        """x with NaN on these boxes, which are remembered with the reason."""
        if where.any():
            self.failures.append(Failure(what, where, x))
        return Interval(np.where(where, np.nan, x.lo), np.where(where, np.nan, x.hi))

    # Arithmetic.

    def const(self, value: float) -> Interval:
        return Interval.point(value)

    def add(self, a: Interval, b: Interval) -> Interval:
        return Interval(_sum_down(a.lo, b.lo), -_sum_down(-a.hi, -b.hi))

    def sub(self, a: Interval, b: Interval) -> Interval:
        return self.add(a, self.neg(b))

    def neg(self, a: Interval) -> Interval:
        return Interval(-a.hi, -a.lo)

    def mul(self, a: Interval, b: Interval) -> Interval:
        return _corners(a, b, _product_down)

    def div(self, a: Interval, b: Interval) -> Interval:
        b = self.refuse("division by a number that may be 0", (b.lo <= 0.0) & (b.hi >= 0.0), b)
        return _corners(a, b, _quotient_down)

    def sq(self, a: Interval) -> Interval:
        m = _magnitudes(a)
        return Interval(_product_down(m.lo, m.lo), -_product_down(-m.hi, m.hi))

    def sqrt(self, a: Interval) -> Interval:
        a = self.refuse("sqrt of a number that may be negative", a.lo < 0.0, a)
        low, high = np.sqrt(a.lo), np.sqrt(a.hi)
        low = np.where((low == 0.0) | (low == 1.0), low, np.nextafter(low, -np.inf))
        return Interval(low, np.where((a.hi == 0.0) | (a.hi == 1.0), high, np.nextafter(high, np.inf)))

    def hypot(self, a: Interval, b: Interval) -> Interval:
        return self.sqrt(self.add(self.sq(a), self.sq(b)))

    def pow(self, a: Interval, b: Interval) -> Interval:
        p = b.lo.flat[0]
        if (b.lo == p).all() and (b.hi == p).all():
            return self._power(a, float(p))
        a = self.refuse("pow, with a varying exponent, of a base that may be 0 or negative", a.lo <= 0.0, a)
        return self.exp(self.mul(b, self.log(a)))

    def _power(self, a: Interval, p: float) -> Interval:
        """A fixed power: by sign of the base for whole exponents, else of positive bases only."""
        import flint

        if p < 0.0:
            return self.div(_ONE, self._power(a, -p))
        if p == int(p):
            n = flint.fmpz(int(p))
            return _rising(lambda x: x**n, a) if n % 2 else _rising(lambda x: x**n, _magnitudes(a), 0.0)
        a = self.refuse(f"power {p:g} of a number that may be negative", a.lo < 0.0, a)
        return _rising(lambda x: x if x == 0 else x ** flint.arb(p), a, 0.0)

    # Exponentials and logarithms.

    def exp(self, a: Interval) -> Interval:
        return _rising(lambda x: x.exp(), a, 0.0)

    def expm1(self, a: Interval) -> Interval:
        return _rising(lambda x: x.expm1(), a, -1.0)

    def log(self, a: Interval) -> Interval:
        return _rising(lambda x: x.log(), self.refuse("log of a number that may be 0 or negative", a.lo <= 0.0, a))

    def log1p(self, a: Interval) -> Interval:
        return _rising(lambda x: x.log1p(), self.refuse("log1p of a number that may be -1 or less", a.lo <= -1.0, a))

    # Circular and hyperbolic functions.

    def sin(self, a: Interval) -> Interval:
        return _wave(lambda x: x.sin(), a, 0.25)

    def cos(self, a: Interval) -> Interval:
        return _wave(lambda x: x.cos(), a, 0.0)

    def tan(self, a: Interval) -> Interval:
        a = self.refuse("tan of a number that may be a pole", _meets_integer(a, np.pi, 0.5), a)
        return _rising(lambda x: x.tan(), a)

    def _unit(self, name: str, a: Interval) -> Interval:
        return self.refuse(f"{name} of a number that may lie outside [-1, 1]", (a.lo < -1.0) | (a.hi > 1.0), a)

    def asin(self, a: Interval) -> Interval:
        return _rising(lambda x: x.asin(), self._unit("asin", a))

    def acos(self, a: Interval) -> Interval:
        return _falling(lambda x: x.acos(), self._unit("acos", a), 0.0)

    def atan(self, a: Interval) -> Interval:
        return _rising(lambda x: x.atan(), a, -1.5707963267948968, 1.5707963267948968)  # the doubles beyond pi / 2

    def atan2(self, y: Interval, x: Interval) -> Interval:
        import flint

        cut = self.on_cut(y, x)
        yl, yh, xl, xh = np.broadcast_arrays(y.lo, y.hi, x.lo, x.hi)
        ends = []
        with flint.ctx.workprec(64):
            for box in zip(yl.flat, yh.flat, xl.flat, xh.flat, cut.flat, strict=True):
                ends.append(_atan2_ends(*map(float, box)))
        both = np.array(ends, dtype=float).reshape(*yl.shape, 2)
        return Interval(both[..., 0], both[..., 1])

    def on_cut(self, y: Interval, x: Interval) -> Mask:
        """Whether atan2 may jump: the box touches the negative half of the x axis, or the origin."""
        return (y.lo <= 0.0) & (y.hi >= 0.0) & (x.lo <= 0.0)

    def sinh(self, a: Interval) -> Interval:
        return _rising(lambda x: x.sinh(), a)

    def cosh(self, a: Interval) -> Interval:
        return _rising(lambda x: x.cosh(), _magnitudes(a), 1.0)

    def tanh(self, a: Interval) -> Interval:
        return _rising(lambda x: x.tanh(), a, -1.0, 1.0)

    def asinh(self, a: Interval) -> Interval:
        return _rising(lambda x: x.asinh(), a)

    def acosh(self, a: Interval) -> Interval:
        return _rising(lambda x: x.acosh(), self.refuse("acosh of a number that may be below 1", a.lo < 1.0, a), 0.0)

    def atanh(self, a: Interval) -> Interval:
        bad = (a.lo <= -1.0) | (a.hi >= 1.0)
        return _rising(lambda x: x.atanh(), self.refuse("atanh of a number that may reach -1 or 1", bad, a))

    # Pieces.

    def abs(self, a: Interval) -> Interval:
        return _magnitudes(a)

    def sign(self, a: Interval) -> Interval:
        return Interval(np.sign(a.lo), np.sign(a.hi))

    def floor(self, a: Interval) -> Interval:
        return Interval(np.floor(a.lo), np.floor(a.hi))

    def ceil(self, a: Interval) -> Interval:
        return Interval(np.ceil(a.lo), np.ceil(a.hi))

    def min(self, a: Interval, b: Interval) -> Interval:
        return Interval(np.minimum(a.lo, b.lo), np.minimum(a.hi, b.hi))

    def max(self, a: Interval, b: Interval) -> Interval:
        return Interval(np.maximum(a.lo, b.lo), np.maximum(a.hi, b.hi))

    def lt(self, a: Interval, b: Interval) -> Interval:
        return _truth(a.hi < b.lo, a.lo >= b.hi, a, b)

    def le(self, a: Interval, b: Interval) -> Interval:
        return _truth(a.hi <= b.lo, a.lo > b.hi, a, b)

    def eq(self, a: Interval, b: Interval) -> Interval:
        return _truth((a.lo == b.hi) & (a.hi == b.lo), (a.hi < b.lo) | (b.hi < a.lo), a, b)

    def ne(self, a: Interval, b: Interval) -> Interval:
        return self.logical_not(self.eq(a, b))

    def logical_not(self, a: Interval) -> Interval:
        return _truth(_never(a), _always(a), a, a)

    def logical_and(self, a: Interval, b: Interval) -> Interval:
        return _truth(_always(a) & _always(b), _never(a) | _never(b), a, b)

    def logical_or(self, a: Interval, b: Interval) -> Interval:
        return _truth(_always(a) | _always(b), _never(a) & _never(b), a, b)

    def if_else_zero(self, c: Interval, x: Interval) -> Interval:
        zero = Interval.point(0.0)
        either = choose(_always(c), x, hull(x, zero))
        return choose(np.isnan(c.lo), c, choose(_never(c), zero, either))


def _always(c: Interval) -> Mask:
    return (c.lo > 0.0) | (c.hi < 0.0)


def _never(c: Interval) -> Mask:
    return (c.lo == 0.0) & (c.hi == 0.0)


def _truth(yes: Mask, no: Mask, a: Interval, b: Interval) -> Interval:
    """[1, 1] where certain, [0, 0] where refuted, [0, 1] in doubt."""
    bad = np.isnan(a.lo) | np.isnan(b.lo)
    return Interval(np.where(bad, np.nan, yes * 1.0), np.where(bad, np.nan, 1.0 - no))


def _atan2_ends(yl: float, yh: float, xl: float, xh: float, cut: float) -> tuple[float, float]:
    """The range of the angle over one rectangle: it has no extremum inside, so its corners decide."""
    import flint

    if np.isnan(yl) or np.isnan(xl):
        return np.nan, np.nan
    beyond_pi = 3.1415926535897936
    if cut or not np.isfinite([yl, yh, xl, xh]).all():
        return -beyond_pi, beyond_pi
    ends = [_ball_ends(flint.arb.atan2(flint.arb(float(y)), flint.arb(float(x)))) for y in (yl, yh) for x in (xl, xh)]
    return min(low for low, _ in ends), max(high for _, high in ends)
