# SPDX-License-Identifier: BSD-3-Clause
"""Which sensor would help is answered with the floor it would give, and combinations of faults as a table."""

import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from faultrecon.cli.checking import examined
from faultrecon.diagnosis.diagnosis import diagnose
from faultrecon.diagnosis.existence import additive_sensor_findings, assumptions
from faultrecon.diagnosis.limits import Floor, reconstruction_floor, slow_fault_floor
from faultrecon.diagnosis.sensors import Candidate, fault_sets, rank_sensors, what_would_help, with_sensor
from faultrecon.finding import InputError
from faultrecon.io.library import read_library
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Noise, Signals

AIRLINER = read_library("lipschitz_aircraft")


def mass(*faulty, p=3, sample_time=None):
    """A free mass: two encoders and a tacho, a push and noise on every sensor."""
    y = ("encoder", "laser", "tacho")[:p]
    A, C = np.array([[0.0, 1.0], [0.0, -0.2]]), np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])[:p]
    if sample_time is not None:
        A = np.eye(2) + sample_time * A
    signals = Signals(Channels(("position", "velocity")), Channels(("force",)), Channels(y))
    noise = tuple(Disturbance(f"noise of {name}", on={name: 1.0}, size=1e-3) for name in y)
    return Plant(
        "mass",
        signals,
        A,
        np.array([[0.0], [1.0]]),
        C,
        np.zeros((p, 1)),
        faults=tuple(FaultChannel(f"{name} drift", {name: 1.0}) for name in faulty),
        disturbances=(Disturbance("push", {"velocity": sample_time or 1.0}), *noise),
        noise=Noise(0.01, (1e-3,) * p),
        sample_time=sample_time,
    )


def test_another_position_sensor_makes_the_impossible_possible():
    options = what_would_help(mass("encoder", "laser"))
    assert {(o.kind, o.name) for o in options} == {
        ("add", "position"),
        ("protect", "encoder"),
        ("protect", "laser"),
    }
    assert all(o.gain == np.inf for o in options)
    assert what_would_help(mass("encoder")) == ()


def test_a_sensor_of_the_speed_does_not_help_where_the_position_is_lost():
    (option,) = rank_sensors(mass("encoder", "laser"), ["velocity"], protect=False)
    assert not option.possible
    assert str(option) == "add a healthy sensor velocity: does not help"


def test_an_extra_healthy_sensor_never_raises_the_floor_and_a_quieter_one_ranks_first():
    now = reconstruction_floor(AIRLINER).value
    state = AIRLINER.signals.x.names[0]
    loud, quiet = (Candidate(f"extra_{k}", {state: 1.0}, noise) for k, noise in (("loud", 10.0), ("quiet", 1e-3)))
    options = rank_sensors(AIRLINER, [loud, quiet], protect=False)
    assert [o.name for o in options] == ["extra_quiet", "extra_loud"]
    assert all(o.floor.value <= now * (1 + 1e-8) and o.gain >= 1 - 1e-8 for o in options)


def test_every_state_is_a_candidate_by_default_and_the_floors_are_in_order():
    options = rank_sensors(AIRLINER)
    assert sum(o.kind == "add" for o in options) == AIRLINER.n
    floors = [float(f"{o.floor.value:.6g}") for o in options if o.possible]
    assert floors == sorted(floors)


def test_protecting_a_sensor_is_having_one_fault_less():
    plant = AIRLINER
    for option in rank_sensors(plant, []):
        left = [f.name for f in plant.faults if f.name not in option.faults]
        assert option.floor.value == reconstruction_floor(plant.with_faults(left)).value


def test_an_added_sensor_reads_its_states_and_carries_its_noise():
    extra = with_sensor(mass("encoder"), Candidate("sonar", {"position": 2.0}, 0.05, "m"))
    assert extra.signals.y.names[-1] == "sonar"
    np.testing.assert_array_equal(extra.C[-1], [2.0, 0.0])
    assert extra.noise.sd[-1] == extra.disturbances[-1].size == 0.05
    assert not extra.F_f[-1].any()


