# SPDX-License-Identifier: BSD-3-Clause
"""Values of a .mat file as SciPy hands them out: matrices, numbers, text, cells of text, structs; each knows its place.

Everything there is a matrix, text is an array of characters, and a cell is an array of objects; what a value may be is
checked here, and a complaint names file, variable and value.  Indices in messages count from one, as MATLAB does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Place:
    """One value, the file it is from, and what it is called there: 'A', 'faults(2).size'."""

    source: str
    name: str
    value: Any

    def refuse(self, what: str, why: str = "", *remedies: str) -> NoReturn:
        """Raise InputError about this value."""
        raise InputError(f"{self.source}: {self.name} {what}", why=why, remedies=remedies)

    def matrix(self, *, finite: bool = True) -> Array:
        """A matrix of real numbers, finite unless said otherwise."""
        value = self.value.toarray() if hasattr(self.value, "toarray") else np.asarray(self.value)
        if value.dtype.kind not in "fiub":
            words = {"c": "complex", "U": "text", "S": "text", "O": "a cell", "V": "a struct"}
            self.refuse(f"is {words.get(value.dtype.kind, str(value.dtype))}", "it holds real numbers here")
        if value.ndim != 2:
            self.refuse(f"has {value.ndim} dimensions", "a matrix has two")
        array = np.array(value, dtype=float)
        wrong = np.argwhere(~np.isfinite(array))
        if finite and wrong.size:
            i, j = (int(k) for k in wrong[0])
            self.refuse(f"holds {array[i, j]}", f"at ({i + 1},{j + 1}); every entry is a finite number", "correct it")
        return array

    def scalar(self, *, finite: bool = True) -> float:
        """One number."""
        value = self.matrix(finite=finite)
        if value.size != 1:
            self.refuse(f"is {value.shape}", "it is one number")
        return float(value.ravel()[0])

    def vector(self, size: int | None = None, *, finite: bool = True) -> tuple[float, ...]:
        """A row or a column of numbers."""
        value = self.matrix(finite=finite)
        if value.size and 1 not in value.shape:
            self.refuse(f"is {value.shape}", "it is a row or a column")
        if size is not None and value.size != size:
            self.refuse(f"has {value.size} entries", f"the matrices ask for {size}")
        return tuple(float(v) for v in value.ravel())

    def text(self) -> str:
        """One line of text."""
        value = np.asarray(self.value)
        if value.size == 0:
            return ""
        if value.dtype.kind != "U" or value.size != 1:
            self.refuse("is no line of text", f"it is {_shown(value)}", "write it in quotes: 'name'")
        return str(value.ravel()[0])

    def texts(self, size: int | None = None) -> tuple[str, ...]:
        """A cell array of text in a row or a column; rows of a character matrix serve too."""
        value = np.asarray(self.value)
        if value.size and value.ndim == 2 and 1 not in value.shape:
            self.refuse(f"is a {value.shape[0]} by {value.shape[1]} cell", "names come in a row or a column")
        if value.dtype.kind == "U":
            found = tuple(str(v).rstrip(" ") for v in value.ravel())  # a character matrix is padded with blanks
        elif value.dtype.kind == "O" or value.size == 0:
            entries = enumerate(value.ravel())
            found = tuple(Place(self.source, f"{self.name}{{{k + 1}}}", v).text() for k, v in entries)
        else:
            self.refuse(f"is {_shown(value)}", "it is a cell array of text", "write {'theta', 'omega'}")
        if size is not None and len(found) != size:
            self.refuse(f"has {len(found)} entries", f"the matrices ask for {size}")
        return found

    def records(self) -> list[Record]:
        """The entries of a struct array."""
        value = np.asarray(self.value)
        if value.dtype.names is None:
            self.refuse(f"is {_shown(value)}", "it is a struct")
        flat = value.ravel()
        names = [self.name] if flat.size == 1 else [f"{self.name}({k + 1})" for k in range(flat.size)]
        return [Record(self.source, name, row) for name, row in zip(names, flat, strict=True)]


@dataclass(frozen=True, eq=False)
class Record:
    """One struct."""

    source: str
    name: str
    row: Any

    @property
    def fields(self) -> tuple[str, ...]:
        """The names of its fields."""
        return self.row.dtype.names or ()

    def __contains__(self, field: str) -> bool:
        return field in self.fields

    def __getitem__(self, field: str) -> Place:
        """A field.  Raises InputError when it is missing."""
        if field not in self.fields:
            given = ", ".join(self.fields) or "none"
            raise InputError(f"{self.source}: {self.name} has no field {field}", why=f"its fields are {given}")
        return Place(self.source, f"{self.name}.{field}", self.row[field])

    def only(self, known: Sequence[str]) -> Record:
        """This record, all of whose fields are known.  Raises InputError with a suggestion."""
        from faultrecon.finding import did_you_mean

        for field in self.fields:
            if field not in known:
                raise InputError(f"{self.source}: {self.name} has a field {field}", why=did_you_mean(field, known))
        return self

    def table(self, names: str, numbers: str) -> dict[str, float]:
        """Coefficients by signal; none when neither field is there."""
        if names not in self and numbers not in self:
            return {}
        keys = self[names].texts()
        if len(set(keys)) < len(keys):
            self[names].refuse("names a signal twice")
        return dict(zip(keys, self[numbers].vector(len(keys)), strict=True))


def _shown(value: NDArray[Any]) -> str:
    if value.dtype.names is not None:
        return "a struct"
    if value.dtype.kind == "O":
        return f"a {value.shape} cell"
    return f"{value.shape} of numbers" if value.dtype.kind in "fiubc" else f"{value.shape} of {value.dtype}"
