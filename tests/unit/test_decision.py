# SPDX-License-Identifier: BSD-3-Clause
"""From tests to a name: slowly enough to be sure, and the same however the samples are cut."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.runtime.decision import (
    FAULT,
    NOBODY,
    OUTSIDE,
    RECOVERING,
    SUSPECT,
    TRACKING,
    WARMING,
    Counts,
    Decider,
    Rules,
    Standing,
    counted,
)

W = 6
RULES = Rules(window=W, patience=3)


def decided(failed, outside, faded=None, faults=(1, 1, 1), cuts=(), heard=None):
    """Mode, named and candidates after every row, by one call for each piece."""
    failed, outside = np.asarray(failed, dtype=bool)[:, None], np.asarray(outside, dtype=bool)
    faded, heard = (np.ones_like(outside) if one is None else np.asarray(one, dtype=bool) for one in (faded, heard))
    decider, counts, standing = Decider(RULES, faults), Counts.none(RULES, len(faults)), Standing()
    rows = []
    edges = [0, *sorted(cuts), len(failed)]
    for a, b in pairwise(edges):
        before = standing
        now = Counts(failed[a:b], outside[a:b], faded[a:b], heard[a:b])
        _, verdicts = counted(RULES, counts, now)
        counts, standing, changes, ready = decider.take(counts, standing, now)
        assert np.array_equal(ready, verdicts.ready)
        assert [c.row for c in changes] == sorted({c.row for c in changes})
        here = [before] * (b - a)
        for change in changes:
            here[change.row :] = [change.after] * (b - a - change.row)
        rows += [(s.mode, s.named, s.candidates) for s in here]
    return rows


def rows_of(*parts):
    """failed (N,) and outside (N, 3) from (rows, fails, (out, out, out))."""
    failed = np.concatenate([np.full(n, fails) for n, fails, _ in parts])
    return failed, np.concatenate([np.tile(np.array(out, dtype=bool), (n, 1)) for n, _, out in parts])


QUIET = (False, (False, False, False))
FIRST = (True, (False, True, True))
SECOND = (True, (True, False, True))


def test_failures_before_a_quiet_piece_are_forgotten_in_it():
    """Two, then more than a window without any, then one: never half of a window, wherever the pieces end."""
    log = rows_of((20, *QUIET), (2, *FIRST), (8, *QUIET), (1, *FIRST), (9, *QUIET))
    whole = decided(*log)
    assert whole == decided(*log, cuts=(22, 30, 31)) == decided(*log, cuts=(22, 24, 26, 28, 30))
    assert {mode for mode, *_ in whole[W:]} == {TRACKING}


def test_before_anything_can_be_tested_nothing_is_said():
    failed, outside = rows_of((30, *FIRST))
    assert {row[:2] for row in decided(failed, outside, np.zeros((30, 3)))} == {(WARMING, NOBODY)}


def test_when_all_is_well_it_tracks():
    assert decided(*rows_of((30, *QUIET)))[W:] == [(TRACKING, NOBODY, ())] * (30 - W)


@pytest.mark.parametrize("length", range(1, (W + 1) // 2))
def test_a_momentary_spike_never_decides_anything(length):
    found = decided(*rows_of((20, *QUIET), (length, *FIRST), (20, *QUIET)))
    assert {mode for mode, *_ in found[W:]} == {TRACKING}


def test_a_momentary_spike_never_switches_a_decision():
    found = decided(*rows_of((20, *QUIET), (40, *FIRST), ((W + 1) // 2 - 1, *SECOND), (40, *FIRST)))
    assert {row[:2] for row in found[20 + 3 * W :]} == {(FAULT, 0)}


def test_one_explanation_that_holds_for_a_window_is_named():
    found = decided(*rows_of((20, *QUIET), (40, *FIRST)))
    named = [k for k, (mode, who, _) in enumerate(found) if mode == FAULT]
    assert found[named[0]][1] == 0
    assert 20 + W <= named[0] <= 20 + 2 * W
    assert SUSPECT in {mode for mode, *_ in found[20 : named[0]]}


def test_several_explanations_are_suspects_by_name():
    found = decided(*rows_of((20, *QUIET), (60, True, (False, False, True))))
    assert found[-1] == (SUSPECT, NOBODY, (0, 1))


def test_the_explanation_with_fewer_faults_is_preferred():
    found = decided(*rows_of((20, *QUIET), (60, True, (False, True, False))), faults=(1, 1, 2))
    assert found[-1][:2] == (FAULT, 0)


def test_what_nothing_explains_is_out_of_envelope_after_some_patience():
    found = decided(*rows_of((20, *QUIET), (80, True, (True, True, True))))
    first = next(k for k, row in enumerate(found) if row[0] == OUTSIDE)
    enough = (W + 1) // 2
    assert first == 20 + enough - 1 + RULES.patience * W
    assert {row[0] for row in found[20 + enough - 1 : first]} == {SUSPECT}


def test_out_of_envelope_ends_when_all_is_well_again():
    found = decided(*rows_of((20, *QUIET), (80, True, (True, True, True)), (20, *QUIET)))
    assert found[-1] == (TRACKING, NOBODY, ())


def test_a_fault_that_is_over_recovers_and_then_tracks():
    found = decided(*rows_of((20, *QUIET), (40, *FIRST), (60, *QUIET)))
    modes = [mode for mode, *_ in found[60:]]
    assert modes[: W - 1] == [FAULT] * (W - 1)
    assert modes[W - 1 : 3 * W - 1] == [RECOVERING] * 2 * W
    assert modes[3 * W - 1 :] == [TRACKING] * (60 - 3 * W + 1)


def test_a_fault_that_comes_back_while_it_recovers_is_still_the_same():
    found = decided(*rows_of((20, *QUIET), (40, *FIRST), (W + 2, *QUIET), (20, *FIRST)))
    assert [row[0] for row in found[-15:]] == [FAULT] * 15
    assert {row[1] for row in found[60:]} == {0}


def test_two_faults_in_sequence_are_followed():
    found = decided(*rows_of((20, *QUIET), (60, *FIRST), (60, *SECOND)))
    assert found[79][:2] == (FAULT, 0)
    assert found[-1][:2] == (FAULT, 1)


def test_a_hypothesis_that_has_just_begun_never_looks_best():
    """The second would explain it all, but it is tested too seldom to say so."""
    failed, outside = rows_of((20, *QUIET), (60, True, (True, False, True)))
    faded = np.ones((80, 3), dtype=bool)
    faded[20:, 1] = np.arange(60) % 3 == 0
    assert 1 not in {who for _, who, _ in decided(failed, outside, faded)}
    fresh = np.ones((80, 3), dtype=bool)
    fresh[20:50, 1] = False
    found = decided(failed, outside, fresh)
    assert all(who != 1 for _, who, _ in found[: 50 + (W + 1) // 2 - 1])
    assert found[-1][:2] == (FAULT, 1)


def test_a_rival_that_is_not_refuted_keeps_a_name_open_though_it_is_not_tested():
    failed, outside = rows_of((20, *QUIET), (60, True, (False, False, True)))
    silent = np.ones((80, 3), dtype=bool)
    silent[:, 1] = False
    assert {row[:2] for row in decided(failed, outside, silent)[30:]} == {(SUSPECT, NOBODY)}


def test_what_an_untested_hypothesis_explains_is_not_out_of_envelope():
    failed, outside = rows_of((20, *QUIET), (80, *SECOND))
    silent = np.ones((100, 3), dtype=bool)
    silent[:, 1] = False
    assert {row[0] for row in decided(failed, outside, silent)[30:]} == {SUSPECT}


def test_a_hypothesis_that_is_rejected_is_named_no_longer():
    found = decided(*rows_of((20, *QUIET), (40, *FIRST), (80, True, (True, True, True))))
    assert {who for _, who, _ in found[60 + W :]} == {NOBODY}


def test_a_named_sensor_that_falls_silent_has_not_recovered():
    failed, outside = rows_of((20, *QUIET), (40, *FIRST), (80, *QUIET))
    heard = np.ones((140, 3), dtype=bool)
    heard[60:, 0] = False
    assert {row[:2] for row in decided(failed, outside, heard=heard)[60:]} == {(FAULT, 0)}


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_where_the_samples_are_cut_changes_nothing(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    parts = [(int(rng.integers(1, 25)), rng.random() < 0.7, rng.random(3) < 0.6) for _ in range(12)]
    failed, outside = rows_of(*parts)
    flips = rng.random(outside.shape) < 0.1
    faded = rng.random(outside.shape) < 0.98
    heard = rng.random(outside.shape) < 0.6
    cuts = data.draw(st.lists(st.integers(0, len(failed)), max_size=20))
    whole = decided(failed, outside ^ flips, faded, heard=heard)
    assert decided(failed, outside ^ flips, faded, cuts=cuts, heard=heard) == whole
    assert decided(failed, outside ^ flips, faded, cuts=range(1, len(failed)), heard=heard) == whole
