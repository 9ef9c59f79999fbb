# SPDX-License-Identifier: BSD-3-Clause
"""What the unknown-input observers promise beyond the paper's examples: roles, noise, weights, operating points."""

from dataclasses import replace

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.advise.trials import trial_plants
from faultrecon.diagnosis.decoupling import invariant_zero_notes, partition, unknown_input_gain
from faultrecon.diagnosis.limits import hidden_floor
from faultrecon.lmi.expr import ShapeError, blocks, given, zeros
from faultrecon.lmi.typeset import latex
from faultrecon.methods.registry import method
from faultrecon.plant.matrices import plant_from_matrices
from faultrecon.synthesis.pipeline import optimum
from faultrecon.testing import check_method

SPRING, PENDULUM = trial_plants()[:2]
AIRCRAFT = fr.library("civil_aircraft")
DECOUPLED_SPRING = replace(
    SPRING, disturbances=(replace(SPRING.disturbances[0], role="decouple"), SPRING.disturbances[1])
)


def chain(disturbances, faults=("y3",)):
    """Three masses' worth of stable first-order lags, each state measured."""
    return plant_from_matrices(
        [[-1.0, 0.5, 0.0], [0.0, -2.0, 0.5], [0.3, 0.0, -3.0]],
        np.zeros((3, 0)),
        np.eye(3),
        np.zeros((3, 0)),
        states=["x1", "x2", "x3"],
        outputs=["y1", "y2", "y3"],
        faults=[fr.FaultChannel(f"f_{name}", {name: 1.0}) for name in faults],
        disturbances=disturbances,
    )


# ---------------------------------------------------------------- roles


def test_everything_that_can_be_decoupled_together_is():
    found = partition(chain([fr.Disturbance("a", {"x1": 1.0}), fr.Disturbance("b", {"x2": 1.0})]))
    assert (found.decouple, found.attenuate, found.reasons) == (("a", "b"), (), {})


def test_what_reaches_a_sensor_is_attenuated_with_that_reason():
    found = partition(chain([fr.Disturbance("a", {"x1": 1.0}), fr.Disturbance("hum", {}, {"y2": 1.0})]))
    assert (found.decouple, found.attenuate) == (("a",), ("hum",))
    assert "reaches y2 directly" in found.reasons["hum"] and "attenuate hum" in str(found)


def test_of_two_that_exclude_each_other_the_first_is_decoupled_and_the_other_says_why_not():
    both = [fr.Disturbance("a", {"x1": 1.0}), fr.Disturbance("b", {"x1": -2.0})]
    found = partition(chain(both))
    assert found.decouple == ("a",)
    assert "not together with a" in found.reasons["b"] and "rank 1 of 2" in found.reasons["b"]


def test_a_refusal_says_which_of_several_disturbances_can_be_decoupled():
    both = [fr.Disturbance("a", {"x1": 1.0}, role="decouple"), fr.Disturbance("b", {"x1": -2.0}, role="decouple")]
    with pytest.raises(fr.Impossible, match="rank 1 of 2") as refused:
        fr.design(chain(both), "adaptive-uio")
    assert refused.value.finding.remedies[0] == "decouple a and attenuate b"
    eased = chain([both[0], replace(both[1], role="attenuate")])
    assert fr.design(eased, "adaptive-uio").verification.verdict == "proved"


def test_a_larger_set_is_preferred_to_an_earlier_one():
    mixed = fr.Disturbance("mixed", {"x1": 1.0, "x2": 1.0})
    found = partition(chain([mixed, fr.Disturbance("a", {"x1": 1.0}), fr.Disturbance("b", {"x2": 1.0})]))
    assert len(found.decouple) == 2


def test_a_partition_can_be_applied_and_the_method_then_accepts_the_plant():
    for plant in (SPRING, PENDULUM, fr.library("lipschitz_aircraft"), fr.library("airliner"), AIRCRAFT):
        found = partition(plant)
        applied = found.applied(plant)
        assert {d.name for d in applied.attenuated if d.role == "decouple"} == set(found.decouple)
        assert not [f for f in method("adaptive-uio").assumptions(applied) if f.severity == "fatal"]


