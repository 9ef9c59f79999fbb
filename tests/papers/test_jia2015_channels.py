# SPDX-License-Identifier: BSD-3-Clause
"""One Lipschitz constant and one multiplier per component of φ: what they reach beyond one for all, and their files."""

import copy
from dataclasses import replace

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.io.plantfile import parse_plant
from faultrecon.io.plantwrite import plant_text
from faultrecon.methods.euler_pi import EulerPiEuler
from faultrecon.methods.registry import method
from faultrecon.methods.sampled_limits import largest_lipschitz, longest_sample_time, practical_bound
from faultrecon.plant.lipschitz import combined
from faultrecon.plant.plant import Plant
from faultrecon.plant.stored import plant_from_dict
from faultrecon.synthesis.certify import conforms, prove
from faultrecon.synthesis.levels import scale

PENDULUM = """\
schema = 1
name   = "position seen, speed not"
[signals]
x = ["p", "v"]
u = ["force"]
y = ["sensor"]
range = { p = 1.0, v = 1.0, force = 1.0 }
[matrices]
A = [[0.0, 1.0], [-1.0, -1.0]]
B = [[0.0], [1.0]]
C = { select = ["p"] }
[nonlinearity]
into = ["p", "v"]
phi  = ["0.5 * sin(v)", "20 * sin(p)"]
domain = { p = [-10, 10], v = [-10, 10] }
lipschitz = LIPSCHITZ
[noise]
hold = 0.01
sd   = { sensor = 1e-3 }
[[disturbance]]
name = "load"
into = { v = 1.0 }
[[fault]]
name     = "actuator"
actuator = "force"
"""


def pendulum(lipschitz: str) -> Plant:
    """φ₁ = sin(v)/2 hides the speed if it is steeper than one; φ₂ = 20 sin(p) reads what is measured."""
    return parse_plant(PENDULUM.replace("LIPSCHITZ", lipschitz))


EACH, ONE = pendulum("[0.5, 20.0]"), pendulum("20.0")


# ---------------------------------------------------------------- what the multipliers reach


def test_with_one_multiplier_per_component_there_is_an_observer_where_there_is_none_with_one():
    design = fr.design(EACH, "euler-pi")
    assert design.verification.verdict == "assumed"  # the constants are; nothing else is less than proved
    assert {s.verdict for s in design.verification.steps if s.label != "Lipschitz constants"} == {"proved"}
    assert "0.5, 20" in design.certificate.scope
    with pytest.raises(
        fr.Impossible, match=r"constant of 20: the largest is 1: .*one Lipschitz constant per component"
    ):
        fr.design(ONE, "euler-pi")


def test_constants_that_are_derived_are_proved_for_each_component():
    plant = pendulum('"derive"')
    term = plant.nonlinearity
    assert term.basis == "proved" and term.constant == pytest.approx(20.0, rel=0.011)
    assert term.channels == pytest.approx((0.5, 20.0), rel=0.011) and min(term.channels) >= 0.5
    assert fr.design(plant, "euler-pi").verification.verdict == "proved"


def test_each_component_may_only_be_as_steep_as_hides_nothing():
    steep = replace(EACH, nonlinearity=replace(EACH.nonlinearity, channels=(1.5, 20.0)))
    with pytest.raises(fr.Impossible, match=r"constants of 1\.5, 20 of the components of φ: 0\.6\d* times"):
        fr.design(steep, "euler-pi")


def test_the_largest_constants_in_proportion_reach_farther_than_the_largest_one():
    each, one = (largest_lipschitz(EulerPiEuler(0.01), plant) for plant in (EACH, ONE))
    # Apart, φ₁ alone limits: its slope 0.5 may double.  Together any φ of that slope may hide the speed.
    assert each == pytest.approx(40.0, rel=0.02) and one == pytest.approx(1.0, rel=0.02)
    assert longest_sample_time(EulerPiEuler(), EACH) > 0.01 > longest_sample_time(EulerPiEuler(), ONE)


def test_two_multipliers_are_never_worse_than_one():
    mild = pendulum("[0.4, 0.4]")
    single = replace(mild, nonlinearity=replace(mild.nonlinearity, channels=None))
    best, other = (fr.optimum(plant, "euler-pi") for plant in (mild, single))
    # sin(v)/2 and 20 sin(p) read one state each, so that |δ|² <= 0.4² |Δ|² is what the two bounds say together.
    assert mild.nonlinearity.constant == 0.4 and best <= other * (1 + 1e-5)


def test_a_component_that_reads_no_state_needs_no_multiplier():
    text = PENDULUM.replace('"20 * sin(p)"', '"cos(2 * t)"').replace("p = [-10, 10], ", "")
    design = fr.design(parse_plant(text.replace("LIPSCHITZ", "[0.5, 0.0]")), "euler-pi")
    assert design.verification.verdict == "assumed"
    alone = PENDULUM.replace('"p", "v"]\nphi', '"p"]\nphi').replace(', "20 * sin(p)"', "")
    single = parse_plant(alone.replace("p = [-10, 10], ", "").replace("LIPSCHITZ", "0.5"))
    assert design.optimum == pytest.approx(fr.optimum(single, "euler-pi"), rel=1e-4)


def test_the_practical_bound_uses_the_multipliers_too():
    gains = fr.design(EACH, "euler-pi-euler").gains
    reach = np.array([0.01, 0.01])
    assert practical_bound(EulerPiEuler(0.01), EACH, gains, reach) is not None
    assert practical_bound(EulerPiEuler(0.01), ONE, gains, reach) is None


# ---------------------------------------------------------------- what does not change