@pytest.mark.parametrize(
    ("candidate", "message"),
    [
        (Candidate("sonar", {"positon": 1.0}), "did you mean 'position'"),
        (Candidate("sonar", {}), "reads no state"),
        (Candidate("sonar", {"position": 1.0}, -1.0), "has noise -1"),
        (Candidate("sonar", {"position": 1.0}, np.nan), "has noise nan"),
    ],
)
def test_a_candidate_that_makes_no_sense_is_refused(candidate, message):
    with pytest.raises(InputError, match=message):
        with_sensor(mass("encoder"), candidate)


def test_the_table_of_combinations_agrees_with_a_diagnosis_of_each():
    plant = mass("encoder", "laser", "tacho")
    rows = fault_sets(plant, largest=3)
    assert [r.faults for r in rows] == [c for k in (1, 2, 3) for c in combinations([f.name for f in plant.faults], k)]
    for row in rows:
        assert row.reconstructible == diagnose(plant.with_faults(row.faults)).possible
        assert bool(row.why) != row.reconstructible


def test_a_set_is_isolable_when_no_other_fault_looks_like_it():
    plant = replace(
        mass("encoder"),
        faults=(
            FaultChannel("a", {"encoder": 1.0}),
            FaultChannel("b", {"encoder": 2.0}),
            FaultChannel("c", {"encoder": 1.0, "tacho": 1.0}),
            FaultChannel("d", {"tacho": 1.0}),
        ),
    )
    rows = {r.faults: r for r in fault_sets(plant)}
    assert not rows[("a",)].isolable  # b moves the same sensor
    assert rows[("d",)].isolable
    assert not rows[("c", "d")].isolable  # a is their difference
    assert "dependent directions" in rows[("a", "b")].why


def test_a_sampled_plant_is_diagnosed_on_the_unit_circle():
    both = diagnose(mass("encoder", "laser", sample_time=0.01))
    assert not both.possible
    assert "z = 1" in str(both)
    one = diagnose(mass("encoder", sample_time=0.01)).together
    assert one.possible
    # Euler sampling at 10 ms moves the floor by about the sample time relative to the slowest time constant.
    assert one.floor == pytest.approx(diagnose(mass("encoder")).together.floor, rel=0.05)


def test_a_mode_at_rest_that_healthy_sensors_miss_has_an_infinite_floor():
    limit = reconstruction_floor(mass("encoder", "laser"))
    assert (limit.kind, limit.value) == ("hidden mode", np.inf)
    assert limit.noise_gain(1.0) is None
    assert "a constant fault looks like a drift of the plant" in str(limit)


def test_the_noise_gain_is_known_for_one_real_mode_only():
    assert Floor(0.5, 0.0, "hidden mode", (2.0 + 0j,)).noise_gain(1.0) == pytest.approx(1.0)
    assert Floor(0.5, 0.0, "hidden mode", (2.0 + 0j,)).noise_gain(0.4) == np.inf
    assert Floor(0.5, 1.0, "hidden mode", (2 + 1j, 2 - 1j)).noise_gain(1.0) is None
    assert Floor(0.5, 1.0).noise_gain(1.0) is None


def test_an_actuator_fault_is_diagnosed_as_slowly_varying():
    plant = replace(mass(), faults=(FaultChannel("motor loss", {"force": 1.0}, site="actuator"),))
    found = diagnose(plant).together
    assert found.possible
    assert all(c.holds for c in found.conditions)
    # The methods for additive sensor faults still refuse it.
    assert "actuator" in additive_sensor_findings(plant)[0].what


def test_every_assumption_carries_its_distance_and_its_source():
    for condition in assumptions(AIRLINER):
        assert condition.holds
        assert 0 < condition.distance <= 1
        assert condition.see


# ---------------------------------------------------------------- sensors in words


