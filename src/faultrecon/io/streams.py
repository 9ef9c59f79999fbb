# SPDX-License-Identifier: BSD-3-Clause
"""Samples as lines of text that keep coming: one line in, one line out.

Lines are JSON objects, or CSV after a header; the answers have the same form.  Every answer carries `seq`, the number
of the line that it answers: the line's own where it has a `seq`, else counted from 1.  A line is answered by its row,
at once or, where rows wait for older ones, when its row leaves.  A line that has no row of its own is answered at once
by the reason: it is late, repeats another one, or makes no sample, and harms nothing.  Where lines have numbers of
their own and one cannot be read, the answer has none.  A line whose own number has been used is passed over: it has
been answered, or it waits.

With a checkpoint no line is lost: an answer is out before a checkpoint counts it, so whoever sends on from the line
after the checkpoint's `seq` gets every answer at least once.  At the end of the lines what waits is answered, and the
checkpoint lets it wait on: a stream that goes on answers it again, as if it had never stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from faultrecon.finding import InputError
from faultrecon.io.chunks import Survey
from faultrecon.io.lines import LONGEST, Clock, Form, Malformed, Sample, form_of
from faultrecon.io.logs import TIMES
from faultrecon.io.numbering import Numbers
from faultrecon.io.running import EVERY, Chosen, Make, existing
from faultrecon.plant.signals import Signals
from faultrecon.runtime.processing import Answers, Processor
from faultrecon.storage import checkpoint as checkpoints

ENDLESS = Survey("t", {}, 0, None, None, None)
"""What is known of a stream beforehand."""

SCHEMA = 2
"""Of what a checkpoint of a stream holds."""


@dataclass(frozen=True)
class Heard:
    """What became of the lines that came; all but `lines` itself add up to it.

    answered: by a row.  aside: samples without a row of their own, answered by the reason.  malformed: answered by
    what is wrong.  waiting: not answered yet.  repeated: of a number that was used.
    """

    lines: int = 0
    answered: int = 0
    aside: int = 0
    malformed: int = 0
    waiting: int = 0
    repeated: int = 0
    blank: int = 0
    headers: int = 0

    def one(self, what: str) -> Heard:
        """With one line more, of this kind."""
        return replace(self, lines=self.lines + 1, **{what: getattr(self, what) + 1})

    def settled(self, answered: int, aside: int) -> Heard:
        """With so many that waited answered."""
        waiting = self.waiting - answered - aside
        return replace(self, answered=self.answered + answered, aside=self.aside + aside, waiting=waiting)


@dataclass(frozen=True)
class _Here:
    """Where a stream stands.  waiting: the number of the line of each sample that is not answered yet.

    form: of its lines, "json" or "csv", once there was one.
    """

    state: Any
    numbers: Numbers = field(default_factory=Numbers)
    clock: Clock = field(default_factory=Clock)
    heard: Heard = field(default_factory=Heard)
    waiting: Mapping[int, int] = field(default_factory=dict)
    form: str = ""

    def content(self, processor: Processor[Any]) -> dict[str, Any]:
        """What a checkpoint holds of it."""
        told = {"state": processor.pack(self.state), **self.numbers.pack(), "clock": asdict(self.clock)}
        told |= {"heard": asdict(self.heard), "waiting": [list(pair) for pair in self.waiting.items()]}
        return told | {"form": self.form}

    @staticmethod
    def of(content: Mapping[str, Any], processor: Processor[Any]) -> _Here:
        """Where a checkpoint says that it stands."""
        state, clock = processor.unpack(content["state"]), Clock(**content["clock"])
        heard, waiting = Heard(**content["heard"]), dict(content["waiting"])
        return _Here(state, Numbers.unpack(content), clock, heard, waiting, content["form"])


@dataclass(frozen=True)
class Listened:
    """A stream that has ended.  seq: the highest number of its lines; resumed_at: the one at which it went on.

    closed: whether it ended because nobody reads the answers any more.  processor, state: what did the work, and where
    it stood in the end.
    """

    seq: int
    heard: Heard
    chosen: Chosen
    resumed_at: int
    closed: bool
    processor: Processor[Any]
    state: Any


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
    of = {"run": "a stream", "schema of streams": SCHEMA}
    of |= {"processor": processor.identity, "columns": dict(mapping or {})}
    here = _Here(processor.start())
    if begun is not None:
        checkpoints.sweep(str(checkpoint))
        checkpoints.demand_same(str(checkpoint), begun.of, of)
        here = _Here.of(begun.content, processor)
        if tell is not None:
            tell(here.numbers.last)
    answering = _Answering(processor, signals, write, form, mapping or {})
    resumed_at, saved, closed = here.numbers.last, time.monotonic(), False

    def save(here: _Here) -> None:
        if checkpoint is not None:
            if settle is not None:
                settle()
            checkpoints.save(checkpoint, of, {"chosen": dict(chosen)} | here.content(processor))

    try:
        for line in lines:
            here = answering.answered(here, line)
            if time.monotonic() - saved >= every:
                save(here)
                saved = time.monotonic()
        save(here)
        here = answering.last(here)
    except BrokenPipeError:
        closed = True
        save(here)
    return Listened(here.numbers.last, here.heard, chosen, resumed_at, closed, processor, here.state)


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
            here, headed = self._begun(here, line, self._wanted)
            if headed:
                return replace(here, heard=here.heard.one("headers"))
            assert self._form is not None
        try:
            if len(line) > LONGEST:
                raise Malformed(f"the line is longer than {LONGEST} bytes")
            sample = self._form.sample(line, here.clock)
            if not here.numbers.free(sample.seq):
                return replace(here, heard=here.heard.one("repeated"))
            state, answers = self._taken(here, sample)
        except Malformed as wrong:
            return self._complained(here, wrong)
        seq, numbers = here.numbers.used(sample.seq)
        waiting, heard = {**here.waiting, answers.first: seq}, here.heard.one("waiting")
        return self._told(_Here(state, numbers, sample.clock, heard, waiting, here.form), answers)

    def _begun(self, here: _Here, line: bytes, wanted: str) -> tuple[_Here, bool]:
        """With the form found out and the header of the answers written, and whether there is one."""
        self._form, header = form_of(line, wanted, *self._arguments)
        if header is not None:
            self._write(header)
        return replace(here, form="json" if header is None else "csv"), header is not None

    def _complained(self, here: _Here, wrong: Malformed) -> _Here:
        assert self._form is not None
        if not here.numbers.free(wrong.seq):
            return replace(here, heard=here.heard.one("repeated"))
        heard = here.heard.one("malformed")
        if wrong.seq is None and here.numbers.own:  # counting on would take the number of the line that comes next
            self._write(self._form.complaint(None, str(wrong)))
            return replace(here, heard=heard)
        own = here.numbers.own
        seq, numbers = here.numbers.used(wrong.seq)
        self._write(self._form.complaint(seq, str(wrong)))
        return replace(here, numbers=replace(numbers, own=own), heard=heard)

    def last(self, here: _Here) -> _Here:
        """No more lines will come: the rows that waited for some."""
        if not here.waiting:
            return here
        if self._form is None:  # none has come since it went on; the answers are as those before
            here, _ = self._begun(here, self._header(), here.form)
        state, answers = self._processor.rest(here.state)
        return self._told(replace(here, state=state), answers)

    def _header(self) -> bytes:
        """A header that lines could have."""
        signals, mapping, _ = self._arguments
        time = next((mapping[name] for name in TIMES if name in mapping), TIMES[0])
        names = (time, *(mapping.get(name, name) for name in (*signals.u.names, *signals.y.names)))
        return ",".join('"' + name.replace('"', '""') + '"' for name in names).encode()

    def _taken(self, here: _Here, sample: Sample) -> tuple[Any, Answers]:
        try:
            return self._processor.answer(here.state, sample.t, sample.u, sample.y)
        except InputError as refused:
            raise Malformed(str(refused), sample.seq) from refused

    def _told(self, here: _Here, answers: Answers) -> _Here:
        """After the lines are answered that these rows and reasons are for."""
        waiting, rows = dict(here.waiting), zip(*(column.tolist() for column in answers.rows.values()), strict=True)
        for sample, values in zip(answers.of.tolist(), rows, strict=True):
            assert self._form is not None
            self._write(self._form.row(waiting.pop(sample), values))
        for sample, why in answers.aside.items():
            assert self._form is not None
            self._write(self._form.complaint(waiting.pop(sample), why))
        heard = here.heard.settled(len(answers.of), len(answers.aside))
        return replace(here, heard=heard, waiting=waiting)
