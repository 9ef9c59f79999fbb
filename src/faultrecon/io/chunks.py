# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of any length, a piece at a time: first a survey, then the samples.

What comes out is what `read_log` reads, to the last bit; the memory it takes does not depend on how long the file is.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.io.batches import BLOCK, Pieces
from faultrecon.io.logs import matched
from faultrecon.io.tables import elapsed, first_unlike, no_time, numbers, place, plain_column, time_kinds
from faultrecon.plant.signals import Signals

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
Samples = tuple[Array, Array, Array]
Span = Sequence[float]  # two of them: the least and the largest
PIECE = 65_536  # rows, some 10 MB of a table with twenty columns
SAMPLE = 1 << 16  # bytes at the beginning, in the middle and at the end that a recording is known by
DIGITS = 16  # bits of a number that one look through all intervals settles


@dataclass(frozen=True)
class Survey:
    """What is known of a recording before its samples are read: its times are finite and increase throughout.

    time, signals: the columns; rows; interval: the median one, s, None for a single row.  kind: which of
    `tables.time_kinds` text is to be read as, None for a column that is no text; since: where dates are counted from.
    spans: the least and the largest finite value of every signal that has one.
    """

    time: str
    signals: Mapping[str, str]
    rows: int
    interval: float | None
    kind: int | None
    since: int | None
    spans: Mapping[str, Span] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for a checkpoint."""
        spans = {name: list(ends) for name, ends in self.spans.items()}
        return asdict(self) | {"signals": dict(self.signals), "spans": spans}


def fingerprint(source: str) -> str:
    """What a recording is known by: its size, and a hash of its beginning, middle and end."""
    size = os.path.getsize(source)
    found = hashlib.sha256(str(size).encode("ascii"))
    with open(source, "rb") as file:
        for at in (0, size // 2, max(0, size - SAMPLE)):
            file.seek(at)
            found.update(file.read(SAMPLE))
    return found.hexdigest()


def columns_of(source: str, signals: Signals, mapping: Mapping[str, str] | None = None) -> dict[str, str]:
    """The column of every signal, and that of the time as "t".  Raises InputError that lists those missing."""
    wanted = dict.fromkeys((*signals.u.names, *signals.y.names))
    found = matched(source, Pieces(source).names, [*wanted], mapping or {})
    return {**found.by_signal, "t": found.time}


def survey(
    source: str,
    signals: Signals,
    mapping: Mapping[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
    as_it_came: bool = False,
) -> Survey:
    """One look through a recording.

    progress is told which part is done.  Raises InputError as `read_log` does: on columns that are not there, on cells
    that are no numbers, and on times that are absent or do not increase and values that are infinite, with the row;
    these two are let through where it is read as it came.
    """
    columns = columns_of(source, signals, mapping)
    time = columns.pop("t")
    refused: list[int] = []
    for kind in range(len(time_kinds())):
        try:
            with tempfile.TemporaryFile() as kept:
                rows, since, text, spans = _spill(source, time, columns, kind, kept, progress, as_it_came)
                interval = _median_interval(kept)
            return Survey(time, columns, rows, interval, kind if text else None, since, spans)
        except _OtherKindError as error:
            refused.append(error.row)
    row = max(refused)
    raise no_time(source, time, row, _cell(source, time, row))


def _seconds(
    source: str, column: str, values: Any, since: int | None, first: int, as_it_came: bool
) -> tuple[Array, int | None]:
    """Times in seconds and what they count from; NaN where there is none, if it is read as it came."""
    present = values.is_valid().to_numpy(zero_copy_only=False)
    if present.all() or not as_it_came:
        return elapsed(source, column, values, since, first)
    if not present.any():
        return np.full(len(values), np.nan), since
    t, since = elapsed(source, column, values.fill_null(values[int(np.argmax(present))]), since, first)
    return np.where(present, t, np.nan), since


class _OtherKindError(Exception):
    """The time in this row is text that does not read as the kind that was tried."""

    def __init__(self, row: int) -> None:
        super().__init__(row)
        self.row = row


def _spill(
    source: str,
    column: str,
    signals: Mapping[str, str],
    kind: int,
    into: IO[bytes],
    progress: Callable[[float], None] | None,
    as_it_came: bool,
) -> tuple[int, int | None, bool, dict[str, Span]]:
    """Write all times to a file, 8 bytes each, and look that they increase; their number, their origin, if text.

    Also the spans of the signals, whose columns are given.
    """
    rows, since, text, last, spans = 0, None, False, -np.inf, dict[str, Span]()
    table, read = Pieces(source), numbers if as_it_came else _signal
    for piece in table.read(list(dict.fromkeys((column, *signals.values())))):
        values = plain_column(piece.column(column))
        values, text = _as_kind(values, kind, rows)
        t, since = _seconds(source, column, values, since, rows, as_it_came)
        wrong = ~np.isfinite(t) | ~(t > np.append(last, t[:-1]))
        if wrong.any() and not as_it_came:
            k = int(np.argmax(wrong))
            before = last if k == 0 else t[k - 1]
            raise _not_later(source, column, rows + k, float(t[k]), float(before))
        into.write(t.tobytes())
        for name, own in signals.items():
            _widen(spans, name, read(source, piece, own, rows))
        rows, last = rows + len(t), t[-1]
        if progress is not None:
            progress(table.done())
    if not rows:
        raise InputError(
            f"{source}: is empty", why="it has a header and no rows", remedies=("record at least one sample",)
        )
    return rows, since, text, spans


def _widen(spans: dict[str, Span], name: str, values: Array) -> None:
    """A span with further values in it."""
    known = values[np.isfinite(values)]
    if known.size:
        low, high = spans.get(name, (np.inf, -np.inf))
        spans[name] = min(low, float(known.min())), max(high, float(known.max()))


def _as_kind(values: Any, kind: int, first: int) -> tuple[Any, bool]:
    """Text as times of this kind, all else as it is; and whether it was text."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if not pa.types.is_string(values.type):
        return values, False
    text = pc.call_function("utf8_trim_whitespace", [values])
    try:
        return pc.cast(text, time_kinds()[kind]), True
    except pa.ArrowInvalid as error:
        raise _OtherKindError(first + first_unlike(text, time_kinds()[kind])) from error


