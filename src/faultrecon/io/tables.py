# SPDX-License-Identifier: BSD-3-Clause
"""CSV and Parquet files as columns, and columns as numbers or times; every failure says where it is."""

from __future__ import annotations

import csv as plain_csv
import os
import re
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError, did_you_mean

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
EXTENSIONS = (".csv", ".parquet")
QUOTED = re.compile(r'"[^"]*"')
DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
# Words that recorders and spreadsheets write for a value that is not there.
ABSENT = ["", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "#N/A", "null", "NULL", "None", "none"]


def name_extension(source: str) -> str:
    """'.csv' or '.parquet'.  Raises InputError for any other."""
    extension = Path(source).suffix.lower()
    if extension not in EXTENSIONS:
        raise InputError(
            f"{source}: the extension is '{extension}'", remedies=(f"use {' or '.join(EXTENSIONS)} for a recording",)
        )
    return extension


def read_table(source: str) -> pa.Table:
    """The whole file as a table; the columns of a CSV file are text still, unless they all read as numbers."""
    start = first_bytes(source)
    return _parquet(source) if name_extension(source) == ".parquet" else _csv(source, start)


def first_bytes(source: str) -> bytes:
    """How the file begins, 4 kB of it.  Raises InputError where there is no such file, or nothing in it."""
    file = Path(source)
    name_extension(source)
    try:
        if file.is_dir():
            raise InputError(f"{source}: is a folder, not a file", remedies=("name a file in it",))
        if not file.exists():
            raise InputError(f"{source}: no such file", remedies=_neighbour(file))
        if not file.is_file():
            raise InputError(f"{source}: is not an ordinary file")
        if file.stat().st_size == 0:
            raise InputError(
                f"{source}: is empty", why="the file has 0 bytes", remedies=("record at least one sample",)
            )
        with file.open("rb") as opened:
            return opened.read(4096)
    except OSError as error:
        raise InputError(f"{source}: cannot be read", why=error.strerror or str(error)) from error


def _neighbour(file: Path) -> tuple[str, ...]:
    if not file.parent.is_dir():
        return (f"the folder {file.parent} does not exist",)
    hint = did_you_mean(file.name, sorted(n for n in os.listdir(file.parent) if n.lower().endswith(EXTENSIONS)))
    return (hint,) if hint.startswith("did you mean") else ("check the path",)


def _parquet(source: str) -> pa.Table:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(source) as opened:
            table = opened.read()
        table.validate(full=True)  # text that is not UTF-8 would only be met later, without its file
        return table
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        raise unreadable_parquet(source, error) from error


def unreadable_parquet(source: str, error: Exception) -> InputError:
    """The complaint about a file that is no Parquet."""
    return InputError(
        f"{source}: cannot be read as Parquet, the file is truncated, damaged or of another kind",
        why=_first_line(error),
        remedies=("copy the file again from where it was recorded",),
    )


def _csv(source: str, start: bytes) -> pa.Table:
    import pyarrow as pa
    from pyarrow import csv

    likely, text = csv_types(source, start)
    for types in (likely, text):
        options = csv.ConvertOptions(column_types=types, null_values=ABSENT, strings_can_be_null=True)
        try:
            table = csv.read_csv(source, convert_options=options)
            return table.rename_columns([name.strip() for name in table.column_names])
        except (pa.ArrowException, OSError) as error:
            problem = error
    raise unreadable_csv(source, problem) from problem


