# SPDX-License-Identifier: BSD-3-Clause
"""A recording of any length through a processor, a piece at a time, in memory that does not depend on its length.

With a checkpoint a run that was stopped, by whatever means, goes on where it was, and the file that comes out in the
end is the same, byte for byte: what is appended to the output reaches the disk before the checkpoint that counts it,
and what was appended after the last checkpoint is cut off when the run goes on.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.io.appending import Appending, schema_of, working_file
from faultrecon.io.chunks import PIECE, Samples, Survey, columns_of, fingerprint, samples, survey
from faultrecon.io.designfile import design_document
from faultrecon.io.playback import column_names, corrected_sensors
from faultrecon.plant.signals import Signals
from faultrecon.runtime.processing import Columns, Processor, Reconstruction, settled
from faultrecon.runtime.stepping import Hold, Scheme
from faultrecon.storage import checkpoint as checkpoints
from faultrecon.storage.hashing import canonical_digest
from faultrecon.synthesis.result import Design

EVERY = 5.0  # s between checkpoints
SURVEYED = 0.1  # of the progress: reading the times of a CSV file takes a tenth of the whole
Chosen = Mapping[str, Any]
Make = Callable[[Survey, Chosen | None], tuple[Processor[Any], Chosen]]
"""From a survey to a processor, and what was chosen in making it, as plain values: an engine, say.

