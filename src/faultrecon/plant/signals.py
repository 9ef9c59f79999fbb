# SPDX-License-Identifier: BSD-3-Clause
"""Names, units, ranges, limits and noise of the signals of a plant."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from faultrecon.finding import InputError, did_you_mean

NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]*")
DECLARED = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")
UNLIMITED = (-math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class Channels:
    """One group of signals, in order; ranges are expected deviations from the operating point, NaN where undeclared.

    limits: the lowest and the highest value that the device can put out, absolute; infinite where undeclared.
    """

    names: tuple[str, ...]
    units: tuple[str, ...] = ()
    ranges: tuple[float, ...] = ()
    limits: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(self, "units", tuple(self.units) or ("",) * n)
        object.__setattr__(self, "ranges", tuple(float(r) for r in self.ranges) or (math.nan,) * n)
        object.__setattr__(self, "limits", tuple((float(a), float(b)) for a, b in self.limits) or (UNLIMITED,) * n)
        if len(self.units) != n or len(self.ranges) != n:
            raise InputError(f"{n} signals have {len(self.units)} units and {len(self.ranges)} ranges")
        if len(self.limits) != n:
            raise InputError(f"{n} signals have {len(self.limits)} pairs of limits")
        for name in self.names:
            if not NAME.fullmatch(name):
                raise InputError(
                    f"'{name}' is no signal name", remedies=("use letters, digits and _, a letter first: 'pitch_rate'",)
                )
            if self.names.count(name) > 1:
                raise InputError(f"the signal name '{name}' is given twice")
        for name, r in zip(self.names, self.ranges, strict=True):
            if not (math.isnan(r) or (math.isfinite(r) and r > 0)):
                raise InputError(f"the range of {name} is {r}", why="a range is a positive number")
        for name, (low, high) in zip(self.names, self.limits, strict=True):
            if not low < high or low == math.inf or high == -math.inf:
                raise InputError(
                    f"the limits of {name} are {low:g} and {high:g}",
                    why="the first is the lowest value that it can take, the second the highest",
                    remedies=("give [low, high]; -inf or inf where there is none",),
                )

    @classmethod
    def declared(
        cls,
        texts: Sequence[str],
        ranges: Mapping[str, float] | None = None,
        limits: Mapping[str, tuple[float, float]] | None = None,
    ) -> Channels:
        """From texts such as 'theta [rad]'; ranges and limits by name."""
        found = [DECLARED.fullmatch(t) for t in texts]
        for text, match in zip(texts, found, strict=True):
            if match is None:
                raise InputError(f"'{text}' is no signal", remedies=("write 'name [unit]'",))
        names = tuple(m["name"] for m in found if m)
        units = tuple(m["unit"] or "" for m in found if m)
        group = cls(names, units)
        for name in (*(ranges or {}), *(limits or {})):
            group.index(name)
        return cls(
            names,
            units,
            tuple((ranges or {}).get(name, math.nan) for name in names),
            tuple((limits or {}).get(name, UNLIMITED) for name in names),
        )

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def index(self, name: str) -> int:
        """Position of a signal.  Raises InputError with a suggestion."""
        if name not in self.names:
            raise InputError(f"there is no signal '{name}'", why=did_you_mean(name, self.names))
        return self.names.index(name)

    def limited(self) -> dict[str, tuple[float, float]]:
        """The limits that were declared, by name."""
        return {name: pair for name, pair in zip(self.names, self.limits, strict=True) if pair != UNLIMITED}

    def texts(self) -> list[str]:
        """The declarations, 'name [unit]'."""
        return [f"{n} [{u}]" if u else n for n, u in zip(self.names, self.units, strict=True)]


@dataclass(frozen=True, slots=True)
class Noise:
    """Measurement noise: standard deviation per sensor of samples that are held for `hold` seconds each."""

    hold: float
    sd: tuple[float, ...]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.hold) and self.hold > 0):
            raise InputError(f"noise is held for {self.hold} s", why="a hold time is positive")
        for value in self.sd:
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"a noise standard deviation is {value}", why="it is finite and not negative")


@dataclass(frozen=True, slots=True)
class Signals:
    """The states x, inputs u and measurements y of a plant."""

    x: Channels
    u: Channels
    y: Channels

    def __post_init__(self) -> None:
        for name in self.u.names:
            if name in self.x.names or name in self.y.names:
                raise InputError(f"'{name}' is both an input and another signal")
        for group in (self.x, self.u, self.y):
            if "t" in group.names or "time" in group.names:
                raise InputError("'t' and 'time' name the time", remedies=("rename the signal",))
        for name in self.x.limited():
            raise InputError(f"the state {name} has limits", why="limits are those of a device: an input or a sensor")