def _not_later(source: str, column: str, row: int, t: float, before: float) -> InputError:
    cell = _cell(source, column, row)
    if not np.isfinite(t):
        return InputError(
            f"{place(source, column, row)} has the time {cell}", remedies=("give every row a finite time",)
        )
    earlier = _cell(source, column, row - 1)
    return InputError(
        f"{place(source, column, row)} " + (f"repeats {earlier}" if t == before else f"has {cell} after {earlier}"),
        why="times must increase from row to row",
        remedies=("sort the rows by time and keep one row per time",),
    )


def _cell(source: str, column: str, row: int) -> str | None:
    """One cell as text, for messages."""
    import pyarrow as pa
    import pyarrow.compute as pc

    for piece in Pieces(source).read([column]):
        if row < piece.num_rows:
            return pc.cast(piece.column(column)[row], pa.string()).as_py()
        row -= piece.num_rows
    return None


# ---------------------------------------------------------------- samples


def samples(
    source: str, signals: Signals, found: Survey, first: int = 0, rows: int = PIECE, as_it_came: bool = False
) -> Iterator[Samples]:
    """The samples from row `first` on, `rows` at a time: t (N,), u (N, m), y (N, p), NaN where a value is missing.

    Raises InputError on cells that are no numbers, with the row, and on infinite ones unless it is read as it came.
    """
    return _cut(_read(source, signals, found, first, as_it_came), rows)


