# SPDX-License-Identifier: BSD-3-Clause
"""How far the models of the sampled observers are off: bounds proved on the declared domain against what happens."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import faultrecon as fr
from faultrecon.advise.papers._jia2015_robot import PlainEuler, PlainHeld, ranged, robot, truth
from faultrecon.graph.function import Graph
from faultrecon.methods.euler_pi import EulerPi, EulerPiEuler, EulerPiRk4
from faultrecon.methods.sampled_letters import averaged
from faultrecon.methods.sampled_limits import practical_bound, practical_bound_in_box
from faultrecon.methods.sampled_mismatch import euler_mismatch, held_mismatch, seen_mismatch
from faultrecon.plant.derive import drift
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import KnownTerm, Lipschitz
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Noise, Signals

TEXTS = ("a**3 - a*b", "sin(2*b) + 0.5*tanh(a)")


def declared(seed: int, texts: tuple[str, ...] = TEXTS, known: bool = False) -> Plant:
    """A random plant of three states with these terms in a and b, everything declared, away from zero."""
    r = np.random.default_rng(seed)
    phi = Graph.from_texts(texts, {"x": ("a", "b"), "u": ("v",), "t": ("t",)})
    x, u = Channels(("a", "b", "c"), ranges=tuple(r.uniform(0.5, 1.5, 3))), Channels(("v",), ranges=(0.7,))
    own = Graph.from_texts(["cos(p) * v"], {"y": ("p", "q"), "u": ("v",), "t": ("t",)})
    A, C = 2 * r.standard_normal((3, 3)), r.standard_normal((2, 3))
    return Plant(
        "random",
        Signals(x, u, Channels(("p", "q"))),
        A,
        r.standard_normal((3, 1)),
        C,
        np.zeros((2, 1)),
        faults=(FaultChannel("f", {"v": 1.0}, site="actuator", size=0.4),),
        disturbances=(Disturbance("w", {"a": 0.3, "c": 1.0}, size=0.5),),
        nonlinearity=Lipschitz(r.standard_normal((3, len(texts))), ("a", "b"), phi, 10.0),
        known=KnownTerm(r.standard_normal((3, 1)), own) if known else None,
        noise=Noise(0.01, (1e-3, 1e-3)),
        operating_point=OperatingPoint(tuple(r.uniform(-1, 1, 3)), (0.2,), (0.1, -0.3)),
    )


def one_sample(plant: Plant, T: float, r: np.random.Generator) -> tuple[np.ndarray, ...] | None:
    """From a random point of the domain: ẋ there and x after T seconds, all else held; None if it leaves the domain."""
    ranges = np.array(plant.signals.x.ranges)
    x0, u = plant.point.x + r.uniform(-1, 1, 3) * ranges, plant.point.u + r.uniform(-0.7, 0.7, 1)
    held = plant.E_f @ r.uniform(-0.4, 0.4, 1) + plant.E_w @ r.uniform(-0.5, 0.5, 1)
    done = solve_ivp(lambda t, x: drift(plant, x, u, t=t) + held, (0.0, T), x0, method="DOP853", rtol=1e-12, atol=1e-14)
    inside = np.all(np.abs(done.y.T - plant.point.x) <= ranges)
    return (x0, drift(plant, x0, u) + held, done.y[:, -1]) if inside else None


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_no_sample_of_a_random_plant_is_farther_off_than_is_proved(seed, known):
    plant, r, seen = declared(seed, known=known), np.random.default_rng(seed), 0
    for T in (0.01, 0.1):
        Φ1, euler, held = averaged(plant, T), euler_mismatch(plant, T).size, held_mismatch(plant, T).size
        assert euler is not None and held is not None
        for _ in range(40):
            found = one_sample(plant, T, r)
            if found is not None:
                x0, ẋ, x1 = found
                seen += 1
                # 1e-9: the truth is integrated to 1e-12 and divided by T.
                assert np.all(np.abs((x1 - x0) / T - ẋ) <= euler + 1e-9)
                assert np.all(np.abs((x1 - x0) / T - Φ1 @ ẋ) <= held + 1e-9)
    assert seen > 10


def test_on_the_robot_the_bounds_are_above_the_run_and_the_held_one_is_sharp():
    T, plant = 0.01, ranged()
    t, u, x, f = truth("const", 0.0, T, 0.0)
    for kind, sharp in ((PlainEuler, 17.0), (PlainHeld, 1.2)):
        proved = kind(T).mismatch(plant, T).size
        seen = np.abs(seen_mismatch(plant, kind(T).model(plant, T), t, u, x, f[:, None])).max(axis=0)
        assert proved is not None and np.all(seen <= proved) and np.all(proved <= sharp * seen)


def test_the_bound_of_eulers_model_is_proportional_to_the_sample_time():
    plant = ranged()
    long, short = (euler_mismatch(plant, T).size for T in (0.02, 0.005))
    assert long == pytest.approx(4 * short, rel=1e-12)


def test_a_linear_plant_is_exact_for_the_held_model_whatever_its_ranges():
    linear = replace(robot(), nonlinearity=None)
    assert not held_mismatch(linear, 0.01).size.any()
    assert set(euler_mismatch(linear, 0.01).missing) == {"theta_m", "omega_m", "theta_l", "omega_l", "voltage"}
    assert "sup |m| = 0" in " ".join(fr.design(linear, "euler-pi").details.notes)


def test_only_ranges_that_matter_are_asked_for():
    # φ' = -3.33 cos(θ_l) ω_l asks for ω_l alone: the cosine is at most one wherever θ_l is.
    assert held_mismatch(robot(), 0.01).missing == ("omega_l",)
    found = euler_mismatch(robot(), 0.01)
    assert found.size is None and found.missing == ("theta_m", "omega_m", "omega_l", "voltage")


def test_a_product_of_two_states_without_ranges_asks_for_both():
    plant = declared(0, ("a*b",))
    bare = replace(plant, signals=replace(plant.signals, x=replace(plant.signals.x, ranges=())))
    assert {"a", "b"} <= set(held_mismatch(bare, 0.01).missing)


def test_the_domain_of_phi_serves_as_a_range_and_cuts_wider_ones():
    plant = declared(1)
    term = plant.nonlinearity
    narrow = {name: (plant.point.x[i] - 0.1, plant.point.x[i] + 0.1) for i, name in enumerate("ab")}
    cut = replace(plant, nonlinearity=replace(term, domain=narrow))
    assert np.all(held_mismatch(cut, 0.01).size < held_mismatch(plant, 0.01).size)
    apart = replace(plant, nonlinearity=replace(term, domain={"a": (50.0, 60.0)}))
    assert "nothing in common" in held_mismatch(apart, 0.01).why


def test_a_term_that_jumps_leaves_no_bound_and_says_so():
    found = held_mismatch(declared(2, ("sign(a - b)", "b")), 0.01)
    assert found.size is None and "may jump" in found.why and not found.missing


def test_a_term_that_reads_the_time_is_bounded_where_its_waves_are():
    swinging = replace(declared(3), nonlinearity=replace(declared(3, ("sin(3*t)*a", "b")).nonlinearity))
    assert held_mismatch(swinging, 0.01).size is not None
    assert held_mismatch(declared(3, ("t*a", "b")), 0.01).size is None


# ---------------------------------------------------------------- what a user reads


def test_the_report_says_how_far_the_model_is_off_and_what_that_costs():
    for name in ("euler-pi", "euler-pi-euler", "euler-pi-ramp", "euler-pi-minimum-norm", "euler-observer"):
        report = fr.design(ranged(), name).report()
        assert "sup |m| <= theta_m" in report and "proved on the declared domain" in report
        assert "in the end |actuator - its estimate| <=" in report


def test_without_ranges_or_for_runge_kutta_the_report_says_that_it_is_to_be_checked():
    assert "checked in simulation: no range is declared; declare the range of omega_l" in report("euler-pi")
    assert "no bound in closed form" in report("euler-pi-rk4")


def report(name: str) -> str:
    return fr.design(robot(), name).report()


def test_entry_by_entry_bounds_are_never_worse_than_an_ellipsoid_around_them():
    method, plant, reach = EulerPiEuler(0.01), robot(), np.array([0.05, 0.35, 0.02, 0.16])
    gains = fr.design(plant, "euler-pi-euler").gains
    box = practical_bound_in_box(method, plant, gains, reach, (4.0, 8.0))
    around = practical_bound(method, plant, gains, 2.0 * reach, (4.0, 8.0))
    assert box is not None and around is not None and box.value <= around.value


def test_a_model_that_is_never_off_leaves_no_error():
    gains = fr.design(robot(), "euler-pi").gains
    found = practical_bound_in_box(EulerPi(0.01), robot(), gains, np.zeros(4))
    assert found is not None and found.value == 0.0
    assert EulerPiRk4(0.01).mismatch(ranged(), 0.01).size is None
