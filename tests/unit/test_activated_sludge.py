# SPDX-License-Identifier: BSD-3-Clause
"""Two tanks of BSM1: what was recorded, what was fitted, what mismatch leaves of the fouling fault."""

import json
from importlib.resources import files
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from pyarrow import csv

import faultrecon as fr
from faultrecon.advise.activated_sludge import TANKS, Case, changed, fit_of, fouling, reactor, recording
from faultrecon.advise.fouling_demo import MODEL, SHOWN, activated_sludge_demo
from faultrecon.methods.registry import method

SHIPPED = Path(str(files("faultrecon") / "data" / "activated_sludge"))
PROVENANCE = json.loads((SHIPPED / "provenance.json").read_text())
FIT = Path(__file__).parents[2] / "examples" / "activated_sludge" / "fit.py"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The demonstration with the two methods of its figure, a second each, and the parts done that it told."""
    told: list[float] = []
    out = tmp_path_factory.mktemp("demo") / "new"
    return activated_sludge_demo(out, progress=told.append, methods=[SHOWN]), told


@pytest.fixture(scope="module")
def found(written):
    """What that found."""
    return written[0]


@pytest.mark.parametrize("tank", TANKS)
def test_the_reading_is_the_healthy_one_times_the_gain_with_noise_of_the_declared_size(tank):
    log = recording(tank)
    rest = log.y[:, 0] - (1 + log.extra["true_f_fouling"]) * log.extra["true_x_substrate"]
    # The mean of 4,000 squares of normal numbers is within 2.2 % of its expectation (one sigma); five of them.
    assert np.sqrt(np.mean(rest**2)) == pytest.approx(PROVENANCE["log"]["noise_sd_g_N_per_m3"], rel=0.06)
    assert abs(rest.mean()) < 5 * 0.1 / np.sqrt(len(rest))


@pytest.mark.parametrize("tank", TANKS)
def test_the_log_is_healthy_for_a_week_and_loses_a_third_of_its_gain_by_a_ramp(tank):
    log, fault = recording(tank), PROVENANCE["fault"]
    f = log.extra["true_f_fouling"]
    assert not f[log.t <= fault["onset_h"]].any() and (np.diff(f) <= 0).all()
    assert f[log.t > fault["reached_h"]] == pytest.approx(-fault["gain_lost"], abs=1e-6)
    assert len(log) == PROVENANCE["log"]["samples"] and not log.missing
    assert (SHIPPED / f"{tank}.csv").stat().st_size < 1e6


@pytest.mark.parametrize("tank", TANKS)
def test_the_model_in_open_loop_leaves_the_residual_that_the_fit_reports(tank):
    case = Case.of(tank)
    told = json.loads((SHIPPED / "fit.json").read_text())[tank]
    residual = (case.model - case.log.y[:, 0])[case.unseen]
    # The fit starts from the first reading, the estimator from the operating point: forgotten within a day.
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(told["residual_rms_held_out"], rel=0.01)


@pytest.mark.parametrize("tank", TANKS)
def test_the_polytopic_form_is_the_equation_and_the_slope_its_derivative(tank):
    for name in ("ts-guaranteed-cost", "ts-mean-value"):
        assert [f for f in method(name).assumptions(reactor(tank)) if f.severity == "fatal"] == []


def test_the_plant_files_are_what_the_fit_writes_from_the_logs(tmp_path, monkeypatch):
    spec = spec_from_file_location("fit", FIT)
    fit = module_from_spec(spec)
    spec.loader.exec_module(fit)
    for path in SHIPPED.glob("*.csv"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.setattr("sys.argv", ["fit.py", "--data", str(tmp_path)])
    fit.main()
    for tank in TANKS:
        made, stored = fr.load(tmp_path / f"{tank}.toml"), reactor(tank)
        for name, value in stored.nonlinearity.phi.constants.items():
            # Least squares stops within 1e-8 of the cost, so c and rho, nearly collinear, within 1e-3 of each other.
            assert made.nonlinearity.phi.constants[name] == pytest.approx(value, rel=2e-3)


def test_two_states_leave_three_percent_of_the_fault_in_the_first_tank_and_a_tenth_in_the_last(found):
    assert found.size == pytest.approx(0.35)
    assert found.of("first_tank", "ts-guaranteed-cost").rmse == pytest.approx(0.030, rel=0.1)
    assert found.of("last_tank", "ts-guaranteed-cost").rmse == pytest.approx(0.087, rel=0.1)
    for tank in TANKS:
        assert found.of(tank, "ts-guaranteed-cost").rmse < 0.5 * found.of(tank, "simulate-invert").rmse


def test_the_budget_from_healthy_data_predicts_what_is_left_within_a_factor_of_one_and_a_half(found):
    for one in found.found:
        assert 1 / 1.5 < one.rmse / (one.budget.total / found.size) < 1.5, (one.tank, one.method)


def test_mismatch_and_not_the_uncertainty_of_the_fit_is_the_limit(found):
    for one in found.found:
        assert one.budget.missed > 4 * one.budget.parameters, (one.tank, one.method)
    first, last = (found.of(tank, "ts-guaranteed-cost").budget for tank in TANKS)
    assert last.missed > 3 * first.missed


def test_only_the_product_of_yield_growth_and_biomass_counts(found):
    for one in found.found:
        # x1 = n_in (1 + g/D): a is 0.7 % more than a factor, by g/D.
        assert one.gauges["a"] == pytest.approx(one.gauges["c"], rel=0.02)
        assert one.gauges["n_in"] == pytest.approx(one.gauges["c"], rel=0.02)


def test_one_percent_of_the_feed_analyser_is_about_one_percent_of_the_gain(found):
    for one in found.found:
        assert one.gauges["feed analyser"] == pytest.approx(-0.01, rel=0.1)


def test_the_additive_design_stays_finite_where_the_reading_nearly_vanishes():
    (one,) = fouling(["last_tank"], ["ts-additive"]).found
    case = Case.of("last_tank")
    low = recording("last_tank").y.min() / case.plant.polytopic.boxes["x"][1][0]
    assert low < 0.1  # a tenth of the smallest reading of the box: 1/ĥ would ask for steps ten times as short
    f_hat = case.estimate(fr.design(case.plant, "ts-additive"))
    assert np.isfinite(f_hat).all() and np.abs(f_hat).max() < 2.0
    # Inside the box nothing is changed, and the estimate is as good as those of its neighbours, 0.07 to 0.18.
    assert one.within < 0.12 < one.rmse


def test_a_reading_of_exactly_nothing_moves_the_additive_estimate_by_no_more_than_a_hold():
    plant = reactor("first_tank")
    observer = method("ts-additive").observer(plant, fr.design(plant, "ts-additive").gains)
    term = observer.nonlinear
    empty = np.array([130.0, 0.0, 0.2, 0.0])  # [x̂; f̂; y], no ammonium and none shown
    rate = observer.A @ np.array([0.0, -plant.point.x[1], 0.2]) + term.phi(empty, np.array(plant.point.u), [0.0])
    assert np.isfinite(rate).all()


def test_the_published_design_estimates_nothing_on_this_plant_either():
    (one,) = fouling(["first_tank"], ["ts-published"]).found
    f = Case.of("first_tank").f
    assert one.rmse == pytest.approx(np.sqrt(np.mean(f[f != 0] ** 2)) / 0.35, rel=1e-6)


def test_a_method_that_does_not_fit_is_told_with_its_reason(found):
    refused = fouling(["first_tank"], ["lipschitz-hinf"])
    assert refused.found == () and "multiplicative" in refused.refused["first_tank", "lipschitz-hinf"]
    with pytest.raises(fr.InputError, match="no result"):
        refused.of("first_tank", "lipschitz-hinf")


def test_what_is_not_there_is_told_by_what_is():
    with pytest.raises(fr.InputError, match="did you mean 'first_tank'"):
        reactor("first_tanc")
    with pytest.raises(fr.InputError, match="no constant 'd'"):
        changed(reactor("first_tank"), "d", 0.1)
    assert fit_of("last_tank")[0] == ("c", "b", "rho")


def test_the_report_holds_every_method_its_budget_and_the_gauges(found):
    text = str(found)
    for word in ("expected", "missed", "feed analyser", "simulate-invert", "last_tank"):
        assert word in text
    plain = json.loads(json.dumps(found.as_dict()))
    assert {row["method"] for row in plain["found"]} == {"simulate-invert", "ts-guaranteed-cost"}


# ---------------------------------------------------------------- the demonstration


def test_the_files_it_names_are_there_and_no_others(written):
    found, told = written
    names = {"table.csv", "fouling.png", *(f"{t}_{what}" for t in TANKS for what in ("design.json", "corrected.csv"))}
    assert {path.name for path in found.written} == names
    assert {path.name for path in found.written[0].parent.iterdir()} == names
    assert told == sorted(told) and told[-1] == 1.0


def test_the_table_holds_a_row_for_each_method_and_tank(written):
    table = csv.read_csv(written[0].written[0].parent / "table.csv").to_pydict()
    pairs = list(zip(table["tank"], table["method"], strict=True))
    assert sorted(pairs) == sorted((t, m) for t in TANKS for m in (SHOWN, MODEL))
    k = pairs.index(("first_tank", SHOWN))
    assert table["rmse"][k] == written[0].of("first_tank", SHOWN).rmse


def test_the_corrected_log_is_nearer_to_the_true_ammonium_than_the_measured_one(written):
    for tank in TANKS:
        table = csv.read_csv(written[0].written[0].parent / f"{tank}_corrected.csv").to_pydict()
        true, late = recording(tank).extra["true_x_substrate"], slice(-1000, None)
        sensor = reactor(tank).signals.y.names[0]
        off = {name: np.std((np.array(table[name]) - true)[late]) for name in (sensor, f"{sensor}_corrected")}
        assert off[f"{sensor}_corrected"] < 0.5 * off[sensor]


def test_what_ships_is_conditional_and_verifies_as_such(written):
    for tank in TANKS:
        path = written[0].written[0].parent / f"{tank}_design.json"
        assert fr.verify(str(path)).verdict == "assumed"


def test_it_says_what_it_wrote_in_text_and_in_json(written):
    found = written[0]
    assert f"wrote {found.written[-1]}" in str(found)
    assert json.loads(json.dumps(found.as_dict()))["written"] == [str(path) for path in found.written]
