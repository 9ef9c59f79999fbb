# SPDX-License-Identifier: BSD-3-Clause
"""One line in, one line out: what a line says wrong is answered, and nothing that was sent goes unaccounted."""

import csv
import io
import json
import math
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import faultrecon as fr
from faultrecon.cli.streaming import Ending, lines_of
from faultrecon.finding import InputError
from faultrecon.io import lines as forms
from faultrecon.io.lines import Clock, Malformed
from faultrecon.io.playback import column_names
from faultrecon.io.running import reconstruction
from faultrecon.io.streams import run_stream
from faultrecon.storage import checkpoint

H = 0.01


@pytest.fixture(scope="module")
def design():
    return fr.design(fr.library("flexible_joint"))


@pytest.fixture(scope="module")
def names(design):
    signals = design.plant.signals
    return "t", *signals.u.names, *signals.y.names


@pytest.fixture(scope="module")
def rows(names):
    """Thirty samples, one with a gap."""
    rng = np.random.default_rng(1)
    made = np.column_stack([np.arange(30) * H, 1e-2 * rng.normal(size=(30, len(names) - 1))])
    made[7, 3] = np.nan
    return made


@pytest.fixture(scope="module")
def expected(design, rows):
    """The rows of answers, by the whole log."""
    trace = design.estimator(H, engine="casadi").replay(rows[:, 0], rows[:, 1:2], rows[:, 2:])
    return trace.fault


def as_json(names, rows, **more):
    told = [{n: None if math.isnan(v) else v for n, v in zip(names, row, strict=True)} for row in rows.tolist()]
    return [json.dumps(line | more).encode() + b"\n" for line in told]


def as_csv(names, rows):
    told = [",".join("" if math.isnan(v) else repr(v) for v in row) for row in rows.tolist()]
    return [(line + "\n").encode() for line in [",".join(names), *told]]


def answers(design, lines, **options):
    """The answers, and how the stream ended."""
    got = []
    done = run_stream(reconstruction(design, sample_time=H), design.plant.signals, lines, got.append, **options)
    assert all(line.endswith("\n") and line.count("\n") == 1 for line in got)
    return got, done


def faults(design, got):
    """f_<fault> of every answer, and its number."""
    wanted = [f"f_{f.name}" for f in design.plant.faults]
    if got[0].startswith("{"):
        told = [json.loads(line) for line in got]
        read = [[math.nan if line[n] is None else line[n] for n in wanted] for line in told]
    else:
        told = list(csv.DictReader(io.StringIO("".join(got))))
        read = [[float(line[n] or "nan") for n in wanted] for line in told]
    return np.array(read), [int(line["seq"]) for line in told]


# ---------------------------------------------------------------- answers


@pytest.mark.parametrize("written", [as_json, as_csv])
def test_answers_have_the_bits_of_the_log(design, names, rows, expected, written):
    got, done = answers(design, written(names, rows))
    found, numbers = faults(design, got)
    assert np.array_equal(found, expected, equal_nan=True)
    assert numbers == list(range(1, 31))
    assert done.seq == done.heard.answered == 30 and len(got) == done.heard.lines


def test_the_columns_are_those_of_a_replay(design, names, rows):
    told = json.loads(answers(design, as_json(names, rows[:1]))[0][0])
    assert list(told) == ["seq", *column_names(design.plant)]
    header = answers(design, as_csv(names, rows[:1]))[0][0].strip().split(",")
    assert header == ["seq", *column_names(design.plant), "error"]


def test_dates_are_told_as_seconds_from_the_first(design, names, rows):
    lines = as_json(names, rows[:3])
    for k, fraction in enumerate(("", ".010000001", ".02")):
        lines[k] = json.dumps(json.loads(lines[k]) | {"t": f"2026-03-01T12:00:00{fraction}Z"}).encode()
    got = [json.loads(line)["t"] for line in answers(design, lines)[0]]
    assert got == [0.0, 0.010000001, 0.02]


def test_columns_may_have_other_names(design, names, rows, expected):
    lines = [line.replace(b'"t"', b'"clock"').replace(b'"y1"', b'"ENC"') for line in as_json(names, rows)]
    found, _ = faults(design, answers(design, lines, mapping={"t": "clock", "y1": "ENC"})[0])
    assert np.array_equal(found, expected, equal_nan=True)


