# SPDX-License-Identifier: BSD-3-Clause
"""How fast inequalities over the vertices of a box are assembled, solved and proved, beside a modelling layer.

Everything is compared inside this one process, on one thread, in CPU time; read the ratios.  Run it as

    python benchmarks/bench_polytopic.py            # some minutes, writes benchmarks/results/
    python benchmarks/bench_polytopic.py --quick    # half a minute, writes nothing

The inequality is theorem 1 of Bezzaoucha 2013 in its compressed form (ts-published), on random stable plants: n states,
p premises that are states, r = 2^p vertices of A(z), two sensors that may both lose gain, so 4 r blocks.  Both sides
state the same blocks from the same arrays for the same solver with the same tolerances.
"""

from __future__ import annotations

import sys
import time
import warnings
from typing import Any

import numpy as np
from tables import one_thread, table, turns

TOLERANCE = 1e-9
FAULTS = 2


def main(quick: bool) -> None:
    """Both tables."""
    assembly(((4, 2), (6, 4)) if quick else ((4, 2), (6, 4), (6, 6)), 1 if quick else 3, keep=not quick)
    whole(((4, 2), (6, 3)) if quick else ((4, 2), (6, 4), (6, 6)), 4 if quick else 16, keep=not quick)


# ---------------------------------------------------------------- the plants


def plant(n: int, p: int, seed: int = 0) -> Any:
    """x' = (A0 + Σ z_k A_k) x + B u with z_k = x_k - 1.5 on [1, 2], and two positive sums of states as sensors."""
    from faultrecon.io.plantfile import parse_plant

    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n)) / np.sqrt(n)
    A -= (np.max(np.linalg.eigvals(A).real) + 1.0) * np.eye(n)
    parts = 0.2 * rng.normal(size=(p, n, n)) / n
    x = [f"x{k + 1}" for k in range(n)]

    def text_of(i: int, j: int, names: list[str]) -> str:
        return " + ".join([f"{A[i, j]:.6f}", *(f"{part[i, j]:.6f}*{z}" for part, z in zip(parts, names, strict=True))])

    z = [f"z{k + 1}" for k in range(p)]
    inside = [f"({x[k]} - 1.5)" for k in range(p)]
    phi = [" + ".join(f"({text_of(i, j, inside)})*{x[j]}" for j in range(n)) + f" + u*{i + 1}.0" for i in range(n)]
    C = np.round(rng.uniform(0.5, 1.5, size=(FAULTS, n)), 3)
    rest = [1.5] * n
    text = [
        "schema = 1", f'name = "random, {n} states, {2**p} vertices"',
        "[signals]", f"x = {x}".replace("'", '"'), 'u = ["u"]', 'y = ["y1", "y2"]',
        "[noise]", "hold = 0.1", "sd = { y1 = 0.01, y2 = 0.01 }",
        "[operating_point]", "x = { " + ", ".join(f"{k} = 1.5" for k in x) + " }",
        "y = { " + ", ".join(f"y{i + 1} = {float(C[i] @ rest)!r}" for i in range(FAULTS)) + " }",
        "[matrices]", f"A = {np.zeros((n, n)).tolist()}", f"B = {np.zeros((n, 1)).tolist()}", f"C = {C.tolist()}",
        "[nonlinearity]", f"into = {x}".replace("'", '"'), f"phi = {phi}".replace("'", '"'), "constants = {}",
        "domain = { " + ", ".join(f"{k} = [0.0, 3.0]" for k in [*x, "u"]) + " }", 'lipschitz = "derive"',
        "[polytopic]", "premises = { " + ", ".join(f'{a} = "{b}"' for a, b in zip(z, inside, strict=True)) + " }",
        f"A = {[[text_of(i, j, z) for j in range(n)] for i in range(n)]}".replace("'", '"'),
        f"B = {[[f'{i + 1}.0'] for i in range(n)]}".replace("'", '"'),
        "box = { " + ", ".join(f"{k} = [1.0, 2.0]" for k in x) + ", u = [0.0, 1.0] }",
        "faults = { f1 = [-0.2, 0.2], f2 = [-0.2, 0.2] }",
    ]  # fmt: skip
    for i in range(FAULTS):
        text += ["[[fault]]", f'name = "f{i + 1}"', f'sensor = "y{i + 1}"', 'effect = "multiplicative"', "rate = 0.1"]
        text += ["size = 0.2"]
    return parse_plant("\n".join(text), "random.toml")


