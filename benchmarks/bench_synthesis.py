# SPDX-License-Identifier: BSD-3-Clause
"""How fast gains are found and proved: small plants, thirty states, large plants, proofs, starting up.

Everything is compared inside this one process, on one thread, in CPU time, as medians of rounds in which the
contestants take turns; read the ratios, the absolute numbers are only a scale.  Run it as

    python benchmarks/bench_synthesis.py            # six minutes, writes benchmarks/results/
    python benchmarks/bench_synthesis.py --quick    # half a minute, writes nothing

The plants are random and stable: n states, n/2 sensors of which half (rounded down) may be faulty, two disturbances,
noise on every sensor, two sine nonlinearities that read all states with Lipschitz constant 0.15/sqrt(n).
"""

from __future__ import annotations

import statistics
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from tables import one_thread, process_turns, table, turns

Arrays = Mapping[str, Any]
TOLERANCE = 1e-9  # of both interior-point routes


def main(quick: bool) -> None:
    """All tables."""
    small((0,) if quick else (0, 1, 2, 3, 4), 3 if quick else 9, keep=not quick)
    thirty((0,) if quick else (0, 1, 2), 1 if quick else 3, keep=not quick)
    large((80,) if quick else (80, 160), (0,) if quick else (0, 1, 2), keep=not quick)
    proofs((20,) if quick else (20, 40), 1 if quick else 3, keep=not quick)
    starts(3 if quick else 11, keep=not quick)


# ---------------------------------------------------------------- the plants


