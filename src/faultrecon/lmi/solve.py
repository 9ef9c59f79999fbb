# SPDX-License-Identifier: BSD-3-Clause
"""Semidefinite programs by Clarabel, from svec data assembled directly.

An outcome is one of three words.  "solved": a point was returned; whether it satisfies the inequalities is for the
prover to say.  "infeasible": the solver returned a dual certificate and it was checked here in floating point.
"unknown": anything else, in the solver's own words.  No exception of the solver leaves this module.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from faultrecon.lmi.problem import Form, Problem, freedom
from faultrecon.lmi.together import rows_of, upper


@dataclass(frozen=True)
class Outcome:
    """What the solver answered: `values` by unknown (empty unless solved), `objective`, its own word and effort.

    duals: one symmetric matrix per inequality, scaled as the solver saw it; of a certificate of infeasibility when
    infeasible, of the optimum when solved.
    """

    status: Literal["solved", "infeasible", "unknown"]
    values: dict[str, np.ndarray] = field(default_factory=dict)
    objective: float = float("nan")
    solver: str = ""
    iterations: int = 0
    seconds: float = 0.0
    duals: tuple[np.ndarray, ...] = ()

    @property
    def solved(self) -> bool:
        """True when a point was returned."""
        return self.status == "solved"


@dataclass(frozen=True)
class ConicData:
    """min q'v s.t. b - M v in a product of cones; each block an svec (upper triangle by columns, off-diagonal * √2).

    units: what v is measured in, per scalar unknown.
    """

    q: np.ndarray
    M: Any
    b: np.ndarray
    sizes: tuple[int, ...]
    units: np.ndarray


def conic_data(problem: Problem, margin: float = 0.0, near: np.ndarray | None = None) -> ConicData:
    """The solver's arrays for `positive side >= margin * I` in scaled coordinates.

    near: scalar unknowns (N,) of a point, in whose neighbourhood matrices and unknowns are brought to size one; without
    it the data alone decide.
    """
    from scipy import sparse

    units = np.ones(problem.size) if near is None else _units(problem, near)
    if len(problem.inequalities) >= MANY:
        M, b, sizes = rows_of(problem, margin, near, units)
        return ConicData(_costs(problem, units, near), M, b, sizes, units)
    none = np.zeros if problem.dense else sparse.csr_array
    blocks = [_svec(form, none((form.constant.size, problem.size)), margin, near) for form in problem.forms]
    q = _costs(problem, units, near)
    rows = [m for m, _, _ in blocks] or [none((0, problem.size))]
    M = np.vstack(rows) * units if problem.dense else sparse.vstack(rows, format="csc") @ sparse.diags_array(units)
    b = np.concatenate([rhs for _, rhs, _ in blocks] or [np.zeros(0)])
    return ConicData(q, sparse.csc_array(M), b, tuple(n for _, _, n in blocks), units)


MANY = 12
"""Inequalities from which blocks are read once for all: vertices share most of them, and few unknowns."""


def _costs(problem: Problem, units: np.ndarray, near: np.ndarray | None) -> np.ndarray:
    q = np.zeros(problem.size)
    if problem.objective is not None and problem.objective.slope is not None:
        slope = problem.objective.slope
        q = (slope if problem.dense else slope.toarray()).ravel() * units
        if near is not None and q.any():
            q = q / np.abs(q).max()
    return q


def _units(problem: Problem, near: np.ndarray) -> np.ndarray:
    """The size of each unknown at a point, as a power of two, for all its entries alike."""
    units = np.ones(problem.size)
    for name, leaf in problem.unknowns.items():
        part = slice(problem.offsets[name], problem.offsets[name] + freedom(leaf))
        size = np.abs(near[part]).max(initial=0.0)
        units[part] = np.exp2(np.round(np.log2(size))) if size > 0 else 1.0
    return units


def _svec(form: Form, none: Any, margin: float, near: np.ndarray | None) -> tuple[Any, np.ndarray, int]:
    """The rows (-slope, constant) of one matrix inequality after a diagonal congruence by powers of two."""
    n = form.constant.shape[0]
    slope = none if form.slope is None else form.slope
    diagonal = np.arange(n) * (n + 1)
    if near is None:
        weight = np.maximum(np.abs(form.constant).max(axis=1, initial=0), _row_max(slope[diagonal]))
    else:
        weight = np.abs(form.constant).diagonal() + abs(slope[diagonal]) @ np.abs(near)
    d = np.exp2(-np.round(0.5 * np.log2(np.where(weight > 0, weight, 1.0))))
    i, j, root = upper(n)
    factor = root * d[i] * d[j]
    constant = 0.5 * (form.constant + form.constant.T) - margin * np.diag(1.0 / d**2)
    half = -0.5 * (slope[i * n + j] + slope[j * n + i])
    rows = half * factor[:, None] if isinstance(half, np.ndarray) else half.multiply(factor[:, None]).tocsr()
    return rows, constant[i, j] * factor, n


def _row_max(rows: Any) -> np.ndarray:
    if rows.shape[0] == 0 or rows.shape[1] == 0:
        return np.zeros(rows.shape[0])
    top = np.abs(rows).max(axis=1)
    return top if isinstance(top, np.ndarray) else top.toarray().ravel()


def solve(
    problem: Problem,
    *,
    margin: float = 0.0,
    near: Mapping[str, np.ndarray] | None = None,
    tolerance: float = 1e-9,
    time_limit: float = 300.0,
) -> Outcome:
    """Solve by an interior-point method.

    margin: how far inside each (scaled) inequality the point has to lie.  near: unknowns of about the size of the
    answer, in whose units it is computed.  tolerance: relative gap and feasibility.
    An optimum that its dual does not settle is computed again in units in which the first answer has size one: an
    infimum with an unknown of 1e-8 beside one of 1e5 is else off by parts in a hundred while the solver is content.
    """
    data = conic_data(problem, margin, None if near is None else problem.pack(near))
    if problem.objective is None or margin:
        return _attempt(problem, data, tolerance, time_limit)
    quick = _attempt(problem, data, tolerance, time_limit, BRISK)
    if quick.status == "infeasible" or _settled(problem, data, quick):
        return quick
    first = quick if quick.solved else _attempt(problem, data, tolerance, time_limit)
    if not first.solved:
        return first
    again = _attempt(problem, conic_data(problem, margin, problem.pack(first.values)), tolerance, time_limit)
    if not again.solver.endswith(": Solved"):
        patient = _attempt(problem, data, tolerance, time_limit) if first is quick else first
        return patient if patient.solved else first  # a point is a point: the prover has the last word
    effort = {"iterations": first.iterations + again.iterations, "seconds": first.seconds + again.seconds}
    return replace(again, **effort)


SETTLED = 2e-6
"""The part of an optimum that may stay in doubt: a squared level is then known to 2e-6 and the level to 1e-6, ten times
closer than an infimum that no gain attains is worth knowing."""
REACH = 10.0
"""How many times larger than in the answer the unknowns of a better one may be, for the answer to count as settled."""


def _settled(problem: Problem, data: ConicData, found: Outcome) -> bool:
    """Whether the dual leaves no more than SETTLED of the optimum in doubt, in terms that do not depend on units.

    For a feasible v and z in the dual cone, q'v >= -b'z + v'(q + M'z) >= -b'z - |v|'|q + M'z|, and |v| is bounded by
    REACH times the size of each unknown found.  Where the answer itself is not feasible, z prices what it lacks.
    """
    if not found.solver.endswith(": Solved"):
        return False
    v = problem.pack(found.values)
    size, v = REACH * _units(problem, v) / data.units, v / data.units
    slack = [_smat(part, n) for part, n in _parts(data.b - data.M @ v, data.sizes)]
    z = np.concatenate([_projected(dual) for dual in found.duals] or [np.zeros(0)])
    blocks = [(s, dual) for s, dual in zip(slack, found.duals, strict=True) if len(s)]
    lacking = sum(max(0.0, -np.linalg.eigvalsh(s)[0]) * np.trace(dual) for s, dual in blocks)
    value = float(data.q @ v)
    doubt = abs(value + data.b @ z) + size @ np.abs(data.q + data.M.T @ z) + lacking
    return bool(doubt <= SETTLED * abs(value))


PATIENT: Mapping[str, Any] = {}
"""The solver's own settings; where it stops short of the tolerance it is asked again in the next manner."""
CENTRAL: Mapping[str, Any] = {"max_step_fraction": 0.9}
"""Shorter steps keep the iterates central, and often reach the tolerance after all."""
BRISK: Mapping[str, Any] = {
    "iterative_refinement_enable": False,
    "equilibrate_enable": False,
    "chordal_decomposition_merge_method": "none",
}
"""A quarter faster at the same number of iterations, for a first answer that is examined: no refinement of each step,
no scaling beyond ours, and no search for cliques that are better merged."""

