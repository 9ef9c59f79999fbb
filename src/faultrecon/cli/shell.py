# SPDX-License-Identifier: BSD-3-Clause
"""What every verb shares: exit codes, JSON, messages on the error stream, a progress bar for work over a second."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NoReturn

from faultrecon.finding import FaultreconError

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


def answer(as_json: bool, data: Mapping[str, Any], text: str) -> None:
    """Print the answer of a verb."""
    print(json.dumps(plain(data), ensure_ascii=False, indent=1) if as_json else text)


def leave(error: FaultreconError, as_json: bool) -> NoReturn:
    """End with the exit code of an error; the message goes to the error stream, JSON to the output."""
    if as_json:
        print(json.dumps(plain({"error": error.finding.as_dict()}), ensure_ascii=False, indent=1))
    print(f"faultrecon: {error}", file=sys.stderr)
    raise SystemExit(error.exit_code)


@contextmanager
def guarded(as_json: bool = False) -> Iterator[None]:
    """Turn errors raised on purpose into a message and an exit code; a pipe closed by its reader is no error."""
    try:
        yield
    except FaultreconError as error:
        leave(error, as_json)
    except BrokenPipeError:
        sys.stderr.close()
        raise SystemExit(FINE) from None
    except KeyboardInterrupt:
        print("faultrecon: interrupted; nothing half-written is left", file=sys.stderr)
        raise SystemExit(130) from None


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
