# SPDX-License-Identifier: BSD-3-Clause
"""The smallest level of the Lipschitz H-infinity filter problem, found between two bounds and without a solver.

For the error system e' = (A - L C1) e + Bphi dphi + (B - L E1) w, ef = H1 e + H2 w, |dphi| <= alpha |G e|, the levels
g = gamma^2 for which some L, P > 0 and beta > 0 prove int ef^2 <= g int w^2 form a convex set in (beta, g).  A failed
attempt at a point gives half planes that contain the whole set (`cuts`), so each attempt either accepts a level or
raises the lower bound by a Newton step, and the search over beta sees slopes, not only values.  Khosrowjerdi 2011,
Theorem 3.1, with K1 = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from faultrecon.finding import Impossible, Inconclusive
from faultrecon.numerics.cuts import Cut, FilterProblem, attempt, frequency_cuts, frequency_forms
from faultrecon.numerics.pencil import RANK_TOLERANCE, undetectable_modes, unobservable_subspace
from faultrecon.numerics.scaling import scale_states, spectral_norm, state_scaling

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class LevelSolution:
    """The optimum, an infimum that is not attained: gamma was accepted, and `lower` bounds it from below.

    Both are checked in floating point, not proved.  beta: the multiplier gamma belongs to; None when there is no
    nonlinearity.  schur_count: Hamiltonian Schur forms it took.
    """

    gamma: float
    beta: float | None
    schur_count: int
    lower: float


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
    m = 0 or alpha = 0 is the plain H-infinity filter.  gamma is within rtol of the infimum, from above, or as near as
    its distance to `lower` says (where the best beta is 0, rounding leaves about 1e-6).  Raises Inconclusive when E1
    lacks row rank (this route then does not apply) or no level was accepted, Impossible when a mode is undetectable or
    the frequencies leave no (beta, gamma).
    """
    return _optimum(filter_problem(A, Bphi, B, C1, E1, H1, H2, G, alpha), beta, rtol)


def _optimum(problem: FilterProblem, beta: float | None, rtol: float) -> LevelSolution:
    """First by frequencies alone, which spends no Schur form, then by attempts at the Riccati equation."""
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
        start = _minimise(search, by_frequency, 1.0, 1e-4, floor, least)[0]
        at, g, lower = _minimise(search, by_riccati, start, 2 * rtol, floor, least)
    else:
        at = 1.0 if beta is None or not m else float(beta)
        by_frequency(at, np.inf)
        g, accepted = by_riccati(at, np.inf)
        lower = max(search.bound(at)[0], floor)
        g = g if accepted else np.inf
    if not lower <= g * (1 + 4 * rtol) or not np.isfinite(g):  # rounding decided: only the frequencies are certain
        search.cuts = [cut for cut in search.cuts if cut.frequency]
        lower = max(search.bound(at)[0] if beta is not None or not m else _lowest(search)[1], floor)
    if not np.isfinite(g):
        raise _no_level(search, beta, lower)
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
    _demand_solvable(A, C1, E1)
    if alpha == 0 or not np.any(G) or not np.any(Bphi):
        Bphi, G = Bphi[:, :0], G[:0]
    C = np.vstack([C1, alpha * G, H1])
    A, Bs, C = scale_states(A, np.hstack([Bphi, B]), C, state_scaling(A, np.hstack([Bphi, B]), C))
    Bf, B = Bs[:, : Bphi.shape[1]], Bs[:, Bphi.shape[1] :]
    p1, k = C1.shape[0], G.shape[0]
    C1, G, H1 = C[:p1], C[p1 : p1 + k], C[p1 + k :]
    Q, R = np.linalg.qr(E1.T, mode="complete")
    shown, free = Q[:, :p1], Q[:, p1:]
    Cn = solve_triangular(R[:p1].T, C1, lower=True) if p1 else C1
    A0, B0 = A - B @ shown @ Cn, B @ free
    B0[np.abs(B0) <= 1e-14 * spectral_norm(B)] = 0.0  # rounding is no disturbance
    H0, H20 = H1 - H2 @ shown @ Cn, H2 @ free
    V = _disturbed_states(A0, np.hstack([Bf, B0]))
    least = spectral_norm(H2) ** 2
    return FilterProblem(V.T @ A0 @ V, V.T @ Bf, V.T @ B0, Cn @ V, H0 @ V, H20, G @ V, least)