HALFWAY = ("AlmostSolved", "InsufficientProgress", "NumericalError")
"""Words after which it is asked again."""


def _attempt(
    problem: Problem, data: ConicData, tolerance: float, time_limit: float, manner: Mapping[str, Any] = PATIENT
) -> Outcome:
    started = time.perf_counter()
    try:
        answer = _clarabel(data, tolerance, time_limit, manner)
        if _word(answer) in HALFWAY and manner is PATIENT:
            central = _clarabel(data, tolerance, time_limit, CENTRAL)
            better = ("Solved",) if _word(answer) == "AlmostSolved" else ("Solved", "AlmostSolved", "PrimalInfeasible")
            answer = central if _word(central) in better else answer
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as failure:  # a panic inside the compiled solver derives from BaseException alone
        return Outcome("unknown", solver=f"Clarabel: {type(failure).__name__}: {failure}")
    seconds = time.perf_counter() - started
    word, iterations = _word(answer), int(answer.iterations)
    z = np.asarray(answer.z, dtype=float)
    duals = tuple(_smat(part, n) for part, n in _parts(z, data.sizes))
    effort = {"solver": f"Clarabel: {word}", "iterations": iterations, "seconds": seconds, "duals": duals}
    v = np.asarray(answer.x, dtype=float) * data.units
    if word in ("Solved", "AlmostSolved") and np.all(np.isfinite(v)):
        return Outcome("solved", problem.unpack(v), _objective(problem, v), **effort)
    if word == "PrimalInfeasible" and _farkas(data, z):
        return Outcome("infeasible", **effort)
    return Outcome("unknown", **effort)


