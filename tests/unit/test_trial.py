# SPDX-License-Identifier: BSD-3-Clause
"""Trials of a monitor: missed faults by size, false alarms, and what is refused."""

import json
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import faultrecon
from faultrecon.finding import InputError
from faultrecon.io.bankfile import read_bank, write_bank
from faultrecon.plant.fault import Disturbance
from faultrecon.plant.lipschitz import Lipschitz
from faultrecon.plant.signals import Noise
from faultrecon.runtime.apart import separation
from faultrecon.simulation.proving_ground import Ground
from faultrecon.simulation.trial import LADDER, Trial, trial
from faultrecon.synthesis.bank import bank

OPTIONS = {"spans": (0.5, 2.5), "window": 10, "crest": 1.0}
RUNS = 6


@pytest.fixture(scope="module")
def made(by_hand, cart_monitor):
    return by_hand(cart_monitor.plant)


@pytest.fixture(scope="module")
def tried(made):
    told = []
    found = trial(made, runs=RUNS, hours=0.1, seed=1, progress=told.append, **OPTIONS)
    return found, told


def by_size(found, fault, waveform):
    return [one for one in found.found if (one.fault, one.waveform) == (fault, waveform)]


def test_every_fault_is_tried_at_every_size_as_a_step_and_as_a_ramp(tried, made):
    found, told = tried
    assert len(found.found) == 4 * 2 * len(LADDER)
    assert {one.runs for one in found.found} == {RUNS}
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_a_fault_of_the_size_that_is_certain_is_never_missed(tried, made):
    found, _ = tried
    needed = separation(made.monitor(**OPTIONS))
    for name, certain in found.certain.items():
        assert certain == max(needed[name].values())
        for waveform in ("step", "ramp"):
            largest = by_size(found, name, waveform)[-1]
            assert largest.size == pytest.approx(certain)
            assert (largest.missed, largest.wrong) == (0, 0)
            assert math.isfinite(largest.delay_90)


def test_the_missed_rate_does_not_rise_with_size(tried):
    """All sizes meet the same noise, so what a small one shows a large one does; one run of slack for chance."""
    found, _ = tried
    some = 0
    for name in found.certain:
        for waveform in ("step", "ramp"):
            missed = [one.missed for one in by_size(found, name, waveform)]
            assert all(b <= a + 1 for a, b in pairwise(missed))
            some += missed[0]
    assert some > 0  # the smallest sizes are below what can be found: the trial does show where it ends


def test_nothing_is_made_up_while_bounds_hold(tried):
    found, _ = tried
    assert found.false_alarms == 0
    assert 0.09 < found.hours < 0.11  # whole runs, each less its warming up
    assert found.false_alarms_between == (0.0, pytest.approx(-math.log(0.05) / found.hours))
    assert f"at most {-math.log(0.05) / found.hours:.3g}" in str(found)


def test_a_median_delay_is_never_where_most_runs_missed(tried):
    found, _ = tried
    for one in found.found:
        assert math.isinf(one.delay) == (2 * one.missed >= one.runs)
        assert one.delay <= one.delay_90
        assert one.missed_between[0] <= one.missed_rate <= one.missed_between[1]


def test_the_seed_says_it_all(made):
    options = {"faults": ["v1"], "runs": 2, "hours": 0.0, "duration": 5.0, **OPTIONS}
    one, again, other = (trial(made, seed=seed, **options) for seed in (3, 3, 4))
    assert one == again
    assert [f.delay for f in one.found] != [f.delay for f in other.found]
    assert one.hours == 0.0
    assert math.isnan(one.false_alarms_per_hour)
    assert "cannot be counted" in str(one)


def test_sizes_are_in_declared_sizes_each_once_and_sorted(made):
    found = trial(made, faults=["s1"], sizes=[0.5, 0.1, 0.5], waveforms=["step"], runs=1, hours=0.0, **OPTIONS)
    assert [one.size for one in found.found] == [0.2, 1.0]  # of 2
    assert [one.part for one in found.found] == [0.1, 0.5]


def test_a_ramp_takes_its_declared_rate(made):
    slow = made.designs["s1"].plant.faults[0]
    slow = replace(slow, rate=0.1)
    design = made.designs["s1"]
    bank_ = replace(made, designs={**made.designs, "s1": replace(design, plant=replace(design.plant, faults=(slow,)))})
    found = trial(bank_, faults=["s1"], sizes=[0.5], waveforms=["ramp"], runs=1, hours=0.0, **OPTIONS)
    assert found.lasts == pytest.approx(1.5 * 1.0 / 0.1)
    with pytest.raises(InputError, match=r"takes 10 s at its declared rate.*pass a duration of 15 s"):
        trial(bank_, faults=["s1"], sizes=[0.5], runs=1, duration=5.0, **OPTIONS)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sizes": [0.0]}, "positive"),
        ({"sizes": [math.nan]}, "positive"),
        ({"sizes": []}, "nothing to try"),
        ({"runs": 0}, "one or more"),
        ({"hours": -1.0}, "zero or more"),
        ({"duration": math.inf}, "positive number of seconds"),
        ({"duration": 0.3}, "cannot be named"),
        ({"faults": ["mixx"]}, "did you mean 'mix'"),
        ({"faults": []}, "no fault to try"),
        ({"waveforms": ["stepp"]}, "did you mean 'step'"),
        ({"inputs": {"forse": [1.0]}}, "did you mean 'force'"),
    ],
)
def test_what_makes_no_sense_is_refused(made, wrong, message):
    with pytest.raises(InputError, match=message):
        trial(made, **{"runs": 1, "hours": 0.0, **OPTIONS, **wrong})


