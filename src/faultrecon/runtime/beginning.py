# SPDX-License-Identifier: BSD-3-Clause
"""Where to start: the state that the first sample tells, from the sensors that a hypothesis calls healthy.

The guess weighs what a sensor says against the declared ranges, x̂ = x0 + K (y - y0 - D u) with the K of least variance;
it makes the start of a bank a matter of seconds instead of its slowest mode.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.observer import Observer
from faultrecon.plant.plant import Plant
from faultrecon.runtime.steps import disturbed

Array = NDArray[Any]

ANYWHERE = 1e3  # in its unit: how far a state without a declared range may be at the start
EXACT = 1e-9  # of a sensor's reading of a typical state: the noise of one that has none


@dataclass(frozen=True, eq=False)
class Beginning:
    """K (n, p), with zero columns for the sensors that faults reach."""

    plant: Plant
    K: Array

    @staticmethod
    def of(plant: Plant) -> Beginning:
        """The guess of least variance for independent states within their ranges."""
        healthy = ~np.any(plant.F_f != 0, axis=1)
        ranges = np.array(plant.signals.x.ranges)
        X = np.where(np.isnan(ranges), ANYWHERE, ranges)
        C = plant.C[healthy] * X
        sd = np.zeros(plant.p) if plant.noise is None else np.array(plant.noise.sd)
        sizes = [w.size if w.role != "decouple" else ANYWHERE * w.size for w in plant.disturbances]
        S = np.diag(sd[healthy] ** 2 + EXACT**2 * np.square(C).sum(axis=1))
        on = disturbed(plant)[1][healthy]
        S = S + (on * np.square(sizes)) @ on.T
        K = np.zeros((plant.n, plant.p))
        if healthy.any():
            reach = C @ C.T + S
            K[:, healthy] = X[:, None] * (C.T @ np.linalg.pinv(reach, hermitian=True))
        return Beginning(plant, K)

    def guess(self, u: Array, y: Array) -> Array | None:
        """The state that one sample tells, (n,); None where it lacks something."""
        used = np.any(self.K != 0, axis=0)
        if not (np.isfinite(y[used]).all() and np.isfinite(u).all()):
            return None
        point = self.plant.point
        deviation = np.where(used, y, 0.0) - np.where(used, point.y, 0.0)
        moved = self.plant.D @ (u - np.array(point.u))
        return np.array(point.x) + self.K @ (deviation - np.where(used, moved, 0.0))

    def box(self, observer: Observer, coordinates: Array, crest: float, noise_peak: float) -> Array:
        """The error ζ of the first estimate, as columns of which any |share| ≤ 1.

        coordinates: [Π, Π_f] of the error system.
        """
        plant, n, m = self.plant, self.plant.n, observer.inputs
        Pi, Pi_f = coordinates[:, :n], coordinates[:, n:]
        back = np.linalg.pinv(observer.Cx if observer.prior is None else observer.prior)
        shows = observer.Dx[:, m:] if observer.prior is None else np.zeros((n, plant.p))
        states = back @ (self.K @ plant.C - np.eye(n)) + (back @ observer.Cx - np.eye(len(Pi))) @ Pi
        if observer.prior is not None:
            states = back @ (self.K @ plant.C) - Pi
        measured = back @ (self.K - shows)
        sd = np.zeros(plant.p) if plant.noise is None else np.array(plant.noise.sd)
        sizes = np.array([w.size for w in plant.disturbances])
        peaks = np.array([noise_peak if w.role == "noise" else crest for w in plant.disturbances])
        parts = [
            measured * (noise_peak * sd),
            (measured @ disturbed(plant)[1]) * (peaks * sizes),
        ]
        return np.hstack([*parts, self._spread(states, Pi_f + back @ shows @ plant.F_f)])

    def blind_box(self, coordinates: Array) -> Array:
        """The same for an observer that begins at rest because the first sample lacks something."""
        n = self.plant.n
        return self._spread(coordinates[:, :n], coordinates[:, n:])

    def _spread(self, states: Array, faults: Array) -> Array:
        """Columns by state and by fault, times how large they may be."""
        ranges = np.nan_to_num(np.array(self.plant.signals.x.ranges), nan=ANYWHERE)
        return np.hstack([states * ranges, faults * np.array([f.size for f in self.plant.faults])])

    @property
    def undeclared(self) -> tuple[str, ...]:
        """The states that have no range."""
        x = self.plant.signals.x
        return tuple(name for name, reach in zip(x.names, x.ranges, strict=True) if math.isnan(reach))
