# SPDX-License-Identifier: BSD-3-Clause
"""A bank that answers a stream: every line has one answer, with its own number, whatever order the samples come in."""

import csv
import io
import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import faultrecon as fr
from faultrecon.cli import streaming
from faultrecon.finding import InputError
from faultrecon.io.numbering import REMEMBERED, Numbers
from faultrecon.io.playback import column_names
from faultrecon.io.streams import run_stream
from faultrecon.io.watched import supervised
from faultrecon.runtime.processing import Reconstruction, settled
from faultrecon.runtime.supervision import whole
from faultrecon.storage import checkpoint

T = 0.05
NAMES = ("t", "force", "s1", "s2", "v1", "mix")
AHEAD = 1e9 * T  # s: no observer is carried across so many sample times


@pytest.fixture(scope="module")
def make(by_hand, cart_monitor):
    """A processor for a stream: the hand-made bank with the waits that are asked for."""
    base = supervised(by_hand(cart_monitor.plant, ["v1"]), T, spans=(0.5, 2.5), window=10, crest=1.0)

    def made(reorder=0.0, leap=np.inf):
        return replace(base, intake=replace(base.intake, reorder=reorder, leap=leap))

    return made


@pytest.fixture(scope="module")
def signals(make):
    return make().monitor.plant.signals


def values_at(t):
    """A healthy cart, near enough: one value of each channel for each time, so that a sample repeats bit for bit."""
    return [float(v) for v in (np.sin(t), *(0.3 * np.cos(k * t) for k in range(4)))]


def line_of(time, form="json", **changes):
    cells = dict(zip(NAMES, [time, *values_at(time)], strict=True)) | changes
    if form == "json":
        return json.dumps(cells).encode() + b"\n"
    return ",".join("" if cells[name] is None else repr(cells[name]) for name in NAMES).encode() + b"\n"


def ran(processor, signals, lines, form="json", **options):
    """The answers as lines, and how the stream ended."""
    got = []
    lines = [",".join(NAMES).encode() + b"\n", *lines] if form == "csv" else lines
    done = run_stream(lambda survey, chosen: (processor, {}), signals, lines, got.append, form=form, **options)
    return got, done


def read(form, got):
    """(seq, t, the first word of an error) of every answer; t is None where there is no row."""
    told = [json.loads(line) for line in got] if form == "json" else list(csv.DictReader(io.StringIO("".join(got))))
    times = [float(one["t"]) if one.get("t") not in (None, "") else None for one in told]
    words = [one.get("error", "").split(":")[0] for one in told]
    return [(int(one["seq"]), t, word) for one, t, word in zip(told, times, words, strict=True)]


def adds_up(heard):
    kinds = ("answered", "aside", "malformed", "waiting", "repeated", "blank", "headers")
    assert heard.lines == sum(getattr(heard, kind) for kind in kinds)


# ---------------------------------------------------------------- one answer for each line

# A mess: samples at some multiple of T, of which some lie close, repeat, come late, differ, or are no samples at all.
LATTICE = st.integers(0, 9).map(lambda k: round(k * T, 10))
SAMPLES = st.tuples(LATTICE | st.sampled_from([0.03, 7.0, AHEAD, -1.0]), st.sampled_from([0.25, 0.25, 0.75, None]))
MESS = st.lists(SAMPLES | st.sampled_from(["junk", "no time"]), max_size=25)
REORDER = st.sampled_from([0.0, 0.12, 1e9])


def written(mess, form):
    """The lines; where a sample says None it lacks a value."""
    words = {"junk": b"junk\n", "no time": line_of(0.0, form, t=None)}
    return [words[one] if isinstance(one, str) else line_of(one[0], form, s1=one[1]) for one in mess]


@settings(deadline=None, max_examples=80)
@given(mess=MESS, form=st.sampled_from(["json", "csv"]), reorder=REORDER, leap=st.sampled_from([np.inf, 1.0]))
@example(mess=[(0.0, 0.25), (0.1, 0.25), (AHEAD, 0.25)], form="json", reorder=0.12, leap=np.inf)
def test_every_line_has_one_answer_with_its_own_number(make, signals, mess, form, reorder, leap):
    got, done = ran(make(reorder, leap), signals, written(mess, form), form)
    told = read(form, got)
    assert sorted(seq for seq, _, _ in told) == list(range(1, len(mess) + 1))
    for seq, t, word in told:
        one = mess[seq - 1]
        assert (t is None) == bool(word)
        if word == "":
            assert t == one[0], "the row of another line"
        elif isinstance(one, str):
            assert word == {"junk": told_of_junk(form), "no time": "there is no time"}[one]
    heard, counts = done.heard, done.state.counts
    adds_up(heard)
    assert heard.waiting == 0 and heard.answered + heard.aside == counts.received == counts.accounted
    words = Counter(word for _, _, word in told)
    kinds = {"merged": counts.merged, "duplicate": counts.duplicates, "late": counts.late, "no time": counts.bad_time}
    assert {word: words[word] for word in kinds} == kinds
    assert counts.passed == heard.answered + words["refused"]


