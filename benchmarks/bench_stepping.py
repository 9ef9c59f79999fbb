# SPDX-License-Identifier: BSD-3-Clause
"""How fast the observer steps: over a log, one sample at a time, and from file to file.

Everything is compared inside this one process, on one thread, in CPU time, as the median of several rounds in which
the contestants take turns; read the ratios, the absolute numbers are only a scale.  Run it as

    python benchmarks/bench_stepping.py

The example is the aircraft of Khosrowjerdi (2011), Example 4.1: six states, four sensors, a saturation, the gains that
`fr.design` ships, RK4 at 1 ms.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tables import one_thread, table, turns

import faultrecon as fr
from faultrecon.runtime.estimator import Estimator

H = 1e-3
ROWS = 100_000
SHORT = 5_000  # samples given to the general-purpose integrators, which take long enough as it is
FILE_ROWS = 1_000_000


def main() -> None:
    """All tables."""
    design = fr.design(fr.library("lipschitz_aircraft"), "lipschitz-hinf")
    engines(design)
    bulk(design)
    single(design)
    injections()
    files(design)
    starts()


def signals(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smooth inputs and measurements at the times t: u (N, 1), y (N, 4)."""
    t = np.asarray(t, dtype=float)[..., None]
    return 0.3 * np.sin(1.1 * t), np.sin(t * [0.7, 1.3, 2.1, 0.4] + [0.0, 1.0, 2.0, 3.0]) * [0.1, 2.0, 0.1, 0.2]


