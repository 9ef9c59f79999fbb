# SPDX-License-Identifier: BSD-3-Clause
"""What the benchmarks share: contestants that take turns, tables on the screen, and the same tables as results files.

A results file is JSON: title, about, command, machine, version, date, and rows of named columns.  The documentation
shows every file in `benchmarks/results/`.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
PACKAGES = ("numpy", "scipy", "clarabel", "numba", "python-flint")

Row = Mapping[str, Any]


def one_thread() -> None:
    """Start this script again with one thread: the libraries read the number when they are loaded."""
    if any(os.environ.get(name) != "1" for name in THREADS):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **dict.fromkeys(THREADS, "1")})  # noqa: S606 - ourselves


def turns(contestants: Mapping[str, Callable[[], object]], rounds: int = 7) -> dict[str, float]:
    """Median CPU seconds of each, taking turns so that a noisy neighbour meets them all."""
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, work in contestants.items():
            start = time.process_time()
            work()
            seconds[name].append(time.process_time() - start)
    return {name: statistics.median(s) for name, s in seconds.items()}


def process_turns(commands: Mapping[str, Sequence[str]], rounds: int = 9) -> dict[str, float]:
    """Median CPU seconds of whole processes, user and system, taking turns; the first round only warms the disk."""
    import resource

    def spent() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    seconds: dict[str, list[float]] = {name: [] for name in commands}
    for turn in range(rounds + 1):
        for name, command in commands.items():
            start = spent()
            subprocess.run(command, check=True, capture_output=True, cwd=HERE)  # noqa: S603 - our own commands
            if turn:
                seconds[name].append(spent() - start)
    return {name: statistics.median(s) for name, s in seconds.items()}


def table(name: str, title: str, rows: Sequence[Row], about: str = "", keep: bool = True) -> None:
    """Print a small aligned table; keep: also write it to `results/<name>.json`."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    cells = [columns, *([shown(row.get(c)) for c in columns] for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    print(f"\n{title}\n  {about}" if about else f"\n{title}")
    for line in cells:
        print(
            "  " + "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip(), flush=True
        )
    if keep:
        document = {
            "title": title,
            "about": about,
            "command": f"python benchmarks/{Path(sys.argv[0]).name}",
            "machine": machine(),
            "version": metadata.version("faultrecon"),
            "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
            "rows": [{key: rounded(value) for key, value in row.items()} for row in rows],
        }
        (HERE / "results").mkdir(exist_ok=True)
        text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
        (HERE / "results" / f"{name}.json").write_text(text, encoding="utf-8")


def shown(value: Any) -> str:
    """A cell: numbers in four digits, nothing for nothing."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def rounded(value: Any) -> Any:
    """Floats in four digits: more would only make the files differ from run to run."""
    return float(f"{value:.4g}") if isinstance(value, float) else value


def machine() -> str:
    """Processor, system and libraries; no names of hosts."""
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in PACKAGES)
    return (
        f"{_processor()}, {os.cpu_count()} cores (one used), {platform.system()}, "
        f"Python {platform.python_version()}, {versions}"
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{models[0]} ({platform.machine()})" if models else platform.machine()
