# SPDX-License-Identifier: BSD-3-Clause
"""From one sample to the next: how the observer's equations are integrated.

Schemes, each for three ways to read the input between samples:

    zoh   e^(Ah) and its integrals carry the linear part exactly; nonlinear terms by the second-order exponential
          Runge-Kutta scheme ETD2RK [Cox & Matthews 2002, J. Comput. Phys. 176, (20)-(22)]: stable for any pole
    rk4   the classical Runge-Kutta scheme, of order four while the input is smooth inside the interval

and two for observers with injections:

    implicit  zoh for all but the injections, linear ones included, which then act at the new sample: see `injecting`
    explicit  zoh with each ν held at its value at the beginning of the interval; it chatters, and is for comparison

and one for sampled observers, whose equations are a map from one sample to the next already:

    sampled   that map, applied to the sample that is left behind; nothing is integrated

The same compiled kernel steps one sample and, through CasADi's `mapaccum`, a whole log: the same instructions in the
same order, so the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.graph.observer import Observer
from faultrecon.runtime.filling import Filling
from faultrecon.runtime.injecting import Move, drift, explicit, move, rounds, rounds_for_any, settled, times

if TYPE_CHECKING:
    import casadi

Hold = Literal["left", "midpoint", "linear"]
Scheme = Literal["auto", "zoh", "rk4", "implicit", "explicit", "sampled"]
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LONG, SHORT = 1024, 32  # rows per mapped call; 10 ms and 0.3 ms to build, and padded rows cost about 1 us each


@dataclass(frozen=True, eq=False)
class Stepper:
    """Carries (z, v) over one sampling interval; a pure function once built.

    The vector s = [z; v] holds the observer's states and the last input [u - u0; y - y0], (nz + m + p,).
    during: what is filled in while time passes; after: what is filled in at the new sample; gone: (p,), the channels
    the new sample lacks.  scheme is any but "auto".
    """

    observer: Observer
    during: Filling
    after: Filling
    gone: Mask
    hold: Hold
    scheme: Scheme
    sample_time: float

    # ------------------------------------------------------------ the equations with the gaps filled

    @cached_property
    def _linear(self) -> tuple[Array, Array]:
        return drift(self.observer) if self.scheme == "implicit" else (self.observer.A, self.observer.B)

    @cached_property
    def A(self) -> Array:
        """The linear part while time passes, (nz, nz)."""
        A, B = self._linear
        return A + B @ self.during.from_z

    @cached_property
    def B(self) -> Array:
        """What the input v drives while time passes, (nz, m+p)."""
        return self._linear[1] @ self.during.from_v

    @cached_property
    def N(self) -> Array:
        """What the nonlinear terms drive, (nz, r): the columns of N and M together; of G_n too where ν is explicit."""
        o = self.observer
        terms = [term.into for term in (o.nonlinear, o.copied) if term is not None]
        terms += [one.into for one in o.injections] if self.scheme == "explicit" else []
        return np.hstack([np.zeros((o.A.shape[0], 0)), *terms])

    @cached_property
    def frozen(self) -> int:
        """How many of the columns of N keep their value for a whole interval; they are the last ones."""
        return sum(one.into.shape[1] for one in self.observer.injections) if self.scheme == "explicit" else 0

    @cached_property
    def moves(self) -> list[tuple[Move, int]]:
        """What each injection does over one sample time, and in how many rounds; empty unless it is implicit."""
        if self.scheme != "implicit":
            return []
        found = [move(one, self.sample_time) for one in self.observer.injections]
        return [(one, rounds(one.knees)) for one in found]

    def matrices(self, h: float) -> tuple[Array, ...]:
        """(Ad, B0, B1, N0, N1) for one step of h seconds: z <- Ad z + B0 v0 + B1 v1 + N0 n0 + N1 n1.

        Where the input is constant inside the interval, B1 is zero and B0 carries it alone.
        """
        from faultrecon.numerics.discretise import foh, zoh

        (nz, k), r = self.B.shape, self.N.shape[1]
        if nz == 0:
            return np.zeros((0, 0)), np.zeros((0, k)), np.zeros((0, k)), np.zeros((0, r)), np.zeros((0, r))
        if self.hold == "linear":
            Ad, start, end = foh(self.A, np.hstack([self.B, self.N]), h)
            return Ad, start[:, :k], end[:, :k], start[:, k:], end[:, k:]
        Ad, B0 = zoh(self.A, self.B, h)
        _, N0, N1 = foh(self.A, self.N, h) if r else (Ad, self.N, self.N)
        return Ad, B0, np.zeros_like(B0), N0, N1

    # ------------------------------------------------------------ kernels

    @cached_property
    def regular(self) -> casadi.Function:
        """([z; v0], [t0; v1]) -> [z; v1 filled], over exactly one sample time."""
        import casadi as ca

        nz, k = self.B.shape
        s, sample = ca.SX.sym("s", nz + k), ca.SX.sym("sample", 1 + k)
        v1 = self._keep_last(s[nz:, :], sample[1:, :])
        step = self.matrices(self.sample_time) if self.scheme not in ("rk4", "sampled") else ()
        z = self._substep(s[:nz, :], sample[0], *self._held(s[nz:, :], v1), self.sample_time, step)
        z = self._settled(z, v1, self.moves)
        return ca.Function("regular", [s, sample], [ca.densify(ca.vertcat(z, self._fill(self.after, z, v1)))])

    @cached_property
    def long(self) -> casadi.Function:
        """The regular kernel over `LONG` samples in a row."""
        return self.regular.mapaccum(LONG)

    @cached_property
    def short(self) -> casadi.Function:
        """The regular kernel over `SHORT` samples in a row."""
        return self.regular.mapaccum(SHORT)

    @cached_property
    def irregular(self) -> casadi.Function:
        """(z, [t0; h], va, vb, matrices) -> z, over h seconds in which the input runs from va to vb.

        Implicit injections are left out.
        """
        import casadi as ca

        nz, k = self.B.shape
        r = self.N.shape[1]
        z, time = ca.SX.sym("z", nz), ca.SX.sym("time", 2)
        va, vb = ca.SX.sym("va", k), ca.SX.sym("vb", k)
        shapes = [(nz, nz), (nz, k), (nz, k), (nz, r), (nz, r)] if self.scheme != "rk4" else []
        parts = [ca.SX.sym(f"m{i}", rows, columns) for i, (rows, columns) in enumerate(shapes)]
        packed = ca.vertcat(*(ca.vec(part) for part in parts)) if parts else ca.SX(0, 1)
        stages = (va, 0.5 * (va + vb), vb) if self.hold == "linear" else (va, va, va)
        out = self._substep(z, time[0], *stages, time[1], parts)
        return ca.Function("irregular", [z, time, va, vb, packed], [ca.densify(out)])

    @cached_property
    def fill(self) -> casadi.Function:
        """(z, v0, v1) -> v1 with what is missing filled in."""
        import casadi as ca

        nz, k = self.B.shape
        z, v0, v1 = ca.SX.sym("z", nz), ca.SX.sym("v0", k), ca.SX.sym("v1", k)
        return ca.Function("fill", [z, v0, v1], [ca.densify(self._fill(self.after, z, self._keep_last(v0, v1)))])

    @cached_property
    def settle(self) -> casadi.Function:
        """(z, v0, v1, moves) -> [z; v1 filled]: the implicit injections at the new sample, for any interval."""
        import casadi as ca

        nz, k = self.B.shape
        z, v0, v1 = ca.SX.sym("z", nz), ca.SX.sym("v0", k), ca.SX.sym("v1", k)
        moves = []
        for one in self.observer.injections if self.moves else ():
            parts = [ca.SX.sym(f"m{len(moves)}", *shape) for shape in Move.shapes(one)]
            moves.append((Move(*parts), rounds_for_any(one, self.sample_time)))
        packed = ca.vertcat(*(ca.vec(part) for one, _ in moves for part in one)) if moves else ca.SX(0, 1)
        last = self._keep_last(v0, v1)
        z1 = self._settled(z, last, moves)
        out = ca.vertcat(z1, self._fill(self.after, z1, last))
        return ca.Function("settle", [z, v0, v1, packed], [ca.densify(out)])

    # ------------------------------------------------------------ running them

    def advance(self, s: Array, t: float, v1: Array) -> Array:
        """One regular interval from time t to the sample v1 (m+p,), missing entries zero."""
        return call(self.regular, [s, np.concatenate(([t], v1))], len(s))

    def advance_by(self, s: Array, t: float, h: float, v1: Array, packed: Sequence[Array], moves: Array) -> Array:
        """One interval of h seconds, in as many equal parts as `packed` has entries (the matrices of each part).

        moves: what implicit injections do at its end, see `pack_moves`; they act once, since y is known once.
        """
        nz, parts = self.A.shape[0], len(packed)
        z, v0 = s[:nz], s[nz:]
        end = v1.copy()
        m = self.observer.inputs
        end[m:][self.gone] = v0[m:][self.gone]
        middle = 0.5 * v0 + 0.5 * end
        with np.errstate(over="ignore", invalid="ignore"):  # of values near the largest number there is
            for i, matrices in enumerate(packed):
                if self.hold == "linear":
                    va, vb = v0 + (end - v0) * (i / parts), v0 + (end - v0) * ((i + 1) / parts)
                else:
                    va = vb = v0 if self.hold == "left" else middle
                z = call(self.irregular, [z, np.array([t + h * i / parts, h / parts]), va, vb, matrices], nz)
        return call(self.settle, [z, v0, v1, moves], len(s))

    def pack(self, h: float) -> Array:
        """The matrices of a step of h seconds as the irregular kernel takes them, column by column."""
        if self.scheme == "rk4":
            return np.zeros(0)
        return np.concatenate([part.ravel(order="F") for part in self.matrices(h)])

    def pack_moves(self, h: float) -> Array:
        """What the implicit injections do over h seconds, as the settling kernel takes it."""
        if self.scheme != "implicit":
            return np.zeros(0)
        found = [part.ravel(order="F") for one in self.observer.injections for part in move(one, h)]
        return np.concatenate(found)

    def run(self, s: Array, t: Array, v: Array) -> Array:
        """Regular intervals in a row: t (N,) their beginnings, v (N, m+p) the samples at their ends; s after each.

        At most `LONG` rows; short runs are padded with copies of their last row, whose results are dropped.
        """
        rows, width = len(t), len(s)
        size = LONG if rows > 4 * SHORT else SHORT
        out = np.empty((rows, width))
        for a in range(0, rows, size):
            n = min(size, rows - a)
            samples = np.empty((size, 1 + v.shape[1]))
            samples[:n, 0], samples[:n, 1:] = t[a : a + n], v[a : a + n]
            samples[n:] = samples[n - 1]
            out[a : a + n] = call(self.long if size == LONG else self.short, [s, samples], size * width).reshape(
                size, width
            )[:n]
            s = out[a + n - 1]
        return out

    # ------------------------------------------------------------ pieces

    def _keep_last(self, v0: Any, v1: Any) -> Any:
        """v1, with the last value where the channel is missing."""
        import casadi as ca

        m = self.observer.inputs
        entries = [v0[i] if i >= m and self.gone[i - m] else v1[i] for i in range(v1.numel())]
        return ca.vertcat(*entries)

    def _held(self, v0: Any, v1: Any) -> tuple[Any, Any, Any]:
        """The input at the beginning, the middle and the end of the interval."""
        if self.hold == "left":
            return v0, v0, v0
        middle = 0.5 * (v0 + v1)
        return (middle, middle, middle) if self.hold == "midpoint" else (v0, middle, v1)

    def nonlinear(self, z: Any, v: Any, t: Any) -> Any:
        """φ, g and explicit ν at one instant, (r, 1); the arguments of φ and g are absolute values."""
        import casadi as ca

        o, m = self.observer, self.observer.inputs
        filled = self._fill(self.during, z, v)
        u, y = filled[:m, :] + ca.DM(o.u0), filled[m:, :] + ca.DM(o.y0)
        out = []
        if o.nonlinear is not None:
            term = o.nonlinear
            argument = times(term.reads, z) + ca.DM(term.offset)
            if term.direct is not None:
                argument = argument + times(term.direct, filled)
            out.append(term.phi.symbolic(ca.fmin(ca.fmax(argument, ca.DM(term.lower)), ca.DM(term.upper)), u, t))
        if o.copied is not None:
            out.append(o.copied.g.symbolic(y, u, t))
        if self.scheme == "explicit":
            out += [explicit(one, times(one.reads, z) + times(one.direct, filled)) for one in o.injections]
        return ca.vertcat(*out)

    def _fill(self, filling: Filling, z: Any, v: Any) -> Any:
        """v with its gaps filled in; a sensor whose gain is at fault is predicted with the gain that is estimated."""
        o, m = self.observer, self.observer.inputs
        filled = times(filling.from_z, z) + times(filling.from_v, v)
        if not (o.scales and filling.predicted) or o.readout is not None:
            return filled
        gain = times(o.split[1], times(o.Cf, z) + times(o.Df, filled))
        for row in filling.predicted:
            filled[row] = filled[row] + gain[row - m] * (filled[row] + o.y0[row - m])
        return filled

    def _settled(self, z: Any, v1: Any, moves: Sequence[tuple[Move, int]]) -> Any:
        """z after the implicit injections.

        A missing channel reads what the observer predicts before they act, so its innovation is zero.
        """
        return settled(self.observer.injections, moves, z, self._fill(self.after, z, v1)) if moves else z

    def _slope(self, z: Any, v: Any, t: Any) -> Any:
        """The right-hand side: ż, or z at the next sample."""
        linear = times(self.A, z) + times(self.B, v)
        return linear + times(self.N, self.nonlinear(z, v, t)) if self.N.shape[1] else linear

    def _substep(self, z: Any, t: Any, v0: Any, vm: Any, v1: Any, h: Any, matrices: Sequence[Any]) -> Any:
        if self.scheme == "sampled":
            return self._slope(z, v0, t)
        if self.scheme == "rk4":
            k1 = self._slope(z, v0, t)
            k2 = self._slope(z + 0.5 * h * k1, vm, t + 0.5 * h)
            k3 = self._slope(z + 0.5 * h * k2, vm, t + 0.5 * h)
            k4 = self._slope(z + h * k3, v1, t + h)
            return z + (h / 6.0) * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        Ad, B0, B1, N0, N1 = matrices
        linear = times(Ad, z) + times(B0, v0)
        if self.hold == "linear":
            linear = linear + times(B1, v1)
        if not self.N.shape[1]:
            return linear
        n0 = self.nonlinear(z, v0, t)
        held = linear + times(N0, n0)  # with n0 at both ends this is the exponential Euler step (ETD1)
        n1 = self.nonlinear(held + times(N1, n0), v1, t + h)
        return held + times(N1, _with_the_end_of(n1, n0, self.frozen))


def substeps(interval: float, sample_time: float) -> int:
    """How many equal parts an interval takes so that none is longer than a sample time."""
    return max(1, math.ceil(interval / sample_time * (1 - 1e-6)))


def call(function: Any, arguments: Sequence[Array], size: int) -> Array:
    """One call of a CasADi function through its buffers, eight times faster than through its matrices: (size,) back."""
    kept = [np.ascontiguousarray(a, dtype=float) for a in arguments]
    out = np.empty(size)
    buffer, evaluate = function.buffer()
    for i, array in enumerate(kept):
        if array.size:
            buffer.set_arg(i, array.data)
    if size:
        buffer.set_res(0, out.data)
    evaluate()
    return out


def _with_the_end_of(new: Any, old: Any, count: int) -> Any:
    """`new` with its last `count` entries from `old`."""
    import casadi as ca

    own = new.numel() - count
    return ca.vertcat(new[:own, :], old[own:, :]) if count else new
