# SPDX-License-Identifier: BSD-3-Clause
import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import faultrecon as fr
from faultrecon.plant.signals import Channels, Noise, Signals

SHIPPED = Path(str(files("faultrecon") / "data" / "fighter"))
TOLD = json.loads((SHIPPED / "provenance.json").read_text(encoding="utf-8"))
LOGS = sorted(stem for stem, about in TOLD["logs"].items() if about["shipped"])
PLANT = fr.library("fighter")
FULL = round(TOLD["log"]["duration_s"] / TOLD["log"]["sample_time_s"]) + 1


def recorded(stem):
    return fr.read_log(SHIPPED / f"{stem}.parquet", PLANT.signals)


def truth(log):
    """The true states (N, 8) of a log, in the order of the plant."""
    return np.column_stack([log.extra[f"true_x_{name}"] for name in PLANT.signals.x])


def with_sensor(name, state):
    """The fighter with one more healthy sensor, which reads one state."""
    y = PLANT.signals.y
    names, units = (*y.names, name), (*y.units, PLANT.signals.x.units[PLANT.signals.x.index(state)])
    signals = Signals(PLANT.signals.x, PLANT.signals.u, Channels(names, units, (*y.ranges, 1.0)))
    row = np.eye(PLANT.n)[[PLANT.signals.x.index(state)]]
    point = PLANT.point
    assert PLANT.noise is not None
    return replace(
        PLANT,
        signals=signals,
        C=np.vstack([PLANT.C, row]),
        D=np.zeros((4, 4)),
        noise=Noise(PLANT.noise.hold, (*PLANT.noise.sd, 1e-3)),
        operating_point=replace(point, y=(*point.y, 0.0)),
    )


def limit(plant):
    return fr.diagnose(plant).as_dict()["together"]["limit"]


# ---------------------------------------------------------------- the plant


def test_the_airframe_has_one_unstable_mode_and_it_is_real():
    modes = np.linalg.eigvals(PLANT.A)
    unstable = modes[modes.real > 0]
    # provenance.json holds six digits
    assert len(unstable) == 1 and unstable[0].imag == 0
    assert unstable[0].real == pytest.approx(TOLD["loop"]["unstable_mode"], rel=1e-6)


def test_the_other_gyros_do_not_see_the_unstable_mode_at_all():
    A, gyros = PLANT.A, PLANT.C[[0, 2]]
    longitudinal = [PLANT.signals.x.index(s) for s in ("V", "alpha", "q", "theta")]
    lateral = [PLANT.signals.x.index(s) for s in ("beta", "p", "r", "phi")]
    assert not A[np.ix_(lateral, longitudinal)].any() and not gyros[:, longitudinal].any()


def test_no_estimator_beats_the_inverse_of_the_unstable_mode_with_gyros_alone():
    assert limit(PLANT)["value"] == pytest.approx(1 / TOLD["loop"]["unstable_mode"], rel=1e-6)


@pytest.mark.parametrize(("sensor", "state"), [("alpha_vane", "alpha"), ("pitch_angle", "theta"), ("airspeed", "V")])
def test_a_healthy_sensor_of_any_longitudinal_state_lifts_the_limit(sensor, state):
    found = fr.diagnose(with_sensor(sensor, state)).as_dict()["together"]
    assert found["possible"] and not (found["limit"] or {"value": 0.0})["value"]


# ---------------------------------------------------------------- the logs


@pytest.mark.parametrize("stem", LOGS)
def test_every_log_is_whole_and_agrees_with_the_plant_file(stem):
    log = recorded(stem)
    about = TOLD["logs"][stem]
    rows = round(about["strays_from_healthy"]["flown_s"] / TOLD["log"]["sample_time_s"]) + 1
    # flown_s has three digits: half a unit of the last one is 0.05 s, or two and a half samples
    assert abs(len(log) - rows) <= 3 and len(log) <= FULL and not log.missing
    assert np.allclose(np.diff(log.t), TOLD["log"]["sample_time_s"], atol=1e-9)
    assert np.isfinite(log.u).all() and np.isfinite(log.y).all() and np.isfinite(truth(log)).all()
    assert PLANT.noise is not None and PLANT.noise.hold == TOLD["log"]["sample_time_s"]


@pytest.mark.parametrize("stem", LOGS)
def test_a_log_starts_at_the_operating_point_in_the_units_of_the_plant(stem):
    log, point = recorded(stem), PLANT.point
    # float32 of 190 m/s is good to 8e-6, and the logs are rounded to 2^-10 in V and n2 and to 2^-18 elsewhere
    fine = np.array([2.0**-10 if name == "V" else 2.0**-18 for name in PLANT.signals.x])
    assert np.all(abs(truth(log)[0] - point.x) <= fine)
    assert np.all(abs(log.u[0] - point.u) <= [2.0**-10, *3 * [2.0**-18]])


