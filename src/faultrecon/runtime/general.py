# SPDX-License-Identifier: BSD-3-Clause
"""Any sample whatever: the first one, one with gaps, one that comes at an odd time; nothing needs compiling.

This is the engine that knows every rule.  It runs on CasADi's virtual machine: one sample by calls of a few
microseconds, stretches of alike samples through `mapaccum`.  The compiled engine takes over complete, regular samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from faultrecon.finding import InputError
from faultrecon.graph.observer import Observer
from faultrecon.runtime.filling import Filling, Prediction, reads_directly
from faultrecon.runtime.samples import Array, Layout, Mask, State, last_known
from faultrecon.runtime.stepping import LONG, Hold, Scheme, Stepper, call, substeps

if TYPE_CHECKING:
    import casadi

REGULAR = 1e-6  # relative: how far an interval may be from the sample time and still count as one
FARTHEST = 1e7  # sample times between two samples: a day at 10 ms, and two minutes of work to cross for a nonlinear one
REMEMBERED = 8_000_000  # numbers: how much of the matrices of irregular intervals is kept, 64 MB
PATTERNS = 256  # kernels kept, one per pair of gap patterns met
ALONE = 4  # rows: a single call costs as much as eight rows of a loop, which is padded to 32


@dataclass(frozen=True, eq=False, repr=False)
class General:
    """An observer with one sample time, one scheme and one hold, for samples of every kind."""

    observer: Observer
    sample_time: float
    hold: Hold
    scheme: Scheme
    prediction: Prediction | None = None
    _steppers: dict[bytes, Stepper] = field(default_factory=dict, init=False)
    _packed: dict[tuple[bytes, int], Array] = field(default_factory=dict, init=False)

    @cached_property
    def layout(self) -> Layout:
        """Where things are in a row."""
        o = self.observer
        return Layout(o.A.shape[0], len(o.u0), len(o.y0), len(o.x0), o.F.shape[1])

    # ------------------------------------------------------------ one sample

    def sample(self, before: Array, t: float, u: Array, y: Array) -> Array:
        """The row after the sample (t, u, y), checked already, that follows the row `before`.

        Raises InputError when it is `FARTHEST` sample times or more after it.
        """
        o, lay = self.observer, self.layout
        missing, lost = ~np.isfinite(y), ~np.isfinite(u)
        v = np.concatenate((np.where(lost, 0.0, u - o.u0), np.where(missing, 0.0, y - o.y0)))
        v[: lay.m][lost] = before[lay.v][: lay.m][lost]
        state = State(before, lay)
        if state.samples == 0:
            s = self._first(state, v, missing)
        else:
            s = self._next(before[lay.carried], state.t, state.missing, t, v, missing)
        late, skipped = False, 0
        if self.scheme == "sampled" and state.samples:
            late, skipped = bool(self._off_beat(t - state.t, t)), int(self._skipped(t - state.t))
        fault, x, corrected, ok = self._read(s[None], y[None], missing[None], np.array([lost.any() or late]))
        gap = bool(missing.any() or lost.any() or late)
        clock = [t, state.samples + 1, state.gaps + gap + skipped]
        return np.concatenate((s, clock, fault[0], x[0], corrected[0], missing, ok[0], u, y))

    # ------------------------------------------------------------ many

    def stretch(
        self,
        before: Array,
        t: Array,
        u: Array,
        y: Array,
        into: tuple[Array, Array, Array, Mask],
        progress: Callable[[int], None],
    ) -> Array:
        """The samples t (N,), u (N, m), y (N, p), N >= 1, that follow the row `before`; the last row comes back.

        into: where fault, state, corrected and ok of these samples go.  progress is told how many rows are done.
        Raises InputError as `sample` does.
        """
        o, lay = self.observer, self.layout
        start = State(before, lay)
        missing, lost = ~np.isfinite(y), ~np.isfinite(u)
        known = last_known(np.where(lost, 0.0, u - o.u0), lost, start.v[: lay.m])
        v = np.hstack([known, np.where(missing, 0.0, y - o.y0)])
        s = np.empty((len(t), lay.carried.stop))
        if start.samples == 0:
            s[0] = self._first(start, v[0], missing[0])
        else:
            s[0] = self._next(before[lay.carried], start.t, start.missing, float(t[0]), v[0], missing[0])
        self._carry(s, t, v, missing, progress)
        flawed, skipped = np.any(lost, axis=1), 0
        if self.scheme == "sampled":  # no interval is infinite here: the carrying would have stopped
            lengths = np.diff(t, prepend=start.t if start.samples else t[0] - self.sample_time)
            flawed, skipped = flawed | self._off_beat(lengths, t), int(self._skipped(lengths).sum())
        parts = self._read(s, y, missing, flawed)
        for place, part in zip(into, parts, strict=True):
            place[:] = part
        gaps = start.gaps + int(np.count_nonzero(flawed | missing.any(axis=1))) + skipped
        clock = [t[-1], start.samples + len(t), gaps]
        return np.concatenate(
            (s[-1], clock, *(part[-1] for part in parts[:3]), missing[-1], parts[3][-1], u[-1], y[-1])
        )

    def _carry(self, s: Array, t: Array, v: Array, missing: Mask, progress: Callable[[int], None]) -> None:
        """Fill s (N, nz+m+p) from its first row on; runs of alike intervals go to the mapped loop."""
        with np.errstate(over="ignore"):  # two finite times may be infinitely far apart; `_next` refuses them
            lengths = np.diff(t)
        if not lengths.size:
            return
        regular = self.is_regular(lengths, t[1:])
        alike = regular[1:] & regular[:-1] & ~np.any(missing[2:] != missing[1:-1], axis=1)
        if self.hold == "left":
            alike &= ~np.any(missing[1:-1] != missing[:-2], axis=1)
        starts = np.concatenate(([0], 1 + np.flatnonzero(~alike)))
        ends = np.append(starts[1:], len(lengths))
        reported = 0
        for a, b in zip(starts, ends, strict=True):
            if b - a <= ALONE:
                for k in range(a, b):
                    s[k + 1] = self._next(s[k], float(t[k]), missing[k], float(t[k + 1]), v[k + 1], missing[k + 1])
            else:
                stepper = self.stepper(missing[a], missing[a + 1])
                for c in range(a, b, LONG):
                    d = min(c + LONG, b)
                    s[c + 1 : d + 1] = stepper.run(s[c], t[c:d], v[c + 1 : d + 1])
                    progress(d)
            if b - reported > LONG:
                reported = b
                progress(int(b))

    # ------------------------------------------------------------ pieces

    def _first(self, state: State, v: Array, missing: Mask) -> Array:
        """[z; v] at the first sample: the observer state whose x̂ is the guess, in the sense of least squares."""
        o, m = self.observer, self.layout.m
        z: Array = state.z
        if state.guess is not None and len(z):
            deviation = state.guess - o.x0
            if self.prediction is not None and missing.any():  # the guess says what the missing sensors would read
                v = v.copy()
                expected = self.prediction.C @ deviation + self.prediction.D @ v[:m]
                v[m:][missing] = expected[missing]
            reads, read = (o.Cx, deviation - o.Dx @ v) if o.prior is None else (o.prior, deviation)
            z = np.asarray(np.linalg.lstsq(reads, read, rcond=None)[0], dtype=float)
            if o.injections and (self.prediction is not None or not missing.any()):
                z = _on_the_surface(o, z, v)
        filled = call(self.stepper(missing, missing).fill, [z, state.v, v], len(v))
        return np.concatenate((z, filled))

    def _next(self, s: Array, t0: float, gone: Mask, t: float, v: Array, missing: Mask) -> Array:
        """[z; v] at the sample (t, v), v (m+p,) with zeros where a channel is missing, from s = [z; v] at t0."""
        h = t - t0
        if h > FARTHEST * self.sample_time and (self.scheme == "sampled" or not self.is_regular(h, t)):
            raise _too_far(t, h, self.sample_time)
        if self.scheme == "sampled":
            return self._through(s, t0, gone, int(self._skipped(h)), v, missing)
        stepper = self.stepper(gone, missing)
        if self.is_regular(h, t):
            return stepper.advance(s, t0, v)
        parts = substeps(h, self.sample_time) if stepper.N.shape[1] or stepper.scheme == "rk4" else 1
        return stepper.advance_by(s, t0, h, v, [self._pack(stepper, h / parts)] * parts, self._pack_moves(stepper, h))

    def _through(self, s: Array, t0: float, gone: Mask, skipped: int, v: Array, missing: Mask) -> Array:
        """[z; v] of a sampled observer after `skipped` rows that never came and the sample v.

        Where a row is missing the observer predicts all of it, and the last input stays.
        """
        lay, nothing = self.layout, np.ones(self.layout.p, dtype=bool)
        held = np.concatenate((s[lay.v][: lay.m], np.zeros(lay.p)))
        for first in range(0, skipped, LONG):
            beats = np.arange(first, min(first + LONG, skipped), dtype=float)
            t: Array = np.asarray(t0 + self.sample_time * beats, dtype=float)
            s = self.stepper(gone, nothing).run(s, t, np.tile(held, (len(t), 1)))[-1]
            gone = nothing
        return self.stepper(gone, missing).advance(s, t0 + skipped * self.sample_time, v)

    def _skipped(self, interval: Any) -> Any:
        """How many rows of a sampled observer are missing before the one that ends this interval."""
        return np.maximum(np.rint(np.asarray(interval) / self.sample_time), 1.0) - 1.0

    def _off_beat(self, interval: Any, t: Any) -> Any:
        """Whether a sampled observer takes the end of this interval for the nearest beat of its clock."""
        return ~self.is_regular(interval - self._skipped(interval) * self.sample_time, t)

    def is_regular(self, interval: Any, t: Any) -> Any:
        """Whether an interval is the sample time, up to `REGULAR` and the rounding of the clock itself."""
        return np.abs(interval - self.sample_time) <= REGULAR * self.sample_time + 2.0 * np.spacing(np.abs(t))

    def stepper(self, before: Mask, after: Mask) -> Stepper:
        """The kernels for a pair of gap patterns, built once.

        While time passes a channel is unknown if the sample that says what it did is missing: the older one for the
        left hold, the newer one otherwise.  A filled observer whose poles RK4 cannot follow is stepped by zoh.
        """
        if self.scheme == "sampled":  # what it steps from is the older sample, in which all gaps are filled
            before = np.zeros_like(after)
        during = before if self.hold == "left" else after
        key = during.tobytes() + after.tobytes()
        if key not in self._steppers:
            filling = Filling.of(self.observer, self.prediction, during)
            arguments = (self.observer, filling, Filling.of(self.observer, self.prediction, after), after.copy())
            stepper = Stepper(*arguments, self.hold, self.scheme, self.sample_time)
            if self.scheme == "rk4" and during.any() and self.sample_time > stability_limit(stepper.A):
                stepper = Stepper(*arguments, self.hold, "zoh", self.sample_time)
            if len(self._steppers) >= PATTERNS:
                self._steppers.clear()
            self._steppers[key] = stepper
        return self._steppers[key]

    def _pack(self, stepper: Stepper, h: float) -> Array:
        """The matrices of a step of h seconds; they depend on what is filled in while time passes."""
        if stepper.scheme == "rk4":
            return stepper.pack(h)
        return self._remembered(stepper.during.from_z.tobytes(), h, stepper.pack)

    def _pack_moves(self, stepper: Stepper, h: float) -> Array:
        """What the implicit injections do over h seconds; the same whatever is missing."""
        if stepper.scheme != "implicit":
            return stepper.pack_moves(h)
        return self._remembered(b"moves", h, stepper.pack_moves)

    def _remembered(self, what: bytes, h: float, pack: Callable[[float], Array]) -> Array:
        grain = REGULAR * self.sample_time
        length = max(1, round(h / grain))
        key = what, length
        if key not in self._packed:
            packed = pack(length * grain)
            if len(self._packed) * packed.size >= REMEMBERED:
                self._packed.clear()
            self._packed[key] = packed
        return self._packed[key]

    @cached_property
    def reader(self) -> casadi.Function:
        """([z; v; y]) -> [f̂; x̂; (y - F_a f̂) / (1 + F_m f̂); C x̂ + D u]."""
        import casadi as ca

        o = self.observer
        nz, k, m = o.A.shape[0], o.B.shape[1], len(o.u0)
        row = ca.SX.sym("row", nz + k + len(o.y0))
        z, v, y = row[:nz, :], row[nz : nz + k, :], row[nz + k :, :]
        fault = _constant(o.Cf) @ z + _constant(o.Df) @ v
        deviation = _constant(o.Cx) @ z + _constant(o.Dx) @ v
        if o.readout is not None:
            fault = o.readout.symbolic(fault, ca.DM(o.x0) + deviation)
        predicted = y * math.nan
        if self.prediction is not None:
            predicted = ca.DM(o.y0) + _constant(self.prediction.C) @ deviation + _constant(self.prediction.D) @ v[:m, :]
        adds, multiplies = o.split
        corrected = y - _constant(adds) @ fault
        if o.scales:
            corrected = corrected / (1.0 + _constant(multiplies) @ fault)
        parts = [fault, ca.DM(o.x0) + deviation, corrected, predicted]
        return ca.Function("read", [row], [ca.densify(ca.vertcat(*parts))])

    @cached_property
    def _readers(self) -> casadi.Function:
        return self.reader.map(LONG)

    def _read(self, s: Array, y: Array, missing: Mask, lost: Mask) -> tuple[Array, Array, Array, Mask]:
        """fault, state, corrected and ok over rows: s (N, nz+m+p), y (N, p), missing (N, p), lost inputs (N,)."""
        o = self.observer
        n, p, q = len(o.x0), len(o.y0), o.F.shape[1]
        rows, width = len(s), q + n + 2 * p
        out = np.empty((rows, width))
        full = np.hstack([s, np.where(missing, 0.0, y)])
        if rows <= 2 * ALONE:
            for k in range(rows):
                out[k] = call(self.reader, [full[k]], width)
        else:
            for a in range(0, rows, LONG):
                block = np.zeros((LONG, full.shape[1]))
                b = min(a + LONG, rows)
                block[: b - a] = full[a:b]
                out[a:b] = call(self._readers, [block], LONG * width).reshape(LONG, width)[: b - a]
        fault, state = out[:, :q], out[:, q : q + n]
        corrected, predicted = out[:, q + n : q + n + p], out[:, q + n + p :]
        if missing.any():
            blind = (missing.astype(float) @ self._direct.T) > 0  # reads a missing channel
            fault[blind] = math.nan
            corrected[(blind.astype(float) @ (o.F != 0).T) > 0] = math.nan
            corrected[missing] = predicted[missing]
        return fault, state, corrected, ~(missing | lost[:, None])

    @cached_property
    def _direct(self) -> Mask:
        return reads_directly(self.observer)


def _on_the_surface(observer: Observer, z: Array, v: Array) -> Array:
    """z with the directions that x̂ does not show, such as those of f̂, so that the injections find as little as can be.

    They would bring it there in any case, but only at the pace of their bound.
    """
    _, sizes, directions = np.linalg.svd(observer.Cx)
    rank = int(np.count_nonzero(sizes > len(z) * np.finfo(float).eps * sizes.max(initial=0.0)))
    free = directions[rank:].T
    reads = np.vstack([one.reads for one in observer.injections])
    found = reads @ z + np.vstack([one.direct for one in observer.injections]) @ v
    return z - free @ np.linalg.lstsq(reads @ free, found, rcond=None)[0]


def _too_far(t: float, h: float, sample_time: float) -> InputError:
    return InputError(
        f"the sample at t = {t:g} s comes {h:.3g} s after the one before it",
        why=f"after {FARTHEST:.0g} sample times nothing of what was known is worth carrying on",
        evidence={"time": t, "interval": h, "longest": FARTHEST * sample_time},
        remedies=("begin anew after the gap, with `init`, or cut the log there", "check the clock"),
    )


def stability_limit(A: Array) -> float:
    """The largest stable RK4 step of z' = A z, s; inf when nothing decays."""
    from faultrecon.numerics.discretise import rk4_polynomial_limit

    return rk4_polynomial_limit(np.linalg.eigvals(A)) if A.size else math.inf


def _constant(matrix: Array) -> Any:
    import casadi as ca

    return ca.sparsify(ca.DM(matrix))