def log(rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A regular log of such signals."""
    t = np.arange(rows) * H
    return t, *signals(t)


# ---------------------------------------------------------------- engines against each other


def engines(design: fr.Design) -> None:
    """The two engines over the same log."""
    t, u, y = log(ROWS)
    both = {name: design.estimator(H, engine=name) for name in ("casadi", "numba")}
    traces = {name: e.replay(t, u, y) for name, e in both.items()}
    apart = max(np.abs(getattr(traces["casadi"], n) - getattr(traces["numba"], n)).max() for n in ("fault", "state"))
    cost = turns({name: (lambda e=e: e.replay(t, u, y)) for name, e in both.items()})
    rows = [{"engine": k, "ns per sample": s / ROWS * 1e9, "times numba": s / cost["numba"]} for k, s in cost.items()]
    about = f"{ROWS} samples; largest difference between the engines {apart:.1e}."
    table("stepping_1_engines", "Stepping: a whole log, by engine", rows, about)


# ---------------------------------------------------------------- a whole log against general-purpose integrators


def bulk(design: fr.Design) -> None:
    """Against scipy's solve_ivp on the same equations: the log read as straight lines, and its smooth origin."""
    estimator = design.estimator(H, engine="numba")
    t, u, y = log(ROWS)
    ours = turns({"replay": lambda: estimator.replay(t, u, y)})["replay"] / ROWS
    t, u, y = log(SHORT)
    state = estimator.replay(t, u, y).state
    z0 = state[0]  # this observer's own states are the plant's, and its first estimate is where it starts
    v = np.hstack([u, y])

    def straight(time: float) -> np.ndarray:
        k = min(int(time / H), SHORT - 2)
        return v[k] + (v[k + 1] - v[k]) * (time / H - k)

    def smooth(time: float) -> np.ndarray:
        return np.concatenate(signals(np.array(time)))

    against(("2_lines", "the log read as straight lines"), design, ours, state, z0, t, straight)
    against(("3_smooth", "smooth signals known between the samples"), design, ours, state, z0, t, smooth)


def against(
    title: tuple[str, str],
    design: fr.Design,
    ours: float,
    state: np.ndarray,
    z0: np.ndarray,
    t: np.ndarray,
    held: Callable[[float], np.ndarray],
) -> None:
    """Every method of solve_ivp at three tolerances; its cost and its error beside ours."""
    from scipy.integrate import solve_ivp

    A, B = design.observer.A, design.observer.B

    def slope(time: float, z: np.ndarray) -> np.ndarray:
        out = A @ z + B @ held(time)
        saturated = min(max(z[0], -1.0), 1.0)
        out[1] += saturated
        out[4] += saturated
        return out

    def solve(method: str, rtol: float, **more: float) -> np.ndarray:
        found = solve_ivp(slope, (t[0], t[-1]), z0, method=method, t_eval=t, rtol=rtol, atol=1e-3 * rtol, **more)
        return found.y.T

    def error(z: np.ndarray) -> float:
        return float(np.linalg.norm(z - exact) / np.linalg.norm(exact))

    exact = solve("DOP853", 1e-11, max_step=H)
    own = error(state)
    rows: list[dict[str, Any]] = []

    def note(method: str, rtol: float | None, cost: float, error: float) -> None:
        fair = None if rtol is None else error <= own
        row = {"method": method, "rtol": rtol, "us per sample": cost * 1e6, "error": error}
        rows.append({**row, "times replay": cost / ours, "no worse than replay": fair})

    note("replay", None, ours, own)
    found: list[tuple[float, float, str]] = []
    for method in ("RK45", "RK23", "DOP853", "LSODA", "BDF", "Radau"):
        for rtol in (1e-3, 1e-6, 1e-9):
            start = time.process_time()
            z = solve(method, rtol)
            cost = (time.process_time() - start) / SHORT
            found.append((cost, error(z), method))
            note(method, rtol, *found[-1][:2])
    fastest = min(found)
    said = [f"Fastest of all: {fastest[2]}, {fastest[0] / ours:.0f} times replay at error {fastest[1]:.1e}."]
    for label, names in (("Fastest", {m for _, _, m in found}), ("RK45", {"RK45"})):
        fair = [cost for cost, e, method in found if e <= own and method in names]
        said.append(f"{label} at no worse error: " + (f"{min(fair) / ours:.0f} times replay." if fair else "none."))
    about = f"{SHORT} samples, error against DOP853 at 1e-11. {' '.join(said)}"
    table(f"stepping_{title[0]}", f"Stepping: against solve_ivp, {title[1]}", rows, about)


# ---------------------------------------------------------------- one sample at a time


def single(design: fr.Design) -> None:
    """`step` and `step_into` against a bare loop that reads the same two rows."""
    estimator = design.estimator(H, engine="numba")
    count = 20_000
    t, u, y = log(count)
    times = t.tolist()
    first, _ = estimator.step(estimator.init(), times[0], u[0], y[0])

    def bare() -> None:
        for k in range(1, count):
            u[k]
            y[k]

    def step() -> None:
        state = first
        for k in range(1, count):
            state, _ = estimator.step(state, times[k], u[k], y[k])

    def step_and_read() -> None:
        state = first
        for k in range(1, count):
            state, estimate = estimator.step(state, times[k], u[k], y[k])
            estimate.fault  # noqa: B018 - the read is what is measured

    def step_into() -> None:
        buffers = estimator.buffers(first)
        for k in range(1, count):
            estimator.step_into(buffers, times[k], u[k], y[k])

    def freeze() -> None:
        for _ in range(1, count):
            for size in (2, 6, 4):
                np.empty(size).flags.writeable = False

    cold = design.estimator(H, engine="casadi")

    def general() -> None:
        state = first
        for k in range(1, count // 10):
            state, _ = cold.step(state, times[k], u[k], y[k])

    cost = turns(
        {
            "bare loop, two row reads": bare,
            "step_into": step_into,
            "step": step,
            "step, and reading estimate.fault": step_and_read,
            "allocating and freezing three arrays": freeze,
            "step, nothing compiled": general,
        }
    )
    cost["step, nothing compiled"] *= 10
    base = cost["bare loop, two row reads"]
    rows = [{"per sample": k, "ns": s / count * 1e9, "times the bare loop": s / base} for k, s in cost.items()]
    table("stepping_4_samples", "Stepping: one sample at a time", rows)


# ---------------------------------------------------------------- the implicit step of a sliding mode


def injections() -> None:
    """Sliding-mode observers against the same observers without the injection, over a log, by engine."""
    rows = []
    for name in ("two_mass", "admire", "fighter"):
        made = fr.design(fr.library(name), "sliding-mode")
        linear, N = replace(made.observer, injections=()), ROWS
        rng = np.random.default_rng(2009)
        t, m, p = np.arange(N) * 1e-2, len(made.observer.u0), len(made.observer.y0)
        scale = made.plant.faults[0].size
        u, y = (np.cumsum(rng.normal(size=(N, k)), axis=0) * 1e-2 * scale for k in (m, p))
        for engine in ("casadi", "numba"):
            both = {
                "sliding mode": Estimator.build(made.observer, 1e-2, engine=engine),
                "linear": Estimator.build(linear, 1e-2, engine=engine),
            }
            cost = turns({label: (lambda e=e, log=(t, u, y): e.replay(*log)) for label, e in both.items()})
            per = {label: s / N * 1e9 for label, s in cost.items()}
            ratio = cost["sliding mode"] / cost["linear"]
            rows.append({"plant": name, "engine": engine, "ns per sample": per["sliding mode"], "times linear": ratio})
    table("stepping_7_injections", "Stepping: the implicit step of a sliding mode", rows, f"{ROWS} samples at 10 ms.")


# ---------------------------------------------------------------- from file to file


def files(design: fr.Design) -> None:
    """A Parquet log in, a Parquet table out, against pyarrow reading and writing the same two tables."""
    import pyarrow as pa
    from pyarrow import parquet

    pa.set_cpu_count(1)
    pa.set_io_thread_count(1)
    t, u, y = log(FILE_ROWS)
    y = y + 0.01 * np.random.default_rng(1).normal(size=y.shape)
    with tempfile.TemporaryDirectory() as folder:
        recorded, result, other = (str(Path(folder) / f"{name}.parquet") for name in ("log", "result", "other"))
        names = design.plant.signals
        fr.write_log(recorded, {"t": t, names.u.names[0]: u[:, 0]} | dict(zip(names.y.names, y.T, strict=True)))

        def reconstruct() -> None:
            fr.write_log(result, fr.replay(design, recorded, sample_time=H).columns())

        reconstruct()
        written = parquet.read_table(result)

        def through() -> None:
            parquet.read_table(recorded, use_threads=False)
            parquet.write_table(written, other)

        steps = design.estimator(H, engine="numba")
        cost = turns(
            {
                "pyarrow read + write": through,
                "read, reconstruct, write": reconstruct,
                "of which read_log": lambda: fr.read_log(recorded, names),
                "of which replay": lambda: steps.replay(t, u, y),
            },
            rounds=5,
        )
    base = cost["pyarrow read + write"]
    rows = [{"from file to file": name, "s": s, "times pyarrow": s / base} for name, s in cost.items()]
    about = f"{FILE_ROWS} rows, {len(written.column_names)} columns out."
    table("stepping_5_files", "Stepping: Parquet to Parquet", rows, about)


# ---------------------------------------------------------------- compiling


def starts() -> None:
    """What the first use costs: compiling, fetching from disk in a new process, fetching from memory."""
    program = """
import time, numpy, faultrecon as fr
design = fr.design(fr.library("lipschitz_aircraft"), "lipschitz-hinf")
def clock(work):
    start = time.process_time()
    work()
    return time.process_time() - start
print(clock(lambda: __import__("numba")), clock(lambda: design.estimator(1e-3).warm()),
      clock(lambda: design.estimator(1e-3).warm()))
"""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "FAULTRECON_CACHE": folder}
        command = [sys.executable, "-c", program]
        runs = [
            subprocess.run(command, env=environment, capture_output=True, text=True, check=True)  # noqa: S603 - our text
            for _ in range(2)
        ]
    (imported, cold, memory), (_, disk, _) = ([float(x) for x in run.stdout.split()] for run in runs)
    cost = {"importing numba": imported, "compiled now": cold, "from the disk cache": disk, "from memory": memory}
    rows = [{"start": name, "CPU s": seconds} for name, seconds in cost.items()]
    table("stepping_6_starts", "Stepping: making an estimator ready", rows)


if __name__ == "__main__":
    one_thread()
    main()
