# SPDX-License-Identifier: BSD-3-Clause
"""The repair ladder: from gains that a solver found to gains that are proved.

Interior-point answers lie on the boundary of their own inequalities, on either side of it.  So for each level, from the
one wanted upwards:  (1) round the gains and test them with the solver's own multipliers;  (2) keep the gains and solve
for the multipliers of largest margin;  (3) grow the back-off and begin again.  What still fails is reported with the
vector that refutes it.  Each test is made in floating point with rigorous bounds (a millisecond) and then exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from faultrecon.certificate import Certificate, Verification
from faultrecon.lmi.quick import quickly_proved
from faultrecon.lmi.solve import Outcome
from faultrecon.methods.base import Theorem
from faultrecon.synthesis.certify import certificate, proof_inequalities, prove, shipped
from faultrecon.synthesis.levels import Posed, mildest, multipliers, quietest, smallest_gain

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rung:
    """One attempt: at which level, with whose multipliers, and what became of it."""

    level: float
    multipliers: str
    outcome: str

    def __str__(self) -> str:
        return f"γ = {self.level:.6g}, {self.multipliers}: {self.outcome}"


@dataclass(frozen=True, eq=False)
class Proven:
    """Gains that hold at a level, and the proof."""

    level: float
    gains: dict[str, Array]
    certificate: Certificate
    verification: Verification
    criterion: str


@dataclass(frozen=True)
class Central:
    """Another route to gains than the program: at a level, in words, and whether it finds the multipliers as well.

    theorem: whose unknowns it finds, where that is not the one to be proved.
    """

    at: Callable[[float], tuple[Outcome, str]]
    multipliers: bool = True
    theorem: Theorem | None = None


def climb(
    posed: Posed,
    levels: Sequence[float],
    say: Callable[[str], None],
    central: Central | None = None,
) -> tuple[Proven | None, tuple[Rung, ...]]:
    """Gains for the first of `levels` at which they can be proved, and every rung that was tried.

    central: gains at a level by another route than the program.
    """
    rungs: list[Rung] = []
    for level in levels:
        say(f"gains at γ = {level:.6g}")
        found, criterion = pick(posed, level) if central is None else central.at(level)
        if not found.solved:
            rungs.append(Rung(level, "no gains", found.solver))
            continue
        found_for = posed.theorem if central is None or central.theorem is None else central.theorem
        gains = shipped(found_for, found.values)
        say("proof")
        own = central is None or central.multipliers
        again = central is None or not central.multipliers  # a program over P of a large plant is what is avoided
        attempts = [("the solver's multipliers", lambda f=found: f)] if own else []
        attempts += [("those of largest margin", lambda g=gains, at=level: multipliers(posed, g, at))] if again else []
        for label, attempt in attempts:
            outcome = attempt()
            made, verification, word = _tested(posed, gains, outcome, level)
            rungs.append(Rung(level, label, word))
            if made is not None and verification is not None:
                return Proven(level, gains, made, verification, criterion), tuple(rungs)
    return None, tuple(rungs)


def pick(posed: Posed, level: float) -> tuple[Outcome, str]:
    """Gains at this level by the second criterion that suits the plant, and that criterion in words."""
    if posed.theorem.mildest is not None:
        return mildest(posed, level), posed.theorem.criterion
    if posed.plant.noise is not None and any(posed.plant.noise.sd):
        return quietest(posed, level), "least noise in the reconstructed fault (bound)"
    return smallest_gain(posed, level), "least gain from the healthy outputs to the state, in scaled units (bound)"


def _tested(
    posed: Posed, gains: Mapping[str, Array], outcome: Outcome, level: float
) -> tuple[Certificate | None, Verification | None, str]:
    if not outcome.solved:
        return None, None, f"no multipliers ({outcome.solver})"
    values = {**posed.fixed, **outcome.values}
    numbers = {**values, **gains, "γ": level}
    shown = all(quickly_proved(i, numbers) for i in proof_inequalities(posed.theorem))
    made = certificate(posed.method.name, posed.theorem, posed.plant, gains, values, level)
    verification = prove(made)
    if verification.sound:
        return made, verification, "proved exactly" + (", and in floating point with rigorous bounds" if shown else "")
    worst = next(s for s in verification.steps if s.verdict == "refuted")
    vector = ""
    if any(worst.witness):
        v = np.array([float(x) for x in worst.witness])
        vector = " by v = [" + ", ".join(f"{x:.2g}" for x in v / np.abs(v).max()) + "]"
    return None, None, f"{worst.label} is refuted{vector}"
