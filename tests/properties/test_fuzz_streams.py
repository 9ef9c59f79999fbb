# SPDX-License-Identifier: BSD-3-Clause
"""Mutated lines of a stream: each is answered, counted or refused by its number, and the counts add up.

JSON and CSV go to a bank and to a single observer the way `run` takes them; `test_fuzz_files` does the same with files,
a hundred thousand rows between the two.  As a script it does both for longer, and prints what it found:

    python tests/properties/test_fuzz_streams.py 1000000
"""

import csv
import importlib.util
import io
import json
import re
import sys
import tempfile
import time
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.cli.streaming import Ending, lines_of
from faultrecon.finding import InputError
from faultrecon.io.lines import LONGEST
from faultrecon.io.streams import run_stream
from faultrecon.io.watched import supervised
from faultrecon.runtime.processing import Reconstruction
from faultrecon.runtime.supervision import Supervision

T = 0.05
LINES = 250  # of one stream
PATIENCE = 60.0  # s for one of either: it takes tenths of a second, a hang takes for ever
TOO_FAR = "after the one before it"

# ---------------------------------------------------------------- what the rows go to


@cache
def cart():
    """The hand-made bank of the unit tests."""
    place = Path(__file__).parent.parent / "unit" / "conftest.py"
    spec = importlib.util.spec_from_file_location("hand_made", place)
    module = importlib.util.module_from_spec(spec)
    sys.modules["hand_made"] = module
    spec.loader.exec_module(module)
    return module.bank_by_hand(module.cart_plant(), sensors=("v1", "mix"))


@cache
def processor(kind):
    """A bank, one that lets rows wait and doubts leaps, or one observer."""
    bank = cart()
    if kind == "design":
        design = bank.designs["v1"]
        names = ("t", *bank.plant.signals.u.names, *bank.plant.signals.y.names, "f_v1", "v1_corrected")
        names += tuple(f"{name}_ok" for name in bank.plant.signals.y.names)
        return Reconstruction(design.estimator(T, engine="casadi"), names, (2,), "by hand")
    options = {"spans": (0.5, 2.5), "window": 10, "crest": 1.0}
    return supervised(bank, T, **options, **({"reorder": 0.2, "leap": 50.0} if kind == "patient bank" else {}))


class Noted:
    """A processor that notes what it has taken, and where it stands."""

    def __init__(self, inner):
        self.inner, self.taken, self.state = inner, [], inner.start()

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def answer(self, state, t, u, y):
        self.state, answers = self.inner.answer(state, t, u, y)
        self.taken.append((t, u, y))
        return self.state, answers


NAMES = ("t", "force", "s1", "s2", "v1", "mix")


def healthy(rng, rows):
    """Samples of a cart that is moved a little: (rows, 6)."""
    t = T * np.arange(rows)
    s = 0.5 * np.sin(0.3 * t)
    values = np.column_stack([np.sin(0.7 * t), s, s, 0.15 * np.cos(0.3 * t), s])
    values[:, 1:] += 0.01 * rng.normal(size=(rows, 4))
    return np.column_stack([t, values])


# ---------------------------------------------------------------- lines, and what may happen to them

WILD = [
    "1e308",
    "-1e308",
    "1e400",
    "5e-324",
    "-0",
    "1" * 400,
    "0x10",
    "1_0",
    "1e",
    "--1",
    "1,5",
    "٣",
    "½",
    "1 2",
    "+.5e1",
]
ABSENT = [
    "NaN",
    "nan",
    "-nan",
    "NAN",
    "Infinity",
    "-Infinity",
    "inf",
    "-inf",
    "∞",
    "NA",
    "N/A",
    "null",
    "None",
    "",
    "-",
]
TIMES = ["-1e300", "2026-03-01T12:00:00Z", "2026-03-01", "noon", "12:00", "-5", "0", "-1e5", "NaN", "", "1e400"]
FAR = ["1e300", "1.7e308", "1e7", "1e5"]
TYPES = ["true", "false", "[]", "{}", "[1]", '{"a": {"b": [1, {"c": null}]}}', '"1.5"', '"x"', "[" * 60 + "]" * 60]
TEXT = ["\x00", "\ufeff", "\u2028", "😀", "é", "\x7f", '"', "'", "\\", "\t", "\r", ";", "#", "\x1a", "\x0b", "\x85"]
RAW = [b"\xff", b"\xc3", b"\xed\xa0\x80", b"\xf8\x88\x80\x80\x80", b"\x80"]
SEQ = ["3", "-1", '"7"', "1.5", "null", str(2**70), "true", "[]", "99999999", '""', '"x"', "0"]


def one_of(rng, choices):
    return choices[int(rng.integers(len(choices)))]


def jump(rng, decades):
    """Seconds by which a time is off; seldom far ahead, since all that follows is late then."""
    size = abs(float(rng.normal()))
    if rng.random() < 0.01:
        return size * 10.0 ** int(rng.integers(decades))
    return (
        -size * 10.0 ** int(rng.integers(-3, decades))
        if rng.random() < 0.5
        else size * 10.0 ** int(rng.integers(-3, 0))
    )


