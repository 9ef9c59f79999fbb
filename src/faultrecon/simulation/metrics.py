# SPDX-License-Identifier: BSD-3-Clause
"""How good a reconstruction is: four numbers per fault, each with one meaning.

    nrmse   root mean square error over the rows in which the fault acts, divided by the root mean square of the fault
            there: 0 is perfect, 1 is what an estimate of zero gets
    peak    the largest |f̂ - f| while the fault acts, in the unit of the fault
    delay   from the onset to the first row from which on |f̂ - f| <= 0.37 max|f| for the rest of the episode, s; the
            maximum runs over the episode so far.  For a step this is "within 37 %", for a ramp it is 37 % of what the
            ramp has reached, and the zero crossings of an oscillation do not count as leaving.  Nothing is smoothed: a
            noise peak beyond the band counts.  inf if the estimate never stays; of several episodes, the longest delay
    leak    root mean square of the estimate while there is no fault

A fault acts in the rows where it is not zero, and in a single zero between two such rows (a crossing); rows in a
stretch are an episode.  Rows whose estimate or truth is not finite are left out of all four and counted.  Every row
counts alike, whatever its distance in time to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BAND = 0.37  # 1/e: what a first-order lag has left after one time constant


@dataclass(frozen=True, slots=True)
class FaultScore:
    """The four numbers of one fault, and how many rows were left out; nan where a number has no rows to stand on."""

    nrmse: float
    peak: float
    delay: float
    leak: float
    excluded: int = 0

    def as_dict(self) -> dict[str, float]:
        """The numbers by name."""
        return asdict(self)


def score(t: ArrayLike, f_true: ArrayLike, f_hat: ArrayLike) -> dict[str, float]:
    """The score of one fault as a table: nrmse, peak, delay, leak, excluded; t, f_true and f_hat are (N,)."""
    F_true, F_hat = np.asarray(f_true, dtype=float), np.asarray(f_hat, dtype=float)
    return scores(t, F_true[..., None], F_hat[..., None], ("f",))["f"].as_dict()


def scores(t: ArrayLike, F_true: ArrayLike, F_hat: ArrayLike, names: Sequence[str]) -> dict[str, FaultScore]:
    """The score of every fault by name; t (N,), F_true and F_hat (N, q).  Raises InputError on other shapes."""
    t, truth, guess = (np.asarray(a, dtype=float) for a in (t, F_true, F_hat))
    shape = (t.size, len(names))
    for name, given, wanted in (("t", t, shape[:1]), ("the truth", truth, shape), ("the estimate", guess, shape)):
        if given.shape != wanted:
            raise InputError(f"{name} is {given.shape}", why=f"{shape[0]} times and {shape[1]} faults ask for {wanted}")
    known = np.isfinite(truth) & np.isfinite(guess)
    acting = _acting(truth)
    error = np.where(known, guess, 0.0) - np.where(known, truth, 0.0)
    rms_error = _rms(error, acting & known)
    rms_truth = _rms(truth, acting & known)
    nrmse = np.divide(rms_error, rms_truth, out=np.full(len(names), np.nan), where=rms_truth > 0)
    peak = np.max(np.abs(error), axis=0, where=acting & known, initial=-np.inf)
    leak = _rms(guess, ~acting & known)
    return {
        name: FaultScore(
            float(nrmse[j]),
            float(peak[j]) if np.isfinite(peak[j]) else float("nan"),
            _delay(t, truth[:, j], error[:, j], acting[:, j], known[:, j]),
            float(leak[j]),
            int(np.count_nonzero(~known[:, j])),
        )
        for j, name in enumerate(names)
    }


def _acting(truth: Array) -> Mask:
    """Where each fault acts, (N, q): not zero, or a lone zero between two rows that are not."""
    nonzero = np.nan_to_num(truth) != 0
    acting = nonzero.copy()
    acting[1:-1] |= nonzero[:-2] & nonzero[2:]
    return acting


def _rms(values: Array, where: Mask) -> Array:
    """Root mean square down each column over some of the rows; nan where there are none."""
    count = np.count_nonzero(where, axis=0)
    # Contiguous rows: NumPy then sums a column in the same order whether it comes alone or with others.
    total = np.sum(np.ascontiguousarray(np.where(where, values, 0.0).T) ** 2, axis=1)
    return np.sqrt(np.divide(total, count, out=np.full(values.shape[1], np.nan), where=count > 0))


def _delay(t: Array, truth: Array, error: Array, acting: Mask, known: Mask) -> float:
    """The longest delay over the episodes; nan when there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], acting, [False]))))
    delays = []
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        so_far = np.maximum.accumulate(np.abs(np.nan_to_num(truth[a:b])))
        seen = np.flatnonzero(known[a:b])
        outside = np.flatnonzero(known[a:b] & (np.abs(error[a:b]) > BAND * so_far))
        settled = seen[seen > outside[-1]] if outside.size else seen
        delays.append(float(t[a + settled[0]] - t[a]) if settled.size else float("inf"))
    return max(delays, default=float("nan"))
