# SPDX-License-Identifier: BSD-3-Clause
"""What a caller may ask of a design, and how a wish that cannot be met is answered."""

from dataclasses import replace

import numpy as np
import pytest

from faultrecon.advise.trials import trial_plants
from faultrecon.diagnosis.limits import reconstruction_floor
from faultrecon.finding import Impossible, InputError
from faultrecon.io.library import read_library
from faultrecon.methods.registry import list_methods, method
from faultrecon.plant.signals import Noise
from faultrecon.storage.atomic import write_text
from faultrecon.synthesis.certify import conforms
from faultrecon.synthesis.levels import scale
from faultrecon.synthesis.pipeline import automatic_pole_bound, design, optimum

PLANT = read_library("lipschitz_polynomial")
BALANCE = next(p for p in trial_plants() if p.name == "balance")


def test_a_level_below_the_floor_is_refused_with_both_numbers():
    with pytest.raises(
        Impossible, match=r"γ = 0\.3 is below 0\.58732\d, the best any estimator can guarantee"
    ) as caught:
        design(PLANT, level=0.3)
    assert caught.value.finding.evidence == {"level": 0.3, "floor": reconstruction_floor(PLANT).value}


def test_a_level_below_the_optimum_is_refused_with_a_level_to_ask_for():
    with pytest.raises(Impossible, match=r"γ = 2 is below 3\.417\d*, the optimum of lipschitz-hinf;") as caught:
        design(PLANT, level=2.0, pole_bound=None)
    assert caught.value.finding.remedies[0] == "ask γ ≥ 3.589"


def test_a_level_that_only_the_pole_bound_forbids_says_so():
    with pytest.raises(Impossible, match="with poles to the right of -5 rad/s") as caught:
        design(PLANT, level=3.45, pole_bound=5.0)
    assert "raise pole_bound" in caught.value.finding.remedies
    assert design(PLANT, level=3.45, pole_bound=None).level == 3.45


@pytest.mark.parametrize("level", [0.0, -1.0, float("nan"), float("inf")])
def test_a_level_is_a_positive_number(level):
    with pytest.raises(InputError, match="γ is a positive number"):
        design(PLANT, level=level)


@pytest.mark.parametrize("backoff", [0.0, -0.05, float("nan"), float("inf")])
def test_a_back_off_is_a_positive_number(backoff):
    with pytest.raises(InputError, match="the optimum itself is not attained"):
        design(PLANT, backoff=backoff)


@pytest.mark.parametrize("bound", [0.0, -1.0, float("nan"), float("inf"), "fast"])
def test_a_pole_bound_is_auto_none_or_a_positive_number(bound):
    with pytest.raises(InputError, match="the pole bound is"):
        design(PLANT, pole_bound=bound)


def test_the_automatic_pole_bound_suits_the_hold_time_of_the_noise():
    noisy = replace(PLANT, noise=Noise(0.05, (1e-3, 1e-3)))
    assert automatic_pole_bound(noisy) == pytest.approx(40.0)
    found = design(noisy)
    assert found.details.pole_bound == pytest.approx(40.0)
    assert np.abs(found.observer.poles.real).max() <= 40.0
    assert found.details.largest_step > 0.05


def test_an_unknown_method_is_answered_with_a_suggestion():
    with pytest.raises(InputError, match="did you mean 'lipschitz-hinf'"):
        design(PLANT, "lipschitz-hinv")


def test_an_unknown_fault_is_answered_with_a_suggestion():
    with pytest.raises(InputError, match="there is no fault 'g'"):
        design(PLANT, faults=["g"])
    with pytest.raises(InputError, match="did you mean 'f1'"):
        design(read_library("lipschitz_aircraft"), faults=["f11"])


def test_a_fault_asked_for_twice_is_refused():
    with pytest.raises(InputError, match="the fault 'f' is asked for twice"):
        design(PLANT, faults=["f", "f"])


def test_no_fault_asked_for_is_no_design():
    with pytest.raises(Impossible, match="declares no fault"):
        design(PLANT, faults=[])


@pytest.mark.parametrize("name", ["β", "beta"])
def test_an_unknown_can_be_held_by_either_name(name):
    assert optimum(PLANT, fix={name: 3.0}) == pytest.approx(3.4222394, rel=1e-6)


@pytest.mark.parametrize("name", ["K₁", "K1"])
def test_what_the_method_holds_can_be_set_free_by_either_name(name):
    assert optimum(PLANT, free=(name,)) <= optimum(PLANT) * (1 + 1e-6)


def test_holding_an_unknown_never_lowers_the_optimum():
    best = optimum(PLANT)
    for β in (2.0, 2.9, 4.0):
        assert optimum(PLANT, fix={"β": β}) >= best * (1 - 1e-7)


