# SPDX-License-Identifier: BSD-3-Clause
"""The executable equations of an observer: matrices for the linear part, graphs for the rest.

    ż = A z + B v + N φ(sat(S z + S_v v + s0), u, t) + M g(y, u, t) + Σ G_n ν        v = [u - u0; y - y0]
    x̂ = x0 + Cx z + Dx v,    f̂ = Cf z + Df v,    y - F f̂ is the corrected measurement

Faults that multiply: the corrected measurement is (y - F_a f̂) / (1 + F_m f̂), F_m the columns of F named in `scales`.
Where f̂ is no linear function of z and v, `readout` makes it of them.

φ and g read absolute values; sat keeps the argument of φ in the domain for which its bound is claimed.  Each ν is the
discontinuous injection of a sliding-mode observer, see `Injection`; most observers have none.

A sampled observer has a sample time, and z at the next sample in place of ż: A, B, N and M are then those of a map from
one sample to the next, and v, u, y and t are those of the sample that is left behind.  What it shows is that of the new
one: x̂ = x0 + Cx z + Dx v with the measurement just taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.function import Graph

Array = NDArray[np.float64]

GONE = 1e-6
"""Multiplier per sample of a mode that one sample ends, as far as anybody can see; its rate would be infinite."""


@dataclass(frozen=True, eq=False)
class NonlinearTerm:
    """N φ(sat(S z + S_v v + s0), u, t): into N (nz, r), reads S (s, nz), offset s0 (s,), limits lower and upper (s,).

    direct: S_v (s, m+p), for observers whose x̂ reads the samples themselves; None where it is zero.
    flat: whether it has no slope where the observer settles, so that A and B say how small signals pass.
    """

    into: Array
    reads: Array
    offset: Array
    lower: Array
    upper: Array
    phi: Graph
    direct: Array | None = None
    flat: bool = False


@dataclass(frozen=True, eq=False)
class Injection:
    """The unit-vector injection of a sliding-mode observer, set valued where its argument vanishes.

        e = reads z + direct v,    ν = -ρ P e / (|P e| + δ),    and any |ν| ≤ ρ at P e = 0 when δ = 0

    linear: G_l (nz, k), so that A and B of the observer hold -G_l e already: the implicit step takes it apart again.
    into: G_n (nz, k), with reads @ into invertible.  reads (k, nz), direct (k, m+p).
    weight: P (k, k), symmetric and positive definite.
    bound: ρ > 0 in the unit of e per second.  layer: δ >= 0 in the unit of P e; it smooths the injection.
    """

    linear: Array
    into: Array
    reads: Array
    direct: Array
    weight: Array
    bound: float
    layer: float = 0.0


@dataclass(frozen=True, eq=False)
class CopiedTerm:
    """M g(y, u, t): into M (nz, k), g a graph with inputs y, u, t."""

    into: Array
    g: Graph


@dataclass(frozen=True, eq=False)
class Observer:
    """An observer with nz states, driven by v = [u - u0; y - y0] of m + p entries.

    A (nz, nz), B (nz, m+p), Cx (n, nz), Dx (n, m+p), Cf (q, nz), Df (q, m+p), F (p, q); x0 (n,), u0 (m,), y0 (p,).
    The injections of a continuous observer, when stepped, act in the order given: each reads what the ones before it
    have moved.

    sample_time: seconds between the samples of a sampled observer, None for a continuous one.  prior (n, nz): x - x0 as
    the observer's state alone predicts it, which stands in for samples that lack everything; None: their last value.
    scales: which faults multiply what their sensors show.  readout: graph of f (q), what Cf z + Df v gives, and x (n),
    the absolute x̂; its q outputs are then f̂.
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
    injections: tuple[Injection, ...] = ()
    sample_time: float | None = None
    prior: Array | None = None
    scales: tuple[int, ...] = ()
    readout: Graph | None = None

    @property
    def inputs(self) -> int:
        """Number of plant inputs m."""
        return len(self.u0)

    @property
    def linear(self) -> bool:
        """Whether the matrices say it all."""
        return self.nonlinear is None and self.copied is None and not self.injections

    @property
    def split(self) -> tuple[Array, Array]:
        """F of the faults that add, and F of those that multiply; both (p, q)."""
        multiplying = np.isin(np.arange(self.F.shape[1]), self.scales)
        return self.F * ~multiplying, self.F * multiplying

    @property
    def poles(self) -> NDArray[Any]:
        """Eigenvalues of the linear part, slowest first: in 1/s, or multipliers per sample of a sampled observer."""
        values = np.asarray(np.linalg.eigvals(self.A))
        return values[np.argsort(-values.real if self.sample_time is None else -np.abs(values))]

    @property
    def rates(self) -> NDArray[Any]:
        """The poles in 1/s, slowest first; a multiplier below `GONE` counts as that much."""
        if self.sample_time is None:
            return self.poles
        poles = self.poles.astype(np.complex128)
        return np.log(np.where(np.abs(poles) < GONE, GONE, poles)) / self.sample_time
