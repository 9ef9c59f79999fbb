# SPDX-License-Identifier: BSD-3-Clause
"""The observer at work: one sample at a time, or a whole log, with the same results either way.

A sample is (t, u, y).  On receiving sample k the estimator carries the observer from t[k-1] to t[k] and then reads off
the estimate, so it is causal; what u and y did in between is the explicit choice `hold`.

What happens to imperfect samples is part of the contract:

- NaN or inf in a measurement: the observer's own prediction takes its place, so that it drives neither the state nor
  the other faults; `ok` is False there; a fault whose estimate reads that channel directly is NaN in that row, and the
  corrected value is the prediction.  Without a `Prediction` the last value stays and the corrected value is NaN.
  Injections find no innovation in that channel: it reads what the observer predicts before they act.
- NaN or inf in an input: the last known input stays, and `ok` is False for the whole row.
- An interval that is not the sample time (by more than one millionth) is integrated over its own length, in parts no
  longer than the sample time; for all but rk4, lengths are told apart to one millionth of the sample time.
  Implicit injections act once, at the new sample, for the whole interval.
- A sampled observer is not integrated.  An interval of k sample times is k - 1 rows that never came: each is predicted
  whole, like a sample without a single measurement, and counted among the gaps.  Any other interval is taken for the
  nearest such one, and `ok` is False for the whole row: its time is not the one the observer has counted to.
- A wrong shape, time that does not increase, and an interval of more than ten million sample times raise InputError.

Two engines share the work, see `runtime.engine`: which one is reported, and the rules are the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy import empty, ndarray
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import InputError
from faultrecon.graph.observer import Observer
from faultrecon.runtime.engine import Chosen, Engine, EngineName
from faultrecon.runtime.filling import Prediction
from faultrecon.runtime.general import REGULAR, General, stability_limit
from faultrecon.runtime.injecting import check, overridden
from faultrecon.runtime.samples import (
    Array,
    Buffers,
    Estimate,
    Layout,
    State,
    Trace,
    before_the_first,
    checked_log,
    checked_row,
    columns,
)
from faultrecon.runtime.stepping import Hold, Scheme

COMFORT = 1 / 3  # of the RK4 limit: there |h s| <= 0.93 and one step errs by less than |h s|^5/120 = 0.6 % of a mode
WORTHWHILE = 32  # plain rows: going from the general engine to the compiled one and back costs as much as 40 of them
BLOCK = 65_536  # rows between two reports of progress: 5 ms of compiled work


@dataclass(frozen=True, eq=False, repr=False)
class Estimator:
    """An observer made executable for one sample time: pure `init` and `step`, and `replay` for a whole log.

    Use `Estimator.build`.  scheme is what was chosen, never "auto"; hold says how samples are read in between:
    "left" (the older one stays), "midpoint" (their mean) or "linear" (a straight line).
    """

    observer: Observer
    sample_time: float
    hold: Hold
    scheme: Scheme
    prediction: Prediction | None = None
    asked: EngineName = "auto"
    _chosen: Chosen = field(init=False)
    _general: General = field(init=False)

    def __post_init__(self) -> None:
        general = General(self.observer, self.sample_time, self.hold, self.scheme, self.prediction)
        object.__setattr__(self, "_general", general)
        object.__setattr__(self, "_chosen", Chosen(self.asked))
        if self.asked == "numba":
            self.warm()

    @staticmethod
    def build(
        observer: Observer,
        sample_time: float,
        *,
        hold: Hold = "linear",
        scheme: Scheme = "auto",
        prediction: Prediction | None = None,
        engine: EngineName = "auto",
        bound: float | Sequence[float] | None = None,
        layer: float | Sequence[float] | None = None,
    ) -> Estimator:
        """The estimator for samples every `sample_time` seconds.

        auto: exact exponentials for a linear observer; for a nonlinear one RK4 where its step is a third of the
        stability limit or less, else exponentials; for one with injections the implicit scheme, which does not chatter
        ("explicit" does; it is for comparison).  prediction: the plant's C and D, for missing channels.
        A sampled observer has its own sample time and map: scheme is "sampled", and hold "left" whatever is asked for.
        engine: "auto" compiles when a log is long enough to repay it, "casadi" never, "numba" now.
        bound, layer: ρ and δ of the injections in place of the observer's own, one number for all or one for each; ρ
        is a noise tuning knob: no larger than the fault needs, since it is what noise can move the state by per second.
        Raises InputError, before anything runs, when RK4 is asked for beyond its stability limit.
        """
        for name, value in (("sample time", sample_time), ("bound", bound), ("layer", layer)):
            if any(isinstance(v, bool | np.bool_) for v in np.ravel(np.array(value, dtype=object))):
                raise InputError(f"the {name} is {value}", why="it is a number, and True is not taken for 1")
        if not (isinstance(sample_time, int | float) and math.isfinite(sample_time) and sample_time > 0):
            raise InputError(f"the sample time is {sample_time}", why="it is a positive number of seconds")
        if hold not in ("left", "midpoint", "linear"):
            raise InputError(f"'{hold}' is no hold", remedies=("use left, midpoint or linear",))
        if scheme not in ("auto", "zoh", "rk4", "implicit", "explicit", "sampled"):
            raise InputError(
                f"'{scheme}' is no integration scheme", remedies=("use auto, zoh, rk4, implicit, explicit or sampled",)
            )
        if engine not in ("auto", "casadi", "numba"):
            raise InputError(f"'{engine}' is no engine", remedies=("use auto, casadi or numba",))
        _check_sizes(observer, prediction)
        observer = overridden(observer, bound, layer)
        check(observer, sample_time)
        if scheme == "auto":
            scheme = _best_scheme(observer, sample_time)
        _demand_scheme_for(observer, scheme)
        if observer.sample_time is not None:
            _demand_its_sample_time(observer.sample_time, sample_time)
            hold = "left"
        if scheme == "rk4":
            _demand_stable_rk4(observer, sample_time)
        return Estimator(observer, float(sample_time), hold, scheme, prediction, engine)

    def __reduce__(self) -> tuple[Any, ...]:
        return Estimator, (self.observer, self.sample_time, self.hold, self.scheme, self.prediction, self.asked)

    def __repr__(self) -> str:
        o = self.observer
        kind = "linear" if o.linear else "with injections" if o.injections else "nonlinear"
        kind += "" if o.sample_time is None else ", sampled"
        return (
            f"Estimator({kind}, {o.A.shape[0]} states, {len(o.y0)} sensors, {o.F.shape[1]} faults; "
            f"every {self.sample_time:g} s, hold {self.hold}, scheme {self.scheme}, engine {self.engine})"
        )

    # ------------------------------------------------------------ engines

    @property
    def engine(self) -> Engine:
        """What steps complete samples at regular times, and why; all others take the general road."""
        return self._chosen.engine

    def warm(self) -> Estimator:
        """Compile now, about a second, or fetch what was compiled before; this estimator comes back.

        Without it a single `step` is not compiled, so that no call of a live loop ever takes a second by surprise.
        """
        self._chosen.compile(self._general)
        return self

    def expect(self, rows: int) -> None:
        """Have the kernels ready if that pays for so many rows, which may come in pieces."""
        self._chosen.prepare(self._general, rows)

    # ------------------------------------------------------------ one sample at a time

    def init(self, *, x: ArrayLike | None = None) -> State:
        """Before the first sample.  x: where the plant is thought to be (n,), absolute; else the observer at rest."""
        guess = None
        if x is not None:
            guess = np.array(x, dtype=float)
            if guess.shape != self.observer.x0.shape or not np.isfinite(guess).all():
                raise InputError(f"the initial state is {x!r}", why=f"it takes {len(self.observer.x0)} finite numbers")
        return before_the_first(self._layout, guess)

    def step(self, state: State, t: float, u: ArrayLike, y: ArrayLike) -> tuple[State, Estimate]:
        """Take one sample at time t, u (m,), y (p,) in, absolute; the next state and the estimate come back."""
        row = empty(self._width)
        try:
            # Numba takes 0.1 ms to say that it was given a list; asking first costs nothing.
            refused = type(u) is not ndarray or type(y) is not ndarray or self._chosen.one(state._row, t, u, y, row)
        except TypeError:  # arrays, but not of floats
            refused = True
        if refused:
            row = self._any_sample(state._row, t, u, y)
        return State(row, self._layout), Estimate(row, self._layout)

    def buffers(self, state: State | None = None) -> Buffers:
        """What `step_into` works on, from `state` on, or before the first sample."""
        return Buffers(self.init() if state is None else state)

    def step_into(self, buffers: Buffers, t: float, u: ArrayLike, y: ArrayLike) -> None:
        """The same as `step`, bit for bit, in place: `buffers` holds the new state and the estimate afterwards.

        For loops that must not allocate.  When it raises, the buffers are as they were.
        """
        row = buffers._row
        try:
            refused = type(u) is not ndarray or type(y) is not ndarray or self._chosen.over(row, t, u, y)
        except TypeError:
            refused = True
        if refused:
            row[:] = self._any_sample(row, t, u, y)
            buffers.refresh()
        elif not buffers.complete:
            buffers.refresh()

    def _any_sample(self, before: Array, t: float, u: ArrayLike, y: ArrayLike) -> Array:
        """The row after a sample of any kind, its parts in any form that reads as numbers."""
        o = self.observer
        t = float(t)
        u, y = checked_row(u, len(o.u0), "u"), checked_row(y, len(o.y0), "y")
        if len(before) != self._width:
            raise InputError("the state belongs to another estimator")
        row = np.empty(self._width)
        if not self._chosen.one(before, t, u, y, row):  # lists and whole numbers: plain after all
            return row
        last = State(before, self._layout)
        if not math.isfinite(t) or (last.samples and not t > last.t):
            raise InputError(
                f"the sample at t = {t:g} s follows the one at {last.t:g} s",
                why="time must increase from sample to sample",
                remedies=("drop late and repeated samples",),
            )
        return self._general.sample(before, t, u, y)

    @cached_property
    def _layout(self) -> Layout:
        return self._general.layout

    @cached_property
    def _width(self) -> int:
        return self._layout.width

    # ------------------------------------------------------------ a whole log

    def replay(
        self,
        t: ArrayLike,
        u: ArrayLike,
        y: ArrayLike,
        *,
        x: ArrayLike | None = None,
        state: State | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Trace:
        """A whole log: t (N,), u (N, m), y (N, p), absolute; the same as `step`, sample by sample.

        x: as in `init`.  state: where an earlier part of the log ended, `Trace.end`, in place of x; a log replayed in
        parts gives the rows of the whole.  progress is told now and then which part of the work is done, 0 to 1.  The
        bits are those of `step`, if the engines' sin, cos, ... are: each has a library of its own for these.
        """
        t, u, y = checked_log(t, u, y, len(self.observer.u0), len(self.observer.y0))
        begins = self.init(x=x) if state is None else self._demand_before(state, t)
        return self.go_on(begins, t.copy(), u, y, progress or _silent)

    def go_on(self, state: State, t: Array, u: Array, y: Array, tell: Callable[[float], None]) -> Trace:
        """The same for samples that `checked_log` has been through, all of them later than the state."""
        o, rows, row = self.observer, len(t), state._row.copy()
        self._chosen.prepare(self._general, rows)
        fault, x_hat = columns(rows, o.F.shape[1]), columns(rows, len(o.x0))
        corrected, ok = columns(rows, len(o.y0)), columns(rows, len(o.y0), bool)
        ok[:] = True
        many, plain, k = self._chosen.many, None, 0
        while k < rows:
            if many is not None:
                reached = many(row, t, u, y, k, min(k + BLOCK, rows), fault, x_hat, corrected)
                if reached > k:
                    k = reached
                    tell(k / rows)
                    continue
            if k == 0 and many is not None:  # the first sample is seldom plain
                here = slice(0, 1)
            else:  # nor are this one and those up to the next plain one
                plain = self._plain_rows(t, u, y) if plain is None else plain
                here = slice(k, int(plain[np.searchsorted(plain, k, side="right")]))
            into = fault[here], x_hat[here], corrected[here], ok[here]
            row = self._general.stretch(row, t[here], u[here], y[here], into, _part_of(tell, k, rows))
            k = here.stop
        tell(1.0)
        return Trace(t, fault, x_hat, corrected, ok, State(row, self._layout))

    def _demand_before(self, state: State, t: Array) -> State:
        """A state of this estimator, from before t."""
        if len(state._row) != self._width:
            raise InputError("the state belongs to another estimator")
        if state.samples and len(t) and not t[0] > state.t:
            raise InputError(
                f"the log goes on at {t[0]:g} s, and the part before it ended at {state.t:g} s",
                why="time must increase from sample to sample",
            )
        return state

    def _plain_rows(self, t: Array, u: Array, y: Array) -> NDArray[np.intp]:
        """The rows that the compiled kernel is to take, if there is one, and N at their end."""
        rows = len(t)
        if self._chosen.many is None:
            return np.array([rows])
        complete = np.asarray(np.isfinite(y).all(axis=1))
        plain = complete & np.isfinite(u).all(axis=1)
        plain[:1] = False
        with np.errstate(over="ignore"):  # two finite times may be infinitely far apart
            plain[1:] &= self._general.is_regular(np.diff(t), t[1:])
        if self.hold == "left":
            plain[1:] &= complete[:-1]
        edges = np.flatnonzero(np.diff(plain, prepend=False, append=False))
        for start, end in edges.reshape(-1, 2)[np.diff(edges)[::2] < WORTHWHILE]:
            plain[start:end] = False
        return np.append(np.flatnonzero(plain), rows)


def rk4_limit(observer: Observer) -> float:
    """The largest stable RK4 step for the linear part of a continuous observer, s; inf when nothing decays."""
    return stability_limit(observer.A)


def _best_scheme(observer: Observer, sample_time: float) -> Scheme:
    if observer.sample_time is not None:
        return "sampled"
    if observer.injections:
        return "implicit"
    return "rk4" if not observer.linear and sample_time <= COMFORT * rk4_limit(observer) else "zoh"


def _demand_its_sample_time(own: float, given: float) -> None:
    if abs(given - own) > REGULAR * own:
        raise InputError(
            f"the sample time is {given:g} s, and this observer is made for {own:g} s",
            why="it is a map from one sample to the next, and another sample time has another map",
            evidence={"sample_time": given, "designed for": own},
            remedies=(f"sample every {own:g} s", f"design for {given:g} s: fix={{'T': {given:g}}}"),
        )


def _demand_scheme_for(observer: Observer, scheme: Scheme) -> None:
    if (observer.sample_time is not None) != (scheme == "sampled"):
        sampled = observer.sample_time is not None
        raise InputError(
            f"'{scheme}' cannot step a {'sampled' if sampled else 'continuous'} observer",
            why="its equations say what z is at the next sample, so there is nothing to integrate"
            if sampled
            else "its equations say how fast z changes, not what it is at the next sample",
            remedies=("use scheme='auto'" + (" or 'sampled'" if sampled else ", 'zoh' or 'rk4'"),),
        )
    if observer.sample_time is not None and observer.injections:
        raise InputError("a sampled observer with injections", why="an injection is stated for continuous time")
    if observer.injections and scheme in ("zoh", "rk4"):
        raise InputError(
            f"'{scheme}' cannot step an observer with discontinuous injections",
            why="it takes the slope for smooth; where the injection switches it chatters or stalls",
            remedies=("use scheme='implicit', which does neither", "scheme='explicit', to see it chatter"),
        )
    if not observer.injections and scheme in ("implicit", "explicit"):
        raise InputError(
            f"'{scheme}' is for observers with discontinuous injections",
            why="this one has none",
            remedies=("use scheme='auto', 'zoh' or 'rk4'",),
        )


def _demand_stable_rk4(observer: Observer, sample_time: float) -> None:
    limit = rk4_limit(observer)
    if sample_time > limit:
        fastest = float(np.abs(observer.poles).max())
        raise InputError(
            f"RK4 is unstable at a step of {sample_time:g} s: the largest stable step here is {limit:.3g} s",
            why=f"its fastest pole is {fastest:.3g} rad/s",
            evidence={"sample_time": sample_time, "largest_stable_step": limit, "fastest_pole": fastest},
            remedies=(
                "use scheme='zoh', which is stable for any pole",
                f"sample every {limit:.3g} s or faster",
                "design with a lower pole bound",
            ),
        )


def _check_sizes(observer: Observer, prediction: Prediction | None) -> None:
    o = observer
    nz, n, m, p, q = o.A.shape[0], len(o.x0), len(o.u0), len(o.y0), o.F.shape[1]
    wanted = {"A": (nz, nz), "B": (nz, m + p), "Cx": (n, nz), "Dx": (n, m + p), "Cf": (q, nz), "Df": (q, m + p)}
    for name, shape in (wanted | {"F": (p, q)}).items():
        if getattr(o, name).shape != shape:
            raise InputError(
                f"the observer's {name} is {getattr(o, name).shape}", why=f"its other parts ask for {shape}"
            )
    if prediction is not None and (prediction.C.shape != (p, n) or prediction.D.shape != (p, m)):
        raise InputError(
            f"the prediction has C {prediction.C.shape} and D {prediction.D.shape}",
            why=f"this observer asks for {(p, n)} and {(p, m)}",
        )


def _part_of(tell: Callable[[float], None], first: int, rows: int) -> Callable[[int], None]:
    return lambda done: tell((first + done) / rows)


def _silent(_: float) -> None:
    return None