def test_a_held_unknown_is_what_ships():
    K1 = [[0.25]]
    found = design(PLANT, fix={"K1": K1, "beta": 3.0})
    assert np.array_equal(found.certificate.data["β"]["hex"], [(3.0).hex()])
    # Both scalings are powers of two and the fault has size one, so K₁ ships up to the unit of the healthy output.
    ratio = found.gains["K1"][0, 0] / 0.25
    assert np.log2(ratio) == round(np.log2(ratio))


@pytest.mark.parametrize("wrong", [{"gamma": 1.0}, {"Q": 1.0}])
def test_holding_a_letter_that_is_no_unknown_is_refused(wrong):
    with pytest.raises(InputError, match="is held fixed: the unknowns are"):
        design(PLANT, fix=wrong)


@pytest.mark.parametrize("wrong", [("Q",), ("β",), "K1"])
def test_setting_free_what_is_not_held_is_refused(wrong):
    with pytest.raises(InputError, match="cannot be set free"):
        design(PLANT, free=wrong)


@pytest.mark.parametrize("name", ["γ²", "gamma2"])
def test_what_is_minimised_cannot_be_held(name):
    with pytest.raises(InputError, match="it is what is minimised"):
        optimum(PLANT, fix={name: 9.0})


@pytest.mark.parametrize("value", [np.nan, np.inf, np.ones((3, 3))])
def test_an_unknown_is_held_at_a_finite_value_of_its_shape(value):
    with pytest.raises(InputError):
        design(PLANT, fix={"β": value})


def test_gains_without_a_proof_claim_nothing():
    found = design(read_library("lipschitz_aircraft"), "open-loop", certify=False)
    assert found.level is None
    assert found.certificate is None
    assert found.verification is None
    assert "certificate: none; nothing is claimed" in found.report()
    assert found.as_dict()["verdict"] is None


def test_a_method_whose_gains_come_from_its_theorem_has_none_without():
    with pytest.raises(InputError, match="has no gains without its theorem"):
        design(PLANT, certify=False)


def test_progress_is_told_in_words_before_each_stage():
    said = []
    design(PLANT, progress=said.append)
    assert said[:2] == ["floor", "optimum"]
    assert said[-1] == "proof"


def test_the_same_question_gets_the_same_bits():
    one, two = design(PLANT), design(PLANT)
    assert one.level == two.level
    assert all(np.array_equal(one.gains[k], two.gains[k]) for k in one.gains)
    assert one.certificate.digests == two.certificate.digests


def test_a_design_carries_only_the_faults_that_were_asked_for():
    plant = replace(read_library("lipschitz_aircraft"), disturbances=(
        *read_library("lipschitz_aircraft").disturbances,
        *(replace(read_library("lipschitz_aircraft").disturbances[1], name=f"n{k}", on={k: 1.0}) for k in ("y3", "y4")),
    ))  # fmt: skip
    found = design(plant, faults=["f2"])
    assert [f.name for f in found.plant.faults] == ["f2"]
    assert found.observer.Df.shape[0] == 1


def test_the_report_says_level_optimum_floor_and_scope():
    text = design(PLANT).report()
    for part in ("γ shipped", "optimum 3.41782", "floor 0.587324", "poles: fastest", "scope: covers", "assumed"):
        assert part in text


def test_variants_are_listed_on_request_only():
    assert "lipschitz-hinf-thau" not in list_methods()
    assert "lipschitz-hinf-thau" in list_methods(variants=True)
    assert method("lipschitz-hinf-thau").reproductions == ()


def test_a_file_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot write"):
        write_text(tmp_path / "folder", "text")
    with pytest.raises(InputError, match="cannot write"):
        write_text(tmp_path / "missing" / "file", "text")
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]


def test_a_bound_below_zero_is_refused_since_the_claim_would_not_follow():
    for ask in (design, optimum):
        with pytest.raises(InputError, match=r"p_min is -1\.0: below zero .* leave p_min out"):
            ask(BALANCE, "sliding-mode", fix={"p_min": -1.0})


def test_a_bound_at_zero_is_noted_and_one_above_is_not():
    for value, noted in ((0, True), (1e-3, False)):
        notes = design(BALANCE, "sliding-mode", fix={"p_min": value}).details.notes
        assert any("p_min is held at 0: nothing keeps P from losing rank" in note for note in notes) == noted


def test_a_bound_cannot_be_set_free():
    with pytest.raises(InputError, match="p_min is set free"):
        design(BALANCE, "sliding-mode", free=("p_min",))


def test_a_stored_certificate_with_such_a_number_below_zero_does_not_state_its_theorem():
    made = design(BALANCE, "sliding-mode")
    assert made.certificate is not None
    theorem = method("sliding-mode").theorem(BALANCE, scale(BALANCE))
    assert conforms(made.certificate, theorem)
    below = {**made.certificate.data, "p_min": {"shape": [1, 1], "hex": [(-1.0).hex()]}}
    assert not conforms(replace(made.certificate, data=below), theorem)
