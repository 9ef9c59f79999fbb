# SPDX-License-Identifier: BSD-3-Clause
"""What stands against a reconstruction is said with the mode, the states it lives in, and what would change it."""

from dataclasses import replace

import numpy as np
import pytest

from faultrecon.diagnosis.conditions import detectable, minimum_phase
from faultrecon.diagnosis.diagnosis import diagnose
from faultrecon.diagnosis.existence import detectability_findings, fault_findings
from faultrecon.diagnosis.limits import reconstruction_floor
from faultrecon.finding import Impossible
from faultrecon.io.library import read_library
from faultrecon.numerics.annihilator import annihilator
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Signals
from faultrecon.synthesis.pipeline import design

PUSH = (Disturbance("w", {"x1": 1.0}),)


def plant(A, C, faults, disturbances=PUSH, inputs=()):
    """A linear plant with states x1, x2, ... and sensors y1, y2, ..."""
    A, C = np.atleast_2d(np.asarray(A, dtype=float)), np.atleast_2d(np.asarray(C, dtype=float))
    x, y = ([f"{k}{i + 1}" for i in range(m)] for k, m in (("x", len(A)), ("y", len(C))))
    signals = Signals(Channels(tuple(x)), Channels(tuple(inputs)), Channels(tuple(y)))
    B, D = np.zeros((len(A), len(inputs))), np.zeros((len(C), len(inputs)))
    channels = tuple(FaultChannel(f"f{i + 1}", on) for i, on in enumerate(faults))
    return Plant("tank", signals, A, B, C, D, faults=channels, disturbances=tuple(disturbances))


STABLE = np.array([[-1.0, 0.5], [0.0, -2.0]])


def test_a_plant_that_declares_no_fault_says_so():
    (found,) = fault_findings(plant(STABLE, np.eye(2), []))
    assert (
        str(found) == "tank declares no fault: there is nothing to reconstruct; add a [[fault]] table to the plant file"
    )
    assert not diagnose(plant(STABLE, np.eye(2), [])).possible


def test_faults_in_one_direction_cannot_be_told_apart_and_are_named():
    C = np.vstack([np.eye(2), [1.0, 1.0]])
    twice = plant(STABLE, C, [{"y1": 1.0}, {"y2": 1.0, "y3": 2.0}, {"y2": -3.0, "y3": -6.0}])
    (found,) = fault_findings(twice)
    assert found.what == "the fault matrix F has rank 2 for 3 sensor faults"
    assert found.why.startswith("f2 and f3 move the measurements in one direction")
    assert found.evidence == {"rank": 2, "faults": 3, "sensors": 3}
    assert any("one of them at a time" in r for r in found.remedies)
    assert not diagnose(twice).possible
    assert all(d.possible for d in diagnose(twice).alone)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_the_rank_of_the_fault_matrix_does_not_depend_on_units(unit):
    good = plant(STABLE, np.eye(2), [{"y1": unit}, {"y1": 1.0, "y2": 1.0}])
    bad = plant(STABLE, np.eye(2), [{"y1": unit, "y2": unit}, {"y1": 1.0, "y2": 1.0}])
    assert fault_findings(good) == []
    assert len(fault_findings(bad)) == 1


def test_more_faults_than_sensors_are_too_many():
    found = fault_findings(plant(STABLE, np.eye(2), [{"y1": 1.0}, {"y2": 1.0}, {"y1": 1.0, "y2": 1.0}]))
    assert found[0].evidence["rank"] == 2


def test_a_mode_that_healthy_sensors_do_not_see_is_named_with_its_states_and_a_remedy():
    # The integrator x2 is seen by y2 alone, and y2 is faulty.
    integrator = plant([[-1.0, 0.0], [0.0, 0.0]], np.eye(2), [{"y2": 1.0}])
    (found,) = detectability_findings(integrator)
    assert found.what == "the healthy sensors do not see the mode at s = 0, which does not decay"
    assert found.why == "(A, C1) is not detectable; the mode lives in x2"
    assert found.evidence["states"] == ["x2"]
    assert found.remedies[0] == "add a healthy sensor that reads x2"
    with pytest.raises(Impossible, match="do not see the mode at s = 0"):
        design(integrator)


def test_an_undamped_pair_is_one_finding_with_its_frequency():
    pair = plant([[-1.0, 0, 0], [0, 0, 3.0], [0, -3.0, 0]], np.eye(3), [{"y2": 1.0}, {"y3": 1.0}])
    (found,) = detectability_findings(pair)
    assert "s = 0 ± 3j" in found.what
    assert set(found.evidence["states"]) == {"x2", "x3"}


