# SPDX-License-Identifier: BSD-3-Clause
"""A lag by products of matrices is the loop that it stands for."""

import numpy as np
import pytest

from faultrecon.numerics.lag import Lag


@pytest.mark.parametrize("length", [1, 7, 36, 256])
@pytest.mark.parametrize("keeps", [0.0, 0.3, 0.999])
def test_a_lag_is_its_recursion_from_block_to_block(length, keeps):
    rng = np.random.default_rng(length)
    x, lag, held = rng.normal(size=(3, 2, 3 * length)), Lag(keeps, 0.4, length), rng.normal(size=(3, 2))
    wanted, y = [], held
    for k in range(3 * length):
        y = keeps * y + 0.4 * x[..., k]
        wanted.append(y)
    for begin in range(0, 3 * length, length):
        found = lag.over(x[..., begin : begin + length], held)
        np.testing.assert_allclose(
            found, np.array(wanted[begin : begin + length]).transpose(1, 2, 0), rtol=1e-12, atol=1e-13 * length
        )  # rounding of so many terms, all of them of the order of one
        held = found[..., -1]
