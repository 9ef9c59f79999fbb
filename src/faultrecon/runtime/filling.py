# SPDX-License-Identifier: BSD-3-Clause
"""What stands in for a measurement that is missing: the one the observer itself predicts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.observer import Observer

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SINGULAR = 1e-8  # a channel whose prediction repeats its own reading to 8 digits has no prediction
ROUNDING = 1e-12  # of the largest entry in its row: what a pseudo-inverse leaves of a zero


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the plant says a sensor should read: y - y0 = C (x - x0) + D (u - u0); C (p, n), D (p, m)."""

    C: Array
    D: Array


@dataclass(frozen=True, eq=False)
class Filling:
    """The input with its missing channels filled in: v <- from_z z + from_v v, of (m+p) rows.

    predicted: the rows that are predictions, in which faults that multiply have their say afterwards.
    """

    from_z: Array
    from_v: Array
    predicted: tuple[int, ...] = ()

    @staticmethod
    def of(observer: Observer, prediction: Prediction | None, missing: Mask) -> Filling:
        """Each missing measurement is the one the observer itself predicts; missing: (p,).

        The prediction is C x̂ + D u + F f̂ over the faults whose estimate does not read a missing channel: its
        innovation is zero.  Where x̂ repeats the channel itself there is no prediction and the last value stays, or
        that of the observer's `prior` if it has one; between the two, the solution closest to that value is taken.
        """
        m, p = observer.inputs, len(observer.y0)
        from_z, from_v = np.zeros((m + p, observer.A.shape[0])), np.eye(m + p)
        gone = np.flatnonzero(missing)
        if prediction is None or gone.size == 0:
            return Filling(from_z, from_v)
        F = observer.split[0] * ~np.any(reads_directly(observer)[:, gone], axis=1)
        Pz = prediction.C @ observer.Cx + F @ observer.Cf
        Pv = prediction.C @ observer.Dx + F @ observer.Df
        Pv[:, :m] += prediction.D
        K = np.eye(gone.size) - Pv[np.ix_(gone, m + gone)]
        solve = np.linalg.pinv(K, rcond=SINGULAR)
        from_z[m + gone] = solve @ Pz[gone]
        known = Pv[gone]
        known[:, m + gone] = 0.0
        from_v[m + gone] = solve @ known
        stays = np.eye(gone.size) - solve @ K
        if observer.prior is None:
            from_v[np.ix_(m + gone, m + gone)] = stays
            return Filling(from_z, from_v, tuple(int(row) for row in m + gone))
        from_z[m + gone] += stays @ (prediction.C @ observer.prior + F @ observer.Cf)[gone]
        from_v[np.ix_(m + gone, m + gone)] = 0.0
        from_v[m + gone, :m] += stays @ prediction.D[gone]
        return Filling(from_z, from_v, tuple(int(row) for row in m + gone))

    @staticmethod
    def nothing(observer: Observer) -> Filling:
        """The input as it is."""
        k = observer.inputs + len(observer.y0)
        return Filling(np.zeros((k, observer.A.shape[0])), np.eye(k))


def reads_directly(observer: Observer) -> Mask:
    """Which fault estimates jump when a measurement does, (q, p): Df has an entry there that is not mere rounding."""
    direct = np.abs(observer.Df[:, observer.inputs :])
    return direct > ROUNDING * np.max(direct, axis=1, keepdims=True, initial=0.0)
