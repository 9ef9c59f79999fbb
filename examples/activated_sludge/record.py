# SPDX-License-Identifier: BSD-3-Clause
"""Run Benchmark Simulation Model No. 1 in dry weather, let ammonium sensors foul in two of its tanks, record the logs.

    pip install bsm2-python                            # 0.0.16, BSD-3-Clause; Python 3.11
    python examples/activated_sludge/record.py         # two minutes
    python examples/activated_sludge/fit.py            # then: the two-state models, from the logs alone

What is written: one log for the first and one for the last aerated tank, and `provenance.json`.
"""

import argparse
import json
import os
import platform
import tempfile
from importlib.metadata import version
from pathlib import Path

import bsm2_python
import numpy as np
from bsm2_python.bsm1_ol import BSM1OL

STEP, EVERY = 1.0 / 1440.0, 5  # d; steps between two rows of a log
DAYS, SETTLING = 14, 2  # d; the dry-weather fortnight, and how often it passes before the record
ONSET, REACHED, LOSS = 168.0, 288.0, 0.35  # h, h; of its gain the sensor loses that much, steadily in between
NOISE, FINE, SEED = 0.1, 1e-3, 3  # g N/m3 on both analysers; resolution of the logs
VOLUME = 1333.0  # m3, of every aerated tank
XBA, SNH, FLOW = 5, 9, 14  # columns of the simulator: nitrifiers, ammonium, flow
TANKS = {"first_tank": (2, 3), "last_tank": (4, 5)}  # the reactor in front, where the feed is measured, and the tank


def settled(data):
    """The plant on the edge of the recorded fortnight: from the steady state that ships with the simulator."""
    dry = np.loadtxt(data / "dryinfluent.csv", delimiter=",")
    passes = [np.column_stack([dry[:, 0] + DAYS * k, dry[:, 1:]]) for k in range(SETTLING + 1)]
    plant = BSM1OL(data_in=np.vstack(passes), timestep=STEP)
    for k, row in enumerate(np.loadtxt(data / "asm1_values_ss_ps.csv", max_rows=5), start=1):
        getattr(plant, f"reactor{k}").y0 = row.copy()
    return plant


def run():
    """Times (N,), h, and what left the reactors 1 to 5, (N, 5, 21), over the recorded fortnight."""
    plant = settled(Path(bsm2_python.__file__).parent / "data")
    last = len(plant.simtime) - 1
    for i in range(last):
        plant.step(i)
    left = np.stack([getattr(plant, f"y_out{k}_all")[:last] for k in range(1, 6)], axis=1)
    t = 24.0 * (plant.simtime[:last] + STEP - SETTLING * DAYS)
    start = int(np.flatnonzero(t > -1e-9)[0])
    return np.maximum(t[start::EVERY], 0.0), left[start::EVERY]


def fouling(t):
    """The gain that is lost, as f in y = (1 + f) h."""
    return 0.0 - LOSS * np.clip((t - ONSET) / (REACHED - ONSET), 0.0, 1.0)


def table(t, left, tank, rng):
    """One log: what a recorder has, and the truth beside it."""
    before, inside = (left[:, k - 1] for k in TANKS[tank])
    f = fouling(t)
    noise = NOISE * rng.normal(size=(len(t), 2))
    return {
        "t": t,
        "dilution": inside[:, FLOW] / (24.0 * VOLUME),
        "feed_ammonium": before[:, SNH] + noise[:, 0],
        "ammonium": (1.0 + f) * inside[:, SNH] + noise[:, 1],
        "true_f_fouling": f,
        "true_x_nitrifiers": inside[:, XBA],
        "true_x_substrate": inside[:, SNH],
    }


def text(columns):
    """The log as CSV."""
    digits = {"t": 6, "dilution": 5, "true_f_fouling": 6}
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns)]
    places = [digits.get(name, round(-np.log10(FINE))) for name in columns]
    lines += [",".join(f"{v + 0.0:.{k}f}" for v, k in zip(row, places, strict=True)) for row in rows]
    return "\n".join(lines) + "\n"


def replace(path, content):
    """Write beside the target and rename, so that nobody ever reads half a file."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name + ".")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(content)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def provenance(t, logs):
    """Where the logs come from."""

    def ends(values):
        return [float(f"{v:.4g}") for v in (values.min(), values.mean(), values.max())]

    return {
        "simulator": "Benchmark Simulation Model No. 1, open loop, constant aeration, dry weather",
        "bsm2-python": version("bsm2-python"), "licence": "BSD-3-Clause", "python": platform.python_version(),
        "numpy": version("numpy"), "script": "examples/activated_sludge/record.py",
        "log": {"unit_of_time": "h", "sample_time": float(f"{np.diff(t).mean():.6g}"), "samples": len(t),
                "noise_sd_g_N_per_m3": NOISE, "noise_seed": SEED, "tank_volume_m3": VOLUME},
        "fault": {"sensor": "ammonium", "effect": "multiplicative", "onset_h": ONSET, "reached_h": REACHED,
                  "gain_lost": LOSS},
        "tanks": {name: {"tank": TANKS[name][1], "feed_measured_behind": TANKS[name][0],
                         "least_mean_largest": {k: ends(v) for k, v in log.items() if k not in ("t", "true_f_fouling")}}
                  for name, log in logs.items()},
    }  # fmt: skip


def main():
    """Record everything into the folder given by --out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("src/faultrecon/data/activated_sludge"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    t, left = run()
    rng = np.random.default_rng(SEED)
    logs = {tank: table(t, left, tank, rng) for tank in TANKS}
    for tank, columns in logs.items():
        replace(given.out / f"{tank}.csv", text(columns))
    replace(given.out / "provenance.json", json.dumps(provenance(t, logs), indent=1) + "\n")


if __name__ == "__main__":
    main()
