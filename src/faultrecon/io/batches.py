# SPDX-License-Identifier: BSD-3-Clause
"""CSV and Parquet files as tables a piece at a time: what `tables.read_table` reads, never all of it in memory."""

from __future__ import annotations

import csv as plain_csv
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from faultrecon.io.tables import ABSENT, csv_types, first_bytes, name_extension, unreadable_csv, unreadable_parquet

if TYPE_CHECKING:
    import pyarrow as pa

BLOCK = 1 << 20  # bytes that are parsed at a time
ROWS = 65_536  # of a Parquet file, at a time


class Pieces:
    """A file that is read a piece at a time."""

    def __init__(self, source: str) -> None:
        self.source = source
        start = first_bytes(source)
        self._types = csv_types(source, start) if name_extension(source) == ".csv" else None
        self._part = 0.0

    @property
    def names(self) -> Sequence[str]:
        """The columns."""
        if self._types is not None:
            return [name.strip() for name in _header(self.source)]
        with self._parquet() as opened:
            return opened.schema_arrow.names

    def done(self) -> float:
        """Which part of the file has been read, 0 to 1."""
        return self._part

    def read(self, columns: Sequence[str], first: int = 0) -> Iterator[pa.Table]:
        """These columns from row `first` on, in tables of any length above 0."""
        reader = self._read_parquet(columns, first) if self._types is None else self._read_csv(columns, first)
        for table in reader:
            if table.num_rows:
                yield table

    def _read_csv(self, columns: Sequence[str], first: int) -> Iterator[pa.Table]:
        """As numbers; from where a cell turns out to be none, as text, for `numbers` to say which."""
        import pyarrow as pa

        assert self._types is not None
        likely, text = self._types
        try:
            for table in self._csv(columns, likely, first):
                yield table
                first += table.num_rows
            return
        except (pa.ArrowException, OSError):
            pass
        try:
            yield from self._csv(columns, text, first)
        except (pa.ArrowException, OSError) as error:
            raise unreadable_csv(self.source, error) from error

    def _csv(self, columns: Sequence[str], types: Mapping[str, Any], first: int) -> Iterator[pa.Table]:
        import pyarrow as pa
        from pyarrow import csv

        raw = [name for name in types if name.strip() in columns]
        options = csv.ConvertOptions(
            column_types={name: types[name] for name in raw},
            include_columns=raw,
            null_values=ABSENT,
            strings_can_be_null=True,
        )
        size = os.path.getsize(self.source)
        with pa.OSFile(self.source) as file:
            for batch in csv.open_csv(file, csv.ReadOptions(block_size=BLOCK), convert_options=options):
                self._part = file.tell() / size
                kept = batch.slice(min(first, batch.num_rows))
                first -= batch.num_rows - kept.num_rows
                yield pa.Table.from_batches([kept]).rename_columns([name.strip() for name in raw])

    def _parquet(self) -> Any:
        import pyarrow as pa
        from pyarrow import parquet

        try:
            return parquet.ParquetFile(self.source, buffer_size=BLOCK, pre_buffer=False)
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            raise unreadable_parquet(self.source, error) from error

    def _read_parquet(self, columns: Sequence[str], first: int) -> Iterator[pa.Table]:
        import pyarrow as pa

        with self._parquet() as opened:
            about, read = opened.metadata, 0
            try:
                for group in range(about.num_row_groups):  # one at a time: all at once would stay in memory
                    number = about.row_group(group).num_rows
                    if first >= number:
                        first, read = first - number, read + number
                        continue
                    for batch in opened.iter_batches(ROWS, [group], list(columns)):
                        batch.validate(full=True)
                        read += batch.num_rows
                        self._part = read / about.num_rows
                        kept = batch.slice(min(first, batch.num_rows))
                        first -= batch.num_rows - kept.num_rows
                        yield pa.Table.from_batches([kept])
            except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
                raise unreadable_parquet(self.source, error) from error


def _header(source: str) -> list[str]:
    """The names in the header of a CSV file, each as often as it stands there."""
    with open(source, encoding="utf-8-sig", newline="") as opened:
        return next(row for row in plain_csv.reader(opened) if row)
