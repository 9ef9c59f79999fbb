# SPDX-License-Identifier: BSD-3-Clause
"""How large a fault must be before a wrong explanation is ruled out: which hypotheses can be told apart at all."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.runtime.errors import ErrorSystem, error_system
from faultrecon.runtime.monitor import Monitor
from faultrecon.runtime.watch import Watch

NOTHING = 1e-9  # of what a fault does to its own sensor: what rounding makes of one that does not show


def separation(monitor: Monitor) -> dict[str, dict[str, float]]:
    """The smallest constant fault of each kind that rules each other hypothesis out, for certain, in the end.

    By fault, then by hypothesis; inf where none does.  In units of the fault.
    """
    systems = [error_system(h.watch.plant, h.watch.estimator) for h in monitor.hypotheses]
    table: dict[str, dict[str, float]] = {}
    for fault, i in monitor.singles.items():
        channel = monitor.hypotheses[i].watch.plant.faults[0]
        table[fault] = {
            h.name: ruled_out(h.watch, system, monitor.plant, channel)
            for h, system in zip(monitor.hypotheses, systems, strict=True)
            if fault not in h.faults
        }
    return table


def ruled_out(watch: Watch, system: ErrorSystem, plant: Plant, fault: FaultChannel) -> float:
    """The smallest constant size of a sensor fault outside the hypothesis for which its tests must fail in the end.

    Worst case: bounds are used up in the other direction, so twice the bound is what the fault has to bring.  inf where
    its residuals do not see a constant at all.  system: that of the watch's estimator.
    """
    F = replace(plant, faults=(fault,)).F_f[:, 0]
    if fault.site != "sensor" or not F.any():
        return math.inf
    into, out = (part @ F for part in system.reading)
    try:
        settled = out + system.C @ np.linalg.solve(np.eye(len(system.M)) - system.M, into)
    except np.linalg.LinAlgError:
        return math.inf
    q = watch.bounds.faults
    gain = np.abs(settled[q : q + watch.plant.p])
    limits = watch.limits[:, q:]
    visible = gain > NOTHING * float(np.abs(F).max())
    sizes = np.where(visible, 2.0 * limits / np.where(visible, gain, 1.0), math.inf)
    return float(sizes.min(initial=math.inf))
