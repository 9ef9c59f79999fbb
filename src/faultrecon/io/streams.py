# SPDX-License-Identifier: BSD-3-Clause
"""Samples as lines of text that keep coming: one line in, one line out.

Lines are JSON objects, or CSV after a header; the answers have the same form.  Every answer carries `seq`, the number
of the line that it answers: the line's own where it has a `seq`, else counted from 1.  A line that makes no sample is
answered by what is wrong with it, and harms nothing; where lines have numbers of their own and this one's cannot be
read, the answer has none.  A line whose own number is not above those before has been answered: it is passed over.

With a checkpoint no line is lost: an answer is out before a checkpoint counts it, so whoever sends on from the line
after the checkpoint's `seq` gets every answer at least once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from faultrecon.finding import InputError
from faultrecon.io.chunks import Survey
from faultrecon.io.lines import LONGEST, Clock, Form, Malformed, Sample, form_of
from faultrecon.io.running import EVERY, Chosen, Make, existing
from faultrecon.plant.signals import Signals
from faultrecon.runtime.processing import Columns, Processor
from faultrecon.storage import checkpoint as checkpoints

ENDLESS = Survey("t", {}, 0, None, None, None)
"""What is known of a stream beforehand."""


@dataclass(frozen=True)
class Heard:
    """What became of the lines that came: lines = answered + malformed + repeated + blank + headers."""

    lines: int = 0
    answered: int = 0
    malformed: int = 0
    repeated: int = 0
    blank: int = 0
    headers: int = 0

    def one(self, what: str) -> Heard:
        """With one line more, of this kind."""
        return replace(self, lines=self.lines + 1, **{what: getattr(self, what) + 1})


@dataclass(frozen=True)
class _Here:
    """Where a stream stands.  numbered: whether its lines have numbers of their own."""

    state: Any
    seq: int = 0
    numbered: bool = False
    clock: Clock = field(default_factory=Clock)
    heard: Heard = field(default_factory=Heard)


@dataclass(frozen=True)
class Listened:
    """A stream that has ended.  seq: of its last line; resumed_at: that of the last line before it went on.

    closed: whether it ended because nobody reads the answers any more.
    """

    seq: int
    heard: Heard
    chosen: Chosen
    resumed_at: int
    closed: bool


def run_stream(
    make: Make,
    signals: Signals,
    lines: Iterable[bytes],
    write: Callable[[str], None],
    *,
    form: str = "auto",
    mapping: Mapping[str, str] | None = None,
    checkpoint: str | None = None,
    resume: bool = False,
    every: float = EVERY,
    settle: Callable[[], None] | None = None,
    tell: Callable[[int], None] | None = None,
) -> Listened:
    """Answer lines until there are no more, or until `write` raises BrokenPipeError.

    form: "json", "csv", or "auto": by the first line.  write: takes a line and passes it on at once; settle: makes sure
    of what was passed on, before a checkpoint counts it.  tell: hears the number of the line after which the stream
    goes on, once.  Lines longer than `lines.LONGEST` bytes are malformed, so none need be longer than that by more
    than one byte.  Raises InputError on a header without the plant's signals, and on a checkpoint that does not fit.
    """
    begun = existing(checkpoint, resume)
    processor, chosen = make(ENDLESS, None if begun is None else begun.content.get("chosen"))
    _demand_free_names(processor)
    of = {"run": "a stream", "processor": processor.identity, "columns": dict(mapping or {})}
    here = _Here(processor.start())
    if begun is not None:
        checkpoints.sweep(str(checkpoint))
        checkpoints.demand_same(str(checkpoint), begun.of, of)
        content = begun.content
        state, clock = processor.unpack(content["state"]), Clock(**content["clock"])
        here = _Here(state, content["seq"], content["numbered"], clock, Heard(**content["heard"]))
        if tell is not None:
            tell(here.seq)
    answering = _Answering(processor, signals, write, form, mapping or {})
    resumed_at, saved, closed = here.seq, time.monotonic(), False

    def save(here: _Here) -> None:
        if checkpoint is not None:
            if settle is not None:
                settle()
            content = {"chosen": dict(chosen), "state": processor.pack(here.state), "seq": here.seq}
            content |= {"numbered": here.numbered, "clock": asdict(here.clock), "heard": asdict(here.heard)}
            checkpoints.save(checkpoint, of, content)

    try:
        for line in lines:
            here = answering.answered(here, line)
            if time.monotonic() - saved >= every:
                save(here)
                saved = time.monotonic()
        save(here)
        answering.last(here)
    except BrokenPipeError:
        closed = True
        save(here)
    return Listened(here.seq, here.heard, chosen, resumed_at, closed)


def _demand_free_names(processor: Processor[Any]) -> None:
    for name in ("seq", "error"):
        if name in processor.columns:
            raise InputError(
                f"a signal is called '{name}'",
                why="every answer of a stream has a field of that name",
                remedies=("rename the signal in the plant file",),
            )


class _Answering:
    """Takes a line, answers it, and says where the stream stands then.  Only the form is found out once and kept."""

    def __init__(
        self,
        processor: Processor[Any],
        signals: Signals,
        write: Callable[[str], None],
        form: str,
        mapping: Mapping[str, str],
    ) -> None:
        self._processor, self._write = processor, write
        self._wanted = form
        self._arguments = signals, mapping, processor.columns
        self._form: Form | None = None

    def answered(self, here: _Here, line: bytes) -> _Here:
        """After this line.  When it raises, the line has not been answered, and the place before it still holds."""
        if not line.strip():
            return replace(here, heard=here.heard.one("blank"))
        if self._form is None:
            self._form, header = form_of(line, self._wanted, *self._arguments)
            if header is not None:
                self._write(header)
                return replace(here, heard=here.heard.one("headers"))
        try:
            if len(line) > LONGEST:
                raise Malformed(f"the line is longer than {LONGEST} bytes")
            sample = self._form.sample(line, here.clock)
            if sample.seq is not None and sample.seq <= here.seq:
                return replace(here, heard=here.heard.one("repeated"))
            state, rows = self._taken(here, sample)
        except Malformed as wrong:
            return self._complained(here, wrong)
        seq = here.seq + 1 if sample.seq is None else sample.seq
        self._rows(seq, rows)
        return _Here(state, seq, sample.seq is not None, sample.clock, here.heard.one("answered"))

    def _complained(self, here: _Here, wrong: Malformed) -> _Here:
        assert self._form is not None
        if wrong.seq is not None and wrong.seq <= here.seq:
            return replace(here, heard=here.heard.one("repeated"))
        heard = here.heard.one("malformed")
        if wrong.seq is None and here.numbered:  # counting on would take the number of the line that comes next
            self._write(self._form.complaint(None, str(wrong)))
            return replace(here, heard=heard)
        seq = here.seq + 1 if wrong.seq is None else wrong.seq
        self._write(self._form.complaint(seq, str(wrong)))
        return replace(here, seq=seq, heard=heard)

    def last(self, here: _Here) -> None:
        """No more lines will come: the rows that waited for some."""
        self._rows(here.seq, self._processor.finish(here.state))

    def _taken(self, here: _Here, sample: Sample) -> tuple[Any, Columns]:
        try:
            return self._processor.take(here.state, sample.t, sample.u, sample.y)
        except InputError as refused:
            raise Malformed(str(refused), sample.seq) from refused

    def _rows(self, seq: int, rows: Columns) -> None:
        for values in zip(*(column.tolist() for column in rows.values()), strict=True):
            assert self._form is not None
            self._write(self._form.row(seq, values))
