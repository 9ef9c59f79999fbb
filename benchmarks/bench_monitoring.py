# SPDX-License-Identifier: BSD-3-Clause
"""What it costs to find out which sensor lies: a bank of eight hypotheses against one design, on the same log.

Read the ratios.  Everything runs in this process, on one thread, in CPU time, as the median of rounds in which the
contestants take turns; memory is that of processes of their own.  Run it as

    python benchmarks/bench_monitoring.py

The plant is the airliner that ships with the package: 8 states, 11 sensors, sampled every 0.02 s.  The log is a flight
of its model in gusts and noise, a million rows long.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import tables

import faultrecon as fr
from faultrecon.io.running import reconstruction, run_file
from faultrecon.io.watched import monitoring

ROWS, PIECE = 1_000_000, 65_536
OFF = 0.05  # rad/s; the separation of pitch_rate, see `Bank.apart`, is about a third of it
SENSORS = (
    "alpha_vane",
    "beta_vane",
    "roll_rate",
    "pitch_rate",
    "yaw_rate",
    "roll_angle",
    "pitch_angle",
    "vertical_speed",
)


def flight(plant: fr.Plant, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """t, u, y of the linear model in gusts of its declared size, held for a second, and in its noise."""
    from scipy.signal import lfilter

    assert plant.noise is not None
    rng, T = np.random.default_rng(0), plant.noise.hold
    real = [k for k, w in enumerate(plant.disturbances) if w.into]
    sizes = np.array([plant.disturbances[k].size for k in real])
    w = np.repeat(rng.uniform(-1, 1, (rows // 50 + 1, len(real))), 50, axis=0)[:rows] * sizes
    values, modes = np.linalg.eig(np.asarray(fr.discretised(plant, T).A))
    driven = w @ (np.linalg.solve(modes, plant.E_w[:, real] * T)).T
    x = np.column_stack([lfilter([0.0, 1.0], [1.0, -s], d) for s, d in zip(values, driven.T, strict=True)]) @ modes.T
    x, F = np.real(x), plant.F_w[:, real]
    y = np.array(plant.point.y) + x @ plant.C.T + w @ F.T + rng.standard_normal((rows, plant.p)) * plant.noise.sd
    return np.arange(rows) * T, np.tile(plant.point.u, (rows, 1)), y


def main() -> None:
    """Two tables: time in memory and from file to file, and memory by length of the log."""
    plant = fr.library("airliner")
    bank = fr.bank(plant, sensors=SENSORS)
    monitor, one = bank.monitor(), bank.designs["pitch_rate"]
    t, u, y = flight(plant, ROWS)
    estimators = [h.watch.estimator.warm() for h in monitor.hypotheses]
    monitor.take(monitor.start(), t[:PIECE], u[:PIECE], y[:PIECE])
    pieces = [slice(k, k + PIECE) for k in range(0, ROWS, PIECE)]

    def bare(chosen: list[fr.Estimator]) -> None:
        for estimator in chosen:
            state = estimator.init()
            for here in pieces:
                state = estimator.replay(t[here], u[here], y[here], state=state).end

    def watched(y: np.ndarray) -> None:
        state = monitor.start()
        for here in pieces:
            state, _ = monitor.take(state, t[here], u[here], y[here])

    lying = y.copy()
    lying[ROWS // 20 :, plant.signals.y.names.index("pitch_rate")] += OFF

    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.parquet"
        names = ("t", *plant.signals.u, *plant.signals.y)
        fr.write_log(log, dict(zip(names, (t, *u.T, *y.T), strict=True)))
        single = [bank.designs["pitch_rate"].estimator().warm()]
        spent = tables.turns(
            {
                "one": lambda: bare(single),
                "eight": lambda: bare(estimators),
                "watched": lambda: watched(y),
                "lying": lambda: watched(lying),
                "file one": lambda: run_file(reconstruction(one), plant.signals, log, out=Path(folder) / "one.parquet"),
                "file bank": lambda: run_file(monitoring(bank), plant.signals, log, out=Path(folder) / "bank.parquet"),
            },
            rounds=5,
        )
        rows = [
            {"what": what, "s": spent[key], "ratio": spent[key] / spent[base], "to": to}
            for what, key, base, to in (
                ("one design in memory", "one", "one", "itself"),
                ("eight designs in memory, bare", "eight", "eight", "itself"),
                ("the monitor of the eight in memory: bounds, tests, decisions", "watched", "eight", "the eight, bare"),
                ("the same while a sensor lies and tests fail", "lying", "eight", "the eight, bare"),
                ("one design, file to file", "file one", "file one", "itself"),
                ("the bank of eight, file to file", "file bank", "file one", "one design, file to file"),
            )
        ]
        tables.table(
            "monitoring_1_time",
            "What it costs to know which sensor lies",
            rows,
            f"{ROWS:,} rows of the airliner, eight hypotheses; CPU seconds; goals: the monitor at most twice the bare"
            " eight, the bank at most 6 times one design",
        )
        memory = []
        for length in (ROWS // 4, ROWS, 4 * ROWS):
            part = Path(folder) / f"{length}.parquet"
            times, index = np.arange(length) * (t[1] - t[0]), np.arange(length) % ROWS
            fr.write_log(part, dict(zip(names, (times, *u[index].T, *y[index].T), strict=True)))
            memory.append({"rows": length, "MB": _peak(bank, part, Path(folder))})
        tables.table("monitoring_2_memory", "Memory of a bank by length of the log", memory, "peak resident size, MB")


def _peak(bank: fr.Bank, log: Path, folder: Path) -> float:
    """The peak memory of a process that runs the bank over a log."""
    fr.save(bank, folder / "bank.json")
    code = (
        "import sys; import faultrecon as fr; from faultrecon.io.running import run_file;"
        "from faultrecon.io.watched import monitoring; b = fr.load(sys.argv[1]);"
        "run_file(monitoring(b), b.plant.signals, sys.argv[2], out=sys.argv[3]);"
        "print(next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')))"
    )
    arguments = [sys.executable, "-c", code, str(folder / "bank.json"), str(log), str(folder / "watched.parquet")]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)  # noqa: S603 - ourselves
    return float(done.stdout.splitlines()[-1]) / 1024.0  # the kernel's own account: getrusage would tell the parent's


if __name__ == "__main__":
    tables.one_thread()
    main()
