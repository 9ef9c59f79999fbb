# SPDX-License-Identifier: BSD-3-Clause
"""Which methods apply, which one is picked, and how the command line says why there is no design."""

import inspect
import json
import re
from dataclasses import replace

import pytest

import faultrecon as fr
from faultrecon.advise.recommendation import EQUAL, error_of
from faultrecon.advise.trials import trial_plants
from faultrecon.advise.why_not import why_failed
from faultrecon.methods.registry import method
from faultrecon.synthesis import pipeline

SPRING, PENDULUM, *_ = trial_plants()


def test_every_method_is_in_the_table_and_applies_or_says_why_not():
    for plant in (SPRING, fr.library("lipschitz_polynomial"), replace(SPRING, sample_time=0.1)):
        advice = fr.recommend(plant)
        assert {row.method for row in advice.table} == set(fr.list_methods())
        assert all(row.applies or row.findings for row in advice.table)
        assert all(name in str(advice) for name in fr.list_methods())


def test_baselines_are_recommended_after_methods():
    named = fr.recommend(SPRING).applicable
    baseline = [method(name).baseline for name in named]
    assert named[0] == "lipschitz-hinf" and "open-loop" in named and baseline == sorted(baseline)


def test_a_method_whose_assumption_fails_is_not_recommended():
    advice = fr.recommend(fr.library("lipschitz_polynomial"))
    assert advice.applicable == ("lipschitz-hinf", "adaptive-uio", "augmented-uio")
    assert "has to stay below 1" in str(advice)
    assert not advice["open-loop"].applies


def test_the_best_has_a_certificate_and_no_other_that_has_one_is_clearly_better_in_the_scenario():
    found = fr.best(SPRING)
    entries = [e for e in found.table.entries if e.level is not None and e.scores]
    assert {e.method for e in entries} >= {"lipschitz-hinf", "open-loop"}
    assert error_of(found.table[found.method]) <= EQUAL * min(error_of(e) for e in entries)
    assert found.method in str(found)
    assert found.rule in str(found)
    made = found.design()
    assert made.method == found.method
    assert made.verification is not None
    assert made.verification.sound


def test_designing_with_the_best_is_designing_with_the_one_that_best_picks_and_says_so():
    picked, stages = fr.best(SPRING), []
    made = fr.design(SPRING, "best", backoff=0.2, progress=stages.append)
    assert stages[0] == "comparing methods"
    assert made.method == picked.method
    # The options are those of the design that ships: the level is (1 + backoff) times the optimum at least.
    least = picked.design().details.bounded_optimum
    assert made.level is not None and least is not None
    assert made.level >= 1.2 * least * (1 - 1e-6)
    assert made.method in made.details.notes[0] and picked.rule in made.details.notes[0]
    assert all(name in made.details.notes[0] for name in fr.recommend(SPRING).applicable)


def test_the_best_is_asked_for_the_faults_that_are_to_be_reconstructed():
    plant = fr.library("lipschitz_polynomial")
    name = plant.faults[0].name
    assert [f.name for f in fr.design(plant, "best", faults=[name]).plant.faults] == [name]


@pytest.mark.parametrize("options", [{}, {"level": 4.0, "pole_bound": None}, {"backoff": 0.3, "pole_bound": 50.0}])
def test_the_public_design_by_name_is_that_of_the_pipeline(options):
    plant = fr.library("lipschitz_polynomial")
    ours, theirs = fr.design(plant, **options), pipeline.design(plant, **options)
    assert (ours.level, ours.optimum, ours.floor) == (theirs.level, theirs.optimum, theirs.floor)
    assert all((ours.gains[k] == theirs.gains[k]).all() for k in theirs.gains)


def test_the_public_design_takes_the_same_options_as_the_pipeline():
    ours, theirs = (inspect.signature(f).parameters for f in (fr.design, pipeline.design))
    assert {k: (p.default, p.kind) for k, p in ours.items()} == {k: (p.default, p.kind) for k, p in theirs.items()}


def test_where_nothing_applies_there_is_no_best_and_the_message_says_where_to_look():
    with pytest.raises(fr.Impossible, match=r"none of .* methods applies") as refused:
        fr.best(replace(SPRING, sample_time=0.1))
    assert "faultrecon check" in refused.value.finding.remedies[0]


def test_design_with_the_best_method_says_which_and_by_what_rule(cli, tmp_path):
    code, out, err = cli("design", "lipschitz_polynomial", "--method", "best", "--out", tmp_path / "d.json")
    assert (code, err) == (0, "")
    assert "picked: lipschitz-hinf" in out
    assert "rule: of the designs that carry a certificate" in out
    assert (tmp_path / "d.json").exists()
    code, out, _ = cli("design", "lipschitz_polynomial", "--method", "best", "--json")
    assert json.loads(out)["picked"]["method"] == json.loads(out)["method"] == "lipschitz-hinf"


def test_a_design_that_cannot_be_is_explained_with_numbers_and_code_1(cli):
    code, out, err = cli("design", "lipschitz_polynomial", "--method", "lipschitz-hinf-thau")
    assert (code, out) == (1, "")
    assert "shrink the domain to x1 in" in err
    assert "up to a Lipschitz constant" in err
    code, out, _ = cli("design", "lipschitz_polynomial", "--method", "lipschitz-hinf-thau", "--json")
    told = json.loads(out)
    assert code == 1
    assert told["explanation"]["stage"] == "whole"
    assert told["explanation"]["tradeoff"]["solvable"] == pytest.approx(0.6343, rel=1e-3)
    assert told["error"]["what"] == told["explanation"]["findings"][0]["what"]


def test_check_says_which_methods_apply_and_what_to_type_next(cli):
    code, out, _ = cli("check", "lipschitz_polynomial")
    assert code == 0
    assert re.search(r"lipschitz-hinf +applies", out)
    assert re.search(r"open-loop +does not apply", out)
    assert "--method lipschitz-hinf" in out
    _, out, _ = cli("check", "lipschitz_polynomial", "--json")
    assert json.loads(out)["recommendation"]["applicable"][0] == "lipschitz-hinf"


def test_gains_that_could_not_be_proved_are_no_negative_answer():
    error = fr.Inconclusive("no gains were found that could be proved", remedies=("ask for a larger level",))
    found = why_failed(SPRING, "lipschitz-hinf", error)
    assert (found.stage, found.exit_code) == ("proof", 3)
    assert found.findings[0] is error.finding
    assert "has a solution" in str(found)


def test_check_ranks_sensors_and_tabulates_faults_when_asked(cli):
    code, out, _ = cli("check", "airliner", "--sensors")
    assert code == 0
    assert "the best first" in out
    assert "pitch_rate and roll_rate: reconstructible; isolable" in out
    told = json.loads(cli("check", "airliner", "--sensors", "--json")[1])
    assert {row["change"] for row in told["sensors"]} == {"add", "protect"}
    assert "sensors" not in json.loads(cli("check", "airliner", "--json")[1])
