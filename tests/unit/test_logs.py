# SPDX-License-Identifier: BSD-3-Clause
from datetime import UTC, datetime

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from faultrecon.finding import InputError
from faultrecon.io.logs import read_log, write_log
from faultrecon.plant.signals import Channels, Signals

SIGNALS = Signals(Channels(("x",)), Channels(("voltage",)), Channels(("encoder", "tacho")))
GOOD = "t,voltage,encoder,tacho\n0.0,1,0.5,2\n0.1,2,0.25,3\n0.2,3,0.125,4\n"


@pytest.fixture
def log(tmp_path):
    """Reads a CSV text as a file called log.csv."""

    def read(text: str | bytes, **options):
        file = tmp_path / "log.csv"
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_log(file, SIGNALS, **options)

    return read


@pytest.fixture
def refused(log):
    def read(text: str | bytes, **options) -> str:
        with pytest.raises(InputError) as caught:
            log(text, **options)
        message = str(caught.value)
        if "the mapping" in message:
            return message
        assert "log.csv" in message  # every complaint names the file
        return message.split("log.csv", 1)[1]

    return read


# ---------------------------------------------------------------- good recordings


def test_columns_become_signals_by_name_in_any_order(log):
    got = log("tacho,note,time,encoder,true_f_tacho,voltage\n2,ok,0.0,0.5,0,1\n3,,0.1,0.25,0.5,2\n")
    assert got.t.tolist() == [0.0, 0.1] and got.u.tolist() == [[1.0], [2.0]]
    assert got.y.tolist() == [[0.5, 2.0], [0.25, 3.0]]
    assert got.extra["true_f_tacho"].tolist() == [0.0, 0.5] and got.ignored == ("note",)
    assert (got.time_name, got.start, len(got)) == ("time", None, 2)
    assert got.source.endswith("log.csv") and "2 samples, 0 to 0.1 s" in repr(got)


def test_a_log_cannot_be_changed(log):
    with pytest.raises(ValueError, match="read-only"):
        log(GOOD).y[0, 0] = 1.0


@pytest.mark.parametrize("extension", [".csv", ".parquet", ".PARQUET"])
def test_what_is_written_reads_back_to_the_last_bit(tmp_path, extension):
    rng = np.random.default_rng(3)
    columns = {
        "t": np.arange(50) * 0.1,
        "voltage": rng.standard_normal(50),
        "encoder": rng.standard_normal(50) * 1e-300,
    }
    columns |= {"tacho": rng.standard_normal(50) * 1e300, "true_f": np.arange(50), "mode": np.array(["idle"] * 50)}
    columns["encoder"][7] = np.nan
    write_log(tmp_path / f"log{extension}", columns)
    got = read_log(tmp_path / f"log{extension}", SIGNALS)
    assert np.array_equal(got.t, columns["t"]) and np.array_equal(got.u[:, 0], columns["voltage"])
    assert np.array_equal(got.y, np.column_stack([columns["encoder"], columns["tacho"]]), equal_nan=True)
    assert np.array_equal(got.extra["true_f"], np.arange(50.0)) and got.ignored == ("mode",)
    assert dict(got.missing) == {"encoder": 1}


def test_empty_cells_and_nan_are_missing_values_that_are_counted(log):
    got = log("t,voltage,encoder,tacho\n0,1,NaN,2\n1,,nan,3\n2,1,,4\n")
    assert np.isnan(got.y[:, 0]).all() and got.y[:, 1].tolist() == [2.0, 3.0, 4.0]
    assert dict(got.missing) == {"voltage": 1, "encoder": 3}


def test_a_column_may_be_mapped_to_a_signal(log):
    text = "Time [s],U1,encoder,n\n0,1,0.5,2\n"
    got = log(text, mapping={"t": "Time [s]", "voltage": "U1", "tacho": "n"})
    assert (got.u.tolist(), got.y.tolist(), got.time_name) == ([[1.0]], [[0.5, 2.0]], "Time [s]")


def test_one_row_is_a_log(log):
    assert len(log("t,voltage,encoder,tacho\n0,1,0.5,2\n")) == 1


