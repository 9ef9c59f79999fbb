# SPDX-License-Identifier: BSD-3-Clause
import errno
import inspect
import io
import json
import subprocess
import sys
from importlib.resources import files

import pytest

from faultrecon.cli import shell
from faultrecon.cli.app import app
from faultrecon.finding import InputError
from faultrecon.io.template import TEMPLATE
from faultrecon.lmi.solve import Outcome

VERBS = ("new", "check", "design", "verify", "run", "demo", "methods", "cite", "doctor")
HIDDEN = TEMPLATE.replace("A = [[0.0, 1.0], [-10.0, -0.5]]", "A = [[0.0, 0.0], [0.0, 0.0]]")  # velocity: seen by nobody
LOG = "t,force,position_a,position_b,true_f_position_b_drift,note\n" + "".join(
    f"{k * 0.01:.2f},0.0,0.0,{0.01 * (k >= 20)},{0.01 * (k >= 20)},calm\n" for k in range(120)
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a plant, its design and a log."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "plant.toml").write_text(TEMPLATE, encoding="utf-8")
    (folder / "log.csv").write_text(LOG)
    with pytest.raises(SystemExit):
        app(["design", str(folder / "plant.toml"), "--out", str(folder / "design.json")])
    return folder


@pytest.fixture
def arguments(made, tmp_path):
    """A command line that ends well, by verb."""
    return {
        "new": ("new", tmp_path / "plant.toml"),
        "check": ("check", made / "plant.toml"),
        "design": ("design", made / "plant.toml", "--out", tmp_path / "design.json"),
        "verify": ("verify", made / "design.json"),
        "run": ("run", made / "design.json", made / "log.csv", "--out", tmp_path / "out.csv"),
        "methods": ("methods",),
        "cite": ("cite", "lipschitz-hinf"),
        "doctor": ("doctor",),
    }


QUICK = [verb for verb in VERBS if verb != "demo"]  # the demonstration has tests of its own

# ---------------------------------------------------------------- every verb, as text and as JSON


def test_every_promised_verb_is_there_and_each_has_help_and_json():
    callbacks = {c.callback for c in app.registered_commands if c.callback is not None}
    assert {c.__name__ for c in callbacks} >= set(VERBS)
    for callback in callbacks:
        assert callback.__doc__ and "as_json" in inspect.signature(callback).parameters


@pytest.mark.parametrize("verb", QUICK)
def test_a_verb_that_ends_well_answers_on_the_output_and_leaves_with_0(cli, arguments, verb):
    code, out, err = cli(*arguments[verb])
    assert (code, err) == (0, "") and out.strip()


@pytest.mark.parametrize("verb", QUICK)
def test_with_json_the_output_is_one_json_object_and_nothing_else(cli, arguments, verb):
    code, out, err = cli(*arguments[verb], "--json")
    assert (code, err) == (0, "") and isinstance(json.loads(out), dict)


@pytest.mark.parametrize(
    ("verb", "line"),
    [
        ("check", ("check", "no.toml")),
        ("design", ("design", "no.toml")),
        ("verify", ("verify", "no.json")),
        ("run", ("run", "no.json", "no.csv")),
        ("new", ("new", "plant.txt")),
        ("cite", ("cite", "nobody")),
        ("demo", ("demo", "submarine")),
    ],
)
def test_an_error_goes_to_the_error_stream_and_with_json_to_the_output_too(cli, verb, line):
    code, out, err = cli(*line)
    assert (code, out) == (2, "") and err.startswith("faultrecon: ") and "Traceback" not in err
    code, out, err = cli(*line, "--json")
    assert code == 2 and json.loads(out)["error"]["what"] in err


def test_json_never_holds_nan(cli, made, tmp_path):
    blind = tmp_path / "blind.csv"
    blind.write_text("t,force,position_a,position_b\n" + "".join(f"{k * 0.01},,,\n" for k in range(5)))
    code, out, _ = cli("run", made / "design.json", blind, "--json")
    found = json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert code == 0 and found["missing"] == {"force": 5, "position_a": 5, "position_b": 5}
    assert found["faults"]["position_b_drift"] == {"rms": None, "largest": None}


# ---------------------------------------------------------------- what the verbs do


def test_new_then_check_then_design_then_verify_then_run_is_a_working_path(cli, tmp_path):
    plant, design, log, out = (tmp_path / name for name in ("p.toml", "d.json", "log.csv", "out.parquet"))
    log.write_text(LOG)
    assert cli("new", plant)[0] == 0
    assert "can be reconstructed" in cli("check", plant)[1]
    assert f"wrote {design}" in cli("design", plant, "-o", design)[1]
    assert cli("verify", design)[1].startswith("verdict: proved")
    code, text, _ = cli("run", design, log, "-o", out, "--plant", plant)
    assert code == 0 and out.exists()
    assert "120 samples over 1.19 s" in text and "ignored: note" in text and "nrmse" in text


def test_new_never_replaces_a_file_unless_forced_and_copies_library_plants(cli, tmp_path):
    plant = tmp_path / "p.toml"
    plant.write_text("mine")
    code, _, err = cli("new", plant)
    assert code == 2 and "--force" in err and plant.read_text() == "mine"
    assert cli("new", plant, "--from", "airliner", "--force")[0] == 0
    assert cli("check", plant, "--json")[1] == cli("check", "airliner", "--json")[1]
    assert "did you mean 'airliner'" in cli("new", tmp_path / "q.toml", "--from", "airlner")[2]


def test_check_takes_single_faults_and_library_names(cli):
    code, out, _ = cli("check", "airliner", "--fault", "pitch_rate", "--json")
    assert code == 0 and json.loads(out)["together"]["faults"] == ["pitch_rate"]
    assert "did you mean 'pitch_rate'" in cli("check", "airliner", "--fault", "pich_rate")[2]
    assert "did you mean 'airliner'" in cli("check", "airlner")[2]


def test_run_maps_columns_and_refuses_a_signal_mapped_twice(cli, made, tmp_path):
    log = tmp_path / "log.csv"
    log.write_text(LOG.replace("force", "F"))
    command = ("run", made / "design.json", log)
    assert cli(*command)[0] == 2
    assert cli(*command, "--column", "force=F")[0] == 0
    assert "written signal=column" in cli(*command, "--column", "force")[2]
    assert "has the column 'F' already" in cli(*command, "--column", "force=F", "--column", "force=note")[2]


def test_a_fault_that_never_acts_is_said_to_be_so(cli, made, tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("\n".join(",".join(("0" if i == 4 and k else cell) for i, cell in enumerate(line.split(",")))
                             for k, line in enumerate(LOG.splitlines())))  # fmt: skip
    text = cli("run", made / "design.json", log)[1]
    assert "it never acts; leak" in text and "nan" not in text


def changed_log(path, change):
    """A log of 100 rows: change(k, t, a, b) gives time and the two positions of row k as text."""
    rows = (",".join(("0", *map(str, change(k, k * 0.01, 0.0, 0.001)))) for k in range(100))
    path.write_text("force,t,position_a,position_b\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda k, t, a, b: (1000 * t, a, b),
            "note: the log has a sample every 10 s, the plant's noise is held 0.01 s",
        ),
        (lambda k, t, a, b: (t, a, 0.2), "note: position_b_drift is found to reach 20 times its declared size of 0.01"),
        (lambda k, t, a, b: (t + (k > 50), a, b), "longest interval 1.01 s = 101 samples at t = 0.5"),
        (lambda k, t, a, b: (t, a, ""), "position_b_drift: position_b was never measured, its fault cannot be read"),
    ],
)
def test_a_log_that_looks_wrong_is_run_and_told(cli, made, tmp_path, change, words):
    code, text, _ = cli("run", made / "design.json", changed_log(tmp_path / "log.csv", change))
    assert code == 0 and words in text and "nan" not in text