def family(n: int, seed: int) -> dict[str, np.ndarray]:
    """A, G (two columns), E_w (two columns) and C of a random stable plant."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n)) / np.sqrt(n)
    A -= (np.max(np.linalg.eigvals(A).real) + 0.3) * np.eye(n)
    parts = {"A": A, "G": rng.normal(size=(n, 2)), "E_w": rng.normal(size=(n, 2))}
    return {**parts, "C": rng.normal(size=(max(2, n // 2), n))}


def level_problem(n: int, seed: int) -> dict[str, Any]:
    """The same plant as the arguments of `optimal_level`: the last half of the sensors is faulty."""
    f = family(n, seed)
    p = len(f["C"])
    healthy = p - p // 2
    B, E = np.hstack([f["E_w"], np.zeros((n, p))]), np.hstack([np.zeros((p, 2)), 0.3 * np.eye(p)])
    known = {"A": f["A"], "Bphi": f["G"], "B": B, "C1": f["C"][:healthy], "E1": E[:healthy]}
    return {**known, "H1": -f["C"][healthy:], "H2": -E[healthy:], "G": np.eye(n), "alpha": 0.15 / np.sqrt(n)}


def plant(n: int, seed: int) -> Any:
    """The same plant as a `fr.Plant`."""
    import casadi as ca

    import faultrecon as fr

    f, alpha = family(n, seed), 0.15 / np.sqrt(n)
    p = len(f["C"])
    x, y = tuple(f"x{k + 1}" for k in range(n)), tuple(f"y{k + 1}" for k in range(p))

    def phi(state: Any, u: Any, t: Any) -> list[Any]:
        """Sines of two orthogonal unit combinations of the states."""
        halves = (state[0::2], state[1::2])
        return [alpha * ca.sin(ca.sum1(half) / half.shape[0] ** 0.5) for half in halves]

    graph = fr.Graph.trace(phi, {"x": n, "u": 0, "t": 1})
    disturbances = [fr.Disturbance(f"w{k}", into=dict(zip(x, f["E_w"][:, k].tolist(), strict=True))) for k in (0, 1)]
    disturbances += [fr.Disturbance(f"noise on {name}", on={name: 0.3}) for name in y]
    return fr.Plant(
        f"random, {n} states",
        fr.Signals(fr.Channels(x), fr.Channels(()), fr.Channels(y)),
        f["A"],
        np.zeros((n, 0)),
        f["C"],
        np.zeros((p, 0)),
        faults=tuple(fr.FaultChannel(f"f{k + 1}", on={y[k]: 1.0}) for k in range(p - p // 2, p)),
        disturbances=tuple(disturbances),
        nonlinearity=fr.Lipschitz(f["G"], x, replace(graph, inputs={"x": x, "u": (), "t": ("t",)}), alpha),
    )


# ---------------------------------------------------------------- the routes to the optimum


def by_modelling_layer(a: Arrays) -> float:
    """gamma by CVXPY and Clarabel, from the arrays to the answer."""
    import cvxpy as cp

    A, Bphi, B, C1, E1, H1, H2 = (a[name] for name in ("A", "Bphi", "B", "C1", "E1", "H1", "H2"))
    n, m, w, q = len(A), Bphi.shape[1], B.shape[1], len(H1)
    P, Z = cp.Variable((n, n), symmetric=True), cp.Variable((n, len(C1)))
    beta, g = cp.Variable(), cp.Variable()
    top = A.T @ P + P @ A - C1.T @ Z.T - Z @ C1 + beta * a["alpha"] ** 2 * a["G"].T @ a["G"]
    side, zero = P @ B - Z @ E1, np.zeros
    # fmt: off
    block = cp.bmat([
        [top,      P @ Bphi,          side,           H1.T],
        [Bphi.T @ P, -beta * np.eye(m), zero((m, w)),   zero((m, q))],
        [side.T,   zero((w, m)),      -g * np.eye(w), H2.T],
        [H1,       zero((q, m)),      H2,             -np.eye(q)],
    ])
    # fmt: on
    task = cp.Problem(cp.Minimize(g), [(block + block.T) / 2 << 0, P >> 0])
    settings = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), TOLERANCE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an inaccurate answer shows in the table
        task.solve(solver="CLARABEL", max_threads=1, **settings)
    return float(np.sqrt(g.value))


def posed(a: Arrays) -> Any:
    """The same inequality in this package's letters."""
    from faultrecon.lmi.expr import I, __, given, sym, unknown
    from faultrecon.lmi.problem import Problem

    A, Bphi, B, C1, E1, H1, H2, G = (given(k, a[k]) for k in ("A", "Bphi", "B", "C1", "E1", "H1", "H2", "G"))
    n, p1 = C1.shape[1], C1.shape[0]
    P, Z, beta, g = unknown("P", n, n, symmetric=True), unknown("Z", n, p1), unknown("beta"), unknown("g")
    top = A.T @ P + P @ A - C1.T @ Z.T - Z @ C1 + beta * a["alpha"] ** 2 * (G.T @ G)
    # fmt: off
    block = sym([
        [top, P @ Bphi,                P @ B - Z @ E1,    H1.T],
        [__,  -beta * I(Bphi.shape[1]), 0,                0],
        [__,  __,                      -g * I(B.shape[1]), H2.T],
        [__,  __,                      __,                -I(H1.shape[0])],
    ])
    # fmt: on
    return Problem([block < 0, P > 0], g)


def once(a: Arrays) -> float:
    """gamma by our assembly and one call of Clarabel."""
    return asked(a)[0]


def asked(a: Arrays) -> tuple[float, str]:
    """The same, and Clarabel's word for its answer."""
    from importlib import import_module

    from scipy import sparse

    from faultrecon.lmi.solve import conic_data

    clarabel, problem = import_module("clarabel"), posed(a)
    data = conic_data(problem)
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    nothing = sparse.csc_matrix((len(data.q), len(data.q)))
    cones = [clarabel.PSDTriangleConeT(size) for size in data.sizes]
    solver = clarabel.DefaultSolver(nothing, data.q, sparse.csc_matrix(data.M), data.b, cones, settings)
    answer = solver.solve()
    values = problem.unpack(np.asarray(answer.x) * data.units)
    return float(np.sqrt(values["g"].item())), str(answer.status).rpartition(".")[2]


def shipped(a: Arrays) -> float:
    """gamma as the package solves it: where the dual leaves doubt, again in the units of the first answer."""
    from faultrecon.lmi.solve import solve

    return float(np.sqrt(solve(posed(a), tolerance=TOLERANCE).objective))


def by_riccati(a: Arrays) -> float:
    """gamma by Riccati equations."""
    from faultrecon.numerics.riccati import optimal_level

    return optimal_level(**a).gamma