def told_of_junk(form):
    return "the line is no JSON" if form == "json" else "the line has 1 cells for 6 columns"


@settings(deadline=None, max_examples=40)
@given(mess=MESS, reorder=REORDER)
def test_the_rows_are_those_of_the_recording_read_at_once(make, signals, mess, reorder):
    mess = [one for one in mess if not isinstance(one, str) and one[0] != AHEAD]
    got, _ = ran(make(reorder), signals, written(mess, "json"))
    x = np.array([[t, *values_at(t)] for t, _ in mess]).reshape(-1, 6)
    x[:, 2] = [np.nan if s1 is None else s1 for _, s1 in mess]
    _, rows = whole(make(reorder), x[:, 0], x[:, 1:2], x[:, 2:])
    told = [{name: v for name, v in json.loads(line).items() if name != "seq"} for line in got if "error" not in line]
    columns = zip(*(column.tolist() for column in rows.values()), strict=True)
    known = ([None if isinstance(v, float) and not np.isfinite(v) else v for v in one] for one in columns)
    expected = [dict(zip(rows, one, strict=True)) for one in known]
    assert told == expected


def test_each_reason_begins_with_its_word(make, signals):
    lines = [line_of(t) for t in (0.0, 0.1, 0.1, 0.05, 0.15, 50.0, 0.2)]
    told = read("json", ran(make(leap=1.0), signals, lines)[0])
    assert [word for _, _, word in told] == ["", "", "duplicate", "late", "", "no time", ""]
    parts = [line_of(0.0, s1=None), line_of(0.0), line_of(0.0)]
    told = read("json", ran(make(0.1), signals, parts)[0])
    assert told == [(2, None, "merged"), (3, None, "duplicate"), (1, 0.0, "")]


def test_a_line_is_answered_as_soon_as_its_row_leaves(make, signals):
    got, after = [], []

    def lines():
        for t in (0.0, 0.1, 0.05, 0.05, 0.2, 0.25):
            yield line_of(t)
            after.append([seq for seq, _, _ in read("json", got)])

    run_stream(lambda survey, chosen: (make(0.1), {}), signals, lines(), got.append)
    # 0.1 s lets 0.0 leave, 0.2 s lets 0.05 and 0.1 leave; the repeated line need not wait; the end lets all leave.
    assert after == [[], [1], [1], [1, 4], [1, 4, 3, 2], [1, 4, 3, 2]]
    assert [seq for seq, _, _ in read("json", got)] == [1, 4, 3, 2, 5, 6]


def test_in_csv_the_header_is_the_same_whether_rows_wait_or_not(make, signals):
    for reorder in (0.0, 0.1):
        got, _ = ran(make(reorder), signals, [line_of(0.0, "csv")] * 2, "csv")
        assert got[0].strip().split(",") == ["seq", *make().columns, "error"]
        assert all(len(row) == len(make().columns) + 2 for row in csv.reader(got))


def test_after_an_interval_that_no_observer_crosses_they_begin_anew(make, signals):
    lines = [line_of(t) for t in (0.0, 0.1, AHEAD)]
    told = read("json", ran(make(1e18), signals, lines)[0])
    assert [(seq, t) for seq, t, _ in told] == [(1, 0.0), (2, 0.1), (3, AHEAD)]


