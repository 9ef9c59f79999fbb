# SPDX-License-Identifier: BSD-3-Clause
"""The smallest level of the Lipschitz H-infinity filter problem, found between two bounds and without a solver.

For the error system e' = (A - L C1) e + Bphi dphi + (B - L E1) w, ef = H1 e + H2 w, |dphi| <= alpha |G e|, the levels
g = gamma^2 for which some L, P > 0 and beta > 0 prove int ef^2 <= g int w^2 form a convex set in (beta, g).  With L
eliminated (E1 of full row rank) a point belongs to it when the largest solution P of one Riccati equation exists and is
positive.  Where it fails, the failure itself is a half plane that contains the whole set:

- a Hamiltonian eigenvalue on the axis: at that frequency some (dphi, w) invisible to the healthy outputs breaks the
  inequality, and the form is linear in (beta, g);
- P not positive: v'P v is concave in (beta, g), its gradient costs one Lyapunov equation.

So each test either accepts a level or raises the lower bound by a Newton step, and the search over beta sees slopes, not
only values.  Khosrowjerdi 2011, Theorem 3.1, in the form of Section 8 of its re-derivation; cf. performance figures there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import Impossible, Inconclusive
from faultrecon.numerics.hamiltonian import StableSubspace, signs, stable_subspace
from faultrecon.numerics.hinf import frequency_response
from faultrecon.numerics.pencil import RANK_TOLERANCE, undetectable_modes, unobservable_subspace
from faultrecon.numerics.scaling import scale_states, spectral_norm, state_scaling

Array = NDArray[Any]

POSITIVE = 1e-11
"""A sine of twice the angle of X above minus this counts as not negative: the subspace is known to about 1e-14."""


@dataclass(frozen=True, slots=True)
class LevelSolution:
    """The optimum (an infimum, not attained): gamma was accepted, no level below `lower` can be.

    beta: the multiplier gamma belongs to; None when there is no nonlinearity.  schur_count: Hamiltonian Schur forms.
    """

    gamma: float
    beta: float | None
    schur_count: int
    lower: float


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


@dataclass
class Search:
    """The cuts so far and the number of Schur forms: the only state of the search."""

    cuts: list[Cut] = field(default_factory=list)
    schur_count: int = 0

    def axis(self, beta: float) -> float:
        """The level below which frequencies alone forbid (beta, g), as far as it is known."""
        return max((cut.level(beta) for cut in self.cuts if cut.frequency), default=0.0)

    def bound(self, beta: float) -> tuple[float, Cut | None]:
        """The highest lower bound on g at beta and the cut it comes from."""
        if not self.cuts:
            return 0.0, None
        levels = [cut.level(beta) for cut in self.cuts]
        k = int(np.argmax(levels))
        return levels[k], self.cuts[k]


def optimal_level(
    A: ArrayLike,
    Bphi: ArrayLike,
    B: ArrayLike,
    C1: ArrayLike,
    E1: ArrayLike,
    H1: ArrayLike,
    H2: ArrayLike,
    G: ArrayLike,
    alpha: float,
    *,
    beta: float | None = None,
    rtol: float = 1e-8,
) -> LevelSolution:
    """The smallest gamma any gain L can prove for the Lipschitz filter problem, over beta too unless it is given.

    A: (n, n), Bphi: (n, m), B: (n, l), C1: (p1, n), E1: (p1, l) of full row rank, H1: (q, n), H2: (q, l), G: (k, n).
    m = 0 or alpha = 0 is the plain H-infinity filter.  gamma is within rtol of the infimum, from above.  Raises
    Inconclusive when E1 lacks row rank (this route then does not apply) or no level was accepted, Impossible when a mode
    is undetectable or no (beta, gamma) satisfies the inequality.
    """
    problem = filter_problem(A, Bphi, B, C1, E1, H1, H2, G, alpha)
    search = Search()
    m, floor = problem.Bf.shape[1], max(problem.least, _tiny(problem))
    forms = frequency_forms(problem, _frequencies(problem))

    def by_frequency(beta: float, ceiling: float) -> tuple[float, bool]:
        search.cuts += frequency_cuts(forms, m, beta, max(search.bound(beta)[0], floor))
        level = max(search.bound(beta)[0], floor)
        return level, bool(np.isfinite(level))

    def by_riccati(beta: float, ceiling: float) -> tuple[float, bool]:
        return _accepted_level(problem, search, beta, ceiling, 0.5 * rtol)

    if m and beta is None:
        least = _least_ratio(problem)
        start = _minimise(search, by_frequency, 1.0, 1e-4, floor, least)[0]  # spends no Schur form
        at, g, lower = _minimise(search, by_riccati, start, 2 * rtol, floor, least)
    else:
        at = 1.0 if beta is None or not m else float(beta)
        by_frequency(at, np.inf)
        g, accepted = by_riccati(at, np.inf)
        lower = max(search.bound(at)[0], floor) if accepted else np.inf
    if not np.isfinite(lower) or not np.isfinite(g):
        raise _no_level(search, beta)
    return LevelSolution(_root(g), at if m else None, search.schur_count, min(_root(lower), _root(g)))


def filter_problem(
    A: ArrayLike,
    Bphi: ArrayLike,
    B: ArrayLike,
    C1: ArrayLike,
    E1: ArrayLike,
    H1: ArrayLike,
    H2: ArrayLike,
    G: ArrayLike,
    alpha: float,
) -> FilterProblem:
    """Eliminate what the healthy outputs show, balance the units, drop states nothing disturbs and that decay."""
    from scipy.linalg import solve_triangular

    A, Bphi, B, C1, E1, H1, H2, G = (np.asarray(M, dtype=float) for M in (A, Bphi, B, C1, E1, H1, H2, G))
    if not full_row_rank(E1):
        raise Inconclusive(
            "the Riccati route does not apply",
            why="some combination of the healthy outputs carries no noise (E1 lacks row rank)",
            remedies=("solve the linear matrix inequality instead", "declare noise on every healthy sensor"),
        )
    hidden = undetectable_modes(A, C1)
    if hidden:
        raise Impossible(
            f"the mode {hidden[0].value:.4g} is not seen by the healthy outputs and does not decay",
            why="no gain can make the error decay",
            evidence={"direction": np.real(hidden[0].direction).tolist()},
        )
    if alpha == 0 or not np.any(G) or not np.any(Bphi):
        Bphi, G = Bphi[:, :0], G[:0]
    C = np.vstack([C1, alpha * G, H1])
    A, Bs, C = scale_states(A, np.hstack([Bphi, B]), C, state_scaling(A, np.hstack([Bphi, B]), C))
    Bf, B = Bs[:, : Bphi.shape[1]], Bs[:, Bphi.shape[1] :]
    p1, k = C1.shape[0], G.shape[0]
    C1, G, H1 = C[:p1], C[p1 : p1 + k], C[p1 + k :]
    Q, R = np.linalg.qr(E1.T, mode="complete")
    shown, free = Q[:, :p1], Q[:, p1:]
    Cn = solve_triangular(R[:p1], C1, trans="T") if p1 else C1
    A0, B0 = A - B @ shown @ Cn, B @ free
    H0, H20 = H1 - H2 @ shown @ Cn, H2 @ free
    V = _disturbed_states(A0, np.hstack([Bf, B0]))
    least = spectral_norm(H2) ** 2
    return FilterProblem(V.T @ A0 @ V, V.T @ Bf, V.T @ B0, Cn @ V, H0 @ V, H20, G @ V, least)


def full_row_rank(E1: ArrayLike) -> bool:
    """Whether every combination of the healthy outputs carries noise, the rows measured each in its own size."""
    E1 = np.asarray(E1, dtype=float)
    if E1.shape[0] == 0:
        return True
    rows = np.linalg.norm(E1, axis=1, keepdims=True)
    if E1.shape[0] > E1.shape[1] or not rows.all():
        return False
    # 1e-7: the noise enters squared, and its square must stand clear of eps.
    return bool(np.linalg.svd(E1 / rows, compute_uv=False)[-1] > 1e-7)


def _disturbed_states(A: Array, B: Array) -> Array:
    """Orthonormal basis of the states left when those that B never reaches, and that do not grow, are set to zero."""
    from scipy.linalg import schur

    n = A.shape[0]
    N = unobservable_subspace(A.T, B.T, RANK_TOLERANCE)
    if N.shape[1] == 0:
        return np.eye(n)
    M = N.T @ A.T @ N
    marginal = 1e-9 * spectral_norm(A)
    _, Z, count = schur(M - marginal * np.eye(M.shape[0]), sort="lhp")
    quiet = N @ Z[:, :count]
    return np.asarray(np.linalg.qr(np.hstack([quiet, np.eye(n)]))[0])[:, count:]


def _frequencies(problem: FilterProblem) -> Array:
    """Where the first lower bounds are taken: a logarithmic grid, and the flanks of the poles."""
    poles = np.linalg.eigvals(problem.A0).astype(np.complex128)
    size = np.abs(poles)[np.abs(poles) > 1e-9 * np.max(np.abs(poles), initial=1e-300)]
    low, high = (size.min() / 10, size.max() * 10) if size.size else (0.1, 10.0)
    w = np.concatenate([[0.0, np.inf], np.geomspace(low, high, 40), np.abs(poles.imag), np.abs(poles)])
    return np.unique(w)


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
        level = missing / np.maximum(h, 1e-30 * np.abs(missing))
        k = int(np.argmax(level))
        if not level[k] > g * (1 + 1e-13):
            break
        strongest, g = Cut(float(b[k]), float(h[k]), float(c[k]), frequency=True), float(level[k])
        if g > 1e25:  # hardly any disturbance is needed: this beta is out of reach at every level
            break
    return [] if strongest is None else [strongest]


def test_level(problem: FilterProblem, search: Search, beta: float, g: float) -> tuple[bool, list[Cut]]:
    """Whether (beta, g) is feasible, and half planes that contain the feasible set (through this point if it is not)."""
    p = problem
    S0 = np.linalg.inv(g * np.eye(p.H20.shape[1]) - p.H20.T @ p.H20)
    h = p.H20.T @ p.H0
    At = p.A0 + p.B0 @ S0 @ h
    S = p.Bf @ p.Bf.T / beta + p.B0 @ S0 @ p.B0.T
    Q = beta * p.G.T @ p.G + p.H0.T @ p.H0 + h.T @ S0 @ h - g * p.Cn.T @ p.Cn
    search.schur_count += 1
    found = stable_subspace(At.T, 0.5 * (Q + Q.T), 0.5 * (S + S.T))
    if not isinstance(found, StableSubspace):
        return False, frequency_cuts(frequency_forms(p, _between(found)), p.Bf.shape[1], beta, g)
    sine, Z = signs(found)
    accepted = bool(sine.size == 0 or sine[0] >= -POSITIVE)
    count = min(1, sine.size) if accepted else min(3, int(np.count_nonzero(sine < -POSITIVE)))
    # sine / |U2 z|^2 is an eigenvalue of P: when accepted the smallest, and not an X near 0, says how far down g may go.
    order = np.argsort(sine / np.maximum(np.sum((found.U2 @ Z) ** 2, axis=0), 1e-300)) if accepted else np.arange(count)
    tangents = [_gain_cut(p, found, S0, beta, g, sine[k], Z[:, k]) for k in order[:count]]
    return accepted and all(clear for _, clear in tangents), [cut for cut, _ in tangents]


def _between(crossed: Array) -> Array:
    """Frequencies on both sides of every crossing: the inequality fails on one of them, perhaps down to 0 or up to inf."""
    if crossed.size == 0:
        return crossed
    w = np.concatenate([[0.0], crossed])
    return np.unique(np.concatenate([w, 0.5 * (w[1:] + w[:-1]), np.sqrt(w[1:] * w[:-1]), [1.5 * w[-1], 10 * w[-1], np.inf]]))


def _gain_cut(
    p: FilterProblem, found: StableSubspace, S0: Array, beta: float, g: float, sine: float, z: Array
) -> tuple[Cut, bool]:
    """The tangent of v'P v >= 0 for v = U2 z, and whether its sign stands clear of rounding.

    v'P v is concave in (beta, g), P being the largest solution.  A sign is also clear when a change of g by 1e-9 of
    itself outweighs the rounding.
    """
    from scipy.linalg import lapack

    W, scale, _ = lapack.dtrsyl(found.T, found.T, -np.outer(z, z), trana=b"N", tranb=b"T")
    W = 0.5 * (W + W.T) / scale
    U1, U2 = found.U1 / found.unit, found.U2
    J = S0 @ (p.B0.T @ U1 + p.H20.T @ p.H0 @ U2)

    def trace(M: Array) -> float:
        return float(np.sum((M @ W) * M))

    along_g = trace(p.Cn @ U2) + trace(J)
    along_beta = trace(p.Bf.T @ U1) / beta**2 - trace(p.G @ U2)
    # A rounding dH of H moves v'P v by at most |dH| tr W, in practice a small part of it: the half plane gives way.
    doubt = 0.1 * found.rounding * float(np.trace(W))
    constant = along_g * g + along_beta * beta - (float(sine) + doubt) / found.unit
    clear = abs(float(sine)) > doubt or doubt / found.unit <= 1e-9 * abs(along_g) * g
    return Cut(float(along_beta), float(along_g), constant, frequency=False), clear


def _accepted_level(
    problem: FilterProblem, search: Search, beta: float, ceiling: float, slack: float
) -> tuple[float, bool]:
    """Raise the lower bound at beta by the cuts until a level just above it is accepted, or it passes the ceiling.

    Between, a guess may be accepted far above the bound; its cut then raises the bound to just below the optimum.
    """
    low = max(search.bound(beta)[0], problem.least, _tiny(problem))
    accepted, guess, margin = np.inf, 0.0, slack
    for _ in range(80):
        if accepted <= low * (1 + 2 * slack):
            return accepted, True
        if not low < ceiling or not np.isfinite(low) or low > 1e36 * max(_tiny(problem), problem.least):
            return low, False
        trial = guess if low * (1 + 4 * margin) < guess < accepted else min(low * (1 + margin), accepted)
        fits, cuts = test_level(problem, search, beta, trial)
        search.cuts += cuts
        higher = max((cut.level(beta) for cut in cuts), default=0.0)
        guess = 0.0 if fits else _beyond_newton(search.axis(beta), trial, higher)
        if fits:
            if trial <= low * (1 + margin):
                return trial, True
            accepted, low = trial, max(low, min(higher, trial))
        elif higher > trial:
            low, margin = higher, slack
        else:  # rounding hides the cut: go up by growing steps
            low, margin = trial, 4 * margin
    return (accepted, True) if np.isfinite(accepted) else (low, False)


def _beyond_newton(axis: float, g: float, newton: float) -> float:
    """Where P may become positive, if it grows like the square root of the distance to the axis level, as it does near it.

    With f = -a + b sqrt(g - axis) the tangent at g vanishes at `newton` and f itself at the value returned, above it.
    """
    x, step = g - axis, newton - g
    return min(newton + step**2 / (4 * x), 2 * newton) if x > 0 and step > 0 else 0.0


def _lowest(search: Search) -> tuple[float, float]:
    """The minimum over beta >= 0 of the lower bound, and where it is: two lines at a time, as for any convex polygon."""
    low, high = 0.0, 1e30
    left, right = search.bound(low)[1], search.bound(high)[1]
    if left is None or right is None or right.a >= 0:  # nothing bounds beta from above yet
        return high, search.bound(high)[0]
    if left.a <= 0:
        return low, search.bound(low)[0]
    for _ in range(200):
        beta = _crossing(left, right, low, high)
        level, active = search.bound(beta)
        if active is None or active is left or active is right or not low < beta < high:
            return beta, level
        if active.a > 0:
            low, left = beta, active
        else:
            high, right = beta, active
    return beta, level


def _crossing(left: Cut, right: Cut, low: float, high: float) -> float:
    """Where a falling and a rising lower bound meet."""
    det = left.a * right.b - right.a * left.b
    if det == 0:
        return np.sqrt(max(low, 1e-30) * high)
    return (left.c * right.b - right.c * left.b) / det


Oracle = Callable[[float, float], tuple[float, bool]]
"""(beta, ceiling) -> (g, whether g is feasible at beta), adding cuts on the way; it may stop once g passes the ceiling."""


def _minimise(
    search: Search, oracle: Oracle, beta: float, rtol: float, floor: float, least_ratio: float
) -> tuple[float, float, float]:
    """Close the gap between the best level of the oracle and the lowest point of all cuts: (beta, g, lower bound)."""
    best_beta, best, lower, vain = beta, np.inf, floor, 0
    ends: dict[bool, tuple[float, float]] = {}  # falling?: (log beta, d g / d log beta)
    last: bool | None = None
    stride = 1.5
    for _ in range(60):
        g, accepted = oracle(beta, best)
        gap = best / lower - 1
        if accepted and g < best:
            best_beta, best = beta, g
        lowest, lower = _lowest(search)
        lower = max(lower, floor)
        # Where beta tends to 0 rounding stops the progress: four rounds in vain are enough.
        vain = vain + 1 if np.isfinite(gap) and best / lower - 1 > 0.99 * gap else 0
        if best <= lower * (1 + rtol) or vain >= 4:
            break
        if not np.isfinite(lower):
            raise _no_level(search, None)
        cut = search.bound(beta)[1]
        falling = cut is not None and cut.a > 0
        repeated = falling == last
        if repeated and (not falling) in ends:  # Illinois: halve the slope of the end that stays
            x, t = ends[not falling]
            ends[not falling] = x, 0.5 * t
        last = falling
        ends[falling] = np.log(beta), beta * cut.slope() if cut is not None else 0.0
        if len(ends) == 2 and repeated and ends[True][0] < np.log(max(lowest, 1e-300)) < ends[False][0]:
            beta = lowest  # most often on the other side of the minimum
        elif len(ends) == 2:
            beta = _vanishing_slope(*ends[True], *ends[False])
        else:  # at the edge of the feasible beta the cuts alone creep, so each step is also longer than the last
            far, near = (100.0, stride) if falling else (0.01, 1 / stride)
            beta = max(float(np.clip(lowest, *sorted((beta * near, beta * far)))), least_ratio * lower)
            stride *= stride
        for _ in range(40):  # where the cuts already exclude an improvement there is nothing to learn
            if search.bound(beta)[0] < best:
                break
            beta = max(float(np.clip(lowest, beta / 10, beta * 10)), least_ratio * lower)
    return best_beta, best, min(lower, best)


def _least_ratio(problem: FilterProblem) -> float:
    """beta/g below which the nonlinearity's channel outweighs the disturbances by more than arithmetic can hold."""
    disturbed = spectral_norm(problem.B0)
    return 1e-12 * (spectral_norm(problem.Bf) / disturbed) ** 2 if disturbed > 0 else 0.0


