# SPDX-License-Identifier: BSD-3-Clause
"""What a count says about the rate behind it: exact intervals, each end of which is wrong in one case of twenty.

A count of nothing is no rate of nothing: with no event in N trials the upper end is 1 - 0.05^(1/N), about 3/N, and with
none in H hours it is 3.0/H ("rule of three").
"""

from __future__ import annotations

import math

ODDS = 0.05  # that the truth lies beyond one end


def share_interval(count: int, trials: int) -> tuple[float, float]:
    """The share behind `count` in so many independent trials [Clopper and Pearson 1934]; (0, 1) without any."""
    from scipy.special import betaincinv

    if trials == 0:
        return 0.0, 1.0
    low = 0.0 if count == 0 else float(betaincinv(count, trials - count + 1, ODDS))
    high = 1.0 if count == trials else float(betaincinv(count + 1, trials - count, 1.0 - ODDS))
    return low, high


def rate_interval(count: int, time: float) -> tuple[float, float]:
    """The rate behind `count` events in so much time, if they come independently [Garwood 1936]; (0, inf) in none."""
    from scipy.special import gammaincinv

    if not time > 0:
        return 0.0, math.inf
    low = 0.0 if count == 0 else float(gammaincinv(count, ODDS))
    return low / time, float(gammaincinv(count + 1, 1.0 - ODDS)) / time
