# SPDX-License-Identifier: BSD-3-Clause
"""The verb `run` on a bank: what its options do, what is refused, and what in a log looks like other units."""

import io
import json
import sys

import numpy as np
import pandas
import pytest

import faultrecon as fr
from faultrecon.finding import InputError
from faultrecon.io.bankfile import write_bank
from faultrecon.io.chunks import survey
from faultrecon.io.logs import read_log, write_log
from faultrecon.io.plausibility import unit_doubts, unit_doubts_of
from faultrecon.io.running import Survey, run_file
from faultrecon.io.watched import monitoring, supervised
from faultrecon.runtime.decision import Rules

T, ROWS = 0.05, 400
MADE = {}


@pytest.fixture
def bank(cart):
    """One hypothesis that has a design."""
    if "bank" not in MADE:
        MADE["bank"] = fr.bank(cart, sensors=("v1",))
    return MADE["bank"]


@pytest.fixture
def columns(cart, drive):
    """A healthy log by column."""
    t, u, y = drive(cart, np.random.default_rng(1), ROWS)
    return {"t": t, **dict(zip((*cart.signals.u.names, *cart.signals.y.names), (*u.T, *y.T), strict=True))}


@pytest.fixture
def files(bank, columns, tmp_path):
    """A bank, a design and a log."""
    write_bank(bank, tmp_path / "bank.json")
    fr.save(bank.designs["v1"], tmp_path / "design.json")
    write_log(tmp_path / "log.csv", columns)
    return tmp_path


# ---------------------------------------------------------------- leap, window, patience


def test_the_options_reach_the_intake_and_the_rules(bank):
    made = supervised(bank, T, leap=2.0, window=9, patience=3)
    assert made.intake.leap == 2.0 and made.monitor.rules == Rules(9, 3)
    assert supervised(bank, T).monitor.rules == Rules() and supervised(bank, T).intake.leap == np.inf
    for more in ({"leap": 2.0}, {"window": 9}, {"patience": 3}):  # a checkpoint of other options does not fit
        assert supervised(bank, T, **more).identity != supervised(bank, T).identity
        made, _ = monitoring(bank, sample_time=T, **more)(Survey("t", {}, 0, None, None, None), None)
        assert made.identity == supervised(bank, T, **more).identity


def test_a_time_that_leaps_is_left_out_where_that_is_asked_for(bank, files, columns):
    wild = columns | {"t": np.where(np.arange(ROWS) == 200, 1e6, columns["t"])}
    write_log(files / "wild.csv", wild)
    kept = fr.watch(bank, files / "wild.csv", leap=10.0)
    assert kept.counts.bad_time == 1 and len(kept.table["t"]) == ROWS - 1
    wild["t"][200] = 1e4
    write_log(files / "wild.csv", wild)
    lost = fr.watch(bank, files / "wild.csv")
    assert lost.counts.bad_time == 0 and lost.counts.late == ROWS - 201


@pytest.mark.parametrize("kept", [False, True])
def test_the_verb_takes_them_for_whole_logs_pieces_and_streams(cli, files, columns, kept):
    write_log(files / "wild.csv", columns | {"t": np.where(np.arange(ROWS) == 200, 1e6, columns["t"])})
    options = ("--leap", 10, "--window", 12, "--patience", 2, "--json")
    more = ("--checkpoint", files / "c.json") if kept else ()
    code, text, _ = cli("run", files / "bank.json", files / "wild.csv", *options, *more)
    assert code == 0 and json.loads(text)["counts"]["bad_time"] == 1


def test_the_verb_takes_them_for_streams(cli, files, columns, monkeypatch):
    lines = (files / "log.csv").read_text().splitlines()
    lines[201] = "1e4" + lines[201][lines[201].index(",") :]
    for leap, answers in ((10, ROWS - 1), ("inf", 201)):  # without, all that follow come too late
        stdin = io.TextIOWrapper(io.BytesIO("\n".join(lines).encode()))
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdin", stdin)
            code, text, said = cli("run", files / "bank.json", "-", "--leap", leap, "--sample-time", T)
        assert code == 0 and sum(line.endswith(",") for line in text.splitlines()) == answers, said


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--leap", 0, "a time may leap 0.0 s ahead"),
        ("--leap", "nan", "a time may leap nan s ahead"),
        ("--window", 1, "the window is 1 samples"),
        ("--patience", 0, "the patience is 0 windows"),
        ("--reorder", -1, "rows are to wait for -1.0 s"),
        ("--sample-time", 0, "the sample time is 0"),
        ("--window", "many", "Invalid value for '--window'"),
    ],
)
@pytest.mark.parametrize("source", ["log.csv", "-"])
def test_options_that_make_no_sense_are_refused(cli, files, option, value, words, source):
    code, _, said = cli("run", files / "bank.json", source if source == "-" else files / source, option, value)
    assert code == 2 and words in said