def test_an_unseen_mode_that_decays_is_no_obstacle():
    assert detectability_findings(plant(np.diag([-1.0, -2.0]), np.eye(2), [{"y2": 1.0}])) == []


def test_the_verdict_on_detectability_does_not_depend_on_units():
    for unit in (1e-6, 1e6):
        T = np.diag([1.0, unit])
        A, C = np.linalg.inv(T) @ np.array([[-1.0, 0.0], [0.0, 0.0]]) @ T, np.eye(2) @ T
        assert len(detectability_findings(plant(A, C, [{"y2": 1.0}]))) == 1
        assert detectability_findings(plant(A, C, [{"y1": 1.0}])) == []


def test_a_hair_from_undetectable_is_a_warning_with_the_distance():
    # x2 grows and reaches the healthy sensor y1 through a difference of two nearly equal paths alone; units of single
    # states cannot mend that.
    A = [[-1.0, 0.0, 1.0], [0.0, -1.0, 1.0 + 1e-9], [0.0, 0.0, 0.1]]
    (found,) = detectability_findings(plant(A, [[1.0, -1.0, 0.0], [0.0, 0.0, 1.0]], [{"y2": 1.0}]))
    assert found.severity == "warning"
    assert "by a hair" in found.what
    assert 0 < found.evidence["distance"] < 1e-6


@pytest.mark.parametrize("A", [STABLE, [[0.1, 0.0], [0.0, -1.0]]])
def test_a_plant_whose_sensors_are_all_faulty_has_no_observer(A):
    everything = plant(A, np.eye(2), [{"y1": 1.0}, {"y2": 1.0}])
    with pytest.raises(Impossible, match="all 2 sensors are declared faulty"):
        design(everything)
    settles = np.linalg.eigvals(A).real.max() < 0
    assert diagnose(everything).possible == settles
    if not settles:
        assert "no sensor stays healthy and the plant does not settle by itself" in str(diagnose(everything))


def test_a_stable_plant_whose_sensors_are_all_faulty_has_its_open_loop():
    everything = plant(STABLE, np.eye(2), [{"y1": 1.0}, {"y2": 1.0}])
    found = design(everything, "open-loop")
    assert found.verification.verdict == "proved"
    # Without a healthy sensor nothing is better than the open loop: its gain is the floor.
    assert found.optimum == pytest.approx(found.floor, rel=1e-5)


def test_without_a_disturbance_there_is_no_level_and_no_crash():
    calm = plant(STABLE, np.eye(2), [{"y2": 1.0}], disturbances=())
    assert reconstruction_floor(calm) is None
    assert diagnose(calm).together.floor is None
    assert calm.digest() == replace(calm).digest()
    for name in ("lipschitz-hinf", "open-loop"):
        with pytest.raises(Impossible, match="declares no disturbance to attenuate"):
            design(calm, name)


@pytest.mark.parametrize("role", ["noise"])
def test_a_disturbance_that_no_level_counts_is_not_attenuated(role):
    calm = plant(STABLE, np.eye(2), [{"y2": 1.0}], disturbances=(Disturbance("w", {"x1": 1.0}, role=role),))
    assert calm.E_w.shape == (2, 0)
    with pytest.raises(Impossible, match="declares no disturbance to attenuate"):
        design(calm)


@pytest.mark.parametrize("names", [("fa",), ("fs", "fa"), ("fa", "fs")])
def test_actuator_faults_do_not_break_the_diagnosis(names):
    with_input = plant(STABLE, np.eye(2), [], inputs=("u",))
    channels = {"fa": FaultChannel("fa", {"u": 1.0}, site="actuator"), "fs": FaultChannel("fs", {"y2": 1.0})}
    found = diagnose(replace(with_input, faults=tuple(channels[n] for n in names)))
    assert found.together.faults == names
    assert found.together.floor is None


def test_diagnosis_of_the_examples_reports_their_floors():
    # Six digits are tabulated.
    for name, floor in (("lipschitz_aircraft", 0.487601), ("lipschitz_polynomial", 0.587324)):
        found = diagnose(read_library(name))
        assert found.possible
        assert found.together.floor == pytest.approx(floor, rel=2e-6)
        assert f"{floor:.4g}"[:6] in str(found)


def test_fewer_faults_at_a_time_never_raise_the_floor():
    found = diagnose(read_library("lipschitz_aircraft"))
    assert all(d.floor <= found.together.floor * (1 + 1e-8) for d in found.alone)


def test_a_diagnosis_is_plain_values_for_json():
    import json

    found = diagnose(read_library("lipschitz_aircraft"))
    assert json.loads(json.dumps(found.as_dict()))["together"]["possible"] is True