def written(form, cells):
    """Cells (name, text) as a line; in JSON the texts are what stands behind the colon."""
    if form == "json":
        return ("{" + ", ".join(f'"{name}": {text}' for name, text in cells) + "}").encode()
    return ",".join(text for _, text in cells).encode()


def bare(form, text):
    """A text as a cell: in JSON one that is no number needs quotes, most of the time."""
    if form == "csv" or re.fullmatch(r"-?\d+(\.\d+)?(e[-+]?\d+)?|NaN|-?Infinity|null|true|false", text):
        return text
    return json.dumps(text)


def mutated(form, row, rng):
    """The lines that come of one row, without their ends; and what was done to it."""
    cells = [(name, repr(float(value))) for name, value in zip(NAMES, row, strict=True)]
    k, kind = int(rng.integers(len(cells))), one_of(rng, KINDS)
    name = cells[k][0]
    if kind in ("wild", "absent", "type"):
        text = one_of(rng, {"wild": WILD, "absent": ABSENT, "type": TYPES}[kind])
        cells[k] = name, text if kind == "type" or rng.random() < 0.2 else bare(form, text)
    elif kind == "large":
        cells[k] = name, repr(float(rng.normal()) * 10.0 ** int(rng.integers(-300, 300)))
    elif kind == "time":
        cells[0] = "t", bare(form, one_of(rng, TIMES + FAR * (rng.random() < 0.03)))
    elif kind == "jump":
        cells[0] = "t", repr(row[0] + jump(rng, 9))
    elif kind == "keys":
        cells = [*cells[:k], *cells[k + 1 :]]
        if rng.random() < 0.5:
            cells.insert(
                int(rng.integers(len(cells) + 1)), (one_of(rng, ["force ", "V1", "time", "x", "t", ""]), "1.0")
            )
    elif kind == "more":
        cells.insert(k, (one_of(rng, ["t", "v1", "s3", "note"]), "2.0"))
    elif kind == "seq":
        cells.append(("seq", one_of(rng, SEQ)))
    line = written(form, cells)
    if kind == "long":
        return [line[:-1] + b" " * LONGEST + b"}" if rng.random() < 0.5 else line + b"," * LONGEST]
    if kind == "bytes":
        for _ in range(1 + int(rng.integers(3))):
            at = int(rng.integers(len(line) + 1))
            line = line[:at] + (one_of(rng, RAW) if rng.random() < 0.4 else one_of(rng, TEXT).encode()) + line[at:]
    elif kind == "cut":
        a, b = sorted(rng.integers(0, len(line) + 1, 2))
        line = one_of(rng, [line[:a], line[a:], line[:a] + line[b:]])
    elif kind == "empty":
        line = one_of(rng, [b"", b"  ", b"\r", b"{}", b"[]", b"null", b",", b",,,,,", b'""', b"{" * 3000, b"[" * 3000])
    elif kind == "twice":
        return [line] * int(rng.integers(2, 4))
    elif kind == "joined":
        line += one_of(rng, [b"", b" ", b","]) + line
    return [line]


COMMON = (
    "wild",
    "absent",
    "large",
    "jump",
    "time",
    "type",
    "keys",
    "more",
    "seq",
    "bytes",
    "cut",
    "empty",
    "twice",
    "joined",
)
KINDS = (*(kind for kind in COMMON for _ in range(20)), "long")


def stream_of(form, seed, lines=LINES):
    """The bytes of a stream with so many mutated rows, some healthy ones between them, and how many were mutated.

    Some streams stay in order, so that rows get through; in some the first line is spoilt too.
    """
    rng = np.random.default_rng(seed)
    share = one_of(rng, [0.5, 0.8, 0.95])
    out = [b",".join(name.encode() for name in NAMES)] if form == "csv" else []
    if rng.random() < 0.05:
        out.append(mutated(form, np.zeros(len(NAMES)), rng)[0])
    count = 0
    for row in healthy(rng, int(lines / share)):
        if rng.random() < share:
            out += mutated(form, row, rng)
            count += 1
        else:
            out.append(written(form, [(name, repr(float(value))) for name, value in zip(NAMES, row, strict=True)]))
    for _ in range(int(rng.integers(0, 20))):
        i, j = rng.integers(min(2, len(out) - 1), len(out), 2)
        out[i], out[j] = out[j], out[i]
    return b"\n".join(out) + b"\n" * int(rng.integers(0, 2)), count


# ---------------------------------------------------------------- what is claimed of a stream