@pytest.mark.parametrize(("option", "value"), [("--leap", 5), ("--window", 20), ("--patience", 5), ("--reorder", 1)])
@pytest.mark.parametrize("source", ["log.csv", "-"])
def test_a_single_design_has_none_of_them(cli, files, option, value, source):
    code, _, said = cli("run", files / "design.json", source if source == "-" else files / source, option, value)
    assert code == 2 and f"{option} is for a bank" in said


# ---------------------------------------------------------------- other units


def test_a_log_in_other_units_is_doubted_in_the_same_words_by_every_road(cli, files, columns, cart, bank):
    write_log(files / "odd.csv", columns | {"t": 1e3 * columns["t"], "v1": 57.3 * columns["v1"]})
    log = read_log(files / "odd.csv", cart.signals, as_it_came=True)
    words = unit_doubts(cart, log.t, log.u, log.y)
    assert len(words) == 2 and "sample every 50 s" in words[0] and words[1].startswith("v1 goes to ")
    assert fr.watch(bank, files / "odd.csv").doubts() == words
    runs = [(name, more) for name in ("bank", "design") for more in ((), ("--checkpoint", files / "c.json"))]
    for name, more in runs:
        call = ("run", files / f"{name}.json", files / "odd.csv", *more)
        found = json.loads(cli(*call, "--json")[1])["notes"]
        assert [note for note in found if note in words] == list(words), (name, more)
        text = cli(*call)[1]
        assert all(f"  note: {doubt}" in text for doubt in words), (name, more)


def test_a_log_in_its_units_is_not_doubted(cli, files):
    for more in ((), ("--checkpoint", files / "c.json")):
        assert json.loads(cli("run", files / "bank.json", files / "log.csv", *more, "--json")[1])["notes"] == []


def test_doubts_are_of_what_came_not_of_what_limits_left(cart, bank, files, columns):
    """Values beyond what a device can put out are taken away before the monitor sees them."""
    write_log(files / "far.csv", columns | {"v1": np.where(np.arange(ROWS) == 7, -1e3, columns["v1"])})
    assert any("v1 goes to 500 times" in doubt for doubt in fr.watch(bank, files / "far.csv").doubts())


def test_the_survey_keeps_the_span_of_every_signal_whatever_the_pieces(cart, files, columns, monkeypatch):
    columns["v1"][5:9], columns["s1"][:] = (np.nan, np.inf, -np.inf, 7.0), np.nan
    columns["force"][300] = -9.0
    write_log(files / "log.csv", columns)
    for block in (1 << 20, 2000):
        monkeypatch.setattr("faultrecon.io.batches.BLOCK", block)
        found = survey(str(files / "log.csv"), cart.signals, as_it_came=True)
        for name, values in columns.items():
            known = values[np.isfinite(values)]
            wanted = (known.min(), known.max()) if known.size and name != "t" else None
            assert found.spans.get(name) == wanted, name
    assert Survey(**json.loads(json.dumps(found.as_dict()))).spans["force"] == [-9.0, columns["force"].max()]
    assert unit_doubts_of(cart, found.interval, found.spans) == unit_doubts(
        cart, *(getattr(read_log(files / "log.csv", cart.signals, as_it_came=True), name) for name in "tuy")
    )


def test_a_cell_that_is_no_number_is_found_before_the_work_begins(files, columns):
    lines = (files / "log.csv").read_text().splitlines()
    lines[300] = lines[300].rsplit(",", 1)[0] + ",oops"
    (files / "log.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"log\.csv:301  column mix is .oops."):
        survey(str(files / "log.csv"), fr.load(files / "design.json").plant.signals)


@pytest.mark.parametrize("extension", ["csv", "parquet"])
def test_a_file_made_in_pieces_says_in_words_what_the_whole_log_says(bank, columns, tmp_path, extension):
    columns["v1"][150:] += 3.0
    log, out = tmp_path / f"log.{extension}", tmp_path / f"out.{extension}"
    write_log(log, columns)
    run_file(monitoring(bank), bank.plant.signals, log, out=out, piece=90, as_it_came=True)
    whole = fr.watch(bank, log).table
    read = pandas.read_csv(out, keep_default_na=False) if extension == "csv" else pandas.read_parquet(out)
    words = [name for name, values in whole.items() if values.dtype.kind == "U"]
    assert {"mode", "fault", "v1_quality"} <= set(words)
    for name in words:
        assert read[name].dtype.kind in "OU"  # text, not the numbers that stand for it
        assert read[name].tolist() == whole[name].tolist()
    assert len(set(read["v1_quality"])) > 1


def test_a_log_with_its_truth_says_that_it_is_not_scored_a_piece_at_a_time(cli, files, columns):
    write_log(files / "known.csv", {**columns, "true_f_v1": np.zeros(ROWS)})
    call = "run", files / "bank.json", files / "known.csv", "--json"
    kept = "--checkpoint", files / "known.json", "--out", files / "known_out.csv"
    whole, parts = (json.loads(cli(*call, *more)[1]) for more in ((), kept))
    assert whole["scores"] is not None and whole["notes"] == []
    assert parts["notes"][0].startswith("true_f_v1: a log is not scored a piece at a time")
