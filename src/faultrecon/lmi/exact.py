# SPDX-License-Identifier: BSD-3-Clause
"""Exact arithmetic on matrices of dyadic rationals, and proofs of definiteness; standard library alone.

A float64 is an integer times a power of two, and sums and products of such numbers are such numbers again.  So every
matrix that an inequality builds from float data is a matrix of integers with one common exponent, without rounding.
The integers live in any type that looks like `IntMatrix`; python-flint's `fmpz_mat` does, and is faster.

A matrix M is proved positive definite by one of
* congruence: with a rounded L⁻¹ of a floating-point Cholesky factor, G = L⁻¹ M L⁻ᵀ is computed exactly and found
  strictly diagonally dominant with a positive diagonal; then G > 0, hence L⁻¹ is regular and M > 0;
* fraction-free elimination: all leading principal minors are positive (Sylvester); slower, and decides every case.
It is refuted by an integer vector v with vᵀ M v <= 0, evaluated exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal

Rows = Sequence[Sequence[int]]
LARGEST = 2_000
"""Rows or columns of a matrix that a file may ask for by its size alone."""


class ExactError(ValueError):
    """A stored statement cannot be read: an unknown letter, operation or shape."""


class IntMatrix:
    """A matrix of Python integers with the few operations that proofs need."""

    __slots__ = ("columns", "rows", "values")

    def __init__(self, rows: int, columns: int, values: list[list[int]]) -> None:
        self.rows, self.columns, self.values = rows, columns, values

    def nrows(self) -> int:
        return self.rows

    def ncols(self) -> int:
        return self.columns

    def tolist(self) -> list[list[int]]:
        return self.values

    def transpose(self) -> IntMatrix:
        return IntMatrix(self.columns, self.rows, [[row[j] for row in self.values] for j in range(self.columns)])

    def __add__(self, other: IntMatrix) -> IntMatrix:
        rows = [[a + b for a, b in zip(r, s, strict=True)] for r, s in zip(self.values, other.values, strict=True)]
        return IntMatrix(self.rows, self.columns, rows)

    def __mul__(self, other: IntMatrix | int) -> IntMatrix:
        if isinstance(other, int):
            return IntMatrix(self.rows, self.columns, [[a * other for a in row] for row in self.values])
        columns = other.transpose().values
        rows = [[sum(map(int.__mul__, row, column)) for column in columns] for row in self.values]
        return IntMatrix(self.rows, other.columns, rows)


Backend = Callable[[int, int, list[list[int]]], Any]


@dataclass(frozen=True, slots=True)
class Dyadic:
    """The matrix `mat` * 2**`exponent`; `mat` is an integer matrix of shape (rows, columns)."""

    mat: Any
    exponent: int

    @property
    def shape(self) -> tuple[int, int]:
        return int(self.mat.nrows()), int(self.mat.ncols())


class DyadicAlgebra:
    """Sums, products and blocks of `Dyadic` matrices over one integer-matrix backend; every result is exact."""

    def __init__(self, backend: Backend = IntMatrix) -> None:
        self.backend = backend

    def from_floats(self, rows: int, columns: int, flat: Sequence[float]) -> Dyadic:
        """The exact value of a float matrix; flat: row by row.  Raises ExactError on a value that is not finite."""
        if len(flat) != rows * columns or min(rows, columns) < 0:
            raise ExactError(f"{len(flat)} numbers do not fill a {rows} by {columns} matrix")
        if not all(math.isfinite(v) for v in flat):
            raise ExactError("a stored number is not finite")
        ratios = [float(v).as_integer_ratio() for v in flat]
        shift = max((q.bit_length() - 1 for _, q in ratios), default=0)
        ints = [p << (shift - (q.bit_length() - 1)) for p, q in ratios]
        return self._make(rows, columns, [ints[i * columns : (i + 1) * columns] for i in range(rows)], -shift)

    def _make(self, rows: int, columns: int, values: list[list[int]], exponent: int) -> Dyadic:
        return Dyadic(self.backend(rows, columns, values), exponent)

    def number(self, value: float) -> Dyadic:
        return self.from_floats(1, 1, [value])

    def eye(self, n: int) -> Dyadic:
        return self._make(n, n, [[int(i == j) for j in range(n)] for i in range(n)], 0)

    def zero(self, rows: int, columns: int) -> Dyadic:
        return self._make(rows, columns, [[0] * columns for _ in range(rows)], 0)

    def add(self, a: Dyadic, b: Dyadic) -> Dyadic:
        if a.shape != b.shape:
            raise ExactError(f"cannot add {a.shape} and {b.shape}")
        low = min(a.exponent, b.exponent)
        return Dyadic(_at(a, low).mat + _at(b, low).mat, low)

    def neg(self, a: Dyadic) -> Dyadic:
        return Dyadic(a.mat * -1, a.exponent)

    def matmul(self, a: Dyadic, b: Dyadic) -> Dyadic:
        if a.shape[1] != b.shape[0]:
            raise ExactError(f"cannot multiply {a.shape} by {b.shape}")
        if a.shape[1] == 0:
            return self.zero(a.shape[0], b.shape[1])
        return Dyadic(a.mat * b.mat, a.exponent + b.exponent)

    def scale(self, s: Dyadic, a: Dyadic) -> Dyadic:
        if s.shape != (1, 1):
            raise ExactError(f"a {s.shape} matrix does not scale")
        return Dyadic(a.mat * int(s.mat.tolist()[0][0]), s.exponent + a.exponent)

    def transpose(self, a: Dyadic) -> Dyadic:
        return Dyadic(a.mat.transpose(), a.exponent)

    def block(self, rows: list[list[Dyadic]]) -> Dyadic:
        low = min((b.exponent for row in rows for b in row), default=0)
        out: list[list[int]] = []
        for row in rows:
            if len({b.shape[0] for b in row}) > 1:
                raise ExactError("the blocks of one row differ in height")
            parts = [integers(_at(b, low)) for b in row]
            out += [[v for part in parts for v in part[i]] for i in range(row[0].shape[0])]
        width = sum(b.shape[1] for b in rows[0]) if rows else 0
        if any(len(line) != width for line in out):
            raise ExactError("the block rows differ in width")
        return self._make(len(out), width, out, low)


def _at(a: Dyadic, exponent: int) -> Dyadic:
    return a if a.exponent == exponent else Dyadic(a.mat * (1 << (a.exponent - exponent)), exponent)


def integers(a: Dyadic) -> list[list[int]]:
    """The integer part of a dyadic matrix as rows of Python integers."""
    return [[int(v) for v in row] for row in a.mat.tolist()]


def largest(a: Dyadic) -> Fraction:
    """The largest absolute entry, exactly."""
    top = max((abs(v) for row in integers(a) for v in row), default=0)
    return Fraction(top) * Fraction(2) ** a.exponent


def read_tree(tree: Any, letter: Callable[[str], Dyadic], algebra: DyadicAlgebra) -> Dyadic:
    """The exact value of a stored expression tree (`lmi.prove.tree`), its letters looked up by `letter`."""

    def go(node: Any) -> Dyadic:
        match node:
            case str():
                return letter(node)
            case ["number", str() as text]:
                return algebra.number(float.fromhex(text))
            case ["eye", int() as n] if 0 <= n <= LARGEST:
                return algebra.eye(n)
            case ["zero", int() as rows, int() as columns] if 0 <= rows <= LARGEST and 0 <= columns <= LARGEST:
                return algebra.zero(rows, columns)
            case ["add", a, b]:
                return algebra.add(go(a), go(b))
            case ["neg", a]:
                return algebra.neg(go(a))
            case ["matmul", a, b]:
                return algebra.matmul(go(a), go(b))
            case ["scale", s, a]:
                return algebra.scale(go(s), go(a))
            case ["T", a]:
                return algebra.transpose(go(a))
            case ["block", [*rows]]:
                return algebra.block([[go(b) for b in row] for row in rows])
        raise ExactError(f"no such operation in a statement: {str(node)[:60]}")

    return go(tree)


# ---------------------------------------------------------------- definiteness


@dataclass(frozen=True, slots=True)
class Definite:
    """Whether a matrix is positive definite: the answer, how it was reached, how far it is from changing.

    margin: estimate of the smallest eigenvalue after the diagonal is scaled to about one; 0 when elimination decided.
    witness: integer vector v with vᵀ M v <= 0 when refuted.
    """

    verdict: Literal["proved", "refuted"]
    how: str
    margin: float = 0.0
    witness: tuple[int, ...] = ()


def prove_positive(a: Dyadic, algebra: DyadicAlgebra) -> Definite:
    """Prove or refute that the exact matrix `a` is positive definite.  Raises ExactError if it is not symmetric."""
    n, columns = a.shape
    m = integers(a)
    if n != columns or any(m[i][j] != m[j][i] for i in range(n) for j in range(i)):
        raise ExactError("a definiteness claim is about a symmetric matrix")
    if n == 0:
        return Definite("proved", "an empty matrix", margin=1.0)
    for i in range(n):
        if m[i][i] <= 0:
            return Definite("refuted", "diagonal entry", witness=tuple(int(k == i) for k in range(n)))
    # Powers of two bring the diagonal near one, so that the floating-point factor below sees a well-scaled matrix.
    half = [m[i][i].bit_length() // 2 for i in range(n)]
    try:
        return _by_factor(a, m, half, algebra) or _by_elimination(m)
    except (OverflowError, ValueError):  # an entry is out of proportion to its diagonal: only integers can tell
        return _by_elimination(m)


def _by_factor(a: Dyadic, m: list[list[int]], half: list[int], algebra: DyadicAlgebra) -> Definite | None:
    n = len(m)
    # Python divides integers of any size with one rounding.
    scaled = [[m[i][j] / (1 << (half[i] + half[j])) for j in range(n)] for i in range(n)]
    inverse, failed = _inverse_cholesky(scaled)
    if failed is not None:
        witness = _integer_vector([math.ldexp(v, -h) for v, h in zip(failed, half, strict=True)])
        if any(witness) and _quadratic(m, witness) <= 0:
            return Definite("refuted", "witness from a failed Cholesky step", witness=witness)
        return None
    if not _dominant(a, inverse, half, algebra):
        return None
    margin = 1.0 / sum(v * v for row in inverse for v in row)
    return Definite("proved", "congruence and diagonal dominance", margin=margin)


def _inverse_cholesky(s: list[list[float]]) -> tuple[list[list[float]], list[float] | None]:
    """L⁻¹ for s = L Lᵀ in floating point; or, at the first pivot <= 0, a direction that is likely a witness."""
    n = len(s)
    lower: list[list[float]] = []
    inverse: list[list[float]] = []
    for k in range(n):
        row: list[float] = []
        for j in range(k):
            row.append((s[k][j] - sum(map(float.__mul__, row, lower[j]))) / lower[j][j])
        pivot = s[k][k] - sum(v * v for v in row)
        # e_k - Σ (L⁻ᵀ row)_j e_j  solves  s v = 0  in the first k rows: the Schur complement direction.
        direction = [-sum(row[i] * inverse[i][j] for i in range(j, k)) for j in range(k)]
        if not pivot > 0:
            return [], direction + [1.0] + [0.0] * (n - k - 1)
        root = math.sqrt(pivot)
        lower.append(row + [root])
        inverse.append([v / root for v in direction] + [1.0 / root])
    return inverse, None


def _dominant(a: Dyadic, inverse: list[list[float]], half: list[int], algebra: DyadicAlgebra) -> bool:
    n = len(inverse)
    bits, top = 60, max(half)
    rows = []
    for i in range(n):
        head = [int(math.ldexp(v, bits)) << (top - half[j]) for j, v in enumerate(inverse[i])]
        rows.append(head + [0] * (n - i - 1))
    factor = Dyadic(algebra.backend(n, n, rows), 0)
    g = integers(algebra.matmul(algebra.matmul(factor, Dyadic(a.mat, 0)), algebra.transpose(factor)))
    return all(g[i][i] > sum(abs(g[i][j]) for j in range(n) if j != i) for i in range(n))


def _by_elimination(m: list[list[int]]) -> Definite:
    """Bareiss' fraction-free elimination; the k-th pivot is the k-th leading principal minor."""
    n = len(m)
    u = [row[:] for row in m]
    previous = 1
    for k in range(n):
        if u[k][k] <= 0:
            v = [Fraction(0)] * n
            v[k] = Fraction(1)
            for i in reversed(range(k)):
                v[i] = -sum((u[i][j] * v[j] for j in range(i + 1, k + 1)), Fraction(0)) / u[i][i]
            common = math.lcm(*(x.denominator for x in v))
            return Definite("refuted", "fraction-free elimination", witness=tuple(int(x * common) for x in v))
        for i in range(k + 1, n):
            for j in range(i, n):
                u[i][j] = (u[i][j] * u[k][k] - u[k][i] * u[k][j]) // previous
                u[j][i] = u[i][j]
        previous = u[k][k]
    return Definite("proved", "fraction-free elimination")