def test_the_answer_is_plain_values_and_a_table(tried):
    found, _ = tried
    data = json.loads(json.dumps(found.as_dict()))
    assert data["found"][0]["fault"] == "s1"
    assert set(data["certain"]) == {"s1", "s2", "v1", "mix"}
    columns = found.columns()
    assert {len(values) for values in columns.values()} == {len(found.found)}
    assert {"missed_at_least", "missed_at_most", "delay", "size"} <= set(columns)
    assert "found for certain" in str(found)
    assert Trial("nothing", (), {}, 0, 0.0, 1.0, 0).columns() == {}


# ---------------------------------------------------------------- what happens to the plant


def ground(made, **options):
    return Ground(made.monitor(**OPTIONS), {}, {}, True, 0, **options)


def test_disturbances_move_and_stay_within_their_bounds(made):
    truth = ground(made).healthy("run 0", 100.0)
    size = made.plant.disturbances[0].size
    assert np.abs(truth.w).max() <= size * (1 + 1e-12)  # crest 1
    assert np.ptp(truth.w) > size
    assert (ground(made).healthy("run 1", 100.0).w != truth.w).any()


def test_noise_that_is_declared_twice_acts_once(cart, by_hand):
    """Designs weigh it as a disturbance; the plant's own noise is what the sensor adds."""
    again = Disturbance("noise of s1", {}, {"s1": 1.0}, size=0.01)
    truth = ground(by_hand(replace(cart, disturbances=(*cart.disturbances, again)))).healthy("run 0", 20.0)
    assert not truth.w[:, 1].any()
    assert np.std(truth.noise[:, 0]) == pytest.approx(0.01, rel=0.2)


def test_a_fault_on_a_nonlinear_plant_meets_the_nonlinear_plant(cart, by_hand):
    """The run that all faults share is that of φ: it is simulated with it, not without."""
    from faultrecon.graph.function import Graph

    phi = Graph.from_texts(["0.1 * sin(s)"], {"x": ["s"], "u": ["force"], "t": ["t"]})
    bent = replace(cart, nonlinearity=Lipschitz(np.array([[0.0], [1.0]]), ("s",), phi, 0.1))
    straight, curved = (
        Ground(replace(by_hand(cart).monitor(**OPTIONS), plant=plant), {"force": [2.0]}, {}, True, 0).healthy("a", 10.0)
        for plant in (cart, bent)
    )
    assert np.abs(curved.x - straight.x).max() > 0.05


# ---------------------------------------------------------------- the command line


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    plant = faultrecon.library("two_mass")
    x = replace(plant.signals.x, ranges=(1.0, 1.0, 1.0, 1.0))
    u = replace(plant.signals.u, ranges=(2.0,))
    push = Disturbance("push", {"v2": 1.0}, size=0.1)
    plant = replace(
        plant,
        signals=replace(plant.signals, x=x, u=u),
        disturbances=(push,),
        noise=Noise(0.05, (0.01, 0.01)),
    )
    path = tmp_path_factory.mktemp("bank") / "bank.json"
    write_bank(bank(plant), path)
    return path


def test_simulate_with_a_bank_is_a_trial(file, cli, tmp_path):
    out = tmp_path / "trial.csv"
    arguments = ("--fault", "f", "--runs", 2, "--size", 4, "--size", 8, "--hours", 0.1, "--duration", 20, "--seed", 5)
    code, text, errors = cli("simulate", file, *arguments, "--out", out)
    assert (code, errors) == (0, "")
    assert text.splitlines()[0].split()[:3] == ["fault", "waveform", "size"]
    assert "h without a fault" in text
    assert out.read_text().splitlines()[0].startswith('"fault","waveform","size"')
    code, text, _ = cli("simulate", file, *arguments, "--json")
    data = json.loads(text)
    assert (code, len(data["found"]), data["seed"]) == (0, 4, 5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--size", 0), "positive"),
        (("--runs", 0), "one or more"),
        (("--fault", "ff"), "no fault 'ff'"),
        (("--fault", "f:step:size=1"), "--size"),
        (("--figure", "x.png"), "--out trial.csv"),
        (("--out", "x.txt"), "extension"),
        (("--input", "forse:step:size=1"), "did you mean 'force'"),
    ],
)
def test_wrong_words_are_refused_with_a_way_out(file, cli, arguments, message):
    code, _, errors = cli("simulate", file, *arguments)
    assert code == 2
    assert message in errors


def test_a_log_with_its_truth_is_scored_by_run(file, cli, drive, tmp_path):
    plant = read_bank(file).plant
    fault = 3.0 * (np.arange(2400) > 1500)
    t, u, y = drive(plant, np.random.default_rng(1), 2400, faults={"position2": fault})
    names = (*plant.signals.u, *plant.signals.y)
    log = tmp_path / "log.csv"
    columns = {"t": t, **dict(zip(names, np.hstack([u, y]).T, strict=True))}
    faultrecon.write_log(log, columns | {"true_f_f": fault})
    code, text, _ = cli("run", file, log, "--json")
    scores = json.loads(text)["scores"]
    assert (code, len(scores["episodes"]), scores["episodes"][0]["fault"]) == (0, 1, "f")
    assert "against the recorded truth:" in cli("run", file, log)[1]
    faultrecon.write_log(log, columns)
    assert json.loads(cli("run", file, log, "--json")[1])["scores"] is None
