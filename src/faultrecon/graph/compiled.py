# SPDX-License-Identifier: BSD-3-Clause
"""Generated programs, compiled by Numba and kept: in this process, and on disk for the next one."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import math
import os
import platform
import re
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Inconclusive
from faultrecon.storage import kernelcache

FILE = "kernel.py"
HELD = 64  # programs kept in memory; each holds some 100 kB of machine code

Kernels = Mapping[str, Callable[..., Any]]
_held: dict[str, Kernels] = {}
_lock = threading.Lock()  # Numba compiles one thing at a time in any case


@dataclass(frozen=True, eq=False)
class Program:
    """Text made by this package alone, and the arrays it reads by name.

    The text may use `math`, `np`, `inf`, `nan`, Numba's types by the names in `_vocabulary`, and two decorators:
    `part`, for functions that other functions call, and `kernel(signature)`, for those that Python calls.
    """

    text: str
    constants: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # Numba copies arrays into the machine code when they lie in one piece and have less than a megabyte.
        pieces = {name: np.array(array, dtype=float, order="C") for name, array in self.constants.items()}
        object.__setattr__(self, "constants", pieces)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the text, the constants, and all that decides which machine code comes out."""
        mixed = hashlib.sha256("\n".join((*_machine(), self.text)).encode("utf-8"))
        for name in sorted(self.constants):
            array = self.constants[name]
            mixed.update(f"{name} {array.shape}".encode("ascii") + array.tobytes())
        return mixed.hexdigest()


def obstacle() -> str:
    """Why nothing can be compiled here; empty when it can, as far as can be told without importing Numba."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return "NUMBA_DISABLE_JIT is set"
    return "" if importlib.util.find_spec("numba") else "Numba is not installed"


def where(program: Program) -> Literal["memory", "disk", ""]:
    """Where the compiled program can be had from at once, if anywhere."""
    if program.digest in _held:
        return "memory"
    return "disk" if kernelcache.stored(program.digest) else ""


def load(program: Program) -> Kernels:
    """The functions of a program that are marked `kernel`, compiled.

    From memory, from disk, or by compiling now (about a second).  Raises Inconclusive when Numba cannot do it.
    """
    with _lock:
        found = _held.get(program.digest)
        if found is None:
            found = _from_disk(program) or _compile(program)
            while len(_held) >= HELD:
                dropped = next(iter(_held))
                del _held[dropped]
                sys.modules.pop(_module_name(dropped), None)
            _held[program.digest] = found
    return found


def plain_text(function: Callable[..., Any], **constants: float) -> str:
    """The source of a function of this package as a program takes it: annotations off, named constants put in."""
    head, body = inspect.getsource(function).split('"""', 1)
    arguments = ", ".join(inspect.signature(function).parameters)
    text = f'{head[: head.index("(")]}({arguments}):\n    """{body}'
    for name, value in constants.items():
        text = re.sub(rf"\b{name}\b", repr(value), text)
    return text


def forget() -> None:
    """Drop what this process has compiled; the disk keeps its copies."""
    with _lock:
        _held.clear()


def _from_disk(program: Program) -> Kernels | None:
    entry = kernelcache.stored(program.digest)
    if entry is None:
        return None
    try:
        return _run(program, entry)
    except Exception:  # Numba unpickles what it finds; whatever comes of that, compiling anew is right
        kernelcache.discard(entry)
        return None


def _compile(program: Program) -> Kernels:
    try:
        with kernelcache.preparing(program.digest) as entry:
            if entry is not None and _written(entry / FILE, program.text):
                return _run(program, entry)
        return _run(program, None)
    except Exception as error:  # Numba and LLVM raise whatever they like; the caller has another engine
        reason = str(error).strip().splitlines() or [""]
        raise Inconclusive(
            "the program could not be compiled",
            why=f"{type(error).__name__}: {reason[0]}",
            remedies=('use the other engine (engine="casadi")',),
        ) from error


def _written(path: Path, text: str) -> bool:
    try:
        path.write_text(text, encoding="utf-8", newline="\n")
        return True
    except OSError:
        return False


def _run(program: Program, entry: Path | None) -> Kernels:
    """Execute the text once, which defines and compiles its functions.

    entry: the folder where Numba keeps the machine code, beside the file that it takes for the source.
    """
    names, kernels = _vocabulary(keep=entry is not None)
    module = ModuleType(_module_name(program.digest))
    vars(module).update(names, **program.constants)
    sys.modules[module.__name__] = module  # machine code from disk looks its module up by name
    file = f"<{module.__name__}>" if entry is None else str(entry / FILE)
    # The text is what this process generated, never what a file holds.  It is made of `graph.source` statements, whose
    # operations come from a fixed table, whose names are our own and whose numbers are floats: no user text reaches it.
    with _beside_its_source(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that machine code with larger arrays is not kept on disk
        exec(compile(program.text, file, "exec"), vars(module))  # noqa: S102 - see above
    return kernels


@contextmanager
def _beside_its_source() -> Iterator[None]:
    """Numba keeps machine code beside the source, even where NUMBA_CACHE_DIR names a folder that knows no checksums."""
    config: Any = importlib.import_module("numba.core.config")  # its names are made at run time
    before = config.CACHE_DIR
    config.CACHE_DIR = ""
    try:
        yield
    finally:
        config.CACHE_DIR = before


def _module_name(digest: str) -> str:
    return f"faultrecon_kernel_{digest[:16]}"


def _vocabulary(keep: bool) -> tuple[dict[str, Any], dict[str, Callable[..., Any]]]:
    """The names a program may use, and where its kernels are gathered as they are defined."""
    from numba import njit
    from numba.core.types import Array, boolean, float64, int64

    # numpy: a division by zero is inf or NaN, as it is on every other road.  No fast-math: the bits are to agree.
    options = {"error_model": "numpy", "cache": keep}
    kernels: dict[str, Callable[..., Any]] = {}

    def kernel(signature: Any, **more: Any) -> Callable[[Callable[..., Any]], Any]:
        def compiled(function: Callable[..., Any]) -> Any:
            kernels[function.__name__] = njit(signature, **options, **more)(function)
            return kernels[function.__name__]

        return compiled

    names = {"math": math, "np": np, "inf": math.inf, "nan": math.nan}
    names |= {"part": njit(**options), "kernel": kernel, "int64": int64, "float64": float64, "boolean": boolean}
    # Any strides will do, and what is only read may be read-only.
    names |= {"row": Array(float64, 1, "C"), "vector": Array(float64, 1, "A", readonly=True)}
    names |= {"table": Array(float64, 2, "A", readonly=True), "into": Array(float64, 2, "A")}
    names |= {"block": Array(float64, 2, "C", readonly=True)}  # where it is worth a copy that it lies in one piece
    return names, kernels


@cache
def _machine() -> tuple[str, ...]:
    """What the machine code depends on besides the program."""
    from importlib.metadata import PackageNotFoundError, version

    versions = []
    for package in ("numba", "llvmlite", "numpy"):
        try:
            versions.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            versions.append(f"no {package}")
    try:
        from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

        processor = f"{get_host_cpu_name()} {get_host_cpu_features().flatten()}"
    except Exception as error:  # llvmlite missing, or unable to tell on this machine
        processor = f"{platform.machine()} {type(error).__name__}"
    return sys.implementation.cache_tag or "", sys.version, platform.system(), processor, *versions
