# SPDX-License-Identifier: BSD-3-Clause
"""Running a log a piece at a time: when that is done, what it leaves behind, and how it is interrupted."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from faultrecon.finding import InputError
from faultrecon.io.running import EVERY, Make, Ran, run_file
from faultrecon.plant.signals import Signals

LARGE = 100_000_000  # bytes of a log; read whole, such a CSV file takes about a gigabyte of memory
FOR_BANKS = {
    "crest": 3.0,
    "false_alarms": 0.01,
    "policy": "correct",
    "reorder": 0.0,
    "leap": math.inf,
    "window": 24,
    "patience": 8,
}


@dataclass(frozen=True)
class Keeping:
    """Where a run leaves its checkpoints, how often in seconds, and whether it goes on from one that is there."""

    checkpoint: Path | None = None
    resume: bool = False
    every: float = EVERY

    def __post_init__(self) -> None:
        if not self.every >= 0.0:
            raise InputError(f"--every is {self.every}", why="it is a number of seconds")
        if self.checkpoint is None and self.resume:
            raise InputError("--resume without --checkpoint", remedies=("name the file with --checkpoint FILE",))
        if self.checkpoint is not None and not self.checkpoint.parent.is_dir():
            raise InputError(
                f"cannot write {self.checkpoint}", why=f"the folder {self.checkpoint.parent} does not exist"
            )


def large(log: str) -> bool:
    """Whether a log is too large to be read whole."""
    return os.path.isfile(log) and os.path.getsize(log) > LARGE


def run_pieces(
    make: Make,
    signals: Signals,
    log: str,
    out: Path | None,
    mapping: Mapping[str, str],
    keeping: Keeping,
    progress: Callable[[float], None],
    as_it_came: bool = False,
) -> Ran:
    """A log a piece at a time; interrupted, it says how to go on."""
    try:
        return run_file(
            make,
            signals,
            log,
            out=out,
            checkpoint=keeping.checkpoint,
            resume=keeping.resume,
            every=keeping.every,
            mapping=mapping or None,
            progress=progress,
            as_it_came=as_it_came,
        )
    except KeyboardInterrupt:
        if keeping.checkpoint is None:
            raise
        print("faultrecon: interrupted; to go on, give the same command with --resume", file=sys.stderr)
        raise SystemExit(130) from None


def plain(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of a run without those for banks.  Raises InputError where one of these was given."""
    for name, value in FOR_BANKS.items():
        if options.get(name, value) != value:
            raise InputError(f"--{name.replace('_', '-')} is for a bank", why="this file holds one design")
    return {name: value for name, value in options.items() if name not in FOR_BANKS}


def watched(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of a run for a bank.  Raises InputError where a scheme was chosen."""
    if options.get("scheme", "auto") != "auto":
        raise InputError("--scheme is for a single design", why="this file holds a bank")
    return {name: value for name, value in options.items() if name != "scheme"}
