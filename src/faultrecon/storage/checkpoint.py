# SPDX-License-Identifier: BSD-3-Clause
"""Checkpoints: where a run stands, as one JSON file that gives back every bit of every number.

A checkpoint is written whole or not at all and reaches the disk before it counts.  It says what it is `of` (which
design, which log, which options), so that a run never goes on from another one's state.

    float            {"$float": "0x1.8p+1"}, "inf", "-inf", "nan", "nan:<16 hexadecimal digits>" for an unusual NaN
    whole number     as it is up to 2^53, {"$int": "..."} beyond, where other readers of JSON would round it
    array            {"$array": "float64", "bool", "int8" to "uint64", "shape": [...], "values": [...]}
    other mappings   as they are; a key that begins with $ gets one more
"""

from __future__ import annotations

import json
import math
import os
import re
import struct
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.storage.atomic import replacing
from faultrecon.storage.hashing import canonical_digest

KIND = "faultrecon-checkpoint"
SCHEMA = 1
EXACT = 2**53  # whole numbers up to here survive in readers that know doubles only
PLAIN_NAN = 0x7FF8000000000000
WHOLE = tuple(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
TYPES = ("float64", "bool", *WHOLE)  # of arrays
DAMAGE = (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError)
ANEW = "delete it and begin anew"


@dataclass(frozen=True)
class Checkpoint:
    """of: what the run is about, by name; content: where it stands.  Both are nested plain values and arrays."""

    of: Mapping[str, Any]
    content: Mapping[str, Any]
    written_by: str = ""


def save(path: str | os.PathLike[str], of: Mapping[str, Any], content: Mapping[str, Any]) -> None:
    """Write a checkpoint; when this returns it is on the disk, and a kill before that leaves the one before.

    Values are str, int, float, bool, None, lists and mappings of them with text for keys, and arrays of float64,
    bool or whole numbers.  Raises TypeError on any other value, InputError when the file cannot be written.
    """
    from faultrecon import __version__

    document = {
        "kind": KIND,
        "schema": SCHEMA,
        "written_by": f"faultrecon {__version__}",
        "of": _coded(of),
        "content": _coded(content),
    }
    document["sha256"] = canonical_digest(document)
    text = json.dumps(document, ensure_ascii=True, allow_nan=False) + "\n"
    with replacing(path) as temporary, open(temporary, "w", encoding="ascii", newline="\n") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    settle_folder(Path(path).parent)


def settle_folder(folder: Path) -> None:
    """See to it that the names of the files in a folder are on the disk, where the system can do that."""
    if os.name == "nt":
        return
    place = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(place)
    finally:
        os.close(place)


def sweep(path: str | os.PathLike[str]) -> None:
    """Remove what kills have left of attempts to write this file; only the run that it belongs to may."""
    file = Path(path)
    unfinished = re.compile(rf"\.{re.escape(file.stem)}\.[0-9a-f]{{12}}{re.escape(file.suffix)}")
    with suppress(OSError):
        for name in os.listdir(file.parent):
            if unfinished.fullmatch(name):
                (file.parent / name).unlink()


def load(path: str | os.PathLike[str]) -> Checkpoint:
    """Read a checkpoint.  Raises InputError on a file that is absent, damaged, something else, or newer than this."""
    source = os.fspath(path)
    try:
        document = json.loads(Path(path).read_bytes())
    except FileNotFoundError as error:
        raise InputError(f"{source}: no such file", remedies=("begin without a checkpoint",)) from error
    except OSError as error:
        raise InputError(f"{source}: cannot be read", why=str(error.strerror or error)) from error
    except (ValueError, RecursionError) as error:
        raise _damaged(source, str(error)) from error
    if not isinstance(document, dict) or document.get("kind") != KIND:
        raise InputError(f"{source}: is no checkpoint", remedies=("name the file given to --checkpoint",))
    if document.get("schema") != SCHEMA:
        raise InputError(
            f"{source}: has schema {document.get('schema')!r:.20}",
            why=f"this version reads schema {SCHEMA}; the file was written by {document.get('written_by')!s:.40}",
            remedies=("update faultrecon", ANEW),
        )
    digest = document.pop("sha256", None)
    try:
        if digest != canonical_digest(document):
            raise _damaged(source, "its content does not have the SHA-256 that it states")
        return Checkpoint(_decoded(document["of"]), _decoded(document["content"]), str(document["written_by"]))
    except InputError:
        raise
    except DAMAGE as error:
        raise _damaged(source, f"{type(error).__name__}: {error}") from error


def demand_same(path: str | os.PathLike[str], found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """The checkpoint is of this very run.  Raises InputError that says in what the two differ."""
    differ = [name for name in dict.fromkeys((*expected, *found)) if found.get(name) != expected.get(name)]
    if differ:
        said = [f"{name} is {_short(found.get(name))} there, {_short(expected.get(name))} here" for name in differ]
        raise InputError(
            f"{os.fspath(path)}: is the checkpoint of another run",
            why="; ".join(said),
            remedies=("give the same design, log and options as before", ANEW),
        )


def _short(value: Any) -> str:
    text = "absent" if value is None else str(value)
    return text if len(text) <= 40 else f"{text[:16]}..."


def _damaged(source: str, why: str) -> InputError:
    return InputError(f"{source}: is damaged", why=why[:200], remedies=(ANEW,))


# ---------------------------------------------------------------- values as JSON


def _coded(value: Any) -> Any:
    """A plain value or an array, as JSON can hold it."""
    if value is None or isinstance(value, bool | str):
        return value
    if type(value) is int:
        return value if abs(value) <= EXACT else {"$int": str(value)}
    if type(value) is float:
        return {"$float": _float_text(value)}
    if isinstance(value, list):
        return [_coded(v) for v in value]
    if isinstance(value, Mapping):
        wrong = next((key for key in value if not isinstance(key, str)), None)
        if wrong is not None:
            raise TypeError(f"a checkpoint holds no key {wrong!r}: keys are text")
        return {(f"${key}" if key.startswith("$") else key): _coded(v) for key, v in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.name in TYPES and value.dtype.isnative:
        entries = value.ravel().tolist()
        entries = [_float_text(v) for v in entries] if value.dtype == np.float64 else entries
        return {"$array": value.dtype.name, "shape": list(value.shape), "values": entries}
    raise TypeError(f"a checkpoint holds no {type(value).__name__}: {value!r:.60}")


def _decoded(value: Any) -> Any:
    """What `_coded` was given."""
    if isinstance(value, list):
        return [_decoded(v) for v in value]
    if not isinstance(value, dict):
        return value
    if "$float" in value:
        return _float_of(value["$float"])
    if "$int" in value:
        return int(value["$int"])
    if "$array" in value:
        return _array_of(value)
    return {(key[1:] if key.startswith("$$") else key): _decoded(v) for key, v in value.items()}


def _array_of(value: Mapping[str, Any]) -> NDArray:
    entries = value["values"]
    if value["$array"] == "float64":
        entries = [_float_of(text) for text in entries]
    return np.array(entries, dtype=TYPES[TYPES.index(value["$array"])]).reshape(value["shape"])


def _float_text(value: float) -> str:
    if not math.isnan(value):
        return value.hex()
    bits = struct.unpack("<Q", struct.pack("<d", value))[0]
    return "nan" if bits == PLAIN_NAN else f"nan:{bits:016x}"


def _float_of(text: str) -> float:
    if text == "nan":
        return math.nan
    if text.startswith("nan:"):
        return struct.unpack("<d", struct.pack("<Q", int(text[4:], 16)))[0]
    return float.fromhex(text)
