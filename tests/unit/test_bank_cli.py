# SPDX-License-Identifier: BSD-3-Clause
"""Banks on the command line and as files: what is designed, refused, proved again, told apart, and left untested."""

import io
import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.cli.app import app
from faultrecon.finding import Finding, InputError
from faultrecon.io.bankfile import is_bank, read_bank, write_bank
from faultrecon.io.logs import write_log
from faultrecon.synthesis.bank import Bank

MOTOR = """schema = 1
name = "motor"
[signals]
x = ["speed", "current"]
u = ["voltage"]
y = ["tacho", "encoder", "shunt"]
[signals.range]
x = { speed = 100.0, current = 20.0 }
u = { voltage = 24.0 }
y = { tacho = 100.0, encoder = 100.0, shunt = 20.0 }
[noise]
hold = 0.01
sd = { tacho = 0.5, encoder = 0.5, shunt = 0.05 }
[matrices]
A = [[-1.0, 5.0], [-2.0, -20.0]]
B = [[0.0], [20.0]]
C = { select = ["speed", "speed", "current"] }
[[disturbance]]
name = "load"
into = { speed = 1.0 }
size = 5.0
"""
AMPLIFIER = """[[fault]]
name = "amplifier"
actuator = "voltage"
size = 5.0
rate = 10.0
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A plant without a fault, one with a fault of its amplifier, the bank of the first, and a log."""
    folder = tmp_path_factory.mktemp("banks")
    (folder / "motor.toml").write_text(MOTOR, encoding="utf-8")
    (folder / "driven.toml").write_text(MOTOR + AMPLIFIER, encoding="utf-8")
    write_bank(fr.bank(fr.load(folder / "motor.toml")), folder / "bank.json")
    rows = 60
    log = {"t": np.arange(rows) * 0.01, "voltage": np.zeros(rows)}
    write_log(folder / "log.csv", log | {name: np.zeros(rows) for name in ("tacho", "encoder", "shunt")})
    return folder


@pytest.fixture
def call(capsys):
    """`call("design", "plant.toml", ...)`: exit code, output, messages."""

    def run(*words):
        with pytest.raises(SystemExit) as end:
            app([str(word) for word in words])
        said = capsys.readouterr()
        return end.value.code, said.out, said.err

    return run


# ---------------------------------------------------------------- design --bank


def test_a_declared_actuator_fault_is_a_hypothesis_of_its_own(files, call):
    code, out, _ = call("design", files / "driven.toml", "--bank", "--json")
    assert code == 0 and set(json.loads(out)["hypotheses"]) == {"tacho", "encoder", "amplifier"}


@pytest.mark.parametrize(
    ("faults", "expected"),
    [
        (["amplifier"], ["amplifier"]),
        (["tacho"], ["tacho"]),
        (["encoder", "amplifier"], ["encoder", "amplifier"]),
    ],
)
def test_named_faults_and_sensors_restrict_the_bank(files, call, faults, expected):
    words = [word for name in faults for word in ("--fault", name)]
    code, out, _ = call("design", files / "driven.toml", "--bank", "--json", *words)
    assert code == 0 and list(json.loads(out)["hypotheses"]) == expected


def test_an_actuator_without_a_rate_is_said_at_once_with_the_remedy(files, call):
    code, out, _ = call("design", files / "motor.toml", "--bank", "--actuator", "voltage")
    assert code == 0 and "voltage: no design; no rate is declared" in out and "[[fault]]" in out
    code, _, err = call("design", files / "motor.toml", "--bank", "--fault", "voltage")
    assert code == 1 and "no rate is declared for voltage" in err and "[[fault]]" in err


def test_an_unknown_name_is_refused_with_those_that_there_are(files, call):
    code, _, err = call("design", files / "motor.toml", "--bank", "--fault", "tachoo")
    assert code == 2 and "did you mean 'tacho'" in err


@pytest.mark.parametrize(
    "words",
    [("--level", "3"), ("--fix", "beta=3"), ("--free", "K1"), ("--method", "best"), ("--method", "nobody")],
)
def test_what_only_one_design_can_have_is_refused_with_a_bank(files, call, words):
    code, _, err = call("design", files / "motor.toml", "--bank", *words)
    assert code == 2 and words[1].split("=")[0] in err


def test_backoff_and_pole_bound_reach_every_design_of_a_bank(files, call):
    words = ("--backoff", "0.5", "--pole-bound", "30")
    _, out, _ = call("design", files / "motor.toml", "--bank", "--json", *words)
    made = [one["details"] for one in json.loads(out)["hypotheses"].values()]
    assert {one["pole_bound"] for one in made} == {30.0}
    assert [one["backoff"] for one in made] == pytest.approx([0.5] * len(made))


def test_what_is_told_apart_is_in_the_report_and_in_its_data(files, call):
    _, out, _ = call("design", files / "motor.toml", "--bank", "--json")
    apart = json.loads(out)["apart"]
    assert apart["groups"] == [] and apart["largest"] == {"tacho": 100.0, "encoder": 100.0}
    assert 0.0 < apart["needed"]["tacho"]["encoder"] < 100.0
    _, out, _ = call("design", files / "motor.toml", "--bank")
    assert "told apart: every fault from every other" in out


# ---------------------------------------------------------------- verify


def test_every_design_of_a_bank_is_proved_again_a_row_each(files, call):
    code, out, _ = call("verify", files / "bank.json")
    assert code == 0
    assert [line.split()[:2] for line in out.splitlines()[:2]] == [["tacho", "proved:"], ["encoder", "proved:"]]
    code, out, _ = call("verify", files / "bank.json", "--json")
    assert {one["verdict"] for one in json.loads(out)["designs"].values()} == {"proved"}


