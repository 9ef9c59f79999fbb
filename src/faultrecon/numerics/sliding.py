# SPDX-License-Identifier: BSD-3-Clause
"""What a sliding-mode observer of sensor faults does once it slides, and the gains that decide it [Alwi 2009].

The fault is one more state, f' = ξ, so that e = z - [x; f] obeys  e' = (A_a - Gl C_a) e - F_a ξ - M_a ψ + Gn ν.  In the
coordinates of `canonical` the last p errors are those of the outputs; the injection ν keeps them at zero, and what is
left is  e1' = (A11 + L A21) e1 - L2 ξ - (M_1 + L M_2) ψ,  f̂ - f = C_e e1,  with Gn = [-L; I], L = [L1 L2].  The
equations are those of the paper with its signs corrected: C_e = [0 -I] and -L2 ξ belong together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import Impossible, Inconclusive, InputError
from faultrecon.numerics.annihilator import column_rank
from faultrecon.numerics.riccati import filter_riccati, optimal_level
from faultrecon.numerics.scaling import spectral_norm, state_scaling

Array = NDArray[Any]

LITTLE_NOISE = 1e-6
"""On every state, relative to the fault's channel in balanced units: keeps undamped modes off the imaginary axis."""

MAX_CELLS = 2**14
"""Cells per stage of the integral of an impulse response: its relative width falls with the square of their number."""


@dataclass(frozen=True, slots=True)
class Canonical:
    """The augmented plant in coordinates where the outputs are the last states: y = S⁻¹ [0 I] x_a.

    State [Nᵀx; C_2 x; C_1 x; y_2] = T [x; f], N = n+q entries, outputs S y = [healthy; faulty], S F = [0; I] so that f
    keeps its units.  A_a (N, N), B_a (N, m), C_a = [0 I] (p, N), F_a = [0; I] (N, q), M_a (N, h), C_f (q, N) with
    f = C_f x_a.  S, S_inverse (p, p), T, T_inverse (N, N).  Gl and Gn in these coordinates are T⁻¹ Gl S and T⁻¹ Gn in
    the plant's.  Parts: n1 = n + q - p errors are left in sliding, A_a = [A11 A12; A21 A22] with A11 (n1, n1),
    A21 = [A211; A212] with p - q and q rows, M_a = [M_1; M_2], C_e = [0 -I] (q, n1).  A212 repeats the last q rows of
    A11, and the last q columns of A12 and A22 are zero.
    """

    S: Array
    S_inverse: Array
    T: Array
    T_inverse: Array
    A_a: Array
    B_a: Array
    C_a: Array
    F_a: Array
    M_a: Array
    C_f: Array

    @property
    def p(self) -> int:
        return self.S.shape[0]

    @property
    def q(self) -> int:
        return self.F_a.shape[1]

    @property
    def n1(self) -> int:
        return self.T.shape[0] - self.p

    @property
    def A11(self) -> Array:
        return self.A_a[: self.n1, : self.n1]

    @property
    def A12(self) -> Array:
        return self.A_a[: self.n1, self.n1 :]

    @property
    def A21(self) -> Array:
        return self.A_a[self.n1 :, : self.n1]

    @property
    def A22(self) -> Array:
        return self.A_a[self.n1 :, self.n1 :]

    @property
    def A211(self) -> Array:
        return self.A21[: self.p - self.q]

    @property
    def A212(self) -> Array:
        return self.A21[self.p - self.q :]

    @property
    def C_e(self) -> Array:
        return self.C_f[:, : self.n1]

    @property
    def M_1(self) -> Array:
        return self.M_a[: self.n1]

    @property
    def M_2(self) -> Array:
        return self.M_a[self.n1 :]


