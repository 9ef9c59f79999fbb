# SPDX-License-Identifier: BSD-3-Clause
"""A table that grows on disk while it is made, and becomes a .csv or .parquet file when it is complete.

Until then its rows are in a working file beside it, NAME.part, to which rows are only ever appended: cut at a length
that was once safe on disk, it holds the rows it held then.  The file itself appears whole or not at all.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError
from faultrecon.io.tables import name_extension
from faultrecon.storage.atomic import replacing
from faultrecon.storage.checkpoint import settle_folder

if TYPE_CHECKING:
    import pyarrow as pa


def working_file(out: str | os.PathLike[str]) -> Path:
    """Where the rows are until all of them are there."""
    return Path(f"{os.fspath(out)}.part")


class Appending:
    """The rows of `out` so far.  CSV text as it will stand; for Parquet, a stream of record batches in Arrow's format.

    length: bytes that are safe on disk.  Raises InputError when the file cannot be written, or is shorter than that.
    """

    def __init__(self, out: str | os.PathLike[str], length: int = 0) -> None:
        self.out = Path(out)
        self._csv = name_extension(str(out)) == ".csv"
        self._work = working_file(out)
        try:
            self._file = open(self._work, "r+b" if length else "w+b")  # noqa: SIM115 - it stays open between calls
            present = self._file.seek(0, os.SEEK_END)
            self._file.truncate(length)
            self._file.seek(length)
        except OSError as error:
            raise self._unwritable(error) from error
        if present < length:
            raise InputError(
                f"{self._work}: has {present} bytes",
                why=f"the checkpoint knows of {length}",
                remedies=("delete the checkpoint and begin anew",),
            )
        self.length = length

    def append(self, columns: Mapping[str, ArrayLike]) -> None:
        """These rows at the end; the columns are the same every time."""
        import pyarrow as pa

        batch = pa.record_batch({name: _arrow(np.asarray(values)) for name, values in columns.items()})
        try:
            self._file.write(self._text(batch) if self._csv else self._message(batch))
        except (pa.ArrowException, OSError) as error:
            raise self._unwritable(error) from error

    def settle(self) -> int:
        """Bring everything to the disk; the length of the working file."""
        try:
            self._file.flush()
            os.fsync(self._file.fileno())
            self.length = self._file.tell()
        except OSError as error:
            raise self._unwritable(error) from error
        return self.length

    def complete(self) -> None:
        """All rows are there: make the file of them, and remove the working file."""
        import pyarrow as pa

        self.settle()
        self._file.close()
        try:
            if self._csv:
                os.replace(self._work, self.out)
            else:
                self._as_parquet()
                self._work.unlink()
            settle_folder(self.out.parent)
        except (pa.ArrowException, OSError) as error:
            raise self._unwritable(error) from error

    def close(self) -> None:
        """Leave the working file as it is."""
        self._file.close()

    def abandon(self) -> None:
        """Nothing is to come of it."""
        self._file.close()
        self._work.unlink(missing_ok=True)

    def _text(self, batch: pa.RecordBatch) -> Any:
        import pyarrow as pa
        from pyarrow import csv

        into = pa.BufferOutputStream()
        csv.write_csv(batch, into, csv.WriteOptions(include_header=self._file.tell() == 0))
        return into.getvalue()

    def _message(self, batch: pa.RecordBatch) -> Any:
        if self._file.tell() == 0:
            self._file.write(batch.schema.serialize())
        return batch.serialize()

    def _as_parquet(self) -> None:
        """The stream as Parquet, a row group per piece; floats hardly repeat, so they get no dictionary."""
        import pyarrow as pa
        from pyarrow import ipc, parquet

        with pa.OSFile(str(self._work)) as file, replacing(self.out) as temporary:
            stream = ipc.open_stream(file)
            repeating: Any = [f.name for f in stream.schema if not pa.types.is_floating(f.type)]
            with parquet.ParquetWriter(temporary, stream.schema, use_dictionary=repeating) as writer:
                for batch in stream:
                    writer.write_batch(batch, row_group_size=max(1, batch.num_rows))
            with open(temporary, "rb+") as written:
                os.fsync(written.fileno())

    def _unwritable(self, error: Exception) -> InputError:
        return InputError(f"{self._work}: cannot be written", why=str(getattr(error, "strerror", None) or error))


def _arrow(values: NDArray[Any]) -> pa.Array:
    """As Arrow has it; words are mostly all the same, which is quicker said once."""
    import pyarrow as pa

    if values.dtype.kind == "U" and len(values) and np.all(values == values[0]):
        return pa.repeat(str(values[0]), len(values))
    return pa.array(values)
