# SPDX-License-Identifier: BSD-3-Clause
"""The smallest level of the Lipschitz H-infinity filter problem, found between two bounds and without a solver.

For the error system e' = (A - L C1) e + Bphi dphi + (B - L E1) w, ef = H1 e + H2 w, |dphi| <= alpha |G e|, the levels
g = gamma^2 for which some L, P > 0 and beta > 0 prove int ef^2 <= g int w^2 form a convex set in (beta, g).  With L
eliminated (E1 of full row rank) a point belongs to it when the largest solution P of one Riccati equation exists and is
positive.  Where it fails, the failure itself is a half plane that contains the whole set:

- a Hamiltonian eigenvalue on the axis: at that frequency some (dphi, w) invisible to the healthy outputs breaks the
  inequality, and the form is linear in (beta, g);
- P not positive: v'P v is concave in (beta, g), its gradient costs one Lyapunov equation.

So each test either accepts a level or raises the lower bound by a Newton step, and the search over beta sees slopes, not
only values.  Khosrowjerdi 2011, Theorem 3.1, in the form of Section 8 of its re-derivation; cf. performance figures there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import Impossible, Inconclusive
from faultrecon.numerics.hamiltonian import StableSubspace, signs, stable_subspace
from faultrecon.numerics.scaling import scale_states, spectral_norm, state_scaling

Array = NDArray[Any]

POSITIVE = 1e-11
"""A sine of twice the angle of X above minus this counts as not negative: the subspace is known to about 1e-14."""


@dataclass(frozen=True, slots=True)
class LevelSolution:
    """The optimum (an infimum, not attained): gamma was accepted, no level below `lower` can be.

    beta: the multiplier gamma belongs to; None when there is no nonlinearity.  schur_count: Hamiltonian Schur forms.
    """

    gamma: float
    beta: float | None
    schur_count: int
    lower: float


@dataclass(frozen=True, slots=True)
class FilterProblem:
    """The problem on the disturbances that healthy outputs do not show, in balanced units.

    w = -K C1 x + (free) nu; A0, B0, H0, H20 act on (x, nu), |w|^2 = |Cn x|^2 + |nu|^2, G contains alpha.
    """

    A0: Array
    Bf: Array
    B0: Array
    Cn: Array
    H0: Array
    H20: Array
    G: Array
    least: float


@dataclass(frozen=True, slots=True)
class Cut:
    """a beta + b g >= c holds for every feasible (beta, g)."""

    a: float
    b: float
    c: float

    def level(self, beta: float) -> float:
        """The smallest g this cut allows at beta."""
        missing = self.c - self.a * beta
        if self.b > 1e-13 * max(abs(self.a) * beta, abs(self.c)):
            return missing / self.b
        return np.inf if missing > 1e-9 * abs(self.c) else 0.0

    def slope(self) -> float:
        """d g / d beta along the cut."""
        return -self.a / max(self.b, 1e-300)


@dataclass
class Search:
    """The cuts so far and the number of Schur forms: the only state of the search."""

    cuts: list[Cut] = field(default_factory=list)
    schur_count: int = 0

    def level(self, beta: float) -> tuple[float, Cut | None]:
        """The highest lower bound at beta and the cut it comes from."""
        if not self.cuts:
            return 0.0, None
        levels = [cut.level(beta) for cut in self.cuts]
        k = int(np.argmax(levels))
        return levels[k], self.cuts[k]
