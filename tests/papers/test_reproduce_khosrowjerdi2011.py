# SPDX-License-Identifier: BSD-3-Clause
"""Khosrowjerdi 2011 again: every table of the reproduction, its figures, and its noisy rows under other seeds."""

import pytest

from faultrecon.advise.papers._khosrowjerdi2011_examples import (
    SIGMAS,
    central,
    example_4_1,
    fixed_design,
    predicted,
    rmse,
    scenario_4_1,
    scenario_4_2,
)
from faultrecon.advise.reproductions import reproduce
from faultrecon.finding import InputError
from faultrecon.simulation.run import simulate, watch
from faultrecon.simulation.truth import true_run


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    return reproduce("khosrowjerdi2011", tmp_path_factory.mktemp("figures"))


TABLES = (
    "Printed levels and the optimum of Theorem 3.1",
    "Smallest levels of Theorem 3.1",
    "Backing off from the optimum",
    "Optimum under a pole bound",
    "Example 4.1, descriptor observer",
    "Example 4.1, RMSE",
    "Example 4.2, RMSE",
)


@pytest.mark.parametrize("title", TABLES)
def test_every_row_agrees_with_its_reference(reproduced, title):
    table = next(t for t in reproduced.tables if t.title.startswith(title))
    assert [row for row in table.rows if not row.agrees] == []
    assert len(table.rows) >= 4


def test_there_is_no_other_table(reproduced):
    assert len(reproduced.tables) == len(TABLES)
    assert reproduced.agrees


def test_no_printed_level_is_claimed_to_be_reproduced(reproduced):
    printed = [row for row in reproduced if row.printed is not None]
    assert len(printed) == 4
    assert {row.status for row in printed} == {"not_as_printed"}
    assert all(row.computed > 5 * row.printed and "no estimator" in row.note for row in printed)


def test_the_open_loop_is_better_under_noise_than_designs_certified_at_alpha_1(reproduced):
    rows = {row.item: row.computed for row in reproduced}
    loop = rows["open loop, L = 0: f2, noise"]
    for design in ("γ = 4.2, β = 0.01", "γ = 1, noise weight √0.05", "γ = 0.3, noise weight 0.02"):
        assert rows[f"{design}: f2, noise"] > 4 * loop


def test_a_smaller_level_passes_less_disturbance_and_more_noise(reproduced):
    rows = {row.item: row.computed for row in reproduced}
    assert rows["γ = 0.38: w1 only"] < 0.6 * rows["γ = 1: w1 only"]
    assert rows["γ = 0.38: noise only"] > 1.2 * rows["γ = 1: noise only"]


def test_seven_figures_are_drawn(reproduced):
    assert [path.name for path in reproduced.figures] == [f"figure_{k}.png" for k in range(1, 8)]
    assert all(path.stat().st_size > 20_000 for path in reproduced.figures)


def test_the_text_says_what_agrees_and_what_was_written(reproduced):
    text = str(reproduced)
    assert "0 of 4 values are reproduced as the paper prints them" in text and "with our own re-derivation" in text
    assert "not as printed" in text
    assert "figure_7.png" in text
    assert reproduced.as_dict()["agrees"] is True


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_of_any_seed_is_within_four_deviations_of_its_prediction(seed):
    from faultrecon.advise.papers._khosrowjerdi2011_examples import example_4_2

    plant = example_4_2(0.1)
    quiet, noisy = (true_run(plant, scenario_4_2(True, noise, seed)) for noise in (False, True))
    made = fixed_design(plant, central(plant, 0.5, 3.0))
    expected, spread = predicted(watch(made, quiet), 0, ("w2",), 0.01, 5.0)
    assert abs(rmse(watch(made, noisy), 5.0)[0] - expected) < SIGMAS * spread
    assert spread < 0.06 * expected


def test_a_runge_kutta_step_beyond_its_limit_is_refused():
    made = fixed_design(example_4_1(1.0), central(example_4_1(0.02), 0.3, 0.01))
    assert made.details.largest_step == pytest.approx(2.785 / 7920, rel=1e-3)
    with pytest.raises(InputError, match="RK4 is unstable"):
        simulate(made, scenario_4_1(True, 5e-4, 0), scheme="rk4")
