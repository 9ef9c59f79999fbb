# SPDX-License-Identifier: BSD-3-Clause
"""What a plant has to meet for a sampled proportional-integral observer, and what a Lipschitz bound may ask of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from faultrecon.diagnosis import conditions
from faultrecon.diagnosis.existence import decoupling_findings, fault_findings
from faultrecon.finding import Finding
from faultrecon.methods.base import Assumed
from faultrecon.methods.sampled_plants import continuous_findings, own_time_findings
from faultrecon.plant.lipschitz import Lipschitz
from faultrecon.plant.plant import Plant

if TYPE_CHECKING:
    from faultrecon.methods.euler_pi import EulerPi

SEE = "Jia 2015, section 2, re-derived"
HOPELESS = 0.02
"""Distance of the constant fault condition below which estimates are of no use.  The flexible joint with a sensor fault
beside its actuator fault: see tests/papers/test_jia2015.py."""


def sampled_findings(plant: Plant, sample_time: float | None) -> list[Finding]:
    """Findings in the order in which they should be read; the first fatal one alone."""
    found = own_time_findings(plant, sample_time) or fault_findings(plant)
    found = found or _kind(plant, sample_time) or _channels(plant)
    if found:
        return found
    found = decoupling_findings(plant)
    if any(f.severity == "fatal" for f in found):
        return found
    return found + _conditioning(plant)


def plain_findings(plant: Plant, sample_time: float | None) -> list[Finding]:
    """What every observer asks for that discretises a plant itself: additive faults, noise, no way around the states."""
    return fault_findings(plant) or continuous_findings(plant) or _kind(plant, sample_time) or _channels(plant)


def _kind(plant: Plant, sample_time: float | None) -> list[Finding]:
    for f in plant.faults:
        if f.effect == "multiplicative":
            why = "the method reconstructs additive faults"
            remedy = "declare it additive: the waveform of (gain - 1) times the signal is then reconstructed"
            return [Finding(f"fault '{f.name}' is multiplicative", why=why, remedies=(remedy,), see=SEE)]
    if plant.noise is None or not any(plant.noise.sd):
        what = f"{plant.name} declares no sensor noise"
        why = "without a price on noise the gains grow without bound"
        if sample_time is None and plant.sample_time is None:
            why += ", and its hold time is the sample time that a sampled observer is made for"
        remedies = ("declare noise: the standard deviation of each sensor, and the time for which a sample is held",)
        return [Finding(what, why=why, remedies=remedies, see=SEE)]
    return []


def _channels(plant: Plant) -> list[Finding]:
    commands = conditions.commands(plant)
    reached = [f.name for f, column in zip(plant.faults, (plant.D @ commands).T, strict=True) if column.any()]
    if reached:
        why = "it reaches the measurements at once, through D, and the model of the method has no such path"
        what = f"actuator fault '{reached[0]}' shows in the sensors directly"
        remedies = ("declare it a sensor fault on the sensors that D reaches", "leave the fast path out of D")
        return [Finding(what, why=why, evidence={"faults": reached}, remedies=remedies, see=SEE)]
    decoupled = [d.name for d in plant.attenuated if d.role == "decouple" and any(d.on.values())]
    if decoupled:
        why = "what is decoupled may act on the states alone: a sensor that it reaches is needed to see it"
        remedies = (f'attenuate {decoupled[0]} (role = "attenuate")',)
        return [
            Finding(f"'{decoupled[0]}' is to be decoupled and acts on a sensor", why=why, remedies=remedies, see=SEE)
        ]
    if plant.noise is not None and plant.nonlinearity is not None:
        return _faulty_command(plant, commands)
    return []


def _faulty_command(plant: Plant, commands: np.ndarray) -> list[Finding]:
    """φ sees the command that was sent, and an actuator fault changes the one that arrives."""
    assert plant.nonlinearity is not None
    phi = plant.nonlinearity.phi
    group = list(phi.inputs).index("u") if "u" in phi.inputs else -1
    read = {int(node[2]) for node in phi.nodes if node[0] == "input" and node[1] == group}
    for f, column in zip(plant.faults, commands.T, strict=True):
        if any(column[i] for i in read):
            why = "φ would be copied with the command that was sent, not with the one that arrives"
            remedies = ("write that term with states, or as a further state",)
            return [Finding(f"φ reads an input that '{f.name}' moves", why=why, remedies=remedies, see=SEE)]
    return []


def _conditioning(plant: Plant) -> list[Finding]:
    """How far a constant fault is from looking like a plant at rest, when it is not far."""
    condition = conditions.constant_fault(plant)
    if condition.distance >= HOPELESS:
        return []
    sigma = float(np.linalg.svd(conditions.constant_fault_matrix(plant), compute_uv=False)[-1])
    return [
        Finding(
            f"the faults of {plant.name} can hardly be told apart",
            why=f"[A, E; C, F] is within {condition.distance:.2g} of losing rank, relative to its size",
            evidence={"distance": condition.distance, "smallest singular value": sigma},
            remedies=("declare fewer faults at a time (faults=[...] or --fault)", "add a sensor"),
            see="Jia 2015, section 2.3, re-derived",
            severity="warning",
        )
    ]


def _cannot(term: Lipschitz, most: float) -> str:
    if not term.separate or term.channels is None:
        text = f"a Lipschitz constant of {term.constant:.6g}: the largest is {most:.6g}"
    else:
        each = ", ".join(f"{c:.6g}" for c in term.channels)
        text = (
            f"Lipschitz constants of {each} of the components of φ: {most / term.constant:.4g} times that is the most"
        )
    return f"no observer of this kind can live with {text}"


def each_premises(plant: Plant) -> list[Assumed]:
    """The bound on each component of φ, and who says so; nothing where there is one for all of φ."""
    term = plant.nonlinearity
    if term is None or term.channels is None or not term.separate:
        return []
    how = "proved by ball arithmetic, not rechecked here" if term.basis == "proved" else "declared with the plant"
    bounds = []
    for k, (constant, seen) in enumerate(zip(term.channels, term.sees, strict=True)):
        reads = ", ".join(name for name, sees in zip(term.reads, seen, strict=True) if sees) or "no state"
        bounds.append(f"{constant:.9g} for component {k + 1}, which reads {reads}")
    return [Assumed("Lipschitz constants", f"on the domain {'; '.join(bounds)}: {how}", term.basis)]


def unstructured(method: EulerPi, plant: Plant) -> Finding | None:
    """Why no multiplier serves: the Lipschitz bound against the largest one there is an observer for, in numbers."""
    from faultrecon.methods.sampled_limits import largest_lipschitz

    term = plant.nonlinearity
    if term is None or term.constant == 0:
        return None
    most = largest_lipschitz(method, plant)
    if most is None or most >= term.constant:
        return None
    whole = term.into.shape[1] == plant.n or len(term.reads) == plant.n
    where = "declare where the nonlinearity enters ('into') and which states it reads ('reads')"
    scale = "scale the states: the bound |φ(a) - φ(b)| ≤ ℓ |a - b| depends on their units, the plant does not"
    apart = term.into.shape[1] > 1 and not term.separate
    each = ('give one Lipschitz constant per component of φ (lipschitz = "derive", or a list of numbers)',) * apart
    return Finding(
        _cannot(term, most),
        why="φ enters every equation and reads every state, and among all such φ one hides a state that does not settle"
        if whole
        else "among all φ within that bound one hides a state that does not settle in a sample time",
        evidence={"Lipschitz constant": term.constant, "largest": most, "sample_time": method.time(plant)},
        remedies=(where, scale, *each) if whole else (*each, "sample faster", "shrink the domain of φ", scale),
        see="Jia 2015, section 4, re-derived",
    )