def test_a_signal_far_beyond_its_declared_range_is_doubted(cli, tmp_path):
    plant, design = tmp_path / "p.toml", tmp_path / "d.json"
    plant.write_text(TEMPLATE.replace("velocity = 0.3 }", "velocity = 0.3, position_a = 0.1 }"), encoding="utf-8")
    assert cli("design", plant, "--out", design)[0] == 0
    log = changed_log(tmp_path / "log.csv", lambda k, t, a, b: (t, 5.0, b))
    found = json.loads(cli("run", design, log, "--json")[1])
    assert found["notes"][0].startswith("position_a goes to 50 times its declared range of 0.1 m")
    assert found["longest_interval"] is None


def test_a_good_log_has_no_notes(cli, made):
    found = json.loads(cli("run", made / "design.json", made / "log.csv", "--json")[1])
    assert found["notes"] == [] and found["longest_interval"] is None


def test_run_says_when_nothing_is_claimed(cli, made, tmp_path):
    bare = tmp_path / "bare.json"
    bare.write_text(json.dumps(json.loads((made / "design.json").read_text()) | {"certificate": None}))
    assert "carries no certificate; nothing is claimed" in cli("run", bare, made / "log.csv")[1]
    assert json.loads(cli("run", bare, made / "log.csv", "--json")[1])["verdict"] is None


def test_methods_lists_variants_only_when_asked(cli):
    plain, more = (json.loads(cli("methods", *o, "--json")[1])["methods"] for o in ((), ("--variants",)))
    assert {"lipschitz-hinf", "open-loop"} <= {m["name"] for m in plain}
    assert "lipschitz-hinf-thau" in {m["name"] for m in more} - {m["name"] for m in plain}


# ---------------------------------------------------------------- exit codes


