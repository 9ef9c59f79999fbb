# SPDX-License-Identifier: BSD-3-Clause
"""Where each value of a TOML text stands: a line number for every path of keys and array items.

`tomllib` gives values without places, so a second, simpler reader goes over a text that `tomllib` has already accepted.
"""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_right
from collections.abc import Mapping
from contextlib import suppress

Path = tuple[str | int, ...]

_TRIVIA = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_BLANK = re.compile(r"[ \t]*")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_STRING = re.compile(
    r'"""(?:[^\\]|\\.)*?"""(?:"{0,2})'  # up to two quotes may belong to the text before the closing three
    r"|'''.*?'''(?:'{0,2})"
    r'|"(?:[^"\\\n]|\\.)*"'
    r"|'[^'\n]*'",
    re.DOTALL,
)
_SCALAR = re.compile(r"[^,\]}#\r\n]+")


def positions(text: str) -> dict[Path, int]:
    """Line number (from 1) by path; what the scanner cannot follow is left out, its table is still there.

    ('fault', 1, 'name') is the key `name` of the second [[fault]], ('matrices', 'A', 0, 2) an entry of a matrix.
    """
    scanner = _Scanner(text)
    # Where it stops, the places found so far still serve: `line_of` falls back to the nearest one above.
    with suppress(LookupError, RecursionError, ValueError):
        scanner.document()
    return scanner.lines


def line_of(path: Path, lines: Mapping[Path, int]) -> int:
    """The line of a path, or of the closest thing around it; 1 when nothing around it is known."""
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path, 1)


def spelled(path: Path) -> str:
    """The path as people write it: 'fault[1].name', 'matrices.A[0][2]'."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += ("." if text else "") + (part if _BARE_KEY.fullmatch(part) else repr(part))
    return text


class _Scanner:
    """One pass over the text.  It may assume valid TOML; on anything else it stops with LookupError."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines: dict[Path, int] = {}
        self.latest: dict[Path, int] = {}  # index of the newest element of each array of tables
        self.breaks = [m.start() for m in re.finditer("\n", text)]

    def document(self) -> None:
        """Every header and every key = value of the file."""
        current: Path = ()
        self.skip(_TRIVIA)
        while self.at < len(self.text):
            if self.text[self.at] == "[":
                current = self.header()
            else:
                self.pair(current)
            self.skip(_TRIVIA)

    def header(self) -> Path:
        """[a.b] or [[a.b]]: the path that the keys below it hang on."""
        line = self.line()
        double = self.text.startswith("[[", self.at)
        self.at += 2 if double else 1
        path: Path = ()
        for key in self.key():
            path = self.element(path) + (key,)
            self.lines.setdefault(path, line)
        self.at += 2 if double else 1
        if double:
            self.latest[path] = self.latest.get(path, -1) + 1
        path = self.element(path)
        self.lines[path] = line
        return path

    def element(self, path: Path) -> Path:
        """The newest element, where the path is an array of tables."""
        return (*path, self.latest[path]) if path in self.latest else path

    def pair(self, table: Path) -> None:
        """key = value, the key dotted or not."""
        line = self.line()
        path = table
        for key in self.key():
            path = (*path, key)
            self.lines.setdefault(path, line)
        self.expect("=")
        self.skip(_BLANK)
        self.value(path)

    def key(self) -> list[str]:
        """The parts of a dotted key."""
        parts: list[str] = []
        while True:
            self.skip(_BLANK)
            if self.text[self.at] in "\"'":
                parts.append(tomllib.loads("key = " + self.take(_STRING))["key"])
            else:
                parts.append(self.take(_BARE_KEY))
            self.skip(_BLANK)
            if self.text[self.at] != ".":
                return parts
            self.at += 1

    def value(self, path: Path) -> None:
        """A value of any kind; arrays and inline tables record what is in them."""
        self.lines.setdefault(path, self.line())
        start = self.text[self.at]
        if start == "[":
            self.array(path)
        elif start == "{":
            self.inline(path)
        elif start in "\"'":
            self.take(_STRING)
        else:
            self.take(_SCALAR)

    def array(self, path: Path) -> None:
        """[a, b, ...] over any number of lines."""
        self.at += 1
        index = 0
        while not self.closes("]"):
            self.value((*path, index))
            index += 1

    def inline(self, path: Path) -> None:
        """{ a = 1, b = 2 }."""
        self.at += 1
        while not self.closes("}"):
            self.pair(path)

    def closes(self, bracket: str) -> bool:
        """Past a comma and blanks: is this the closing bracket?"""
        self.skip(_TRIVIA)
        if self.text[self.at] == ",":
            self.at += 1
            self.skip(_TRIVIA)
        if self.text[self.at] != bracket:
            return False
        self.at += 1
        return True

    def line(self) -> int:
        return bisect_right(self.breaks, self.at - 1) + 1

    def skip(self, pattern: re.Pattern[str]) -> None:
        match = pattern.match(self.text, self.at)
        self.at = match.end() if match else self.at

    def take(self, pattern: re.Pattern[str]) -> str:
        match = pattern.match(self.text, self.at)
        if match is None:
            raise LookupError(f"offset {self.at}")
        self.at = match.end()
        return match.group()

    def expect(self, character: str) -> None:
        if self.text[self.at] != character:
            raise LookupError(f"offset {self.at}")
        self.at += 1
