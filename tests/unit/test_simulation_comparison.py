# SPDX-License-Identifier: BSD-3-Clause
"""Methods side by side, the gallery of faults, and the verbs of the command line behind them."""

from dataclasses import replace

import pytest

from faultrecon.advise.comparison import compare, one_by_one
from faultrecon.advise.reproductions import Comparison, Row, reproduce, reproducible
from faultrecon.cli.simulating import parsed_signal, run_comparison, run_simulation, scenario_from
from faultrecon.finding import InputError
from faultrecon.io.library import read_library
from faultrecon.plot.gallery import Trace, every_fault, fault_gallery, traces_figure
from faultrecon.simulation.scenario import Scenario
from faultrecon.simulation.truth import true_run
from faultrecon.synthesis.pipeline import design

PAIR = ("lipschitz-hinf", "open-loop")


def test_the_table_shows_promises_and_performance_of_each_method():
    found = compare(read_library("airliner"), PAIR)
    ours, loop = found["lipschitz-hinf"], found["open-loop"]
    assert ours.verdict == "proved"
    assert ours.floor < ours.optimum < ours.level
    assert ours.achieved <= ours.level
    assert ours.scores["roll_rate"].nrmse < loop.scores["roll_rate"].nrmse
    assert set(ours.noise_sd) == set(ours.scores)
    text = str(found)
    for word in (*PAIR, "fastest pole", "largest step", "noise sd", "leak"):
        assert word in text


def test_a_baseline_without_a_certificate_runs_and_says_so():
    found = compare(read_library("lipschitz_polynomial"), PAIR)
    assert found["open-loop"].verdict == "none"
    assert found["open-loop"].note.startswith("runs without a certificate")
    assert found["open-loop"].scores is not None
    assert found["lipschitz-hinf"].verdict == "assumed"


def test_a_method_that_has_no_gains_gets_an_entry_that_says_why():
    plant = read_library("lipschitz_polynomial")
    both = replace(plant, faults=(*plant.faults, replace(plant.faults[0], name="g", on={"y1": 1.0})))
    found = compare(both, ("lipschitz-hinf",), Scenario.healthy(duration=0.1, sample_time=0.01))
    assert found["lipschitz-hinf"].verdict == "impossible"
    assert "all 2 sensors" in found["lipschitz-hinf"].note
    with pytest.raises(InputError, match="no method"):
        compare(plant, ("lipschitz",))


def test_the_default_scenario_keeps_the_plant_where_its_model_holds():
    plant = read_library("lipschitz_polynomial")
    scenario = one_by_one(plant)
    assert true_run(plant, scenario).left_domain() == ()
    assert "to stay in the domain" in scenario.name
    assert set(one_by_one(read_library("airliner")).faults) == {"pitch_rate", "pitch_angle", "roll_rate"}


def test_the_gallery_has_a_row_per_shape():
    made = design(read_library("airliner"))
    figure = fault_gallery(made, "pitch_rate", base=Scenario(duration=4.0), title="faults")
    assert len(figure.axes) == 2 * len(every_fault(1.0, 4.0))
    assert "nrmse" in figure.axes[1].get_title(loc="right")
    with pytest.raises(InputError, match="did you mean"):
        fault_gallery(made, "pitch_rat")
    with pytest.raises(InputError, match="nothing to draw"):
        traces_figure([0.0, 1.0], [])
    assert len(traces_figure([0.0, 1.0], [Trace("a", "m", {"x": ([0.0, 1.0], "#000000")})]).axes) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("pitch_rate:stp:size=1", "there is no shape stp; did you mean 'step'"),
        ("pitch_rate", "write NAME:SHAPE"),
        ("pitch_rate:step:size=x", "no key=number"),
        ("pitch_rate:step:siz=1", "did you mean 'size'"),
        ("pitch_rate:ramp:size=1", "needs over"),
    ],
)
def test_a_signal_that_cannot_be_read_says_how_to_write_it(text, words):
    with pytest.raises(InputError, match=words):
        parsed_signal(text)


def test_signals_are_written_as_name_shape_and_numbers():
    name, shape = parsed_signal("pitch_rate:ramp:size=0.4,over=10,at=5,until=30")
    assert name == "pitch_rate"
    assert shape([4.0, 10.0, 15.0, 30.0]).tolist() == [0.0, 0.2, 0.4, 0.0]
    scenario = scenario_from(["a:stuck"], ["b:doublet:size=1,width=2"], ["c:noise:sd=1,hold=0.1,seed=3"], duration=5.0)
    assert (list(scenario.faults), list(scenario.inputs), list(scenario.disturbances)) == (["a"], ["b"], ["c"])


def test_the_name_of_a_signal_is_checked_before_its_numbers():
    with pytest.raises(InputError, match="no fault 'pitch_rat': did you mean 'pitch_rate'"):
        scenario_from(["pitch_rat:ramp:size=1"], [], [], read_library("airliner"))


def test_noise_that_is_not_declared_is_a_footnote_of_the_comparison():
    plant = read_library("airliner")
    bare = replace(plant, disturbances=tuple(d for d in plant.disturbances if d.name != "noise_pitch_rate"))
    found = compare(bare, PAIR[:1], Scenario.healthy(duration=1.0))
    assert found[PAIR[0]].achieved is None
    assert "no gain achieved is shown: noise of pitch_rate acts" in str(found)


def test_the_verbs_answer_in_data_and_text(tmp_path):
    made = design(read_library("airliner"))
    scenario = scenario_from(["pitch_rate:step:size=0.04,at=2"], [], [], duration=4.0)
    out, figure = tmp_path / "run.csv", tmp_path / "run.png"
    data, text = run_simulation(made, scenario, out=out, figure=figure)
    assert out.exists()
    assert figure.stat().st_size > 10_000
    assert data["score"]["faults"]["pitch_rate"]["delay"] == 0.0
    assert f"wrote {out}" in text
    with pytest.raises(InputError, match="unknown kind of figure"):
        run_simulation(made, scenario, out=None, figure=tmp_path / "run.bmp")
    data, text = run_comparison(made.plant, PAIR, scenario)
    assert [entry["method"] for entry in data["methods"]] == list(PAIR)
    assert "open-loop" in text


def test_a_row_agrees_within_its_tolerance_and_with_what_is_predicted():
    assert Row("a", 1.009, 1.0, 0.01).agrees
    assert not Row("a", 1.011, 1.0, 0.01).agrees
    assert Row("a", 3.0, 9.0, 0.5, absolute=True, expected=3.4).agrees
    assert Row("a", None, None, 1.0).agrees
    assert not Row("a", 1.0, None, 1.0).agrees
    assert "DIFFERS" in str(Comparison("t", [Row("a", 2.0, 1.0, 0.1)]))


def test_only_papers_that_are_here_are_reproduced(tmp_path):
    assert "khosrowjerdi2011" in reproducible()
    with pytest.raises(InputError, match="did you mean 'khosrowjerdi2011'"):
        reproduce("khosrowjerdi2012")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be made a folder"):
        reproduce("khosrowjerdi2011", tmp_path / "file")