# ---------------------------------------------------------------- lines that make no sample

BAD = {
    "no json": b"nonsense\n",
    "no object": b"[1, 2]\n",
    "cut off": b'{"t": 0.0',
    "no utf-8": b"{\xff\xfe}\n",
    "too long": b"{" + b" " * (forms.LONGEST + 5) + b"}\n",
    "too deep": b"[" * 50_000 + b"\n",
}


@pytest.mark.parametrize("kind", BAD)
def test_a_line_that_cannot_be_read_is_answered_by_what_is_wrong_and_harms_nothing(design, names, rows, expected, kind):
    lines = as_json(names, rows)
    lines.insert(10, BAD[kind])
    got, done = answers(design, lines)
    told = json.loads(got.pop(10))
    assert told["seq"] == 11 and told["error"] and set(told) == {"seq", "error"}
    found, numbers = faults(design, got)
    assert np.array_equal(found, expected, equal_nan=True)
    assert numbers == [*range(1, 11), *range(12, 32)]
    assert (done.heard.lines, done.heard.answered, done.heard.malformed) == (31, 30, 1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d | {"t": -1.0}, "time must increase"),
        (lambda d: d | {"t": None}, "there is no time"),
        (lambda d: d | {"t": "noon"}, "neither a number nor an ISO 8601 date"),
        (lambda d: d | {"t": "2026-03-01"}, "unlike those before"),
        (lambda d: d | {"t": True}, "neither a number"),
        (lambda d: {k: v for k, v in d.items() if k != "t"}, "there is no t"),
        (lambda d: {k: v for k, v in d.items() if k != "y2"}, "there is no y2; null says"),
        (lambda d: d | {"y2": "1_0"}, "y2 is '1_0', not a number"),
        (lambda d: d | {"y2": [1]}, "not a number"),
        (lambda d: d | {"seq": 1.5}, "seq is 1.5, not a whole number"),
    ],
)
def test_a_line_without_a_sample_says_why(design, names, rows, change, words):
    lines = as_json(names, rows[:3])
    lines[1] = json.dumps(change(json.loads(lines[1]))).encode()
    got, done = answers(design, lines)
    assert words in json.loads(got[1])["error"]
    assert done.heard.answered == 2


def test_a_csv_line_with_too_few_cells_has_an_error_and_empty_values(design, names, rows):
    lines = as_csv(names, rows[:3])
    lines[2] = b'1,"2\n'
    got, _ = answers(design, lines)
    told = list(csv.DictReader(io.StringIO("".join(got))))
    assert told[1].pop("error") and told[1].pop("seq") == "2" and set(told[1].values()) == {""}
    assert told[2]["error"] == "" and told[2]["t"] == repr(float(rows[2, 0]))


def test_blank_lines_are_counted_and_not_answered(design, names, rows):
    got, done = answers(design, [b"\n", *as_json(names, rows[:2]), b"  \r\n"])
    assert len(got) == 2 and done.heard.blank == 2 and done.heard.lines == 4


def test_a_header_without_the_signals_is_refused(design):
    with pytest.raises(InputError, match="there is no column for"):
        answers(design, [b"t,voltage\n"])
    with pytest.raises(InputError, match="neither a JSON object nor a header"):
        answers(design, [b"\xff\n"])
    with pytest.raises(InputError, match="is no format"):
        answers(design, [b"{}\n"], form="xml")


def test_the_format_may_be_given(design, names, rows):
    got, done = answers(design, [b"garbage\n", *as_json(names, rows[:2])], form="json")
    assert json.loads(got[0])["error"] and done.heard.answered == 2


# Times far ahead are refused; those that are not so far take a while to cross, so they are left out.
LINES = st.lists(
    st.binary(max_size=40)
    | st.sampled_from([b"{}", b"", b'{"t":1}', b'{"t":1e999}', b'{"seq":3}', b'{"seq":-1}', b'{"t":"2026-01-01"}'])
    | st.tuples(st.floats().filter(lambda t: not 5.0 < t <= 1e5), st.floats(), st.text(max_size=3)).map(
        lambda v: json.dumps({"t": v[0], "u": v[1], "y1": v[2], "y2": v[1], "y3": None, "seq": 7}).encode()
    ),
    max_size=12,
)


