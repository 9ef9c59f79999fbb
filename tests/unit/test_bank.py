# SPDX-License-Identifier: BSD-3-Clause
"""A bank: one design per explanation, what has none and why, and what can be told from what."""

import math
from dataclasses import replace

import numpy as np
import pytest

import faultrecon
from faultrecon.finding import Impossible, InputError
from faultrecon.io.logs import Log
from faultrecon.numerics.discretise import foh
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.runtime.apart import separation
from faultrecon.runtime.building import noise_room
from faultrecon.synthesis.bank import bank

PUSH = FaultChannel("push harder", {"force": 1.0}, "actuator", size=1.0, rate=0.5)


def chain():
    """The two masses, with what disturbs them and what their sensors add."""
    plant = faultrecon.library("two_mass")
    push = Disturbance("push", {"v2": 1.0}, size=0.1)
    return replace(plant, disturbances=(push,), noise=Noise(0.05, (0.01, 0.01)))


def pushed():
    """The same with a declared fault of its actuator."""
    return replace(chain(), faults=(*chain().faults, PUSH))


@pytest.fixture(scope="module")
def made():
    return bank(chain(), actuators=("force",), together=(("position1", "f"),))


@pytest.fixture(scope="module")
def both():
    return bank(pushed())


def test_every_sensor_has_a_hypothesis_and_every_declared_actuator_fault(made, both):
    assert list(made.designs) == ["position1", "f"]
    assert [d.method for d in made.designs.values()] == ["lipschitz-hinf"] * 2
    assert list(both.designs) == ["position1", "f", "push harder"]
    assert both.designs["push harder"].method == "euler-pi"
    assert "push harder" not in bank(pushed(), actuators=()).designs


def test_an_actuator_without_a_declared_rate_is_refused_with_the_table_to_write(made):
    """Designed it could be, and tested never."""
    refused = made.refused["force"]
    assert "no rate is declared for force" in refused.what
    assert any("[[fault]]" in r and 'actuator = "force"' in r and "rate" in r for r in refused.remedies)


@pytest.mark.parametrize(
    ("faults", "names"),
    [(("position1",), ["position1"]), (("push harder",), ["push harder"]), (("f", "position1"), ["f", "position1"])],
)
def test_named_faults_and_sensors_are_all_that_a_bank_is_about(faults, names):
    assert list(bank(pushed(), faults=faults).designs) == names


def test_a_fault_that_multiplies_is_looked_for_as_an_additive_one():
    gain = FaultChannel("gain", {"position2": 1.0}, effect="multiplicative")
    made = bank(replace(chain(), faults=(gain,)), faults=("gain",))
    assert made.designs["position2"].plant.faults[0].effect == "additive"


def tank(rate):
    """A sampled level with three gauges."""
    signals = Signals(Channels(("h",), ranges=(2.0,)), Channels(("pump",), ranges=(1.0,)), Channels(("a", "b", "c")))
    A, B, C = np.array([[0.98]]), np.array([[0.02]]), np.ones((3, 1))
    faults = tuple(FaultChannel(f"f{name}", {name: 1.0}, size=0.5, rate=rate) for name in signals.y)
    w = (Disturbance("inflow", {"h": 1.0}, size=0.001),)
    noise = Noise(1.0, (0.01,) * 3)
    return Plant("tank", signals, A, B, C, np.zeros((3, 1)), faults, w, noise=noise, sample_time=1.0)


def test_a_sampled_plant_takes_the_method_that_is_made_for_it():
    made = bank(tank(0.01))
    assert {d.method for d in made.designs.values()} == {"euler-pi"}
    assert not made.monitor().refused


def test_a_sampled_plant_without_rates_is_told_to_declare_them():
    with pytest.raises(Impossible, match="no rate is declared") as refusal:
        bank(tank(math.inf))
    assert "rate = " in str(refusal.value) and "continuous" not in str(refusal.value)


def test_options_reach_every_design():
    made = bank(equal_gauges(0.02), backoff=0.5, pole_bound=50.0)
    for design in made.designs.values():
        assert design.details.pole_bound == 50.0
        assert design.details.backoff == pytest.approx(0.5)


