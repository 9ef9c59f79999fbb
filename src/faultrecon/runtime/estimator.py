# SPDX-License-Identifier: BSD-3-Clause
"""The observer at work: one sample at a time, or a whole log, with the same bits either way.

A sample is (t, u, y).  On receiving sample k the estimator carries the observer from t[k-1] to t[k] and then reads off
the estimate, so it is causal; what u and y did in between is the explicit choice `hold`.

What happens to imperfect samples is part of the contract:

- NaN or inf in a measurement: the observer's own prediction takes its place, so that it drives neither the state nor
  the other faults; `ok` is False there; a fault whose estimate reads that channel directly is NaN in that row, and the
  corrected value is the prediction.  Without a `Prediction` the last value stays and the corrected value is NaN.
- NaN or inf in an input: the last known input stays, and `ok` is False for the whole row.
- An interval that is not the sample time (by more than one millionth) is integrated over its own length, in parts no
  longer than the sample time; for zoh, lengths are told apart to one millionth of the sample time.
- A wrong shape, or time that does not increase, raises InputError.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from faultrecon.finding import InputError
from faultrecon.graph.observer import Observer
from faultrecon.runtime.samples import Array, Estimate, Mask, State, Trace, checked_log, checked_row, last_known
from faultrecon.runtime.stepping import LONG, Filling, Hold, Prediction, Scheme, Stepper, call, reads_directly, substeps

if TYPE_CHECKING:
    import casadi

REGULAR = 1e-6  # relative: how far an interval may be from the sample time and still count as one
COMFORT = 1 / 3  # of the RK4 limit: there |h s| <= 0.93 and one step errs by less than |h s|^5/120 = 0.6 % of a mode
REMEMBERED = 8_000_000  # numbers: how much of the matrices of irregular intervals is kept, 64 MB
PATTERNS = 256  # kernels kept, one per pair of gap patterns met


@dataclass(frozen=True, eq=False, repr=False)
class Estimator:
    """An observer made executable for one sample time: pure `init` and `step`, and `replay` for a whole log.

    Use `Estimator.build`.  scheme is what was chosen, "zoh" or "rk4"; hold says how samples are read in between:
    "left" (the older one stays), "midpoint" (their mean) or "linear" (a straight line).
    """

    observer: Observer
    sample_time: float
    hold: Hold
    scheme: Scheme
    prediction: Prediction | None = None
    _steppers: dict[bytes, Stepper] = field(default_factory=dict, init=False)
    _packed: dict[tuple[bytes, int], Array] = field(default_factory=dict, init=False)

    @staticmethod
    def build(
        observer: Observer,
        sample_time: float,
        *,
        hold: Hold = "linear",
        scheme: Scheme = "auto",
        prediction: Prediction | None = None,
    ) -> Estimator:
        """The estimator for samples every `sample_time` seconds.

        auto: exact exponentials for a linear observer; for a nonlinear one RK4 where its step is a third of the
        stability limit or less, else exponentials.  prediction: the plant's C and D, for missing channels.
        Raises InputError, before anything runs, when RK4 is asked for beyond its stability limit.
        """
        if not (isinstance(sample_time, int | float) and math.isfinite(sample_time) and sample_time > 0):
            raise InputError(f"the sample time is {sample_time}", why="it is a positive number of seconds")
        if hold not in ("left", "midpoint", "linear"):
            raise InputError(f"'{hold}' is no hold", remedies=("use left, midpoint or linear",))
        if scheme not in ("auto", "zoh", "rk4"):
            raise InputError(f"'{scheme}' is no integration scheme", remedies=("use auto, zoh or rk4",))
        _check_sizes(observer, prediction)
        if scheme == "auto":
            scheme = "rk4" if not observer.linear and sample_time <= COMFORT * rk4_limit(observer) else "zoh"
        if scheme == "rk4":
            _demand_stable_rk4(observer, sample_time)
        return Estimator(observer, float(sample_time), hold, scheme, prediction)

    def __reduce__(self) -> tuple[Any, ...]:
        return Estimator, (self.observer, self.sample_time, self.hold, self.scheme, self.prediction)

    def __repr__(self) -> str:
        o = self.observer
        kind = "linear" if o.linear else "nonlinear"
        return (
            f"Estimator({kind}, {o.A.shape[0]} states, {len(o.y0)} sensors, {o.F.shape[1]} faults; "
            f"every {self.sample_time:g} s, hold {self.hold}, scheme {self.scheme})"
        )

    # ------------------------------------------------------------ one sample at a time

    def init(self, *, x: ArrayLike | None = None) -> State:
        """Before the first sample.  x: where the plant is thought to be (n,), absolute; else the observer at rest."""
        o = self.observer
        guess = None
        if x is not None:
            guess = np.array(x, dtype=float)
            if guess.shape != o.x0.shape or not np.isfinite(guess).all():
                raise InputError(f"the initial state is {x!r}", why=f"it takes {len(o.x0)} finite numbers")
        width = len(o.u0) + len(o.y0)
        return State(
            np.zeros(o.A.shape[0]), math.nan, np.zeros(width), np.zeros(len(o.y0), dtype=bool), guess, 0, 0
        )  # fmt: skip

    def step(self, state: State, t: float, u: ArrayLike, y: ArrayLike) -> tuple[State, Estimate]:
        """Take one sample at time t, u (m,), y (p,) in, absolute; the next state and the estimate come back."""
        o = self.observer
        t = float(t)
        u, y = checked_row(u, len(o.u0), "u"), checked_row(y, len(o.y0), "y")
        if not math.isfinite(t) or (state.samples and not t > state.t):
            raise InputError(
                f"the sample at t = {t:g} s follows the one at {state.t:g} s",
                why="time must increase from sample to sample",
                remedies=("drop late and repeated samples",),
            )
        missing, lost = ~np.isfinite(y), ~np.isfinite(u)
        v = np.concatenate((np.where(lost, 0.0, u - o.u0), np.where(missing, 0.0, y - o.y0)))
        v[: len(u)][lost] = state.v[: len(u)][lost]
        s = self._first(state, v, missing) if state.samples == 0 else self._next(state, t, v, missing)
        nz = len(state.z)
        gap = bool(missing.any() or lost.any())
        new = State(s[:nz], t, s[nz:], missing, None, state.samples + 1, state.gaps + gap)
        fault, x, corrected, ok = self._read(s[None], y[None], missing[None], np.array([lost.any()]))
        return new, Estimate(t, fault[0], x[0], corrected[0], ok[0])

    # ------------------------------------------------------------ a whole log

    def replay(
        self,
        t: ArrayLike,
        u: ArrayLike,
        y: ArrayLike,
        *,
        x: ArrayLike | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Trace:
        """A whole log: t (N,), u (N, m), y (N, p), absolute; the same bits as `step`, sample by sample.

        x: as in `init`.  progress is told now and then which part of the work is done, 0 to 1.
        """
        o = self.observer
        t, u, y = checked_log(t, u, y, len(o.u0), len(o.y0))
        missing, lost = ~np.isfinite(y), ~np.isfinite(u)
        v = np.hstack([last_known(np.where(lost, 0.0, u - o.u0), lost), np.where(missing, 0.0, y - o.y0)])
        start = self.init(x=x)
        nz = len(start.z)
        s = np.empty((len(t), nz + v.shape[1]))
        if len(t):
            s[0] = self._first(start, v[0], missing[0])
            self._carry(s, t, v, missing, progress or _silent)
        fault, state, corrected, ok = self._read(s, y, missing, np.any(lost, axis=1))
        end = start
        if len(t):
            gaps = int(np.count_nonzero(missing.any(axis=1) | lost.any(axis=1)))
            end = State(s[-1, :nz].copy(), float(t[-1]), s[-1, nz:].copy(), missing[-1], None, len(t), gaps)
        (progress or _silent)(1.0)
        return Trace(t, fault, state, corrected, ok, end)

    def _carry(self, s: Array, t: Array, v: Array, missing: Mask, progress: Callable[[float], None]) -> None:
        """Fill s (N, nz+m+p) from its first row on; runs of alike intervals go to the compiled loop."""
        nz = self.observer.A.shape[0]
        lengths = np.diff(t)
        if not lengths.size:
            return
        regular = self._is_regular(lengths, t[1:])
        alike = regular[1:] & regular[:-1] & ~np.any(missing[2:] != missing[1:-1], axis=1)
        if self.hold == "left":
            alike &= ~np.any(missing[1:-1] != missing[:-2], axis=1)
        starts = np.concatenate(([0], 1 + np.flatnonzero(~alike)))
        ends = np.append(starts[1:], len(lengths))
        reported = 0
        for a, b in zip(starts, ends, strict=True):
            if b - a <= 4:  # a single call costs as much as eight rows of the loop
                for k in range(a, b):
                    before = State(s[k, :nz], float(t[k]), s[k, nz:], missing[k], None, 1, 0)
                    s[k + 1] = self._next(before, float(t[k + 1]), v[k + 1], missing[k + 1])
            else:
                stepper = self._stepper(missing[a], missing[a + 1])
                for c in range(a, b, LONG):
                    d = min(c + LONG, b)
                    s[c + 1 : d + 1] = stepper.run(s[c], t[c:d], v[c + 1 : d + 1])
                    progress(d / len(t))
            if b - reported > LONG:
                reported = b
                progress(b / len(t))

    # ------------------------------------------------------------ pieces

    def _first(self, state: State, v: Array, missing: Mask) -> Array:
        """[z; v] at the first sample: the observer state whose x̂ is the guess, in the sense of least squares."""
        o = self.observer
        z: Array = state.z
        m = len(o.u0)
        if state.guess is not None and len(z):
            deviation = state.guess - o.x0
            if self.prediction is not None and missing.any():  # the guess says what the missing sensors would read
                v = v.copy()
                expected = self.prediction.C @ deviation + self.prediction.D @ v[:m]
                v[m:][missing] = expected[missing]
            z = np.asarray(np.linalg.lstsq(o.Cx, deviation - o.Dx @ v, rcond=None)[0], dtype=float)
        filled = call(self._stepper(missing, missing).fill, [z, state.v, v], len(v))
        return np.concatenate((z, filled))

    def _next(self, state: State, t: float, v: Array, missing: Mask) -> Array:
        """[z; v] at the sample (t, v), v (m+p,) with zeros where a channel is missing."""
        stepper = self._stepper(state.missing, missing)
        s = np.concatenate((state.z, state.v))
        h = t - state.t
        if self._is_regular(h, t):
            return stepper.advance(s, state.t, v)
        parts = substeps(h, self.sample_time) if not self.observer.linear or stepper.scheme == "rk4" else 1
        return stepper.advance_by(s, state.t, h, v, [self._pack(stepper, h / parts)] * parts)

    def _is_regular(self, interval: Any, t: Any) -> Any:
        """Whether an interval is the sample time, up to `REGULAR` and the rounding of the clock itself."""
        return np.abs(interval - self.sample_time) <= REGULAR * self.sample_time + 2.0 * np.spacing(np.abs(t))

    def _stepper(self, before: Mask, after: Mask) -> Stepper:
        """The kernels for a pair of gap patterns, built once.

        While time passes a channel is unknown if the sample that says what it did is missing: the older one for the
        left hold, the newer one otherwise.  A filled observer whose poles RK4 cannot follow is stepped by zoh.
        """
        during = before if self.hold == "left" else after
        key = during.tobytes() + after.tobytes()
        if key not in self._steppers:
            filling = Filling.of(self.observer, self.prediction, during)
            arguments = (self.observer, filling, Filling.of(self.observer, self.prediction, after), after.copy())
            stepper = Stepper(*arguments, self.hold, self.scheme, self.sample_time)
            if self.scheme == "rk4" and during.any() and self.sample_time > _limit(stepper.A):
                stepper = Stepper(*arguments, self.hold, "zoh", self.sample_time)
            if len(self._steppers) >= PATTERNS:
                self._steppers.clear()
            self._steppers[key] = stepper
        return self._steppers[key]

    def _pack(self, stepper: Stepper, h: float) -> Array:
        """The matrices of a step of h seconds; they depend on what is filled in while time passes."""
        if stepper.scheme != "zoh":
            return stepper.pack(h)
        grain = REGULAR * self.sample_time
        length = max(1, round(h / grain))
        key = stepper.during.from_z.tobytes(), length
        if key not in self._packed:
            packed = stepper.pack(length * grain)
            if len(self._packed) * packed.size >= REMEMBERED:
                self._packed.clear()
            self._packed[key] = packed
        return self._packed[key]

    @cached_property
    def _reader(self) -> casadi.Function:
        """([z; v; y]) -> [f̂; x̂; y - F f̂; C x̂ + D u], for `LONG` rows at once and for one."""
        import casadi as ca

        o = self.observer
        nz, k, m = o.A.shape[0], o.B.shape[1], len(o.u0)
        row = ca.SX.sym("row", nz + k + len(o.y0))
        z, v, y = row[:nz], row[nz : nz + k], row[nz + k :]
        fault = _constant(o.Cf) @ z + _constant(o.Df) @ v
        deviation = _constant(o.Cx) @ z + _constant(o.Dx) @ v
        predicted = y * math.nan
        if self.prediction is not None:
            predicted = ca.DM(o.y0) + _constant(self.prediction.C) @ deviation + _constant(self.prediction.D) @ v[:m]
        parts = [fault, ca.DM(o.x0) + deviation, y - _constant(o.F) @ fault, predicted]
        return ca.Function("read", [row], [ca.densify(ca.vertcat(*parts))])

    @cached_property
    def _readers(self) -> casadi.Function:
        return self._reader.map(LONG)

    def _read(self, s: Array, y: Array, missing: Mask, lost: Mask) -> tuple[Array, Array, Array, Mask]:
        """fault, state, corrected and ok over rows: s (N, nz+m+p), y (N, p), missing (N, p), lost inputs (N,)."""
        o = self.observer
        n, p, q = len(o.x0), len(o.y0), o.F.shape[1]
        rows, width = len(s), q + n + 2 * p
        out = np.empty((rows, width))
        full = np.hstack([s, np.where(missing, 0.0, y)])
        if rows == 1:
            out[0] = call(self._reader, [full[0]], width)
        else:
            for a in range(0, rows, LONG):
                block = np.zeros((LONG, full.shape[1]))
                b = min(a + LONG, rows)
                block[: b - a] = full[a:b]
                out[a:b] = call(self._readers, [block], LONG * width).reshape(LONG, width)[: b - a]
        fault, state = out[:, :q].copy(), out[:, q : q + n].copy()
        corrected, predicted = out[:, q + n : q + n + p].copy(), out[:, q + n + p :]
        if missing.any():
            blind = (missing.astype(float) @ reads_directly(o).T) > 0  # reads a missing channel
            fault[blind] = math.nan
            corrected[(blind.astype(float) @ (o.F != 0).T) > 0] = math.nan
            corrected[missing] = predicted[missing]
        return fault, state, corrected, ~(missing | lost[:, None])


def rk4_limit(observer: Observer) -> float:
    """The largest stable RK4 step for the linear part of an observer, s; inf when nothing decays."""
    return _limit(observer.A)


def _limit(A: Array) -> float:
    from faultrecon.numerics.discretise import rk4_polynomial_limit

    return rk4_polynomial_limit(np.linalg.eigvals(A)) if A.size else math.inf


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


def _constant(matrix: Array) -> Any:
    import casadi as ca

    return ca.sparsify(ca.DM(matrix))


def _silent(_: float) -> None:
    return None
