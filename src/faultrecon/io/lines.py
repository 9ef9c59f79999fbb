# SPDX-License-Identifier: BSD-3-Clause
"""One sample as a line of text, and one row of answers as another: JSON objects, or CSV after a header."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.io.logs import TIMES, matched
from faultrecon.io.tables import ABSENT
from faultrecon.plant.signals import Signals

LONGEST = 1 << 20  # bytes of a line; a thousand signals take some 20 kB
INPUT = "standard input"
FRACTION = re.compile(r"[.,](\d+)")
EPOCH = datetime.fromtimestamp(0, UTC)


class Malformed(Exception):
    """What is wrong with a line; seq: its own number, if it tells one."""

    def __init__(self, what: str, seq: int | None = None) -> None:
        super().__init__(what)
        self.seq = seq


@dataclass(frozen=True)
class Clock:
    """How a stream tells the time, once its first line has: "numbers", "dates", or "dates with an offset".

    since: what dates are counted from, in ns after 1970.
    """

    kind: str = ""
    since: int = 0

    def seconds(self, cell: Any) -> tuple[float, Clock]:
        """A time in seconds, and the clock from then on.  Raises Malformed."""
        kind, ns = "numbers", 0
        try:
            t = number(cell)
        except ValueError:
            kind, ns = _instant(cell)
            t = 0.0
        if not math.isfinite(t):
            raise Malformed("there is no time")
        if self.kind and kind != self.kind:
            raise Malformed(f"the time {cell!r:.60} is unlike those before")
        clock = self if self.kind else Clock(kind, ns)
        # Differences of whole ticks are exact; only the division rounds.
        return (t if kind == "numbers" else (ns - clock.since) / 1e9), clock


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample: t (1,), u (1, m), y (1, p); the line's own number, and the clock after it."""

    t: NDArray[np.float64]
    u: NDArray[np.float64]
    y: NDArray[np.float64]
    seq: int | None
    clock: Clock


class Form(Protocol):
    """How lines are read and answered."""

    def sample(self, line: bytes, clock: Clock) -> Sample:
        """The sample that a line holds.  Raises Malformed."""
        ...

    def row(self, seq: int, values: Sequence[Any]) -> str:
        """The line for one row of answers."""
        ...

    def complaint(self, seq: int | None, what: str) -> str:
        """The line that answers a malformed one."""
        ...


def form_of(
    line: bytes, wanted: str, signals: Signals, mapping: Mapping[str, str], columns: Sequence[str]
) -> tuple[Form, str | None]:
    """The form of a stream by its first line, and the header of the answers, if it has one.

    wanted: "json", "csv" or "auto".  Raises InputError on a header without the plant's signals.
    """
    if wanted not in ("auto", "json", "csv"):
        raise InputError(f"'{wanted}' is no format of a stream", remedies=("use json or csv",))
    if wanted == "json" or (wanted == "auto" and line.strip().startswith((b"{", b"\xef\xbb\xbf{"))):
        return _Json(signals, mapping, columns), None
    try:
        header = next(csv.reader([_text(line)]))
    except (Malformed, csv.Error) as error:
        raise InputError(
            f"{INPUT}: the first line is neither a JSON object nor a header",
            why=str(error),
            remedies=("begin with a line of column names",),
        ) from error
    form = _Csv([name.strip() for name in header], signals, mapping, columns)
    return form, form.header()


def number(cell: Any) -> float:
    """A cell as a number, NaN for one that says it is absent.  Raises ValueError on any other."""
    if cell is None:
        return math.nan
    if isinstance(cell, str):
        cell = cell.strip()
        if cell in ABSENT:
            return math.nan
        if "_" in cell:  # Python takes them for digit separators
            raise ValueError(cell)
    elif isinstance(cell, bool) or not isinstance(cell, int | float):
        raise ValueError(cell)
    try:
        return float(cell)
    except OverflowError:
        return math.inf if cell > 0 else -math.inf


def _instant(cell: Any) -> tuple[str, int]:
    """A date as ns after 1970.  Raises Malformed."""
    text = cell.strip() if isinstance(cell, str) else ""
    fraction = FRACTION.search(text)
    try:
        whole = datetime.fromisoformat(text[: fraction.start()] + text[fraction.end() :] if fraction else text)
    except ValueError:
        raise Malformed(f"the time {cell!r:.60} is neither a number nor an ISO 8601 date") from None
    kind = "dates" if whole.tzinfo is None else "dates with an offset"
    try:
        since = (whole if whole.tzinfo else whole.replace(tzinfo=UTC)) - EPOCH
    except OverflowError:
        raise Malformed(f"the time {cell!r:.60} is out of range") from None
    digits = fraction[1][:9].ljust(9, "0") if fraction else "0"
    return kind, since // timedelta(seconds=1) * 10**9 + int(digits)