def _demand_solvable(A: Array, C1: Array, E1: Array) -> None:
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
    form = schur(M - marginal * np.eye(M.shape[0]), sort="lhp")
    quiet = N @ np.asarray(form[1])[:, : int(form[-1])]
    return np.asarray(np.linalg.qr(np.hstack([quiet, np.eye(n)]))[0])[:, quiet.shape[1] :]


def _frequencies(problem: FilterProblem) -> Array:
    """Where the first lower bounds are taken: a logarithmic grid, and the flanks of the poles; not on a pole itself,
    where rounding would be taken for a bound."""
    poles = np.linalg.eigvals(problem.A0).astype(np.complex128)
    size = np.abs(poles)[np.abs(poles) > 1e-9 * np.max(np.abs(poles), initial=1e-300)]
    low, high = (size.min() / 10, size.max() * 10) if size.size else (0.1, 10.0)
    w = np.concatenate([[0.0, np.inf], np.geomspace(low, high, 40), np.abs(poles.imag), np.abs(poles)])
    w = np.unique(w)
    gap = np.abs(1j * np.where(np.isfinite(w), w, 1e300)[:, None] - poles[None]).min(axis=1, initial=np.inf)
    return w[gap > 1e-9 * np.max(np.abs(poles), initial=0.0)]


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
        fits, cuts = attempt(problem, beta, trial)
        search.schur_count += 1
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
    """Where P may become positive if it grows like the square root of the distance to the axis level.

    With f = -a + b sqrt(g - axis) the tangent at g vanishes at `newton` and f itself at the value returned, above it.
    """
    x, step = g - axis, newton - g
    return min(newton + step**2 / (4 * x), 2 * newton) if x > 0 and step > 0 else 0.0


def _lowest(search: Search) -> tuple[float, float]:
    """Where over beta >= 0 the lower bound is least, and its value: two lines at a time, as for any convex polygon."""
    low, high = 0.0, 1e30
    left, right = search.bound(low)[1], search.bound(high)[1]
    if left is None or right is None or right.a >= 0:  # nothing bounds beta from above yet
        return high, search.bound(high)[0]
    if left.a <= 0:
        return low, search.bound(low)[0]
    beta, level = low, np.inf
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
"""(beta, ceiling) -> (g, whether g is feasible at beta), adding cuts; it may stop once g passes the ceiling."""


@dataclass
class Bracket:
    """Where the level last fell and last rose with beta, and what to try next."""

    least_ratio: float
    ends: dict[bool, tuple[float, float]] = field(default_factory=dict)  # falling?: (log beta, d g / d log beta)
    falling: bool = False
    repeated: bool = False
    stride: float = 1.5
    turn: int = 0

    def note(self, beta: float, cut: Cut | None) -> None:
        """Take in the slope at beta."""
        falling = cut is not None and cut.a > 0
        self.repeated = falling == self.falling and falling in self.ends
        if self.repeated and (not falling) in self.ends:  # Illinois: halve the slope of the end that stays
            x, slope = self.ends[not falling]
            self.ends[not falling] = x, 0.5 * slope
        self.falling = falling
        self.ends[falling] = float(np.log(beta)), beta * cut.slope() if cut is not None else 0.0

    def propose(self, beta: float, lowest: float, lower: float, slow: bool) -> float:
        """The next beta: where the slope vanishes, where the cuts are lowest, or half-way."""
        if len(self.ends) == 2:
            (xl, falling), (xr, rising) = self.ends[True], self.ends[False]
            # In turn while progress is slow: the lowest point is exact at a kink, halving helps where a slope is void.
            self.turn = self.turn + 1 if slow or self.repeated else 0
            if self.turn % 3 == 1 and np.exp(xl) < lowest < np.exp(xr):
                return lowest
            if self.turn % 3 == 2:
                return float(np.exp(0.5 * (xl + xr)))
            steeper = max(-falling, rising) / max(min(-falling, rising), 1e-300)
            # One end beyond the feasible beta has a slope that says nothing: halve.
            share = falling / (falling - rising) if steeper < 1e3 else 0.5
            return float(np.exp(xl + np.clip(share, 1e-3, 1 - 1e-3) * (xr - xl)))
        # At the edge of the feasible beta the cuts alone creep, so each step is also longer than the last.
        low, high = (beta * self.stride, beta * 100) if self.falling else (beta / 100, beta / self.stride)
        self.stride = min(self.stride**2, 100.0)
        return max(float(np.clip(lowest, low, high)), self.least_ratio * lower)