def _objective(problem: Problem, v: np.ndarray) -> float:
    form = problem.objective
    if form is None:
        return 0.0
    return float(form.constant[0, 0]) + (0.0 if form.slope is None else float((form.slope @ v)[0]))


def _word(answer: Any) -> str:
    return str(answer.status).rpartition(".")[2]


def _clarabel(data: ConicData, tolerance: float, time_limit: float, manner: Mapping[str, Any] = PATIENT) -> Any:
    from importlib import import_module

    from scipy import sparse

    clarabel = import_module("clarabel")  # its classes live in a compiled module that type checkers cannot see

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.time_limit = time_limit
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    settings.max_threads = 1  # small dense cones: threads cost more than they give, and results stay reproducible
    for name, value in manner.items():
        setattr(settings, name, value)
    cones = [clarabel.NonnegativeConeT(1) if n == 1 else clarabel.PSDTriangleConeT(n) for n in data.sizes if n > 0]
    size = len(data.q)
    quadratic = sparse.csc_matrix((size, size))
    return clarabel.DefaultSolver(quadratic, data.q, sparse.csc_matrix(data.M), data.b, cones, settings).solve()


FAR = 1e6
"""How far out, beside the sizes of the data, a dual certificate excludes solutions before "infeasible" is said."""


def _farkas(data: ConicData, z: np.ndarray) -> bool:
    """Whether z shows that no v within reach satisfies the inequalities: z in the dual cone, b'z < 0 and M'z nearly 0.

    For a feasible v, 0 <= (b - M v)'z = b'z - v'(M'z), so |v|'|M'z| >= -b'z.  With |M'z|_k a millionth of -b'z in units
    of column k, such a v would have to be a million times larger than the data: the test does not depend on units.
    """
    if not np.all(np.isfinite(z)) or not z.any():
        return False
    z = np.concatenate([_projected(_smat(part, n)) for part, n in _parts(z, data.sizes)])
    gain = -float(data.b @ z)
    if gain <= 0:
        return False
    columns = np.abs(data.M).max(axis=0).toarray().ravel()
    return bool(np.all(np.abs(data.M.T @ z) <= gain / FAR * columns / np.abs(data.b).max()))


def _parts(z: np.ndarray, sizes: tuple[int, ...]) -> list[tuple[np.ndarray, int]]:
    ends = np.cumsum([n * (n + 1) // 2 for n in sizes])
    return [(z[end - n * (n + 1) // 2 : end], n) for end, n in zip(ends, sizes, strict=True)]


def _projected(Z: np.ndarray) -> np.ndarray:
    """The nearest positive semidefinite matrix, as an svec."""
    values, vectors = np.linalg.eigh(Z)
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    i, j, root = upper(len(Z))
    return nearest[i, j] * root


def _smat(z: np.ndarray, n: int) -> np.ndarray:
    out = np.zeros((n, n))
    i, j, root = upper(n)
    out[i, j] = out[j, i] = z / root
    return out
