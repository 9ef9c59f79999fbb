# SPDX-License-Identifier: BSD-3-Clause
"""What a diagnosis costs, in Schur decompositions of A: the one thing every answer about modes needs.

Read the ratios.  Everything runs in this process, on one thread, in CPU time, as the median of rounds in which the
contestants take turns.  Run it as

    python benchmarks/bench_diagnosis.py

The plants are random with 30 states, 10 sensors, noise on each and a fault on each: one that settles by itself, and one
with two modes that do not.
"""

from __future__ import annotations

import numpy as np
import tables
from scipy.linalg import schur

import faultrecon as fr
from faultrecon.diagnosis.limits import disturbance_floor
from faultrecon.diagnosis.sensors import fault_sets
from faultrecon.numerics.pencil import detectability_margin

STATES, SENSORS = 30, 10


def plant(growing: int, seed: int = 0) -> fr.Plant:
    """A random plant with so many growing modes, seen by every sensor."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((STATES, STATES)) / np.sqrt(STATES) - 1.5 * np.eye(STATES)
    A[:growing] = 0.0
    A[:growing, :growing] = np.diag(0.1 + 0.2 * np.arange(growing))
    T = np.linalg.qr(rng.standard_normal((STATES, STATES)))[0]
    A, C = T.T @ A @ T, rng.standard_normal((SENSORS, STATES))
    x, y = (tuple(f"{k}{i}" for i in range(size)) for k, size in (("x", STATES), ("y", SENSORS)))
    noise = [fr.Disturbance(f"noise of {name}", on={name: 1.0}, size=0.1) for name in y]
    return fr.Plant(
        "random",
        fr.Signals(fr.Channels(x), fr.Channels(()), fr.Channels(y)),
        A,
        np.zeros((STATES, 0)),
        C,
        np.zeros((SENSORS, 0)),
        faults=tuple(fr.FaultChannel(f"f{i}", {y[i]: 1.0}) for i in range(SENSORS)),
        disturbances=(fr.Disturbance("gust", dict.fromkeys(x, 1.0)), *noise),
    )


def main() -> None:
    """One table: seconds per candidate fault and per Schur decomposition."""
    rows = []
    for growing, label in ((0, "settles by itself"), (2, "two growing modes")):
        model = plant(growing)
        healthy = model.C[1:]
        one = model.with_faults(["f0"])
        spent = tables.turns(
            {
                "schur": lambda model=model: [schur(model.A) for _ in range(SENSORS)],
                "exists": lambda model=model: fault_sets(model, largest=1),
                "pairs": lambda model=model: fault_sets(model, largest=2),
                "distance": lambda model=model, healthy=healthy: detectability_margin(model.A, healthy),
                "floor": lambda one=one: disturbance_floor(one),
            },
            rounds=5,
        )
        schur_one = spent["schur"] / SENSORS
        pairs = SENSORS + SENSORS * (SENSORS - 1) // 2
        for what, seconds in (
            ("can each fault be reconstructed and isolated", spent["exists"] / SENSORS),
            ("the same for every pair too", spent["pairs"] / pairs),
            ("distance to undetectability", spent["distance"]),
            ("floor of any estimator", spent["floor"]),
        ):
            rows.append({"plant": label, "per fault or set": what, "ms": 1e3 * seconds, "Schur": seconds / schur_one})
    tables.table(
        "diagnosis",
        "What a diagnosis costs",
        rows,
        f"{STATES} states, {SENSORS} sensors, a fault on each; Schur: cost in Schur decompositions of A",
    )


if __name__ == "__main__":
    tables.one_thread()
    main()
