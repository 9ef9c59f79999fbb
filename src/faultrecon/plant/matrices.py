# SPDX-License-Identifier: BSD-3-Clause
"""Plants from and to four matrices, with a word on what matrices cannot hold.

The common ground of every tool in the field: (A, B, C, D), a sample time, and names beside them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import Finding, InputError, did_you_mean
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import DECLARED, Channels, Noise, Signals

Array = NDArray[np.float64]
Group = Literal["u", "disturbances", "faults"]


class FindingWarning(UserWarning):
    """A warning that carries the findings it tells of."""

    def __init__(self, *findings: Finding) -> None:
        super().__init__("; ".join(map(str, findings)))
        self.findings = findings


def tell(findings: Sequence[Finding]) -> None:
    """Warn of findings, if there are any, at the line of whoever called the caller."""
    if findings:
        warnings.warn(FindingWarning(*findings), stacklevel=3)


# ---------------------------------------------------------------- out


def plant_matrices(plant: Plant, *, inputs: Sequence[Group] = ("u",)) -> tuple[Array, Array, Array, Array]:
    """(A, B, C, D) with the chosen groups as inputs, in that order: "u", "disturbances", "faults", per physical unit.

    Raises InputError for a plant with a nonlinear part, and for multiplicative faults as inputs.
    """
    _demand_linear(plant)
    columns = [input_columns(plant, group)[:2] for group in groups_of(inputs)]
    B = np.hstack([np.zeros((plant.n, 0)), *(b for b, _ in columns)])
    D = np.hstack([np.zeros((plant.p, 0)), *(d for _, d in columns)])
    return plant.A.copy(), B, plant.C.copy(), D


def left_behind(plant: Plant, inputs: Sequence[Group] = ("u",)) -> list[Finding]:
    """What a system of matrices with these inputs does not hold of the plant, as warnings; names apart."""
    found = []
    point = (*plant.point.x, *plant.point.u, *plant.point.y)
    if any(point):
        found.append(
            Finding(
                "the operating point is left behind",
                why="the matrices act on deviations from it",
                evidence={g: list(getattr(plant.point, g)) for g in ("x", "u", "y")},
                remedies=("subtract plant.point from logs",),
                severity="warning",
            )
        )
    groups = groups_of(inputs)
    parts = {
        f"inputs {', '.join(plant.signals.u)}": "u" not in groups and len(plant.signals.u) > 0,
        f"disturbances {', '.join(d.name for d in plant.disturbances)}": bool(plant.disturbances)
        and "disturbances" not in groups,
        f"faults {', '.join(f.name for f in plant.faults)}": bool(plant.faults) and "faults" not in groups,
        "roles and sizes of disturbances": bool(plant.disturbances) and "disturbances" in groups,
        "sizes and rates of faults": bool(plant.faults) and "faults" in groups,
        "noise": plant.noise is not None,
        "ranges": any(not math.isnan(r) for g in ("x", "u", "y") for r in getattr(plant.signals, g).ranges),
    }
    lost = [part for part, there in parts.items() if there]
    if lost:
        found.append(
            Finding(
                f"left behind: {'; '.join(lost)}",
                why="a system of matrices has no place for them",
                remedies=("keep the plant beside it",),
                severity="warning",
            )
        )
    return found


def _demand_linear(plant: Plant) -> None:
    parts = [word for word, part in (("φ", plant.nonlinearity), ("g", plant.known)) if part is not None]
    if parts:
        raise InputError(
            f"{plant.name} has the nonlinear part {' and '.join(parts)}",
            why="its matrices alone would be another plant",
            remedies=("convert linearised(plant, x, u), its linear plant about a point",),
        )


def groups_of(inputs: Sequence[Group]) -> tuple[Group, ...]:
    """The groups asked for, each once.  Raises InputError with a suggestion."""
    known: tuple[Group, ...] = ("u", "disturbances", "faults")
    chosen = [inputs] if isinstance(inputs, str) else list(inputs)
    for group in chosen:
        if group not in known:
            raise InputError(f"there is no group of inputs '{group}'", why=did_you_mean(str(group), known))
    return tuple(known[known.index(group)] for group in dict.fromkeys(chosen))


def input_columns(plant: Plant, group: Group) -> tuple[Array, Array, list[str]]:
    """Columns into the states (n, k), columns onto the sensors (p, k), and their names."""
    if group == "u":
        return plant.B, plant.D, plant.signals.u.texts()
    if group == "faults":
        for fault in plant.faults:
            if fault.effect == "multiplicative":
                raise InputError(
                    f"fault '{fault.name}' is multiplicative",
                    why="it multiplies a signal, so it is no input of a linear system",
                    remedies=("declare it additive: its waveform is then (gain - 1) times the signal",),
                )
        return plant.E_f, plant.F_f, [f.name for f in plant.faults]
    into, on = np.zeros((plant.n, len(plant.disturbances))), np.zeros((plant.p, len(plant.disturbances)))
    for j, disturbance in enumerate(plant.disturbances):
        for name, value in disturbance.into.items():
            into[plant.signals.x.index(name), j] = value
        for name, value in disturbance.on.items():
            on[plant.signals.y.index(name), j] = value
    return into, on, [d.name for d in plant.disturbances]


def demand_distinct(labels: Sequence[str]) -> None:
    """No two inputs of one name.  Raises InputError."""
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(f"two inputs would be called '{label}'", remedies=("rename the fault or disturbance",))


# ---------------------------------------------------------------- in


def plant_from_matrices(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    *,
    sample_time: float | None = None,
    name: str | None = None,
    states: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    faults: Sequence[FaultChannel | str] = (),
    disturbances: Sequence[Disturbance | str] = (),
    noise: Noise | None = None,
    operating_point: OperatingPoint | None = None,
    source: str = "",
) -> Plant:
    """A plant from four matrices; signals are called x1.., u1.., y1.. unless declared as "name [unit]".

    A disturbance given as text is the input of that name: its columns of B and D move to the disturbance.  A fault
    given as text is the input of that name if there is one (its column of B has to be zero), else an additive fault on
    the sensor of that name.  Raises InputError on shapes, numbers or names that do not fit.
    """
    a, b, c, d = _shaped(A, B, C, D)
    x, y = _channels("x", states, a.shape[0]), _channels("y", outputs, c.shape[0])
    outer = split(_texts("u", inputs, b.shape[1]))
    names = [known for known, _ in outer]
    made_w = [_disturbance(w, names, x, y, b, d) if isinstance(w, str) else w for w in disturbances]
    made_f = [_fault(f, names, y, b, d) if isinstance(f, str) else f for f in faults]
    taken = {text for text in (*disturbances, *faults) if isinstance(text, str)}
    kept = [j for j, known in enumerate(names) if known not in taken]
    u = Channels(tuple(outer[j][0] for j in kept), tuple(outer[j][1] for j in kept))
    return Plant(
        name=name or "imported plant",
        signals=Signals(x, u, y),
        A=a,
        B=b[:, kept],
        C=c,
        D=d[:, kept],
        faults=tuple(made_f),
        disturbances=tuple(made_w),
        noise=noise,
        operating_point=operating_point,
        sample_time=sample_time,
        source=source,
    )


def _shaped(A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Four matrices; a vector B is one input, a vector C one sensor, and a D of zero has the size that fits."""
    a, b, c, d = (_real(letter, value) for letter, value in zip("ABCD", (A, B, C, D), strict=True))
    b = b[:, None] if b.ndim == 1 else b
    c = c[None, :] if c.ndim == 1 else c
    if d.ndim < 2 and b.ndim == c.ndim == 2 and (d.size == c.shape[0] * b.shape[1] or (d.ndim == 0 and d == 0)):
        d = np.broadcast_to(d, (c.shape[0], b.shape[1])) if d.ndim == 0 else d.reshape(c.shape[0], b.shape[1])
    for letter, value in zip("ABCD", (a, b, c, d), strict=True):
        if value.ndim != 2:
            raise InputError(f"{letter} has {value.ndim} dimensions", why="a matrix has two")
    n, m, p = a.shape[0], b.shape[1], c.shape[0]
    for letter, value, wanted in (("A", a, (n, n)), ("B", b, (n, m)), ("C", c, (p, n)), ("D", d, (p, m))):
        if value.shape != wanted:
            why = f"{n} rows of A, {m} columns of B and {p} rows of C ask for {wanted}"
            raise InputError(f"{letter} is {value.shape}", why=why)
    return a, b, c, d