def test_with_one_component_a_list_of_one_constant_is_that_constant():
    text = PENDULUM.replace('into = ["p", "v"]', 'into = ["p"]').replace(', "20 * sin(p)"', "")
    text = text.replace("p = [-10, 10], ", "")
    plain, listed = (parse_plant(text.replace("LIPSCHITZ", value)) for value in ("0.5", "[0.5]"))
    a, b = (fr.design(plant, "euler-pi") for plant in (plain, listed))
    assert a.level == b.level and all(np.array_equal(a.gains[k], b.gains[k]) for k in a.gains)
    assert a.plant.letters().keys() == b.plant.letters().keys()


def test_other_methods_see_the_one_constant_alone():
    listed = pendulum("[0.03, 0.04]")
    single = replace(listed, nonlinearity=replace(listed.nonlinearity, channels=None))
    a, b = (fr.optimum(sensor_fault(plant), "lipschitz-hinf") for plant in (listed, single))
    assert a == b


def sensor_fault(plant: Plant) -> Plant:
    """A second position sensor, and a fault of it in place of the actuator's."""
    y = replace(plant.signals.y, names=("sensor", "other"), units=(), ranges=(), limits=())
    fault = fr.FaultChannel("bias", {"other": 1.0})
    return replace(
        plant,
        signals=replace(plant.signals, y=y),
        C=np.vstack([plant.C, plant.C]),
        D=np.zeros((2, 1)),
        faults=(fault,),
        noise=None,
        operating_point=None,
    )


def test_a_constant_for_all_follows_from_those_of_the_components():
    phi = EACH.nonlinearity.phi
    assert combined((0.5, 20.0), phi) == 20.0  # they read different states
    both = pendulum("[3.0, 4.0]").nonlinearity.phi
    shared = parse_plant(PENDULUM.replace("20 * sin(p)", "20 * sin(p + v)").replace("LIPSCHITZ", "[3.0, 4.0]"))
    assert combined((3.0, 4.0), both) == 4.0
    assert 5.0 <= shared.nonlinearity.constant <= 5.0 * (1 + 1e-15)


def test_another_constant_changes_those_of_the_components_in_proportion():
    assert EACH.nonlinearity.at(10.0).channels == (0.25, 10.0)
    assert EACH.reading_all_states().nonlinearity.channels is None  # which one reads what was the point


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("lipschitz", ["[0.5, 20.0]", '"derive"', "20.0"])
def test_constants_survive_files_and_designs_to_the_last_bit(lipschitz):
    plant = pendulum(lipschitz)
    again, stored = parse_plant(plant_text(plant)), plant_from_dict(plant.to_dict())
    assert again.digest() == plant.digest() == stored.digest()
    assert again.nonlinearity.channels == plant.nonlinearity.channels == stored.nonlinearity.channels


@pytest.mark.parametrize(
    ("lipschitz", "message"),
    [
        ("[0.5]", "has 1 numbers for 2 formulas"),
        ("[0.5, -1.0]", r"nonlinearity\.lipschitz\[1\].*is -1\.0"),
        ('[0.5, "derive"]', r"nonlinearity\.lipschitz\[1\]"),
    ],
)
def test_a_list_that_does_not_fit_is_refused_where_it_stands(lipschitz, message):
    with pytest.raises(fr.InputError, match=message):
        pendulum(lipschitz)


def test_constants_that_cannot_be_told_in_a_file_are_not_written():
    odd = replace(EACH, nonlinearity=replace(EACH.nonlinearity, constant=30.0))
    with pytest.raises(fr.InputError, match="cannot be written"):
        plant_text(odd)
    proved = replace(pendulum('"derive"'), nonlinearity=replace(pendulum('"derive"').nonlinearity, channels=None))
    with pytest.raises(fr.InputError, match="of the components of phi cannot be written"):
        plant_text(proved)


def test_a_wrong_number_of_constants_is_refused():
    with pytest.raises(fr.InputError, match="3 Lipschitz constants are given for 2 components"):
        replace(EACH.nonlinearity, channels=(1.0, 2.0, 3.0))
    with pytest.raises(fr.InputError, match="a Lipschitz constant is -1"):
        replace(EACH.nonlinearity, channels=(1.0, -1.0))


# ---------------------------------------------------------------- certificates


def tampered(design: fr.Design, letter: str, share: float):
    """The certificate with one of the constants in it changed, sealed again."""
    plant = copy.deepcopy(design.certificate.plant)
    entry = plant["matrices"][letter]
    entry["hex"] = [(share * float.fromhex(v)).hex() for v in entry["hex"]]
    return replace(design.certificate, plant=plant).sealed()


def test_the_proof_rests_on_the_constant_of_each_component_and_on_no_other():
    design = fr.design(EACH, "euler-pi")
    assert prove(tampered(design, "α₁", 3.0)).verdict == "refuted"
    assert prove(tampered(design, "α", 3.0)).verdict == "assumed"


def test_a_certificate_with_milder_constants_is_not_one_of_this_plant():
    milder = replace(EACH, nonlinearity=EACH.nonlinearity.at(10.0))
    theorem = method("euler-pi").theorem(milder, scale(milder))
    made = fr.design(EACH, "euler-pi").certificate
    assert conforms(made, method("euler-pi").theorem(EACH, scale(EACH))) and not conforms(made, theorem)
    damaged = EACH.to_dict()
    damaged["matrices"]["α₁"]["hex"] = [(0.0).hex()] * 4
    with pytest.raises(fr.InputError, match="contradicts itself"):
        plant_from_dict(damaged)
