# SPDX-License-Identifier: BSD-3-Clause
"""How well the fault is reconstructed from each recording: methods of faultrecon, and the extended Kalman filter.

    python examples/flexible_joint/baselines.py [METHOD ...]     # needs no simulator; lipschitz-hinf by default

Printed: error over fault, both as root mean square while the fault acts, in percent; for the healthy run the root mean
square of the estimate in mrad.
"""

import json
import sys
from functools import partial
from importlib.resources import files
from pathlib import Path

import kalman

import faultrecon as fr

NAME, FAULT = "flexible_joint_measured", "motor_encoder"
SHIPPED = Path(str(files("faultrecon") / "data" / "flexible_joint"))
KINDS = tuple(json.loads((SHIPPED / "provenance.json").read_text(encoding="utf-8"))["logs"])


def recorded(plant, kind):
    """One recording and its true fault."""
    log = fr.read_log(SHIPPED / f"{kind}.parquet", plant.signals)
    return log, log.extra[f"true_f_{FAULT}"]


def errors(plant, estimate):
    """Per kind: percent of the fault, or mrad where there is none.  estimate: a log in, the fault (N,) out."""
    found = {}
    for kind in KINDS:
        log, true = recorded(plant, kind)
        marks = fr.score(log.t, true, estimate(log))
        found[kind] = 100.0 * marks["nrmse"] if true.any() else 1e3 * marks["leak"]
    return found


def by_method(plant, name):
    """The estimate of a design by this method."""
    design = fr.design(plant, name)
    return lambda log: fr.reconstruct(design, log)[f"f_{FAULT}"].to_numpy()


def main(methods):
    """Print one row per estimator."""
    plant = fr.library(NAME)
    rows = [("Kalman filter", partial(kalman.follow, plant))]
    for name in methods:
        try:
            rows.append((name, by_method(plant, name)))
        except fr.FaultreconError as why:
            print(f"{name}: {why}\n")
    print(f"{'':24s}" + "".join(f"{kind:>11s}" for kind in KINDS))
    for name, estimate in rows:
        print(f"{name:24s}" + "".join(f"{value:11.2f}" for value in errors(plant, estimate).values()))


if __name__ == "__main__":
    main(sys.argv[1:] or ["lipschitz-hinf", "open-loop"])