def test_a_plant_without_inputs_needs_no_input_column(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("t,y\n0,1\n1,2\n")
    got = read_log(file, Signals(Channels(("x",)), Channels(()), Channels(("y",))))
    assert got.u.shape == (2, 0) and got.y.shape == (2, 1)


def test_iso_times_become_seconds_from_the_first_row(log):
    rows = ["2026-03-01T12:00:00.020+02:00", "2026-03-01T12:00:00.040+02:00", "2026-03-01T10:00:01.020Z"]
    got = log("time,voltage,encoder,tacho\n" + "".join(f"{r},1,2,3\n" for r in rows))
    assert got.t.tolist() == [0.0, 0.02, 1.0]
    assert got.start == datetime(2026, 3, 1, 10, 0, 0, 20_000, tzinfo=UTC)
    got = log("time,voltage,encoder,tacho\n2026-03-01 12:00:00,1,2,3\n2026-03-01 12:00:00.5,1,2,3\n")
    assert got.t.tolist() == [0.0, 0.5] and got.start == datetime(2026, 3, 1, 12)


@pytest.mark.parametrize("kind", [pa.timestamp("ms"), pa.timestamp("ns", "Europe/Berlin"), pa.timestamp("s", "UTC")])
def test_parquet_timestamps_become_seconds_from_the_first_row(tmp_path, kind):
    ticks = {"s": 1, "ms": 1000, "ns": 10**9}[kind.unit]
    t = pa.array([1_700_000_000 * ticks, 1_700_000_002 * ticks], pa.int64()).cast(kind)
    one = pa.array([1.0, 1.0], pa.float32())
    pq.write_table(pa.table({"t": t, "voltage": one, "encoder": one, "tacho": one}), tmp_path / "log.parquet")
    got = read_log(tmp_path / "log.parquet", SIGNALS)
    assert got.t.tolist() == [0.0, 2.0] and got.start is not None
    assert got.start.replace(tzinfo=UTC).timestamp() == 1_700_000_000


def test_integers_truth_values_categories_and_text_numbers_are_numbers(tmp_path):
    columns = {
        "t": pa.array([0, 1]),
        "voltage": pa.array([True, False]),
        "encoder": pa.array(["1.5", " 2.5 "]).dictionary_encode(),
        "tacho": pa.array([None, None], pa.null()),
        "nested": pa.array([[1], [2]]),
    }
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    got = read_log(tmp_path / "log.parquet", SIGNALS)
    assert got.u.tolist() == [[1.0], [0.0]] and got.y[:, 0].tolist() == [1.5, 2.5]
    assert np.isnan(got.y[:, 1]).all() and got.ignored == ("nested",)


def test_a_byte_order_mark_blanks_and_windows_line_ends_are_read(log):
    text = b"\xef\xbb\xbf" + GOOD.replace(",", ", ").replace("\n", "\r\n").encode()
    assert log(text).y.tolist() == log(GOOD).y.tolist()


def test_a_text_column_that_begins_like_a_number_is_only_ignored(log):
    got = log("t,voltage,encoder,tacho,tag\n0,1,2,3,17\n1,1,2,3,B4\n")
    assert got.ignored == ("tag",) and got.t.tolist() == [0.0, 1.0]


# ---------------------------------------------------------------- columns that are not there


def test_all_missing_columns_are_listed_with_suggestions_and_what_is_there(refused):
    message = refused("t,voltage,encodr,speed\n0,1,2,3\n")
    assert message.startswith(": there is no column for encoder, tacho: the columns are: t, voltage, encodr, speed;")
    assert "for encoder: did you mean 'encodr'?" in message and "mapping {signal: column}" in message


def test_a_log_without_time_is_refused(refused):
    message = refused(GOOD.replace("t,vol", "tim,vol"))
    assert message.startswith(": there is no time column: the columns are: tim, voltage, encoder, tacho;")
    assert "did you mean 'tim'?, or call it t or time, or map 't' to it" in message
    assert "both t and time could be the time" in refused("t,time,voltage,encoder,tacho\n0,0,1,2,3\n")


def test_semicolons_are_recognised(refused):
    assert "separated by semicolons; save it as comma-delimited" in refused(GOOD.replace(",", ";"))


def test_a_table_from_a_german_spreadsheet_is_recognised_by_its_header(refused):
    message = refused(GOOD.replace(",", ";").replace(".", ","))
    assert message.startswith(": is separated by semicolons with decimal commas: as spreadsheets write it")
    assert message.endswith("save it as comma-delimited CSV with decimal points")
    assert "separated by tabs;" in refused(GOOD.replace(",", "\t"))


def test_semicolons_within_quoted_names_are_no_separators(log):
    assert len(log(GOOD.replace("tacho\n", 'tacho,"a;b;c;d;e;f"\n', 1).replace("2\n", "2,0\n").replace("3\n", "3,0\n")
                   .replace("4\n", "4,0\n"))) == 3  # fmt: skip


def test_a_missing_column_is_answered_with_the_option_that_maps_it(refused):
    message = refused(GOOD.replace("tacho", "Tacho speed"))
    assert """on the command line --column tacho="Tacho speed\"""" in message
    message = refused(GOOD.replace("t,vol", "Time (s),vol"))
    assert """on the command line --column t="Time (s)\"""" in message
    message = refused(GOOD.replace("t,vol", "motor,vol"))
    assert "did you mean" not in message and """--column t="COLUMN\"""" in message


def test_what_a_run_wrote_is_not_called_ignored(log):
    head = "t,voltage,encoder,tacho,tacho_ok,tacho_corrected,f_drift,note\n"
    assert log(head + "0,1,2,3,true,,,calm\n1,1,2,3,false,x,x,calm\n").ignored == ("note",)


def test_the_line_of_a_bad_cell_counts_blank_lines_and_lines_within_quotes(refused):
    assert ":6  column tacho is 'bad'" in refused('t,voltage,encoder,tacho,note\n\n0,1,2,3,"a\nb"\n\n1,1,2,bad,c\n')


def test_a_parquet_file_has_rows(tmp_path):
    columns = {"t": [0.0, 1.0], "voltage": [1.0, 1.0], "encoder": [1.0, 1.0], "tacho": ["1", "bad"]}
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    with pytest.raises(InputError, match=r"log\.parquet: column tacho, row 2 is 'bad'"):
        read_log(tmp_path / "log.parquet", SIGNALS)


def test_a_mapping_of_something_unknown_is_refused(refused):
    message = refused(GOOD, mapping={"tachoo": "tacho"})
    assert message == "the mapping names 'tachoo', which is no signal; did you mean 'tacho'?"
    assert "there is no column for n" in refused(GOOD, mapping={"tacho": "n"})


def test_two_columns_of_one_name_are_refused_only_where_it_matters(refused, log):
    assert ": two columns are called 'tacho'" in refused("t,voltage,encoder,tacho,tacho\n0,1,2,3,4\n")
    assert log("t,voltage,encoder,tacho,k,k\n0,1,2,3,4,5\n").ignored == ("k",)


# ---------------------------------------------------------------- cells that are no numbers


def test_text_in_a_numeric_column_is_refused_with_row_column_and_cell(refused):
    message = refused(GOOD.replace("0.25", "0,25".replace(",", ";")))
    assert message == (
        ":3  column encoder is '0;25', not a number; correct the cell, or leave it empty where there is no value"
    )


def test_the_bad_cell_is_found_far_into_a_long_log(refused):
    rows = [f"{k},1,2,3" for k in range(100_000)]
    rows[87_654] = "87654,1,2,error"
    assert ":87656  column tacho is 'error'" in refused("t,voltage,encoder,tacho\n" + "\n".join(rows) + "\n")


def test_an_infinite_measurement_is_refused(refused):
    assert ":3  column encoder is inf; leave the cell empty" in refused(GOOD.replace("0.25", "inf"))


def test_a_column_of_dates_is_no_measurement(tmp_path):
    one = pa.array([1.0])
    table = {"t": one, "voltage": one, "encoder": one, "tacho": pa.array([0], pa.timestamp("ms"))}
    pq.write_table(pa.table(table), tmp_path / "log.parquet")
    with pytest.raises(
        InputError, match=r"log\.parquet: column tacho holds timestamp\[ms\], not numbers; give numbers"
    ):
        read_log(tmp_path / "log.parquet", SIGNALS)


# ---------------------------------------------------------------- times that do not run


def test_rows_out_of_order_are_refused_with_row_and_values(refused):
    message = refused(GOOD.replace("0.2,", "0.05,"))
    assert message.startswith(":4  column t has 0.05 after 0.1: times must increase from row to row; sort the rows")


def test_a_repeated_time_is_refused_with_row_and_value(refused):
    assert ":4  column t repeats 0.1: times must increase" in refused(GOOD.replace("0.2,", "0.1,"))
    twice = "t,voltage,encoder,tacho\n2026-03-01T12:00:00Z,1,2,3\n2026-03-01T12:00:00Z,1,2,3\n"
    assert ":3  column t repeats 2026-03-01T12:00:00Z" in refused(twice)


@pytest.mark.parametrize("cell", ["", "nan", "inf"])
def test_a_row_without_a_time_is_refused(refused, cell):
    message = refused(GOOD.replace("0.2,", f"{cell},"))
    assert message.startswith(":4  column t has the time") and message.endswith("give every row a finite time")


def test_a_date_that_is_missing_among_dates_is_refused(refused):
    text = "t,voltage,encoder,tacho\n2026-03-01T12:00:00Z,1,2,3\n,1,2,3\n"
    assert ":3  column t has no time; give every row a time" in refused(text)


def test_a_time_that_is_neither_number_nor_date_is_refused(refused):
    message = refused(GOOD.replace("0.1,", "noon,"))
    assert message.startswith(":3  column t is 'noon', not a time like those above; give seconds, or ISO 8601")
    assert ":2  column t is 'dawn', not a time; give" in refused(GOOD.replace("0.0,", "dawn,"))


# ---------------------------------------------------------------- files that are no recordings


def test_an_empty_log_is_refused(refused):
    remedy = "record at least one sample"
    assert refused("") == f": is empty: the file has 0 bytes; {remedy}"
    assert refused("t,voltage,encoder,tacho\n") == f": is empty: it has a header and no rows; {remedy}"
    assert "has no header" in refused("\n\n")


def test_a_ragged_row_is_refused_with_its_line(refused):
    message = refused(GOOD.replace("0.1,2,0.25,3", "0.1,2,0.25"))
    assert message == ":3  has 3 cells for 4 columns: the line is '0.1,2,0.25'; give every row one cell per column"


def test_text_that_is_not_utf8_is_refused_with_its_line(refused):
    latin = "t,voltage,encoder,tacho,note\n0,1,2,3,a\n1,1,2,3,20 °C\n".encode("latin-1")
    assert refused(latin) == ":3  has a byte 0xb0, which is not UTF-8; save the file as UTF-8"
    assert ":1  has a byte 0xb0" in refused(latin.replace(b"note", b"T \xb0C"))
    assert ":1  is UTF-16 text; save the file as CSV in UTF-8" in refused(GOOD.encode("utf-16"))
    assert ": is binary, not CSV text" in refused(b"\x00\x01" * 100)


def test_a_truncated_parquet_file_is_refused(tmp_path):
    file = tmp_path / "log.parquet"
    write_log(file, {name: np.arange(1000.0) for name in ("t", "voltage", "encoder", "tacho")})
    whole = file.read_bytes()
    for size in (3, 8, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"log\.parquet: cannot be read as Parquet.*; copy the file again"):
            read_log(file, SIGNALS)


def test_a_damaged_parquet_file_never_gives_anything_but_a_log_or_a_refusal(tmp_path):
    file = tmp_path / "log.parquet"
    write_log(file, {name: np.arange(40.0) for name in ("t", "voltage", "encoder", "tacho")})
    whole = file.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            damaged[place] = int(rng.integers(0, 256))
        file.write_bytes(damaged)
        try:
            read_log(file, SIGNALS)
        except InputError as error:
            assert "log.parquet" in str(error)


def test_a_file_of_another_kind_is_refused(tmp_path, refused):
    csv_as_parquet = tmp_path / "a.parquet"
    csv_as_parquet.write_text(GOOD)
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        read_log(csv_as_parquet, SIGNALS)
    write_log(tmp_path / "b.parquet", {"t": [0.0]})
    assert ": is a Parquet file; rename it to .parquet" in refused((tmp_path / "b.parquet").read_bytes())
    for name in ("log.xlsx", "log", "log.csv.gz"):
        with pytest.raises(InputError, match=r"the extension is .*; use \.csv or \.parquet"):
            read_log(tmp_path / name, SIGNALS)


def test_a_file_that_is_not_there_is_refused_with_a_suggestion(tmp_path):
    (tmp_path / "flight.csv").write_text(GOOD)
    with pytest.raises(InputError, match=r"fligth\.csv: no such file; did you mean 'flight\.csv'\?"):
        read_log(tmp_path / "fligth.csv", SIGNALS)
    with pytest.raises(InputError, match=r"the folder .*nowhere does not exist"):
        read_log(tmp_path / "nowhere" / "flight.csv", SIGNALS)
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(InputError, match="is a folder, not a file"):
        read_log(tmp_path / "folder.csv", SIGNALS)


# ---------------------------------------------------------------- writing


def test_columns_that_do_not_fit_are_not_written(tmp_path):
    file = tmp_path / "out.csv"
    for columns, message in [
        ({"t": [0.0, 1.0], "y": [1.0]}, "the column 'y' has shape (1,); give one value per row (2 rows)"),
        ({"t": [0.0, 1.0], "y": np.zeros((2, 2))}, "the column 'y' has shape (2, 2)"),
        ({"t": 0.0}, "the column 't' has shape ()"),
        ({}, "there is no column to write"),
        ({"t": [0.0], "y": [object()]}, "cannot be written"),
    ]:
        with pytest.raises(InputError) as caught:
            write_log(file, columns)
        assert message in str(caught.value) and not file.exists()
    with pytest.raises(InputError, match=r"the extension is '\.txt'; use \.csv or \.parquet"):
        write_log(tmp_path / "out.txt", {"t": [0.0]})
    with pytest.raises(InputError, match="cannot write"):
        write_log(tmp_path / "nowhere" / "out.csv", {"t": [0.0]})
    assert list(tmp_path.iterdir()) == []
