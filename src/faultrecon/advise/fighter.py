# SPDX-License-Identifier: BSD-3-Clause
"""The demonstration on a fighter, unstable in pitch, whose pitch-rate gyro fails inside the loop that keeps it flying.

The logs are flights of JSBSim's nonlinear F-16, each flown three times: the loop reads the gyro as it is, as corrected
by a linear observer made by hand, and as corrected by the sliding-mode design.  The healthy sensors are the other two
gyros, which do not see the unstable mode: no estimator is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from faultrecon.advise.demonstration import DEGREES, Demonstration, Row, made_folder, shipped_log, write_results
from faultrecon.io.library import read_library
from faultrecon.io.logs import Log
from faultrecon.io.playback import Replay, replay
from faultrecon.runtime.estimator import Estimator
from faultrecon.simulation.metrics import FaultScore
from faultrecon.synthesis.pipeline import design
from faultrecon.synthesis.result import Design

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from faultrecon.plot.loops import Course, LoopColumn

Array = NDArray[np.float64]

METHOD, BASELINE, ALONE = "sliding-mode", "linear-observer", "same gains, nu=0"
FAULT = "pitch_rate"
FAULTS = {"ramp": "gyro drifts", "step": "gyro jumps", "sine": "gyro sways"}
LOOPS = {"faulty": "sensor as it is", "linear": "corrected, linear observer", "sliding_mode": "corrected, sliding mode"}
SHOWN = "ramp_sliding_mode"
START = 5000 * 0.3048  # m above the ground where every flight begins; examples/fighter/record.py
LINEAR_SPEED = 1.0  # of the linear observer that was flown: its pole over the unstable mode, likewise


@dataclass(frozen=True)
class Flown:
    """How far one flight strayed from the healthy one; pitch in °, altitude at its end in m, its length in s.

    least: what no linear estimator of these sensors stays below, by the linear model.
    """

    fault: str
    loop: str
    largest_pitch: float
    pitch_at_end: float
    altitude_at_end: float
    ended: float
    early: bool
    least: float


def fighter_demo(out: Path, progress: Callable[[float], None] | None = None) -> Demonstration:
    """Design for the gyro at fault, replay and score the shipped flights, show the loop with and without correction.

    out: folder, made if it does not exist.  Raises InputError when it cannot be written.
    """
    out, tell = made_folder(out), progress or (lambda part: None)
    plant = read_library("fighter")
    made, baseline = design(plant, METHOD), design(plant, BASELINE)
    names = [f"{fault}_{loop}" for fault in FAULTS for loop in LOOPS]
    names += ["healthy", *(f"healthy_{loop}" for loop in LOOPS if loop != "faulty")]
    rows: list[Row] = []
    done: dict[str, Replay] = {}
    for k, name in enumerate(names):
        log = shipped_log("fighter", name, plant)
        done[name] = replay(made, log)
        rows.append(Row(name, FAULT, _scores(baseline, done[name])))
        tell((k + 1) / len(names))
    flown = _flown(made, {name: d.log for name, d in done.items()})
    figures = {out / "fighter_overview.png": lambda: _figure(done, list(FAULTS))}
    figures |= {out / f"fighter_{fault}.png": lambda fault=fault: _figure(done, [fault]) for fault in FAULTS}
    written, note = write_results(
        out / "fighter_design.json", done[SHOWN], out / f"fighter_{SHOWN}_corrected.csv", figures
    )
    found = {"loop": [asdict(f) for f in flown]}
    return Demonstration(made, tuple(rows), written, note, tuple(_told(made, flown, done)), found)


def _scores(baseline: Design, done: Replay) -> dict[str, FaultScore]:
    """Of a linear observer of its own, of the design's gains without their injection, and of the design."""
    log, made = done.log, done.design
    linear = Estimator.build(replace(made.observer, injections=()), made.estimator(done.sample_time).sample_time)
    alone = Replay(made, log, linear.replay(log.t, log.u, log.y))
    found = {BASELINE: replay(baseline, log), ALONE: alone, METHOD: done}
    return {name: r.scores()[FAULT] for name, r in found.items()}


# ---------------------------------------------------------------- the loop


def _flown(made: Design, logs: Mapping[str, Log]) -> list[Flown]:
    healthy, found = logs["healthy"], []
    unstable = float(np.linalg.eigvals(made.plant.A).real.max())
    for name, log in ((n, log) for n, log in logs.items() if n != "healthy"):
        fault, _, loop = name.partition("_")
        off = DEGREES * (log.extra["true_x_theta"] - healthy.extra["true_x_theta"][: len(log)])
        found.append(
            Flown(
                "none" if fault == "healthy" else fault,
                loop,
                float(np.abs(off).max()),
                float(off[-1]),
                float(_altitude(log)[-1]),
                float(log.t[-1]),
                len(log) < len(healthy),
                _least(log, unstable),
            )
        )
    return found


def _least(log: Log, unstable: float) -> float:
    """What the pitch angle strays at least, °, whatever linear estimator corrects the gyro and whatever loop holds it.

    unstable: λ, 1/s.  The estimator's error is G f' with |G(λ)| = 1/λ, as no healthy sensor sees the mode λ; the loop
    turns it into pitch by T(s)/s with T(λ) = 1, as it stabilises that mode.  So in every such flight, from the onset
    on, |∫ exp(-λt) Δθ dt| = |∫ exp(-λt) f dt|/λ, and the largest |Δθ| is no less than |∫ exp(-λt) f dt|.
    """
    f = log.extra[f"true_f_{FAULT}"]
    if not f.any():
        return 0.0
    onset = int(np.flatnonzero(f)[0]) - 1
    t = log.t[onset:] - log.t[onset]  # 20 s and more: exp(-λt) leaves nothing of what comes after the log
    return float(DEGREES * abs(np.trapezoid(np.exp(-unstable * t) * f[onset:], t)))


