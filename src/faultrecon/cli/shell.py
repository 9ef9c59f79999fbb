# SPDX-License-Identifier: BSD-3-Clause
"""What every verb shares: exit codes, JSON, messages on the error stream, a progress bar for work over a second."""

from __future__ import annotations

import io
import json
import math
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from faultrecon.finding import FaultreconError, Finding, Inconclusive, InputError

FINE, NEGATIVE, USAGE, INTERNAL = 0, 1, 2, 3
PATIENCE = 1.0  # s before a progress bar appears


def plain(value: Any) -> Any:
    """A value that JSON can hold: NaN and infinities become null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if hasattr(value, "item"):
        return plain(value.item())
    return value


def speak_any_letter() -> None:
    """Let the output streams take γ and ∫ where their encoding has none, as on a redirected Windows console."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def answer(as_json: bool, data: Mapping[str, Any], text: str) -> None:
    """Print the answer of a verb.  Raises InputError when the output takes no more."""
    try:
        print(json_text(data) if as_json else text, flush=True)  # unflushed, a full disk would only show at exit
    except BrokenPipeError:
        raise
    except OSError as error:
        abandon_output()
        raise InputError("the output cannot be written", why=str(error.strerror or error)) from error


def json_text(data: Mapping[str, Any]) -> str:
    """JSON in readable letters where the output can hold them, in escapes where it cannot."""
    unicode = (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"
    return json.dumps(plain(data), ensure_ascii=not unicode, indent=1)


def leave(
    error: FaultreconError, as_json: bool, *, also: Mapping[str, Any] | None = None, text: str | None = None
) -> NoReturn:
    """End with the exit code of an error; the message goes to the error stream, JSON to the output.

    also: further keys of the JSON.  text: what to print in place of the message.
    """
    try:
        if as_json:
            print(json_text({"error": error.finding.as_dict(), **(also or {})}), flush=True)
    except OSError:  # nobody listens, or the disk is full; the exit code still tells
        abandon_output()
    print(f"faultrecon: {text or error}", file=sys.stderr)
    raise SystemExit(error.exit_code)


@contextmanager
def guarded(as_json: bool = False) -> Iterator[None]:
    """Turn whatever goes wrong into a message and an exit code; a pipe closed by its reader is no error."""
    try:
        yield
    except FaultreconError as error:
        leave(error, as_json)
    except BrokenPipeError:
        abandon_output()
        raise SystemExit(FINE) from None
    except KeyboardInterrupt:
        print("faultrecon: interrupted; nothing half-written is left", file=sys.stderr)
        raise SystemExit(130) from None
    except OSError as error:  # a full disk, a folder that vanished: the caller can mend it
        place = f"{error.filename}: " if error.filename else ""
        leave(InputError(f"{place}cannot be read or written", why=str(error.strerror or error)), as_json)
    except MemoryError:
        leave(Inconclusive("there is not enough memory", remedies=("use a shorter log or a smaller plant",)), as_json)
    except Exception as error:
        leave(Inconclusive(_internal(error)), as_json)


def _internal(error: Exception) -> Finding:
    """An error nobody foresaw is ours; it is reported with its place, and is no verdict on the plant."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(last.filename).name}, line {last.lineno}"
    return Finding(
        f"internal error, {type(error).__name__} in {place}",
        why=str(error)[:200],
        remedies=("please report it with the command and its files",),
    )


def abandon_output() -> None:
    """Send what is still buffered nowhere, so that closing a broken output raises nothing at exit."""
    if sys.stdout is sys.__stdout__:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def bar(label: str) -> Iterator[Callable[[float], None]]:
    """A function that is told the part done, 0 to 1; a bar shows on a terminal once a second has passed."""
    started, shown = time.monotonic(), None

    def tell(part: float) -> None:
        nonlocal shown
        if shown is None and sys.stderr.isatty() and time.monotonic() - started > PATIENCE:
            from rich.console import Console
            from rich.progress import Progress

            shown = Progress(console=Console(stderr=True), transient=True)
            shown.start()
            shown.add_task(label, total=1.0)
        if shown is not None:
            shown.update(shown.task_ids[0], completed=part)

    try:
        yield tell
    finally:
        if shown is not None:
            shown.stop()


@contextmanager
def stages(label: str) -> Iterator[Callable[[str], None]]:
    """A function that is told the stage of work that has no measure; a spinner shows it on a terminal."""
    if not sys.stderr.isatty():
        yield lambda stage: None
        return
    from rich.console import Console

    with Console(stderr=True).status(label) as status:
        yield lambda stage: status.update(f"{label}: {stage}")