def _integer_vector(v: Sequence[float]) -> tuple[int, ...]:
    top = max(abs(x) for x in v)
    shift = 52 - math.frexp(top)[1]
    return tuple(int(math.ldexp(x, shift)) for x in v)


def _quadratic(m: Rows, v: Sequence[int]) -> int:
    return sum(v[i] * v[j] * m[i][j] for i in range(len(v)) for j in range(len(v)))


LONGEST = 100_000
"""Bits of an integer in a statement; a product of ten float matrices has about a thousand."""


def largest_bits(a: Dyadic) -> int:
    """Length of the longest integer, and of the common exponent, in bits."""
    return max((abs(v).bit_length() for row in integers(a) for v in row), default=0) + abs(a.exponent)


def letters_from(data: Mapping[str, Dyadic], lets: Mapping[str, Any], algebra: DyadicAlgebra) -> dict[str, Dyadic]:
    """All letters of a statement: the data, and each definition, whatever their order in the file."""
    known, begun = dict(data), set[str]()

    def look(name: str) -> Dyadic:
        if name not in known:
            if name not in lets:
                raise ExactError(f"the letter {name} is not defined")
            if name in begun:
                raise ExactError(f"the letter {name} is defined by itself")
            begun.add(name)
            known[name] = read_tree(lets[name], look, algebra)
            if largest_bits(known[name]) > LONGEST:
                raise ExactError(f"the numbers of {name} grow beyond {LONGEST} bits")
        return known[name]

    for name in lets:
        if name in data:
            raise ExactError(f"the letter {name} is defined twice")
        look(name)
    return known
