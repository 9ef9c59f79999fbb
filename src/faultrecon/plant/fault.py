# SPDX-License-Identifier: BSD-3-Clause
"""What may go wrong and what disturbs: fault channels and disturbance channels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from faultrecon.finding import InputError

Role = Literal["attenuate", "decouple", "noise"]
Site = Literal["sensor", "actuator"]
Effect = Literal["additive", "multiplicative"]


@dataclass(frozen=True, slots=True)
class FaultChannel:
    """One fault signal: where it enters, and how large and how fast it may be.

    on: coefficient per sensor (a sensor fault), or per input (an actuator fault).
    size: the magnitude that counts as one when errors of several faults are compared; rate: bound on |df/dt|.
    """

    name: str
    on: Mapping[str, float]
    site: Site = "sensor"
    effect: Effect = "additive"
    size: float = 1.0
    rate: float = math.inf

    def __post_init__(self) -> None:
        _printable("fault", self.name)
        _positive(f"fault '{self.name}'", "size", self.size)
        if not self.rate > 0:
            raise InputError(f"fault '{self.name}' has rate {self.rate}", why="a rate bound is positive")
        if self.site not in ("sensor", "actuator") or self.effect not in ("additive", "multiplicative"):
            raise InputError(
                f"fault '{self.name}' is '{self.effect}' on a '{self.site}'",
                remedies=("an effect is additive or multiplicative, a site sensor or actuator",),
            )
        _coefficients(f"fault '{self.name}'", self.on)
        if not any(self.on.values()):
            raise InputError(f"fault '{self.name}' reaches no signal", remedies=("name the sensor it sits on",))


@dataclass(frozen=True, slots=True)
class Disturbance:
    """One unknown input w: into the states, onto the sensors, and what a design should do about it.

    size: the amplitude that counts as one; coefficients are per unit of the physical signal.
    """

    name: str
    into: Mapping[str, float] = field(default_factory=dict)
    on: Mapping[str, float] = field(default_factory=dict)
    role: Role = "attenuate"
    size: float = 1.0

    def __post_init__(self) -> None:
        _printable("disturbance", self.name)
        _positive(f"disturbance '{self.name}'", "size", self.size)
        if self.role not in ("attenuate", "decouple", "noise"):
            raise InputError(
                f"disturbance '{self.name}' has role '{self.role}'", remedies=("use attenuate, decouple or noise",)
            )
        _coefficients(f"disturbance '{self.name}'", {**self.into, **self.on})


def _printable(owner: str, name: str) -> None:
    if not name.strip() or not name.isprintable():
        raise InputError(f"{name!r} is no name of a {owner}", remedies=("use visible characters on one line",))


def _positive(owner: str, key: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{owner} has {key} {value}", why=f"a {key} is a positive number")


def _coefficients(owner: str, table: Mapping[str, float]) -> None:
    for name, value in table.items():
        if not math.isfinite(value):
            raise InputError(f"{owner} enters {name} with {value}", why="a coefficient is a finite number")
