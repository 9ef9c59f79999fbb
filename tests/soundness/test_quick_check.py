# SPDX-License-Identifier: BSD-3-Clause
"""The floating-point check with rigorous bounds never says more than exact integers do."""

import numpy as np
import pytest
from hypothesis import given as forall
from hypothesis import settings
from hypothesis import strategies as st

from faultrecon.io.library import read_library
from faultrecon.lmi.expr import I, __, given, sym, unknown
from faultrecon.lmi.prove import statement
from faultrecon.lmi.quick import Ball, positive_definite, quickly_proved
from faultrecon.plant.stored import stored_matrix
from faultrecon.synthesis.certify import proof_inequalities
from faultrecon.synthesis.levels import pose
from faultrecon.synthesis.pipeline import design


def nearly_singular(seed, n, tilt):
    """A = Q diag(1 ... tilt) Qᵀ assembled from factors, so that its rounding matters where tilt is an ulp."""
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    scales = np.exp2(rng.integers(-30, 30, n))
    values = np.append(rng.uniform(0.1, 1, n - 1), tilt)
    return given("S", np.diag(scales) @ Q), given("D", np.diag(values))


@settings(max_examples=300, deadline=None)
@forall(
    st.integers(0, 2**32 - 1),
    st.integers(1, 10),
    st.sampled_from([0.1, 1e-8, 1e-13, 3e-15, 2e-16, 0.0, -1e-17, -1e-12]),
)
def test_what_is_quickly_proved_is_exactly_true(seed, n, tilt):
    S, D = nearly_singular(seed, n, tilt)
    claim = (S @ D @ S.T + given("E", np.zeros((n, n)))) > 0
    if quickly_proved(claim, {}):
        assert statement(claim, {}).prove().verdict == "proved"


@pytest.mark.parametrize("tilt", [1e-2, 1e-6, 1e-10])
def test_margins_far_above_rounding_are_recognised(tilt):
    # Rounding of assembly and Cholesky at n = 8 is below 1e-13 of the trace; these margins are a thousand times that.
    S, D = nearly_singular(5, 8, tilt)
    assert quickly_proved((S @ D @ S.T) > 0, {})


def test_the_smallest_relative_margin_shown_is_near_the_unit_roundoff():
    for n in (13, 34, 124):
        assert positive_definite(Ball(np.diag([1.0] * (n - 1) + [1e-10]), np.zeros((n, n))))


def test_a_radius_that_reaches_an_indefinite_matrix_is_not_passed():
    mid = np.array([[1.0, 0.5], [0.5, 1.0]])
    assert positive_definite(Ball(mid, np.full((2, 2), 0.2)))
    assert not positive_definite(Ball(mid, np.full((2, 2), 0.3)))  # [[0.7, 0.8], [0.8, 0.7]] lies within


def test_infinite_and_undefined_entries_are_not_passed():
    for bad in (np.inf, np.nan):
        assert not positive_definite(Ball(np.array([[bad, 0.0], [0.0, 1.0]]), np.zeros((2, 2))))
        assert not positive_definite(Ball(np.eye(2), np.array([[bad, 0.0], [0.0, 0.0]])))


def test_symmetric_unknowns_and_blocks_are_read():
    P, g = unknown("P", 2, 2, symmetric=True), unknown("g")
    claim = sym([[P, given("B", np.array([[1.0], [0.0]]))], [__, g * I(1)]]) > 0
    assert quickly_proved(claim, {"P": np.eye(2), "g": 1.5})
    assert not quickly_proved(claim, {"P": np.eye(2), "g": 0.5})


@pytest.mark.parametrize("name", ["lipschitz_aircraft", "lipschitz_polynomial", "airliner"])
def test_the_designs_of_the_library_pass_it(name):
    found = design(read_library(name))
    posed = pose(found_method(found), found.plant)
    stored = {**found.certificate.data, **found.certificate.gains}
    values = {k: stored_matrix(v) for k, v in stored.items()} | {"γ": found.level}
    assert all(quickly_proved(i, values) for i in proof_inequalities(posed.theorem))


def found_method(found):
    from faultrecon.methods.registry import method

    return method(found.method)