def _read(source: str, signals: Signals, found: Survey, at: int, as_it_came: bool) -> Iterator[Samples]:
    names = list(dict.fromkeys((found.time, *found.signals.values())))
    reader = numbers if as_it_came else _signal
    for piece in Pieces(source).read(names, at):
        values = plain_column(piece.column(found.time))
        values = values if found.kind is None else _as_kind(values, found.kind, at)[0]
        t, _ = _seconds(source, found.time, values, found.since, at, as_it_came)
        read = {column: reader(source, piece, column, at) for column in dict.fromkeys(found.signals.values())}
        u, y = (
            np.array([read[found.signals[name]] for name in group]).reshape(len(group), len(t)).T
            for group in (signals.u.names, signals.y.names)
        )
        yield t, u, y
        at += len(t)


def _signal(source: str, piece: pa.Table, column: str, first: int) -> Array:
    values = numbers(source, piece, column, first)
    infinite = np.isinf(values)
    if infinite.any():
        row = int(np.argmax(infinite))
        raise InputError(
            f"{place(source, column, first + row)} is {values[row]}",
            remedies=("leave the cell empty where there is no measurement",),
        )
    return values


def _cut(read: Iterator[Samples], rows: int) -> Iterator[Samples]:
    """The same samples, so many rows at a time; where they were cut before does not show."""
    waiting: list[Samples] = []
    number = 0
    for samples in read:
        waiting.append(samples)
        number += len(samples[0])
        if number >= rows:
            t, u, y = _joined(waiting)
            whole = number - number % rows
            for k in range(0, whole, rows):
                yield t[k : k + rows], u[k : k + rows], y[k : k + rows]
            waiting, number = [(t[whole:], u[whole:], y[whole:])], number - whole
    if number:
        yield _joined(waiting)


def _joined(waiting: list[Samples]) -> Samples:
    """Columns stay in one piece in memory, as they were read."""
    t, u, y = zip(*waiting, strict=True)
    return np.concatenate(t), np.concatenate([a.T for a in u], axis=1).T, np.concatenate([a.T for a in y], axis=1).T


# ---------------------------------------------------------------- the median of any number of intervals


def _median_interval(times: IO[bytes]) -> float | None:
    """The median of the differences of times that lie in a file, as numpy has it; None where there is none.

    Those that do not go forward, in a recording that is read as it came, do not count.
    """
    n = sum(len(steps) for steps in _intervals(times))
    if n < 1:
        return None
    middle = [_ranked(times, rank) for rank in sorted({(n - 1) // 2, n // 2})]
    with np.errstate(over="ignore"):  # two finite times may be infinitely far apart
        return float(np.mean(middle))


def _ranked(times: IO[bytes], rank: int) -> float:
    """The interval before which `rank` smaller ones lie: its bits, some at a time from the first on, by counting."""
    known, prefix = 0, 0
    while known < 64:
        digits = min(DIGITS, 64 - known)
        counts = np.zeros(1 << digits, dtype=np.int64)
        for steps in _intervals(times):
            keys = steps.view(np.uint64)  # positive numbers are in the order of their bits
            if known:
                keys = keys[keys >> np.uint64(64 - known) == np.uint64(prefix)]
            part = (keys >> np.uint64(64 - known - digits)) & np.uint64((1 << digits) - 1)
            counts += np.bincount(part.astype(np.intp), minlength=1 << digits)
        below = np.cumsum(counts)
        digit = int(np.searchsorted(below, rank, side="right"))
        rank -= int(below[digit - 1]) if digit else 0
        known, prefix = known + digits, (prefix << digits) | digit
    return float(np.array(prefix, dtype=np.uint64).view(np.float64))


def _intervals(times: IO[bytes]) -> Iterator[Array]:
    times.seek(0)
    last = np.empty(0)
    while block := times.read(BLOCK):
        t = np.concatenate((last, np.frombuffer(block)))
        t = t[np.isfinite(t)]
        with np.errstate(over="ignore"):
            steps = np.diff(t)
        yield steps[steps > 0]
        last = t[-1:]
