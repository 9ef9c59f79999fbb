# SPDX-License-Identifier: BSD-3-Clause
"""The verb `run` on standard input: lines as they come, and an end in good order on Ctrl-C and SIGTERM."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from typing import IO, Any

from faultrecon.cli.shell import abandon_output
from faultrecon.finding import Finding
from faultrecon.io.lines import LONGEST
from faultrecon.io.streams import Listened, run_stream

PIECE = 1 << 16  # bytes of an overlong line that are passed over at a time
KINDS = {"aside": "set aside", "malformed": "malformed", "waiting": "still waiting", "repeated": "repeated"}
KINDS |= {"blank": "blank", "headers": "of header"}
ROWS = ("received", "passed", "merged", "duplicates", "late", "bad_time", "reordered")


class Interrupted(BaseException):
    """A signal asked for the end while the program was waiting for a line."""


class Ending:
    """Whether a signal has asked for the end.  A line that is being answered is answered first."""

    def __init__(self) -> None:
        self.asked = False
        self._waiting = False

    def __call__(self, *_: Any) -> None:
        """The signal handler.  Asked twice, the program stops where it is."""
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        if self._waiting:
            raise Interrupted

    def awaited(self, read: Callable[[], bytes]) -> bytes:
        """What `read` gives; nothing once the end was asked for."""
        try:
            self._waiting = True
            return b"" if self.asked else read()
        finally:
            self._waiting = False


@contextmanager
def ending() -> Iterator[Ending]:
    """Take SIGINT and SIGTERM as the wish to end, as long as the block runs."""
    wish = Ending()
    before = {number: signal.signal(number, wish) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield wish
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def lines_of(stream: IO[bytes], wish: Ending) -> Iterator[bytes]:
    """The lines of a stream until it ends or the wish to end is there; of an overlong one only the beginning."""
    with suppress(Interrupted):
        while line := wish.awaited(lambda: stream.readline(LONGEST + 1)):
            rest = line
            while len(line) > LONGEST and rest and not rest.endswith(b"\n"):
                rest = wish.awaited(lambda: stream.readline(PIECE))
            yield line


def listen(
    make: Any,
    signals: Any,
    *,
    form: str,
    mapping: Mapping[str, str],
    checkpoint: str | None,
    resume: bool,
    every: float,
) -> tuple[dict[str, Any], str]:
    """Answer standard input on standard output until it ends; the summary as data and as text."""
    out = sys.stdout.buffer

    def write(line: str) -> None:
        out.write(line.encode("utf-8"))
        out.flush()

    def settle() -> None:
        with suppress(OSError):  # pipes and terminals cannot be brought to a disk
            os.fsync(out.fileno())

    def tell(seq: int) -> None:
        print(f"faultrecon: going on after line {seq}", file=sys.stderr, flush=True)

    with ending() as wish:
        done = run_stream(
            make,
            signals,
            lines_of(sys.stdin.buffer, wish),
            write,
            form=form,
            mapping=mapping,
            checkpoint=checkpoint,
            resume=resume,
            every=every,
            settle=settle,
            tell=tell,
        )
    if done.closed:
        abandon_output()
    return _data(done, wish.asked, checkpoint), _text(done, wish.asked, checkpoint)


def _ended(done: Listened, asked: bool) -> str:
    return "nobody reads the answers" if done.closed else "asked to end" if asked else "end of input"


def _intake(done: Listened) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """What became of the samples, and what somebody should know about them; nothing where they have no intake."""
    from faultrecon.runtime.supervision import Supervision

    if not isinstance(done.processor, Supervision):
        return {}, ()
    intake, counts = done.processor.intake, done.state.counts
    return counts.as_dict(intake.names), intake.findings(counts)


def _untested(done: Listened) -> dict[str, Finding]:
    """Hypotheses of a bank that nothing tests, and why."""
    from faultrecon.runtime.supervision import Supervision

    return dict(done.processor.monitor.refused) if isinstance(done.processor, Supervision) else {}


def _data(done: Listened, asked: bool, checkpoint: str | None) -> dict[str, Any]:
    counts, found = _intake(done)
    return {
        **asdict(done.heard),
        "seq": done.seq,
        "resumed_after": done.resumed_at,
        "ended": _ended(done, asked),
        "checkpoint": checkpoint,
        **done.chosen,
        **({"counts": counts, "findings": [finding.as_dict() for finding in found]} if counts else {}),
        **({"untested": {name: why.as_dict() for name, why in _untested(done).items()}} if counts else {}),
    }


def _text(done: Listened, asked: bool, checkpoint: str | None) -> str:
    heard = asdict(done.heard)
    told = [f"{heard['answered']} answered"]
    told += [f"{heard[name]} {said}" for name, said in KINDS.items() if heard[name]]
    kept = f"; {checkpoint} holds the state after line {done.seq}" if checkpoint else ""
    counts, found = _intake(done)
    rows = [f"{number} {name.replace('_', ' ')}" for name, number in counts.items() if name in ROWS and number]
    lines = [f"{_ended(done, asked)} after {heard['lines']} lines, {', '.join(told)}{kept}"]
    lines += [f"  samples: {', '.join(rows)}"] if rows else []
    lines += [f"  not tested: {name}; {why}" for name, why in _untested(done).items()]
    return "\n".join([*lines, *(f"  {finding}" for finding in found)])
