# SPDX-License-Identifier: BSD-3-Clause
"""A whole log through a design: fault waveforms, corrected measurements and flags come out as a table."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from faultrecon.finding import InputError
from faultrecon.io.coverage import Coverage, coverage
from faultrecon.io.logs import Log, read_log
from faultrecon.plant.plant import Plant
from faultrecon.runtime.estimator import Trace
from faultrecon.runtime.stepping import Hold, Scheme
from faultrecon.simulation.metrics import FaultScore, scores
from faultrecon.synthesis.result import Design

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Replay:
    """A log and what a design made of it.  sample_time: s, that of the estimator."""

    design: Design
    log: Log
    trace: Trace
    sample_time: float | None = None

    def columns(self) -> dict[str, np.ndarray]:
        """Time, inputs, measurements, f_<fault>, <sensor>_corrected for every sensor a fault reaches, <sensor>_ok."""
        signals, log, trace = self.design.plant.signals, self.log, self.trace
        reached = [signals.y.index(name) for name in corrected_sensors(self.design.plant)]
        values = [
            *(log.t, *log.u.T, *log.y.T, *trace.fault.T),
            *(trace.corrected[:, j] for j in reached),
            *trace.ok.T,
        ]
        return dict(zip(column_names(self.design.plant), values, strict=True))

    def corrected_sensors(self) -> list[str]:
        """The sensors that a declared fault reaches, in order."""
        return corrected_sensors(self.design.plant)

    def coverage(self) -> Coverage | None:
        """In which samples the certificate holds, for designs over a box; None where it knows no box."""
        return coverage(self.design, self.trace.state, self.log.u, self.trace.fault)

    def truth(self, fault: str) -> np.ndarray | None:
        """The true fault that the log carries as `true_f_<fault>`, if it does."""
        return self.log.extra.get(f"true_f_{fault}")

    def scores(self) -> dict[str, FaultScore]:
        """Scores of the faults whose true waveform is in the log."""
        found: dict[str, FaultScore] = {}
        for j, f in enumerate(self.design.plant.faults):
            true = self.truth(f.name)
            if true is not None:
                found |= scores(self.log.t, true[:, None], self.trace.fault[:, [j]], (f.name,))
        return found


def corrected_sensors(plant: Plant) -> list[str]:
    """The sensors that a declared fault reaches, in order."""
    reached = {name for f in plant.faults for name in f.on}
    return [name for name in plant.signals.y if name in reached]


def column_names(plant: Plant) -> list[str]:
    """The columns of a reconstruction in order.  Raises InputError when two would bear one name."""
    y = plant.signals.y.names
    names = ["t", *plant.signals.u.names, *y, *(f"f_{f.name}" for f in plant.faults)]
    names += [*(f"{name}_corrected" for name in corrected_sensors(plant)), *(f"{name}_ok" for name in y)]
    twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if twice is not None:
        raise InputError(
            f"two columns of the reconstruction would be called '{twice}'",
            why=f"{plant.name} has a signal of that name",
            remedies=("rename the signal or the fault",),
        )
    return names


def replay(
    design: Design,
    log: Log | str | os.PathLike[str],
    *,
    sample_time: float | None = None,
    hold: Hold = "linear",
    scheme: Scheme = "auto",
    mapping: Mapping[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Replay:
    """Run a design over a log.

    log: a path to .csv or .parquet, or a Log.  sample_time in s: the median interval of the log by default.  hold says
    what samples mean in between; mapping gives the column of a signal where names differ.
    Raises InputError on a bad log and on a step beyond the stability limit, before anything runs.
    """
    column_names(design.plant)  # a clash of names is refused before the work
    if not isinstance(log, Log):
        log = read_log(log, design.plant.signals, mapping=mapping)
    if sample_time is None:
        if len(log) < 2 and design.plant.noise is None:
            raise InputError(f"{log.source}: one sample tells no sample time", remedies=("pass sample_time=...",))
        sample_time = float(np.median(np.diff(log.t))) if len(log) > 1 else None
    estimator = design.estimator(sample_time, hold=hold, scheme=scheme)
    return Replay(design, log, estimator.replay(log.t, log.u, log.y, progress=progress), sample_time)


def reconstruct(design: Design, log: Log | str | os.PathLike[str], **options: Any) -> pd.DataFrame:
    """A whole log in, a table out: columns f_<fault>, <sensor>_corrected and <sensor>_ok beside the log's own.

    options are those of `replay`: sample_time, hold, scheme, mapping, progress.
    """
    import pandas as pd

    return pd.DataFrame(replay(design, log, **options).columns())
