# SPDX-License-Identifier: BSD-3-Clause
"""Words that are numbers until somebody reads them."""

from __future__ import annotations

import numpy as np
import pytest

from faultrecon.runtime.words import Words, spelled

SAID = Words(np.array([0, 2, 2, 1], dtype=np.int8), ("good", "held", "bad"))


def test_numpy_reads_a_column_of_words_as_text() -> None:
    assert np.asarray(SAID).tolist() == SAID.tolist() == list(SAID) == ["good", "bad", "bad", "held"]
    assert SAID.dtype == np.asarray(SAID).dtype
    assert (SAID.shape, SAID.size, SAID.ndim, len(SAID)) == ((4,), 4, 1, 4)
    assert SAID.astype(object).tolist() == SAID.tolist()
    assert repr(SAID) == "Words(['good', 'bad', 'bad', 'held'])"
    with pytest.raises(ValueError, match="always a copy"):
        np.array(SAID, copy=False)
    assert np.isin(SAID, ("bad", "held")).tolist() == [False, True, True, True]
    assert spelled({"said": SAID, "t": np.arange(4.0)})["said"].tolist() == SAID.tolist()


def test_a_column_of_words_compares_row_by_row() -> None:
    assert (SAID == "bad").tolist() == [False, True, True, False]
    assert not (SAID == "unheard of").any()
    assert (SAID != "bad").tolist() == [True, False, False, True]
    assert (SAID[:1] != "bad").tolist() == [True]
    assert (SAID != "unheard of").all() and not (np.asarray(SAID) != SAID).any()
    assert (np.asarray(SAID) == SAID).all()
    with pytest.raises(TypeError):
        hash(SAID)


def test_parts_of_a_column_keep_their_words_and_can_be_joined() -> None:
    assert SAID[3] == "held"
    assert Words.joined([SAID[:2], SAID[2:]]).tolist() == SAID.tolist()
    assert SAID[SAID == "bad"].tolist() == ["bad", "bad"]


@pytest.mark.parametrize("count", [1, 128, 129, 40_000])
def test_there_is_room_for_as_many_words_as_there_are(count: int) -> None:
    room = Words.room(1, [str(k) for k in range(count)])
    room.codes[0] = count - 1
    assert room[0] == str(count - 1)
