# SPDX-License-Identifier: BSD-3-Clause
"""How well the fault is reconstructed from each recording: methods of faultrecon, and the extended Kalman filter.

    python examples/flexible_joint/baselines.py [METHOD ...]     # needs no simulator; the README's rows by default

Printed: error over fault, both as root mean square while the fault acts, in percent; for the healthy run the root mean
square of the estimate in mrad.
"""

import json
import sys
from dataclasses import replace
from functools import partial
from importlib.resources import files
from pathlib import Path

import kalman

import faultrecon as fr

NAME, FAULT = "flexible_joint_measured", "motor_encoder"
SHIPPED = Path(str(files("faultrecon") / "data" / "flexible_joint"))
KINDS = tuple(json.loads((SHIPPED / "provenance.json").read_text(encoding="utf-8"))["logs"])

AS_FAST_AS_THE_POLES = {"fix": {"W": 1 / 512}}  # Γ = ρ in units of the fault's size, ρ the method's bound on its poles
# label: (method, what is asked of it, whether the motor's friction is decoupled as the plant file says)
CASES = {
    "lipschitz-hinf": ("lipschitz-hinf", {}, True),
    "adaptive-uio": ("adaptive-uio", {}, True),
    "adaptive-uio, Γ = ρ": ("adaptive-uio", AS_FAST_AS_THE_POLES, True),
    "adaptive-uio, W free": ("adaptive-uio", {"free": ("W",)}, True),
    "adaptive-uio-noise": ("adaptive-uio-noise", {}, True),
    "adaptive-uio-full": ("adaptive-uio-full", {}, True),
    "augmented-uio": ("augmented-uio", {}, True),
    "attenuate: adaptive-uio": ("adaptive-uio", {}, False),
    "attenuate: adaptive-uio, Γ = ρ": ("adaptive-uio", AS_FAST_AS_THE_POLES, False),
    "attenuate: adaptive-uio-full": ("adaptive-uio-full", {}, False),
    "attenuate: augmented-uio": ("augmented-uio", {}, False),
}


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


def attenuated(plant):
    """The plant with nothing to be decoupled."""
    return replace(plant, disturbances=tuple(replace(d, role="attenuate") for d in plant.disturbances))


def by_method(plant, name, **options):
    """The estimate of a design by this method."""
    design = fr.design(plant, name, **options)
    return lambda log: fr.reconstruct(design, log)[f"f_{FAULT}"].to_numpy()


def main(methods):
    """Print one row per estimator."""
    plant = fr.library(NAME)
    rows = [("Kalman filter", partial(kalman.follow, plant))]
    for label, (name, options, decoupled) in ({m: (m, {}, True) for m in methods} or CASES).items():
        try:
            rows.append((label, by_method(plant if decoupled else attenuated(plant), name, **options)))
        except fr.FaultreconError as why:
            print(f"{label}: {why}\n")
    print(f"{'':32s}" + "".join(f"{kind:>11s}" for kind in KINDS))
    for label, estimate in rows:
        print(f"{label:32s}" + "".join(f"{value:11.2f}" for value in errors(plant, estimate).values()))


if __name__ == "__main__":
    main(sys.argv[1:])