def _vanishing_slope(left: float, falling: float, right: float, rising: float) -> float:
    """Where a slope that is linear in log beta passes through 0 between two ends, given as (log beta, slope) each."""
    steeper = max(-falling, rising) / max(min(-falling, rising), 1e-300)
    share = falling / (falling - rising) if steeper < 1e3 else 0.5  # one end beyond the feasible beta: halve
    return float(np.exp(left + np.clip(share, 1e-3, 1 - 1e-3) * (right - left)))


def _gram(Y: Array) -> Array:
    return Y.conj().transpose(0, 2, 1) @ Y


def _root(g: float) -> float:
    return float(np.sqrt(g))


def _tiny(problem: FilterProblem) -> float:
    """A level that is zero for every purpose: the square of 1e-9 of a crude gain."""
    p = problem
    driven = spectral_norm(np.hstack([p.Bf, p.B0])) / max(spectral_norm(p.A0), 1e-150)
    shown = 1 / max(spectral_norm(p.Cn), 1e-150)
    gain = spectral_norm(p.H0) * min(max(driven, shown), 1e9)
    return max((1e-9 * gain) ** 2, 1e-18 * problem.least, 1e-100)


def _no_level(search: Search, beta: float | None) -> Impossible | Inconclusive:
    at = "" if beta is None else f" for beta = {beta:g}"
    return Impossible(
        f"no level gamma satisfies the inequality{at}",
        why="the nonlinearity is too strong for the healthy outputs" if beta is not None else "",
        evidence={"schur_count": search.schur_count},
    )
