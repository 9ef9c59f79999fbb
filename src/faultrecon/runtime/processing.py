# SPDX-License-Identifier: BSD-3-Clause
"""Work on samples that come in pieces: the protocol, and the bare reconstruction as its first implementation.

Where the pieces end changes nothing: any way of cutting a log gives the same rows, bit for bit, and so does a stop in
between, from `pack` to `unpack`.  They are the rows that `Estimator.replay` gives for the whole log.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.runtime.estimator import WORTHWHILE, Estimator
from faultrecon.runtime.samples import Array, Mask, State, checked_log, columns
from faultrecon.runtime.words import Words

S = TypeVar("S")
Columns = dict[str, NDArray[Any] | Words]


@dataclass(frozen=True, eq=False)
class Answers:
    """Rows out, and which samples they are of, by the order in which those were taken: the first one is number 0.

    rows: N of them, as `take` gives them; of (N,): the sample of each.  first: the number of the first sample that was
    given; aside: those given that will have no row of their own, each with the reason, which begins with a word.
    """

    rows: Columns
    of: NDArray[np.int64]
    first: int
    aside: Mapping[int, str] = field(default_factory=dict)


class Processor(Protocol[S]):
    """Samples in, rows out.  All that it remembers is in its state, a value that is never changed."""

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns that come out, "t" among them, in order."""
        ...

    @property
    def identity(self) -> str:
        """A content hash of all that decides what comes out; a state belongs to one identity."""
        ...

    def start(self) -> S:
        """Before the first sample."""
        ...

    def take(self, state: S, t: Array, u: Array, y: Array) -> tuple[S, Columns]:
        """Samples t (N,), u (N, m), y (N, p), N >= 0, absolute; there may be fewer or more rows out than in.

        Raises InputError on samples that cannot be taken; the state before is then as good as ever.
        """
        ...

    def finish(self, state: S) -> Columns:
        """The rows that were waiting for later samples."""
        ...

    def answer(self, state: S, t: Array, u: Array, y: Array) -> tuple[S, Answers]:
        """What `take` does, with what became of each sample; one that is refused has no number."""
        ...

    def rest(self, state: S) -> tuple[S, Answers]:
        """What `finish` does, with the samples the rows are of, and the state after them."""
        ...

    def pack(self, state: S) -> dict[str, Any]:
        """The state as plain values and arrays, for a checkpoint."""
        ...

    def unpack(self, packed: Mapping[str, Any]) -> S:
        """The state that was packed, every bit of it.  Raises InputError on one of another shape."""
        ...


def settled(estimator: Estimator, rows: int) -> Estimator:
    """The same estimator with the engine that `replay` would choose for a log of so many rows, now and for good.

    Engines may differ in the last bit of a sine, so what stops and goes on has to stay with one.
    """
    estimator.expect(rows)
    return replace(estimator, asked=estimator.engine.name)


