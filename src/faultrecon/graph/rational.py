# SPDX-License-Identifier: BSD-3-Clause
"""Rational functions in exact arithmetic: whether two formulas are the same function, proved and not sampled.

A graph of sums, products, quotients and whole powers is a quotient of two polynomials with rational coefficients: every
constant of a graph is a double, hence a rational number.  Two formulas agree when the numerator of their difference
vanishes; when only rounded constants keep them apart, the rest of it is bounded over a box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from faultrecon.graph.function import Graph
from faultrecon.graph.walk import walk

LARGEST_POWER = 64
"""Whole exponents up to which a power is written out."""


class NotRationalError(ValueError):
    """A formula with a function that no quotient of polynomials is."""


@dataclass(frozen=True)
class Rational:
    """num / den, two polynomials of one ring."""

    num: Any
    den: Any

    def __add__(self, other: Rational) -> Rational:
        if self.den == other.den:
            return Rational(self.num + other.num, self.den)
        return Rational(self.num * other.den + other.num * self.den, self.den * other.den)

    def __neg__(self) -> Rational:
        return Rational(-self.num, self.den)

    def __sub__(self, other: Rational) -> Rational:
        return self + (-other)

    def __mul__(self, other: Rational) -> Rational:
        return Rational(self.num * other.num, self.den * other.den)

    def __truediv__(self, other: Rational) -> Rational:
        if other.num == 0:
            raise NotRationalError("division by zero")
        return Rational(self.num * other.den, self.den * other.num)

    def derivative(self, variable: int) -> Rational:
        """The partial derivative by the variable of that number."""
        by = self.num.derivative(variable) * self.den - self.num * self.den.derivative(variable)
        return Rational(by, self.den * self.den)

    def bound(self, box: Sequence[tuple[float, float]]) -> float:
        """A number that |num / den| does not exceed on the box; inf where the denominator cannot be kept off zero."""
        if self.num == 0:
            return 0.0
        ends = [(Fraction(low), Fraction(high)) for low, high in box]
        top, (low, high) = _enclosed(self.num, ends), _enclosed(self.den, ends)
        away = low if low > 0 else -high
        if away <= 0:
            return float("inf")
        value = max(abs(top[0]), abs(top[1])) / away
        return float(value) * (1.0 + 2.0**-50)  # float() rounds to nearest


class Ring:
    """Polynomials in named variables, and graphs read in them."""

    def __init__(self, names: Sequence[str]) -> None:
        import flint

        self._ring = flint.fmpq_mpoly_ctx.get([f"v{i}" for i in range(max(1, len(names)))], "lex")
        self._one = self._ring.constant(1)
        self.variables = [Rational(g, self._one) for g in self._ring.gens()[: len(names)]]

    def number(self, value: float) -> Rational:
        """A constant, exactly."""
        import flint

        exact = Fraction(value)
        return Rational(self._ring.constant(flint.fmpq(exact.numerator, exact.denominator)), self._one)

    def read(self, graph: Graph, *inputs: Sequence[Rational]) -> list[Rational]:
        """The outputs of a graph at these inputs.  Raises NotRationalError."""
        algebra = _Operations(self)
        unknown = {str(node[0]) for node in graph.nodes} - {"input"} - set(dir(algebra))
        if unknown:
            raise NotRationalError(f"{', '.join(sorted(unknown))} is no part of a rational function")
        return walk(graph, algebra, *inputs)


class _Operations:
    """The operations of a graph that keep to rational functions."""

    def __init__(self, ring: Ring) -> None:
        self.ring = ring

    def const(self, value: float) -> Rational:
        return self.ring.number(value)

    def add(self, a: Rational, b: Rational) -> Rational:
        return a + b

    def sub(self, a: Rational, b: Rational) -> Rational:
        return a - b

    def mul(self, a: Rational, b: Rational) -> Rational:
        return a * b

    def div(self, a: Rational, b: Rational) -> Rational:
        return a / b

    def neg(self, a: Rational) -> Rational:
        return -a

    def sq(self, a: Rational) -> Rational:
        return a * a

    def pow(self, a: Rational, b: Rational) -> Rational:
        if not (b.num.is_constant() and b.den.is_constant()):
            raise NotRationalError("a variable exponent")
        exponent = Fraction(str(b.num.leading_coefficient() / b.den.leading_coefficient()))
        if exponent.denominator != 1 or abs(exponent) > LARGEST_POWER:
            raise NotRationalError(f"the exponent {float(exponent):g}")
        power = self.ring.number(1.0)
        for _ in range(abs(int(exponent))):
            power = power * a
        return power if exponent >= 0 else self.ring.number(1.0) / power


def _enclosed(polynomial: Any, box: Sequence[tuple[Fraction, Fraction]]) -> tuple[Fraction, Fraction]:
    """The natural interval extension of a polynomial, exactly."""
    low = high = Fraction(0)
    for exponents, coefficient in polynomial.terms():
        c = Fraction(int(coefficient.p), int(coefficient.q))
        a = b = c
        for k, (left, right) in zip(map(int, exponents), box, strict=False):
            if k:
                ends = [left**k, right**k] + ([Fraction(0)] if k % 2 == 0 and left < 0 < right else [])
                products = [end * factor for end in (min(ends), max(ends)) for factor in (a, b)]
                a, b = min(products), max(products)
        low, high = low + a, high + b
    return low, high