def _text(line: bytes) -> str:
    try:
        return line.decode("utf-8-sig").strip("\r\n")
    except UnicodeDecodeError as error:
        raise Malformed(f"the byte 0x{line[error.start]:02x} is not UTF-8") from None


def _sample(cells: Mapping[str, Any], time: str, groups: tuple[Sequence[str], Sequence[str]], clock: Clock) -> Sample:
    """The sample in these cells; the columns of u and of y are in `groups`.  Raises Malformed."""
    seq = _own_number(cells.get("seq"))
    try:
        t, clock = clock.seconds(cells[time])
        values = []
        for group in groups:
            row = np.empty((1, len(group)))
            for k, name in enumerate(group):
                try:
                    row[0, k] = number(cells[name])
                except ValueError:
                    raise Malformed(f"{name} is {cells[name]!r:.60}, not a number") from None
            values.append(row)
    except KeyError as missing:
        raise Malformed(f"there is no {missing.args[0]}; null says that it was not measured", seq) from None
    except Malformed as wrong:
        raise Malformed(str(wrong), seq) from None
    return Sample(np.array([t]), values[0], values[1], seq, clock)


def _own_number(cell: Any) -> int | None:
    if isinstance(cell, str):
        cell = int(cell) if re.fullmatch(r"\s*\d{1,18}\s*", cell) else cell or None
    if cell is None:
        return None
    if isinstance(cell, bool) or not isinstance(cell, int) or not 0 <= cell < 2**63:
        raise Malformed(f"seq is {cell!r:.40}, not a whole number")
    return cell


class _Json:
    """A JSON object per line."""

    def __init__(self, signals: Signals, mapping: Mapping[str, str], columns: Sequence[str]) -> None:
        u, y = ([mapping.get(name, name) for name in group] for group in (signals.u.names, signals.y.names))
        self._groups = (u, y)
        self._times = [mapping[name] for name in TIMES if name in mapping] or list(TIMES)
        self._columns = columns

    def sample(self, line: bytes, clock: Clock) -> Sample:
        try:
            cells = json.loads(_text(line))
        except (ValueError, RecursionError) as error:
            raise Malformed(f"the line is no JSON: {error}"[:200]) from None
        if not isinstance(cells, dict):
            raise Malformed("the line is no JSON object")
        time = next((name for name in self._times if name in cells), self._times[0])
        return _sample(cells, time, self._groups, clock)

    def row(self, seq: int, values: Sequence[Any]) -> str:
        told = {name: _finite(value) for name, value in zip(self._columns, values, strict=True)}
        return json.dumps({"seq": seq, **told}, allow_nan=False) + "\n"

    def complaint(self, seq: int | None, what: str) -> str:
        return json.dumps({"seq": seq, "error": what}) + "\n"


def _finite(value: Any) -> Any:
    """JSON has no NaN: what is not known is null."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


class _Csv:
    """Comma-separated cells, a line per row, after a header.  Raises InputError where a signal has no column."""

    def __init__(
        self, present: Sequence[str], signals: Signals, mapping: Mapping[str, str], columns: Sequence[str]
    ) -> None:
        found = matched(INPUT, present, (*signals.u.names, *signals.y.names), mapping)
        u, y = ([found.by_signal[name] for name in group] for group in (signals.u.names, signals.y.names))
        self._groups, self._time, self._present, self._columns = (u, y), found.time, present, columns

    def header(self) -> str:
        """The header of the answers."""
        return _cells(["seq", *self._columns, "error"])

    def sample(self, line: bytes, clock: Clock) -> Sample:
        try:
            cells = next(csv.reader([_text(line)], strict=True))
        except (csv.Error, StopIteration) as error:
            raise Malformed(f"the line is no CSV: {error}") from None
        if len(cells) != len(self._present):
            raise Malformed(f"the line has {len(cells)} cells for {len(self._present)} columns")
        return _sample(dict(zip(self._present, cells, strict=True)), self._time, self._groups, clock)

    def row(self, seq: int, values: Sequence[Any]) -> str:
        return _cells([seq, *(_shown(value) for value in values), ""])

    def complaint(self, seq: int | None, what: str) -> str:
        return _cells([seq, *[""] * len(self._columns), what])


def _shown(value: Any) -> Any:
    return str(value).lower() if isinstance(value, bool) else repr(value) if isinstance(value, float) else value


def _cells(values: Sequence[Any]) -> str:
    into = io.StringIO()
    csv.writer(into, lineterminator="\n").writerow(values)
    return into.getvalue()
