# SPDX-License-Identifier: BSD-3-Clause
"""Plants that come sampled, under the sampled proportional-integral observer: their own map is the prediction."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import faultrecon as fr
from faultrecon.cli.app import app
from faultrecon.diagnosis.conditions import constant_fault
from faultrecon.methods.euler_pi import EulerObserver, EulerPi, EulerPiMinimumNorm, EulerPiRamp
from faultrecon.methods.sampled_letters import decay_rate
from faultrecon.methods.sampled_plants import LONGEST, sampled_decay_rate
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.matrices import plant_from_matrices

T = 0.01
JOINT = fr.library("flexible_joint_sampled")
LINEAR = replace(JOINT, nonlinearity=None)
MAP = fr.discretised(JOINT, T)  # φ held: this map is the plant, and no longer an approximation of one
LINEAR_MAP = fr.discretised(LINEAR, T)


@pytest.fixture(scope="module")
def made():
    return fr.design(MAP, "euler-pi")


@pytest.mark.parametrize("kind", [EulerPi, EulerPiRamp, EulerObserver, EulerPiMinimumNorm])
def test_the_design_for_the_sampled_plant_is_that_for_the_continuous_one_at_this_sample_time(kind):
    ours, theirs = fr.design(LINEAR_MAP, kind.name), fr.design(LINEAR, kind.name, fix={"T": T})
    # The program is the same but for the rounding of its data, and is solved to 1e-9.  At the optimum the level is flat
    # in the gains, so that they agree to the root of that, times the condition of P that they are read from, some 100.
    assert ours.level == pytest.approx(theirs.level, rel=1e-7)
    assert np.allclose(ours.gains["H"], theirs.gains["H"], rtol=0, atol=1e-12)
    for k in ("L", "F"):
        assert np.abs(ours.gains[k] - theirs.gains[k]).max() <= 1e-2 * np.abs(theirs.gains[k]).max(initial=1e-9)
    assert np.allclose(T * ours.gains["Φ₁"], np.eye(4), rtol=0, atol=1e-15)


@pytest.mark.parametrize("kind", [EulerPi, EulerPiRamp, EulerObserver, EulerPiMinimumNorm])
def test_the_same_gains_make_the_same_observer(kind):
    theirs = fr.design(JOINT, kind.name)
    gains = theirs.gains
    ours = kind().observer(MAP, {**gains, "Φ₁": np.eye(4) / T})
    for name in ("A", "B", "Cx", "Dx", "Cf", "Df"):
        assert np.allclose(getattr(ours, name), getattr(theirs.observer, name), rtol=0, atol=1e-11)
    assert ours.nonlinear is not None and theirs.observer.nonlinear is not None
    assert np.allclose(ours.nonlinear.into, theirs.observer.nonlinear.into, rtol=0, atol=1e-14)


def test_the_certificate_is_proved_and_says_that_the_map_is_exact(made):
    assert made.certificate.verify().verdict == "proved"
    assert "the map of the plant as it was given, exact" in made.certificate.scope
    assert any("own map" in step.label for step in made.certificate.steps)
    off = EulerPi().mismatch(MAP, T).size
    assert off is not None and not off.any()


def test_a_constant_fault_is_reconstructed_to_rounding_whatever_is_decoupled(made):
    scenario = fr.Scenario.step("actuator", size=0.2, duration=8.0).quiet()
    scenario = scenario.with_disturbance("frame", lambda t: 100.0 * np.sign(np.sin(50.0 * t)))
    run = fr.simulate(made, scenario)
    # The slowest mode falls by 0.885 per sample, to 1e-37 in 700; what stays is the rounding of states up to 12, times
    # |F| T = 5
    assert np.abs(run.f_hat - run.f)[-100:].max() < 1e-12
    assert run.truth.left_domain() == ()


def test_the_error_of_a_continuous_truth_is_that_of_its_map():
    """Where all that drives the plant is held, the sampled plant and the continuous one do the same."""
    scenario = fr.Scenario.step("actuator", size=0.2, at=1.0, duration=3.0, input_hold="sample").quiet()
    scenario = scenario.with_input("voltage", lambda t: 0.3 * np.sin(3.0 * t))
    design = fr.design(LINEAR_MAP, "euler-pi")
    one, other = fr.simulate(design, scenario), fr.simulate(design, scenario, plant=LINEAR)
    assert np.allclose(one.x, other.x, rtol=0, atol=1e-10)  # the tolerance of the truth
    assert np.allclose(
        one.f_hat, other.f_hat, rtol=0, atol=1e-8
    )  # times |F| T = 5 and the memory of the loop, 10 samples


def test_another_sample_time_is_refused_with_both_numbers():
    with pytest.raises(fr.Impossible, match=r"every 0\.02 s was asked for, and .* steps every 0\.01 s: what a sampled"):
        fr.design(MAP, "euler-pi", fix={"T": 0.02})
    assert EulerPi(T).assumptions(MAP) == EulerPi().assumptions(MAP) == []


@pytest.mark.parametrize("name", ["euler-pi-euler", "euler-pi-rk4", "augmented-ekf"])
def test_methods_that_discretise_a_plant_themselves_refuse_a_sampled_one(name):
    with pytest.raises(fr.Impossible, match="the plant is sampled") as told:
        fr.design(MAP, name)
    assert ("use euler-pi" in str(told.value)) == name.startswith("euler-pi")


def test_the_decay_that_is_asked_for_is_that_of_the_continuous_plant():
    for plant in (LINEAR, fr.library("airliner")):
        # Rates are logarithms of eigenvalues near 1, known to rounding over |A| T, about 1e-11
        assert sampled_decay_rate(fr.discretised(plant, T)) == pytest.approx(decay_rate(plant), rel=1e-8)


def slow_samples(A):
    """Two states, both measured, a fault on the second sensor, noise."""
    return plant_from_matrices(
        A,
        np.array([[1.0], [0.5]]),
        np.eye(2),
        np.zeros((2, 1)),
        sample_time=2.0,
        name="sampled slowly",
        faults=[FaultChannel("drift", {"y2": 1.0}, size=0.5)],
        disturbances=[Disturbance("push", into={"x1": 1.0}, size=0.1)],
        noise=fr.Noise(2.0, (0.01, 0.01)),
    )


@pytest.mark.parametrize("A", [[[0.1, 0.0], [0.3, 0.2]], [[0.0, 0.0], [1.0, 0.0]], [[1.0, 0.2], [0.1, 0.6]]])
def test_a_plant_that_forgets_within_a_few_samples_has_a_design(A):
    plant = slow_samples(np.array(A))
    assert constant_fault(plant).holds
    design = fr.design(plant, "euler-pi")
    assert design.certificate is not None and design.certificate.verify().verdict == "proved"
    assert sampled_decay_rate(plant) * 2.0 <= LONGEST
    run = fr.simulate(design, fr.Scenario.step("drift", size=0.5, at=10.0, duration=200.0).quiet())
    # 90 samples after the onset at 0.6 per sample: 1e-20, so that rounding is what is left
    assert np.abs(run.f_hat - run.f)[-5:].max() < 1e-9


def test_from_a_plant_file_to_a_reconstructed_log(tmp_path, capsys):
    plant, design, log, out = (tmp_path / name for name in ("plant.toml", "design.json", "log.csv", "faults.csv"))
    fr.save(MAP, plant)
    fault = "actuator:step:size=0.2,at=2"
    for line in (
        ["design", plant, "--method", "euler-pi", "--out", design],
        ["verify", design],
        ["simulate", design, "--fault", fault, "--duration", "6", "--out", log],
        ["run", design, log, "--out", out],
    ):
        with pytest.raises(SystemExit) as ended:
            app([str(word) for word in line])
        assert ended.value.code in (0, None), capsys.readouterr()
    found, simulated = pd.read_csv(out), pd.read_csv(log)
    estimate = found["f_actuator"].to_numpy()
    # Numbers are written in full, times in 12 digits
    assert np.allclose(estimate, simulated["f_actuator"].to_numpy(), rtol=0, atol=1e-9)
    assert abs(estimate[found["t"].to_numpy() > 3.0].mean() - 0.2) < 0.01  # noise of 0.01 over 300 samples, correlated