# ---------------------------------------------------------------- the tables


def small(seeds: tuple[int, ...], rounds: int, keep: bool) -> None:
    """Building and solving the level problem each time, in a process that is warm."""
    routes: dict[str, Callable[[Arrays], float]] = {
        "CVXPY + Clarabel": by_modelling_layer,
        "ours, one solve": once,
        "ours, as shipped": shipped,
        "Riccati": by_riccati,
    }
    rows = []
    for n in (4, 5, 6):
        costs, apart = [], 0.0
        for seed in seeds:
            a = level_problem(n, seed)
            levels = [route(a) for route in routes.values()]
            apart = max(apart, max(levels) / min(levels) - 1)
            costs.append(turns({name: (lambda r=route, a=a: r(a)) for name, route in routes.items()}, rounds))
        row: dict[str, Any] = {"n": n}
        row |= {f"{name} (ms)": statistics.median(c[name] for c in costs) * 1e3 for name in routes}
        for name in list(routes)[1:]:
            row[f"{name} / CVXPY"] = statistics.median(c[name] / c["CVXPY + Clarabel"] for c in costs)
        rows.append(row | {"levels apart": apart})
    about = f"From arrays to the optimum, warm, median of {len(seeds)} plants. Goal: ours at most 1/3 of CVXPY."
    table("synthesis_1_small", "Small level problems against a modelling layer", rows, about, keep)


def thirty(seeds: tuple[int, ...], rounds: int, keep: bool) -> None:
    """The Riccati route against the interior-point solver called directly."""
    from faultrecon.numerics.riccati import optimal_level

    rows = []
    for seed in seeds:
        a = level_problem(30, seed)
        found, (level, word) = optimal_level(**a), asked(a)
        cost = turns({"Riccati": lambda a=a: by_riccati(a), "Clarabel": lambda a=a: once(a)}, rounds)
        rows.append(
            {
                "seed": seed,
                "Riccati (s)": cost["Riccati"],
                "Clarabel, one solve (s)": cost["Clarabel"],
                "Clarabel / Riccati": cost["Clarabel"] / cost["Riccati"],
                "its word": word,
                "difference of the optimum": abs(level / found.gamma - 1),
                "difference, as shipped": abs(shipped(a) / found.gamma - 1),
                "Schur forms": found.schur_count,
                "gap to the lower bound": found.gamma / found.lower - 1,
            }
        )
    about = "Goals: at least 20 times faster, optima within 1e-5, at most 100 Schur forms."
    table("synthesis_2_thirty", "Thirty states: Riccati route against Clarabel", rows, about, keep)


def large(sizes: tuple[int, ...], seeds: tuple[int, ...], keep: bool) -> None:
    """Plants that no interior-point solver reaches: the optimum, and a whole design with its proof."""
    import faultrecon as fr
    from faultrecon.numerics.riccati import optimal_level

    rows = []
    for n in sizes:
        for seed in seeds:
            a = level_problem(n, seed)
            found, one = optimal_level(**a), hamiltonian(a)
            cost = turns({"level": lambda a=a: optimal_level(**a), "schur": lambda H=one: schur(H)}, rounds=3)
            model, designs = plant(n, seed), []
            whole = turns({"design": lambda m=model, d=designs: d.append(fr.design(m))}, rounds=1)
            checked = designs[0].verification
            proved = all(s.verdict == "proved" for s in checked.steps if s.label in ("(3.1)", "P > 0", "β > 0"))
            rows.append(
                {
                    "n": n,
                    "seed": seed,
                    "optimum (s)": cost["level"],
                    "Schur forms": found.schur_count,
                    "optimum / one Schur form": cost["level"] / cost["schur"],
                    "gap to the lower bound": found.gamma / found.lower - 1,
                    "whole design (s)": whole["design"],
                    "design / one Schur form": whole["design"] / cost["schur"],
                    "level / optimum": designs[0].level / designs[0].optimum,
                    "inequalities": "proved" if proved else "not proved",
                    "certificate": checked.verdict,
                }
            )
    about = (
        "Every plant was solved. The certificate as a whole is only as strong as the assumed Lipschitz constant. "
        "Goal at n = 160: the optimum within 60 Schur forms' time."
    )
    table("synthesis_3_large", "Large plants", rows, about, keep)


