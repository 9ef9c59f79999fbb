# SPDX-License-Identifier: BSD-3-Clause
"""The executable equations of an observer: matrices for the linear part, graphs for the rest.

    ż = A z + B v + N φ(sat(S z + s0), u, t) + M g(y, u, t)        v = [u - u0; y - y0]
    x̂ = x0 + Cx z + Dx v,    f̂ = Cf z + Df v,    y - F f̂ is the corrected measurement

φ and g read absolute values; sat keeps the argument of φ in the domain for which its bound is claimed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.function import Graph

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NonlinearTerm:
    """N φ(sat(S z + s0), u, t): into N (nz, r), reads S (s, nz), offset s0 (s,), limits lower and upper (s,)."""

    into: Array
    reads: Array
    offset: Array
    lower: Array
    upper: Array
    phi: Graph


@dataclass(frozen=True, eq=False)
class CopiedTerm:
    """M g(y, u, t): into M (nz, k), g a graph with inputs y, u, t."""

    into: Array
    g: Graph


@dataclass(frozen=True, eq=False)
class Observer:
    """A continuous-time observer with nz states, driven by v = [u - u0; y - y0] of m + p entries.

    A (nz, nz), B (nz, m+p), Cx (n, nz), Dx (n, m+p), Cf (q, nz), Df (q, m+p), F (p, q); x0 (n,), u0 (m,), y0 (p,).
    """

    A: Array
    B: Array
    Cx: Array
    Dx: Array
    Cf: Array
    Df: Array
    F: Array
    x0: Array
    u0: Array
    y0: Array
    nonlinear: NonlinearTerm | None = None
    copied: CopiedTerm | None = None

    @property
    def inputs(self) -> int:
        """Number of plant inputs m."""
        return len(self.u0)

    @property
    def linear(self) -> bool:
        """Whether the matrices say it all."""
        return self.nonlinear is None and self.copied is None

    @property
    def poles(self) -> NDArray[Any]:
        """Eigenvalues of the linear part, slowest first."""
        values = np.asarray(np.linalg.eigvals(self.A))
        return values[np.argsort(-values.real)]
