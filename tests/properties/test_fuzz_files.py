# SPDX-License-Identifier: BSD-3-Clause
"""Mutated rows in files: each is counted or refused by its number, whole and in pieces alike, and the counts add up.

For longer: `test_fuzz_streams` as a script.
"""

import re
import time
from collections import Counter

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from pyarrow import parquet
from test_fuzz_streams import BANKS, NAMES, PATIENCE, SEEDS, TOO_FAR, cart, healthy, jump, one_of, processor

from faultrecon.finding import InputError
from faultrecon.io.logs import read_log
from faultrecon.io.plausibility import unit_doubts, unit_doubts_of
from faultrecon.io.running import run_file
from faultrecon.io.watched import median_interval, watched
from faultrecon.runtime.supervision import whole

ROWS = 1000  # of one file

CELLS = [
    "NaN",
    "nan",
    "NA",
    "N/A",
    "",
    "null",
    "inf",
    "-inf",
    "Infinity",
    "1e308",
    "-1e308",
    "1e400",
    "5e-324",
    "-0",
    "+1.5",
]
BROKEN = ["abc", "1,5", "😀", "\x00", '"', "true", "1_0", "0x1", "{}", "'1'", "2026-03-01", "1 2"]


def table_of(rng, rows):
    """Rows as lists of texts, each mutated in value, time or place, none so that its file could not be read."""
    out = []
    for row in healthy(rng, rows).tolist():
        cells = [repr(value) for value in row]
        kind, k = int(rng.integers(8)), int(rng.integers(1, len(cells)))
        if kind == 0:
            cells[k] = one_of(rng, CELLS)
        elif kind == 1:
            cells[k] = repr(float(rng.normal()) * 10.0 ** int(rng.integers(-300, 300)))
        elif kind == 2:
            cells[0] = repr(row[0] + jump(rng, 4))
        elif kind == 3:
            cells[0] = one_of(rng, ["", "NaN", "inf", "-inf", "0", "-5.0", repr(row[0] / 2)])
        elif kind == 4:
            cells[1:] = [""] * (len(cells) - 1)
        elif kind == 5:
            out.append(list(cells))
        elif kind == 6:
            out.insert(max(0, len(out) - int(rng.integers(0, 9))), cells)
            continue
        else:
            cells[k] = f'" {cells[k]} "' if rng.random() < 0.3 else cells[k - 1]
        out.append(cells)
    return out[:rows]


def spoilt(table, rng):
    """A few things that a file may not hold; now and then nothing."""
    for _ in range(int(rng.choice([0, 0, 0, 1, 2]))):
        k = int(rng.integers(len(table)))
        kind = int(rng.integers(4))
        if kind == 0:
            table[k][int(rng.integers(len(table[k])))] = one_of(rng, BROKEN)
        elif kind == 1:
            table[k] = table[k][: int(rng.integers(1, len(table[k])))]
        elif kind == 2:
            table[k] = [*table[k], "1.0"]
        else:
            table[k][0] = one_of(rng, ["1e300", "1.7e308", "-1.7e308", "1e9", "2026-03-01T00:00:00", "noon"])
    return table


def write_csv(table, path, rng):
    end = one_of(rng, ["\n", "\r\n"])
    text = end.join([",".join(NAMES), *(",".join(cells) for cells in table)])
    path.write_bytes((text + end * int(rng.integers(0, 3))).encode("utf-8"))


def write_parquet(table, path, rng):
    """Columns of doubles, of floats, or of texts; whatever makes no number is absent, and rarely a text."""
    columns = {}
    for name, cells in zip(NAMES, zip(*table, strict=True), strict=True):
        values = [as_number(cell) for cell in cells]
        if rng.random() < 0.03:
            columns[name] = pa.array([None if v is None else str(v) for v in values])
        else:
            kind = pa.float32() if rng.random() < 0.1 and name != "t" else pa.float64()
            with np.errstate(over="ignore"):
                columns[name] = pa.array(values).cast(kind, safe=False)
    parquet.write_table(pa.table(columns), path, row_group_size=int(rng.integers(50, 2000)))


def as_number(cell):
    try:
        return float(cell.strip('" '))
    except ValueError:
        return None


def check_file(folder, extension, kind, seed, rows=ROWS):
    """One mutated file, read whole and in pieces; how many rows were mutated, and what became of them."""
    rng = np.random.default_rng(seed)
    table = table_of(rng, rows)
    log = folder / f"log{extension}"
    if extension == ".csv":
        write_csv(spoilt(table, rng), log, rng)
    else:
        write_parquet(table, log, rng)
    supervision, signals = processor(kind), cart().plant.signals
    began, told = time.perf_counter(), None
    try:
        found = read_log(log, signals, as_it_came=True)
        unit_doubts(cart().plant, found.t, found.u, found.y), median_interval(found)
        state, expected = whole(supervision, found.t, found.u, found.y)
        assert str(watched(supervision, str(log), state, expected))
    except InputError as error:
        told = str(error)
    try:
        done = run_file(
            lambda survey, chosen: (supervision, {}), signals, log,
            out=folder / "out.parquet", piece=int(rng.integers(40, 700)), as_it_came=True,
        )  # fmt: skip
    except InputError as error:
        assert told is not None, f"in pieces alone: {error}"
        assert not list(folder.glob("out*")), "what was refused leaves something behind"
        # A file that cannot be read is named, with the row; one that holds two times too far apart is read.
        assert TOO_FAR in told or re.search(r"log\.(csv|parquet)(:\d+| row \d+|:)", told), told
        return rows, Counter({"files refused": 1})
    assert told is None, f"whole alone: {told}"
    assert time.perf_counter() - began < PATIENCE
    written = parquet.read_table(folder / "out.parquet")
    (folder / "out.parquet").unlink()
    for name, column in expected.items():
        assert np.array_equal(written[name].to_numpy(), column, equal_nan=column.dtype.kind == "f"), name
    c = state.counts
    assert c.received == c.accounted == len(found) == done.tally.rows
    assert c.passed == len(written) == done.tally.written
    t = written["t"].to_numpy()
    assert np.isfinite(t).all() and (t[1:] > t[:-1]).all()
    unit_doubts_of(cart().plant, done.survey.interval, done.survey.spans)
    return rows, Counter(
        rows=c.received, passed=c.passed, merged=c.merged, duplicates=c.duplicates, late=c.late, bad_time=c.bad_time
    )


@pytest.mark.parametrize("extension", [".csv", ".parquet"])
@settings(deadline=None, max_examples=70, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=SEEDS, kind=BANKS)
def test_every_row_of_a_file_is_counted_whole_and_in_pieces(tmp_path_factory, extension, seed, kind):
    assert check_file(tmp_path_factory.mktemp("fuzz"), extension, kind, seed)[0] == ROWS
