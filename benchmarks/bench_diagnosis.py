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
from faultrecon.cli.checking import examined
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
    """One table: milliseconds and Schur decompositions, for a whole check and per candidate fault."""
    rows = []
    for growing, label in ((0, "settles by itself"), (2, "two growing modes")):
        # What plants have in common is kept between calls, so every round gets a plant of its own.
        fresh = iter([plant(growing, seed) for seed in range(1, 200)])
        model = plant(growing)
        spent = tables.turns(
            {
                "schur": lambda model=model: [schur(model.A) for _ in range(SENSORS)],
                "check": lambda fresh=fresh: examined(next(fresh), with_sensors=False, as_json=False),
                "diagnose": lambda fresh=fresh: fr.diagnose(next(fresh)),
                "exists": lambda fresh=fresh: fault_sets(next(fresh), largest=1),
                "pairs": lambda fresh=fresh: fault_sets(next(fresh), largest=2),
                "margin": lambda fresh=fresh: detectability_margin((one := next(fresh)).A, one.C[1:]),
                "floor": lambda fresh=fresh: disturbance_floor(next(fresh).with_faults(["f0"])),
                "vectors": lambda model=model: np.linalg.eig(
                    np.block([[model.A, np.eye(STATES)], [-model.C.T @ model.C, -model.A.T]])
                ),
            },
            rounds=15,
        )
        schur_one = spent["schur"] / SENSORS
        pairs = SENSORS + SENSORS * (SENSORS - 1) // 2
        for what, seconds, shared in (
            ("the verb check: all faults together, each alone, and the methods", spent["check"], SENSORS),
            ("of that, fr.diagnose: existence, warnings and floors", spent["diagnose"], SENSORS),
            ("of that, at least: eigenvectors of order 2n, once for all floors", spent["vectors"], SENSORS),
            ("can each fault be reconstructed and isolated (check --sensors)", spent["exists"], SENSORS),
            ("the same for every pair too", spent["pairs"], pairs),
            ("distance to undetectability by search (check --json)", spent["margin"], 1),
            ("one floor alone, nothing shared", spent["floor"], 1),
        ):
            each = seconds / shared
            rows.append({"plant": label, "what": what, "ms": 1e3 * each, "Schur": each / schur_one})
    tables.table(
        "diagnosis",
        "What a diagnosis costs",
        rows,
        f"{STATES} states, {SENSORS} sensors, a fault on each; ms per candidate fault (or pair), and the same in Schur"
        " decompositions of A; goal: at most 10 for the verb",
    )


if __name__ == "__main__":
    tables.one_thread()
    main()
