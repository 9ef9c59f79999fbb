# SPDX-License-Identifier: BSD-3-Clause
"""Wrong files through the command line: a message with place, value and remedy, the exit code, nothing half-written."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from faultrecon.cli.app import app
from faultrecon.io.template import TEMPLATE


@pytest.fixture(scope="module")
def design_file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("design")
    (folder / "plant.toml").write_text(TEMPLATE, encoding="utf-8")
    with pytest.raises(SystemExit):
        app(["design", str(folder / "plant.toml"), "--out", str(folder / "design.json")])
    return folder / "design.json"


def names(folder):
    return sorted(path.name for path in folder.iterdir())


# ---------------------------------------------------------------- plants

A, C = "A = [[0.0, 1.0], [-10.0, -0.5]]", "C = [[1.0, 0.0], [1.0, 0.0]]"
TWICE = '[[fault]]\nname = "again"\nsensor = "position_b"\n'
BOTH = '[[fault]]\nname = "a"\nsensor = "position_a"\n'
FORMULA = """[nonlinearity]
into = ["velocity"]
phi = ["{}"]
domain = {{ position = [-0.2, 0.2] }}
lipschitz = "derive"
[[disturbance]]"""


def edit(old, new, text=TEMPLATE):
    assert old in text
    return text.replace(old, new)


def formula(text):
    return TEMPLATE.replace("[[disturbance]]", FORMULA.format(text), 1)


PLANTS = {
    "an empty file": ("", 2, ("plant.toml:1", "schema")),
    "no TOML": ("A = [[1, 2", 2, ("plant.toml:1", "not valid TOML", "mend that line")),
    "bytes": (b"\xff\xfe\x00", 2, ("plant.toml:1", "not UTF-8")),
    "a newer schema": (edit("schema = 1", "schema = 2"), 2, ("plant.toml:2", "is 2", "newer release")),
    "a misspelt key": (edit("[matrices]", "[matrixes]"), 2, ("plant.toml", "matrixes", "did you mean 'matrices'")),
    "A not square": (edit(A, "A = [[0.0, 1.0]]"), 2, ("matrices.A", "1 rows", "give 2 rows")),
    "a row too short": (edit(A, "A = [[0.0, 1.0], [-10.0]]"), 2, ("matrices.A[1]", "1 entries", "give 2 entries")),
    "C too wide": (edit(C, "C = [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]"), 2, ("matrices.C[0]", "3 entries")),
    "NaN in A": (edit(A, "A = [[nan, 1.0], [-10.0, -0.5]]"), 2, ("matrices.A[0][0]", "is nan", "finite number")),
    "inf in C": (edit(C, "C = [[inf, 0.0], [1.0, 0.0]]"), 2, ("matrices.C[0][0]", "is inf", "finite number")),
    "text in A": (edit(A, 'A = [["0", 1.0], [-10.0, -0.5]]'), 2, ("matrices.A[0][0]", "is text, not a number")),
    "a fault on no sensor": (
        edit('sensor = "position_b"', 'sensor = "position_c"'),
        2,
        ("fault[0].sensor", "did you mean"),
    ),
    "a size of zero": (edit("size   = 0.01", "size   = 0"), 2, ("fault[0].size", "positive number")),
    "two of one name": (TEMPLATE + TWICE.replace("again", "position_b_drift"), 2, ("names two faults", "rename one")),
    "F of deficient rank": (
        TEMPLATE + TWICE,
        1,
        ("rank 1 for 2", "position_b_drift and again", "one of them at a time"),
    ),
    "no fault": (TEMPLATE[: TEMPLATE.index("[[fault]]")], 1, ("declares no fault", "add a [[fault]]")),
    "(A, C1) not detectable": (
        edit(A, "A = [[0.0, 0.0], [0.0, 0.0]]"),
        1,
        ("s = 0", "velocity", "add a healthy sensor"),
    ),
    "a forbidden name": (formula("__import__('os').getcwd()"), 2, ("nonlinearity.phi[0]", "attribute", "column 1")),
    "a forbidden call": (formula("open(position)"), 2, ("nonlinearity.phi[0]", "unknown function 'open'", "sin, cos")),
    "an unknown name": (formula("positron**3"), 2, ("nonlinearity.phi[0]", "'positron'", "did you mean 'position'")),
    "a formula without a bound": (formula("sqrt(position)"), 2, ("nonlinearity.lipschitz", "sqrt", "shrink the box")),
}


@pytest.mark.parametrize("verb", ["check", "design"])
@pytest.mark.parametrize("case", PLANTS)
def test_a_plant_file_that_will_not_do(cli, tmp_path, case, verb):
    content, code, fragments = PLANTS[case]
    plant = tmp_path / "plant.toml"
    plant.write_bytes(content if isinstance(content, bytes) else content.encode())
    found, out, err = cli(verb, plant, *(("--out", tmp_path / "design.json") if verb == "design" else ()))
    # A negative finding is the answer of `check`; for `design`, and for a wrong file, it is an error message.
    message = out if verb == "check" and code == 1 else err
    assert found == code and "Traceback" not in err
    assert all(fragment in message for fragment in fragments), message
    assert names(tmp_path) == ["plant.toml"]


def test_all_sensors_faulty_leaves_none_to_drive_the_observer(cli, tmp_path):
    (tmp_path / "plant.toml").write_text(TEMPLATE + BOTH, encoding="utf-8")
    code, out, err = cli("design", tmp_path / "plant.toml", "--out", tmp_path / "design.json")
    assert (code, out) == (1, "") and "all 2 sensors are declared faulty" in err and "open-loop" in err
    assert names(tmp_path) == ["plant.toml"]


def test_a_folder_or_nothing_in_place_of_a_plant(cli, tmp_path):
    assert cli("check", tmp_path)[0] == 2
    code, _, err = cli("check", tmp_path / "plant.toml")
    assert code == 2 and "no such file" in err


# ---------------------------------------------------------------- logs

HEAD = "t,force,position_a,position_b\n"
ROWS = "0.00,0,0.001,0.01\n0.01,0,0.002,0.01\n0.02,0,0.001,0.01\n"
LOGS = {
    "an empty file": ("", ("is empty", "0 bytes", "record at least one sample")),
    "a header alone": (HEAD, ("is empty", "no rows")),
    "no header": ("\n\n", (":1", "no header")),
    "a missing column": ("t,force,position_a\n0,0,0\n", ("no column for position_b", "the columns are: t, force")),
    "a misspelt column": (HEAD.replace("_b", "_B") + ROWS, ("no column for position_b", "did you mean 'position_B'")),
    "a column twice": (HEAD.replace("position_a", "position_b") + ROWS, ("position_a",)),
    "two alike": ("t,force,position_a,position_b,position_b\n0,0,0,0,0\n", ("two columns are called 'position_b'",)),
    "no time": ("force,position_a,position_b\n0,0,0\n", ("no time column", "call it t or time")),
    "two times": (HEAD.replace("force", "time,force") + "0,0,0,0,0\n", ("both t and time",)),
    "text in a cell": (HEAD + "0,0,abc,0\n", (":2  column position_a", "'abc'", "correct the cell")),
    "inf in a cell": (HEAD + "0,0,0,0\n1,0,0,inf\n", (":3  column position_b is inf", "leave the cell empty")),
    "a short row": (HEAD + "0,0,0\n", (":2", "3 cells for 4 columns")),
    "time going back": (HEAD + "0.1,0,0,0\n0.0,0,0,0\n", (":3  column t", "after 0.1", "sort the rows")),
    "time repeated": (HEAD + "0.1,0,0,0\n0.1,0,0,0\n", (":3  column t repeats 0.1", "one row per time")),
    "a time that is none": (HEAD + "0,0,0,0\nnow,0,0,0\n", (":3  column t", "'now'")),
    "semicolons": ((HEAD + ROWS).replace(",", ";"), ("separated by semicolons", "comma-delimited")),
    "UTF-16": ((HEAD + ROWS).encode("utf-16"), ("UTF-16", "UTF-8")),
    "bytes": (b"\0" * 64, ("is binary",)),
}


def refused_log(cli, design_file, log, *fragments):
    """Whether `run` refuses this log with 2 and leaves nothing."""
    folder = log.parent
    before = names(folder)
    command = ("run", design_file, log, "--out", folder / "out.csv", "--figure", folder / "out.png")
    code, out, err = cli(*command)
    assert (code, out) == (2, "") and "Traceback" not in err and log.name in err
    assert all(fragment in err for fragment in fragments), err
    assert names(folder) == before


@pytest.mark.parametrize("case", LOGS)
def test_a_log_that_will_not_do(cli, design_file, tmp_path, case):
    content, fragments = LOGS[case]
    log = tmp_path / "log.csv"
    log.write_bytes(content if isinstance(content, bytes) else content.encode())
    refused_log(cli, design_file, log, *fragments)


@pytest.mark.parametrize("part", [0.0, 0.01, 0.5, 0.99])
def test_a_truncated_parquet_file(cli, design_file, tmp_path, part):
    log = tmp_path / "log.parquet"
    column = np.arange(50) * 0.01
    pq.write_table(pa.table({"t": column} | dict.fromkeys(("force", "position_a", "position_b"), column)), log)
    whole = log.read_bytes()
    assert cli("run", design_file, log)[0] == 0
    log.write_bytes(whole[: int(part * len(whole))])
    refused_log(cli, design_file, log, "is empty" if part == 0 else "truncated, damaged or of another kind")


def test_a_log_under_the_wrong_extension(cli, design_file, tmp_path):
    (tmp_path / "log.xlsx").write_text(HEAD + ROWS)
    refused_log(cli, design_file, tmp_path / "log.xlsx", "'.xlsx'", "use .csv or .parquet")


def test_extra_columns_missing_values_dates_and_one_row_are_no_errors(cli, design_file, tmp_path):
    good = {
        "extra": HEAD.replace("\n", ",note\n") + ROWS.replace("\n", ",calm\n"),
        "gaps": HEAD + "0,0,,0\n0.01,,0,nan\n0.02,0,0,0\n",
        "dates": HEAD + "".join(f"2026-03-01T12:00:00.{k:02}Z,0,0,0\n" for k in range(0, 99, 2)),
        "one": HEAD + "0,0,0,0\n",
    }
    for name, text in good.items():
        (tmp_path / f"{name}.csv").write_text(text)
        code, out, err = cli("run", design_file, tmp_path / f"{name}.csv", "--out", tmp_path / f"{name}.parquet")
        assert (code, err) == (0, "") and out, name


# ---------------------------------------------------------------- outputs


@pytest.fixture
def good_log(tmp_path):
    (tmp_path / "log.csv").write_text(HEAD + ROWS)
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "folder.json").mkdir()
    return tmp_path / "log.csv"


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        (("--out", "log.csv"), ("is the recording itself", "another file")),
        (("--out", "folder.csv"), ("folder.csv", "it is a folder")),
        (("--out", "missing/out.csv"), ("missing does not exist",)),
        (("--out", "out.txt"), ("'.txt'", "use .csv or .parquet")),
        (("--figure", "missing/out.png"), ("missing does not exist",)),
        (("--figure", "out.bmp"), ("unknown kind of figure", ".png")),
        (("--out", "out.csv", "--figure", "missing/out.png"), ("missing does not exist",)),
        (("--out", "out.csv", "--hold", "cubic"), ("'cubic' is no hold", "left, midpoint or linear")),
        (("--out", "out.csv", "--sample-time", "0"), ("sample time is 0", "positive")),
        (("--out", "out.csv", "--column", "force=push"), ("no column for push",)),
        (("--out", "out.csv", "--scheme", "rk4", "--sample-time", "1"), ("RK4 is unstable", "use scheme='zoh'")),
    ],
)
def test_a_run_that_cannot_write_or_start_writes_nothing(cli, design_file, good_log, monkeypatch, options, fragments):
    monkeypatch.chdir(good_log.parent)
    before = names(good_log.parent)
    code, out, err = cli("run", design_file, good_log.name, *options)
    assert (code, out) == (2, "") and all(fragment in err for fragment in fragments), err
    assert names(good_log.parent) == before and good_log.read_text() == HEAD + ROWS


@pytest.mark.parametrize("place", ["plant.toml", "folder.json", "missing/design.json", "design"])
def test_a_design_is_not_written_where_it_does_not_belong(cli, good_log, monkeypatch, place):
    monkeypatch.chdir(good_log.parent)
    assert cli("new", "plant.toml")[0] == 0
    before = names(good_log.parent)
    code, out, err = cli("design", "plant.toml", "--out", place)
    assert (code, out) == (2, "") and place.replace("missing/", "") in err
    assert names(good_log.parent) == before and (good_log.parent / "plant.toml").read_text(encoding="utf-8") == TEMPLATE


def test_columns_that_would_clash_are_refused_before_the_work(cli, tmp_path):
    text = edit('"force [N]"', '"f_position_b_drift [N]"')
    (tmp_path / "plant.toml").write_text(text, encoding="utf-8")
    assert cli("design", tmp_path / "plant.toml", "--out", tmp_path / "d.json")[0] == 0
    (tmp_path / "log.csv").write_text((HEAD + ROWS).replace("force", "f_position_b_drift"))
    code, _, err = cli("run", tmp_path / "d.json", tmp_path / "log.csv", "--out", tmp_path / "out.csv")
    assert code == 2 and "would be called 'f_position_b_drift'" in err and "rename" in err
    assert not (tmp_path / "out.csv").exists()


# ---------------------------------------------------------------- design files


def test_a_design_file_of_another_plant(cli, design_file, good_log):
    other = good_log.parent / "other.toml"
    other.write_text(edit("-10.0", "-12.5"), encoding="utf-8")
    before = names(good_log.parent)
    out = good_log.parent / "out.csv"
    code, _, err = cli("run", design_file, good_log, "--out", out, "--plant", other)
    assert code == 2 and "design.json" in err and "matrices.A[1][0] is -10 in the design and -12.5 in the plant" in err
    assert names(good_log.parent) == before


@pytest.mark.parametrize(
    ("change", "fragments"),
    [
        (lambda text: text[: len(text) // 2], ("is no design file", "no JSON")),
        (lambda text: "", ("is no design file",)),
        (lambda text: json.dumps(json.loads(text) | {"schema": 9}), ("schema 9", "update faultrecon")),
        (lambda text: json.dumps(json.loads(text) | {"kind": "song"}), ("is no design file", "faultrecon design")),
        (lambda text: json.dumps(json.loads(text) | {"gains": {}}), ("design.json",)),
    ],
)
def test_a_damaged_design_file(cli, design_file, good_log, change, fragments):
    damaged = good_log.parent / "design.json"
    damaged.write_text(change(design_file.read_text(encoding="utf-8")), encoding="utf-8")
    before = names(good_log.parent)
    code, _, err = cli("run", damaged, good_log, "--out", good_log.parent / "out.csv")
    assert code == 2 and all(fragment in err for fragment in ("design.json", *fragments)), err
    assert names(good_log.parent) == before


def test_files_in_the_wrong_order(cli, design_file, good_log):
    code, _, err = cli("run", good_log, design_file)
    assert code == 2 and "log.csv: is no design file" in err
    code, _, err = cli("verify", good_log)
    assert code == 2 and "write one: faultrecon design" in err
