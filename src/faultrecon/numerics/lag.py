# SPDX-License-Identifier: BSD-3-Clause
"""A first-order lag over many signals at once, y⁺ = keeps y + takes x⁺, by products of matrices and not in a loop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Lag:
    """For signals of `length` samples.  These are taken in parts, and the parts are then carried on into each other."""

    keeps: float
    takes: float
    length: int

    def over(self, x: Array, before: Array) -> Array:
        """y (..., length) of x (..., length), where y was `before` (...) at the sample before."""
        part = len(self._within)
        y = (x.reshape(-1, part) @ self._within).reshape(*before.shape, self.length // part, part)
        ahead = y[..., -1] @ self._across + before[..., None] * self._ages
        y += ahead[..., None] * self.keeps ** np.arange(1, part + 1)
        return y.reshape(x.shape)

    @cached_property
    def _within(self) -> Array:
        """What each x of a part adds to each y of it; a part is about as long as there are parts."""
        part = next(k for k in range(math.isqrt(self.length), 0, -1) if self.length % k == 0)
        return self.takes * _powers(self.keeps, part)

    @cached_property
    def _across(self) -> Array:
        """What the end of each part adds to what is held before each."""
        part = len(self._within)
        powers = _powers(self.keeps**part, self.length // part)
        return np.hstack([np.zeros((len(powers), 1)), powers[:, :-1]])

    @cached_property
    def _ages(self) -> Array:
        """What is left before each part of what was held before the first."""
        part = len(self._within)
        return self.keeps ** np.arange(0, self.length, part)


def _powers(base: float, count: int) -> Array:
    """base^(k - j) at [j, k] for j <= k, else 0."""
    ages = np.arange(count) - np.arange(count)[:, None]
    return np.where(ages >= 0, base ** np.maximum(ages, 0), 0.0)