@settings(deadline=None, max_examples=150)
@given(middle=LINES, form=st.sampled_from(["json", "csv"]))
def test_whatever_comes_is_counted_once_and_answered_or_counted_as_unanswered(design, names, rows, middle, form):
    first, *rest = (as_json if form == "json" else as_csv)(names, rows[:3])
    lines = [first, *(line + b"\n" for line in middle), *rest]
    got, done = answers(design, lines)
    heard = done.heard
    assert heard.lines == len(lines)
    assert heard.lines == heard.answered + heard.malformed + heard.repeated + heard.blank + heard.headers
    assert len(got) == heard.answered + heard.malformed + heard.headers
    for line in got if form == "json" else ():
        json.loads(line, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


@given(st.datetimes(), st.integers(0, 999_999_999))
def test_times_count_nanoseconds_exactly(whole, ns):
    whole = whole.replace(microsecond=0)
    _, clock = Clock().seconds(whole.isoformat())
    assert clock.seconds(f"{whole.isoformat()}.{ns:09d}")[0] == ns / 1e9


def test_a_clock_keeps_to_its_kind():
    _, clock = Clock().seconds("2026-03-01T12:00:00+01:00")
    with pytest.raises(Malformed, match="unlike those before"):
        clock.seconds("2026-03-01T12:00:00")
    assert clock.seconds("2026-03-01T11:00:01Z")[0] == 1.0


# ---------------------------------------------------------------- stop and go on


@pytest.mark.parametrize("written", [as_json, as_csv])
def test_a_stream_that_stops_goes_on_with_the_next_number_and_the_same_bits(
    design, names, rows, expected, written, tmp_path
):
    kept, lines = str(tmp_path / "c.json"), written(names, rows)
    head = [] if written is as_json else lines[:1]
    body = lines[len(head) :]
    first, _ = answers(design, [*head, *body[:11]], checkpoint=kept)
    told = []
    second, done = answers(design, [*head, *body[11:]], checkpoint=kept, resume=True, tell=told.append)
    found, numbers = faults(design, [*first, *second[len(head) :]])
    assert np.array_equal(found, expected, equal_nan=True) and numbers == list(range(1, 31))
    assert told == [11] and done.resumed_at == 11 and done.heard.answered == 30


def test_every_line_is_answered_at_least_once_when_a_kill_came_after_the_last_checkpoint(
    design, names, rows, expected, tmp_path
):
    kept, lines = str(tmp_path / "c.json"), as_json(names, rows)
    answers(design, lines[:8], checkpoint=kept)
    stored = (tmp_path / "c.json").read_bytes()
    lost, _ = answers(design, lines[8:20], checkpoint=kept, resume=True)
    (tmp_path / "c.json").write_bytes(stored)  # as if those answers had gone out, and no checkpoint had
    seq = checkpoint.load(kept).content["seq"]
    again, _ = answers(design, lines[seq:], checkpoint=kept, resume=True)
    assert again[: len(lost)] == lost
    found, numbers = faults(design, again)
    assert np.array_equal(found, expected[8:], equal_nan=True) and numbers == list(range(9, 31))


def test_lines_with_numbers_of_their_own_are_answered_once_however_often_they_are_sent(
    design, names, rows, expected, tmp_path
):
    kept = str(tmp_path / "c.json")
    plain = [json.loads(line) for line in as_json(names, rows)]
    lines = [json.dumps(line | {"seq": 100 + 2 * k}).encode() for k, line in enumerate(plain)]
    first, _ = answers(design, [*lines[:10], b"junk\n", *lines[5:12]], checkpoint=kept)
    assert json.loads(first.pop(10))["seq"] is None
    second, done = answers(design, lines, checkpoint=kept, resume=True)
    found, numbers = faults(design, [*first, *second])
    assert np.array_equal(found, expected, equal_nan=True) and numbers == list(range(100, 160, 2))
    assert done.heard.repeated == 5 + 12


def test_a_reader_that_goes_away_ends_the_stream_with_a_last_checkpoint(design, names, rows, tmp_path):
    kept, got = str(tmp_path / "c.json"), []

    def write(line):
        if len(got) == 4:
            raise BrokenPipeError
        got.append(line)

    make = reconstruction(design, sample_time=H)
    done = run_stream(make, design.plant.signals, as_json(names, rows), write, checkpoint=kept)
    assert done.closed and done.seq == 4
    assert checkpoint.load(kept).content["seq"] == 4


def test_a_checkpoint_of_a_file_or_of_other_options_is_refused(design, names, rows, tmp_path):
    kept = str(tmp_path / "c.json")
    answers(design, as_json(names, rows), checkpoint=kept)
    with pytest.raises(InputError, match="add --resume"):
        answers(design, [], checkpoint=kept)
    with pytest.raises(InputError, match="checkpoint of another run: processor"):
        run_stream(
            reconstruction(design, sample_time=2 * H), design.plant.signals, [], print, checkpoint=kept, resume=True
        )
    checkpoint.save(kept, {"run": "a file"}, {})
    with pytest.raises(InputError, match="run is a file there, a stream here"):
        answers(design, [], checkpoint=kept, resume=True)


# ---------------------------------------------------------------- signals, and the program itself


def test_a_signal_ends_the_wait_for_a_line_and_lets_an_answer_be_finished():
    wish = Ending()

    class Quiet:
        """A stream that has one line; the signal comes while the second is waited for."""

        told = 0

        def readline(self, limit):
            self.told += 1
            if self.told == 2:
                wish(signal.SIGTERM)
            return b"line\n"

    assert list(lines_of(Quiet(), wish)) == [b"line\n"] and wish.asked
    with pytest.raises(KeyboardInterrupt):
        wish(signal.SIGINT)


def test_of_an_overlong_line_only_the_beginning_is_kept():
    text = b"x" * (3 * forms.LONGEST) + b"\nshort\n"
    got = list(lines_of(io.BytesIO(text), Ending()))
    assert [len(line) for line in got] == [forms.LONGEST + 1, 6]


@pytest.fixture(scope="module")
def program(design, tmp_path_factory):
    """Starts `faultrecon run DESIGN -` as a process of its own."""
    folder = tmp_path_factory.mktemp("program")
    fr.save(design, folder / "design.json")

    def start(*options):
        command = [sys.executable, "-m", "faultrecon", "run", "design.json", "-", "--sample-time", str(H), *options]
        return subprocess.Popen(
            command, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0
        )

    start.folder = folder
    return start


@pytest.mark.parametrize("written", [as_json, as_csv])
def test_the_program_answers_each_line_before_the_next_is_sent(program, names, rows, design, expected, written):
    process, got = program(), []
    for line in written(names, rows):
        process.stdin.write(line)
        got.append(process.stdout.readline().decode())
    rest, said = process.communicate(timeout=30)
    assert rest == b"" and process.returncode == 0
    assert b"end of input after" in said and b"30 answered" in said
    assert np.array_equal(faults(design, got)[0], expected, equal_nan=True)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_program_ends_in_good_order_on_a_signal(program, names, rows, number):
    name = f"{number.name}.json"
    process = program("--checkpoint", name, "--json")
    lines = as_json(names, rows)
    for line in lines[:5]:
        process.stdin.write(line)
        process.stdout.readline()
    time.sleep(0.05)  # it is waiting for the next line by now; were it not, the end would be the same
    process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 0
    told = json.loads(said)
    assert told["ended"] == "asked to end" and told["seq"] == 5
    process = program("--checkpoint", name, "--resume")
    out, said = process.communicate(b"".join(lines[5:]), timeout=30)
    assert b"going on after line 5" in said and json.loads(out.splitlines()[0])["seq"] == 6


def test_the_program_ends_in_good_order_when_nobody_reads(program, names, rows):
    process = program("--checkpoint", "pipe.json")
    lines = as_json(names, rows)
    process.stdin.write(lines[0])
    process.stdout.readline()
    process.stdout.close()
    process.stdin.write(lines[1])
    said = process.stderr.read()
    assert process.wait(30) == 0 and b"nobody reads the answers" in said and b"Traceback" not in said
    process.stdin.close()
    process.stderr.close()
    assert checkpoint.load(program.folder / "pipe.json").content["seq"] == 1
    assert not [name for name in os.listdir(program.folder) if name.startswith(".")]
