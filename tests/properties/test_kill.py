# SPDX-License-Identifier: BSD-3-Clause
"""A run that is killed at any moment, again and again, ends with the file of a run that nobody touched.

And a stream that is killed, and sent on from the line that it names, answers every line at least once, with the answers
of a stream that nobody touched.

As a script it does the same for longer, and prints what it found:

    python tests/properties/test_kill.py 200
"""

import importlib.util
import json
import multiprocessing
import os
import random
import re
import subprocess
import sys
import tempfile
import threading
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.io.bankfile import write_bank
from faultrecon.io.logs import write_log
from faultrecon.io.running import reconstruction, run_file

# A child of a process that has loaded everything starts in milliseconds; where there is no fork it takes a second.
START = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
PIECE = 50
ROWS = 20_000
PATIENCE = 60.0  # s for a single child; it takes a second or two


@cache
def design_of(folder):
    """Read once by the parent where children are forked."""
    return fr.load(folder / "design.json")


def attempt(folder, extension):
    """One run to the end, unless something happens; it goes on from the checkpoint if there is one."""
    design = design_of(folder)
    make = reconstruction(design, sample_time=0.01)
    options = {"checkpoint": folder / "run.json", "resume": True, "every": 0.0, "piece": PIECE}
    run_file(make, design.plant.signals, folder / "log.csv", out=folder / f"out{extension}", **options)


def prepared(folder, rows):
    """A design and a log of so many rows, with gaps."""
    design = fr.design(fr.library("flexible_joint"))
    fr.save(design, folder / "design.json")
    rng = np.random.default_rng(0)
    columns = {"t": 0.01 * np.arange(rows)}
    for name in (*design.plant.signals.u.names, *design.plant.signals.y.names):
        columns[name] = 1e-2 * rng.normal(size=rows)
        columns[name][rng.random(rows) < 0.002] = np.nan
    write_log(folder / "log.csv", columns)


def killed_until(folder, extension, kills, seed, out=lambda text: None):
    """Run until so many kills have met it, over as many runs as it takes; every run has to end with the same bytes.

    Returns the number of runs that came to their end, and how many kills found the output in the making.
    """
    context, chance, whole, target = multiprocessing.get_context(START), random.Random(seed), None, folder / "untouched"
    target.mkdir()
    for name in ("design.json", "log.csv"):
        (target / name).write_bytes((folder / name).read_bytes())
    design_of(folder), design_of(target)
    began = time.monotonic()
    attempt(target, extension)
    length = time.monotonic() - began
    whole = (target / f"out{extension}").read_bytes()
    done, met, amid = 0, 0, 0
    while met < kills:
        child = context.Process(target=attempt, args=(folder, extension))
        child.start()
        child.join(chance.uniform(0.0, 0.4 * length))  # some five kills in every run
        child.kill()
        child.join(PATIENCE)
        if child.exitcode == 0:
            done += finished(folder, extension, whole)
            continue
        assert child.exitcode is not None and child.exitcode < 0, "the child failed by itself"
        met += 1
        amid += (folder / f"out{extension}.part").exists()
        if met % 20 == 0:
            out(f"{met} kills, {done} runs complete and identical")
    attempt(folder, extension)
    return done + finished(folder, extension, whole), amid


def finished(folder, extension, whole):
    """1 for a run whose output is the untouched one, with nothing left beside it."""
    result = folder / f"out{extension}"
    assert result.read_bytes() == whole, "the output differs"
    left = {p.name for p in folder.iterdir()}
    assert left == {"design.json", "log.csv", "untouched", result.name}
    result.unlink()
    return 1


@pytest.mark.parametrize(("extension", "seed"), [(".csv", 1), (".parquet", 2)])
def test_a_run_that_is_killed_again_and_again_ends_with_the_same_bytes(tmp_path, extension, seed):
    prepared(tmp_path, 3000)
    done, amid = killed_until(tmp_path, extension, 12, seed)
    assert done >= 1 and amid >= 1


# ---------------------------------------------------------------- streams

NAMED, NUMBERED = "csv", "json"  # sent on from the line that is named; with numbers of their own, always from the first


def prepared_stream(folder, rows):
    """A bank, and so many lines with gaps and faults in both forms, after what heads them."""
    place = Path(__file__).parent.parent / "unit" / "conftest.py"
    spec = importlib.util.spec_from_file_location("hand_made", place)
    hand_made = sys.modules["hand_made"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hand_made)
    plant, rng = hand_made.cart_plant(), np.random.default_rng(0)
    write_bank(fr.bank(plant, sensors=("v1",)), folder / "bank.json")
    t, u, y = hand_made.sampled(plant, rng, rows, faults={"v1": 0.8 * (np.arange(rows) % 700 > 400)})
    y[rng.random(y.shape) < 0.002] = np.nan
    names = ("t", *plant.signals.u.names, *plant.signals.y.names)
    values = np.where(np.isnan(table := np.column_stack([t, u, y])), None, table).tolist()
    lines = {NAMED: [",".join("" if v is None else repr(v) for v in one) for one in values]}
    numbered = [dict(zip(names, one, strict=True)) | {"seq": k + 1} for k, one in enumerate(values)]
    lines[NUMBERED] = [json.dumps(one) for one in numbered]
    return {NAMED: [",".join(names)], NUMBERED: []}, lines


