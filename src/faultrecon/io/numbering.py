# SPDX-License-Identifier: BSD-3-Clause
"""The numbers of the lines of a stream: each is used once, whatever order lines with numbers of their own come in."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

REMEMBERED = 1000  # numbers; a line that is overtaken by more others is taken for one that is sent again


@dataclass(frozen=True)
class Numbers:
    """Which numbers are used: all up to `floor`, and those in `recent`, which are sorted and above it.

    last: the highest one.  own: whether the last sample brought its own.
    """

    last: int = 0
    own: bool = False
    floor: int = -1
    recent: tuple[int, ...] = ()

    def free(self, number: int | None) -> bool:
        """Whether a line may have this number of its own; one without a number always may."""
        if number is None or number > self.last:
            return True
        at = bisect_left(self.recent, number)
        return number > self.floor and self.recent[at : at + 1] != (number,)

    def used(self, number: int | None) -> tuple[int, Numbers]:
        """The number of a line, its own or the next, and the numbers after it."""
        if number is None and not self.recent:  # nobody numbers, or nobody has skipped one: there is nothing to list
            return self.last + 1, Numbers(self.last + 1, False, self.last + 1)
        taken = self.last + 1 if number is None else number
        at = bisect_left(self.recent, taken)
        recent, floor, past = (*self.recent[:at], taken, *self.recent[at:]), self.floor, 0
        while past < len(recent) and (recent[past] == floor + 1 or len(recent) - past > REMEMBERED):
            floor, past = recent[past], past + 1
        return taken, Numbers(max(self.last, taken), number is not None, floor, recent[past:])

    def pack(self) -> dict[str, Any]:
        """Plain values, for a checkpoint."""
        return {"seq": self.last, "numbered": self.own, "floor": self.floor, "recent": list(self.recent)}

    @staticmethod
    def unpack(packed: Mapping[str, Any]) -> Numbers:
        """What was packed."""
        return Numbers(packed["seq"], packed["numbered"], packed["floor"], tuple(packed["recent"]))