def csv_types(source: str, start: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
    """Two ways to read a CSV file: the type of each column, by the name in the header.

    Columns that begin with a number are read as numbers at once.  Where a later cell is none, all is read again as
    text, slower, so that `numbers` can say which cell it is.  Raises InputError on what is no CSV text.
    """
    import pyarrow as pa

    names, first = _head(source, start)
    _refuse_other_separators(source)
    cells = dict(zip(names, first, strict=True))
    likely = {name: pa.float64() if _reads_as_number(cell) else pa.string() for name, cell in cells.items()}
    return likely, dict.fromkeys(names, pa.string())


def _reads_as_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return cell.strip() in ABSENT
    return True


def _head(source: str, start: bytes) -> tuple[list[str], list[str]]:
    """The column names and the first row, padded to as many cells.  Raises InputError on what is no UTF-8 text."""
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{source}:1  is UTF-16 text", remedies=("save the file as CSV in UTF-8",))
    if start.startswith(b"PAR1"):
        raise InputError(f"{source}: is a Parquet file", remedies=("rename it to .parquet",))
    if b"\x00" in start:
        raise InputError(f"{source}: is binary, not CSV text", remedies=("export the recording as CSV in UTF-8",))
    try:
        with open(source, encoding="utf-8-sig", newline="") as opened:
            rows = (row for row in plain_csv.reader(opened) if row)
            names = next(rows)
            first = next(rows, [])
            return names, [*first, *[""] * len(names)][: len(names)]
    except UnicodeDecodeError as error:
        raise (_bad_byte(source) or unreadable_csv(source, error)) from error
    except (StopIteration, plain_csv.Error, OSError) as error:
        raise InputError(f"{source}:1  has no header", remedies=("begin with a line of column names",)) from error


def _refuse_other_separators(source: str) -> None:
    """Raises InputError where the header has more cells by semicolons or tabs than by commas."""
    with open(source, encoding="utf-8-sig", errors="replace") as opened:
        lines = [line.rstrip("\r\n") for line in islice(filter(str.strip, opened), 2)]
    head = QUOTED.sub("", lines[0]) if lines else ""
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if head.count(mark) > head.count(","):
            decimal = any(DECIMAL_COMMA.fullmatch(cell.strip(' "')) for line in lines[1:] for cell in line.split(mark))
            raise InputError(
                f"{source}: is separated by {name}{' with decimal commas' if decimal else ''}",
                why="as spreadsheets write it where a comma is the decimal point" if decimal else "",
                remedies=("save it as comma-delimited CSV with decimal points",),
            )


def place(source: str, column: str, row: int) -> str:
    """Where a cell is, for messages: the line of a CSV file, the row of any other; rows count from 0."""
    if source.lower().endswith(".csv"):
        with suppress(OSError, ValueError, plain_csv.Error), open(source, encoding="utf-8-sig", newline="") as opened:
            reader = plain_csv.reader(opened)
            line, at = 1, -2
            for cells in reader:
                at += bool(cells)
                if at == row:
                    return f"{source}:{line}  column {column}"
                line = reader.line_num + 1  # a quoted cell may span lines: the record begins here
    return f"{source}: column {column}, row {row + 1}"


def _bad_byte(source: str) -> InputError | None:
    """The complaint about the first byte that is not UTF-8, if there is one."""
    with open(source, "rb") as opened:
        for line, raw in enumerate(opened, start=1):
            try:
                raw.decode("utf-8")
            except UnicodeDecodeError as bad:
                return InputError(
                    f"{source}:{line}  has a byte 0x{raw[bad.start]:02x}, which is not UTF-8",
                    remedies=("save the file as UTF-8",),
                )
    return None


def unreadable_csv(source: str, error: Exception) -> InputError:
    """The complaint about a table that does not hang together, with its row where a slow second look finds it."""
    import pyarrow as pa
    from pyarrow import csv

    not_text = _bad_byte(source)
    if not_text is not None:
        return not_text
    found: list[Any] = []

    def note(row: Any) -> str:
        found.append(row)
        return "error"

    with suppress(pa.ArrowException, OSError):  # that it fails is known: the row is what is wanted
        csv.read_csv(
            source,
            read_options=csv.ReadOptions(use_threads=False),
            parse_options=csv.ParseOptions(invalid_row_handler=note),
        )
    remedy = "give every row one cell per column"
    if found and found[0].number is not None:
        row = found[0]
        return InputError(
            f"{source}:{row.number}  has {row.actual_columns} cells for {row.expected_columns} columns",
            why=f"the line is {row.text[:60]!r}",
            remedies=(remedy,),
        )
    return InputError(f"{source}: cannot be read as CSV", why=_first_line(error), remedies=(remedy,))


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


# ---------------------------------------------------------------- columns


def numbers(source: str, table: pa.Table, column: str, first: int = 0) -> Array:
    """A column as (N,) floats, NaN where a cell is empty.  Raises InputError with the first cell that is no number.

    first: which row of the file the table begins with.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    values = plain_column(table.column(column))
    kind = values.type
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        values = _spelled(source, column, values, first)
    elif not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)):
        if not (pa.types.is_boolean(kind) or pa.types.is_null(kind)):
            raise InputError(
                f"{source}: column {column} holds {kind}, not numbers", remedies=("give numbers in the plant's units",)
            )
        values = pc.cast(values, pa.int8())
    # An integer beyond 2^53 is rounded, as everywhere in double precision.
    floats = pc.cast(values, pa.float64(), safe=False)
    return np.array(floats.fill_null(float("nan")).to_numpy(), dtype=np.float64)


def plain_column(values: Any) -> Any:
    """The column without dictionary encoding, text of any width as ordinary text."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_dictionary(values.type):
        values = pc.cast(values, values.type.value_type)
    return pc.cast(values, pa.string()) if str(values.type) in ("string_view", "large_string") else values


def _spelled(source: str, column: str, values: Any, first: int) -> Any:
    """Text as numbers; a cell that says it is absent is null."""
    import pyarrow as pa
    import pyarrow.compute as pc

    text = pc.call_function("utf8_trim_whitespace", [values])
    absent = pc.call_function("is_in", [text], pc.SetLookupOptions(value_set=pa.array(ABSENT)))
    text = pc.call_function("if_else", [absent, pa.scalar(None, pa.string()), text])
    try:
        return pc.cast(text, pa.float64())
    except pa.ArrowInvalid as error:
        row = first_unlike(text, pa.float64())
        raise InputError(
            f"{place(source, column, first + row)} is {text[row].as_py()!r:.60}, not a number",
            remedies=("correct the cell, or leave it empty where there is no value",),
        ) from error


def first_unlike(text: Any, kind: Any) -> int:
    """The first row that does not read as this kind of value, by halving."""
    import pyarrow as pa
    import pyarrow.compute as pc

    low, high = 0, len(text)
    while high - low > 1:
        middle = (low + high) // 2
        try:
            pc.cast(text[low:middle], kind)
            low = middle
        except pa.ArrowInvalid:
            high = middle
    return low


# ---------------------------------------------------------------- times


def seconds(source: str, table: pa.Table, column: str) -> tuple[Array, datetime | None]:
    """A time column in seconds: numbers as they stand, dates from the first row, whose date comes second."""
    import pyarrow as pa

    values = plain_column(table.column(column))
    if pa.types.is_string(values.type):
        values = _instants(source, column, values)
    t, since = elapsed(source, column, values)
    if since is None:
        return t, None
    return t, _date(source, column, values.type, since)


def elapsed(
    source: str, column: str, values: Any, since: int | None = None, first: int = 0
) -> tuple[Array, int | None]:
    """Times in seconds: numbers as they stand; dates from `since`, in ticks of their unit, or from their first.

    The instant they count from comes second, None for numbers.  first: which row of the file the values begin with.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_date(values.type):
        values = pc.cast(values, pa.timestamp("s"))
    if not pa.types.is_timestamp(values.type):
        return numbers(source, pa.table({column: values}), column, first), None
    absent = values.is_null().to_numpy(zero_copy_only=False)
    if absent.any():
        row = first + int(np.argmax(absent))
        raise InputError(f"{place(source, column, row)} has no time", remedies=("give every row a time",))
    ticks = pc.cast(values, pa.int64()).to_numpy()
    since = int(ticks[0]) if since is None else since
    # Differences of whole ticks are exact; only the division rounds.
    return (ticks - since) / float(PER_SECOND[values.type.unit]), since


def _date(source: str, column: str, kind: Any, since: int) -> datetime:
    """The instant that many ticks after 1970; kind: Arrow's type of the column."""
    unit, zone = ("s", None) if str(kind).startswith("date") else (kind.unit, kind.tz)
    try:
        start = datetime.fromtimestamp(0, UTC) + timedelta(microseconds=since * 10**6 // PER_SECOND[unit])
    except OverflowError as error:
        raise InputError(
            f"{place(source, column, 0)} is {since} {unit} after 1970",
            why="that is no date",
            remedies=("give seconds or dates",),
        ) from error
    return start if zone else start.replace(tzinfo=None)


def time_kinds() -> list[Any]:
    """What a column of text may mean as times, the first that fits all of it: numbers, dates, dates with offsets.

    Nanoseconds reach from 1678 to 2262; microseconds serve the clocks that were never set.
    """
    import pyarrow as pa

    return [pa.float64(), *(pa.timestamp(unit, zone) for unit in ("ns", "us") for zone in (None, "UTC"))]


def _instants(source: str, column: str, values: Any) -> Any:
    """Text that is numbers, or ISO 8601 dates with or without an offset; the rest is refused with its row."""
    import pyarrow as pa
    import pyarrow.compute as pc

    text = pc.call_function("utf8_trim_whitespace", [values])
    kinds = time_kinds()
    for kind in kinds:
        with suppress(pa.ArrowInvalid):
            return pc.cast(text, kind)
    row = max(first_unlike(text, kind) for kind in kinds)
    raise no_time(source, column, row, text[row].as_py())


def no_time(source: str, column: str, row: int, text: str | None) -> InputError:
    """The complaint about a cell that is no time, or none like those before it."""
    return InputError(
        f"{place(source, column, row)} is {text!r:.60}, not {'a time like those above' if row else 'a time'}",
        remedies=("give seconds, or ISO 8601 times such as 2026-03-01T12:00:00.020Z, in every row",),
    )


def shown(table: pa.Table, column: str, row: int) -> str:
    """A cell as text, for messages."""
    import pyarrow as pa
    import pyarrow.compute as pc

    return str(pc.cast(table.column(column)[row], pa.string()).as_py())
