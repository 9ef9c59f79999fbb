# SPDX-License-Identifier: BSD-3-Clause
"""Compiled kernels on disk, one folder per content hash; standard library alone.

An entry is prepared in a folder of its own and moved into place when it is complete, so that processes that compile the
same kernel at the same time do not meet: the first one stays.  Every file is listed with its SHA-256, and an entry that
does not agree with its list is thrown away.  Nothing here is worth an error: where there is no usable folder, or the
disk is full, kernels live in memory.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

VARIABLE = "FAULTRECON_CACHE"  # a folder to use instead of the user's own; empty: keep nothing on disk
LIST = "contents.json"
KEPT = 256  # entries, about 50 kB each; the ones not used for longest go first
ABANDONED = 24 * 3600.0  # seconds after which a folder still in preparation has lost its process


def folder() -> Path | None:
    """Where kernels are kept; None when there is nowhere.

    What lies there is run, so a folder that others can write to is not used.
    """
    chosen = os.environ.get(VARIABLE)
    if chosen == "":
        return None
    try:
        place = (Path(chosen) if chosen else _user_cache() / "faultrecon") / "kernels"
        place.mkdir(parents=True, exist_ok=True, mode=0o700)
        about = place.stat()
    except (OSError, RuntimeError):  # RuntimeError: this user has no home
        return None
    foreign = hasattr(os, "getuid") and (about.st_uid != os.getuid() or about.st_mode & (stat.S_IWGRP | stat.S_IWOTH))
    return None if foreign or not os.access(place, os.W_OK | os.X_OK) else place


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def stored(digest: str) -> Path | None:
    """The folder of a complete entry, every file of it checked; None when there is none.  A damaged one is removed."""
    place = folder()
    if place is None or not (place / digest).is_dir():
        return None
    entry = place / digest
    if _sound(entry):
        with suppress(OSError):
            os.utime(entry)  # used now
        return entry
    discard(entry)
    return None


@contextmanager
def preparing(digest: str) -> Iterator[Path | None]:
    """A folder of one's own for a new entry, moved into place when the block ends well; None when there is nowhere."""
    place = folder()
    try:
        own = None if place is None else Path(tempfile.mkdtemp(prefix=f".{digest[:16]}.", dir=place))
    except OSError:
        own = None
    if place is None or own is None:
        yield None
        return
    try:
        yield own
        with suppress(OSError):
            (own / LIST).write_text(json.dumps(_contents(own)), encoding="ascii")
            own.rename(place / digest)  # fails when another process was first: its entry is as good
            _prune(place)
    finally:
        discard(own)


def discard(entry: Path) -> None:
    """Remove an entry, as far as that can be done."""
    shutil.rmtree(entry, ignore_errors=True)


def _contents(entry: Path) -> dict[str, str]:
    """SHA-256 of every file, by its path inside the entry."""
    files = sorted(f for f in entry.rglob("*") if f.is_file() and f.name != LIST)
    return {f.relative_to(entry).as_posix(): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def _sound(entry: Path) -> bool:
    try:
        return json.loads((entry / LIST).read_text(encoding="ascii")) == _contents(entry)
    except (OSError, ValueError):
        return False


def _prune(place: Path) -> None:
    entries, now = [], time.time()
    for entry in place.iterdir():
        with suppress(OSError):
            used = entry.stat().st_mtime
            if not entry.name.startswith("."):
                entries.append((used, entry))
            elif now - used > ABANDONED:
                discard(entry)
    for _, entry in sorted(entries)[:-KEPT]:
        discard(entry)