def canonical(A: ArrayLike, B: ArrayLike, C: ArrayLike, F: ArrayLike, M: ArrayLike | None = None) -> Canonical:
    """Coordinates in which the sliding motion can be read off, for  x' = A x + B u + M ψ, y = C x + F f.

    A: (n, n), B: (n, m), C: (p, n) of full row rank, F: (p, q) of full column rank, p > q >= 1, M: (n, h), none by
    default.  Sensors that F does not touch and states that C does not touch are picked, not mixed: where each fault
    sits on a sensor of its own and each sensor reads one state, S and T have one entry per row up to C_2.  Then
    T T⁻¹ = I and [C F] = S⁻¹ [0 I] T hold without rounding if the entries of C and F are powers of two (1 included);
    for another size c, 1/c is the float with c (1/c) = 1 after rounding, where there is one.  Raises InputError.
    """
    A, B, C, F = (np.asarray(X, dtype=float) for X in (A, B, C, F))
    M = np.zeros((A.shape[0], 0)) if M is None else np.asarray(M, dtype=float)
    _demand_shapes(A, B, C, F, M)
    n, (p, q) = A.shape[0], F.shape
    healthy, inverse = _complement(F), _left_inverse(F)
    S, S_inverse = np.vstack([healthy, inverse]), np.hstack([healthy.T, F])
    C_1, C_2 = healthy @ C, inverse @ C
    kernel, right = _complement(np.vstack([C_1, C_2]).T), _left_inverse(np.vstack([C_1, C_2]).T).T
    Tx = np.vstack([kernel, C_2, C_1])
    Tx_inverse = np.hstack([kernel.T, right[:, p - q :], right[:, : p - q]])
    k, N = n - p, n + q
    faulty = slice(k, k + q)  # where C_2 x stands: its rate is that of y_2 up to ξ, copied and not computed again
    T = np.block([[Tx, np.zeros((n, q))], [C_2, np.eye(q)]])
    T_inverse = np.block([[Tx_inverse, np.zeros((n, q))], [np.zeros((q, N))]])
    T_inverse[n:, faulty], T_inverse[n:, n:] = -np.eye(q), np.eye(q)
    a, b, m = (Tx @ X for X in (A @ Tx_inverse, B, M))
    A_a = np.block([[a, np.zeros((n, q))], [a[faulty], np.zeros((q, q))]])
    B_a, M_a = np.vstack([b, b[faulty]]), np.vstack([m, m[faulty]])
    C_a, F_a, C_f = np.eye(N)[N - p :], np.eye(N)[:, n:], np.eye(N)[n:] - np.eye(N)[faulty]
    return Canonical(S, S_inverse, T, T_inverse, A_a, B_a, C_a, F_a, M_a, C_f)


def sliding_motion(canonical: Canonical, L: ArrayLike) -> tuple[Array, Array, Array]:
    """(Ac, Bc, Cc) of [ξ; ψ] -> f̂ - f while the observer slides:  Ac = A11 + L A21,  Bc = [-L2, -(M_1 + L M_2)].

    L: (n1, p) = [L1 L2].  Ac: (n1, n1), Bc: (n1, q + h), ξ first, Cc: (q, n1).  There is no feedthrough; the first q
    columns of Bc are the G̃ of the paper.
    """
    L = _gain(canonical, L)
    Bc = np.hstack([-L[:, canonical.p - canonical.q :], -(canonical.M_1 + L @ canonical.M_2)])
    return canonical.A11 + L @ canonical.A21, Bc, canonical.C_e


