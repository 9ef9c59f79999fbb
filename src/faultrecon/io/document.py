# SPDX-License-Identifier: BSD-3-Clause
"""A TOML file whose values know their place, so that every complaint names file, line and key.

A `Node` is one value; asked for a table, a list, a text or a number it gives that or raises InputError such as
`plant.toml:12  signals.y[2]: 'enc lnk' is no signal name; ...`.
"""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any, NoReturn

from faultrecon.finding import InputError, did_you_mean
from faultrecon.io.positions import Path, line_of, positions, spelled

LARGEST = 10_000_000  # bytes; a model of a thousand states fits, a recording mistaken for one does not
_WORDS = {str: "text", bool: "a truth value", int: "a number", float: "a number", list: "a list", dict: "a table"}


@dataclass(frozen=True)
class Document:
    """A text and the name of the file it came from; lines are only looked up once something is wrong."""

    text: str
    source: str

    @cached_property
    def lines(self) -> dict[Path, int]:
        """Line by path."""
        return positions(self.text)

    def where(self, path: Path) -> str:
        """'plant.toml:12  signals.y[2]'; the file as a whole is called 'the file'."""
        return f"{self.source}:{line_of(path, self.lines)}  {spelled(path) or 'the file'}"


@dataclass(frozen=True)
class Node:
    """One value of a document and the path to it."""

    document: Document
    path: Path
    value: Any

    # ------------------------------------------------------------ complaints

    @property
    def where(self) -> str:
        """File, line and key, as messages begin."""
        return self.document.where(self.path)

    def refuse(self, what: str, why: str = "", *remedies: str) -> NoReturn:
        """Raise InputError about this value."""
        raise InputError(f"{self.where}: {what}", why=why, remedies=tuple(r for r in remedies if r))

    @contextmanager
    def here(self) -> Iterator[None]:
        """Whatever InputError the block raises without a place is about this value."""
        try:
            yield
        except InputError as error:
            found = error.finding
            if found.what.startswith(f"{self.document.source}:"):
                raise
            # What is a suggestion reads better at the end: 'there is no signal 'q'; did you mean 'p'?'
            suggestion = found.why.startswith(("did you mean", "known: ", "none is declared"))
            why, remedies = ("", (found.why, *found.remedies)) if suggestion else (found.why, found.remedies)
            raise InputError(f"{self.where}: {found.what}", why=why, remedies=remedies, see=found.see) from error

    def _kind(self) -> str:
        return _WORDS.get(type(self.value), "a date or time")

    # ------------------------------------------------------------ kinds of values

    def table(self) -> dict[str, Node]:
        """The entries of a table."""
        if not isinstance(self.value, dict):
            self.refuse(f"is {self._kind()}, not a table", "", "write { name = value }")
        return {key: Node(self.document, (*self.path, key), value) for key, value in self.value.items()}

    def fields(self, required: Sequence[str], optional: Sequence[str] = ()) -> dict[str, Node]:
        """The entries of a table with these keys and no others."""
        entries = self.table()
        known = (*required, *optional)
        for key, entry in entries.items():
            if key not in known:
                entry.refuse(f"unknown key '{key}'", "", did_you_mean(key, known))
        for key in required:
            if key not in entries:
                self.refuse(f"the key '{key}' is missing", "", f"add {key} = ...")
        return entries

    def items(self) -> list[Node]:
        """The items of a list."""
        if not isinstance(self.value, list):
            self.refuse(f"is {self._kind()}, not a list", "", "put it in [ ]")
        return [Node(self.document, (*self.path, i), value) for i, value in enumerate(self.value)]

    def string(self) -> str:
        """A text."""
        if not isinstance(self.value, str):
            self.refuse(f"is {self._kind()}, not text", "", "put it in quotes")
        return self.value

    def number(self, *, infinite: bool = False) -> float:
        """A number; infinite only where that has a meaning."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            self.refuse(f"is {self._kind()}, not a number", f"the value is {self.value!r:.60}")
        try:
            number = float(self.value)
        except OverflowError:
            self.refuse("is a number too large for a double")
        if math.isnan(number) or (math.isinf(number) and not infinite):
            self.refuse(f"is {number}", "", "give a finite number")
        return number

    def choice(self, known: Sequence[str]) -> str:
        """A text out of a few."""
        word = self.string()
        if word not in known:
            self.refuse(f"'{word}' is none of {', '.join(known)}", "", did_you_mean(word, known))
        return word

    def name(self, known: Iterable[str], kind: str) -> str:
        """A text that names something declared, of this kind ('state')."""
        return self._declared(self.string(), known, kind)

    def by_name(self, known: Iterable[str], kind: str) -> dict[str, Node]:
        """The entries of a table whose keys name things declared."""
        names = list(known)
        entries = self.table()
        for key, entry in entries.items():
            entry._declared(key, names, kind)
        return entries

    def numbers(self, known: Iterable[str], kind: str) -> dict[str, float]:
        """A table of finite numbers by declared name."""
        return {name: entry.number() for name, entry in self.by_name(known, kind).items()}

    def _declared(self, word: str, known: Iterable[str], kind: str) -> str:
        names = list(known)
        if word not in names:
            self.refuse(f"there is no {kind} '{word}'", "", did_you_mean(word, names))
        return word


def read_text(path: str | os.PathLike[str]) -> str:
    """The UTF-8 text of a small file.  Raises InputError: missing, a folder, too large, not UTF-8."""
    file = FilePath(path)
    if file.is_dir():
        raise InputError(f"{path}: is a folder, not a file", remedies=("name a file in it",))
    try:
        if not file.exists():
            raise InputError(f"{path}: no such file", remedies=_neighbour(file))
        if not file.is_file():
            raise InputError(f"{path}: is not an ordinary file")
        size = file.stat().st_size
        if size > LARGEST:
            raise InputError(f"{path}: has {size} bytes", why=f"a plant file has {LARGEST} at most")
        data = file.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise InputError(f"{path}: cannot be read", why=reason) from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path}:{line}  byte {error.start} is 0x{data[error.start]:02x}, which is not UTF-8",
            remedies=("save the file as UTF-8",),
        ) from error


def _neighbour(file: FilePath) -> tuple[str, ...]:
    """A suggestion when a file of nearly the same name is beside the place asked for."""
    if not file.parent.is_dir():
        return (f"the folder {file.parent} does not exist",)
    suggestion = did_you_mean(file.name, sorted(other.name for other in file.parent.iterdir() if other.is_file()))
    return (suggestion,) if suggestion.startswith("did you mean") else ()


def document(text: str, source: str) -> Node:
    """The root of a TOML text.  Raises InputError with the line where it stops being TOML."""
    if len(text) > LARGEST:
        raise InputError(f"{source}: has {len(text)} characters", why=f"a plant file has {LARGEST} at most")
    try:
        return Node(Document(text, source), (), tomllib.loads(text))
    except RecursionError as error:
        raise InputError(f"{source}:1  is nested too deeply to be a plant") from error
    except ValueError as error:
        found = re.search(r"line (\d+), column \d+\)$", str(error))
        line = int(found[1]) if found else text.count("\n") + 1
        fact = re.sub(r" \(at (line|end)[^()]*\)$", "", str(error))
        raise InputError(
            f"{source}:{line}  is not valid TOML",
            why=fact,
            remedies=("mend that line",),
            see="https://toml.io/en/v1.0.0",
        ) from error
