# SPDX-License-Identifier: BSD-3-Clause
"""A run puts a design to work: what it tells, what it promises, and what a batch of runs adds up to."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigvals

from faultrecon.finding import InputError
from faultrecon.io.library import read_library
from faultrecon.io.logs import read_log, write_log
from faultrecon.io.playback import replay
from faultrecon.numerics.discretise import continuous_covariance
from faultrecon.numerics.hinf import hinf_norm
from faultrecon.simulation.chance import HeldNoise
from faultrecon.simulation.run import initial_cost, simulate, watch
from faultrecon.simulation.scenario import Scenario
from faultrecon.simulation.shapes import Ramp, Sine, Step
from faultrecon.simulation.study import study
from faultrecon.simulation.truth import true_run
from faultrecon.synthesis.pipeline import design

STEP = Scenario.step("pitch_rate", size=0.04, at=2.0, duration=6.0)


@pytest.fixture(scope="module")
def airliner():
    return design(read_library("airliner"))


@pytest.fixture(scope="module")
def polynomial():
    return design(read_library("lipschitz_polynomial"))


def test_the_run_finds_the_fault_at_once_and_says_how_well(airliner):
    run = simulate(airliner, STEP)
    score = run.score()
    assert score["pitch_rate"].delay == 0.0
    assert score["pitch_rate"].nrmse < 0.05
    assert np.isnan(score["roll_rate"].nrmse)
    assert set(score) == {"pitch_rate", "pitch_angle", "roll_rate"}
    assert score.level == airliner.level
    assert "pitch_rate nrmse" in repr(run)
    assert "certified" in str(score)
    with pytest.raises(InputError, match="did you mean 'pitch_rate'"):
        score["pitch_rat"]


def test_all_arrays_have_a_row_per_sample(airliner):
    run = simulate(airliner, STEP)
    plant = airliner.plant
    sizes = {"u": len(plant.signals.u), "y": plant.p, "x": plant.n, "f": 3, "x_hat": plant.n, "f_hat": 3}
    for name, size in (sizes | {"corrected": plant.p, "ok": plant.p}).items():
        assert getattr(run, name).shape == (301, size)
    assert run.ok.all()
    assert run.corrected == pytest.approx(run.y - run.f_hat @ plant.F_f.T)


def test_the_table_is_a_log_that_replays_to_the_same_estimate(airliner, tmp_path):
    run = simulate(airliner, STEP)
    table = run.to_table()
    assert list(table.columns[:2]) == ["t", "n2"]
    assert {"true_f_pitch_rate", "f_pitch_rate", "pitch_rate_corrected", "airspeed_ok"} <= set(table.columns)
    path = tmp_path / "run.parquet"
    write_log(path, run.columns())
    again = replay(airliner, read_log(path, airliner.plant.signals))
    # A log's sample time is the median of its intervals, which differs from 0.02 in the last place.
    assert again.trace.fault == pytest.approx(run.f_hat, abs=1e-12)
    assert again.scores()["pitch_rate"].nrmse == pytest.approx(run.score()["pitch_rate"].nrmse)


def test_without_disturbance_noise_or_error_nothing_is_wrong(airliner):
    run = simulate(airliner, STEP.quiet())
    # What is left is rounding: x stays at the operating point and f̂ is what the faulty sensor shows beyond it.
    assert np.abs(run.f - run.f_hat).max() < 1e-12
    assert run.score().achieved is None
    assert run.score().outside == ()


def test_an_initial_error_decays_whatever_the_fault_does(airliner):
    scenario = replace(STEP.quiet(), duration=120.0, initial_error={"q": 0.01, "theta": 0.01})
    wild = scenario.with_fault("pitch_rate", Ramp(0.3, 10.0) + Sine(0.2, 1.0))
    errors = [simulate(airliner, s) for s in (scenario, wild)]
    for run in errors:
        error = np.linalg.norm((run.x - run.x_hat) / airliner.plant.signals.x.ranges, axis=1)
        # The slowest mode decays at 0.0695/s, so by e^-8.3 = 2.4e-4 in two minutes; modes exchange a factor.
        assert error[-1] < 1e-3 * error.max()
    assert errors[0].x - errors[0].x_hat == pytest.approx(errors[1].x - errors[1].x_hat, abs=1e-9)


def test_the_worst_sine_reaches_the_gain_of_the_closed_loop_and_stays_below_the_level(airliner):
    plant, o = airliner.plant, airliner.observer
    W, V = (plant.letters()[k] for k in "WV")
    F, Dy = plant.F_w, o.Df[:, o.inputs :] @ plant.F_w
    B = plant.E_w - o.B[:, o.inputs :] @ F
    peak = hinf_norm(o.A, B @ W, V @ o.Cf, -V @ Dy @ W)
    jw = 1j * peak.frequency
    gain = V @ (o.Cf @ np.linalg.solve(jw * np.eye(plant.n) - o.A, B) - Dy) @ W
    worst = np.linalg.svd(gain)[2][0].conj()
    waves = {
        d.name: Sine(float(abs(a)) * d.size, peak.frequency, float(np.angle(a)))
        for d, a in zip(plant.attenuated, worst, strict=True)
    }
    run = simulate(airliner, Scenario(duration=60 * 2 * np.pi / peak.frequency, disturbances=waves, noise=False))
    # Sixty periods, so what the start misses is about 1/60 in energy; sampling at 20 ms costs less.
    assert 0.97 * peak.value < run.score().achieved <= peak.value * (1 + 1e-3)
    assert peak.value < airliner.level
    assert run.score().outside == ()


def test_what_the_certificate_does_not_cover_is_said(airliner, polynomial):
    slow = replace(airliner.plant, A=0.9 * airliner.plant.A)
    assert any("not the plant" in why for why in simulate(airliner, STEP.quiet(), plant=slow).score().outside)
    far = Scenario(duration=1.0, sample_time=0.01, x0=(0.3, 0.0))
    assert any("domain of x1" in why for why in simulate(polynomial, far).score().outside)
    baseline = design(read_library("lipschitz_aircraft"), "open-loop", certify=False)
    assert simulate(baseline, Scenario.healthy(duration=0.1)).score().outside == ("there is none",)


@pytest.mark.parametrize("seed", range(4))
def test_noise_that_is_declared_is_counted_and_stays_below_the_level(airliner, seed):
    gusty = replace(STEP, seed=seed, disturbances={"gust_w": HeldNoise(1.1, 0.5)})
    for scenario in (replace(STEP, seed=seed), gusty):
        score = simulate(airliner, scenario).score()
        assert score.outside == () and score.undeclared == ()
        assert 0 < score.achieved <= score.level  # by a factor of four: what sampling may add is far less


def test_noise_that_is_not_declared_leaves_nothing_to_compare_and_its_sensors_are_named(airliner):
    plant = airliner.plant
    kept = tuple(d for d in plant.disturbances if d.name != "noise_pitch_rate")
    some = design(replace(plant, disturbances=kept))
    score = simulate(some, STEP).score()
    assert score.achieved is None and score.undeclared == ("pitch_rate",)
    why = "noise of pitch_rate acts and is not among the disturbances"
    assert score.outside == (why,) and f"not comparable: {why}; --no-noise compares" in str(score)
    assert "nothing disturbs: no gain to compare" in str(simulate(some, STEP.quiet()).score())


def test_faults_that_never_act_have_a_dash_and_no_nan(airliner):
    assert "nan" not in str(simulate(airliner, STEP).score())


def test_a_design_for_some_faults_meets_a_plant_with_more(airliner):
    some = design(read_library("airliner"), faults=["pitch_rate"])
    run = simulate(some, STEP.with_fault("roll_rate", Step(0.04)).quiet(), plant=airliner.plant)
    assert run.f.shape == (301, 1)
    assert any("roll_rate acts" in why for why in run.score().outside)
    with pytest.raises(InputError, match="no fault 'roll_rate'"):
        simulate(some, STEP.with_fault("roll_rate", Step(0.04)))
    with pytest.raises(InputError, match="to simulate has"):
        simulate(some, STEP, plant=read_library("lipschitz_aircraft"))


def test_a_step_beyond_the_stability_limit_is_refused_before_anything_runs(airliner):
    with pytest.raises(InputError, match="RK4 is unstable"):
        simulate(airliner, replace(STEP, sample_time=0.5, duration=1e9), scheme="rk4")


def test_the_initial_cost_bounds_what_an_initial_error_can_cause(airliner):
    o, V = airliner.observer, airliner.plant.letters()["V"]
    energy = continuous_covariance(o.A.T, (V @ o.Cf).T, np.eye(3))  # ∫|f - f̂|² dt = e(0)' X e(0) without disturbance
    ranges = np.diag(airliner.plant.signals.x.ranges)
    cost = (
        np.array([[initial_cost(airliner, a + b) - initial_cost(airliner, a - b) for a in ranges] for b in ranges]) / 4
    )
    ratios = eigvals(ranges @ energy @ ranges, cost).real
    # V pays for disturbances as well, so it is larger, but not by orders: units that were mixed up would show.
    assert np.all(ratios < 1.0)
    assert ratios.max() > 0.1


def test_several_designs_can_watch_the_same_truth(airliner):
    truth = true_run(airliner.plant, STEP)
    loop = design(airliner.plant, "open-loop")
    assert np.array_equal(watch(airliner, truth).f_hat, simulate(airliner, STEP).f_hat)
    assert np.array_equal(watch(loop, truth).y, truth.y)


def test_a_study_is_every_design_on_every_scenario_under_every_seed(airliner):
    designs = {"ours": airliner, "open loop": design(airliner.plant, "open-loop")}
    gusty = replace(STEP, disturbances={"gust_w": HeldNoise(1.1, 0.5)}, name="gusty")
    told = []
    found = study(designs, [STEP, gusty], seeds=range(4), progress=told.append)
    assert len(found.results) == 2 * 2 * 4 * 3
    assert told[-1] == 1.0
    rows = {(r["scenario"], r["design"], r["fault"]): r for r in found.summary()}
    gust = rows["gusty", "ours", "pitch_rate"]
    assert gust["runs"] == 4
    assert gust["nrmse_low"] <= gust["nrmse"] <= gust["nrmse_high"]
    assert gust["nrmse"] < rows["gusty", "open loop", "pitch_rate"]["nrmse"]
    assert _same(found, designs, gusty)
    assert len(found.to_table()) == 48
    assert "open loop" in str(found)
    with pytest.raises(InputError, match="nothing to study"):
        study({}, [STEP])


def _same(found, designs, gusty) -> bool:
    """Equal up to nan, which is not equal to itself."""
    again = study(designs, [STEP, gusty], seeds=range(4))
    return repr(found.results) == repr(again.results)


def test_a_run_draws_itself(airliner):
    figure = simulate(airliner, STEP).plot()
    assert len(figure.axes) == 6
    assert "step on pitch_rate" in figure.get_suptitle()