@pytest.mark.parametrize("options", [{"method": "nobody"}, {"backoff": -1.0}, {"pole_bound": 0.0}])
def test_an_option_that_makes_no_sense_is_said_and_not_taken_for_a_missing_design(options):
    with pytest.raises(InputError, match=r"nobody|back-off|pole bound"):
        bank(chain(), **options)


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
    assert set(made.refused) == {"position1 + f", "force"}
    assert str(made.refused["position1 + f"])
    assert "position1 + f: no design" in made.report()
    assert made.as_dict()["refused"]["position1 + f"]


def test_sensors_that_count_as_exact_are_the_reason_that_is_given_once(quiet):
    """Without noise on the others the optimum is zero, and what a solver says of that helps nobody."""
    made, refused = quiet, str(quiet.refused["shunt"])
    assert list(made.designs) == ["tacho", "encoder"]
    assert "no disturbance acts on tacho and encoder" in refused and "[[disturbance]]" in refused
    assert "Clarabel" not in made.report() and made.report().count("count as exact") == 1
    noisy = tuple(Disturbance(f"noise {name}", {}, {name: 1.0}, size=0.5) for name in quiet.plant.signals.y)
    mended = replace(quiet.plant, disturbances=(*quiet.plant.disturbances, *noisy))
    assert not bank(mended).refused


def test_what_has_no_design_is_not_tested_when_the_bank_runs_and_says_why(quiet):
    assert quiet.monitor().refused["shunt"] == quiet.refused["shunt"]
    log = Log(np.arange(50) * 0.01, np.zeros((50, 1)), np.zeros((50, 3)))
    watched = faultrecon.watch(quiet, log)
    assert "not tested: shunt" in str(watched)
    assert "no disturbance acts on" in watched.as_dict()["untested"]["shunt"]["why"]


def test_noise_gets_room_by_what_is_tested(both, by_hand, cart):
    """Behind each filter: the faults of every hypothesis, and the sensors that these do not reach."""
    for one in (both, by_hand(cart, together=(("s1", "s2"),))):
        monitor = one.monitor(crest=1.0)
        tested = sum(int(np.isfinite(h.watch.limits).sum()) for h in monitor.hypotheses)
        room = noise_room(0.01, tested, monitor.sample_time, monitor.rules)
        assert monitor.hypotheses[0].watch.bounds.allowance.noise_peak == room


def test_faults_that_act_together_are_one_hypothesis(cart):
    together = bank(cart, sensors=("mix",), together=(("s1", "v1"),))
    assert [f.name for f in together.designs["s1 + v1"].plant.faults] == ["s1", "v1"]
    assert {f.name for f in together.plant.faults} == {"mix", "s1", "v1"}


@pytest.fixture(scope="module")
def quiet():
    """A motor with two speed sensors and a shunt, of which none has a disturbance that counts."""
    signals = Signals(
        Channels(("speed", "current"), ranges=(100.0, 20.0)),
        Channels(("voltage",), ranges=(24.0,)),
        Channels(("tacho", "encoder", "shunt"), ranges=(100.0, 100.0, 20.0)),
    )
    A, B = np.array([[-1.0, 5.0], [-2.0, -20.0]]), np.array([[0.0], [20.0]])
    C = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    load, noise = Disturbance("load", {"speed": 1.0}, size=5.0), Noise(0.01, (0.5, 0.5, 0.05))
    return bank(Plant("motor", signals, A, B, C, np.zeros((3, 1)), disturbances=(load,), noise=noise))


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
    again = bank(chain())
    assert made.digest == again.digest != bank(chain(), sensors=("position1",)).digest


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