class Fed:
    """`faultrecon run BANK -` as a process that is fed through a pipe; what came out, and from where it went on."""

    def __init__(self, folder, head, lines, numbered):
        command = [sys.executable, "-m", "faultrecon", "run", "bank.json", "-", "--checkpoint", "live.json"]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        resumes = (folder / "live.json").exists()
        # One thread, since there is no work for more; nothing compiled, which would take longer than all its work.
        own = {"OMP_NUM_THREADS": "1", "NUMBA_DISABLE_JIT": "1"}
        pipes["env"] = {**os.environ, **own}
        self.process = subprocess.Popen([*command, "--resume", "--every", "0.02"], cwd=folder, **pipes)
        self.out, self.said = b"", b""
        self.resumed_at, self.began = 0, threading.Event()
        if resumes:
            first = self.process.stderr.readline()
            named = re.search(rb"going on after line (\d+)", first)
            assert named, first
            self.resumed_at = int(named[1])
        rest = lines if numbered else lines[self.resumed_at :]
        self.threads = [threading.Thread(target=self._feed, args=("\n".join([*head, *rest, ""]).encode(),))]
        self.threads += [threading.Thread(target=read) for read in (self._read, self._listen)]
        for thread in self.threads:
            thread.start()

    def _feed(self, data):
        try:
            self.process.stdin.write(data)
            self.process.stdin.close()
        except OSError:
            pass  # it was killed

    def _read(self):
        while piece := self.process.stdout.read1(1 << 16):
            self.out += piece
            self.began.set()
        self.began.set()  # or it never will

    def _listen(self):
        self.said = self.process.stderr.read()

    def ended(self):
        """After its end: the lines that came out whole, and whether it ended by itself."""
        code = self.process.wait(PATIENCE)
        for thread in self.threads:
            thread.join(PATIENCE)
        assert code in (0, -9), (code, self.said)
        return self.out.decode().split("\n")[:-1], code == 0


def streams_killed(folder, form, prepared, kills, seed, out=lambda text: None):
    """Kill a stream so many times, over as many streams as it takes.

    Returns how many streams came to their end, and how many answers came more than once.
    """
    heads, lines = (part[form] for part in prepared)
    chance, met, twice, done, answered = random.Random(seed), 0, 0, 0, set()
    length, by_itself, expected = None, False, {}
    while met < kills or not by_itself:
        fed = Fed(folder, heads, lines, form == NUMBERED)
        if length is not None and met < kills:
            fed.began.wait(PATIENCE if chance.random() < 0.9 else 0.5)  # a few die before their first answer
            try:
                fed.process.wait(chance.uniform(0.0, 0.5 * length))
            except subprocess.TimeoutExpired:
                fed.process.kill()
        elif length is None:  # the first is left alone
            fed.began.wait(PATIENCE)
            length = -time.monotonic()
            fed.process.wait(PATIENCE)
            length += time.monotonic()
        told, by_itself = fed.ended()
        for line in told[len(heads) :]:
            seq = json.loads(line)["seq"] if form == NUMBERED else int(line.split(",", 1)[0])
            assert expected.setdefault(seq, line) == line, f"another answer to line {seq}"
            twice += seq in answered
            answered.add(seq)
        met += not by_itself
        if by_itself:
            assert answered == set(range(1, len(lines) + 1)), "a line was never answered"
            (folder / "live.json").unlink()
            answered, done = set(), done + 1
        elif met % 20 == 0:
            out(f"{met} kills, {done} streams complete, {twice} answers twice")
    return done, twice


def test_a_stream_that_is_killed_and_goes_on_answers_every_line_at_least_once_and_always_the_same(tmp_path):
    prepared = prepared_stream(tmp_path, 500)
    for form, seed in ((NAMED, 1), (NUMBERED, 2)):
        done, _ = streams_killed(tmp_path, form, prepared, 2, seed)
        assert done >= 2  # one that nobody touched, and one that was killed


def main(kills):
    """Half of the kills with a CSV file in the making, half with a Parquet file; then as many for streams."""
    for extension, seed in ((".csv", 11), (".parquet", 12)):
        with tempfile.TemporaryDirectory() as place:
            folder, began = Path(place), time.monotonic()
            prepared(folder, ROWS)
            done, amid = killed_until(
                folder, extension, kills // 2, seed, lambda text, kind=extension: print(kind, text)
            )
            print(
                f"{extension}: {kills // 2} kills, {amid} of them with output in the making; {done} runs complete, all "
                f"byte-identical to the untouched run; {time.monotonic() - began:.0f} s",
                flush=True,
            )
    for form, seed in ((NAMED, 13), (NUMBERED, 14)):
        with tempfile.TemporaryDirectory() as place:
            folder, began = Path(place), time.monotonic()
            told = streams_killed(
                folder, form, prepared_stream(folder, 3000), kills // 2, seed, lambda text, f=form: print(f, text)
            )
            print(
                f"{form} stream: {kills // 2} kills; {told[0]} streams complete, every line answered, {told[1]} of the "
                f"answers more than once and with the same bytes; {time.monotonic() - began:.0f} s",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
