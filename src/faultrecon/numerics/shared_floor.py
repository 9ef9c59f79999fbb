# SPDX-License-Identifier: BSD-3-Clause
"""The floors of many sets of faults of one plant, from one factored model and one set of frequencies.

With noise of its own on every output, Y = C (jw - A)^-1 B + E has full row rank and S = (Y Y*)^-1 exists at every
frequency.  The best estimate of faults that enter as F then has the error covariance (F' S F)^-1 [Gauss, Markov], so
one S serves every set.  S only says where to look: the value that is returned is evaluated as in
`hinf.estimator_floor`, and that nothing higher is left is settled by a Hamiltonian matrix of twice the order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.decay import resolvent_bound
from faultrecon.numerics.hinf import ON_AXIS, Peak, frequency_grid, on_axis, sensitivity, unexplained
from faultrecon.numerics.partial_fractions import PartialFractions, partial_fractions
from faultrecon.numerics.scaling import spectral_norm

Array = NDArray[Any]
Complex = NDArray[np.complexfloating[Any, Any]]

DISTINCT = 1e6
"""Condition of the noise covariance, rows at unit length, beyond which outputs count as not having noise of their own:
its inverse then keeps fewer than ten digits."""

NEAR = 0.9
"""A second local maximum of the grid this near to the first is followed too: a grid of 12 points per decade shows a
well-damped peak to a few per cent."""


RANGE = 1e7
"""Condition of Y Y* beyond which the eigenvalues of the Hamiltonian matrix are too uncertain for a certificate: their
error is about eps times this condition, and crossings are told from others at 1e-6; the rest is margin."""

SHARP = 1e4
"""The same for jw - A: beyond, resonances are so sharp that crossings are lost."""

DOUBT = 0.1
"""Part of its distance from the axis by which rounding may move an eigenvalue that is to count as off it."""

BLUNT = 1e-3
"""Relative distance from a peak within which its own flat top may pass for a crossing."""

FEW = 3
"""Single faults up to which partial fractions, which take all eigenvectors, are not worth it."""

CLEAR = 1e-9
"""Relative error of partial fractions up to which they serve: a quarter of the margin that a certificate leaves."""

APART = 0.02
"""Grid points nearer than this, relatively, are one: a sharper peak is left to the certificate to find."""


@dataclass(frozen=True, eq=False)
class NoisyOutputs:
    """x' = A x + B w, y = C x + E w with E E' well conditioned, in balanced units, outputs in sizes of their noise.

    T (n, n) complex triangular, A = Q T Q*; QB = Q* B, CQ = C Q.  w (k,) is a grid, S (k, p, p) = (Y Y*)^-1 on it.
    S = through - out (jw - H)^-1 into.  size: unit of each output.  rounding: eps times a bound of the condition of
    jw - A for every w, inf where none is known.
    """

    A: Array
    B: Array
    C: Array
    E: Array
    size: Array
    T: Complex
    QB: Complex
    CQ: Complex
    rounding: float
    H: Array
    into: Array
    out: Array
    through: Array
    w: Array
    S: Complex

    @classmethod
    def of(cls, A: Array, B: Array, C: Array, E: Array) -> NoisyOutputs | None:
        """From A (n, n), B (n, m), C (p, n), E (p, m) balanced.

        None unless each output has noise of its own, well above rounding.
        """
        from scipy.linalg import schur

        size = np.linalg.norm(E, axis=1)
        if A.shape[0] == 0 or E.shape[0] == 0 or E.shape[1] < E.shape[0] or not size.all():
            return None
        E = E / size[:, None]
        if np.linalg.cond(E) ** 2 > DISTINCT:
            return None
        C = C / size[:, None]
        T, Q = (np.asarray(M) for M in schur(A, output="complex"))
        # Beyond |w| = 2 |A| the condition of jw - A is at most 3; below, |jw - A| is at most 3 |A|.
        bound = spectral_norm(A)
        condition = max(3.0, 3.0 * bound * resolvent_bound(A))
        if condition > SHARP:
            return None
        rounding = np.finfo(float).eps * condition
        none = np.zeros((0, 0, 0), dtype=np.complex128)
        bare = cls(A, B, C, E, size, T, Q.conj().T @ B, C @ Q, rounding, *_spectrum(A, B, C, E), np.zeros(0), none)
        w = frequency_grid(np.diag(T), 12)
        inner = w[(w > 1e-12 * bound) & np.isfinite(w)]
        apart = np.diff(np.log(inner), prepend=-np.inf) > APART
        # At the resonances themselves, however sharp, the response must be within range.
        resonances = np.imag(np.diag(T))
        w = np.unique(np.concatenate([[0.0], inner[apart], resonances[resonances > 0], [np.inf]]))
        Y = bare.response(w)
        S = _inverse(Y)
        size2 = np.linalg.norm(Y, axis=(1, 2)) ** 2  # |Y Y*| at most
        if not np.isfinite(Y).all() or np.max(size2 * np.linalg.norm(S, axis=(1, 2))) > RANGE:
            return None
        return replace(bare, w=w, S=S)

    def response(self, w: Array) -> Complex:
        """Y at every frequency (k, p, m), by back substitution for all of them at once; w = inf gives E."""
        # Most noise reaches no state: those columns of Y are E alone.
        moves = np.flatnonzero(self.B.any(axis=0))
        n, k, m, QB = self.T.shape[0], w.size, moves.size, self.QB[:, moves]
        finite = np.isfinite(w)
        s = 1j * np.where(finite, w, 0.0)
        X = np.empty((n, k * m), dtype=np.complex128)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for i in reversed(range(n)):
                row = (self.T[i, i + 1 :] @ X[i + 1 :]).reshape(k, m) + QB[i]
                X[i] = (row / (s - self.T[i, i])[:, None]).ravel()
            moved = (self.CQ @ X).reshape(len(self.CQ), k, m).transpose(1, 0, 2)
        Y = np.broadcast_to(self.E.astype(np.complex128), (k, *self.E.shape)).copy()
        Y[:, :, moves] += np.where(finite[:, None, None], moved, 0.0)
        return Y

    def floors(self, sets: Sequence[tuple[Array, Array]]) -> list[Peak | None]:
        """The floor of each set (N, K): N (p1, p) gives healthy outputs, K (q, p) reads the faults from the others.

        As `hinf.estimator_floor` with C1 = N C, E1 = N E, C2 = K C, E2 = K E.  None where that has to be asked:
        rounding decides there.
        """
        ours = [(N * self.size, K * self.size) for N, K in sets]
        directions = [_directions(N, K) for N, K in ours]
        found = self._single(ours, directions)
        rest = [j for j in range(len(sets)) if j not in found]
        starts = self._starts([directions[j] for j in rest])
        Y = self.response(starts)
        for k, j in enumerate(rest):
            N, K = ours[j]
            found[j] = self._climb(N, K, directions[j], self._evaluated(N, K, starts[k : k + 1], Y[k : k + 1]))
        return [found[j] for j in range(len(sets))]

    def _single(
        self, sets: Sequence[tuple[Array, Array]], directions: Sequence[Array], rtol: float = 1e-9
    ) -> dict[int, Peak | None]:
        """The floors of those sets of one fault each for which partial fractions of F' S F settle it, by position."""
        one = [j for j, F in enumerate(directions) if F.shape[1] == 1]
        if len(one) <= FEW or self.fractions is None:
            return {}
        (poles, into, out), F = self.fractions, np.hstack([directions[j] for j in one])
        information = PartialFractions(poles, (into @ F) * (F.T @ out).T, np.sum(F * (self.through @ F), axis=0))
        known = np.sum((self.S @ F).real * F, axis=1)
        found = information.values(self.w)
        doubt = 8.0 * np.max(np.abs(found - known) / known, axis=0)
        at = information.lowest(self.w, found)
        Y = self.response(at)
        N, K = (np.array([sets[j][k] for j in one]) for k in (0, 1))
        value = unexplained(N @ Y, K @ Y, np.full(at.size, self.rounding))
        clear = (value > 0) & (doubt <= CLEAR)
        level = 1.0 / (np.where(clear, value, 1.0) * (1 + 2 * rtol)) ** 2
        clear &= information.never_below(level, at, np.where(clear, doubt, 0.0))
        return {j: Peak(float(value[k]), float(at[k])) for k, j in enumerate(one) if clear[k]}

    @cached_property
    def fractions(self) -> tuple[Complex, Complex, Complex] | None:
        """S in partial fractions; None where H has no basis of eigenvectors."""
        return partial_fractions(self.H, self.into, self.out, self.through)

    def _starts(self, directions: Sequence[Array]) -> Array:
        """A frequency for each set at which its gain is as good as maximal, all refined together."""
        best: list[tuple[float, float]] = []
        trips: list[tuple[int, float, float]] = []  # set, log w, spacing of the grid there
        for j, F in enumerate(directions):
            values = _covariance(self.S, F)
            k = int(np.argmax(values))
            best.append((float(values[k]), float(self.w[k])))
            trips += [(j, x, d) for x, d in _peaks(self.w, values)]
        owner = np.array([t[0] for t in trips], dtype=np.intp)
        x, d = np.array([t[1] for t in trips]), np.array([t[2] for t in trips])
        for shrink in (8.0, 64.0):  # a parabola leaves the square of the step, the value the square of that: 2e-4, 1e-9
            if not trips:
                break
            step = d / shrink
            points = np.exp(np.concatenate([x - step, x, x + step]))
            S = _inverse(self.response(points))
            values = np.empty(points.size)
            for j, F in enumerate(directions):
                mine = np.flatnonzero(np.tile(owner == j, 3))
                values[mine] = _covariance(S[mine], F)
                for i in mine:
                    best[j] = max(best[j], (float(values[i]), float(points[i])))
            x = x + step * _vertex(*values.reshape(3, -1))
        return np.array([w for _, w in best])

    def _evaluated(self, N: Array, K: Array, w: Array, Y: Complex) -> Peak | None:
        """The highest gain among these frequencies; None when rounding may reach its sixth digit."""
        loose = np.full(w.size, self.rounding)
        values = unexplained(N @ Y, K @ Y, loose)
        if not values.any():
            values = unexplained(N @ Y, K @ Y, sensitivity(self.A, w))
        k = int(np.argmax(values))
        return Peak(float(values[k]), float(w[k])) if values[k] > 0 else None

    def _climb(self, N: Array, K: Array, F: Array, best: Peak | None, rtol: float = 1e-9) -> Peak | None:
        """Look between the crossings of a higher level until there are none (Bruinsma and Steinbuch 1990)."""
        for _ in range(30):
            if best is None:
                return None
            crossed = self._crossings(F, best.value * (1 + 2 * rtol))
            if crossed is None:
                return None
            if crossed.size == 0:
                return best
            trial = np.unique(np.concatenate([crossed, 0.5 * (crossed[1:] + crossed[:-1])]))
            found = self._evaluated(N, K, trial, self.response(trial))
            if found is None or not found.value > best.value * (1 + rtol):
                # Rounding may take the flat top itself for a crossing; one elsewhere that leads nowhere is a doubt.
                return best if np.all(np.abs(crossed - best.frequency) <= BLUNT * best.frequency) else None
            best = found
        return best

    def _crossings(self, F: Array, level: float) -> Array | None:
        """Frequencies at which F' S F has the eigenvalue 1/level^2: S has one state matrix for all sets of faults."""
        into, out = self.into @ F, F.T @ self.out
        D = F.T @ self.through @ F - np.eye(F.shape[1]) / level**2
        try:
            back = np.linalg.inv(D)
        except np.linalg.LinAlgError:
            return None
        if np.linalg.norm(back) * np.linalg.norm(D + np.eye(F.shape[1]) / level**2) > DISTINCT:
            return None  # the level is that of infinite frequency
        s = np.linalg.eigvals(self.H + into @ back @ out)
        # The spectrum is symmetric about the axis: how far s and its mirror image are apart is what rounding did.
        off = np.abs(s.real) > ON_AXIS * np.abs(s)
        apart = np.min(np.abs(s[:, None] + s.conj()[None, :]) + np.diag(np.full(s.size, np.inf)), axis=1)
        return None if np.any(off & (apart > DOUBT * np.abs(s.real))) else on_axis(s)


