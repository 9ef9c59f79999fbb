# SPDX-License-Identifier: BSD-3-Clause
"""A bank: one design per explanation, what has none and why, and what can be told from what."""

import math
from dataclasses import replace

import numpy as np
import pytest

import faultrecon
from faultrecon.finding import Impossible, InputError
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.signals import Noise
from faultrecon.runtime.apart import separation
from faultrecon.synthesis.bank import bank


def chain():
    """The two masses, with what disturbs them and what their sensors add."""
    plant = faultrecon.library("two_mass")
    push = Disturbance("push", {"v2": 1.0}, size=0.1)
    return replace(plant, disturbances=(push,), noise=Noise(0.05, (0.01, 0.01)))


@pytest.fixture(scope="module")
def made():
    return bank(chain(), actuators=("force",), together=(("position1", "f"),))


def test_every_sensor_has_a_hypothesis_and_actuators_on_request(made):
    assert set(made.designs) >= {"position1", "f", "force"}
    assert "force" not in bank(chain(), sensors=("position1",)).designs
    assert [d.method for d in made.designs.values()][:2] == ["lipschitz-hinf"] * 2
    assert made.designs["force"].method in ("adaptive-uio", "euler-pi")


def test_a_declared_fault_keeps_its_name_size_and_rate(made):
    declared = chain().faults[0]
    assert made.designs["f"].plant.faults == (declared,)
    assert made.designs["position1"].plant.faults[0].on == {"position1": 1.0}


def test_a_fault_takes_the_range_of_its_sensor_or_ten_deviations_of_its_noise():
    plant = chain()
    assert bank(plant, sensors=("position1",)).designs["position1"].plant.faults[0].size == pytest.approx(0.1)
    ranged = replace(plant.signals, y=replace(plant.signals.y, ranges=(3.0, math.nan)))
    made = bank(replace(plant, signals=ranged), sensors=("position1",))
    assert made.designs["position1"].plant.faults[0].size == 3.0


def test_what_has_no_design_is_listed_with_the_reason(made):
    """With both positions at fault nothing is left to reconstruct them from."""
    assert set(made.refused) == {"position1 + f"}
    assert str(made.refused["position1 + f"])
    assert "position1 + f: no design" in made.report()
    assert made.as_dict()["refused"]["position1 + f"]


def test_faults_that_act_together_are_one_hypothesis(cart):
    together = bank(cart, sensors=("mix",), together=(("s1", "v1"),))
    assert [f.name for f in together.designs["s1 + v1"].plant.faults] == ["s1", "v1"]
    assert {f.name for f in together.plant.faults} == {"mix", "s1", "v1"}


@pytest.mark.parametrize(
    "names", [{"sensors": ("speed",)}, {"actuators": ("position1",)}, {"together": (("position1", "speed"),)}]
)
def test_unknown_names_are_refused(names):
    with pytest.raises(InputError, match=r"speed|position1"):
        bank(chain(), **names)


def test_without_any_design_there_is_no_bank():
    with pytest.raises(Impossible, match="no hypothesis about two-mass chain has a design"):
        bank(replace(chain(), disturbances=(), noise=None))


def test_a_fault_and_a_disturbance_of_one_name_are_told_apart():
    plant = replace(chain(), disturbances=(Disturbance("position1", {"v2": 1.0}, size=0.1),))
    made = bank(plant, sensors=("position1",))
    assert made.designs["position1 fault"].plant.faults[0].on == {"position1": 1.0}


def test_the_digest_follows_the_gains(made):
    again = bank(chain(), actuators=("force",))
    assert len({made.digest, again.digest, bank(chain(), sensors=("position1",)).digest}) == len(
        {tuple(made.designs), tuple(again.designs), ("position1",)}
    )


def test_progress_names_each_hypothesis():
    told = []
    bank(chain(), sensors=("position1", "position2"), progress=told.append)
    assert told == ["position1", "f"]


