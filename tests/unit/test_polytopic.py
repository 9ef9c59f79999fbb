# SPDX-License-Identifier: BSD-3-Clause
"""Polytopic forms: in files, proved and refuted, factorised, with several sensors, and at run time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import faultrecon as fr
from faultrecon.graph.function import Graph
from faultrecon.graph.ranges import ranges
from faultrecon.graph.rational import NotRationalError, Ring
from faultrecon.io.plantfile import parse_plant
from faultrecon.io.plantwrite import plant_text
from faultrecon.methods.registry import method
from faultrecon.plant.factorisation import factorisations
from faultrecon.plant.polytopic import Family
from faultrecon.plant.sector import Sector, right_side
from faultrecon.plant.signals import Channels, Noise
from faultrecon.plant.stored import plant_from_dict
from faultrecon.testing import all_checks, check_method

FILE = """
schema = 1
name = "tank"
[signals]
x = ["level", "salt"]
u = ["inflow"]
y = ["gauge", "probe"]
[noise]
hold = 0.1
sd = { gauge = 0.01, probe = 0.01 }
[operating_point]
x = { level = 1.0, salt = 0.5 }
u = { inflow = 0.5 }
y = { gauge = 1.0, probe = 0.5 }
[matrices]
A = [[0, 0], [0, 0]]
B = [[0], [0]]
C = { select = ["level", "salt"] }
[nonlinearity]
into = ["level", "salt"]
phi = ["inflow - k*level*level", "inflow*(1 - salt)/level - salt/4"]
constants = { k = 0.5 }
domain = { level = [0.5, 2.0], salt = [0.0, 1.0], inflow = [0.1, 1.0] }
lipschitz = "derive"
[polytopic]
premises = { z1 = "level", z2 = "inflow/level", z3 = "1/level" }
A = [["-k*z1", 0], [0, "-z2 - 0.25"]]
B = [[1], ["z3"]]
box = { level = [0.8, 1.2], salt = [0.3, 0.7], inflow = [0.4, 0.6] }
bounds = { z2 = [0.3, 0.8] }
faults = { "gauge gain" = [-0.2, 0.2] }
constants = { k = 0.5 }
[[disturbance]]
name = "leak"
into = { level = 0.01 }
role = "noise"
[[fault]]
name = "gauge gain"
sensor = "gauge"
effect = "multiplicative"
rate = 0.05
"""


def tank():
    return parse_plant(FILE)


def test_a_polytopic_form_survives_a_file_a_dictionary_and_a_design():
    plant = tank()
    assert parse_plant(plant_text(plant)).digest() == plant.digest()
    again = plant_from_dict(plant.to_dict())
    assert again.digest() == plant.digest() and again.polytopic.bounds == {"z2": (0.3, 0.8)}
    assert "polytopic" not in replace(plant, polytopic=None).to_dict()  # other plants keep their digests


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"-k*z1", 0]', '"-k*z1*z1", 0]', r"\[A B\]\[0\]\[0\] = '-k\*z1\*z1' is of degree 2 in the premise 'z1'"),
        ('"-k*z1", 0]', '"-k*zz", 0]', r"plant.toml:\d+  polytopic.A\[0\]\[0\]: unknown name 'zz'"),
        ('"-k*z1", 0]', '"-k*z1"]', r"polytopic.A\[0\]: has 1 entries; give 2"),
        ("salt = [0.3, 0.7], ", "", r"\[polytopic\]?.*the box has no interval for 'salt'|no interval for 'salt'"),
        ("z2 = [0.3, 0.8]", "z4 = [0.3, 0.8]", r"polytopic.bounds.z4: there is no premise 'z4'"),
        ("z2 = [0.3, 0.8]", "z2 = [0.8, 0.3]", r"polytopic.bounds.z2: is \[0.8, 0.3\]"),
        ('"gauge gain" = [-0.2', '"probe" = [-0.2', r"there is no multiplicative fault 'probe'"),
    ],
)
def test_what_is_wrong_with_a_form_is_said_where_it_stands(old, new, said):
    assert old in FILE
    with pytest.raises(fr.InputError, match=said):
        parse_plant(FILE.replace(old, new, 1))


def test_a_form_of_another_plant_is_fatal_with_the_difference():
    wrong = parse_plant(FILE.replace('"-z2 - 0.25"', '"-z2 - 0.5"'))
    (finding,) = method("ts-published").assumptions(wrong)
    assert finding.severity == "fatal" and "not the plant's own equation" in finding.what
    assert finding.evidence["difference"] == pytest.approx(0.25 * 0.7, rel=0.01)  # 0.25 salt, and salt is at most 0.7
    assert len(finding.evidence["at"]) == 3


def test_a_form_that_is_no_rational_function_is_checked_and_not_called_proved():
    text = FILE.replace("k*level*level", "k*level*exp(level)").replace('z1 = "level"', 'z1 = "exp(level)"')
    agreement = Sector.of(parse_plant(text)).agreement
    assert agreement.verdict == "checked" and agreement.exact
    ring = Ring(["x"])
    with pytest.raises(NotRationalError, match="exp is no part"):
        ring.read(Graph.from_texts(["exp(x)"], {"x": ("x",)}), ring.variables)


def test_premises_of_inputs_alone_count_as_measured():
    assert Sector.of(fr.library("activated_sludge")).measured == ("z1",)
    assert Sector.of(tank()).measured == ()


@settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.floats(-2, 2), st.floats(0.01, 2), st.floats(0.2, 3), st.floats(0.01, 2)),
    st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=5, max_size=5),
)
def test_no_value_in_the_box_is_outside_the_range_and_both_ends_are_met(box, shares):
    graph = Graph.from_texts(["p*q - p*p", "p/(q + 0.1) + q", "sin(p)*q"], {"x": ("p", "q")})
    x = [(box[0], box[0] + box[1]), (box[2], box[2] + box[3])]
    found = ranges(graph, {"x": x}, rtol=1e-3)
    points = np.array([[low + s * (high - low) for s, (low, high) in zip(share, x, strict=True)] for share in shares])
    values = graph.many(points)
    for k, one in enumerate(found):
        assert one.low <= values[:, k].min() and values[:, k].max() <= one.high
        assert one.low <= one.least <= one.most <= one.high


def test_many_premises_are_warned_of_and_too_many_refused():
    def family(p):
        names = tuple(f"z{k}" for k in range(p))
        premises = Graph.from_texts([f"x*{k + 1}" for k in range(p)], {"x": ("x",), "u": ()})
        return Family(premises, Graph.from_texts([" + ".join(names)], {"z": names}), (1, 1))

    with pytest.raises(fr.InputError, match="7 premises: they make 128 vertices"):
        family(7)
    assert len(family(6).names) == 6


# ---------------------------------------------------------------- factorisations


def test_every_factorisation_is_exact_and_they_are_ranked_by_what_the_sensor_sees():
    plant = fr.library("activated_sludge")
    found = factorisations(plant, dict(plant.polytopic.box))
    assert len(found) == 16
    assert [c.observability for c in found] == sorted((c.observability for c in found), reverse=True)
    for candidate in found:
        sector = Sector.of(replace(plant, polytopic=candidate.form))
        assert sector.agreement.exact and sector.agreement.verdict == "proved"
    # With growth written as a function times biomass alone, the biomass sensor never sees the substrate.
    blind = [c for c in found if c.form.sector.entries.texts[1] == "0.0"]
    assert blind and all(c.observability == 0.0 for c in blind) and found[0].observability > 1e-3
    assert "biomass/(substrate + 0.07)" in str(found[0])


def test_a_term_without_a_state_is_refused_by_name():
    plant = tank()
    phi = Graph.from_texts(["inflow - 1", "-salt"], plant.nonlinearity.phi.inputs)
    moved = replace(plant, nonlinearity=replace(plant.nonlinearity, phi=phi, domain={}), polytopic=None)
    with pytest.raises(fr.InputError, match=r"the term -1.0 in the equation of level has no state"):
        factorisations(moved, dict(plant.polytopic.box))


def test_a_form_that_was_found_designs_an_observer():
    plant = fr.library("activated_sludge")
    best = factorisations(plant, dict(plant.polytopic.box))[0]
    form = replace(best.form, faults=plant.polytopic.faults)
    made = fr.design(replace(plant, polytopic=form), "ts-guaranteed-cost")
    assert made.verification.sound and made.gains["G"][2, 0] > 0


# ---------------------------------------------------------------- several sensors


def with_probe():
    """The reactor with a healthy substrate probe beside the fouling biomass sensor."""
    plant = fr.library("activated_sludge")
    y = Channels(("turbidity", "probe"), ("g/l", "g/l"), (1.0, 1.0))
    return replace(
        plant,
        signals=replace(plant.signals, y=y),
        C=np.eye(2),
        D=np.zeros((2, 1)),
        noise=Noise(0.1, (0.02, 0.02)),
        operating_point=replace(plant.point, y=plant.point.x),
    )


def test_a_healthy_probe_lowers_the_guaranteed_variance_and_widens_the_box():
    one, two = fr.library("activated_sludge"), with_probe()
    assert fr.design(two, "ts-mean-value").level < fr.design(one, "ts-mean-value").level
    box = {"biomass": (2.3, 3.6), "substrate": (0.04, 0.7), "dilution": (0.21, 0.45)}
    wide = [replace(p, polytopic=replace(p.polytopic, box=box)) for p in (one, two)]
    with pytest.raises(fr.Impossible, match="no constant gain"):
        fr.design(wide[0], "ts-mean-value")
    made = fr.design(wide[1], "ts-mean-value")
    assert made.verification.verdict == "proved"


def test_two_faulty_sensors_are_told_apart():
    plant = parse_plant(
        FILE
        + '\n[[fault]]\nname = "probe gain"\nsensor = "probe"\neffect = "multiplicative"\nrate = 0.05\nsize = 0.2\n'
    )
    made = fr.design(plant, "simulate-invert")
    scenario = fr.Scenario(
        duration=20.0,
        sample_time=0.05,
        noise=False,
        faults={"gauge gain": lambda t: 0.1 + 0 * t, "probe gain": lambda t: -0.15 + 0 * t},
    )
    run = fr.simulate(made, scenario)
    assert run.f_hat[-1] == pytest.approx([0.1, -0.15], abs=1e-6)
    assert run.corrected[-1] == pytest.approx(run.truth.healthy[-1], abs=1e-6)


# ---------------------------------------------------------------- at run time


@pytest.mark.parametrize("name", ["ts-guaranteed-cost", "ts-mean-value", "ts-published", "simulate-invert"])
def test_the_compiled_engine_gives_the_bits_of_the_general_one(name):
    made = fr.design(fr.library("activated_sludge"), name)
    t = 0.1 * np.arange(300)
    y = made.plant.point.y[0] * (1.0 + 0.1 * np.sin(t))[:, None]
    u = 0.33 + 0.05 * np.cos(t)[:, None]
    traces = [made.estimator(0.1, engine=engine).replay(t, u, y) for engine in ("casadi", "numba")]
    for part in ("fault", "state", "corrected"):
        # sin, cos and their like do not occur in these equations, so not one bit may differ
        assert np.array_equal(getattr(traces[0], part), getattr(traces[1], part)), part


def test_the_corrected_measurement_divides_the_gain_out():
    made = fr.design(fr.library("activated_sludge"), "ts-mean-value")
    run = fr.simulate(made, fr.Scenario.fault("fouling", lambda t: 0.3 + 0.0 * t, duration=30.0, noise=False))
    assert run.y[-1, 0] == pytest.approx(1.3 * run.x[-1, 0], rel=1e-9)
    assert run.corrected[-1, 0] == pytest.approx(run.y[-1, 0] / (1.0 + run.f_hat[-1, 0]), rel=1e-14)
    assert run.corrected[-1, 0] == pytest.approx(run.x[-1, 0], rel=1e-3)


def test_the_variance_that_is_guaranteed_is_not_exceeded_in_noise():
    plant = fr.library("activated_sludge")
    made = fr.design(plant, "ts-mean-value")
    runs = [fr.simulate(made, fr.Scenario(duration=300.0, seed=seed)) for seed in range(3)]
    spent = np.mean([np.sum(np.square((r.x - r.x_hat) / 1.0)[500:], axis=1).mean() for r in runs])
    spent += np.mean([np.square(r.f - r.f_hat)[500:].mean() for r in runs])
    assert 0.0 < spent <= made.level**2  # the fault at rest and no process noise: the bound has room for both


def test_a_design_file_keeps_the_form_and_the_proof(tmp_path):
    made = fr.design(fr.library("activated_sludge"), "ts-mean-value")
    fr.save(made, tmp_path / "d.json")
    again = fr.load(tmp_path / "d.json")
    assert again.plant.digest() == made.plant.digest() and again.verification.verdict == "proved"
    assert fr.verify(tmp_path / "d.json").verdict == "proved"  # by the standard library alone


def test_the_right_side_is_the_plants_equation():
    plant = fr.library("activated_sludge")
    f = right_side(plant)
    x, u = np.array([3.1, 0.2]), np.array([0.3])
    assert f(x, u) == pytest.approx(plant.nonlinearity.phi(x, u, [0.0]), rel=1e-15)


@pytest.mark.parametrize(
    "name", ["ts-mean-value", "ts-guaranteed-cost", "ts-published", "ts-published-known-input", "simulate-invert"]
)
def test_the_methods_for_lost_gain_pass_every_check_on_the_reactor(name):
    assert len(check_method(name, [fr.library("activated_sludge")])) == len(all_checks())


def test_a_level_that_is_a_deviation_is_not_called_a_gain():
    made = fr.design(fr.library("activated_sludge"), "ts-mean-value")
    score = fr.simulate(made, fr.Scenario.step("fouling", size=0.3, at=5.0, duration=10.0)).score()
    assert score.achieved is None and score.outside == ()  # noise of the declared size is what the bound is about
    assert f"error deviation up to {made.level:.6g} under white noise" in str(score)