# ---------------------------------------------------------------- the same inequality twice


def arrays(model: Any) -> dict[str, Any]:
    """Vertices A_i, B_i and C̃_j."""
    from faultrecon.methods.takagi_sugeno import faulty_outputs
    from faultrecon.plant.sector import Sector

    sector = Sector.of(model)
    C = faulty_outputs(model)
    return {"A": list(sector.A), "B": list(sector.B), "C": C, "m": sector.B.shape[2], "q": FAULTS}


def factor(many: list[np.ndarray]) -> np.ndarray:
    """F with F Fᵀ = Σ M Mᵀ."""
    left, sizes, _ = np.linalg.svd(np.hstack(many), full_matrices=False)
    return left[:, sizes > 1e-13 * sizes.max()] * sizes[sizes > 1e-13 * sizes.max()]


def modelled(a: dict[str, Any]) -> Any:
    """The problem in CVXPY, and its β."""
    import cvxpy as cp

    A, C, n, q, m, r = a["A"], a["C"], len(a["A"][0]), a["q"], a["m"], len(a["A"])
    p = len(C[0])
    FA, FB, FC = factor(A), factor(a["B"]), factor(C)
    kA, kB, kC = FA.shape[1], FB.shape[1], FC.shape[1]
    P1, P2 = cp.Variable((n, n), symmetric=True), cp.Variable((q, q), symmetric=True)
    R, Kb, ab = ([cp.Variable(shape) for _ in range(r)] for shape in ((n, p), (q, p), (q, q)))
    G = [cp.Variable((s, s), symmetric=True) for s in (n, q, q, m)]
    l1, lB, l1C, l2C, beta = (cp.Variable() for _ in range(5))
    claims = [P1 >> 0, P2 >> 0, *(beta * np.eye(g.shape[0]) - g >> 0 for g in G)]
    claims += [one >= 0 for one in (l1, lB, l1C, l2C)]
    sizes = (n, q, q, q, kA, kB, kC, kC)
    for Ai, Ri, Ki, ai in zip(A, R, Kb, ab, strict=True):
        for Cj in C:
            X = P1 @ Ai - Ri @ Cj
            upper = {
                (0, 0): X + X.T + np.eye(n), (0, 1): -Cj.T @ Ki.T, (0, 4): P1 @ FA, (0, 5): P1 @ FB, (0, 6): Ri @ FC,
                (1, 1): -ai - ai.T + np.eye(q), (1, 2): ai, (1, 3): P2, (1, 7): Ki @ FC, (2, 2): -G[1], (3, 3): -G[2],
                (4, 4): -l1 * np.eye(kA), (5, 5): -lB * np.eye(kB), (6, 6): -l1C * np.eye(kC),
                (7, 7): -l2C * np.eye(kC),
            }  # fmt: skip
            M = cp.bmat([[entry(upper, i, j, sizes) for j in range(8)] for i in range(8)])
            claims.append((M + M.T) / 2 << 0)
    claims.append(G[0] - (r * l1 + len(C) * (l1C + l2C)) * np.eye(n) >> 0)
    claims.append(G[3] - r * lB * np.eye(m) >> 0)
    return cp.Problem(cp.Minimize(beta), claims), beta


def entry(upper: dict[tuple[int, int], Any], i: int, j: int, sizes: tuple[int, ...]) -> Any:
    """A block of a symmetric matrix given by its upper triangle, zero where nothing stands."""
    if (i, j) in upper:
        return upper[i, j]
    return upper[j, i].T if (j, i) in upper else np.zeros((sizes[i], sizes[j]))


def compiled_by_cvxpy(a: dict[str, Any]) -> Any:
    """From arrays to the solver's arrays."""
    import cvxpy as cp

    return modelled(a)[0].get_problem_data(cp.CLARABEL)[0]


def solved_by_cvxpy(a: dict[str, Any]) -> tuple[float, str]:
    """From arrays to β, and the solver's word for it."""
    problem, beta = modelled(a)
    settings = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), TOLERANCE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an inaccurate answer shows in the table
        problem.solve(solver="CLARABEL", max_threads=1, **settings)
    return float(beta.value), problem.status