def test_rows_that_wait_for_the_compiled_engine_have_the_numbers_of_their_lines():
    design = fr.design(fr.library("flexible_joint"))
    estimator = settled(design.estimator(0.01, engine="numba"), 0)
    processor = Reconstruction(estimator, tuple(column_names(design.plant)), (0,), "by hand")
    state = processor.start()
    t, u, y = 0.01 * np.arange(40.0), np.zeros((40, 1)), np.zeros((40, len(design.plant.signals.y.names)))
    y[[3, 9, 11, 30]] = np.nan
    of = []
    for k in range(40):
        state, answers = processor.answer(state, t[k : k + 1], u[k : k + 1], y[k : k + 1])
        assert answers.first == k and not answers.aside
        of += zip(answers.of.tolist(), answers.rows["t"].tolist(), strict=True)
    _, answers = processor.rest(state)
    of += zip(answers.of.tolist(), answers.rows["t"].tolist(), strict=True)
    assert of == list(enumerate(t.tolist()))


# ---------------------------------------------------------------- stop and go on


@settings(deadline=None, max_examples=30)
@given(mess=MESS, reorder=REORDER, data=st.data())
def test_a_stream_that_stops_and_goes_on_answers_as_if_it_had_not(make, signals, tmp_path_factory, mess, reorder, data):
    kept = tmp_path_factory.mktemp("c") / "c.json"
    cut = data.draw(st.integers(0, len(mess)))
    lines = written(mess, "json")
    first, before = ran(make(reorder), signals, lines[:cut], checkpoint=str(kept))
    assert checkpoint.load(kept).content["seq"] == before.seq == cut
    second, done = ran(make(reorder), signals, lines[cut:], checkpoint=str(kept), resume=True)
    together, untouched = ran(make(reorder), signals, lines)
    # What waited at the stop was answered for fear of an end; it is answered again, and that answer holds.
    told = {json.loads(line)["seq"]: line for line in [*first, *second]}
    assert told == {json.loads(line)["seq"]: line for line in together}
    assert done.heard == untouched.heard and done.state.counts == untouched.state.counts
    twice = len(first) + len(second) - len(mess)
    assert twice == len(checkpointed_waiting(make(reorder), signals, lines[:cut]))


def checkpointed_waiting(processor, signals, lines):
    """What waits after these lines."""
    state = processor.start()
    for line in lines:
        try:
            cells = json.loads(line)
            values = np.array([[np.nan if cells[name] is None else cells[name] for name in NAMES]])
            if cells["t"] is not None:
                state, _ = processor.answer(state, values[:, 0], values[:, 1:2], values[:, 2:])
        except (ValueError, InputError):
            continue
    return state.intake.waiting.t


def test_after_a_kill_every_line_is_answered_at_least_once_and_repeated_answers_are_the_same(make, signals, tmp_path):
    kept, times = tmp_path / "c.json", (0.0, 0.1, 0.05, 0.1, 0.15, 0.12, 0.3, 0.2, 0.35, 0.4, 0.45)
    lines = [line_of(t) for t in times]
    together, _ = ran(make(0.1), signals, lines)
    stored = {}

    def feed():
        for k, line in enumerate(lines):
            yield line
            stored[k + 1] = kept.read_bytes()

    whole_run, _ = ran(make(0.1), signals, feed(), checkpoint=str(kept), every=0.0)
    assert whole_run == together
    for seq, content in stored.items():  # a kill after any line, with the checkpoint of that line
        kept.write_bytes(content)
        again, done = ran(make(0.1), signals, lines[seq:], checkpoint=str(kept), resume=True)
        assert again == together[len(together) - len(again) :]
        assert done.heard.lines == len(lines) and done.heard.waiting == 0
        adds_up(done.heard)


@pytest.mark.parametrize("form", ["json", "csv"])
def test_lines_that_wait_in_a_checkpoint_are_answered_though_no_line_comes_any_more(make, signals, tmp_path, form):
    kept, mapping = str(tmp_path / "c.json"), {"time": "t", "v1": "mix", "mix": "v1"}
    lines = [line_of(t, form) for t in (0.0, 0.1)]
    first, _ = ran(make(1.0), signals, lines, form, checkpoint=kept, mapping=mapping)
    again = []
    done = run_stream(
        lambda survey, chosen: (make(1.0), {}), signals, [], again.append,
        checkpoint=kept, resume=True, mapping=mapping,
    )  # fmt: skip
    assert again == first and len(read(form, again)) == 2 and done.heard.waiting == 0


def test_a_checkpoint_that_does_not_know_which_lines_wait_is_refused(make, signals, tmp_path):
    kept = tmp_path / "c.json"
    of = {"run": "a stream", "processor": make().identity, "columns": {}}
    checkpoint.save(kept, of, {"state": {}, "seq": 3})
    with pytest.raises(InputError, match="schema of streams is absent there, 2 here"):
        ran(make(), signals, [], checkpoint=str(kept), resume=True)