def _real(letter: str, value: ArrayLike) -> Array:
    try:
        array = np.asarray(value)
        if np.iscomplexobj(array):
            raise InputError(f"{letter} is complex", why="a plant has real matrices")
        return np.array(array, dtype=float)
    except (TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{letter} is no matrix of numbers", why=str(error)) from error


# ---------------------------------------------------------------- names


def _texts(group: str, texts: Sequence[str] | None, size: int) -> list[str]:
    if texts is None:
        return [f"{group}{k + 1}" for k in range(size)]
    if len(texts) != size:
        raise InputError(f"{len(texts)} names are given for {group}", why=f"the matrices have {size}")
    return list(texts)


def _channels(group: str, texts: Sequence[str] | None, size: int) -> Channels:
    return Channels.declared(_texts(group, texts, size))


def split(texts: Sequence[str]) -> list[tuple[str, str]]:
    """Name and unit of each declaration, without asking whether the name is one."""
    found = [(DECLARED.fullmatch(text), text) for text in texts]
    return [(m["name"], m["unit"] or "") if m else (text, "") for m, text in found]


def _disturbance(text: str, inputs: Sequence[str], x: Channels, y: Channels, B: Array, D: Array) -> Disturbance:
    if text not in inputs:
        raise InputError(f"there is no input '{text}' to take as a disturbance", why=did_you_mean(text, inputs))
    j = inputs.index(text)
    return Disturbance(text, _told(x, B[:, j]), _told(y, D[:, j]))


def _fault(text: str, inputs: Sequence[str], y: Channels, B: Array, D: Array) -> FaultChannel:
    if text in inputs:
        j = inputs.index(text)
        if np.any(B[:, j]):
            raise InputError(
                f"the input '{text}' moves the states, so it is no sensor fault",
                remedies=(
                    f"declare FaultChannel('{text}', on={{input: 1.0}}, site='actuator') on the input it adds to",
                ),
            )
        return FaultChannel(text, _told(y, D[:, j]))
    if text not in y.names:
        why = did_you_mean(text, [*y.names, *inputs])
        raise InputError(f"there is no sensor or input '{text}' to carry a fault", why=why)
    return FaultChannel(text, {text: 1.0})


def _told(channels: Channels, column: Array) -> Mapping[str, float]:
    return {name: float(value) for name, value in zip(channels, column, strict=True) if value != 0}
