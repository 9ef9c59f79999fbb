# SPDX-License-Identifier: BSD-3-Clause
"""Half planes that contain every feasible (beta, g) of the Lipschitz filter problem, read off a failed attempt.

With L eliminated (E1 of full row rank) a point (beta, g = gamma^2) is feasible when the largest solution P of one
Riccati equation exists and is positive.  Where it is not, the failure itself cuts the plane:

- a Hamiltonian eigenvalue on the axis: at that frequency some (dphi, w) invisible to the healthy outputs breaks the
  inequality, and the form is linear in (beta, g);
- P not positive: v'P v is concave in (beta, g), its gradient costs one Lyapunov equation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.hamiltonian import StableSubspace, signs, stable_subspace
from faultrecon.numerics.hinf import frequency_response

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class FilterProblem:
    """The problem on the disturbances that healthy outputs do not show, in balanced units.

    w = -K C1 x + (free) nu; A0, B0, H0, H20 act on (x, nu), |w|^2 = |Cn x|^2 + |nu|^2, G contains alpha.
    """

    A0: Array
    Bf: Array
    B0: Array
    Cn: Array
    H0: Array
    H20: Array
    G: Array
    least: float


@dataclass(frozen=True, slots=True)
class Cut:
    """a beta + b g >= c holds for every feasible (beta, g); `frequency`: demanded at one frequency, else by P >= 0."""

    a: float
    b: float
    c: float
    frequency: bool

    def level(self, beta: float) -> float:
        """The smallest g this cut allows at beta."""
        missing = self.c - self.a * beta
        if self.b > 1e-13 * max(abs(self.a) * beta, abs(self.c)):
            return missing / self.b
        return np.inf if missing > 1e-9 * abs(self.c) else 0.0

    def slope(self) -> float:
        """d g / d beta along the cut."""
        return -self.a / max(self.b, 1e-300)


def frequency_forms(problem: FilterProblem, w: Array) -> tuple[Array, Array, Array]:
    """Mb, Mg, M0 (k, m + r, m + r): at frequency w every (dphi, nu) demands beta Mb + g Mg - M0 >= 0.

    That is beta (|dphi|^2 - |alpha G x|^2) + g |w|^2 >= |H x + H2 w|^2 on the response x to (dphi, nu).
    """
    m, r = problem.Bf.shape[1], problem.B0.shape[1]
    c, q = problem.Cn.shape[0], problem.H0.shape[0]
    out = np.vstack([problem.Cn, problem.H0, problem.G])
    D = np.zeros((out.shape[0], m + r))
    D[c : c + q, m:] = problem.H20
    Y = frequency_response(problem.A0, np.hstack([problem.Bf, problem.B0]), out, D, w)
    Y = Y[np.all(np.isfinite(Y), axis=(1, 2))]
    Yc, Yh, Yg = Y[:, :c], Y[:, c : c + q], Y[:, c + q :]
    is_phi = np.diag([1.0] * m + [0.0] * r)
    return is_phi - _gram(Yg), np.eye(m + r) - is_phi + _gram(Yc), _gram(Yh)


def frequency_cuts(forms: tuple[Array, Array, Array], m: int, beta: float, g: float) -> list[Cut]:
    """The strongest half plane at beta among those the frequencies demand, above the level g.

    Newton's method on the smallest eigenvalue of each form, kept up only for frequencies that still object.
    """
    strongest: Cut | None = None
    size = forms[0].shape[-1]
    for _ in range(30):
        if size == 0 or forms[0].shape[0] == 0 or not np.isfinite(g):
            break
        Mb, Mg, M0 = forms
        d = 1 / np.sqrt(np.where(np.arange(size) < m, beta, g))
        value, z = np.linalg.eigh((beta * Mb + g * Mg - M0) * np.outer(d, d))
        objects = value[:, 0] < 0
        if not objects.any():
            break
        forms = Mb[objects], Mg[objects], M0[objects]
        z = z[objects, :, 0] * d
        b, h, c = (np.einsum("ki,kij,kj->k", z.conj(), M, z).real for M in forms)
        missing = c - beta * b
        level = missing / np.maximum(np.maximum(h, 1e-30 * np.abs(missing)), np.finfo(float).tiny)
        k = int(np.argmax(level))
        if not level[k] > g * (1 + 1e-13):
            break
        strongest, g = Cut(float(b[k]), float(h[k]), float(c[k]), frequency=True), float(level[k])
        if g > 1e25:  # hardly any disturbance is needed: this beta is out of reach at every level
            break
    return [] if strongest is None else [strongest]


def attempt(problem: FilterProblem, beta: float, g: float) -> tuple[bool, list[Cut]]:
    """Whether (beta, g) is feasible, and half planes that contain every feasible point."""
    p = problem
    S0 = np.linalg.inv(g * np.eye(p.H20.shape[1]) - p.H20.T @ p.H20)
    h = p.H20.T @ p.H0
    At = p.A0 + p.B0 @ S0 @ h
    S = p.Bf @ p.Bf.T / beta + p.B0 @ S0 @ p.B0.T
    Q = beta * p.G.T @ p.G + p.H0.T @ p.H0 + h.T @ S0 @ h - g * p.Cn.T @ p.Cn
    found = stable_subspace(At.T, 0.5 * (Q + Q.T), 0.5 * (S + S.T))
    if not isinstance(found, StableSubspace):
        return False, frequency_cuts(frequency_forms(p, _between(found)), p.Bf.shape[1], beta, g)
    sine, Z = signs(found)
    negative = int(np.count_nonzero(sine < -found.slack))
    if negative:
        order = np.arange(min(3, negative))
    else:
        # sine / |U2 z|^2 is an eigenvalue of P: the smallest says how far down g may go.  Where |U2 z| is small X is
        # near zero, P far from it, and the quotient is rounding.
        share = np.sum((found.U2 @ Z) ** 2, axis=0)
        order = np.argsort(np.where(share > 1e-6, sine / np.maximum(share, 1e-6), np.inf))[: int(np.any(share > 1e-6))]
    tangents = [_gain_cut(p, found, S0, beta, g, float(sine[k]), Z[:, k]) for k in order]
    return negative == 0 and all(positive for _, positive in tangents), [cut for cut, _ in tangents]


def _between(crossed: Array) -> Array:
    """Frequencies on both sides of every crossing: the inequality fails on one, perhaps down to 0 or up to inf."""
    if crossed.size == 0:
        return crossed
    w = np.concatenate([[0.0], crossed])
    return np.unique(
        np.concatenate([w, 0.5 * (w[1:] + w[:-1]), np.sqrt(w[1:] * w[:-1]), [1.5 * w[-1], 10 * w[-1], np.inf]])
    )


def _gain_cut(
    p: FilterProblem, found: StableSubspace, S0: Array, beta: float, g: float, sine: float, z: Array
) -> tuple[Cut, bool]:
    """The tangent of v'P v >= 0 for v = U2 z, and whether v'P v is positive clear of rounding.

    v'P v is concave in (beta, g), P being the largest solution.  Zero counts as positive when a change of g by
    1e-9 of itself outweighs the rounding.
    """
    from scipy.linalg import get_lapack_funcs

    (trsyl,) = get_lapack_funcs(("trsyl",), (found.T,))
    W, scale, _ = trsyl(found.T, found.T, -np.outer(z, z), trana=b"N", tranb=b"T")
    W = 0.5 * (W + W.T) / scale
    U1, U2 = found.U1 / found.unit, found.U2
    J = S0 @ (p.B0.T @ U1 + p.H20.T @ p.H0 @ U2)

    def trace(M: Array) -> float:
        return float(np.sum((M @ W) * M))

    along_g = trace(p.Cn @ U2) + trace(J)
    along_beta = trace(p.Bf.T @ U1) / beta**2 - trace(p.G @ U2)
    # A rounding dH of H moves v'P v by at most |dH| tr W, in practice a small part of it: the half plane gives way.
    doubt = 0.1 * found.rounding * float(np.trace(W))
    constant = along_g * g + along_beta * beta - (sine + doubt) / found.unit
    positive = sine > doubt or (sine >= -doubt and doubt / found.unit <= 1e-9 * abs(along_g) * g)
    return Cut(float(along_beta), float(along_g), constant, frequency=False), positive


def _gram(Y: Array) -> Array:
    return Y.conj().transpose(0, 2, 1) @ Y