def test_decoupling_what_reaches_a_sensor_is_refused_and_the_remedy_helps():
    plant = chain([fr.Disturbance("leak", {"x1": 1.0}, {"y1": 0.1}, role="decouple")])
    with pytest.raises(fr.Impossible, match="leak is to be decoupled and reaches y1 directly") as refused:
        fr.design(plant, "adaptive-uio")
    assert refused.value.finding.remedies == ('attenuate leak (role = "attenuate")',)
    eased = replace(plant, disturbances=(replace(plant.disturbances[0], role="attenuate"),))
    assert fr.design(eased, "adaptive-uio").verification.verdict == "proved"


def test_what_is_decoupled_has_no_influence_whatever_its_size():
    made = fr.design(DECOUPLED_SPRING, "adaptive-uio")
    M = unknown_input_gain(DECOUPLED_SPRING)
    assert np.abs((np.eye(2) - M @ SPRING.C) @ DECOUPLED_SPRING.E_w[:, 0]).max() <= 1e-15
    louder = replace(
        DECOUPLED_SPRING, disturbances=(replace(DECOUPLED_SPRING.disturbances[0], size=1e3), SPRING.disturbances[1])
    )
    assert optimum(louder, "adaptive-uio") == pytest.approx(made.optimum, rel=1e-6)


def test_a_design_says_what_could_be_decoupled_as_well():
    assert any(
        "could be decoupled as well" in n and "push" in n for n in fr.design(SPRING, "adaptive-uio").details.notes
    )


# ---------------------------------------------------------------- the level


def gain_of_the_whole(plant, made, w):
    """|f - f̂| over |[f'; w]| at a frequency, from plant and observer as they run; D = 0, no noise."""
    o, n = made.observer, plant.n
    kept = [d.role != "decouple" for d in plant.attenuated]
    By, Dy, nz = o.B[:, o.inputs :], o.Dx[:, o.inputs :], len(o.A)
    assert Dy.shape[0] == n
    A = np.block([[plant.A, np.zeros((n, nz))], [By @ plant.C, o.A]])
    B = np.vstack([plant.E_w[:, kept], By @ plant.F_w[:, kept]])
    F = np.vstack([np.zeros((n, plant.F_f.shape[1])), By @ plant.F_f])
    C = np.hstack([np.zeros((len(o.Cf), n)), -o.Cf])
    resolvent = np.linalg.inv(1j * w * np.eye(n + nz) - A)
    from_f = (np.eye(len(o.Cf)) + C @ resolvent @ F) / (1j * w)  # f is the integral of f'
    return np.linalg.norm(np.hstack([from_f, C @ resolvent @ B]), 2)


@pytest.mark.parametrize("plant", [SPRING, DECOUPLED_SPRING, AIRCRAFT], ids=["spring", "decoupled spring", "aircraft"])
@pytest.mark.parametrize("name", ["adaptive-uio", "adaptive-uio-full"])
def test_the_level_bounds_the_plant_with_its_observer_disturbed_sensors_included(name, plant):
    plain = replace(plant, faults=(replace(plant.faults[0], size=1.0),))  # errors and derivatives in units of one
    assert all(d.size == 1.0 for d in plain.attenuated)
    made = fr.design(plain, name)
    reached = max(gain_of_the_whole(plain, made, w) for w in np.geomspace(1e-3, 1e4, 120))
    assert reached <= made.level * (1 + 1e-6)  # the resolvent is good to many more digits


def test_a_free_learning_rate_is_never_worse():
    held, free = (optimum(AIRCRAFT, "adaptive-uio", pole_bound=30.0, free=f) for f in ((), ("W",)))
    assert free <= held * (1 + 1e-6)
    made = fr.design(AIRCRAFT, "adaptive-uio", pole_bound=30.0, free=("W",))
    assert made.verification.verdict == "proved" and np.linalg.eigvalsh(made.gains["Γ"]).min() > 0