def _spectrum(A: Array, B: Array, C: Array, E: Array) -> tuple[Array, Array, Array, Array]:
    """H, b, c, d with (Y Y*)^-1 = d - c (s - H)^-1 b on the imaginary axis, H of order 2n and balanced."""
    from scipy.linalg import matrix_balance

    d = np.linalg.inv(E @ E.T)
    b, c = np.vstack([B @ E.T, -C.T]) @ d, np.hstack([C, E @ B.T])
    H = np.block([[A, B @ B.T], [np.zeros_like(A), -A.T]]) - b @ c
    H, (unit, _) = matrix_balance(H, permute=False, separate=True)
    return H, b / unit[:, None], d @ c * unit, d


def _inverse(Y: Complex) -> Complex:
    """(Y Y*)^-1 at every frequency, zero where Y is not finite: such a frequency then attracts nobody."""
    usable = np.asarray(np.isfinite(Y).all(axis=(1, 2)))
    Y = np.where(usable[:, None, None], Y, 0.0)
    gram = Y @ Y.conj().transpose(0, 2, 1)
    gram[~usable] = np.eye(Y.shape[1])
    try:
        return np.linalg.inv(gram)
    except np.linalg.LinAlgError:
        return np.broadcast_to(np.eye(Y.shape[1], dtype=np.complex128), gram.shape)


