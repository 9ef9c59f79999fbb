# SPDX-License-Identifier: BSD-3-Clause
"""How fast the observer steps: over a log, one sample at a time, and from file to file.

Everything is compared inside this one process, on one thread, in CPU time, as the median of several rounds in which
the contestants take turns; read the ratios, the absolute numbers are only a scale.  Run it as

    OMP_NUM_THREADS=1 python benchmarks/bench_stepping.py

The example is the aircraft of Khosrowjerdi (2011), Example 4.1: six states, four sensors, a saturation, the gains that
`fr.design` ships, RK4 at 1 ms.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

import faultrecon as fr

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
    files(design)
    starts()


def turns(contestants: Mapping[str, Callable[[], object]], rounds: int = 7) -> dict[str, float]:
    """Median CPU seconds of each, taking turns so that a noisy neighbour meets them all."""
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, work in contestants.items():
            start = time.process_time()
            work()
            seconds[name].append(time.process_time() - start)
    return {name: statistics.median(s) for name, s in seconds.items()}


def table(title: str, rows: list[tuple[str, ...]]) -> None:
    """A small aligned table."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    print(f"\n{title}")
    for row in rows:
        print("  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


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
    rows = [("engine", "ns per sample", "ratio")]
    rows += [(name, f"{s / ROWS * 1e9:.0f}", f"{s / cost['numba']:.1f}") for name, s in cost.items()]
    table(f"replay of {ROWS} samples; largest difference between the engines {apart:.1e}", rows)


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

    for name, held in (("read as straight lines", straight), ("smooth signals known between samples", smooth)):
        against(f"{name}", design, ours, state, z0, t, held)


def against(
    title: str,
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
    rows = [("method", "rtol", "us per sample", "error", "times replay")]
    rows.append(("replay", "", f"{ours * 1e6:.3f}", f"{own:.1e}", "1"))
    found: list[tuple[float, float, str]] = []
    for method in ("RK45", "RK23", "DOP853", "LSODA", "BDF", "Radau"):
        for rtol in (1e-3, 1e-6, 1e-9):
            start = time.process_time()
            z = solve(method, rtol)
            cost = (time.process_time() - start) / SHORT
            found.append((cost, error(z), method))
            rows.append((method, f"{rtol:g}", f"{cost * 1e6:.1f}", f"{found[-1][1]:.1e}", f"{cost / ours:.0f}"))
    table(f"solve_ivp, {title}: {SHORT} samples", rows)
    fastest = min(found)
    print(f"  fastest of all: {fastest[2]}, {fastest[0] / ours:.0f} times replay at error {fastest[1]:.1e}")
    for label, names in (("fastest", {m for _, _, m in found}), ("RK45", {"RK45"})):
        fair = [cost for cost, e, method in found if e <= own and method in names]
        said = f"{min(fair) / ours:.0f} times replay" if fair else "none reaches our error"
        print(f"  {label} at no worse error: {said}")


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
    rows = [("per sample", "ns", "times the bare loop")]
    rows += [(name, f"{s / count * 1e9:.0f}", f"{s / base:.1f}") for name, s in cost.items()]
    table("one sample at a time", rows)


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
    rows = [(f"{FILE_ROWS} rows", "s", "times pyarrow")]
    rows += [(name, f"{s:.3f}", f"{s / base:.2f}") for name, s in cost.items()]
    table(f"Parquet to Parquet, {len(written.column_names)} columns out", rows)


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
    rows = [("start", "CPU s"), ("importing numba", f"{imported:.2f}"), ("compiled now", f"{cold:.2f}")]
    rows += [("from the disk cache", f"{disk:.3f}"), ("from memory", f"{memory:.3f}")]
    table("making an estimator ready", rows)


if __name__ == "__main__":
    main()