@dataclass(frozen=True, eq=False)
class Standing:
    """Where a reconstruction is: the estimator's state; whether the compiled engine is at work; samples in waiting.

    A stretch of plain samples is compiled work when it is long enough, so the last few may wait for their successors.
    """

    last: State
    compiled: bool
    t: Array
    u: Array
    y: Array


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """One estimator.  names: t, inputs, sensors, faults, corrected sensors, flags, as a replay of a log has them.

    reached: the sensors that are written corrected, by number.  The estimator's engine must be a definite one, see
    `settled`; on "casadi" no sample waits, and one row comes out for one that goes in.
    """

    estimator: Estimator
    names: tuple[str, ...]
    reached: tuple[int, ...]
    identity: str

    def __post_init__(self) -> None:
        if self.estimator.asked == "auto":
            raise InputError("the engine is not settled", remedies=("pass settled(estimator, rows)",))

    @property
    def columns(self) -> tuple[str, ...]:
        return self.names

    def start(self) -> Standing:
        return self._standing(self.estimator.init(), False)

    def take(self, state: Standing, t: Array, u: Array, y: Array) -> tuple[Standing, Columns]:
        t, u, y = checked_log(t, u, y, *self._sizes)
        before = state.t[-1] if len(state.t) else state.last.t
        if len(t) and t[0] <= before:  # before the first sample of all it is NaN
            raise InputError(
                f"the sample at t = {t[0]:g} s follows the one at {before:g} s",
                why="time must increase from sample to sample",
                remedies=("drop late and repeated samples",),
            )
        return self._advanced(state, t, u, y, final=False)

    def finish(self, state: Standing) -> Columns:
        return self.rest(state)[1].rows

    def answer(self, state: Standing, t: Array, u: Array, y: Array) -> tuple[Standing, Answers]:
        after, rows = self.take(state, t, u, y)
        return after, self._answers(state, rows)

    def rest(self, state: Standing) -> tuple[Standing, Answers]:
        nothing = np.empty((0, self._sizes[0])), np.empty((0, self._sizes[1]))
        after, rows = self._advanced(state, np.empty(0), *nothing, final=True)
        return after, self._answers(state, rows)

    def pack(self, state: Standing) -> dict[str, Any]:
        waiting = {"t": state.t, "u": state.u, "y": state.y}
        return {"row": state.last._row.copy(), "compiled": state.compiled, "waiting": waiting}

    def unpack(self, packed: Mapping[str, Any]) -> Standing:
        m, p = self._sizes
        try:
            row, compiled = np.asarray(packed["row"], dtype=float), packed["compiled"]
            t, u, y = (np.asarray(packed["waiting"][name], dtype=float) for name in ("t", "u", "y"))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError("the stored state is none of a reconstruction", why=str(error)) from error
        shapes = row.shape, t.shape, u.shape, y.shape
        N = t.size
        if shapes != ((self.estimator._width,), (N,), (N, m), (N, p)):
            raise InputError("the stored state belongs to another estimator")
        return Standing(State(row, self.estimator._layout), bool(compiled), t, u, y)

    # ------------------------------------------------------------ the work

    def _answers(self, before: Standing, rows: Columns) -> Answers:
        """Each sample has its row, in their order; those in waiting come first."""
        done = before.last.samples
        return Answers(rows, np.arange(done, done + len(rows["t"])), done + len(before.t))

    @property
    def _sizes(self) -> tuple[int, int]:
        return len(self.estimator.observer.u0), len(self.estimator.observer.y0)

    def _standing(self, last: State, compiled: bool, *waiting: Array) -> Standing:
        m, p = self._sizes
        return Standing(last, compiled, *(waiting or (np.empty(0), np.empty((0, m)), np.empty((0, p)))))

    def _advanced(self, state: Standing, t: Array, u: Array, y: Array, final: bool) -> tuple[Standing, Columns]:
        """The samples in waiting and these; the last ones may wait again, unless this is the end."""
        e = self.estimator
        if len(state.t):
            t, u, y = np.concatenate((state.t, t)), np.vstack((state.u, u)), np.vstack((state.y, y))
        rows, o = len(t), e.observer
        into = columns(rows, o.F.shape[1]), columns(rows, len(o.x0)), columns(rows, len(o.y0)), _flags(rows, len(o.y0))
        row, k, compiled, plain = state.last._row.copy(), 0, state.compiled, None
        many = e._chosen.many
        while k < rows:
            if many is not None and compiled:
                k = many(row, t, u, y, k, rows, *into[:3])
                if k < rows:
                    compiled, plain = False, _plain(e, state.last, t, u, y) if plain is None else plain
                    plain[k] = False  # it was refused
                continue
            # The general engine takes the first sample of all, and after an odd one all up to the next long plain run.
            stop, compiled = rows, False
            if many is not None and State(row, e._layout).samples == 0:
                stop, compiled = k + 1, True
            elif many is not None:
                plain = _plain(e, state.last, t, u, y) if plain is None else plain
                stop, compiled = _next_run(plain, k, final)
            if stop > k:
                here = slice(k, stop)
                row = e._general.stretch(row, t[here], u[here], y[here], _parts(into, here), _unheard)
            k = stop
            if not compiled:
                break
        done = self._rows(t[:k], u[:k], y[:k], *_parts(into, slice(0, k)))
        return self._standing(State(row, e._layout), compiled, t[k:].copy(), u[k:].copy(), y[k:].copy()), done

    def _rows(self, t: Array, u: Array, y: Array, fault: Array, _: Array, corrected: Array, ok: Mask) -> Columns:
        values = [t, *u.T, *y.T, *fault.T, *(corrected[:, j] for j in self.reached), *ok.T]
        return dict(zip(self.names, values, strict=True))


def _plain(estimator: Estimator, last: State, t: Array, u: Array, y: Array) -> Mask:
    """The samples that the compiled engine can take, (N,); they follow `last`, which has been through one or more."""
    complete = np.asarray(np.isfinite(y).all(axis=1))
    plain = complete & np.isfinite(u).all(axis=1)
    with np.errstate(over="ignore"):  # two finite times may be infinitely far apart
        plain &= estimator._general.is_regular(np.diff(t, prepend=last.t), t)
    if estimator.hold == "left":
        plain &= np.concatenate(([not last.missing.any()], complete[:-1]))
    return plain


def _next_run(plain: Mask, k: int, final: bool) -> tuple[int, bool]:
    """Where the general engine stops that is at work from row k on, and whether the compiled one goes on there.

    It stops at a plain run worth the change of engines; at one that reaches the end of what is known, so that it may
    yet become one, it stops and waits.
    """
    edges = k + np.flatnonzero(np.diff(plain[k:], prepend=False, append=False))
    for start, end in edges.reshape(-1, 2):
        if end - start >= WORTHWHILE:
            return int(start), True
        if end == len(plain) and not final:
            return int(start), False
    return len(plain), False


def _flags(rows: int, p: int) -> Mask:
    ok = columns(rows, p, bool)
    ok[:] = True
    return ok


def _parts(into: tuple[Array, Array, Array, Mask], here: slice) -> tuple[Array, Array, Array, Mask]:
    fault, state, corrected, ok = into
    return fault[here], state[here], corrected[here], ok[here]


def _unheard(_: int) -> None:
    return None
