# SPDX-License-Identifier: BSD-3-Clause
"""Which disturbances an unknown-input observer can shut out, which it can only attenuate, and why.

A disturbance d through E_d is shut out of the state estimate by M = E_d (C E_d)⁺, J = I - M C, J E_d = 0.  That takes
rank(C E_d) = rank(E_d), no sensor that d reaches directly, zeros of (A, E_d, C) that decay, and, since faults are
followed as slowly varying, no constant d that looks like a constant fault.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.conditions import decoupled_into, decoupled_onto
from faultrecon.diagnosis.existence import additive_sensor_findings, decoupling_findings, fault_findings
from faultrecon.finding import Finding
from faultrecon.numerics.annihilator import left_inverse
from faultrecon.numerics.pencil import invariant_zeros
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

MANY = 8
"""Disturbances up to which every subset is tried: 256 rank tests at most; beyond, they are taken one after another."""


@dataclass(frozen=True)
class Partition:
    """Disturbances to decouple and to attenuate, by name, and for each of the latter the reason."""

    decouple: tuple[str, ...]
    attenuate: tuple[str, ...]
    reasons: dict[str, str]

    def applied(self, plant: Plant) -> Plant:
        """The plant with these roles; noise keeps its own."""
        return with_decoupled(plant, self.decouple)

    def __str__(self) -> str:
        lines = [f"decouple: {', '.join(self.decouple) or 'nothing'}"]
        return "\n".join(lines + [f"attenuate {name}: {self.reasons[name]}" for name in self.attenuate])


def partition(plant: Plant) -> Partition:
    """The largest set of counted disturbances that can be decoupled, whatever role they were given.

    Of two sets of one size the one that comes first in the plant file; with more than `MANY` disturbances the set is
    only maximal (no member can be added), not largest.
    """
    names = [d.name for d in plant.attenuated]
    reasons = {name: reason for name in names if (reason := _obstacle(plant, [name]))}
    able = [name for name in names if name not in reasons]
    chosen = _largest(plant, able) if len(able) <= MANY else _one_after_another(plant, able)
    for name in able:
        if name not in chosen:
            reasons[name] = f"not together with {', '.join(chosen)}: {_obstacle(plant, [*chosen, name])}"
    return Partition(tuple(chosen), tuple(n for n in names if n not in chosen), reasons)


def with_decoupled(plant: Plant, names: Iterable[str]) -> Plant:
    """The plant with exactly these counted disturbances to be decoupled."""
    chosen = set(names)
    roles = [
        d if d.role == "noise" else replace(d, role="decouple" if d.name in chosen else "attenuate")
        for d in plant.disturbances
    ]
    return replace(plant, disturbances=tuple(roles))


def _largest(plant: Plant, able: list[str]) -> list[str]:
    for size in range(min(len(able), plant.p), 0, -1):  # rank(C E_d) is at most p
        for names in combinations(able, size):
            if _obstacle(plant, list(names)) is None:
                return list(names)
    return []


def _one_after_another(plant: Plant, able: list[str]) -> list[str]:
    chosen: list[str] = []
    for name in able:
        if _obstacle(plant, [*chosen, name]) is None:
            chosen.append(name)
    return chosen


def _obstacle(plant: Plant, names: list[str]) -> str | None:
    """Why these cannot be decoupled together, in a clause; None when they can."""
    found = [f for f in unknown_input_findings(with_decoupled(plant, names)) if f.severity == "fatal"]
    return found[0].what if found else None


# ---------------------------------------------------------------- what an unknown-input observer is made of


def unknown_input_findings(plant: Plant) -> list[Finding]:
    """What forbids an observer that decouples role = "decouple" and follows additive sensor faults as slowly varying.

    The corrected existence conditions of [Huang 2024]: with T = J of the paper, (diag(J A, 0), [C, F_f]) detectable,
    which is rank [A - sI, E_d; C, 0] = n + d for Re s >= 0, s != 0, and rank [A, E_d, 0; C, 0, F_f] = n + d + q.
    """
    found = additive_sensor_findings(plant) or fault_findings(plant)
    if found:
        return found
    return _on_sensors(plant) or decoupling_findings(plant)


def with_advice(plant: Plant, findings: list[Finding]) -> list[Finding]:
    """The findings; a fatal one about several disturbances to be decoupled also says which of them can be."""
    asked = [d.name for d in plant.attenuated if d.role == "decouple"]
    if len(asked) < 2 or not any(f.severity == "fatal" for f in findings):
        return findings
    able = [name for name in partition(plant).decouple if name in asked]
    if not able or len(able) == len(asked):
        return findings
    advice = f"decouple {', '.join(able)} and attenuate {', '.join(n for n in asked if n not in able)}"
    return [replace(f, remedies=(advice, *f.remedies)) if f.severity == "fatal" else f for f in findings]


def _on_sensors(plant: Plant) -> list[Finding]:
    onto = decoupled_onto(plant)
    names = [d.name for d in plant.attenuated if d.role == "decouple"]
    for k in np.flatnonzero(onto.any(axis=0)):
        sensors = [plant.signals.y.names[i] for i in np.flatnonzero(onto[:, k])]
        return [
            Finding(
                f"{names[k]} is to be decoupled and reaches {', '.join(sensors)} directly",
                why="what enters the states is shut out; what a sensor shows directly passes through the gains",
                evidence={"disturbance": names[k], "sensors": sensors},
                remedies=(f'attenuate {names[k]} (role = "attenuate")',),
                see="Huang 2024, section 2: y = C x + D f",
            )
        ]
    return []


def unknown_input_gain(plant: Plant) -> Array:
    """M = E_d (C E_d)⁺, (n, p), the pseudo-inverse in rational arithmetic; zero when nothing is to be decoupled."""
    E = decoupled_into(plant)
    if E.shape[1] == 0:
        return np.zeros((plant.n, plant.p))
    return E @ left_inverse(plant.C @ E)


def decoupled_selection(plant: Plant) -> Array:
    """Which of the counted disturbances are decoupled, (l, d): picks their columns out of E_w."""
    return np.eye(len(plant.attenuated))[:, [d.role == "decouple" for d in plant.attenuated]]


def attenuated_selection(plant: Plant) -> Array:
    """Which of the counted disturbances are not decoupled, (l, l - d)."""
    return np.eye(len(plant.attenuated))[:, [d.role != "decouple" for d in plant.attenuated]]


def zeros_to_errors(plant: Plant) -> NDArray[np.complex128]:
    """Invariant zeros from all that disturbs to all that is measured, faults among the measurements; slowest first.

    (A, [E_d, E_w, 0], C, [F_d, F_w, F_f]): those that decay slowly become poles of an observer with a good level, those
    that do not decay keep the level above zero.
    """
    q = len(plant.faults)
    E = np.hstack([plant.E_w, np.zeros((plant.n, q))])
    F = np.hstack([plant.F_w, plant.F_f])
    zeros = np.asarray(invariant_zeros(plant.A, E, plant.C, F), dtype=np.complex128)
    return zeros[np.argsort(-zeros.real)]


def invariant_zero_notes(plant: Plant) -> tuple[str, ...]:
    """What the invariant zeros say about any design, in a sentence; nothing when there are none."""
    zeros = zeros_to_errors(plant)
    if not zeros.size:
        return ()
    told = ", ".join(f"{z.real:.4g}" + (f" ± {z.imag:.4g}j" if z.imag else "") for z in zeros if z.imag >= 0)
    text = f"invariant zeros from disturbances and faults to measurements: {told}"
    if (zeros.real >= 0).any():
        text += "; one that does not decay keeps levels away from zero"
    elif zeros.size:
        text += f"; an observer with a small level has a pole near {zeros[0].real:.4g}"
    return (text,)