def strict(text):
    """JSON as others read it."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def answered(form, got):
    """(seq, error, values) of every answer."""
    if form == "json":
        told = [strict(line) for line in got]
        return [(one.pop("seq"), one.pop("error", ""), list(one.values())) for one in told]
    told = list(csv.reader(got))[1:]
    return [(int(one[0]) if one[0] else None, one[-1], one[1:-1]) for one in told]


def shown(form, rows):
    """Rows of a processor as `answered` has them."""
    values = zip(*(column.tolist() for column in rows.values()), strict=True)
    if form == "json":
        return [[None if isinstance(v, float) and not np.isfinite(v) else v for v in one] for one in values]
    told = ({True: "true", False: "false"}.get(v, "") if isinstance(v, bool) else v for one in values for v in one)
    cells = [repr(v) if isinstance(v, float) else v for v in told]
    width = len(rows)
    return [cells[k : k + width] for k in range(0, len(cells), width)]


def check_stream(form, kind, seed, lines=LINES):
    """Feed one mutated stream; how many rows were mutated, and what became of its lines."""
    data, count = stream_of(form, seed, lines)
    incoming = list(lines_of(io.BytesIO(data), Ending()))
    noted, got, stopped = Noted(processor(kind)), [], None
    began = time.perf_counter()
    try:
        done = run_stream(lambda found, chosen: (noted, {}), cart().plant.signals, incoming, got.append, form=form)
    except InputError as refused:
        stopped = str(refused)
    assert time.perf_counter() - began < PATIENCE
    assert all(line.endswith("\n") and "\n" not in line[:-1] for line in got)
    if stopped is not None:  # by a header without the signals
        assert "standard input" in stopped, stopped
        return count, Counter({"streams refused": 1})
    heard, replies = done.heard, answered(form, got)
    assert heard.lines == len(incoming)
    assert not heard.waiting
    unanswered = heard.repeated + heard.blank + heard.headers
    assert heard.lines == heard.answered + heard.aside + heard.malformed + unanswered
    assert heard.blank == sum(not line.strip() for line in incoming)
    assert heard.headers == (form == "csv")
    rows = [values for _, error, values in replies if not error]
    assert len(rows) == heard.answered
    assert sum(bool(error) for _, error, _ in replies) == heard.malformed + heard.aside
    seqs = [seq for seq, _, _ in replies if seq is not None]
    assert len(set(seqs)) == len(seqs)
    assert len(noted.taken) == heard.answered + heard.aside
    told = Counter(lines=heard.lines, answered=heard.answered, malformed=heard.malformed, repeated=heard.repeated)
    if isinstance(noted.inner, Supervision):
        c = done.state.counts
        refused = sum(error.startswith("refused") and TOO_FAR in error for _, error, _ in replies)
        assert c.received == heard.answered + heard.aside == c.accounted
        assert c.passed == len(rows) + refused
        told += Counter(passed=c.passed, merged=c.merged, duplicates=c.duplicates, late=c.late, bad_time=c.bad_time)
    else:
        assert not heard.aside
    check_harmless(form, noted, rows)
    return count, told


def check_harmless(form, noted, rows):
    """What was refused has changed nothing: the rest, in one piece, gives the same rows."""
    inner = noted.inner
    if not noted.taken:
        assert not rows
        return
    t, u, y = (np.concatenate(parts) for parts in zip(*noted.taken, strict=True))
    state, first = inner.take(inner.start(), t, u, y)
    last = inner.rest(state)[1].rows  # nothing is left behind
    together = {name: np.concatenate([first[name], last[name]]) for name in first}
    assert rows == shown(form, together)


# ---------------------------------------------------------------- in CI, and for longer

SEEDS = st.integers(0, 2**32 - 1)
BANKS = st.sampled_from(["bank", "patient bank"])


@settings(deadline=None, max_examples=24)
@given(seed=SEEDS, form=st.sampled_from(["json", "csv"]), kind=BANKS)
def test_every_line_that_goes_to_a_bank_is_answered_or_counted(seed, form, kind):
    assert check_stream(form, kind, seed)[0] > 0.7 * LINES


@settings(deadline=None, max_examples=24)
@given(seed=SEEDS, form=st.sampled_from(["json", "csv"]))
def test_every_line_that_goes_to_a_design_is_answered_once(seed, form):
    assert check_stream(form, "design", seed)[0] > 0.7 * LINES


ROADS = [("json", kind) for kind in ("bank", "patient bank", "design")] + [("csv", "patient bank"), ("csv", "design")]


def main(total):
    """A tenth of the rows by streams, the others by files."""
    from test_fuzz_files import check_file

    began, seed = time.monotonic(), 0
    for share, roads in ((0.1, ROADS), (0.9, [(e, k) for e in (".csv", ".parquet") for k in ("bank", "patient bank")])):
        rows, told, used = 0, Counter(), 0
        while rows < share * total:
            for form, kind in roads:
                seed += 1
                try:
                    if form.startswith("."):
                        with tempfile.TemporaryDirectory() as place:
                            new, found = check_file(Path(place), form, kind, seed, 10_000)
                    else:
                        new, found = check_stream(form, kind, seed, 4 * LINES)
                except BaseException:
                    print("seed", seed, form, kind)
                    raise
                rows, told, used = rows + new, told + found, used + 1
        what = "streams" if share < 0.5 else "files"
        print(f"{rows} mutated rows in {used} {what}: {dict(told)}; {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