def test_a_small_learning_rate_costs_level():
    levels = [optimum(AIRCRAFT, "adaptive-uio", pole_bound=30.0, fix={"W": np.eye(1) / g}) for g in (0.1, 1.0, 10.0)]
    assert levels[0] > levels[1] > levels[2]


def test_weights_on_the_state_error_can_only_raise_the_level():
    plain = optimum(AIRCRAFT, "adaptive-uio", pole_bound=30.0)
    assert plain <= optimum(AIRCRAFT, "adaptive-uio", pole_bound=30.0, fix={"W_x": 0.1 * np.eye(4)})


def test_noise_in_the_level_costs_level_and_calms_the_estimate():
    quiet = replace(AIRCRAFT, noise=fr.Noise(0.01, (0.01, 0.01, 0.01)))
    plain, priced = (fr.design(quiet, name, pole_bound=30.0) for name in ("adaptive-uio", "adaptive-uio-noise"))
    assert priced.optimum >= plain.optimum * (1 - 1e-6)
    assert all(d.details.noise_sd["f"] < 0.1 for d in (plain, priced))


def test_the_unit_of_a_fault_is_no_physics():
    inch = replace(AIRCRAFT, faults=(replace(AIRCRAFT.faults[0], size=8.0),))
    # The error and its derivative are both counted in the unit, the disturbance is not: it weighs eight times as much.
    d1, d2 = AIRCRAFT.disturbances
    same = replace(inch, disturbances=(d1, replace(d2, size=8.0)))
    expected = optimum(AIRCRAFT, "adaptive-uio", pole_bound=30.0)
    assert optimum(same, "adaptive-uio", pole_bound=30.0) == pytest.approx(expected, rel=1e-5)


def test_ascii_names_reach_the_letters():
    robot = fr.library("flexible_joint")
    by_letter = optimum(robot, "adaptive-uio", pole_bound=30.0, fix={"ε": 40.0, "ρ": 200.0})
    assert optimum(robot, "adaptive-uio", pole_bound=30.0, fix={"epsilon": 40.0, "rho": 200.0}) == by_letter


def test_the_floor_is_that_of_modes_which_only_faulty_sensors_see():
    assert method("adaptive-uio").floor(AIRCRAFT) is None
    unstable = plant_from_matrices(
        [[0.5, 0.3], [1.0, -1.0]],
        np.zeros((2, 0)),
        [[1.0, 0.0], [0.0, 1.0]],
        np.zeros((2, 0)),
        states=["a", "b"],
        outputs=["y1", "y2"],
        faults=[fr.FaultChannel("f", {"y1": 1.0}), fr.FaultChannel("g", {"y2": 1.0})],
        disturbances=[fr.Disturbance("w", {"b": 0.1})],
    )
    floor = hidden_floor(unstable)
    assert floor is not None and floor.kind == "hidden mode"
    made = fr.design(unstable, "adaptive-uio-full")
    assert made.floor == floor.value <= made.optimum * (1 + 1e-6)
    with pytest.raises(fr.Impossible, match=r"do not see the mode at s = 0\.6787") as refused:
        fr.design(unstable, "adaptive-uio")
    assert "adaptive-uio-full" in refused.value.finding.remedies[0]
    with pytest.raises(fr.FaultreconError):  # the finding is right: there is no level to be found
        optimum(unstable, "adaptive-uio-printed")


def test_slow_zeros_are_told():
    (told,) = invariant_zero_notes(AIRCRAFT)
    assert "-0.03849" in told and "a pole near" in told
    assert "away from zero" in invariant_zero_notes(fr.library("flexible_joint"))[0]
    assert fr.design(AIRCRAFT, "adaptive-uio").details.slowest_pole == pytest.approx(0.0385, rel=0.4)


