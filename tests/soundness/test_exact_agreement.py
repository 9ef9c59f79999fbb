# SPDX-License-Identifier: BSD-3-Clause
"""Three opinions on definiteness: Python's integers, python-flint's integers, and rational elimination."""

import json
import math
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import faultrecon
from faultrecon.io.library import read_library
from faultrecon.lmi.exact import DyadicAlgebra, ExactError, IntMatrix, prove_positive
from faultrecon.lmi.prove import exact, fast_algebra
from faultrecon.synthesis.pipeline import design

EPS = np.finfo(float).eps
KINDS = ("definite", "indefinite", "nearly singular", "singular within an ulp", "badly scaled", "exactly singular")


def case(rng, kind, n):
    """A symmetric float matrix of one kind."""
    half = rng.normal(size=(n, n))
    gram = half @ half.T
    match kind:
        case "definite":
            M = gram + 0.1 * np.eye(n)
        case "indefinite":
            M = half + half.T
        case "nearly singular":
            q = np.linalg.qr(half)[0]
            M = (q * np.concatenate([[10.0 ** rng.uniform(-16, -8)], rng.uniform(0.5, 2, n - 1)])) @ q.T
        case "singular within an ulp":
            # A Gram matrix of short integer vectors is exactly singular; one ulp on one entry decides its fate.
            short = rng.integers(-3, 4, size=(n, max(n - 1, 1))).astype(float)
            M = short @ short.T + np.diag((np.diag(short @ short.T) == 0).astype(float))
            k = int(rng.integers(n))
            M[k, k] = np.nextafter(M[k, k], rng.choice([-np.inf, np.inf]))
        case "badly scaled":
            unit = 10.0 ** rng.uniform(-75, 75, n)
            M = (gram + rng.choice([0.01, -0.01]) * np.eye(n)) * unit[:, None] * unit[None, :]
        case _:
            short = rng.integers(-3, 4, size=(n, max(n - 1, 1))).astype(float)
            M = short @ short.T
    return np.triu(M) + np.triu(M, 1).T


def sylvester(M):
    """Whether all pivots of rational elimination are positive: the third opinion, by code of its own."""
    rows = [[Fraction(float(v)) for v in row] for row in M]
    for k in range(len(rows)):
        if rows[k][k] <= 0:
            return False
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / rows[k][k]
            if factor:
                rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return True


def quadratic(M, v):
    """vᵀ M v in rational numbers."""
    return sum(
        Fraction(float(M[i, j])) * v[i] * v[j] for i in range(len(v)) for j in range(len(v)) if v[i] and v[j]
    ) + Fraction(0)


@pytest.mark.parametrize("part", range(10))
def test_both_integer_libraries_and_rational_elimination_agree(part):
    rng = np.random.default_rng(part)
    plain, fast = DyadicAlgebra(IntMatrix), fast_algebra()
    assert fast.backend is not IntMatrix  # python-flint is a dependency, so this is a comparison of two libraries
    verdicts = set()
    for number in range(100):
        M = case(rng, KINDS[number % len(KINDS)], 1 + number % 12)
        one = prove_positive(exact(M, plain), plain)
        two = prove_positive(exact(M, fast), fast)
        assert one == two
        assert (one.verdict == "proved") == sylvester(M)
        if one.verdict == "refuted":
            assert any(one.witness)
            assert quadratic(M, one.witness) <= 0
        verdicts.add((one.verdict, one.how))
    assert {v for v, _ in verdicts} == {"proved", "refuted"}


def test_every_way_to_a_verdict_is_walked():
    algebra = DyadicAlgebra()
    rng = np.random.default_rng(1)
    found = {prove_positive(exact(case(rng, KINDS[k % 6], 1 + k % 9), algebra), algebra).how for k in range(300)}
    assert found >= {
        "diagonal entry",
        "congruence and diagonal dominance",
        "witness from a failed Cholesky step",
        "fraction-free elimination",
    }


@pytest.mark.parametrize(
    "M",
    [
        # The floating-point factor of these overflows to infinity or NaN: only integers can tell.
        [[0.5, 0.0, 1.7e308], [0.0, 0.5, 1.0], [1.7e308, 1.0, 0.5]],
        [[1e-300, 1e300], [1e300, 1e-300]],
        [[1.0, 1.7e308], [1.7e308, 1.0]],
    ],
)
def test_entries_out_of_proportion_are_refuted_by_integers(M):
    M = np.array(M)
    found = prove_positive(exact(M, DyadicAlgebra()), DyadicAlgebra())
    assert found.verdict == "refuted"
    assert quadratic(M, found.witness) <= 0


@pytest.mark.parametrize("tiny", [5e-324, 1e-300, 1e-20])
def test_the_smallest_margin_decides(tiny):
    algebra = DyadicAlgebra()
    for sign, verdict in ((1.0, "proved"), (-1.0, "refuted"), (0.0, "refuted")):
        # Eigenvalues of [[1, 1], [1, 1]] + diag(0, 0, t): the last one alone decides.
        M = np.array([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, sign * tiny]])
        assert prove_positive(exact(M, algebra), algebra).verdict == verdict


def test_one_ulp_from_singular_falls_on_its_own_side():
    algebra = DyadicAlgebra()
    for corner, verdict in ((1.0, "refuted"), (1.0 + EPS, "proved"), (1.0 - EPS / 2, "refuted")):
        M = np.array([[1.0, 1.0], [1.0, corner]])
        assert prove_positive(exact(M, algebra), algebra).verdict == verdict


def test_a_matrix_that_is_not_symmetric_is_no_claim():
    algebra = DyadicAlgebra()
    with pytest.raises(ExactError, match="symmetric"):
        prove_positive(exact([[1.0, 0.0], [EPS, 1.0]], algebra), algebra)
    with pytest.raises(ExactError, match="symmetric"):
        prove_positive(exact(np.ones((1, 2)), algebra), algebra)


def test_numbers_that_are_not_finite_are_no_numbers():
    for value in (math.nan, math.inf):
        with pytest.raises(ExactError, match="not finite"):
            exact([[value]], DyadicAlgebra())


BLOCKED = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("numpy", "scipy", "flint", "casadi", "clarabel", "pandas", "pyarrow", "matplotlib"):
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, Blocked())
sys.path.insert(0, sys.argv[1])
from faultrecon.certificate import load_certificate

for path in sys.argv[2:]:
    print(load_certificate(path).verify().verdict)
third = {m.split(".")[0] for m in sys.modules} - set(sys.stdlib_module_names) - {"faultrecon", "__main__"}
print(sorted(third))
"""


def document(found):
    """A design as its file holds it."""
    certificate = found.certificate
    return {
        "kind": "faultrecon-design",
        "plant": certificate.plant,
        "gains": certificate.gains,
        "certificate": certificate.as_dict(),
    }


def test_the_standard_library_alone_verifies_a_design_file_and_refutes_a_spoilt_one(tmp_path):
    good = document(design(read_library("lipschitz_polynomial")))
    bad = json.loads(json.dumps(good))
    bad["gains"]["L"]["hex"][0] = (50.0).hex()
    for name, content in (("good.json", good), ("bad.json", bad)):
        (tmp_path / name).write_text(json.dumps(content), encoding="utf-8")
    source = str(Path(faultrecon.__file__).parents[1])
    files = [str(tmp_path / "good.json"), str(tmp_path / "bad.json")]
    answer = subprocess.run(
        [sys.executable, "-S", "-c", BLOCKED, source, *files], capture_output=True, text=True, check=False, timeout=60
    )
    assert answer.stdout.split("\n")[:3] == ["assumed", "refuted", "[]"], answer.stderr