def test_a_negative_answer_leaves_with_1(cli, tmp_path):
    plant, design = tmp_path / "p.toml", tmp_path / "d.json"
    plant.write_text(HIDDEN, encoding="utf-8")
    code, out, err = cli("check", plant)
    assert (code, err) == (1, "") and "velocity" in out
    code, out, err = cli("design", plant, "--out", design)
    assert (code, out) == (1, "") and "detectable" in err and not design.exists()


def test_a_refuted_certificate_leaves_with_1(cli, made, tmp_path):
    document = json.loads((made / "design.json").read_text())
    document["gains"]["L"]["hex"][0] = (1e3).hex()
    (tmp_path / "d.json").write_text(json.dumps(document))
    code, out, err = cli("verify", tmp_path / "d.json")
    assert (code, err) == (1, "") and "gains or γ changed after the certificate was made" in out


@pytest.mark.parametrize(
    "line",
    [
        ("design", "airliner", "--level", "much"),
        ("design", "airliner", "--pole-bound", "fast"),
        ("design", "airliner", "--backoff", "0"),
        ("design", "airliner", "--method", "lipshitz-hinf"),
        ("invent",),
        ("check",),
        ("check", "airliner", "--jason"),
    ],
)
def test_wrong_usage_leaves_with_2_and_a_message(cli, line):
    code, out, err = cli(*line)
    assert (code, out) == (2, "") and err.strip()


def test_a_solver_that_gives_up_leaves_with_3(cli, monkeypatch, tmp_path):
    monkeypatch.setattr("faultrecon.synthesis.levels.solve", lambda *a, **k: Outcome("unknown"))
    code, out, err = cli("design", "lipschitz_polynomial", "--out", tmp_path / "d.json")
    assert (code, out) == (3, "") and "lipschitz-hinf" in err and not (tmp_path / "d.json").exists()


def test_an_unforeseen_error_leaves_with_3_and_its_place_and_no_traceback(cli, monkeypatch):
    monkeypatch.setattr("faultrecon.diagnosis.diagnosis.diagnose", lambda plant: 1 / 0)
    code, out, err = cli("check", "airliner")
    assert (code, out) == (3, "") and "Traceback" not in err
    assert "internal error, ZeroDivisionError in test_cli.py" in err and "report it" in err


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (BrokenPipeError(), 0, ""),
        (MemoryError(), 3, "not enough memory"),
        (OSError(errno.ENOSPC, "No space left on device"), 2, "No space left on device"),
        (PermissionError(errno.EACCES, "Permission denied", "plant.toml"), 2, "plant.toml: cannot be read or written"),
    ],
)
def test_what_the_world_does_to_a_command_ends_in_a_code_and_a_line(cli, monkeypatch, error, code, words):
    def fail(plant):
        raise error

    monkeypatch.setattr("faultrecon.diagnosis.diagnosis.diagnose", fail)
    found, _, err = cli("check", "airliner")
    assert found == code and words in err and err.count("\n") == (1 if words else 0)


# ---------------------------------------------------------------- streams


class Full(io.TextIOWrapper):
    """An output on a disk that is full."""

    def __init__(self):
        super().__init__(io.BytesIO(), encoding="utf-8")

    def write(self, text):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_output_is_an_error_with_a_message(monkeypatch):
    monkeypatch.setattr(sys, "stdout", Full())
    with pytest.raises(InputError, match="output cannot be written: No space left"):
        shell.answer(False, {}, "text")


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "utf-8"])
def test_greek_letters_reach_an_output_that_has_none(monkeypatch, encoding):
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", stream)
    shell.speak_any_letter()
    shell.answer(False, {}, "γ = 1")
    shell.answer(True, {"claim": "∫|f|² dt"}, "")
    text, rest = stream.buffer.getvalue().decode(encoding).split("\n", 1)
    assert text == ("γ = 1" if encoding == "utf-8" else "\\u03b3 = 1")
    assert json.loads(rest) == {"claim": "∫|f|² dt"}


PROBE = """
import sys
from faultrecon.cli.app import app
for line in (["--help"], ["verify", sys.argv[1]]):
    try:
        app(line)
    except SystemExit as left:
        assert not left.code
    print("LOADED", line[0], *sorted({name.partition(".")[0] for name in sys.modules}))
"""
HEAVY = {"numpy", "scipy", "casadi", "clarabel", "flint", "pandas", "pyarrow", "matplotlib", "rich"}


def test_help_and_verify_load_no_numerical_library(made):
    command = [sys.executable, "-c", PROBE, str(made / "design.json")]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=True, timeout=60)
    loaded = {
        words[1]: set(words[2:]) for line in done.stdout.splitlines() if (words := line.split())[:1] == ["LOADED"]
    }
    assert not loaded["--help"] & HEAVY
    assert not loaded["verify"] & (HEAVY - {"rich"})


def test_the_package_ships_what_the_verbs_need():
    assert (files("faultrecon") / "data" / "airliner" / "airliner.toml").is_file()