def fault_transfer(canonical: Canonical, L: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """(A, B, C, D) of F(s) = I + s G̃(s), from the fault to its estimate while the observer slides.

    F(0) = I: a constant fault is reconstructed.  D = F(∞) is `high_frequency_gain`.
    """
    Ac, Bc, Cc = sliding_motion(canonical, L)
    return Ac, Bc[:, : canonical.q], Cc @ Ac, high_frequency_gain(canonical, L)


def high_frequency_gain(canonical: Canonical, L: ArrayLike) -> Array:
    """F(∞) = I - C_e L2 (q, q): what a sudden fault, or the noise of a faulty sensor, is multiplied with at once."""
    L = _gain(canonical, L)
    return np.eye(canonical.q) - canonical.C_e @ L[:, canonical.p - canonical.q :]


def full_order_motion(canonical: Canonical, L: ArrayLike, Gl: ArrayLike) -> tuple[Array, Array, Array]:
    """(A, B, C) of ξ -> f̂ - f from (30)-(31), all N errors kept and ν the injection that keeps e_y at zero.

    Gl: (N, p), Gn = [-L; I], both in canonical coordinates.  A = A_a - Gl C_a - Gn (C_a (A_a - Gl C_a) + k C_a),
    B = -(I - Gn C_a) F_a, C = C_f: e_y' = -k e_y is not reached by ξ, and any k > 0 gives the transfer function of
    `sliding_motion`, by another computation.
    """
    L, Gl = _gain(canonical, L), np.asarray(Gl, dtype=float)
    A, C = canonical.A_a - Gl @ canonical.C_a, canonical.C_a
    Gn = np.vstack([-L, np.eye(canonical.p)])
    rate = max(spectral_norm(canonical.A11 + L @ canonical.A21), np.finfo(float).tiny)
    return A - Gn @ (C @ A + rate * C), -(canonical.F_a - Gn @ (C @ canonical.F_a)), canonical.C_f


def reduced_riccati(canonical: Canonical, gamma: float, d1: float, ep: float) -> Array | None:
    """L (n1, p) with |ξ -> f̂ - f| < gamma in sliding, or None when no L reaches gamma with these noises.

    L2 = -Y A212ᵀ, L1 = -Y A211ᵀ/d1² with  A11 Y + Y A11ᵀ + ep² I + Y (C_eᵀC_e/γ² - A212ᵀA212 - A211ᵀA211/d1²) Y = 0.
    d1 > 0: fictitious noise of the healthy channels, ep > 0: of the states; both make the equation regular and are
    counted in gamma, so the gain from ξ alone is below it.  Raises InputError unless all three are positive.
    """
    if not gamma > 0:
        raise InputError(f"the level is {gamma:g}", why="a gain bound is positive")
    B, E = _fictitious(canonical, d1, ep)
    A, C = canonical.A11, canonical.C_e / gamma
    found = filter_riccati(A, B, canonical.A21, E, C, np.zeros((canonical.q, B.shape[1])))
    return None if found is None else -found.L


def smallest_level(canonical: Canonical, d1: float, ep: float) -> float:
    """The smallest level that `reduced_riccati` reaches, to about 1e-6 from above; the gain there is already large.

    As d1 and ep tend to zero it tends to the floor of `hidden_mode_floor`, until rounding takes over: below 1e-3 and
    1e-4 of the plant's size levels can come out too high, never too low.  The optimum of `optimal_level`, confirmed by
    the gain itself, else expanded upwards and bisected.  Raises Impossible when no output sees a mode that does not
    decay, or a constant fault looks like an equilibrium of the plant, Inconclusive when no level is reached.
    """
    B, E = _fictitious(canonical, d1, ep)
    try:
        low = _optimal(canonical.A11, B, canonical.A21, E, canonical.C_e)
    except Inconclusive:
        low = 1e-6 / max(spectral_norm(canonical.A11), np.finfo(float).tiny)
    high, excess = low, 1e-7
    while reduced_riccati(canonical, high := high * (1 + excess), d1, ep) is None:
        low, excess = high, min(8 * excess, 1.0)
        if not high < 1e12:
            raise Inconclusive("no level was reached", why=f"rounding decides for d1 = {d1:g}, ep = {ep:g}")
    while high > low * (1 + 1e-6):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if reduced_riccati(canonical, middle, d1, ep) is None else (low, middle)
    return high


def minimal_gamma0(canonical: Canonical, R: ArrayLike) -> float:
    """The infimum of the γ0 for which (46), or (63) with M, has a solution P > 0: the filter of the linear part.

    R = D1 D1ᵀ (p, p), positive definite, D1 the noise of the outputs S y; that of the plant's own outputs is S D1.
    The smallest γ0, to 1e-8 from above, with a stabilising Σ = γ0 P⁻¹ >= 0 of
    A_a Σ + Σ A_aᵀ + F_a F_aᵀ + M_a M_aᵀ + ep² I + Σ (C_fᵀC_f/γ0² - C_aᵀ R⁻¹ C_a) Σ = 0 for a very small ep.
    """
    R = np.asarray(R, dtype=float)
    if R.shape != (canonical.p, canonical.p) or not np.allclose(R, R.T, rtol=1e-12, atol=0):
        raise InputError(f"R is not a symmetric matrix of the {canonical.p} outputs", evidence={"shape": R.shape})
    try:
        D1 = np.linalg.cholesky(R)
    except np.linalg.LinAlgError as error:
        raise InputError("R is not positive definite", why="some output has no noise") from error
    A, F, C, N = canonical.A_a, canonical.F_a, canonical.C_a, canonical.T.shape[0]
    unit = np.ldexp(1.0, state_scaling(A, F, C))
    little = LITTLE_NOISE * spectral_norm(F / unit[:, None]) * unit
    B = np.hstack([F, canonical.M_a, np.diag(little), np.zeros((N, canonical.p))])
    E = np.hstack([np.zeros((canonical.p, B.shape[1] - canonical.p)), D1])
    return _optimal(A, B, C, E, canonical.C_f)


def linear_gain(canonical: Canonical, L: ArrayLike, A22s: ArrayLike) -> Array:
    """Gl (N, p) that makes the linear error system block triangular: poles of A11 + L A21 and of A22s.

    Gl = T_L⁻¹ [Ã12; Ã22 - A22s] with Ã = T_L A_a T_L⁻¹, T_L = [I L; 0 I].  A22s: (p, p), stable: how the errors of the
    outputs S y decay without the injection.  Raises InputError when it is not stable.
    """
    L, A22s = _gain(canonical, L), np.asarray(A22s, dtype=float)
    if A22s.shape != (canonical.p, canonical.p):
        raise InputError(f"A22s is {A22s.shape}", why=f"it belongs to the {canonical.p} outputs")
    slowest = float(np.max(np.linalg.eigvals(A22s).real))
    if slowest >= 0:
        raise InputError("A22s is not stable", why=f"an eigenvalue has real part {slowest:.3g}")
    lower = canonical.A22 - canonical.A21 @ L - A22s
    upper = canonical.A12 + L @ canonical.A22 - (canonical.A11 + L @ canonical.A21) @ L
    return np.vstack([upper - L @ lower, lower])


@dataclass(frozen=True, slots=True)
class InjectionBound:
    """|ν_eq| <= value * sup |ξ| (or |ψ|); of the value at most `slack` is due to the quadrature."""

    value: float
    slack: float


def peak_injection(canonical: Canonical, L: ArrayLike, *, of: str = "rate", rtol: float = 1e-3) -> InjectionBound:
    """How large ν_eq = -A21 e1 + F_2 ξ + M_2 ψ becomes per unit of sup |ξ|, or of sup |ψ|: ρ above it keeps sliding.

    of: "rate" for ξ, "disturbance" for ψ.  From e1 = 0, Euclidean norms at each instant, ν in the outputs S y per
    second: |F_2| + ∫ |A21 e^(Ac t) L2| dt, or with M_2, M_1 + L M_2.  Never below the true peak, up to rounding;
    above it where outputs peak at different times.  Raises Impossible when Ac is not stable.
    """
    Ac, Bc, _ = sliding_motion(canonical, L)
    if (growth := float(np.linalg.eigvals(Ac).real.max())) >= 0:
        raise Impossible("no bound on the injection", why=f"A11 + L A21 has an eigenvalue with real part {growth:.3g}")
    into = np.split(Bc, [canonical.q], axis=1)[of != "rate"]
    if not into.size:
        return InjectionBound(0.0, 0.0)
    direct, model = 1.0 if of == "rate" else spectral_norm(canonical.M_2), _contracting(Ac, into, canonical.A21)
    low, high = _norm_integral(*model, cells := 64, 0.1 * rtol)
    while high - low > rtol * (direct + high) and cells < MAX_CELLS:
        low, high = _norm_integral(*model, cells := 2 * cells, 0.1 * rtol)
    return InjectionBound(direct + high, high - low)


def _contracting(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """(A, B, C) in coordinates in which |e^(At) x| falls for every x: those of R with R'R = X, A'X + X A = -I."""
    from scipy.linalg import solve_continuous_lyapunov

    t = np.ldexp(1.0, state_scaling(A, B, C))
    A, B, C = A * t / t[:, None], B / t[:, None], C * t
    X = np.asarray(solve_continuous_lyapunov(A.T, -np.eye(A.shape[0])))
    try:
        R = np.linalg.cholesky(0.5 * (X + X.T)).T
    except np.linalg.LinAlgError as error:
        raise Inconclusive("no bound on the injection", why="the sliding motion decays too slowly to tell") from error
    inverse = np.linalg.inv(R)
    return R @ A @ inverse, R @ B, C @ inverse


def _norm_integral(A: Array, B: Array, C: Array, cells: int, rtol: float) -> tuple[float, float]:
    """Bounds of the integral of |C e^(At) B| over t > 0, for A + A' < 0.

    Stages of `cells` steps, the step doubled from one to the next.  In a cell the response H is its chord up to
    h²/8 |H''|, |H''| <= |C| |A² e^(At) B| at its left end, and the norm of a chord lies between that of its middle and
    the mean of its ends.
    """
    from scipy.linalg import expm

    size, decay = spectral_norm(A), -float(np.linalg.eigvalsh(0.5 * (A + A.T))[-1])
    gain, h, x = spectral_norm(C), 4.0 / (cells * size), B
    low, high, tail = 0.0, 0.0, np.inf
    for _ in range(100):  # the span doubles with each stage: 2^100 of the fastest time constants
        X = _orbit(np.asarray(expm(A * h)), x, cells)
        H = C @ X
        ends, middle = np.linalg.norm(H, 2, (1, 2)), np.linalg.norm(0.5 * (H[1:] + H[:-1]), 2, (1, 2))
        bend = h**3 / 12 * gain * float(np.linalg.norm(A @ A @ X[:-1], 2, (1, 2)).sum())
        high += h * float(ends[1:].sum() + ends[:-1].sum()) / 2 + bend
        low += h * float(middle.sum()) - bend
        x, h = X[-1], 2 * h
        tail = gain * spectral_norm(x) / decay if decay > 0 else np.inf
        if tail <= rtol * (1 + high):
            break
    return max(low, 0.0), high + tail


def _orbit(E: Array, x: Array, count: int) -> Array:
    """x, E x, ..., E^count x (count + 1, n, q), count a power of two."""
    X, P = x[None], E
    while X.shape[0] < count:
        X, P = np.concatenate([X, P @ X]), P @ P
    return np.concatenate([X, (E @ X[-1])[None]])


def _complement(F: Array) -> Array:
    """Orthonormal rows (p - q, p) with N F = 0: rows that F (p, q) does not touch are picked, and come first."""
    (p, q), touched = F.shape, np.flatnonzero(np.any(F != 0, axis=1))
    pick = np.eye(p)[np.setdiff1d(np.arange(p), touched)]
    mixed = np.zeros((touched.size - q, p))
    mixed[:, touched] = np.linalg.qr(F[touched], mode="complete")[0][:, q:].T
    return np.vstack([pick, mixed])


def _left_inverse(F: Array) -> Array:
    """F⁺ (q, p) = R⁻¹ Q1ᵀ of F = Q1 R; reciprocals where each column of F is one entry in a row of its own."""
    q, touched = F.shape[1], np.flatnonzero(np.any(F != 0, axis=1))
    inverse = np.zeros_like(F.T)
    if touched.size == q and np.count_nonzero(F) == q:
        column = np.argmax(F[touched] != 0, axis=1)
        inverse[column, touched] = [_reciprocal(float(F[i, j])) for i, j in zip(touched, column, strict=True)]
        return inverse
    Q1, R = np.linalg.qr(F[touched])
    inverse[:, touched] = np.linalg.solve(R, Q1.T)
    return inverse


def _reciprocal(c: float) -> float:
    """1/c, or a neighbouring float where that gives c (1/c) = 1 after rounding and the nearest one does not."""
    r = 1.0 / c
    return next((v for v in (r, float(np.nextafter(r, 0.0)), float(np.nextafter(r, 2 * r))) if c * v == 1.0), r)


def _gain(canonical: Canonical, L: ArrayLike) -> Array:
    L = np.asarray(L, dtype=float)
    wanted = canonical.n1, canonical.p
    if L.shape != wanted:
        raise InputError(f"L is {L.shape}", why=f"n + q - p rows and a column per output make it {wanted}")
    return L


def _fictitious(canonical: Canonical, d1: float, ep: float) -> tuple[Array, Array]:
    """The inputs [states, healthy channels, ξ] of the reduced filter problem, and how they enter A21 e1."""
    if not (d1 > 0 and ep > 0):
        raise InputError(f"the fictitious noises are {d1:g} and {ep:g}", why="both keep the equation regular: positive")
    n1, p, q = canonical.n1, canonical.p, canonical.q
    noise = np.diag(np.concatenate([np.full(p - q, d1), np.ones(q)]))
    return np.hstack([ep * np.eye(n1), np.zeros((n1, p))]), np.hstack([np.zeros((p, n1)), noise])


def _optimal(A: Array, B: Array, C: Array, E: Array, Cz: Array) -> float:
    """The infimum of |v -> Cz e| over the gains of e' = A e + B v - L (C e + E v)."""
    n, r, v = A.shape[0], Cz.shape[0], B.shape[1]
    return optimal_level(A, np.zeros((n, 0)), B, C, E, Cz, np.zeros((r, v)), np.zeros((0, n)), 0.0).gamma


def _demand_shapes(A: Array, B: Array, C: Array, F: Array, M: Array) -> None:
    """Shapes that fit together, p > q >= 1, and the two ranks everything else rests on."""
    if any(X.ndim != 2 for X in (A, B, C, F, M)):
        raise InputError("a matrix of the plant is not two-dimensional")
    n, p, q = A.shape[0], C.shape[0], F.shape[1]
    shapes = (n, n), (n, B.shape[1]), (p, n), (p, q), (n, M.shape[1])
    for name, X, shape in zip("ABCFM", (A, B, C, F, M), shapes, strict=True):
        if X.shape != shape or not np.isfinite(X).all():
            raise InputError(f"{name} is {X.shape} or not finite", why=f"{n} states and {p} outputs make it {shape}")
    if not 1 <= q < p:
        raise InputError(
            f"{q} faults on {p} outputs",
            why="the observer slides on at least one combination of outputs that no fault reaches: p > q >= 1",
            remedies=("add a healthy sensor", "reconstruct fewer faults"),
        )
    if column_rank(C.T) < p:
        raise InputError("C lacks row rank", why="one output repeats others", remedies=("average repeated sensors",))
    if column_rank(F) < q:
        raise InputError("F lacks column rank", why="two faults reach the outputs in the same way")