def test_no_scaling_makes_a_false_decoupling_true():
    made = fr.design(AIRCRAFT, "adaptive-uio").certificate
    data = dict(made.data)
    for name, factor in (("T", 2.0**50), ("T⁻¹", 2.0**-50)):
        data[name] = {**data[name], "hex": [(factor * float.fromhex(v)).hex() for v in data[name]["hex"]]}
    entries = [float.fromhex(v) for v in data["M"]["hex"]]
    data["M"] = {**data["M"], "hex": [(1.001 * v).hex() for v in entries]}
    found = replace(made, data=data).sealed().verify()
    assert not found.sound
    assert next(s for s in found.steps if s.label.startswith("J E_d = 0")).verdict == "refuted"


@pytest.mark.parametrize("rho", [2.0, 10.0])
def test_a_hidden_unstable_mode_costs_its_floor_and_the_time_constant_of_the_fastest_pole(rho):
    balance = trial_plants()[3]
    # Measured, and what a first-order observer of the hidden mode suggests: level = floor + 1/ρ.
    level = optimum(balance, "adaptive-uio-full", pole_bound=rho)
    assert level == pytest.approx(hidden_floor(balance).value + 1 / rho, rel=1e-5)


# ---------------------------------------------------------------- contracts and baselines


@pytest.mark.parametrize("name", ["adaptive-uio", "augmented-uio", "descriptor"])
def test_the_methods_keep_to_what_every_method_owes(name):
    assert check_method(name)


def test_the_state_estimate_of_the_descriptor_observer_is_open_loop():
    made = fr.design(SPRING, "descriptor")
    assert np.array_equal(made.observer.A, SPRING.A) and not made.observer.B[:, made.observer.inputs :].any()
    assert made.optimum == pytest.approx(fr.design(SPRING, "open-loop").optimum, rel=1e-12)


@pytest.mark.parametrize(("alpha", "level"), [(0.01, 1.08613), (0.05, 1.49633), (0.10, 2.81007), (0.15, 21.0958)])
def test_levels_of_the_descriptor_observer_for_the_printed_aircraft(alpha, level):
    plant = fr.library("lipschitz_aircraft").reading_all_states()
    plant = replace(plant, nonlinearity=replace(plant.nonlinearity, constant=alpha))
    assert optimum(plant, "descriptor") == pytest.approx(level, rel=1e-4)


def test_a_descriptor_observer_needs_a_small_loop_gain():
    plant = fr.library("lipschitz_aircraft").reading_all_states()
    plant = replace(plant, nonlinearity=replace(plant.nonlinearity, constant=0.15923))
    with pytest.raises(fr.Impossible, match="too strong"):
        fr.design(plant, "descriptor")


def test_an_integrator_is_no_open_loop_whatever_sign_rounding_gives_its_pole():
    with pytest.raises(fr.Impossible, match="forgets nothing"):
        fr.design(fr.library("flexible_joint"), "open-loop")


def test_a_ramp_fault_is_followed_without_error_by_the_augmented_observer_alone():
    """The error at rest for f = t is C_e A_e⁻¹ times the entry of f': zero when the model knows f'."""
    for name, lag in (("adaptive-uio", True), ("augmented-uio", False)):
        o = fr.design(AIRCRAFT, name).observer
        drive = o.B[:, o.inputs :] @ AIRCRAFT.F_f
        inverse = np.linalg.inv(o.A)
        slope = o.Cf @ inverse @ inverse @ drive  # f̂ = f - slope for f = t, once settled
        assert (np.abs(slope).max() > 1e-3) == lag


# ---------------------------------------------------------------- block matrices without symmetry


def test_blocks_check_their_shapes_and_are_written_in_full():
    A, B = given("A", np.eye(2)), given("B", np.ones((2, 1)))
    assert blocks([[A, B]]).shape == (2, 3)
    with pytest.raises(ShapeError, match="block row 2"):
        blocks([[A, B], [A, A]])
    assert latex(blocks([[A, B], [zeros(1, 2), given("c", 1.0)]])).count(r"\star") == 0
    assert latex(blocks([[A, B], [B.T, given("c", 1.0)]])).count("star") == 1  # a mirror image need not be repeated
