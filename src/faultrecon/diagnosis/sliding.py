# SPDX-License-Identifier: BSD-3-Clause
"""Whether a sliding-mode observer of the faults exists, and if not, why not [Alwi 2009, sections 2 and 3]."""

from __future__ import annotations

import numpy as np

from faultrecon.diagnosis.conditions import Condition
from faultrecon.diagnosis.limits import hidden_floor
from faultrecon.finding import Finding
from faultrecon.plant.plant import Plant

WEAK = 1e-3
"""Relative distance to undetectability below which the exact design (L2 = 0) needs gains that amplify noise by
thousands: modes that are nearly hidden are then treated as hidden."""


def structure(plant: Plant) -> list[Finding]:
    """What the canonical form needs: fewer faults than sensors, no sensor that repeats others, a linear plant."""
    see = "Alwi 2009, section 2"
    if len(plant.faults) >= plant.p:
        return [
            Finding(
                f"{len(plant.faults)} faults are declared on {plant.p} sensors",
                why="at least one output has to be free of faults",
                evidence={"faults": len(plant.faults), "sensors": plant.p},
                remedies=("declare fewer faults at a time (faults=[...] or --fault)",),
                see=see + ": p > q",
            )
        ]
    if plant.nonlinearity is not None:
        return [
            Finding(
                f"{plant.name} is nonlinear",
                why="the sliding motion is analysed for a linear plant",
                evidence={"nonlinear terms": plant.G.shape[1]},
                remedies=("linearise it at its operating point (plant.linearised)", "use lipschitz-hinf"),
                see=see,
            )
        ]
    scale = np.linalg.norm(plant.C, axis=1)
    rows = plant.C / np.where(scale > 0, scale, 1.0)[:, None]
    singular = np.linalg.svd(rows, compute_uv=False)
    if plant.p > plant.n or singular.min() <= 1e-10 * singular.max():
        rank = int(np.sum(singular > 1e-10 * singular.max()))
        return [
            Finding(
                f"the {plant.p} sensors of {plant.name} measure only {rank} independent combinations of its states",
                why="the canonical form needs C of full row rank",
                evidence={"rank": rank, "sensors": plant.p, "smallest singular value": float(singular.min())},
                remedies=(
                    "leave a redundant sensor out of the plant",
                    "use lipschitz-hinf, which takes redundant sensors",
                ),
                see=see,
            )
        ]
    return []


def constant_fault(plant: Plant) -> list[Finding]:
    """A mode at the origin that only the faulty sensors see looks like a constant fault; Lemma 2 as an equivalence."""
    floor = hidden_floor(plant)
    if floor is None or np.isfinite(floor.value):
        return []
    return [
        Finding(
            "a constant fault cannot be told from a drift of the plant",
            why="the healthy sensors miss a mode of A at the origin, which the faulty ones see",
            evidence={"mode": [floor.modes[0].real, floor.modes[0].imag]},
            remedies=("add a healthy sensor that sees this mode", "protect the sensor that sees it"),
            see="Alwi 2009, Lemma 2: (A_a, C_a) observable",
        )
    ]


def not_exact(plant: Plant, seen: Condition) -> Finding:
    """L2 = 0 asked for where the healthy sensors miss a mode, or all but miss it."""
    where = seen.where or 0j
    word = f"s = {where.real:.6g}" + (f" ± {abs(where.imag):.6g}j" if where.imag else "")
    return Finding(
        f"no design with L2 = 0: the healthy sensors do not see the mode at {word}"
        if not seen.holds
        else f"no design with L2 = 0: the healthy sensors hardly see the mode at {word}",
        why=f"relative distance to undetectability {seen.distance:.2g}, needed {WEAK:g}"
        + (f"; it lives in {', '.join(seen.states)}" if seen.states else ""),
        evidence={"mode": [where.real, where.imag], "distance": seen.distance, "states": list(seen.states)},
        remedies=("use sliding-mode, which lets L2 differ from zero", "add a healthy sensor that sees this mode"),
        see="Alwi 2009, Lemma 1 and section 3: (A, C_1) detectable",
    )


def nearly_hidden(seen: Condition) -> Finding:
    """A mode is seen on paper only."""
    where = seen.where or 0j
    return Finding(
        f"the healthy sensors hardly see the mode at {where.real:.4g}{where.imag:+.4g}j, so it is treated as hidden",
        why=f"a relative change of {seen.distance:.1e} in the model hides it, and gains that rely on it amplify noise",
        evidence={"distance": seen.distance, "tolerance": WEAK},
        remedies=("use sliding-mode-exact after adding a sensor", "add a healthy sensor that sees this mode"),
        severity="warning",
        see="Alwi 2009, section 3",
    )
