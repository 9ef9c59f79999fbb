# SPDX-License-Identifier: BSD-3-Clause
"""What the Kalman filters take for noise of the sensors, and what the report says of the noise in their estimates."""

import time
from dataclasses import replace

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.methods.kalman_steps import tuned
from faultrecon.plant.fault import Disturbance

JOINT = fr.library("flexible_joint_sampled")
assert JOINT.noise is not None
T, SD = JOINT.noise.hold, np.array(JOINT.noise.sd)
FIRST, SECOND = JOINT.signals.y.names[:2]
STATE = JOINT.signals.x.names[1]


def variances(*disturbances, sd=JOINT.noise.sd):
    assert JOINT.noise is not None
    plant = replace(JOINT, disturbances=disturbances, noise=replace(JOINT.noise, sd=tuple(sd)))
    return tuned(plant, T).R


def test_a_disturbance_that_moves_states_and_shows_in_sensors_adds_to_their_variances():
    gust = Disturbance("gust", {STATE: 1.0}, {FIRST: 0.5, SECOND: -2.0}, size=0.3)
    added = np.zeros(JOINT.p)
    added[:2] = 0.15**2, 0.6**2
    assert variances(gust) == pytest.approx(SD**2 + added, rel=1e-14)


def test_one_that_shows_in_two_sensors_is_the_noise_of_neither():
    assert variances(Disturbance("hum", {}, {FIRST: 1.0, SECOND: 1.0}, size=0.1))[:2] == pytest.approx(
        SD[:2] ** 2 + 0.01, rel=1e-14
    )


def test_the_noise_of_a_sensor_that_is_declared_as_a_disturbance_too_counts_once():
    own = tuple(Disturbance(f"noise of {n}", {}, {n: 1.0}, size=s) for n, s in zip(JOINT.signals.y, SD, strict=True))
    assert (variances(*own) == variances()).all()
    assert variances(replace(own[0], size=3 * SD[0]))[0] == pytest.approx(9 * SD[0] ** 2, rel=1e-14)


def test_a_sensor_without_declared_noise_has_that_of_its_disturbance():
    noise = Disturbance("noise", {}, {FIRST: 1.0}, size=0.01)
    assert variances(noise, sd=(0.0, *SD[1:]))[0] == pytest.approx(1e-4, rel=1e-14)


def test_told_of_the_gusts_that_its_sensors_see_the_filter_of_the_airliner_is_two_times_better():
    from faultrecon.simulation.chance import HeldNoise
    from faultrecon.simulation.run import watch
    from faultrecon.simulation.shapes import Step
    from faultrecon.simulation.truth import true_run

    plant = fr.library("airliner").with_faults(["pitch_rate"])
    assert plant.noise is not None
    gusts = {d.name: HeldNoise(d.size, 0.5) for d in plant.disturbances if d.into}
    fault = Step(plant.faults[0].size).starting(5.0)
    run = true_run(plant, fr.Scenario.fault("pitch_rate", fault, duration=20.0, disturbances=gusts))
    deaf = replace(plant, disturbances=tuple(replace(d, on={}) for d in plant.disturbances if d.into))
    error, before = (watch(fr.design(p, "augmented-ekf"), run).score()["pitch_rate"].nrmse for p in (plant, deaf))
    assert 2.0 * error < before


@pytest.mark.parametrize("name", ["augmented-ekf", "augmented-ukf"])
def test_the_reported_noise_is_that_of_the_settled_filter(name):
    design = fr.design(JOINT, name)
    rng, N = np.random.default_rng(4), 8000
    y = np.array(JOINT.point.y) + rng.normal(size=(N, JOINT.p)) * SD
    shown = design.estimator().replay(T * np.arange(N), np.tile(JOINT.point.u, (N, 1)), y).fault[1000:]
    said = design.details.noise_sd
    assert said is not None
    # 7000 samples with a memory of some 50 are 140 independent ones: a deviation is known to 6 %; three times that.
    assert shown.std(axis=0) == pytest.approx(list(said.values()), rel=0.18)


def test_the_report_of_a_large_filter_takes_no_derivatives_of_its_steps():
    began = time.process_time()
    said = fr.design(fr.library("airliner"), "augmented-ukf").details.noise_sd
    assert said is not None and min(said.values()) > 1e-4
    assert time.process_time() - began < 10.0  # half a second, against half a minute with derivatives