def _altitude(log: Log) -> Array:
    """Height above ground, m, from the true speed and attitude: no altimeter is recorded."""
    speed, alpha, beta, phi, theta = (log.extra[f"true_x_{name}"] for name in ("V", "alpha", "beta", "phi", "theta"))
    ahead, across, down = np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)
    climb = speed * (ahead * np.sin(theta) - (across * np.sin(phi) + down * np.cos(phi)) * np.cos(theta))
    steps = np.diff(log.t) * (climb[1:] + climb[:-1]) / 2
    return START + np.concatenate([[0.0], np.cumsum(steps)])


def _told(made: Design, flown: list[Flown], done: Mapping[str, Replay]) -> list[str]:
    """The loop as text, and what it does not show."""
    by = {(f.fault, f.loop): f for f in flown}
    lines = [
        "The loop reads this gyro and nothing else.  Largest deviation in pitch from the healthy flight, in °",
        f"{'fault':6} {LOOPS['faulty']:50} {LOOPS['linear']:>26} {LOOPS['sliding_mode']:>24} {'at least':>9}",
    ]
    for fault in ("none", *FAULTS):
        plain, linear, ours = (by.get((fault, loop)) for loop in LOOPS)
        assert linear is not None and ours is not None, "every fault is flown with both corrections"
        as_is = ""
        if plain is not None:
            ended = f", ended {plain.altitude_at_end:.0f} m above ground at {plain.ended:.0f} s" if plain.early else ""
            as_is = f"{plain.largest_pitch:.1f}{ended}"
        least = "" if fault == "none" else f"{ours.least:9.2f}"
        lines.append(f"{fault:6} {as_is:50} {linear.largest_pitch:26.2f} {ours.largest_pitch:24.2f} {least}".rstrip())
    size = DEGREES * max(float(np.abs(done[f"{f}_faulty"].log.extra[f"true_f_{FAULT}"]).max()) for f in FAULTS)
    worst = max(f.largest_pitch for f in flown if f.loop == "faulty")
    return [*lines, "", *(line for said in _words(made, size, worst) for line in wrap(said, 118))]


def _words(made: Design, size: float, worst: float) -> tuple[str, ...]:
    """What the numbers mean.  size: of the faults, °/s.  worst: the largest deviation in pitch, °."""
    assert made.floor is not None and made.level is not None, "one mode is hidden, and the design has a certificate"
    by_hand = made.floor * (1 + 1 / LINEAR_SPEED)
    return (
        "What remains is about the estimator's error per rate times the change of the fault:"
        f" {by_hand:.2f} s (linear, made by hand) and {made.level:.2f} s (this design) times {size:.2g} °/s"
        f" are {by_hand * size:.1f}° and {made.level * size:.1f}°. It cannot vanish without another sensor:"
        " the healthy gyros do not see the unstable mode, and by the linear model no linear estimator stays below"
        " `at least`.",
        "The sliding mode leaves less because its design is faster, not because it slides: a faster linear observer"
        " leaves as little, and without the injection the same gains reconstruct as well, with half the noise.",
        "The corrected loop was analysed for the linear observer (examples/fighter/README.md); with the sliding mode"
        f" it was flown, not analysed. A log *_faulty ends up to {worst:.0f}° off, where the linear model holds no"
        " more: its scores say so. A delay ends with the last peak beyond 37 %, so noise on top of the lag makes it"
        " long.",
    )


# ---------------------------------------------------------------- figures


def _figure(done: Mapping[str, Replay], faults: list[str]) -> Figure:
    from faultrecon.plot.loops import loop_figure

    floor = done[SHOWN].design.floor
    return loop_figure(
        [_column(done, fault) for fault in faults],
        band_label=f"true fault ± floor ({floor:.3g} s) × |its rate|",
        title="F-16, unstable in pitch, its pitch-rate gyro at fault inside the loop",
    )


def _column(done: Mapping[str, Replay], fault: str) -> LoopColumn:
    from faultrecon.plot.figures import CORRECTED, PLAIN, TRUTH
    from faultrecon.plot.loops import Course, LoopColumn

    ours, styles = done[f"{fault}_sliding_mode"], {"faulty": (PLAIN, False), "linear": (CORRECTED, True)}
    log, truth, floor = ours.log, ours.truth(FAULT), ours.design.floor
    assert truth is not None and floor is not None, "the shipped logs carry their true fault, and one mode is hidden"
    logs = {"healthy": ("healthy flight", done["healthy"].log)}
    logs |= {loop: (f"loop: {LOOPS[loop]}", done[f"{fault}_{loop}"].log) for loop in LOOPS}

    def courses(signal: Callable[[Log], Array]) -> list[Course]:
        styled: dict[str, tuple[str, bool]] = {"healthy": (TRUTH, False), "sliding_mode": (CORRECTED, False)} | styles
        return [Course(label, g.t, signal(g), *styled[k], ended=k == "faulty") for k, (label, g) in logs.items()]

    return LoopColumn(
        FAULTS[fault],
        log.t,
        DEGREES * truth,
        DEGREES * ours.trace.fault[:, 0],
        DEGREES * floor * np.abs(np.gradient(truth, log.t)),
        "deg/s",
        {
            ("pitch angle", "deg"): courses(lambda g: DEGREES * g.extra["true_x_theta"]),
            ("height above ground", "m"): courses(_altitude),
        },
        f"nrmse {ours.scores()[FAULT].nrmse:.3g}",
    )
