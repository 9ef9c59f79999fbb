# SPDX-License-Identifier: BSD-3-Clause
"""Recordings: a CSV or Parquet table with a time column and a column per signal, as arrays.

Tables stay columnar from the file to the arrays; nothing here loops over rows.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError, did_you_mean
from faultrecon.io.tables import name_extension, numbers, place, read_table, seconds, shown
from faultrecon.plant.signals import Signals
from faultrecon.runtime.intake import Intake, Taken
from faultrecon.storage.atomic import replacing

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
TIMES = ("t", "time")
TIME_LIKE = re.compile(r"(t|tim|time|times|timestamp|zeit|date|datetime|sec|secs|seconds)([^a-z].*)?", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Log:
    """One recording: N samples of m inputs and p measurements, absolute values in the plant's units.

    t: (N,) seconds, strictly increasing unless it was read as it came; u: (N, m), y: (N, p), NaN where a value is
    missing.  extra: other numeric columns, (N,) each, such as the true fault of a simulated recording; ignored: the
    columns that hold no numbers.
    start: the instant of the first row when the file gives dates.  missing: how many values are absent, by signal.
    """

    t: Array
    u: Array
    y: Array
    extra: Mapping[str, Array] = field(default_factory=dict)
    time_name: str = "t"
    source: str = ""
    start: datetime | None = None
    ignored: tuple[str, ...] = ()
    missing: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for array in (self.t, self.u, self.y, *self.extra.values()):
            array.setflags(write=False)
        object.__setattr__(self, "extra", MappingProxyType(dict(self.extra)))
        object.__setattr__(self, "missing", MappingProxyType(dict(self.missing)))

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        span = f"{self.t[0]:g} to {self.t[-1]:g} s" if len(self) else "no time"
        absent = sum(self.missing.values())
        return (
            f"Log({self.source!r}: {len(self)} samples, {span}; {self.u.shape[1]} inputs, {self.y.shape[1]} sensors, "
            f"{absent} values missing; extra: {', '.join(self.extra) or 'none'})"
        )


def read_log(
    path: str | os.PathLike[str],
    signals: Signals,
    *,
    mapping: Mapping[str, str] | None = None,
    as_it_came: bool = False,
) -> Log:
    """The recording in a .csv or .parquet file, its columns matched to the plant's signals by name.

    mapping: column by signal name, where they differ; 't' may be mapped too.  Times are seconds as they stand, or dates
    (ISO 8601 text or timestamps), then seconds from the first row.  Raises InputError naming file, column and row.

    as_it_came: times may repeat, go back or be absent (NaN) and values be infinite, for an `Intake` to deal with; see
    `orderly`.  Otherwise they are refused.
    """
    source = os.fspath(path)
    wanted = (*signals.u.names, *signals.y.names)
    table = read_table(source)
    columns = matched(source, table.column_names, wanted, mapping or {})
    if table.num_rows == 0:
        raise InputError(
            f"{source}: is empty", why="it has a header and no rows", remedies=("record at least one sample",)
        )
    t, start = (_arrivals if as_it_came else _times)(source, table, columns.time)
    read = numbers if as_it_came else _signal
    values = {name: read(source, table, columns.by_signal[name]) for name in dict.fromkeys(wanted)}
    used = {columns.time, *columns.by_signal.values()}
    extra, ignored = _others(table, [name for name in table.column_names if name not in used])
    ours = {f"{name}_{end}" for name in signals.y.names for end in ("ok", "corrected")}  # written by a run before
    ignored = tuple(name for name in ignored if name not in ours and not name.startswith(("f_", "true_f_")))
    missing = {name: int(np.isnan(v).sum()) for name, v in values.items()}
    return Log(
        t,
        _stacked(values, signals.u.names, len(t)),
        _stacked(values, signals.y.names, len(t)),
        extra,
        columns.time,
        source,
        start,
        ignored,
        {name: count for name, count in missing.items() if count},
    )


def orderly(log: Log, intake: Intake) -> tuple[Log, Taken]:
    """A log read as it came, made fit for an estimator, and what became of each row and value.

    Rows of the other columns are those that brought the time first.
    """
    taken = intake.whole(log.t, log.u, log.y)
    extra = {name: values[taken.arrival] for name, values in log.extra.items()}
    absent = np.isnan(np.hstack([taken.u, taken.y])).sum(axis=0).tolist()
    missing = {name: count for name, count in zip(intake.names, absent, strict=True) if count}
    return replace(log, t=taken.t, u=taken.u, y=taken.y, extra=extra, missing=missing), taken


def write_log(path: str | os.PathLike[str], columns: Mapping[str, ArrayLike]) -> None:
    """Write columns of equal length as .csv or .parquet, whole or not at all; floats keep every bit.

    Raises InputError on another extension, on columns of unequal length, and when the file cannot be written.
    """
    import pyarrow as pa
    from pyarrow import csv, parquet

    source = os.fspath(path)
    kind = name_extension(source)
    if not columns:
        raise InputError(f"{source}: there is no column to write")
    arrays = {str(name): np.asarray(values) for name, values in columns.items()}
    lengths = {name: len(a) for name, a in arrays.items() if a.ndim == 1}
    for name, array in arrays.items():
        if array.ndim != 1 or len(array) != next(iter(lengths.values())):
            raise InputError(
                f"{source}: the column '{name}' has shape {array.shape}",
                remedies=(f"give one value per row ({next(iter(lengths.values()), 0)} rows)",),
            )
    try:
        table = pa.table({name: pa.array(a) for name, a in arrays.items()})
        with replacing(path) as temporary:
            if kind == ".csv":
                csv.write_csv(table, temporary)
            else:
                repeating: Any = [
                    name for name, a in arrays.items() if _repeats(a)
                ]  # the stubs know a truth value only
                parquet.write_table(table, temporary, use_dictionary=repeating)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{source}: cannot be written", why=str(error)) from error


def _repeats(values: NDArray) -> bool:
    """Whether a dictionary of the values would make the column smaller; for others, trying takes half of the writing.

    Judged by a thousand values spread over the column.
    """
    if values.dtype.kind != "f":
        return True
    some = values[:: max(1, len(values) // 1000)]
    return 2 * np.unique(some).size < some.size


# ---------------------------------------------------------------- columns


@dataclass(frozen=True)
class Matched:
    """Which column is the time, and which is each signal."""

    time: str
    by_signal: Mapping[str, str]


def matched(source: str, present: Sequence[str], wanted: Sequence[str], mapping: Mapping[str, str]) -> Matched:
    """The column of every signal.  Raises InputError that lists all that are missing."""
    for name in mapping:
        if name not in wanted and name not in TIMES:
            raise InputError(
                f"the mapping names '{name}', which is no signal", remedies=(did_you_mean(name, [*wanted, "t"]),)
            )
    time = _time_column(source, present, mapping)
    by_signal = {name: mapping.get(name, name) for name in wanted}
    lost = [column for column in dict.fromkeys(by_signal.values()) if column not in present]
    if lost:
        spare = [name for name in present if name not in by_signal.values() and name != time]
        guesses = {name: _likely(name, spare) for name in lost}
        options = (f'--column {s}="{guesses[c] or "COLUMN"}"' for s, c in by_signal.items() if c in guesses)
        raise InputError(
            f"{source}: there is no column for {', '.join(lost)}",
            why=f"the columns are: {', '.join(present)}",
            remedies=(
                *(f"for {name}: did you mean '{guess}'?" for name, guess in guesses.items() if guess),
                f"map signals to columns with a mapping {{signal: column}}, on the command line {' '.join(options)}",
            ),
        )
    for column in (time, *by_signal.values()):
        if list(present).count(column) > 1:
            raise InputError(f"{source}: two columns are called '{column}'", remedies=("rename or remove one of them",))
    return Matched(time, by_signal)


def _time_column(source: str, present: Sequence[str], mapping: Mapping[str, str]) -> str:
    named = [mapping[name] for name in TIMES if name in mapping] or [name for name in TIMES if name in present]
    if len(named) > 1:
        raise InputError(
            f"{source}: both {' and '.join(named)} could be the time", remedies=("map 't' to one of them",)
        )
    if not named or named[0] not in present:
        guess = _likely(named[0], present) if named else next(filter(TIME_LIKE.fullmatch, present), "")
        raise InputError(
            f"{source}: there is no time column{f' {named[0]!r}' if named else ''}",
            why=f"the columns are: {', '.join(present)}",
            remedies=(
                *((f"did you mean '{guess}'?",) if guess else ()),
                f"call it t or time, or map 't' to it, on the command line --column t=\"{guess or 'COLUMN'}\"",
            ),
        )
    return named[0]


def _likely(name: str, present: Sequence[str]) -> str:
    """The column that probably holds a signal: spelt much like it, or with its name in it; '' when there is none."""
    plain = {re.sub(r"[^a-z0-9]", "", column.lower()): column for column in present}
    word = re.sub(r"[^a-z0-9]", "", name.lower())
    hint = did_you_mean(word, plain)
    close = next((c for p, c in plain.items() if hint == f"did you mean '{p}'?"), "")
    return close or next((c for p, c in plain.items() if len(word) > 2 and word in p), "")


def _signal(source: str, table: pa.Table, column: str) -> Array:
    values = numbers(source, table, column)
    infinite = np.isinf(values)
    if infinite.any():
        row = int(np.argmax(infinite))
        raise InputError(
            f"{place(source, column, row)} is {values[row]}",
            remedies=("leave the cell empty where there is no measurement",),
        )
    return values


def _others(table: pa.Table, names: Sequence[str]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """The further columns that hold numbers, and the names of those that do not."""
    extra: dict[str, Array] = {}
    ignored: list[str] = []
    for name in dict.fromkeys(names):
        try:
            if list(names).count(name) > 1:
                raise InputError(f"two columns are called '{name}'")
            extra[name] = numbers("", table, name)
        except InputError:
            ignored.append(name)
    return extra, tuple(ignored)


def _stacked(values: Mapping[str, Array], names: Sequence[str], rows: int) -> Array:
    """The columns side by side, (rows, k), each in one piece in memory, as it was read and as it will be written."""
    stacked = np.empty((len(names), rows))
    for into, name in zip(stacked, names, strict=True):
        into[:] = values[name]
    return stacked.T


def _times(source: str, table: pa.Table, column: str) -> tuple[Array, datetime | None]:
    """Seconds per row, and the first instant when they are dates.  Every time comes after the one before."""
    t, start = seconds(source, table, column)
    absent = ~np.isfinite(t)
    if absent.any():
        row = int(np.argmax(absent))
        raise InputError(
            f"{place(source, column, row)} has the time {shown(table, column, row)}",
            remedies=("give every row a finite time",),
        )
    step = np.diff(t)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 1
        before, here = (shown(table, column, i) for i in (row - 1, row))
        fact = f"repeats {before}" if step[row - 1] == 0 else f"has {here} after {before}"
        raise InputError(
            f"{place(source, column, row)} {fact}",
            why="times must increase from row to row",
            evidence={"rows": int((step <= 0).sum())},
            remedies=("sort the rows by time and keep one row per time",),
        )
    return t, start


def _arrivals(source: str, table: pa.Table, column: str) -> tuple[Array, datetime | None]:
    """Seconds per row as they stand, NaN where there is none; dates count from the first row that has one."""
    given = table.column(column)
    present = given.is_valid().to_numpy()
    if present.all() or not present.any():
        return seconds(source, table, column)
    # Another row's time stands in, so that a date that cannot be read is still found in its own row.
    filled = given.fill_null(given[int(np.argmax(present))])
    t, start = seconds(source, table.set_column(table.column_names.index(column), column, filled), column)
    return np.where(present, t, np.nan), start