def test_one_refuted_design_is_named_and_ends_as_for_one(files, tmp_path, call):
    document = json.loads((files / "bank.json").read_text(encoding="utf-8"))
    certificate = document["designs"]["encoder"]["certificate"]
    certificate["level"] = (float.fromhex(certificate["level"]) / 2).hex()
    (tmp_path / "forged.json").write_text(json.dumps(document), encoding="utf-8")
    code, out, _ = call("verify", tmp_path / "forged.json")
    assert code == 1 and "refuted: encoder" in out and "tacho    proved" in out


def test_a_design_without_a_certificate_is_named(files, tmp_path, call):
    document = json.loads((files / "bank.json").read_text(encoding="utf-8"))
    document["designs"]["encoder"]["certificate"] = None
    (tmp_path / "bare.json").write_text(json.dumps(document), encoding="utf-8")
    code, _, err = call("verify", tmp_path / "bare.json")
    assert code == 2 and "encoder" in err and "no certificate" in err


def test_a_bank_is_verified_by_the_standard_library_alone(files):
    words = [sys.executable, "-c", PROBE, str(files / "bank.json")]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False"]


PROBE = """import sys
from faultrecon.cli.verifying import verified
sound, _, _ = verified(sys.argv[1])
print(sound, 'numpy' in sys.modules)
"""


# ---------------------------------------------------------------- files


def test_a_bank_is_known_by_its_kind_wherever_that_stands(files, tmp_path, call):
    document = json.loads((files / "bank.json").read_text(encoding="utf-8"))
    (tmp_path / "sorted.json").write_text(json.dumps(document, sort_keys=True), encoding="utf-8")
    assert is_bank(tmp_path / "sorted.json")
    assert read_bank(tmp_path / "sorted.json").digest == read_bank(files / "bank.json").digest
    code, out, _ = call("run", tmp_path / "sorted.json", files / "log.csv")
    assert code == 0 and "60 rows in" in out
    assert call("verify", tmp_path / "sorted.json")[0] == 0


def test_definitions_that_go_in_a_circle_are_refuted(files, tmp_path, call):
    document = json.loads((files / "bank.json").read_text(encoding="utf-8"))
    lets = document["designs"]["tacho"]["certificate"]["lets"]
    first, second = list(lets)[:2]
    lets[first], lets[second] = second, first
    (tmp_path / "circle.json").write_text(json.dumps(document), encoding="utf-8")
    code, out, _ = call("verify", tmp_path / "circle.json")
    assert code == 1 and "is defined by itself" in out


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '{"kind": "faultrecon-design"}', '{"a": "faultrecon-bank"}', "[" * 9999, "t,u\n0,1\n"]
)
def test_what_does_not_say_that_it_is_a_bank_is_none(tmp_path, text):
    (tmp_path / "other").write_text(text, encoding="utf-8")
    assert not is_bank(tmp_path / "other") and not is_bank(tmp_path) and not is_bank(tmp_path / "nothing")


def test_a_bank_with_evidence_that_no_file_can_hold_is_refused(files, tmp_path):
    """And numbers of every kind are no such evidence."""
    made = read_bank(files / "bank.json")
    fine = Finding("too large", evidence={"n": np.int64(3), "level": np.inf, "all": (1.0, np.float64(2.0))})
    write_bank(Bank(made.plant, made.designs, {"shunt": fine}), tmp_path / "bank.json")
    assert read_bank(tmp_path / "bank.json").refused["shunt"].evidence == {"n": 3, "level": None, "all": [1.0, 2.0]}
    odd = Finding("odd", evidence={"thing": object()})
    with pytest.raises(InputError, match=r"refused: shunt: evidence: thing: a object"):
        write_bank(Bank(made.plant, made.designs, {"shunt": odd}), tmp_path / "odd.json")
    assert not (tmp_path / "odd.json").exists()


# ---------------------------------------------------------------- run


def test_a_run_names_the_hypotheses_that_have_no_design(files, tmp_path, call):
    """Read whole, and a piece at a time."""
    for more in ((), ("--checkpoint", tmp_path / "here")):
        _, out, _ = call("run", files / "bank.json", files / "log.csv", *more)
        assert "not tested: shunt; " in out and "[[disturbance]]" in out
        _, out, _ = call("run", files / "bank.json", files / "log.csv", "--json", *more)
        assert list(json.loads(out)["untested"]) == ["shunt"]


def test_a_stream_names_them_when_it_ends(files, call, monkeypatch):
    lines = (files / "log.csv").read_bytes()
    for more, said in (((), "not tested: shunt; "), (("--json",), '"untested": {')):
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(lines)))
        _, _, err = call("run", files / "bank.json", "-", *more)
        assert said in err


# ---------------------------------------------------------------- check


def test_a_plant_without_faults_is_told_so_once(files, call):
    code, out, _ = call("check", files / "motor.toml")
    assert code == 1 and out.count("declares no fault") == 1 and "--bank" in out


def test_check_says_where_to_see_what_is_told_apart(files, tmp_path, call):
    bias = '[[fault]]\nname = "bias"\nsensor = "shunt"\nsize = 1.0\n'
    (tmp_path / "two.toml").write_text(MOTOR + AMPLIFIER + bias, encoding="utf-8")
    assert "design PLANT --bank" in call("check", tmp_path / "two.toml")[1]
    assert "design PLANT --bank" not in call("check", files / "driven.toml")[1]