def _directions(N: Array, K: Array) -> Array:
    """F (p, q) with N F = 0 and K F = I: how faults of size one enter the outputs."""
    null = np.linalg.svd(N)[2][N.shape[0] :].T if N.shape[0] else np.eye(K.shape[1])
    return null @ np.linalg.pinv(K @ null)


def _covariance(S: Complex, F: Array) -> Array:
    """Largest gain to the error of the best estimate: |(F' S F)^-1|^(1/2)."""
    information = F.T @ S @ F
    smallest = information[:, 0, 0].real if F.shape[1] == 1 else np.linalg.eigvalsh(information)[:, 0]
    return 1.0 / np.sqrt(np.maximum(smallest, 1e-300))


def _peaks(w: Array, values: Array) -> list[tuple[float, float]]:
    """log w where the parabola through a local maximum peaks, and the spacing there.

    For the highest inner local maximum of a grid, and for the next if it is nearly as high.
    """
    inner = np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:])) + 1
    inner = inner[(w[inner - 1] > 0) & np.isfinite(w[inner + 1])]
    inner = inner[np.argsort(-values[inner])][:2]
    inner = inner[values[inner] >= NEAR * values.max()]
    found = []
    for k in inner:
        (a, b, c), (u, v, t) = np.log(w[k - 1 : k + 2]), values[k - 1 : k + 2]
        bend = (b - a) * (v - t) - (b - c) * (v - u)
        shift = 0.5 * ((b - a) ** 2 * (v - t) - (b - c) ** 2 * (v - u)) / bend if bend > 0 else 0.0
        found.append((float(np.clip(b - shift, a, c)), float(max(c - b, b - a))))
    return found


def _vertex(low: Array, middle: Array, high: Array) -> Array:
    """Where the parabola through three values at -1, 0 and 1 peaks, kept within two steps; towards the higher side
    where it does not."""
    bend = 2 * middle - low - high
    with np.errstate(divide="ignore", invalid="ignore"):
        at = 0.5 * (high - low) / bend
    uphill = np.sign(high - low)
    return np.where((bend > 0) & np.isfinite(at), np.clip(at, -2.0, 2.0), 2.0 * uphill)