def test_a_bank_that_was_designed_runs(made, drive):
    """The designs themselves, under a monitor, on a log with the fault in one of two sensors."""
    plant = chain()
    x = replace(plant.signals.x, ranges=(1.0, 1.0, 1.0, 1.0))
    u = replace(plant.signals.u, ranges=(2.0,))
    plant = replace(plant, signals=replace(plant.signals, x=x, u=u))
    monitor = bank(plant).monitor(crest=1.0)
    fault = 3.0 * (np.arange(2400) > 1500)
    log = drive(plant, np.random.default_rng(1), 2400, faults={"position2": fault})
    state, _ = monitor.take(monitor.start(), *log)
    assert {e.mode for e in monitor.events(state)} & {"suspect", "fault"}
    assert all("f" in e.fault.split(" or ") for e in monitor.events(state) if e.mode in ("suspect", "fault"))


# ---------------------------------------------------------------- what can be told from what


def test_two_sensors_of_one_thing_are_told_apart_where_a_third_says_which(cart, by_hand):
    table = separation(by_hand(cart).monitor(crest=1.0))
    assert set(table) == set(cart.signals.y)
    for fault, row in table.items():
        assert set(row) == set(cart.signals.y) - {fault}
        assert all(0.0 < size < math.inf for size in row.values())


def test_a_constant_that_an_observer_takes_for_a_state_never_rules_it_out(cart, by_hand):
    """A state that nothing drives and that only adds to both positions: a constant offset of both is such a state."""
    blind = replace(
        cart,
        A=np.array([[-1e-12, 0.0], [0.0, -0.8]]),
        B=np.array([[0.0], [1.0]]),
    )
    table = separation(by_hand(blind, ("s1", "s2"), together=()).monitor(crest=1.0))
    assert math.isfinite(table["s1"]["s2"])
    sole = replace(
        blind,
        signals=replace(cart.signals, y=type(cart.signals.y)(("s1", "v1"), ranges=(2.0, 2.0))),
        C=cart.C[[0, 2]],
        D=cart.D[[0, 2]],
        noise=Noise(0.05, (0.01, 0.01)),
        operating_point=None,
    )
    table = separation(by_hand(sole).monitor(crest=1.0))
    assert table["s1"]["v1"] == math.inf


def test_a_fault_of_the_actuator_has_no_constant_that_is_looked_for():
    push = FaultChannel("push harder", {"force": 1.0}, "actuator", size=1.0, rate=0.5)
    monitor = bank(replace(chain(), faults=(push,)), sensors=("position1",), actuators=("force",)).monitor(crest=1.0)
    assert separation(monitor)["push harder"] == {"position1": math.inf}


def test_what_cannot_be_bounded_is_not_tested_and_says_why(made):
    """A fault of the actuator is found by an observer that follows it, which takes a rate."""
    monitor = made.monitor(crest=1.0)
    assert "force" not in [h.name for h in monitor.hypotheses]
    assert "no rate is declared for force" in str(monitor.refused["force"])


def test_a_larger_noise_asks_for_larger_faults(cart, by_hand):
    quiet, loud = (
        separation(by_hand(replace(cart, noise=Noise(0.05, (sd,) * 4))).monitor(crest=1.0)) for sd in (0.01, 0.03)
    )
    for fault, row in quiet.items():
        assert all(loud[fault][name] > size for name, size in row.items())


def test_the_channel_of_a_fault_may_be_any(cart):
    """A fault that is declared on two sensors keeps its own hypothesis only when it is asked for by name."""
    shared = FaultChannel("bent", {"s1": 1.0, "s2": 1.0}, size=0.5)
    noisy = [Disturbance(f"noise {name}", {}, {name: 1.0}, size=0.01) for name in cart.signals.y]
    plant = replace(cart, faults=(shared,), disturbances=(*cart.disturbances, *noisy))
    made = bank(plant, sensors=("mix",), together=(("bent",),))
    assert not made.refused
    assert made.designs["bent"].plant.faults == (shared,)