# ---------------------------------------------------------------- lines with numbers of their own


def test_lines_with_numbers_that_overtake_each_other_are_answered_by_their_numbers(make, signals, tmp_path):
    order = [0, 2, 1, 3, 6, 4, 5, 5, 7]  # the second 5 is sent again
    lines = [line_of(k * T, seq=10 * k) for k in order]
    told = read("json", ran(make(0.15), signals, lines)[0])
    assert told == [(10 * k, k * T, "") for k in range(8)]
    told = read("json", ran(make(), signals, lines)[0])
    assert [seq for seq, _, _ in told] == [0, 20, 10, 30, 60, 40, 50, 70]
    assert [word for _, _, word in told] == ["", "", "late", "", "", "late", "late", ""]
    kept = str(tmp_path / "c.json")
    first, _ = ran(make(0.15), signals, lines[:5], checkpoint=kept)
    second, done = ran(make(0.15), signals, lines, checkpoint=kept, resume=True)  # all sent again
    assert {json.loads(line)["seq"] for line in [*first, *second]} == {10 * k for k in range(8)}
    assert done.heard.repeated == 6 and done.heard.answered == 8
    adds_up(done.heard)


@given(st.lists(st.integers(0, 40), max_size=60))
def test_a_number_is_free_until_it_is_used(wanted):
    numbers, used = Numbers(), set()
    for own in wanted:
        assert numbers.free(own) == (own not in used)
        if numbers.free(own):
            told, numbers = numbers.used(own)
            used.add(told)
            assert told == own and numbers.last == max(used)
            assert Numbers.unpack(json.loads(json.dumps(numbers.pack()))) == numbers


@given(st.lists(st.none() | st.integers(0, 40), max_size=60))
def test_no_number_is_used_twice_where_only_some_lines_have_one(wanted):
    numbers, used = Numbers(), []
    for own in wanted:
        if numbers.free(own):
            told, numbers = numbers.used(own)
            used.append(told)
    assert len(used) == len(set(used)) >= wanted.count(None)


def test_of_numbers_that_are_far_behind_none_is_believed_to_be_new():
    numbers = Numbers()
    for k in range(3 * REMEMBERED):
        _, numbers = numbers.used(2 * k)
    assert len(numbers.recent) == REMEMBERED
    assert numbers.free(6 * REMEMBERED - 5) and not numbers.free(6 * REMEMBERED - 4) and not numbers.free(1)


# ---------------------------------------------------------------- what is said at the end


def summary(monkeypatch, processor, signals, lines):
    """What `run BANK -` says at the end: as data, and as text."""
    stream = io.TextIOWrapper(io.BytesIO())
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"".join(lines))))
    monkeypatch.setattr("sys.stdout", stream)
    options = {"form": "json", "mapping": {}, "checkpoint": None, "resume": False, "every": 5.0}
    said = streaming.listen(lambda survey, chosen: (processor, {}), signals, **options)
    stream.flush()
    return *said, stream.buffer.getvalue().decode().splitlines()


def test_the_summary_tells_what_became_of_every_line_and_what_to_do(monkeypatch, make, signals):
    times = (0.0, 0.05, 0.05, 0.02, 0.1, 0.2, 0.15, 0.25, 0.3)
    lines = [*(line_of(t) for t in times), b"junk\n", b"\n"]
    data, text, out = summary(monkeypatch, make(), signals, lines)
    assert len(out) == 10
    counts = data["counts"]
    assert (data["lines"], data["answered"], data["aside"], data["malformed"], data["blank"]) == (11, 6, 3, 1, 1)
    assert counts["received"] == 9 == counts["passed"] + counts["duplicates"] + counts["late"]
    assert counts["duplicates"] == 1 and counts["late"] == 2 and data["waiting"] == 0
    assert "end of input after 11 lines, 6 answered, 3 set aside, 1 malformed, 1 blank\n" in text
    assert "  samples: 9 received, 6 passed, 1 duplicates, 2 late\n" in text
    assert "2 of 9 rows came too late" in text and data["findings"][0]["evidence"]["late"] == 2
    data, text, out = summary(monkeypatch, make(0.12), signals, lines)
    assert (data["answered"], data["aside"], data["counts"]["late"], data["counts"]["reordered"]) == (8, 1, 0, 2)
    assert "too late" not in text and len(out) == 10
