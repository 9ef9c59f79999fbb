# SPDX-License-Identifier: BSD-3-Clause
"""A log run a piece at a time gives the file that a log read whole gives, stopped in between or not."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import faultrecon as fr
from faultrecon.finding import InputError
from faultrecon.io import chunks, running
from faultrecon.io.appending import Appending
from faultrecon.io.chunks import samples, survey
from faultrecon.io.logs import read_log, write_log
from faultrecon.io.playback import replay
from faultrecon.io.running import reconstruction, run_file
from faultrecon.plant.signals import Channels, Signals

SIGNALS = Signals(Channels(("x",)), Channels(("voltage",)), Channels(("encoder", "tacho")))


@pytest.fixture(scope="module")
def design():
    return fr.design(fr.library("flexible_joint"))


@pytest.fixture(scope="module")
def linear():
    return fr.design(fr.library("airliner"))


def columns(plant, rows=1000, seed=0):
    """A log with gaps and an odd interval."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * 0.01
    t[rows // 2 :] += 0.3
    made = {"t": t}
    for name in (*plant.signals.u.names, *plant.signals.y.names):
        made[name] = 1e-2 * rng.normal(size=rows)
        made[name][rng.random(rows) < 0.01] = np.nan
    return made


@pytest.fixture
def log(design, tmp_path):
    write_log(tmp_path / "log.csv", columns(design.plant))
    return tmp_path / "log.csv"


def run(design, log, out, **options):
    return run_file(reconstruction(design), design.plant.signals, log, out=out, **{"piece": 137, **options})


class StopError(Exception):
    """What a test throws to stop a run somewhere."""


def stopped_after(pieces):
    """Progress that stops a run after so many pieces."""
    told = []

    def tell(part):
        if part > running.SURVEYED:
            told.append(part)
        if len(told) > pieces:
            raise StopError

    return tell


# ---------------------------------------------------------------- both roads lead to the same file


@pytest.mark.parametrize("extension", [".csv", ".parquet"])
def test_a_log_in_pieces_gives_the_table_of_the_whole_log(linear, tmp_path, extension):
    log = tmp_path / f"log{extension}"
    write_log(log, columns(linear.plant))
    write_log(tmp_path / "whole.csv", replay(linear, log).columns())
    done = run(linear, log, tmp_path / "pieces.csv")
    assert (tmp_path / "pieces.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    assert done.tally.rows == done.tally.written == 1000
    run(linear, log, tmp_path / "pieces.parquet")
    write_log(tmp_path / "whole.parquet", replay(linear, log).columns())
    one, other = (pq.read_table(tmp_path / f"{name}.parquet") for name in ("pieces", "whole"))
    assert one.schema == other.schema
    for name in one.column_names:
        assert one[name].to_numpy().tobytes() == other[name].to_numpy().tobytes(), name


@pytest.mark.parametrize("engine", ["casadi", "numba"])
def test_both_roads_agree_in_every_bit_on_either_engine(design, tmp_path, monkeypatch, engine):
    """The plant has a sine, in which engines may differ; so the pieces have to be given to them as the whole log is."""
    monkeypatch.setattr(running, "settled", lambda estimator, rows: estimator.build(
        estimator.observer, estimator.sample_time, prediction=estimator.prediction, engine=engine
    ))  # fmt: skip
    log = tmp_path / "log.parquet"
    write_log(log, columns(design.plant, 3000))
    run(design, log, tmp_path / "out.csv")
    step = survey(str(log), design.plant.signals).interval
    read = read_log(log, design.plant.signals)
    trace = design.estimator(step, engine=engine).replay(read.t, read.u, read.y)
    found = pa.csv.read_csv(tmp_path / "out.csv")
    for j, fault in enumerate(design.plant.faults):
        column = found[f"f_{fault.name}"].to_numpy()
        assert np.array_equal(column, trace.fault[:, j], equal_nan=True)


def test_the_summary_counts_what_the_whole_log_counts(design, log, tmp_path):
    whole, done = replay(design, log), run(design, log, tmp_path / "out.csv").tally
    assert dict(done.missing) == dict(whole.log.missing)
    assert done.flagged == int((~whole.trace.ok.all(axis=1)).sum())
    assert (done.first, done.last) == (whole.log.t[0], whole.log.t[-1])
    steps = np.diff(whole.log.t)
    assert (done.longest, done.longest_at) == (steps.max(), whole.log.t[steps.argmax()])
    for j, fault in enumerate(design.plant.faults):
        values = whole.trace.fault[:, j]
        values = values[np.isfinite(values)]
        assert done.rms(f"f_{fault.name}") == pytest.approx(np.sqrt(np.mean(values**2)), rel=1e-12)
        assert done.greatest(f"f_{fault.name}") == np.abs(values).max()


# ---------------------------------------------------------------- stop and go on


@pytest.mark.parametrize("extension", [".csv", ".parquet"])
def test_a_run_that_was_stopped_goes_on_and_ends_with_the_same_file(design, log, tmp_path, extension):
    whole, out, kept = tmp_path / f"whole{extension}", tmp_path / f"out{extension}", tmp_path / "c.json"
    run(design, log, whole)
    for pieces in (0, 1, 3):
        with pytest.raises(StopError):
            run(design, log, out, checkpoint=kept, resume=True, every=0.0, progress=stopped_after(pieces))
        assert not out.exists() and kept.exists()
    done = run(design, log, out, checkpoint=kept, resume=True)
    assert done.resumed_at > 0
    assert out.read_bytes() == whole.read_bytes()
    left = {p.name for p in tmp_path.iterdir()}
    assert left == {"log.csv", f"whole{extension}", f"out{extension}"}


@pytest.mark.parametrize("extension", [".csv", ".parquet"])
def test_a_stop_between_the_last_step_and_the_end_loses_nothing(design, log, tmp_path, monkeypatch, extension):
    whole, out, kept = tmp_path / f"whole{extension}", tmp_path / f"out{extension}", tmp_path / "c.json"
    run(design, log, whole)

    def no_end(self):
        raise StopError

    def ended_too_late(self):
        complete(self)
        raise StopError

    complete = Appending.complete
    for stop in (no_end, ended_too_late):
        monkeypatch.setattr(Appending, "complete", stop)
        with pytest.raises(StopError):
            run(design, log, out, checkpoint=kept, resume=True)
    monkeypatch.setattr(Appending, "complete", no_end)  # nothing is left to complete
    assert run(design, log, out, checkpoint=kept, resume=True).tally.rows == 1000
    assert out.read_bytes() == whole.read_bytes() and not kept.exists()


def test_what_was_written_after_the_last_checkpoint_is_cut_off(design, log, tmp_path):
    whole, out, kept = tmp_path / "whole.csv", tmp_path / "out.csv", tmp_path / "c.json"
    run(design, log, whole)
    with pytest.raises(StopError):
        run(design, log, out, checkpoint=kept, every=0.0, progress=stopped_after(2))
    with open(tmp_path / "out.csv.part", "ab") as part:
        part.write(b"0.12,half a li")
    run(design, log, out, checkpoint=kept, resume=True)
    assert out.read_bytes() == whole.read_bytes()


def test_a_run_without_a_checkpoint_leaves_nothing_when_it_is_stopped(design, log, tmp_path):
    with pytest.raises(StopError):
        run(design, log, tmp_path / "out.csv", progress=stopped_after(2))
    assert {p.name for p in tmp_path.iterdir()} == {"log.csv"}


@pytest.fixture
def half(design, log, tmp_path):
    """A run that was stopped in the middle."""
    with pytest.raises(StopError):
        run(design, log, tmp_path / "out.csv", checkpoint=tmp_path / "c.json", every=0.0, progress=stopped_after(3))
    return {"checkpoint": tmp_path / "c.json", "resume": True}


def test_a_checkpoint_that_nobody_asked_for_is_not_run_over(design, log, tmp_path, half):
    with pytest.raises(InputError, match=r"did not end; add --resume"):
        run(design, log, tmp_path / "out.csv", checkpoint=half["checkpoint"])


def test_a_checkpoint_is_refused_with_another_log_design_option_or_output(design, linear, log, tmp_path, half):
    refused = pytest.raises(InputError, match="checkpoint of another run")
    with refused:
        run(design, log, tmp_path / "other.csv", **half)
    changed = reconstruction(design, hold="left")
    with refused as told:
        run_file(changed, design.plant.signals, log, out=tmp_path / "out.csv", piece=137, **half)
    assert "processor is" in str(told.value)
    with refused as told:
        log.write_text(log.read_text() + "999,0,0,0,0\n")
        run(design, log, tmp_path / "out.csv", **half)
    assert "log is" in str(told.value)


def test_a_working_file_that_is_gone_or_too_short_is_told(design, log, tmp_path, half):
    (tmp_path / "out.csv.part").write_bytes(b"t")
    with pytest.raises(InputError, match=r"out\.csv\.part: has 1 bytes"):
        run(design, log, tmp_path / "out.csv", **half)
    (tmp_path / "out.csv.part").unlink()
    with pytest.raises(InputError, match=r"out\.csv\.part: cannot be written: No such file"):
        run(design, log, tmp_path / "out.csv", **half)


def test_the_engine_that_a_run_began_with_is_kept(design, log, tmp_path, monkeypatch):
    asked = []
    make = reconstruction(design)

    def noted(found, chosen):
        asked.append(chosen)
        return make(found, chosen)

    with pytest.raises(StopError):
        run_file(noted, design.plant.signals, log, checkpoint=tmp_path / "c.json", piece=99, progress=stopped_after(2))
    run_file(noted, design.plant.signals, log, checkpoint=tmp_path / "c.json", piece=99, resume=True)
    assert asked == [None, {"engine": "casadi"}]


# ---------------------------------------------------------------- the survey


@settings(deadline=None, max_examples=60)
@given(
    steps=hnp.arrays(float, st.integers(0, 40), elements=st.floats(1e-6, 1e3))
    | hnp.arrays(float, st.integers(0, 40), elements=st.sampled_from([0.01, 0.02, np.nextafter(0.02, 1)])),
)
def test_the_interval_is_the_median_in_every_bit(tmp_path_factory, steps):
    t = np.cumsum(np.concatenate(([0.0], steps)))
    file = tmp_path_factory.getbasetemp() / "times.parquet"
    write_log(file, {"t": t, "voltage": t, "encoder": t, "tacho": t})
    found = survey(str(file), SIGNALS)
    assert found.rows == len(t)
    assert found.interval == (float(np.median(np.diff(t))) if len(t) > 1 else None)


TIMES = {
    "numbers": ["0.5", "0.6", "0.7", "0.9"],
    "dates": ["2026-03-01T12:00:00.5", "2026-03-01T12:00:00.600", "2026-03-01 12:00:00.7", "2026-03-01T12:00:00.9"],
    "offsets": [f"2026-03-01T12:00:0{k}.25+02:00" for k in range(4)],
    "far dates": ["2026-03-01T12:00:00", "2300-01-01T00:00:00", "2300-01-01T00:00:01", "2300-01-01T00:00:02"],
}


@pytest.mark.parametrize("kind", TIMES)
@pytest.mark.parametrize("block", [1 << 20, 120])
@pytest.mark.parametrize("extra", ["", "note"])
def test_samples_are_those_of_the_log_however_times_are_written(tmp_path, monkeypatch, kind, block, extra):
    """In blocks of 120 bytes a column changes its type in the middle: that is when a cell says "none"."""
    monkeypatch.setattr("faultrecon.io.batches.BLOCK", block)
    file = tmp_path / "log.csv"
    rows = [f"{t},{k},none,{k / 7!r}" for k, t in enumerate(TIMES[kind])]
    rows[1] = rows[1].replace("none", "1.5")
    if extra:
        rows[3] = rows[3].replace("none", " N/A ")
    file.write_text("time, voltage ,encoder,tacho\n" + "\n".join(rows) + "\n")
    log, found = read_log(file, SIGNALS), survey(str(file), SIGNALS)
    for first in (0, 1, 3):
        pieces = list(samples(str(file), SIGNALS, found, first, 2))
        for k, name in enumerate(("t", "u", "y")):
            whole = getattr(log, name)[first:]
            assert np.concatenate([piece[k] for piece in pieces]).tobytes() == np.ascontiguousarray(whole).tobytes()


BAD = {
    "goes back": "t,voltage,encoder,tacho\n0,1,2,3\n2,1,2,3\n1,1,2,3\n",
    "repeats": "t,voltage,encoder,tacho\n0,1,2,3\n1,1,2,3\n\n1,1,2,3\n",
    "no time": "t,voltage,encoder,tacho\n0,1,2,3\n,1,2,3\n",
    "infinite time": "t,voltage,encoder,tacho\n0,1,2,3\ninf,1,2,3\n",
    "no date": "t,voltage,encoder,tacho\n2026-03-01T12:00:00,1,2,3\nnoon,1,2,3\n",
    "no number": "t,voltage,encoder,tacho\n0,1,2,3\n1,1,2,oops\n",
    "infinite": "t,voltage,encoder,tacho\n0,1,2,3\n1,1,2,inf\n",
    "ragged": "t,voltage,encoder,tacho\n0,1,2,3\n1,1,2\n",
    "empty": "t,voltage,encoder,tacho\n",
    "no column": "t,voltage,encoder\n0,1,2\n",
    "two columns": "t,voltage,encoder,tacho,tacho\n0,1,2,3,4\n",
    "not a table": "\x00\x01",
    "semicolons": "t;voltage;encoder;tacho\n0;1;2;3\n",
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_log_is_refused_in_the_words_of_the_whole_log(tmp_path, kind):
    file = tmp_path / "log.csv"
    file.write_text(BAD[kind])
    with pytest.raises(InputError) as whole:
        read_log(file, SIGNALS)
    with pytest.raises(InputError) as pieces:
        list(samples(str(file), SIGNALS, survey(str(file), SIGNALS), 0, 1))
    assert str(pieces.value) == str(whole.value)


def test_what_is_no_parquet_is_refused(tmp_path):
    (tmp_path / "log.parquet").write_text("t,voltage")
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        survey(str(tmp_path / "log.parquet"), SIGNALS)


def test_a_log_may_be_read_as_it_came(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("t,voltage,encoder,tacho\n0,1,2,3\n2,1,inf,3\n1,1,2,3\n,1,2,3\n1.5,1,2,3\n")
    found = survey(str(file), SIGNALS, as_it_came=True)
    t, _, y = next(samples(str(file), SIGNALS, found, as_it_came=True))
    log = read_log(file, SIGNALS, as_it_came=True)
    assert t.tobytes() == log.t.tobytes() and np.array_equal(y, log.y)
    assert found.interval == 1.25  # the steps forward are 2 and 0.5


def test_parquet_is_read_from_the_row_group_that_is_wanted(tmp_path):
    values = np.arange(100.0)
    table = pa.table(dict.fromkeys(("t", "voltage", "encoder", "tacho"), values))
    pq.write_table(table, tmp_path / "log.parquet", row_group_size=13)
    source = str(tmp_path / "log.parquet")
    found = survey(source, SIGNALS)
    for first in (0, 12, 13, 57, 99):
        t = np.concatenate([piece[0] for piece in samples(source, SIGNALS, found, first, 10)])
        assert np.array_equal(t, values[first:])


def test_two_recordings_that_differ_anywhere_near_their_ends_are_told_apart(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    a.write_bytes(bytes(300_000))
    for place in (0, 150_000, 299_999):
        b.write_bytes(bytes(place) + b"x" + bytes(299_999 - place))
        assert chunks.fingerprint(str(a)) != chunks.fingerprint(str(b))


# ---------------------------------------------------------------- the verb


@pytest.fixture
def saved(design, tmp_path):
    fr.save(design, tmp_path / "design.json")
    return tmp_path / "design.json"


def test_the_verb_runs_a_piece_at_a_time_with_a_checkpoint_or_when_the_log_is_large(
    cli, saved, log, tmp_path, monkeypatch
):
    outs = [tmp_path / f"{name}.csv" for name in ("whole", "kept", "large")]
    code, whole, _ = cli("run", saved, log, "--out", outs[0])
    assert code == 0 and "a piece at a time" not in whole
    code, text, _ = cli("run", saved, log, "--out", outs[1], "--checkpoint", tmp_path / "c.json")
    assert code == 0 and "a piece at a time" in text and not (tmp_path / "c.json").exists()
    monkeypatch.setattr("faultrecon.cli.keeping.LARGE", 1000)
    found = json.loads(cli("run", saved, log, "--out", outs[2], "--json")[1])
    assert found["engine"] == "casadi" and found["resumed_at"] == 0 and found["written"] == str(outs[2])
    assert len({out.read_bytes() for out in outs}) == 1
    for line in whole.splitlines()[1:-1]:
        assert line in text  # the same numbers, except for what needs the whole log


def test_the_verb_says_what_does_not_go_together(cli, saved, log, tmp_path):
    kept = tmp_path / "c.json"
    for options, words in (
        (("--resume",), "--resume without --checkpoint"),
        (("--checkpoint", kept, "--figure", tmp_path / "f.png"), "--figure with --checkpoint"),
        (("--checkpoint", tmp_path / "no" / "c.json"), "does not exist"),
        (("--checkpoint", kept, "--every", "nan"), "--every is nan"),
        (("--format", "json"), "--format json with a file"),
    ):
        code, _, said = cli("run", saved, log, *options)
        assert code == 2 and words in said
    code, _, said = cli("run", saved, "-", "--out", tmp_path / "out.csv")
    assert code == 2 and "answers go to standard output" in said


def test_the_verb_goes_on_and_says_from_where(cli, saved, log, tmp_path, monkeypatch):
    options = ("run", saved, log, "--out", tmp_path / "out.csv", "--checkpoint", tmp_path / "c.json", "--every", 0)

    def interrupted(self):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Appending, "complete", interrupted)
        code, _, said = cli(*options)
        assert code == 130 and "give the same command with --resume" in said
    assert cli(*options)[0] == 2
    code, text, _ = cli(*options, "--resume")
    assert code == 0 and "went on at row 1001" in text