def _minimise(
    search: Search, oracle: Oracle, beta: float, rtol: float, floor: float, least_ratio: float
) -> tuple[float, float, float]:
    """Close the gap between the best level of the oracle and the lowest point of all cuts: (beta, g, lower bound).

    g is inf when no beta is feasible as far as the oracle can tell.
    """
    best_beta, best, lower, vain = beta, np.inf, floor, 0
    bracket = Bracket(least_ratio)
    for _ in range(60):
        g, accepted = oracle(beta, best)
        gap = best / lower - 1
        if accepted and g < best:
            best_beta, best = beta, g
        lowest, lower = _lowest(search)
        lower = max(lower, floor)
        # Where beta tends to 0 rounding stops the progress: six rounds in vain are enough.
        closed = (best / lower - 1) / gap if np.isfinite(gap) and gap > 0 else 0.0
        vain = vain + 1 if closed > 0.99 else 0
        if best <= lower * (1 + rtol) or vain >= 6 or not np.isfinite(lower):
            break
        bracket.note(beta, search.bound(beta)[1])
        beta = bracket.propose(beta, lowest, lower, slow=closed > 0.5)
        for _ in range(40):  # where the cuts already exclude an improvement there is nothing to learn
            if search.bound(beta)[0] < best:
                break
            beta = max(float(np.clip(lowest, beta / 10, beta * 10)), least_ratio * lower)
    return best_beta, best, lower


def _least_ratio(problem: FilterProblem) -> float:
    """beta/g below which the nonlinearity's channel outweighs the disturbances by more than arithmetic can hold."""
    disturbed = spectral_norm(problem.B0)
    return 1e-12 * (spectral_norm(problem.Bf) / disturbed) ** 2 if disturbed > 0 else 0.0


def _root(g: float) -> float:
    return float(np.sqrt(g))


def _tiny(problem: FilterProblem) -> float:
    """A level that is zero for every purpose: the square of 1e-9 of a crude gain."""
    p = problem
    driven = spectral_norm(np.hstack([p.Bf, p.B0])) / max(spectral_norm(p.A0), 1e-150)
    shown = 1 / spectral_norm(p.Cn) if np.any(p.Cn) else 0.0
    gain = spectral_norm(p.H0) * min(max(driven, shown), 1e9)
    return max((1e-9 * gain) ** 2, 1e-18 * problem.least, 1e-100)


def _no_level(search: Search, beta: float | None, lower: float) -> Impossible | Inconclusive:
    at = "" if beta is None else f" with beta = {beta:g}"
    evidence = {"lower bound of gamma": _root(lower), "schur_count": search.schur_count}
    if not np.isfinite(lower):
        return Impossible(
            f"no level gamma satisfies the inequality{at}",
            why="at some frequency the nonlinearity alone breaks it, whatever the gain",
            evidence=evidence,
            remedies=("lower the Lipschitz constant", "add a healthy sensor"),
        )
    return Inconclusive(
        f"no level gamma was accepted{at}",
        why="every level tried failed up to where rounding hides the answer",
        evidence=evidence,
        remedies=("solve the linear matrix inequality instead",),
    )