def posed(model: Any) -> Any:
    """The same in the package's letters: vertices, factors and blocks anew each time."""
    from faultrecon.lmi.problem import Problem
    from faultrecon.methods.takagi_sugeno import TsPublished, Unknowns, compressed

    s = Unknowns.of(model)
    theorem = TsPublished().stated(model, s, compressed(s, True))
    return Problem(theorem.inequalities, theorem.minimise)


def assembled(model: Any) -> Any:
    """From the plant to the solver's arrays."""
    from faultrecon.lmi.solve import conic_data

    return conic_data(posed(model))


def certified(model: Any) -> tuple[float, str]:
    """From the plant to gains that are proved, by one solve a little inside: γ, and the verdict."""
    from faultrecon.lmi.solve import solve
    from faultrecon.methods.registry import method
    from faultrecon.synthesis.certify import certificate, prove, shipped
    from faultrecon.synthesis.levels import pose

    stated = pose(method("ts-published"), model)
    found = solve(stated.problem(), margin=MARGIN, tolerance=TOLERANCE)
    level = float(np.sqrt(found.objective)) * (1 + ROOM)
    values = {**stated.fixed, **found.values}
    gains = shipped(stated.theorem, found.values)
    made = certificate(stated.method.name, stated.theorem, stated.plant, gains, values, level)
    return level, prove(made).verdict


MARGIN, ROOM = 1e-6, 1e-3
"""How far inside the inequalities the point lies, and what the level that is proved has above that of the point."""


# ---------------------------------------------------------------- the tables


def assembly(sizes: tuple[tuple[int, int], ...], rounds: int, keep: bool) -> None:
    """Compiling alone."""
    rows = []
    for n, p in sizes:
        model = plant(n, p)
        a = arrays(model)
        contestants = {"CVXPY": lambda a=a: compiled_by_cvxpy(a), "ours": lambda m=model: assembled(m)}
        for work in contestants.values():
            work()
        cost = turns(contestants, rounds)
        data = assembled(model)
        rows.append(
            {
                "n": n,
                "vertices": 2**p,
                "blocks": 2 ** (p + FAULTS),
                "size of a block": max(data.sizes),
                "CVXPY compiles (s)": cost["CVXPY"],
                "ours assembles (s)": cost["ours"],
                "CVXPY / ours": cost["CVXPY"] / cost["ours"],
            }
        )
    about = "From arrays to the solver's arrays, warm. Goal: 64 blocks at n = 6 in at most 1/20 of CVXPY's time."
    table("polytopic_1_assembly", "Vertex inequalities: assembly against a modelling layer", rows, about, keep)


def whole(sizes: tuple[tuple[int, int], ...], designed: int, keep: bool) -> None:
    """The optimum, and gains with a proof, against one compile and solve by the modelling layer.

    designed: the largest number of vertices for which the whole design is made.
    """
    import faultrecon as fr

    rows = []
    for n, p in sizes:
        model = plant(n, p)
        a = arrays(model)
        (squared, word), layer = timed(lambda a=a: solved_by_cvxpy(a))
        (level, verdict), proof = timed(lambda m=model: certified(m))
        best, optimum = timed(lambda m=model: fr.optimum(m, "ts-published"))
        row = {
            "n": n,
            "vertices": 2**p,
            "blocks": 2 ** (p + FAULTS),
            "CVXPY, compile and solve (s)": layer,
            "its word": word,
            "one solve and proof (s)": proof,
            "one solve and proof / CVXPY": proof / layer,
            "verdict": verdict,
            "its level / optimum": level / best,
            "optimum, as shipped (s)": optimum,
            "optimum / CVXPY": optimum / layer,
            "difference of β": abs(best**2 / squared - 1),
        }
        if 2**p <= designed:
            made, design = timed(lambda m=model: fr.design(m, "ts-published"))
            row |= {"design (s)": design, "design / CVXPY": design / layer, "certificate": made.verification.verdict}
        rows.append(row)
    about = (
        "From the plant to β, and to gains that are proved, once each; CVXPY proves nothing. A design solves four"
        " times: the optimum, the same under a bound on the poles, mildest gains. Goal: 64 vertices proved within"
        " CVXPY's time."
    )
    table("polytopic_2_whole", "Vertex inequalities: solved and proved", rows, about, keep)


def timed(work: Any) -> tuple[Any, float]:
    """What comes out, and CPU seconds."""
    start = time.process_time()
    return work(), time.process_time() - start


if __name__ == "__main__":
    one_thread()
    main("--quick" in sys.argv[1:])
