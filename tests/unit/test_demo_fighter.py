# SPDX-License-Identifier: BSD-3-Clause
import importlib.util
import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.advise.fighter import ALONE, BASELINE, FAULTS, LOOPS, METHOD, fighter_demo
from faultrecon.io.playback import replay

SHIPPED = Path(str(files("faultrecon") / "data" / "fighter"))
PLANT = fr.library("fighter")


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """The demonstration, run once, and the parts done that it told."""
    told: list[float] = []
    return fighter_demo(tmp_path_factory.mktemp("demo") / "new" / "folder", progress=told.append), told


def log(name):
    return fr.read_log(SHIPPED / f"{name}.parquet", PLANT.signals)


def flown(shown):
    return {(f["fault"], f["loop"]): f for f in shown[0].found["loop"]}


def test_every_shipped_flight_is_scored_with_its_baselines(shown):
    logs = {path.stem for path in SHIPPED.glob("*.parquet")}
    assert {r.log for r in shown[0].rows} == logs and len(logs) == 12
    assert all(list(r.scores) == [BASELINE, ALONE, METHOD] for r in shown[0].rows)
    assert shown[1] == sorted(shown[1]) and shown[1][-1] == 1.0


def test_every_fault_is_found_better_than_not_at_all_and_in_the_corrected_loop_within_three_tenths(shown):
    for row in shown[0].rows:
        if row.acts:
            assert row[METHOD].nrmse < (0.7 if row.log.endswith("faulty") else 0.3)


def test_the_injection_buys_nothing_here_and_costs_noise(shown):
    """What the demonstration says in words is what its numbers say."""
    for row in shown[0].rows:
        assert row[ALONE].leak < 0.6 * row[METHOD].leak
        if row.acts:
            assert row[ALONE].nrmse < row[METHOD].nrmse + 0.01


@pytest.mark.parametrize("fault", FAULTS)
def test_correction_keeps_the_loop_where_the_faulty_sensor_loses_the_aircraft(shown, fault):
    by = flown(shown)
    assert by[fault, "faulty"]["early"] and by[fault, "faulty"]["altitude_at_end"] < 160.0
    for loop in ("linear", "sliding_mode"):
        assert not by[fault, loop]["early"] and by[fault, loop]["altitude_at_end"] > 1000.0
        assert by[fault, "faulty"]["largest_pitch"] > 4 * by[fault, loop]["largest_pitch"]


@pytest.mark.parametrize("fault", FAULTS)
def test_what_remains_is_about_the_error_per_rate_times_the_change_of_the_fault(shown, fault):
    """A quarter either way: the level bounds the worst frequency, which no ramp or step is, and noise is on top."""
    left, change = flown(shown)[fault, "sliding_mode"]["largest_pitch"], 1.5
    assert left == pytest.approx(shown[0].design.level * change, rel=0.25)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("loop", LOOPS)
def test_no_flight_stays_below_the_least_deviation_and_all_have_its_integral_in_common(shown, fault, loop):
    """∫ exp(-λt) Δθ dt = -∫ exp(-λt) f dt/λ whatever corrects the sensor; 2 % is the model's error a second ahead."""
    found, unstable = flown(shown)[fault, loop], float(np.linalg.eigvals(PLANT.A).real.max())
    flight, healthy = log(f"{fault}_{loop}"), log("healthy" if loop == "faulty" else f"healthy_{loop}")
    late = slice(500, len(flight))  # the fault begins at 10 s
    t = flight.t[late] - flight.t[late][0]
    off = np.degrees(flight.extra["true_x_theta"][late] - healthy.extra["true_x_theta"][late])
    assert found["least"] == pytest.approx(-unstable * np.trapezoid(np.exp(-unstable * t) * off, t), rel=0.02)
    assert found["largest_pitch"] > found["least"] > 0.1


def test_the_least_deviation_of_a_ramp_is_its_slope_over_the_square_of_the_mode(shown):
    """0.1 °/s per second; exp(-15 λ) of it ends with the ramp, 6e-6.  The log rounds the fault to 2^-18 rad/s."""
    unstable = float(np.linalg.eigvals(PLANT.A).real.max())
    assert flown(shown)["ramp", "linear"]["least"] == pytest.approx(0.1 / unstable**2, rel=2e-3)


def test_the_loops_are_told_as_the_recording_told_them(shown):
    told = json.loads((SHIPPED / "provenance.json").read_text(encoding="utf-8"))["logs"]
    for (fault, loop), found in flown(shown).items():
        strays = told[f"{'healthy' if fault == 'none' else fault}_{loop}"]["strays_from_healthy"]
        # Three digits there, and the logs round the pitch angle to 2^-18 rad.
        assert found["largest_pitch"] == pytest.approx(strays["pitch_angle_largest_deg"], rel=6e-3, abs=1e-3)
        assert found["ended"] == pytest.approx(strays["flown_s"], rel=6e-3)


@pytest.mark.parametrize("fault", FAULTS)
def test_the_design_is_the_one_that_flew(shown, fault):
    """Fails when the method's gains or its step change: then record the flights again (examples/fighter/record.py)."""
    flight = log(f"{fault}_sliding_mode")
    done = replay(shown[0].design, flight)
    corrected = done.trace.corrected[:, PLANT.signals.y.index("pitch_rate")]
    # A tenth of the noise of the gyro; where the flight began differs by a rounding, which is forgotten by 10 s.
    np.testing.assert_allclose(corrected[500:], flight.extra["used_pitch_rate"][500:], rtol=0, atol=1e-4)


def test_the_height_agrees_with_where_the_recording_ends_a_flight(shown):
    """500 ft above ground, one sample late at most (150 m/s down), and 3 m for integrating recorded angles."""
    for fault in FAULTS:
        assert flown(shown)[fault, "faulty"]["altitude_at_end"] == pytest.approx(500 * 0.3048, abs=6.0)


def test_the_files_it_names_are_there_and_no_others(shown):
    written = shown[0].written
    figures = {f"fighter_{name}.png" for name in ("overview", *FAULTS)}
    assert {p.name for p in written} == {
        "fighter_design.json", "fighter_ramp_sliding_mode_corrected.csv", *figures,
    }  # fmt: skip
    assert {p.name for p in written[0].parent.iterdir()} == {p.name for p in written}
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in written if p.suffix == ".png")


def test_the_design_is_proved_and_its_file_verifies_again(shown):
    assert shown[0].design.method == METHOD
    assert fr.verify(str(shown[0].written[0])).verdict == "proved"


def test_what_it_prints_says_what_is_not_shown(shown):
    text, data = str(shown[0]), shown[0].as_dict()
    for said in (
        "certificate: proved",
        "cannot vanish without another sensor",
        "not because it slides",
        "not analysed",
    ):
        assert said in text
    assert "nan" not in text and all(str(path) in text for path in shown[0].written)
    assert len(data["loop"]) == 11 and len(data["rows"]) == 12 and METHOD in data["rows"][0]


def test_without_matplotlib_it_works_and_says_why_there_is_no_figure(tmp_path, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "matplotlib" else found(name, *a))
    demonstration = fighter_demo(tmp_path)
    assert {p.suffix for p in tmp_path.iterdir()} == {".json", ".csv"}
    assert 'pip install "faultrecon[plot]"' in demonstration.note and demonstration.note in str(demonstration)


def test_the_verb_lists_both_demonstrations_and_guesses_a_misspelt_one(cli):
    code, _, said = cli("demo", "figter")
    assert code == 2 and "did you mean 'fighter'?" in said
    code, _, said = cli("demo", "submarine")
    assert code == 2 and "airliner, fighter" in said
