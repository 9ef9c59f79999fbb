# SPDX-License-Identifier: BSD-3-Clause
"""First derivatives over a box, enclosed: the gradient at every point of the box that has one is inside.

Forward differentiation with intervals for numbers. abs, min and max have the slopes of their pieces and all between;
where a function may jump (sign, floor, a switch) the slope is everything from -inf to inf: nothing finite follows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from faultrecon.graph.interval import Failure, Interval, IntervalAlgebra, Mask, choose, hull

_ZERO, _ONE, _TWO = Interval.point(0.0), Interval.point(1.0), Interval.point(2.0)
_ENTIRE = Interval(np.asarray(-np.inf), np.asarray(np.inf))
_BOTH_SIGNS = Interval(np.asarray(-1.0), np.asarray(1.0))


@dataclass(frozen=True, slots=True)
class Slope:
    """A value (N,) and its derivative (k, N) by the k variables; None where it depends on none of them."""

    value: Interval
    by: Interval | None = None


@dataclass
class SlopeAlgebra:
    """The operations of a graph on values that carry their derivatives.

    choices: for the i-th abs, min, max or condition met, whether its first piece is taken (it is true) where the box
    leaves that open; unnamed ones give the hull of both. open: for each of them, the boxes that do. Almost everywhere
    the gradient is that of some choice, so the worst of all bounds a Lipschitz constant, and better than the hull does.
    """

    of: IntervalAlgebra = field(default_factory=IntervalAlgebra)
    choices: Mapping[int, bool] = field(default_factory=dict)
    open: list[Mask] = field(default_factory=list)

    def const(self, value: float) -> Slope:
        return Slope(self.of.const(value))

    def _chain(self, x: Slope, value: Interval, derivative: Callable[[], Interval]) -> Slope:
        """The chain rule of a function of one argument."""
        return Slope(value) if x.by is None else Slope(value, self.of.mul(derivative(), x.by))

    def _steep(self, what: str, where: Mask, x: Interval) -> Interval:
        """x, refused where the slope of a function of x is unbounded."""
        return self.of.refuse(f"{what} is infinitely steep", where, x)

    def _jump(self, what: str, where: Mask, x: Slope, otherwise: Interval | None) -> Interval | None:
        """A slope that is known, except where the function may jump."""
        if not where.any():
            return otherwise
        self.of.failures.append(Failure(f"{what} may jump", where, x.value))
        return choose(where, _ENTIRE, otherwise or _ZERO)

    def _sum(self, a: Interval | None, b: Interval | None) -> Interval | None:
        if a is None or b is None:
            return b if a is None else a
        return self.of.add(a, b)

    def _times(self, a: Interval, by: Interval | None) -> Interval | None:
        return None if by is None else self.of.mul(a, by)

    # Arithmetic.

    def add(self, a: Slope, b: Slope) -> Slope:
        return Slope(self.of.add(a.value, b.value), self._sum(a.by, b.by))

    def neg(self, a: Slope) -> Slope:
        return Slope(self.of.neg(a.value), None if a.by is None else self.of.neg(a.by))

    def sub(self, a: Slope, b: Slope) -> Slope:
        return self.add(a, self.neg(b))

    def mul(self, a: Slope, b: Slope) -> Slope:
        by = self._sum(self._times(b.value, a.by), self._times(a.value, b.by))
        return Slope(self.of.mul(a.value, b.value), by)

    def div(self, a: Slope, b: Slope) -> Slope:
        q = self.of.div(a.value, b.value)
        by = self._sum(a.by, self._times(self.of.neg(q), b.by))  # (a/b)' = (a' - (a/b) b') / b
        return Slope(q, None if by is None else self.of.div(by, b.value))

    def sq(self, a: Slope) -> Slope:
        return self._chain(a, self.of.sq(a.value), lambda: self.of.mul(_TWO, a.value))

    def sqrt(self, a: Slope) -> Slope:
        root = self.of.sqrt(a.value)
        if a.by is None:
            return Slope(root)
        x = self._steep("sqrt", a.value.lo <= 0.0, a.value)
        return self._chain(a, root, lambda: self.of.div(_ONE, self.of.mul(_TWO, self.of.sqrt(x))))

    def pow(self, a: Slope, b: Slope) -> Slope:
        v = self.of
        value = v.pow(a.value, b.value)
        by = None
        if a.by is not None:
            less = v.sub(b.value, _ONE)
            by = v.mul(v.mul(b.value, v.pow(a.value, less)), a.by)
        if b.by is not None:
            by = self._sum(by, v.mul(v.mul(v.log(a.value), value), b.by))
        return Slope(value, by)

    # Exponentials and logarithms.

    def exp(self, a: Slope) -> Slope:
        y = self.of.exp(a.value)
        return self._chain(a, y, lambda: y)

    def expm1(self, a: Slope) -> Slope:
        return self._chain(a, self.of.expm1(a.value), lambda: self.of.exp(a.value))

    def log(self, a: Slope) -> Slope:
        return self._chain(a, self.of.log(a.value), lambda: self.of.div(_ONE, a.value))

    def log1p(self, a: Slope) -> Slope:
        return self._chain(a, self.of.log1p(a.value), lambda: self.of.div(_ONE, self.of.add(_ONE, a.value)))

    # Circular and hyperbolic functions.

    def sin(self, a: Slope) -> Slope:
        return self._chain(a, self.of.sin(a.value), lambda: self.of.cos(a.value))

    def cos(self, a: Slope) -> Slope:
        return self._chain(a, self.of.cos(a.value), lambda: self.of.neg(self.of.sin(a.value)))

    def tan(self, a: Slope) -> Slope:
        y = self.of.tan(a.value)
        return self._chain(a, y, lambda: self.of.add(_ONE, self.of.sq(y)))

    def _root_1_minus_sq(self, name: str, x: Interval) -> Interval:
        x = self._steep(name, (x.lo <= -1.0) | (x.hi >= 1.0), x)
        return self.of.sqrt(self.of.sub(_ONE, self.of.sq(x)))

    def asin(self, a: Slope) -> Slope:
        y = self.of.asin(a.value)
        return self._chain(a, y, lambda: self.of.div(_ONE, self._root_1_minus_sq("asin", a.value)))

    def acos(self, a: Slope) -> Slope:
        y = self.of.acos(a.value)
        return self._chain(a, y, lambda: self.of.div(self.of.neg(_ONE), self._root_1_minus_sq("acos", a.value)))

    def atan(self, a: Slope) -> Slope:
        y = self.of.atan(a.value)
        return self._chain(a, y, lambda: self.of.div(_ONE, self.of.add(_ONE, self.of.sq(a.value))))

    def atan2(self, y: Slope, x: Slope) -> Slope:
        v = self.of
        value = v.atan2(y.value, x.value)
        if y.by is None and x.by is None:
            return Slope(value)
        r2 = v.add(v.sq(x.value), v.sq(y.value))
        cut = v.on_cut(y.value, x.value)
        safe = choose(cut, _ONE, r2)
        by = self._sum(self._times(v.div(x.value, safe), y.by), self._times(v.neg(v.div(y.value, safe)), x.by))
        return Slope(value, self._jump("atan2", cut, y, by))

    def sinh(self, a: Slope) -> Slope:
        return self._chain(a, self.of.sinh(a.value), lambda: self.of.cosh(a.value))

    def cosh(self, a: Slope) -> Slope:
        return self._chain(a, self.of.cosh(a.value), lambda: self.of.sinh(a.value))

    def tanh(self, a: Slope) -> Slope:
        return self._chain(a, self.of.tanh(a.value), lambda: self.of.div(_ONE, self.of.sq(self.of.cosh(a.value))))

    def asinh(self, a: Slope) -> Slope:
        return self._chain(a, self.of.asinh(a.value), lambda: self.of.div(_ONE, self.of.hypot(_ONE, a.value)))

    def acosh(self, a: Slope) -> Slope:
        y = self.of.acosh(a.value)
        if a.by is None:
            return Slope(y)
        x = self._steep("acosh", a.value.lo <= 1.0, a.value)
        return self._chain(a, y, lambda: self.of.div(_ONE, self.of.sqrt(self.of.sub(self.of.sq(x), _ONE))))

    def atanh(self, a: Slope) -> Slope:
        return self._chain(a, self.of.atanh(a.value), lambda: self.of.div(_ONE, self.of.sub(_ONE, self.of.sq(a.value))))

    def hypot(self, a: Slope, b: Slope) -> Slope:
        v = self.of
        r = v.hypot(a.value, b.value)
        return Slope(r, self._sum(self._times(_share(v, a.value, r), a.by), self._times(_share(v, b.value, r), b.by)))

    # Pieces.

    def _piece(self, first: Mask, second: Mask, a: Interval | None, b: Interval | None) -> Interval | None:
        """The slope of whichever piece is active; where that is open, of the piece chosen, or the hull of both."""
        if a is None and b is None:
            return None
        a, b = a or _ZERO, b or _ZERO
        take = self.choices.get(len(self.open))
        # Where both hold, the pieces meet: at a point of a kink either slope may be one that the box does not have.
        self.open.append(first == second)
        chosen = hull(a, b) if take is None else a if take else b
        return choose(first & ~second, a, choose(second & ~first, b, chosen))

    def abs(self, a: Slope) -> Slope:
        value = self.of.abs(a.value)
        if a.by is None:
            return Slope(value)
        return Slope(value, self._piece(a.value.lo >= 0.0, a.value.hi <= 0.0, a.by, self.of.neg(a.by)))

    def _steps(self, name: str, a: Slope, value: Interval) -> Slope:
        """A function of steps: flat, or it jumps."""
        return Slope(value) if a.by is None else Slope(value, self._jump(name, value.lo != value.hi, a, None))

    def sign(self, a: Slope) -> Slope:
        return self._steps("sign", a, self.of.sign(a.value))

    def floor(self, a: Slope) -> Slope:
        return self._steps("floor", a, self.of.floor(a.value))

    def ceil(self, a: Slope) -> Slope:
        return self._steps("ceil", a, self.of.ceil(a.value))

    def min(self, a: Slope, b: Slope) -> Slope:
        first, second = a.value.hi <= b.value.lo, b.value.hi <= a.value.lo
        return Slope(self.of.min(a.value, b.value), self._piece(first, second, a.by, b.by))

    def max(self, a: Slope, b: Slope) -> Slope:
        first, second = a.value.lo >= b.value.hi, b.value.lo >= a.value.hi
        return Slope(self.of.max(a.value, b.value), self._piece(first, second, a.by, b.by))

    def _test(self, name: str, a: Slope, b: Slope, value: Interval) -> Slope:
        """A truth value: flat, or it jumps; of other inputs alone it holds still, and may be either."""
        if a.by is not None or b.by is not None:
            return self._steps(name, b if a.by is None else a, value)
        take = self.choices.get(len(self.open))
        self.open.append(value.lo < value.hi)
        return Slope(value if take is None else choose(self.open[-1], _ONE if take else _ZERO, value))

    def lt(self, a: Slope, b: Slope) -> Slope:
        return self._test("a comparison", a, b, self.of.lt(a.value, b.value))

    def le(self, a: Slope, b: Slope) -> Slope:
        return self._test("a comparison", a, b, self.of.le(a.value, b.value))

    def eq(self, a: Slope, b: Slope) -> Slope:
        return self._test("a comparison", a, b, self.of.eq(a.value, b.value))

    def ne(self, a: Slope, b: Slope) -> Slope:
        return self._test("a comparison", a, b, self.of.ne(a.value, b.value))

    def logical_not(self, a: Slope) -> Slope:
        return self._steps("a condition", a, self.of.logical_not(a.value))

    def logical_and(self, a: Slope, b: Slope) -> Slope:
        return self._test("a condition", a, b, self.of.logical_and(a.value, b.value))

    def logical_or(self, a: Slope, b: Slope) -> Slope:
        return self._test("a condition", a, b, self.of.logical_or(a.value, b.value))

    def if_else_zero(self, c: Slope, x: Slope) -> Slope:
        value = self.of.if_else_zero(c.value, x.value)
        on, off = (c.value.lo > 0.0) | (c.value.hi < 0.0), (c.value.lo == 0.0) & (c.value.hi == 0.0)
        either = hull(x.by or _ZERO, _ZERO)
        by = None if x.by is None and c.by is None else choose(on, x.by or _ZERO, choose(off, _ZERO, either))
        return Slope(value, by if c.by is None else self._jump("if_else", ~on & ~off, c, by))


def _share(v: IntervalAlgebra, a: Interval, r: Interval) -> Interval:
    """a / hypot(a, b), which never leaves [-1, 1]."""
    zero = r.lo <= 0.0
    share = v.div(a, choose(zero, _ONE, r))
    within = Interval(np.clip(share.lo, -1.0, 1.0), np.clip(share.hi, -1.0, 1.0))
    return choose(zero, _BOTH_SIGNS, within)
