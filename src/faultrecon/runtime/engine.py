# SPDX-License-Identifier: BSD-3-Clause
"""Which engine does the work, chosen by what the work costs, and said aloud.

    casadi   knows every kind of sample and needs no compiling; about 1 us per sample of a small observer in a log
    numba    compiles the plain sample to machine code: some twenty times faster, after about a second

Both run the same instructions in the same order.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from faultrecon.finding import Inconclusive, InputError
from faultrecon.graph.compiled import Program, load, obstacle, where
from faultrecon.runtime.general import General
from faultrecon.runtime.kernel import program

EngineName = Literal["auto", "casadi", "numba"]

# Measured on one core of a server; only their ratio decides, and a factor of two either way costs little.
IMPORT = 0.2  # s, importing Numba
COMPILE = 0.8, 1.5e-3  # s, and s per line of the program, of which a small observer has some 200
FETCH = 0.1  # s, machine code from disk, for the first time in a process
PER_SAMPLE = 0.6e-6, 3e-9  # s per sample of a log on CasADi, and s per entry of the observer's matrices
PER_ROUND = 5  # what an entry of an injection costs in each of its five or more rounds, in entries of a matrix
SHORT_LOG = 20_000  # rows below which the question is not worth asking: 20 ms


class Engine(NamedTuple):
    """name: "casadi" or "numba", what complete samples at regular times are stepped by.  why: the reason."""

    name: Literal["casadi", "numba"]
    why: str

    def __str__(self) -> str:
        return f"{self.name} ({self.why})"


Plain = Callable[..., int]


def nothing_is_plain(*_: Any) -> int:
    """The plain step of an estimator that has nothing compiled: every sample needs the general one."""
    return 1


class Chosen:
    """What has been compiled for one estimator so far; the one place in `runtime` that changes.

    one, over and many are the kernels of `runtime.kernel`; until they are there one and over send every sample to the
    general engine, and many is None.
    """

    __slots__ = ("_program", "engine", "many", "one", "over", "wanted")

    def __init__(self, wanted: EngineName) -> None:
        self.wanted = wanted
        self.one: Plain = nothing_is_plain
        self.over: Plain = nothing_is_plain
        self.many: Plain | None = None
        self._program: Program | None = None
        self.engine = Engine("casadi", "as asked" if wanted == "casadi" else "a long log or warm() compiles")

    def prepare(self, general: General, rows: int) -> None:
        """Have the kernels ready if that pays for a log of so many rows."""
        if self.many is not None or self.wanted != "auto" or rows < SHORT_LOG:
            return
        if reason := obstacle():
            self.engine = Engine("casadi", reason)
            return
        source = self._source(general)
        if self._gain(general, source, rows) > 0:
            self._load(source)

    def compile(self, general: General) -> None:
        """Have the kernels ready, whatever it costs; where Numba cannot, `engine` says why.

        Raises InputError when Numba was asked for by name.
        """
        if self.many is not None or self.wanted == "casadi":
            return
        if reason := obstacle():
            self.engine = Engine("casadi", reason)
        else:
            self._load(self._source(general))
        if self.wanted == "numba" and self.many is None:
            raise InputError("this estimator cannot be compiled", why=self.engine.why, remedies=("use engine='auto'",))

    def _source(self, general: General) -> Program:
        if self._program is None:
            self._program = program(general)
        return self._program

    def _gain(self, general: General, source: Program, rows: int) -> float:
        """Seconds saved by using Numba for this log."""
        o = general.observer
        entries = 4 * (o.A.size + o.B.size) + o.Cx.size + o.Cf.size
        entries += sum(PER_ROUND * len(one.reads) * 5 for one in o.injections)
        saved = rows * (PER_SAMPLE[0] + PER_SAMPLE[1] * entries)
        found = where(source)
        if found == "memory":
            return saved
        cost = 0.0 if "numba" in sys.modules else IMPORT
        return saved - cost - (FETCH if found else COMPILE[0] + COMPILE[1] * source.text.count("\n"))

    def _load(self, source: Program) -> None:
        found = where(source)
        try:
            kernels = load(source)
        except Inconclusive as refused:
            self.engine = Engine("casadi", refused.finding.why)
            self.wanted = "casadi" if self.wanted == "auto" else self.wanted  # once is enough
            return
        self.one, self.over, self.many = kernels["one"], kernels["over"], kernels["many"]
        origin = {"memory": "compiled before", "disk": "from the kernel cache", "": "compiled now"}[found]
        self.engine = Engine("numba", origin)