def test_a_constant_fault_of_the_actuator_rules_out_the_sensors_from_a_size_on(quiet, drive):
    """And in a run with somewhat more than that it is named."""
    noise = zip(quiet.plant.signals.y, quiet.plant.noise.sd, strict=True)
    own = tuple(Disturbance(f"noise {name}", {}, {name: 1.0}, size=sd) for name, sd in noise)
    amplifier = FaultChannel("amplifier", {"voltage": 1.0}, "actuator", size=5.0, rate=10.0)
    plant = replace(quiet.plant, faults=(amplifier,), disturbances=(*quiet.plant.disturbances, *own))
    monitor = bank(plant).monitor(crest=1.0)
    needed = separation(monitor)["amplifier"]
    assert set(needed) == {"tacho", "encoder", "shunt"} and 0.0 < max(needed.values()) < 24.0
    still = replace(plant, disturbances=plant.disturbances[:1])
    t, u, y = drive(still, np.random.default_rng(3), 3000, T=0.01)
    extra = np.clip(10.0 * (t - 10.0), 0.0, 1.2 * max(needed.values()))
    Phi, U0, U1 = foh(plant.A, plant.B, 0.01)
    x = np.zeros((3000, plant.n))
    for k in range(2999):
        x[k + 1] = Phi @ x[k] + U0[:, 0] * extra[k] + U1[:, 0] * extra[k + 1]
    state, _ = monitor.take(monitor.start(), t, u, y + x @ plant.C.T)
    last = monitor.events(state)[-1]
    assert (last.mode, last.fault) == ("fault", "amplifier")


def test_a_design_whose_errors_have_no_bound_is_not_tested_and_names_the_rate():
    """A sensor that an observer follows takes a rate as well."""
    plant = chain()
    slow = replace(plant, faults=tuple(replace(f, rate=0.5) for f in plant.faults))
    monitor = bank(slow, faults=("position1", "f"), method="adaptive-uio").monitor(crest=1.0)
    assert set(monitor.refused) == {"position1"}
    assert "no rate is declared for position1" in str(monitor.refused["position1"])
    assert "rate = " in str(monitor.refused["position1"])


def equal_gauges(size):
    """Two gauges of one slow level; a disturbance of that size moves it."""
    x, y = Channels(("x",), ranges=(10.0,)), Channels(("a", "b"), ranges=(10.0, 10.0))
    signals = Signals(x, Channels(("u",)), y)
    own = [Disturbance(f"noise {name}", {}, {name: 1.0}, size=0.1) for name in signals.y]
    w = (Disturbance("w", {"x": 1.0}, size=size), *own)
    faults = tuple(FaultChannel(f"f{name}", {name: 1.0}, size=1.0) for name in signals.y)
    A, B, C, D = np.array([[-0.05]]), np.ones((1, 1)), np.ones((2, 1)), np.zeros((2, 1))
    return Plant("level", signals, A, B, C, D, faults, w, noise=Noise(0.1, (0.1, 0.1)))


def test_faults_that_no_constant_within_their_range_tells_apart_are_reported_as_a_group():
    """A disturbance as large as this moves the level as any fault would; a small one does not."""
    unsure, sure = bank(equal_gauges(50.0)), bank(equal_gauges(0.02))
    assert unsure.apart.groups == (("fa", "fb"),) and sure.apart.groups == ()
    needed = unsure.apart.needed["fa"]["fb"]
    assert needed > 10.0 == unsure.apart.largest["fa"] > sure.apart.needed["fa"]["fb"]
    assert (
        "not told apart for certain: fa, fb" in unsure.report() and f"{needed:.4g} would rule it out" in unsure.report()
    )
    assert "told apart: every fault from every other" in sure.report()
    assert unsure.as_dict()["apart"]["groups"] == [["fa", "fb"]]


def test_diagnose_names_faults_that_look_like_each_other():
    notes = faultrecon.diagnose(equal_gauges(50.0)).notes
    assert [n.evidence["group"] for n in notes if "told apart" in n.what] == [["fa", "fb"]]
    assert not [n for n in faultrecon.diagnose(equal_gauges(0.02)).notes if "told apart" in n.what]


def test_two_faults_of_one_sensor_look_like_each_other(cart):
    twice = tuple(FaultChannel(name, {"s1": 1.0}, size=2.0) for name in ("bias", "drift"))
    other = FaultChannel("other", {"v1": 1.0}, size=2.0)
    notes = faultrecon.diagnose(replace(cart, faults=(*twice, other))).notes
    assert [n.evidence["group"] for n in notes if "told apart" in n.what] == [["bias", "drift"]]


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