@pytest.mark.parametrize(
    ("text", "reads", "noise", "unit"),
    [
        ("sonar on position", {"position": 1.0}, 0.0, "m"),
        ("sonar on position=1 noise=0.01", {"position": 1.0}, 0.01, "m"),
        ("  sonar on position = 2  velocity=-0.5 noise = 1e-3", {"position": 2.0, "velocity": -0.5}, 1e-3, ""),
    ],
)
def test_a_sensor_in_words_reads_what_it_says(text, reads, noise, unit):
    base = mass("encoder")
    plant = replace(base, signals=replace(base.signals, x=Channels(base.signals.x.names, ("m", "m/s"))))
    assert Candidate.from_text(text, plant) == Candidate("sonar", reads, noise, unit)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sonar", "written 'name on state=coefficient noise=size', for example 'extra on position=1 noise=0.01'"),
        ("sonar reads position", "it is written"),
        ("sonar on positon", "reads 'positon', which is no state: did you mean 'position'"),
        ("sonar on position nois=0.1", "did you mean 'noise'"),
        ("sonar on position=one", "position=one: that is no finite number"),
        ("sonar on position noise", "noise=: that is no finite number"),
        ("sonar on position position=2", "names position twice"),
        ("tacho on position", "name of another signal"),
        ("2x on position", "no signal name"),
    ],
)
def test_a_sensor_in_words_that_makes_no_sense_is_refused_with_the_form(text, message):
    with pytest.raises(InputError, match=re.escape(message)):
        Candidate.from_text(text, mass("encoder"))


def test_check_ranks_the_sensors_that_are_offered_beside_its_own():
    plant = mass("encoder", "laser")
    possible, data, text = examined(plant, False, ["sonar on position noise=0.01"])
    assert not possible
    assert "add a healthy sensor sonar (reads position, noise 0.01): possible" in text
    assert "add a healthy sensor velocity: does not help" in text
    rows = {row["sensor"]: row for row in data["sensors"]}
    assert rows["sonar"]["possible"]
    assert rows["sonar"]["reads"] == {"position": 1.0}
    assert rows["sonar"]["noise"] == 0.01
    assert "fault_sets" not in data


def test_the_command_line_takes_a_sensor_and_mends_its_spelling(cli):
    code, out, _ = cli("check", "airliner", "--sensor", "probe on alpha noise=0.01")
    assert code == 0
    assert "probe (reads alpha, noise 0.01 rad): possible, floor" in out
    code, _, err = cli("check", "airliner", "--sensor", "probe on alfa")
    assert code == 2
    assert "did you mean 'alpha'?" in err


def test_the_floor_of_an_offered_sensor_falls_with_its_noise():
    state = AIRLINER.signals.x.names[0]
    texts = [f"extra{k} on {state} noise={noise}" for k, noise in enumerate((10.0, 0.1, 1e-3))]
    options = rank_sensors(AIRLINER, [Candidate.from_text(t, AIRLINER) for t in texts], protect=False)
    assert [o.name for o in options] == ["extra2", "extra1", "extra0"]


# ---------------------------------------------------------------- actuator faults


def test_the_floor_of_an_actuator_fault_says_that_it_holds_at_rest_and_what_would_bound_a_moving_one():
    leak = FaultChannel("motor loss", {"force": 1.0}, site="actuator")
    found = diagnose(replace(mass(), faults=(leak,)))
    # The push enters exactly like the force: one unit of it hides one unit of the fault.
    assert found.together.limit.value == pytest.approx(1.0)
    assert found.together.floor is None
    assert "no estimator that follows a constant fault can guarantee less than γ = 1" in str(found)
    (note,) = found.together.findings
    assert note.severity == "note"
    assert note.evidence["floor at rest"] == found.together.limit.value
    assert "rate = ..." in note.remedies[0]
    moving = diagnose(replace(mass(), faults=(replace(leak, rate=5.0),))).together
    assert moving.findings == ()
    assert "follows faults up to 5 rad/s" in str(moving.limit)
    # Noise of a millimetre and the inertia of the mass: above 1 rad/s the sensors matter more than the push.
    assert moving.limit.value > 1.0


def test_sensors_are_ranked_by_the_floor_of_actuator_faults_too():
    leak = FaultChannel("motor loss", {"force": 1.0}, site="actuator", rate=50.0)
    plant = replace(mass(), faults=(leak,))
    options = rank_sensors(plant, ["velocity"], protect=False)
    assert options[0].floor.kind == "slow fault"
    assert options[0].floor.value <= slow_fault_floor(plant).value


def test_an_added_sensor_leaves_the_limits_of_the_others_as_they_are():
    plant = mass()
    y = replace(plant.signals.y, limits=((-2.0, 2.0), *plant.signals.y.limits[1:]))
    limited = replace(plant, signals=replace(plant.signals, y=y))
    changed = with_sensor(limited, Candidate("gauge", {plant.signals.x.names[0]: 1.0})).signals.y
    assert changed.limited() == {y.names[0]: (-2.0, 2.0)}