Where a run goes on, what was chosen at first is passed in, and nothing is chosen anew.
"""


@dataclass(frozen=True)
class Tally:
    """What a run has seen and found, in numbers that fit a summary.

    rows came in and `written` went out, from `first` to `last`, s.  missing: by signal; flagged: rows in which an
    <sensor>_ok is False; squares, largest, known: of every column f_..., over the rows in which it is a number.
    longest: the longest interval, s, and the time at which it begins.
    """

    rows: int = 0
    written: int = 0
    first: float = np.nan
    last: float = np.nan
    longest: float = 0.0
    longest_at: float = np.nan
    flagged: int = 0
    missing: Mapping[str, int] = field(default_factory=dict)
    squares: Mapping[str, float] = field(default_factory=dict)
    largest: Mapping[str, float] = field(default_factory=dict)
    known: Mapping[str, int] = field(default_factory=dict)

    def rms(self, name: str) -> float:
        """The root of the mean square of a column f_..., over the rows in which it is known."""
        return float(np.sqrt(self.squares[name] / self.known[name])) if self.known.get(name) else float("nan")

    def greatest(self, name: str) -> float:
        """The largest size of a column f_..., NaN where it is never known."""
        return self.largest[name] if self.known.get(name) else float("nan")

    def taken(self, signals: Signals, t: NDArray, u: NDArray, y: NDArray) -> Tally:
        """After these samples."""
        names, lost = (*signals.u.names, *signals.y.names), [np.isnan(a).sum(axis=0) for a in (u, y)]
        missing = {n: self.missing.get(n, 0) + int(c) for n, c in zip(names, np.concatenate(lost), strict=True) if c}
        return replace(self, rows=self.rows + len(t), missing={**self.missing, **missing})

    def found(self, rows: Columns) -> Tally:
        """After these rows have come out."""
        squares, largest, known = dict(self.squares), dict(self.largest), dict(self.known)
        for name, values in rows.items():
            if name.startswith("f_") and values.dtype.kind == "f":
                sizes = np.abs(values[np.isfinite(values)])
                with np.errstate(over="ignore"):  # of an estimate that was led astray
                    squares[name] = squares.get(name, 0.0) + float(sizes @ sizes)
                largest[name] = max(largest.get(name, 0.0), float(sizes.max(initial=0.0)))
                known[name] = known.get(name, 0) + len(sizes)
        flags = [values for name, values in rows.items() if name.endswith("_ok") and values.dtype.kind == "b"]
        flagged = int((~np.all(flags, axis=0)).sum()) if flags else 0
        timed = self._timed(np.asarray(rows["t"]))
        return replace(timed, flagged=self.flagged + flagged, squares=squares, largest=largest, known=known)

    def _timed(self, t: NDArray) -> Tally:
        if not len(t):
            return self
        before = np.concatenate(([self.last if self.written else t[0]], t[:-1]))
        k = int(np.argmax(t - before))
        longer = float(t[k] - before[k]) > self.longest
        return replace(
            self,
            written=self.written + len(t),
            first=self.first if self.written else float(t[0]),
            last=float(t[-1]),
            longest=float(t[k] - before[k]) if longer else self.longest,
            longest_at=float(before[k]) if longer else self.longest_at,
        )


@dataclass(frozen=True)
class Ran:
    """A run that has come to its end.  resumed_at: the row at which it went on, 0 for one that began anew.

    processor, state: what did the work, and where it stood after the last row that came in.
    """

    survey: Survey
    tally: Tally
    chosen: Chosen
    resumed_at: int
    processor: Processor[Any]
    state: Any


def reconstruction(
    design: Design, *, sample_time: float | None = None, hold: Hold = "linear", scheme: Scheme = "auto"
) -> Make:
    """How to make the bare reconstruction, once a recording was surveyed.

    sample_time in s: the median interval of the recording by default.
    """
    names = column_names(design.plant)
    reached = tuple(design.plant.signals.y.index(name) for name in corrected_sensors(design.plant))
    document = design_document(design)
    kept = {name: document[name] for name in ("method", "plant", "gains")}

    def make(found: Survey, chosen: Chosen | None) -> tuple[Reconstruction, Chosen]:
        step = found.interval if sample_time is None else sample_time
        if step is None and found.rows and design.plant.noise is None:
            raise InputError("one sample tells no sample time", remedies=("pass sample_time=...",))
        engine = "auto" if chosen is None else chosen["engine"]
        estimator = settled(design.estimator(step, hold=hold, scheme=scheme, engine=engine), found.rows)
        options = {"hold": estimator.hold, "scheme": estimator.scheme, "engine": estimator.asked}
        identity = canonical_digest(kept | options | {"sample_time": estimator.sample_time.hex()})
        return Reconstruction(estimator, tuple(names), reached, identity), {"engine": estimator.asked}

    return make


def run_file(
    make: Make,
    signals: Signals,
    log: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
    every: float = EVERY,
    mapping: Mapping[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
    piece: int = PIECE,
    as_it_came: bool = False,
) -> Ran:
    """A recording (.csv, .parquet) through the processor that `make` makes, into `out` (.csv, .parquet).

    checkpoint: a file that says where the run stands, written every so many seconds (`every`) and removed at the end.
    resume: go on from it, if it is there.  piece: rows taken at a
    time.  as_it_came: the processor deals with times that are absent, repeat or go back, and with infinite values.
    Raises InputError on bad files, and on a checkpoint that is there unasked for, damaged, or of another run.
    """
    source, tell = os.fspath(log), progress or _silent
    begun = existing(checkpoint, resume)
    of = {"run": "a file", "columns": columns_of(source, signals, mapping), "log": fingerprint(source)}
    of |= {"output": None if out is None else Path(out).name, "rows at a time": piece, "schema": schema_of(out)}
    if begun is not None:
        checkpoints.demand_same(str(checkpoint), {**begun.of, "processor": None}, of | {"processor": None})
        content = begun.content
        found = Survey(**content["survey"])
        processor, chosen = make(found, content["chosen"])
        of["processor"] = processor.identity
        checkpoints.demand_same(str(checkpoint), begun.of, of)
        tally, state = Tally(**content["tally"]), processor.unpack(content["state"])
        here = _Here(state, tally, content["length"], content["complete"])
    else:
        found = survey(source, signals, mapping, lambda part: tell(SURVEYED * part), as_it_came)
        processor, chosen = make(found, None)
        of["processor"] = processor.identity
        here = _Here(processor.start(), Tally(), 0, False)

    def save(here: _Here) -> None:
        content = {"survey": found.as_dict(), "chosen": chosen, "state": processor.pack(here.state)}
        content |= {"tally": asdict(here.tally), "length": here.length, "complete": here.complete}
        checkpoints.save(str(checkpoint), of, content)

    pieces = samples(source, signals, found, here.tally.rows, piece, as_it_came)
    settle = None if checkpoint is None else save
    pieces = _told(pieces, tell, here.tally.rows, found.rows)
    end = _carried_out(processor, signals, pieces, here, out, settle, every)
    if checkpoint is not None:
        Path(checkpoint).unlink(missing_ok=True)
        for place in (checkpoint, out):
            if place is not None:
                checkpoints.sweep(place)
    tell(1.0)
    return Ran(found, end.tally, chosen, here.tally.rows, processor, end.state)


def existing(checkpoint: str | os.PathLike[str] | None, resume: bool) -> checkpoints.Checkpoint | None:
    """The checkpoint to go on from, if there is one.  Raises InputError where there is one and nobody asked for it."""
    if checkpoint is None:
        if resume:
            raise InputError("there is nothing to resume", why="no checkpoint is named", remedies=("name one",))
        return None
    if not os.path.lexists(checkpoint):
        return None
    found = checkpoints.load(checkpoint)
    if not resume:
        raise InputError(
            f"{os.fspath(checkpoint)}: is the checkpoint of a run that did not end",
            remedies=("add --resume to go on with it", "delete it to begin anew"),
        )
    return found


@dataclass(frozen=True)
class _Here:
    """Where a run stands.  length: bytes of the output that are safe; complete: whether all its rows are there."""

    state: Any
    tally: Tally
    length: int
    complete: bool


def _carried_out(
    processor: Processor[Any],
    signals: Signals,
    pieces: Iterator[Samples],
    here: _Here,
    out: str | os.PathLike[str] | None,
    save: Callable[[_Here], None] | None,
    every: float,
) -> _Here:
    """The rest of a run from `here` on, to the end.  save: what keeps a checkpoint, every so many seconds."""
    if here.complete and (out is None or _replaced(out)):
        return here
    sink = None if out is None else Appending(out, here.length)
    try:
        if not here.complete:
            here, saved = _settled(here, sink, save), time.monotonic()
            for t, u, y in pieces:
                state, rows = processor.take(here.state, t, u, y)
                here = _with_rows(replace(here, state=state, tally=here.tally.taken(signals, t, u, y)), rows, sink)
                if save is not None and time.monotonic() - saved >= every:
                    here, saved = _settled(here, sink, save), time.monotonic()
            here = _with_rows(here, processor.finish(here.state), sink)
            here = _settled(replace(here, complete=True), sink, save)
        if sink is not None:
            sink.complete()
    except BaseException:
        if sink is not None:
            sink.abandon() if save is None else sink.close()
        raise
    return here


def _replaced(out: str | os.PathLike[str]) -> bool:
    """Whether the output was made already: then the run was stopped just before its checkpoint was removed.

    Raises InputError where neither the output nor its working file is there.
    """
    if working_file(out).exists():
        return False
    if not Path(out).exists():
        raise InputError(f"{working_file(out)}: is gone", remedies=("delete the checkpoint and begin anew",))
    return True


def _with_rows(here: _Here, rows: Columns, sink: Appending | None) -> _Here:
    if sink is not None and len(rows["t"]):
        sink.append(rows)
    return replace(here, tally=here.tally.found(rows))


def _settled(here: _Here, sink: Appending | None, save: Callable[[_Here], None] | None) -> _Here:
    """What has been written is safe, and the checkpoint says so."""
    here = here if sink is None else replace(here, length=sink.settle())
    if save is not None:
        save(here)
    return here


def _told(pieces: Iterator[Samples], tell: Callable[[float], None], first: int, total: int) -> Iterator[Samples]:
    """The same pieces, with progress told as they are asked for."""
    for piece in pieces:
        yield piece
        first += len(piece[0])
        tell(SURVEYED + (1.0 - SURVEYED) * first / total)


def _silent(_: float) -> None:
    return None
