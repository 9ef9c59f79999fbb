# SPDX-License-Identifier: BSD-3-Clause
"""Whether a sliding-mode observer of the faults exists, and if not, why not [Alwi 2009, sections 2 and 3]."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from faultrecon.diagnosis.conditions import Condition, detectable, living_in
from faultrecon.diagnosis.limits import hidden_floor
from faultrecon.finding import Finding
from faultrecon.numerics.annihilator import annihilator
from faultrecon.numerics.pencil import undetectable_modes
from faultrecon.plant.plant import Plant

WEAK = 5e-3
"""Relative distance to undetectability below which the exact design (L2 = 0) needs gains that amplify noise by
thousands: modes that are nearly hidden are then treated as hidden."""


def pace(plant: Plant) -> float:
    """A power of two near the plant's time constants, s; 1 where nothing moves."""
    rates = np.abs(np.linalg.eigvals(plant.A))
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    return float(np.exp2(np.rint(-np.mean(np.log2(rates))))) if rates.size else 1.0


def visibility(plant: Plant) -> Condition:
    """How far the healthy sensors are from missing a mode that does not decay, in the plant's own time."""
    own = pace(plant)
    found = detectable(replace(plant, A=plant.A * own))
    return found if found.where is None else replace(found, where=found.where / own)


def blind(plant: Plant) -> list[Finding]:
    """A mode that does not decay and that no sensor sees at all."""
    own = pace(plant)
    modes = undetectable_modes(plant.A * own, plant.C)
    if not modes:
        return []
    s, states = modes[0].value / own, living_in(plant, modes[0].direction)
    return [
        Finding(
            f"no sensor sees the mode at {_word(s)}, which does not decay",
            why="(A, C) is not detectable" + (f"; the mode lives in {', '.join(states)}" if states else ""),
            evidence={"mode": [s.real, s.imag], "states": list(states)},
            remedies=("add a sensor that sees this mode",),
            see="Alwi 2009, section 2",
        )
    ]


def _word(s: complex) -> str:
    return f"{s.real:.4g}" + (f" ± {abs(s.imag):.4g}j" if s.imag else "")


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
    both = [d.name for d in plant.attenuated if any(d.into.values()) and any(d.on.values())]
    if both:
        return [
            Finding(
                f"disturbance '{both[0]}' acts on states and on sensors at once",
                why="the sliding motion is analysed for disturbances of the states; on a sensor one passes as noise",
                evidence={"disturbances": both},
                remedies=("declare the part on the sensors as noise", "use linear-observer, which counts both"),
                see="Alwi 2009, section 4",
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
        f"the healthy sensors hardly see the mode at {_word(where)}, so it is treated as hidden",
        why=f"a relative change of {seen.distance:.1e} in the model hides it, and gains that rely on it amplify noise",
        evidence={"distance": seen.distance, "tolerance": WEAK},
        remedies=("add a healthy sensor that sees this mode",),
        severity="warning",
        see="Alwi 2009, section 3",
    )


def with_hidden_mode(plant: Plant) -> Plant | None:
    """The plant with its nearly hidden mode hidden outright, in A alone; None where none is nearly hidden.

    Gains that are found for it do not lean on what the healthy sensors see of that mode.  With v the direction they
    miss at s, freed of what they do see of it: A - (A V - V Λ) V⁺, so that A' V = V Λ and C_1 V = 0.
    """
    seen = visibility(plant)
    if not seen.holds or seen.distance >= WEAK or seen.where is None:
        return None
    C1, s = annihilator(plant.F_f) @ plant.C, complex(seen.where)
    t = np.where(np.isfinite(plant.signals.x.ranges), plant.signals.x.ranges, 1.0)
    A, C = plant.A * t / t[:, None], C1 * t  # directions are compared in declared ranges
    C = C / np.maximum(np.linalg.norm(C, axis=1), 1e-300)[:, None] * np.linalg.norm(A, 2)
    v = np.linalg.svd(np.vstack([A - s * np.eye(plant.n), C]))[2][-1].conj()
    v = v - np.linalg.pinv(C) @ (C @ v)
    if s.imag == 0:
        V, modes = v.real[:, None], np.array([[s.real]])
    else:
        V, modes = np.stack([v.real, v.imag], axis=1), np.array([[s.real, s.imag], [-s.imag, s.real]])
    hidden = A - (A @ V - V @ modes) @ np.linalg.pinv(V)
    return replace(plant, A=hidden * t[:, None] / t)
