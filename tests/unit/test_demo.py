# SPDX-License-Identifier: BSD-3-Clause
import importlib.util
import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from pyarrow import csv

import faultrecon as fr
from faultrecon.advise.airliner import AIR, FAULTS, airliner_demo

SHIPPED = Path(str(files("faultrecon") / "data" / "airliner"))
SENSORS = ("pitch_rate", "pitch_angle", "roll_rate")


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """The demonstration, run once, and the parts done that it told."""
    told: list[float] = []
    demonstration = airliner_demo(tmp_path_factory.mktemp("demo") / "new" / "folder", progress=told.append)
    return demonstration, told


def rows(shown):
    return {(r.log, r.fault): r for r in shown[0].rows}


@pytest.mark.parametrize("fault", ["pitch_rate", "pitch_angle"])
def test_pitch_faults_in_calm_air_are_found_within_a_tenth_and_better_than_by_the_open_loop(shown, fault):
    row = rows(shown)[f"{fault}_calm", fault]
    assert row["lipschitz-hinf"].nrmse < 0.10 and row["lipschitz-hinf"].nrmse < row["open-loop"].nrmse


def test_every_single_fault_is_found_better_than_not_at_all(shown):
    for fault in SENSORS:
        for air in AIR:
            assert rows(shown)[f"{fault}_{air}", fault]["lipschitz-hinf"].nrmse < 1.0


def test_every_log_is_scored_for_every_fault(shown):
    assert set(rows(shown)) == {(f"{log}_{air}", fault) for log in FAULTS for air in AIR for fault in SENSORS}
    assert shown[1] == sorted(shown[1]) and shown[1][-1] == 1.0


def test_the_design_is_proved_and_its_file_verifies_again(shown):
    design, written = shown[0].design, {path.name: path for path in shown[0].written}
    assert design.verification is not None and design.verification.verdict == "proved"
    assert fr.verify(str(written["design.json"])).verdict == "proved"
    again = fr.load(written["design.json"], plant=fr.library("airliner"))
    assert isinstance(again, fr.Design) and again.level == design.level


def test_the_files_it_names_are_there_and_no_others(shown):
    written = shown[0].written
    assert {p.name for p in written} == {
        "design.json", "pitch_rate_calm_corrected.csv", "overview.png", "pitch_rate_calm.png",
    }  # fmt: skip
    assert {p.name for p in written[0].parent.iterdir()} == {p.name for p in written}
    assert all(p.stat().st_size > 1000 for p in written)
    assert written[2].read_bytes().startswith(b"\x89PNG")


def test_the_corrected_log_has_the_columns_that_are_promised_and_takes_the_fault_out(shown):
    table = csv.read_csv(next(p for p in shown[0].written if p.suffix == ".csv"))
    signals = fr.library("airliner").signals
    corrected = [name for name in signals.y if name in SENSORS]
    assert table.column_names == [
        *("t", *signals.u, *signals.y),
        *(f"f_{name}" for name in SENSORS),
        *(f"{name}_corrected" for name in corrected),
        *(f"{name}_ok" for name in signals.y),
    ]
    column = {name: table[name].to_numpy() for name in ("pitch_rate", "f_pitch_rate", "pitch_rate_corrected")}
    # y - f̂ is rounded once, and both sides are read back from their shortest decimals, which are exact.
    np.testing.assert_allclose(
        column["pitch_rate_corrected"], column["pitch_rate"] - column["f_pitch_rate"], rtol=0, atol=1e-15
    )


def test_what_it_prints_has_the_verdict_the_table_and_the_files(shown):
    text, data = str(shown[0]), shown[0].as_dict()
    assert "certificate: proved" in text and "lipschitz-hinf" in text and "nan" not in text
    assert all(str(path) in text for path in shown[0].written)
    assert data["design"]["verdict"] == "proved" and len(data["rows"]) == 30 and data["note"] == ""


def test_without_matplotlib_it_works_and_says_why_there_is_no_figure(tmp_path, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "matplotlib" else found(name, *a))
    demonstration = airliner_demo(tmp_path)
    assert [p.suffix for p in demonstration.written] == [".json", ".csv"]
    assert 'pip install "faultrecon[plot]"' in demonstration.note and demonstration.note in str(demonstration)
    assert {p.suffix for p in tmp_path.iterdir()} == {".json", ".csv"}


def test_a_file_where_the_folder_should_be_is_refused_before_any_work(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(fr.InputError, match="taken: cannot be made a folder"):
        airliner_demo(tmp_path / "taken")


# ---------------------------------------------------------------- what ships


def test_every_shipped_file_is_below_a_megabyte():
    sizes = {path.name: path.stat().st_size for path in SHIPPED.iterdir() if path.is_file()}
    assert len(sizes) >= 13 and max(sizes.values()) < 1_000_000, sizes


def test_the_recordings_say_which_simulator_and_version_made_them():
    told = json.loads((SHIPPED / "provenance.json").read_text(encoding="utf-8"))
    assert told["simulator"].startswith("JSBSim") and told["jsbsim"].count(".") == 2
    root = next((p for p in Path(__file__).parents if (p / "pyproject.toml").exists()), None)
    assert root is not None and (root / told["script"]).is_file()


def test_the_shipped_plant_file_is_the_library_plant():
    plant = fr.load(SHIPPED / "airliner.toml")
    assert isinstance(plant, fr.Plant) and plant.digest() == fr.library("airliner").digest()
    assert [f.name for f in plant.faults] == list(SENSORS)


@pytest.mark.parametrize("name", [f"{fault}_{air}" for fault in FAULTS for air in AIR])
def test_every_recording_reads_whole_and_carries_its_true_faults(name):
    log = fr.read_log(SHIPPED / f"{name}.parquet", fr.library("airliner").signals)
    assert len(log) == 3001 and not log.missing and not log.ignored
    acting = {fault for fault in SENSORS if np.any(log.extra[f"true_f_{fault}"])}
    fault = name.rpartition("_")[0]
    assert acting == ({*SENSORS} if fault == "all_three" else {fault} & {*SENSORS})


def test_the_csv_and_the_parquet_of_a_flight_are_one_recording():
    signals = fr.library("airliner").signals
    a, b = (fr.read_log(SHIPPED / f"pitch_rate_calm.{kind}", signals) for kind in ("csv", "parquet"))
    assert np.array_equal(a.t, b.t)
    # The CSV is rounded to a few decimals to stay small; far below the noise of every sensor.
    noise = fr.library("airliner").noise
    assert noise is not None and np.all(np.abs(a.y - b.y).max(axis=0) <= 0.02 * np.array(noise.sd))