def test_where_nothing_was_asked_nothing_is_called_impossible():
    for asked in (plant(STABLE, np.eye(2), []), plant(STABLE, np.eye(2), [{"y2": 1.0}], disturbances=())):
        assert "cannot be reconstructed" not in str(diagnose(asked))
    (calm,) = diagnose(asked).notes
    assert calm.severity == "warning"
    assert "declares no disturbance" in calm.what
    assert diagnose(asked).possible


def test_a_sensor_that_counts_as_exact_is_pointed_out_with_what_to_declare():
    noise = Disturbance("noise", on={"y1": 1.0})
    (found,) = diagnose(plant(STABLE, np.eye(2), [{"y1": 1.0}], (*PUSH, noise))).notes
    assert found.what == "no disturbance acts on y2, so it counts as exact when healthy"
    assert "on = { y2 = 1.0 }" in found.remedies[0]
    assert found.severity == "note"
    # The only faulty sensor is never relied upon, so its noise is no matter of trust.
    assert diagnose(plant(STABLE, np.eye(2), [{"y2": 1.0}], (*PUSH, noise))).notes == ()


def test_a_zero_floor_is_said_in_words():
    exact = plant(STABLE, np.eye(2), [{"y2": 1.0}])  # the disturbance does not reach y2, and y1 counts as exact
    assert diagnose(exact).together.floor == 0
    assert "no level is too small" in str(diagnose(exact))


@pytest.mark.parametrize(
    ("unit", "coefficient", "odd"), [("deg", 1.0, True), ("deg", 57.3, False), ("rad", 1.0, False)]
)
def test_a_coefficient_of_one_between_different_units_is_worth_a_warning(unit, coefficient, odd):
    base = plant(STABLE, coefficient * np.eye(2)[:1], [], (*PUSH, Disturbance("noise", on={"y1": 1.0})))
    x, y = Channels(("x1", "x2"), ("rad", "rad/s")), Channels(("y1",), (unit,))
    notes = diagnose(replace(base, signals=replace(base.signals, x=x, y=y))).notes
    assert len(notes) == odd
    if odd:
        assert notes[0].what == "y1 [deg] reads x1 [rad] with a coefficient of exactly 1, though the units differ"
        assert notes[0].severity == "warning"
        assert "how many deg one rad is" in notes[0].remedies[0]


def test_what_is_not_printed_is_not_computed(monkeypatch):
    from faultrecon.diagnosis import conditions

    def never(*_, **__):
        raise AssertionError("the distances were asked for")

    monkeypatch.setattr(conditions, "nearest_undetectable", never)
    found = diagnose(plant([[0.1, 0.0], [0.0, -1.0]], np.eye(2), [{"y2": 1.0}], PUSH))
    assert found.possible
    assert str(found)
    with pytest.raises(AssertionError, match="distances"):
        _ = found.together.conditions


def test_a_hidden_growing_mode_forbids_exactness_alone():
    growing = plant([[0.5, 0.0], [0.0, -1.0]], np.eye(2), [{"y1": 1.0}])
    assert "f1: cannot be reconstructed exactly" in str(diagnose(growing))
    assert "at best an error of 2 s times the rate of the fault" in str(diagnose(growing))


@pytest.mark.parametrize("faults", [[{"y1": 1.0}, {"y1": -2.0}], [{"y1": 1.0, "y2": 1.0}, {"y1": 3.0, "y2": 3.0}]])
def test_detectability_with_dependent_faults_is_that_of_the_outputs_that_none_of_them_reaches(faults):
    C = np.vstack([np.eye(2), [1.0, 1.0]])
    one, two = (plant(np.diag([0.5, -1.0]), C, f) for f in (faults[:1], faults))
    assert detectable(two) == detectable(one)
    assert (annihilator(two.F_f) == annihilator(one.F_f)).all()


def test_more_faults_than_outputs_leave_none():
    assert annihilator(np.arange(1.0, 7.0).reshape(2, 3)).shape == (0, 2)


def test_the_slowest_zero_of_a_sampled_plant_is_the_one_of_largest_modulus():
    three = plant(np.diag([-0.9, 0.5, 0.1]), np.eye(3)[2:], [{"y1": 1.0}])  # two modes that no sensor sees
    found = minimum_phase(replace(three, sample_time=0.1))
    assert found.holds and found.where == pytest.approx(-0.9) and found.distance == pytest.approx(0.1)
    growing = replace(three, A=np.diag([-1.5, 1.1, 0.1]), sample_time=0.1)
    assert not minimum_phase(growing).holds and minimum_phase(growing).where == pytest.approx(-1.5)