@pytest.mark.parametrize("stem", LOGS)
def test_what_a_gyro_shows_is_rate_plus_fault_plus_the_noise_of_the_plant_file(stem):
    log = recorded(stem)
    noise = log.y - truth(log) @ PLANT.C.T
    noise[:, 1] -= log.extra["true_f_pitch_rate"]
    assert PLANT.noise is not None
    # The standard deviation of N samples is uncertain by 1/sqrt(2 N), at most 1.8 %; five times that.
    np.testing.assert_allclose(noise.std(axis=0), PLANT.noise.sd, rtol=5 / np.sqrt(2 * len(log)))


def test_the_faults_keep_within_size_and_rate_of_the_plant_file():
    fault = PLANT.faults[0]
    for stem in LOGS:
        f = recorded(stem).extra["true_f_pitch_rate"]
        assert f.any() == (TOLD["logs"][stem]["fault"] is not None)
        # the file gives four digits, the log 2^-18 rad/s
        assert abs(f).max() <= fault.size + 5e-5 + 2.0**-18
        assert abs(np.diff(f)).max() <= (fault.rate + 5e-5) * 0.02 + 2.0**-17


def test_the_linear_model_predicts_the_healthy_flight_a_second_ahead_within_six_percent():
    log = recorded("healthy")
    x, u = truth(log) - PLANT.point.x, log.u - PLANT.point.u
    block = np.zeros((12, 12))
    block[:8] = np.hstack([PLANT.A, PLANT.B]) * 0.02
    Phi, z = expm(block), x[:-50]
    for k in range(50):
        z = z @ Phi[:8, :8].T + (u[k : k - 50] + np.roll(u, -1, axis=0)[k : k - 50]) / 2 @ Phi[:8, 8:].T
    error = np.sqrt(((z - x[50:]) ** 2).mean(axis=0) / (x**2).mean(axis=0))
    told = TOLD["logs"]["healthy"]["linear_model_error_1_s_ahead"]
    assert error.max() < 0.06
    # recomputed from rounded columns: half a percent of the motion at most
    np.testing.assert_allclose(error, [told[name] for name in PLANT.signals.x], atol=5e-3)


# ---------------------------------------------------------------- the loop


@pytest.mark.parametrize("name", ["ramp", "step"])
def test_the_faulty_gyro_flies_the_aircraft_into_the_ground_and_the_corrected_one_does_not(name):
    faulty, corrected = recorded(f"{name}_faulty"), recorded(f"{name}_linear")
    assert len(faulty) < FULL and faulty.extra["true_x_theta"][-1] < -0.5
    healthy = recorded("healthy").extra["true_x_theta"]
    assert len(corrected) == FULL and abs(corrected.extra["true_x_theta"] - healthy).max() < 0.1


@pytest.mark.parametrize("name", ["ramp", "step", "sine"])
def test_correction_leaves_at_most_a_quarter_of_the_deviation_in_pitch(name):
    healthy = recorded("healthy").extra["true_x_theta"]

    def largest(stem):
        theta = recorded(stem).extra["true_x_theta"]
        return abs(theta - healthy[: len(theta)]).max()

    assert largest(f"{name}_linear") < largest(f"{name}_faulty") / 4


def test_every_correction_beats_none_and_none_disturbs_the_healthy_flight_by_more_than_the_noise():
    for stem, about in TOLD["logs"].items():
        strays = about["strays_from_healthy"]
        if about["fault"] is None:
            assert strays["pitch_rate_rms_deg_s"] <= 0.05  # the gyro's own noise, deg/s
        elif about["corrected_by"] is not None:
            faulty = TOLD["logs"][f"{stem.split('_')[0]}_faulty"]["strays_from_healthy"]
            assert strays["pitch_angle_largest_deg"] < faulty["pitch_angle_largest_deg"]


def test_linear_theory_holds_every_loop_that_was_flown_stable():
    for facts in TOLD["loop"]["loops"].values():
        # one eigenvalue is zero by structure, and was computed to rounding
        assert facts["slowest_pole"] < 0 and facts["structural_zero"] < 1e-9


# ---------------------------------------------------------------- what ships


def test_the_shipped_files_are_those_of_the_provenance_and_below_a_megabyte_together():
    names = {path.name for path in SHIPPED.iterdir() if path.is_file()}
    assert names == {"provenance.json", *(f"{stem}.parquet" for stem in LOGS)}
    assert sum((SHIPPED / name).stat().st_size for name in names) < 1_000_000


def test_the_recordings_say_which_simulator_and_version_made_them():
    assert TOLD["simulator"].startswith("JSBSim") and TOLD["jsbsim"].count(".") == 2
    root = next((p for p in Path(__file__).parents if (p / "pyproject.toml").exists()), None)
    assert root is not None and (root / TOLD["script"]).is_file()
