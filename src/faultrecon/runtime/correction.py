# SPDX-License-Identifier: BSD-3-Clause
"""The measurement a controller may read: corrected, held or refused, with a quality that says which.

good        the sensor's own reading, and nothing speaks against it
uncertain   its own reading, while it is one of several suspects, stands still, or nothing can be told
corrected   its reading minus the reconstructed fault
predicted   it sent nothing; what the observer expects of it
held        the last good value
bad         no value to rely on
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.runtime.decision import OUTSIDE, SUSPECT, WARMING
from faultrecon.runtime.samples import Trace

Array = NDArray[Any]
Policy = Literal["correct", "hold", "refuse", "pass"]

QUALITIES = ("good", "uncertain", "corrected", "predicted", "held", "bad")
GOOD, UNCERTAIN, CORRECTED, PREDICTED, HELD, BAD = range(len(QUALITIES))


@dataclass(frozen=True)
class Held:
    """The last good value of each sensor and its time, (p,) each; NaN before there is one."""

    value: Array
    time: Array

    @staticmethod
    def nothing(sensors: int) -> Held:
        """Before the first sample."""
        return Held(np.full(sensors, math.nan), np.full(sensors, math.nan))

    def pack(self) -> dict[str, Any]:
        """Plain values."""
        return {"value": self.value.copy(), "time": self.time.copy()}

    @staticmethod
    def unpack(found: Mapping[str, Any]) -> Held:
        """The inverse of `pack`."""
        return Held(np.array(found["value"], dtype=float), np.array(found["time"], dtype=float))


@dataclass(frozen=True)
class Correction:
    """What happens to a sensor that is named: "correct" takes the fault out, "hold" repeats the last good value for at
    most `longest` seconds, "refuse" sends NaN, "pass" sends the reading as it is, flagged.
    """

    policy: Policy = "correct"
    longest: float = 5.0

    def __post_init__(self) -> None:
        if self.policy not in ("correct", "hold", "refuse", "pass"):
            raise InputError(f"'{self.policy}' is no policy", remedies=("use correct, hold, refuse or pass",))
        if not self.longest >= 0:
            raise InputError(f"values are held for {self.longest} s", why="it is a number of seconds, 0 or more")

    def apply(
        self,
        before: Held,
        t: Array,
        y: Array,
        mode: Array,
        named: Array,
        reached: Sequence[tuple[int, tuple[int, ...], tuple[int, ...]]],
        traces: Sequence[Trace],
        doubt: NDArray[np.bool_] | None = None,
    ) -> tuple[Held, Array, Array]:
        """Values and qualities over N samples, (N, p) each.

        mode, named (N,): the decision.  reached: from which row on which sensors are at fault and which are suspected.
        doubt (N, p): readings that something else speaks against.
        """
        out, quality = y.copy(), np.full(y.shape, GOOD, dtype=np.int8)
        doubtful = (mode == OUTSIDE) | (mode == WARMING)
        quality[doubtful] = UNCERTAIN
        for (a, faulty, suspects), b in zip(reached, [*(r[0] for r in reached[1:]), len(t)], strict=True):
            if b <= a:
                continue
            source = traces[max(int(named[a]), 0)]
            nobody = mode[a] == SUSPECT and not suspects and not faulty
            quality[a:b, slice(None) if nobody else list(suspects)] = UNCERTAIN
            absent = ~np.isfinite(y[a:b])
            out[a:b][absent] = source.corrected[a:b][absent]
            quality[a:b][absent] = PREDICTED
            for i in faulty:
                if self.policy == "correct":
                    out[a:b, i], quality[a:b, i] = (
                        source.corrected[a:b, i],
                        np.where(absent[:, i], PREDICTED, CORRECTED),
                    )
                elif self.policy == "pass":
                    quality[a:b, i] = np.where(absent[:, i], PREDICTED, BAD)
                else:
                    out[a:b, i], quality[a:b, i] = math.nan, BAD
        if doubt is not None:
            quality[doubt & (quality == GOOD)] = UNCERTAIN
        return self._held(before, t, out, quality)

    def _held(self, before: Held, t: Array, out: Array, quality: Array) -> tuple[Held, Array, Array]:
        """With the last good value where there is no other and the policy allows it; NaN stays NaN, and bad."""
        if len(t) and np.all(quality[-1] == GOOD) and np.isfinite(out).all():
            return Held(out[-1].copy(), np.full(out.shape[1], t[-1])), out, quality
        value, time = before.value.copy(), before.time.copy()
        for i in range(out.shape[1]):
            good = (quality[:, i] == GOOD) & np.isfinite(out[:, i])
            lost = ~np.isfinite(out[:, i])
            if lost.any():
                last = np.maximum.accumulate(np.where(good, np.arange(len(t)), -1))
                values = np.where(last >= 0, out[np.maximum(last, 0), i], value[i])
                times = np.where(last >= 0, t[np.maximum(last, 0)], time[i])
                usable = lost & (t - times <= self.longest) & (self.policy in ("correct", "hold"))
                out[usable, i], quality[usable, i] = values[usable], HELD
                quality[lost & ~usable, i] = BAD
            if good.any():
                k = int(np.flatnonzero(good)[-1])
                value[i], time[i] = out[k, i], t[k]
        return Held(value, time), out, quality
