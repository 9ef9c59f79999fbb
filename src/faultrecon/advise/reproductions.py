# SPDX-License-Identifier: BSD-3-Clause
"""What a paper printed, what we hold to be right, and what this installation computes, side by side.

Three facts are kept apart: `printed` is the paper's number, `reference` ours from an independent implementation,
`computed` what came out just now.  `agrees` compares the last two; whether the paper's own number can be reproduced is
said by `status`.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from faultrecon.finding import InputError, did_you_mean
from faultrecon.methods.base import Status

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Row:
    """One number: the paper's, the reference, and the computed one with the tolerance it is held to.

    None for computed or reference stands for "has no solution".  tolerance is relative, or absolute when `absolute`.
    expected: what theory predicts when the reference is one draw of a random number; the computed one is then held to
    it.  status and note: what holds of the printed number.
    """

    item: str
    computed: float | None
    reference: float | None
    tolerance: float
    absolute: bool = False
    expected: float | None = None
    printed: float | None = None
    status: Status = "re_derived"
    note: str = ""

    @property
    def agrees(self) -> bool:
        """Whether the computed number is within its tolerance."""
        target = self.reference if self.expected is None else self.expected
        if self.computed is None or target is None:
            return self.computed is None and target is None
        return abs(self.computed - target) <= self.tolerance * (1.0 if self.absolute else abs(target))

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {**self.__dict__, "agrees": self.agrees}


@dataclass(frozen=True)
class Comparison:
    """A table of a reproduction: a title, its rows, and remarks that concern all of them."""

    title: str
    rows: Sequence[Row]
    remarks: Sequence[str] = ()

    def __str__(self) -> str:
        width = max(len(r.item) for r in self.rows)
        head = f"{'':{width}} {'printed':>9} {'reference':>12} {'predicted':>12} {'computed':>12} {'tolerance':>10}"
        lines = [self.title, head]
        for r in self.rows:
            tolerance = f"{r.tolerance:.2g}{'' if r.absolute else ' rel'}"
            lines.append(
                f"{r.item:{width}} {_number(r.printed, ''):>9} {_number(r.reference):>12}"
                f" {_number(r.expected, ''):>12} {_number(r.computed):>12} {tolerance:>10}"
                f"  {'agrees' if r.agrees else 'DIFFERS'}  {r.status.replace('_', ' ')}"
            )
        notes = dict.fromkeys(r.note for r in self.rows if r.note)
        return "\n".join([*lines, *(f"  {note}" for note in (*notes, *self.remarks))])

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {"title": self.title, "rows": [r.as_dict() for r in self.rows], "remarks": list(self.remarks)}


@dataclass(frozen=True)
class Reproduced:
    """The tables of one paper and the figures that were drawn."""

    key: str
    paper: str
    tables: Sequence[Comparison]
    figures: Sequence[Path] = ()
    note: str = ""
    seconds: float = field(default=math.nan, compare=False)

    @property
    def agrees(self) -> bool:
        """Whether every number is within its tolerance."""
        return all(row.agrees for row in self)

    def __iter__(self) -> Iterator[Row]:
        return (row for table in self.tables for row in table.rows)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        tables = [table.as_dict() for table in self.tables]
        figures = [str(path) for path in self.figures]
        return {"key": self.key, "paper": self.paper, "agrees": self.agrees, "tables": tables, "figures": figures}

    def __str__(self) -> str:
        rows = list(self)
        lines = [self.paper, ""]
        for table in self.tables:
            lines += [str(table), ""]
        lines += [f"wrote {path}" for path in self.figures]
        printed = [row for row in rows if row.printed is not None]
        if printed:
            met = sum(row.status == "as_printed" for row in printed)
            lines.append(f"{met} of {len(printed)} values are reproduced as the paper prints them")
        good = sum(row.agrees for row in rows)
        lines.append(f"{good} of {len(rows)} values agree, within the stated tolerances, with our own re-derivation")
        return "\n".join([*lines, self.note] if self.note else lines)


def reproducible() -> tuple[str, ...]:
    """The keys of the papers that `reproduce` knows."""
    import faultrecon.advise.papers as package

    return tuple(sorted(m.name for m in pkgutil.iter_modules(package.__path__) if not m.name.startswith("_")))


def reproduce(
    key: str, out: str | Path | None = None, *, seed: int = 0, progress: Progress | None = None
) -> Reproduced:
    """Compute a paper's numbers again and draw the counterparts of its figures.

    key: as in `cite`, for example "khosrowjerdi2011".  out: folder for the figures, made if it does not exist; none are
    drawn without one.  seed: of the simulated noise.  progress: told the stage of the work.
    Raises InputError for a paper that is not here.
    """
    if key not in reproducible():
        raise InputError(f"no reproduction of '{key}'", why=did_you_mean(key, reproducible()))
    folder = None if out is None else Path(out)
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made a folder", why=str(error.strerror or error)) from error
    module = importlib.import_module(f"faultrecon.advise.papers.{key}")
    return module.reproduction(folder, seed, progress or (lambda stage: None))


def _number(value: float | None, none: str = "none") -> str:
    return none if value is None else f"{value:.7g}"
