# SPDX-License-Identifier: BSD-3-Clause
"""The level of a plant with a rigid-body mode: a pole on the imaginary axis is no bound."""

from itertools import permutations

import numpy as np
import pytest

from faultrecon.numerics.level import optimal_level


def test_a_pole_at_the_origin_is_not_taken_for_a_bound_whatever_the_order_of_the_states():
    A = np.array([[0, 1, 0, 0], [-48.6, -1.25, 48.6, 0], [0, 0, 0, 1], [19.5, 0, -19.5, 0]])
    B = np.hstack([np.eye(4)[:, [1, 3]], np.zeros((4, 2))])
    E1 = np.array([[0, 0, 0.1, 0], [0, 0, 0, 0.1]])
    levels = []
    for order in permutations(range(4)):
        p = list(order)
        C1, H1 = np.eye(4)[:2][:, p], -np.eye(4)[2:3][:, p]
        found = optimal_level(
            A[np.ix_(p, p)], np.zeros((4, 0)), B[p], C1, E1, H1, np.zeros((1, 4)), np.zeros((0, 4)), 0.0
        )
        levels.append(found.gamma)
        assert found.lower <= found.gamma
    assert levels == pytest.approx([levels[0]] * len(levels), rel=1e-6)
