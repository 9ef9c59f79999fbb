# SPDX-License-Identifier: BSD-3-Clause
"""A run that is killed at any moment, again and again, ends with the file of a run that nobody touched.

As a script it does the same for longer, and prints what it found:

    python tests/properties/test_kill.py 200
"""

import multiprocessing
import random
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import faultrecon as fr
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


def main(kills):
    """Half of the kills with a CSV file in the making, half with a Parquet file."""
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


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