def hamiltonian(a: Arrays) -> np.ndarray:
    """A Hamiltonian matrix of the size the search takes apart, of the same plant."""
    A, S, Q = a["A"], a["B"] @ a["B"].T, a["C1"].T @ a["C1"]
    return np.block([[A.T, -Q], [-S, -A]])


def schur(H: np.ndarray) -> None:
    """One ordered real Schur form as the search makes it: the form, then the stable half moved to the front."""
    from faultrecon.numerics.hamiltonian import stable_subspace

    n = len(H) // 2
    stable_subspace(H[:n, :n], H[:n, n:], -H[n:, :n])


def proofs(sizes: tuple[int, ...], rounds: int, keep: bool) -> None:
    """Proving the gains again, beside one solve of the semidefinite program for the same plant."""
    import faultrecon as fr
    from faultrecon.lmi.quick import quickly_proved
    from faultrecon.methods.registry import method
    from faultrecon.synthesis.certify import gains_from, proof_inequalities, prove
    from faultrecon.synthesis.levels import pose

    rows = []
    for n in sizes:
        a, model = level_problem(n, 0), plant(n, 0)
        made = fr.design(model).certificate
        inequalities = proof_inequalities(pose(method(made.method), model).theorem)
        numbers = {**gains_from(made.data), **gains_from(made.gains), "γ": made.level}

        def quick(inequalities: Any = inequalities, numbers: Any = numbers) -> bool:
            return all(quickly_proved(i, numbers) for i in inequalities)

        exact, short = prove(made), quick()
        fast = turns({"exact": lambda made=made: prove(made), "quick": quick}, rounds=7)
        cost = fast | turns({"solve": lambda a=a: once(a), "library": made.verify}, rounds)
        rows.append(
            {
                "n": n,
                "Clarabel, one solve (s)": cost["solve"],
                "exact proof (s)": cost["exact"],
                "exact / solve (%)": 100 * cost["exact"] / cost["solve"],
                "rigorous floats (s)": cost["quick"],
                "floats / solve (%)": 100 * cost["quick"] / cost["solve"],
                "standard library alone (s)": cost["library"],
                "inequalities exactly": all(s.verdict != "refuted" for s in exact.steps),
                "inequalities in floats": short,
            }
        )
    about = (
        "A proof rebuilds every matrix of the certificate from its numbers; floats may show nothing where the exact "
        "proof does. Goals: exact at most 10 %, floats 1 %."
    )
    table("synthesis_4_proofs", "Proof against solution", rows, about, keep)


def starts(rounds: int, keep: bool) -> None:
    """Whole processes: importing, asking for help, and a first answer."""
    python = sys.executable
    level = "import bench_synthesis as b; b.{}(b.level_problem(6, 0))"
    cost = process_turns(
        {
            "python": [python, "-c", "pass"],
            "import numpy": [python, "-c", "import numpy"],
            "import faultrecon": [python, "-c", "import faultrecon"],
            "faultrecon --help": [python, "-m", "faultrecon", "--help"],
            "level problem, n = 6, by CVXPY": [python, "-c", level.format("by_modelling_layer")],
            "level problem, n = 6, ours as shipped": [python, "-c", level.format("shipped")],
            "level problem, n = 6, Riccati": [python, "-c", level.format("by_riccati")],
        },
        rounds,
    )
    numpy, layer = cost["import numpy"], cost["level problem, n = 6, by CVXPY"]
    rows = [
        {
            "process": name,
            "CPU (s)": seconds,
            "over a bare interpreter (s)": seconds - cost["python"],
            "times import numpy": seconds / numpy,
            "times CVXPY": seconds / layer if "level" in name else None,
        }
        for name, seconds in cost.items()
    ]
    about = "Goals: import at most 1.3 times that of NumPy, the first level at most 1/5 of CVXPY."
    table("synthesis_5_starts", "Starting up", rows, about, keep)


if __name__ == "__main__":
    one_thread()
    main("--quick" in sys.argv[1:])
