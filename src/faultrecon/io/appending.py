# SPDX-License-Identifier: BSD-3-Clause
"""A table that grows on disk while it is made, and becomes a .csv or .parquet file when it is complete.

Until then its rows are in a working file beside it, NAME.part, to which rows are only ever appended: cut at a length
that was once safe on disk, it holds the rows it held then.  The file itself appears whole or not at all.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from faultrecon.finding import InputError
from faultrecon.io.tables import name_extension
from faultrecon.runtime.words import Words
from faultrecon.storage.atomic import replacing
from faultrecon.storage.checkpoint import settle_folder

if TYPE_CHECKING:
    import pyarrow as pa

SCHEMA = 2  # of the working file of a Parquet file; that of a CSV file is its text
WORDS = b"words"  # in the schema of the working file: those that the numbers of a column stand for


def working_file(out: str | os.PathLike[str]) -> Path:
    """Where the rows are until all of them are there."""
    return Path(f"{os.fspath(out)}.part")


def schema_of(out: str | os.PathLike[str] | None) -> int | None:
    """How the rows are kept until all of them are there, where that needs to be said."""
    return SCHEMA if out is not None and name_extension(str(out)) != ".csv" else None


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

    def append(self, columns: Mapping[str, ArrayLike | Words]) -> None:
        """These rows at the end; the columns are the same every time, and so are the words that `Words` choose from."""
        import pyarrow as pa

        try:
            self._file.write(self._text(columns) if self._csv else self._message(columns))
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

    def _text(self, columns: Mapping[str, ArrayLike | Words]) -> Any:
        import pyarrow as pa
        from pyarrow import csv

        batch, into = pa.record_batch({name: _told(each) for name, each in columns.items()}), pa.BufferOutputStream()
        csv.write_csv(batch, into, csv.WriteOptions(include_header=self._file.tell() == 0))
        return into.getvalue()

    def _message(self, columns: Mapping[str, ArrayLike | Words]) -> Any:
        """Rows as the working file has them: of words the numbers, and the words once, in the schema."""
        import pyarrow as pa

        arrays, fields = [], []
        for name, each in columns.items():
            arrays.append(pa.array(each.codes if isinstance(each, Words) else np.asarray(each)))
            words = {WORDS: json.dumps(each.words)} if isinstance(each, Words) else None
            fields.append(pa.field(name, arrays[-1].type, metadata=words))
        batch = pa.RecordBatch.from_arrays(arrays, schema=pa.schema(fields))
        if self._file.tell() == 0:
            self._file.write(batch.schema.serialize())
        return batch.serialize()

    def _as_parquet(self) -> None:
        """The stream as Parquet, a row group per piece; floats hardly repeat, so they get no dictionary.

        Words become text to whoever reads the file: that they were numbers is not stored.
        """
        import pyarrow as pa
        from pyarrow import ipc, parquet

        with pa.OSFile(str(self._work)) as file, replacing(self.out) as temporary:
            stream = ipc.open_stream(file)
            words = {f.name: pa.array(json.loads(f.metadata[WORDS])) for f in stream.schema if f.metadata}
            kinds = {f.name: pa.dictionary(f.type, pa.string()) if f.name in words else f.type for f in stream.schema}
            schema = pa.schema(kinds.items())
            repeating: Any = [name for name, kind in kinds.items() if not pa.types.is_floating(kind)]
            with parquet.ParquetWriter(temporary, schema, use_dictionary=repeating, store_schema=False) as writer:
                for batch in stream:
                    columns = [
                        pa.DictionaryArray.from_arrays(each, words[name]) if name in words else each
                        for name, each in zip(schema.names, batch.columns, strict=True)
                    ]
                    spelled = pa.RecordBatch.from_arrays(columns, schema=schema)
                    writer.write_batch(spelled, row_group_size=max(1, batch.num_rows))
            with open(temporary, "rb+") as written:
                os.fsync(written.fileno())

    def _unwritable(self, error: Exception) -> InputError:
        return InputError(f"{self._work}: cannot be written", why=str(getattr(error, "strerror", None) or error))


def _told(values: ArrayLike | Words) -> pa.Array:
    """As Arrow has it, words as text."""
    import pyarrow as pa

    return pa.array(values.words).take(pa.array(values.codes)) if isinstance(values, Words) else pa.array(values)
