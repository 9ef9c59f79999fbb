# SPDX-License-Identifier: BSD-3-Clause
"""What became of every row and every value that came in: counts that add up, and what they mean."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np

from faultrecon.finding import Finding, InputError


class Flag(IntEnum):
    """What is to be thought of one value; all but GOOD and FROZEN come out as NaN."""

    GOOD = 0
    MISSING = 1  # it did not come
    OUT_OF_LIMITS = 2  # infinite, or beyond what the device can put out
    SATURATED = 3  # at a limit for several samples: a bound, not a measurement
    FROZEN = 4  # bit for bit the same for longer than its noise allows; passed on, since a stuck sensor is a fault


PER_CHANNEL = ("conflicts", "missing", "out_of_limits", "saturated", "frozen")
LARGEST = ("lateness",)


@dataclass(frozen=True, slots=True)
class Counts:
    """Rows: received = passed + merged + duplicates + late + bad_time + those that still wait.

    merged: brought further channels, or other values, of a time that waits.  duplicates: brought nothing new.  late:
    older than what had left; lateness: s behind the newest, the largest.  bad_time: not finite, or not believed.
    reordered: of those that went in, how many came after a newer one.  gaps: intervals longer than 1.5 sample times;
    gap_rows: how many rows they lack.  Per channel, inputs first (m+p,): conflicts (another value at the same time,
    where the first one stays), and how many values passed on have each flag.
    """

    received: int = 0
    passed: int = 0
    merged: int = 0
    duplicates: int = 0
    late: int = 0
    bad_time: int = 0
    reordered: int = 0
    gaps: int = 0
    gap_rows: int = 0
    lateness: float = 0.0
    conflicts: tuple[int, ...] = ()
    missing: tuple[int, ...] = ()
    out_of_limits: tuple[int, ...] = ()
    saturated: tuple[int, ...] = ()
    frozen: tuple[int, ...] = ()

    @staticmethod
    def none(channels: int) -> Counts:
        """Nothing came yet, on so many channels."""
        return Counts(**dict.fromkeys(PER_CHANNEL, (0,) * channels))

    def __add__(self, other: Counts) -> Counts:
        total: dict[str, Any] = {}
        for one in fields(Counts):
            a, b = getattr(self, one.name), getattr(other, one.name)
            if one.name in PER_CHANNEL:
                total[one.name] = tuple(i + j for i, j in zip(a, b, strict=True))
            else:
                total[one.name] = max(a, b) if one.name in LARGEST else a + b
        return Counts(**total)

    @property
    def accounted(self) -> int:
        """Rows whose fate is known; `received` less this is the number of rows that wait."""
        return self.passed + self.merged + self.duplicates + self.late + self.bad_time

    def as_dict(self, names: tuple[str, ...]) -> dict[str, Any]:
        """Plain values for `--json`; per channel only what is not zero.  names: of inputs and sensors, (m+p,)."""
        out: dict[str, Any] = {}
        for one in fields(Counts):
            value = getattr(self, one.name)
            if one.name in PER_CHANNEL:
                value = {name: count for name, count in zip(names, value, strict=True) if count}
            out[one.name] = value
        return out

    def pack(self) -> dict[str, Any]:
        """Plain numbers and arrays of whole numbers, for a checkpoint."""
        found = {one.name: getattr(self, one.name) for one in fields(Counts)}
        return {name: np.array(v, dtype=np.int64) if name in PER_CHANNEL else v for name, v in found.items()}

    @staticmethod
    def unpack(packed: dict[str, Any]) -> Counts:
        """The counts that `pack` described.  Raises InputError where something is missing."""
        values: dict[str, Any] = {}
        for one in fields(Counts):
            if one.name not in packed:
                raise InputError(
                    f"the stored counts lack '{one.name}'", remedies=("start from an undamaged checkpoint",)
                )
            value = packed[one.name]
            if one.name in PER_CHANNEL:
                values[one.name] = tuple(int(v) for v in np.asarray(value).ravel())
            else:
                values[one.name] = float(value) if one.name in LARGEST else int(value)
        return Counts(**values)


def findings(counts: Counts, names: tuple[str, ...], sample_time: float, reorder: float) -> tuple[Finding, ...]:
    """What somebody should know about the samples that came, facts with numbers and remedies; () when all is well."""
    found = [*_about_rows(counts, sample_time, reorder)]
    for k, name in enumerate(names):
        found += _about_channel(counts, k, name)
    return tuple(found)


def _about_rows(c: Counts, sample_time: float, reorder: float) -> list[Finding]:
    found = []
    if c.late:
        jumped = c.lateness > 100 * max(sample_time, reorder)
        found.append(
            Finding(
                f"{c.late} of {c.received} rows came too late to be passed on",
                why=f"up to {c.lateness:.4g} s behind the newest, and rows wait for {reorder:.4g} s",
                evidence={"late": c.late, "received": c.received, "lateness": c.lateness, "reorder": reorder},
                remedies=(
                    ("see whether the clock was set back, or one time is far ahead: leap=... leaves that one out",)
                    if jumped
                    else (f"let rows wait for them: reorder={c.lateness + sample_time:.4g}",)
                ),
                severity="warning",
            )
        )
    if c.bad_time:
        found.append(
            Finding(
                f"{c.bad_time} of {c.received} rows were left out for want of a believable time",
                why="it is absent, infinite or far ahead of all others",
                evidence={"bad_time": c.bad_time, "received": c.received},
                remedies=("mend the clock of the recorder",),
                severity="warning",
            )
        )
    if c.gaps:
        found.append(
            Finding(
                f"missing rows: {c.gap_rows}, in {c.gaps} gap{'s' * (c.gaps != 1)}",
                why=f"a gap is an interval longer than 1.5 sample times of {sample_time:.4g} s",
                evidence={"gaps": c.gaps, "gap_rows": c.gap_rows, "passed": c.passed, "sample_time": sample_time},
                remedies=("look for lost messages", "give the sample time that the rows have"),
                severity="note",
            )
        )
    return found


def _about_channel(c: Counts, k: int, name: str) -> list[Finding]:
    told = (
        ("conflicts", "other values at times that had one; the first ones stayed", "remove one of two sources"),
        ("out_of_limits", "values beyond its limits count as missing", "check its unit and its limits"),
        ("saturated", "values at a limit count as missing", "use a device of wider range"),
        ("frozen", "values stand still for longer than its noise allows", "check the device and its wiring"),
        ("missing", "values did not come", "look for lost messages"),
    )
    found = []
    for what, fact, remedy in told:
        count = getattr(c, what)[k]
        if count:
            numbers = {"channel": name, what: count, "passed": c.passed}
            severity = "note" if what == "missing" else "warning"
            found.append(Finding(f"{name}: {count} {fact}", evidence=numbers, remedies=(remedy,), severity=severity))
    return found
