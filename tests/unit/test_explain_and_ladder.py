# SPDX-License-Identifier: BSD-3-Clause
"""Why there is no solution, and how gains become proved ones."""

from dataclasses import replace

import numpy as np
import pytest

from faultrecon.finding import Impossible, Inconclusive
from faultrecon.io.library import read_library
from faultrecon.lmi.explain import diagonal_blocks, explain
from faultrecon.lmi.expr import I, __, given, sym, unknown
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.solve import Outcome, solve
from faultrecon.methods.registry import method
from faultrecon.synthesis import ladder
from faultrecon.synthesis.levels import pose
from faultrecon.synthesis.pipeline import design, optimum

POLYNOMIAL = read_library("lipschitz_polynomial")


def test_a_block_that_fails_alone_is_named():
    P = unknown("P", 1, 1, symmetric=True)
    unstable = given("A", [[1.0]])
    claim = (sym([[unstable.T @ P + P @ unstable, P], [__, -I(1)]]) < 0).tagged("(1)")
    problem = Problem([claim, P > 0])
    found = explain(problem, Outcome("infeasible"))
    assert found.alone == ("block (1,1) = Aᵀ P + P A of (1)",)
    assert "cannot be satisfied even alone" in str(found)


def test_when_only_the_whole_fails_the_dual_says_where():
    p = unknown("p")
    claim = (sym([[p * I(1), given("B", [[2.0]])], [__, I(1)]]) > 0).tagged("(1)")
    upper = ((3 - p) > 0).tagged("p < 3")
    problem = Problem([claim, upper])  # p > 4 and p < 3
    outcome = solve(problem)
    assert outcome.status == "infeasible"
    found = explain(problem, outcome)
    assert found.alone == ()
    shares = dict(found.shares)
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["p < 3"] > 0.05 and shares["block (1,1) = p·I1 of (1)"] > 0.05


def test_blocks_of_size_zero_are_no_reason():
    claim = sym([[given("A", -np.eye(1)), given("B", np.ones((1, 0)))], [__, -unknown("β") * I(0)]]) < 0
    assert [label for label, _ in diagonal_blocks(claim)] == ["block (1,1) = A"]


def test_raising_the_level_would_not_help_example_4_2_beyond_root_two():
    too_steep = replace(POLYNOMIAL, nonlinearity=replace(POLYNOMIAL.nonlinearity, constant=1.42))
    with pytest.raises(Impossible) as caught:
        design(too_steep)
    shares = caught.value.finding.evidence["shares"]
    level = next(share for label, share in shares.items() if "γ²" in label)
    assert level < 1e-6  # the block of γ² takes no part in the contradiction
    assert "Lipschitz constant" in str(caught.value)


def test_gains_on_the_boundary_are_repaired_by_multipliers_of_more_margin(monkeypatch):
    posed = pose(method("lipschitz-hinf"), POLYNOMIAL)
    level = 1.05 * optimum(POLYNOMIAL)
    good, criterion = ladder.pick(posed, level)
    # A multiplier far off refutes (3.1); the gains themselves are fine.
    spoilt = replace(good, values={**good.values, "β": 100.0 * good.values["β"]})
    monkeypatch.setattr(ladder, "pick", lambda posed, level: (spoilt, criterion))
    proven, rungs = ladder.climb(posed, [level], lambda stage: None)
    assert proven is not None and proven.verification.sound
    assert [r.multipliers for r in rungs] == ["the solver's multipliers", "those of largest margin"]
    assert "(3.1) is refuted by v = [" in rungs[0].outcome and rungs[1].outcome.startswith("proved exactly")


def test_a_level_that_cannot_be_proved_is_followed_by_a_larger_one(monkeypatch):
    posed = pose(method("lipschitz-hinf"), POLYNOMIAL)
    best = optimum(POLYNOMIAL)
    true_pick = ladder.pick

    def stubborn(posed, level):
        return (
            (Outcome("unknown", solver="Clarabel: NumericalError"), "")
            if level < 1.2 * best
            else true_pick(posed, level)
        )

    monkeypatch.setattr(ladder, "pick", stubborn)
    proven, rungs = ladder.climb(posed, [1.05 * best, 1.1 * best, 1.3 * best], lambda stage: None)
    assert proven is not None and proven.level == 1.3 * best
    assert [r.multipliers for r in rungs[:2]] == ["no gains", "no gains"]


def test_what_cannot_be_proved_is_reported_with_the_vector_that_refutes_it(monkeypatch):
    good, criterion = ladder.pick(pose(method("lipschitz-hinf"), POLYNOMIAL), 1.05 * optimum(POLYNOMIAL))
    backwards = replace(good, values={**good.values, "Z": -good.values["Z"]})
    monkeypatch.setattr(ladder, "pick", lambda posed, level: (backwards, criterion))
    with pytest.raises(Inconclusive) as caught:
        design(POLYNOMIAL)
    text = str(caught.value)
    assert "nothing is certified" in text and "refuted by v = [" in text
    assert caught.value.finding.remedies
