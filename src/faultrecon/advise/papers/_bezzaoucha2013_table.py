# SPDX-License-Identifier: BSD-3-Clause
"""The table of results: every estimator on the same faults, without and with noise and with a model that is off.

References are our own, from an independent implementation.  The columns with noise are means of two draws, which are
not those of the references.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from faultrecon.advise.papers._bezzaoucha2013_levels import bounded_gains
from faultrecon.advise.papers._bezzaoucha2013_runs import (
    FREE,
    ONSET,
    SEEDS,
    Case,
    Entry,
    by_hand,
    driven,
    error,
    narrow,
    printed,
    reactor,
    repaired,
    rms,
)
from faultrecon.advise.reproductions import Comparison, Progress, Row
from faultrecon.methods.takagi_sugeno import TsPublished

ENTRIES: tuple[Entry, ...] = (
    Entry("A1", "published optimum", "ts-published", printed),
    Entry("A2", "published, |R| < 10", None, observer=lambda: TsPublished().observer(printed(), bounded_gains(10.0))),
    Entry("A3", "its structure, gains searched", None, observer=lambda: by_hand((1.6151, -1.5581), 11.6483, -0.1945)),
    Entry("A4", "its structure, L = 0, K = 5, α = 0", None, observer=lambda: by_hand((0.0, 0.0), 5.0, 0.0)),
    Entry("R1", "repaired inequality", "ts-guaranteed-cost", repaired),
    Entry("B", "simulate and invert", "simulate-invert"),
    Entry("C1", "mean-value polytope", "ts-mean-value", narrow),
    Entry("C2", "mean-value polytope, louder", "ts-mean-value", lambda: driven(narrow(), 0.01, 0.1)),
    Entry("D", "additive fault, a gain per vertex", "ts-additive", repaired),
    Entry("E1", "extended Kalman filter", "augmented-ekf", sampled=True),
    Entry("E5", "the same, q_f = 0.1", "augmented-ekf", lambda: driven(reactor(), 1e-3, 0.1), sampled=True),
    Entry("E2", "the same, q_x = 0.02", "augmented-ekf", lambda: driven(reactor(), 0.02, 0.02), sampled=True),
    Entry("E3", "the same, jump gate of 16", "augmented-ekf", fix={"gate": 16.0}, sampled=True),
    Entry("E4", "logarithmic Kalman filter", "log-ekf", fix={"gate": math.inf}, sampled=True),
    Entry("F", "unscented Kalman filter", "augmented-ukf", sampled=True),
)
"""The rows, by letter; a method that is not installed is left out and said."""

COLUMNS: tuple[str, ...] = (
    "clean step",
    "clean ramp",
    "clean sine",
    "noisy step",
    "noisy ramp",
    "noisy sine",
    "noisy, no fault",
    "a 2 % off, step",
    "d 2 % off, step",
)
KNOWN: Mapping[str, tuple[float | None, ...]] = {
    "A1": (0.39528, 0.40176, 0.41458, None, None, None, None, None, None),
    "A2": (0.39528, 0.40176, 0.41458, 0.39528, 0.40176, 0.41458, 0.0, 0.39528, 0.39528),
    "A3": (0.00634, 0.00326, 0.00712, 0.00778, 0.00557, 0.00840, 0.00455, 0.01234, 0.03056),
    "A4": (0.00752, 0.00272, 0.00827, 0.00863, 0.00496, 0.00927, 0.00409, 0.01155, 0.03006),
    "R1": (0.01106, 0.00401, 0.01232, 0.01157, 0.00514, 0.01271, 0.00324, 0.01385, 0.03089),
    "B": (3e-10, 0.0, 0.0, 0.00508, 0.00508, 0.00508, 0.00501, 0.00940, 0.02961),
    "C1": (0.01457, 0.00545, 0.01732, 0.01487, 0.00604, 0.01748, 0.00263, 0.01642, 0.03139),
    "C2": (0.02031, 0.00797, 0.02646, 0.02052, 0.00830, 0.02652, 0.00195, 0.02135, 0.03325),
    "D": (0.00973, 0.00415, 0.01326, 0.01040, 0.00543, 0.01374, 0.00361, 0.01243, 0.02938),
    "E1": (0.00464, 0.00140, 0.00439, 0.00598, 0.00402, 0.00576, 0.00380, 0.00978, 0.02958),
    "E5": (0.00420, 0.00010, 0.00032, 0.00649, 0.00495, 0.00496, 0.00489, 0.01024, 0.02999),
    "E2": (0.01578, 0.00652, 0.02910, 0.01590, 0.00676, 0.02918, 0.00366, 0.01576, 0.02746),
    "E3": (0.00433, 0.00037, 0.00161, 0.00571, 0.00380, 0.00407, 0.00380, 0.00976, 0.02985),
    "E4": (0.00571, 0.00165, 0.00634, 0.00666, 0.00378, 0.00715, 0.00380, 0.01014, 0.02954),
    "F": (0.00464, 0.00140, 0.00439, 0.00598, 0.00402, 0.00576, 0.00380, 0.00978, 0.02959),
}
"""RMSE of f by row and column: the fault window [60, 140), without fault [40, 59.8)."""
START = {
    "A4": (0.126, 0.085, 0.0031),
    "R1": (0.936, 0.764, 0.0041),
    "B": (0.129, 0.085, 0.0042),
    "C1": (0.056, 0.038, 0.0018),
}
"""RMSE of f in [10, 20), [20, 30), [30, 40) with f = 0.4 from the start."""


def cell(entry: Entry, column: str, seed: int) -> float:
    """RMSE of f in one cell of the table."""
    if column.startswith("clean"):
        return error(entry, Case(column.split()[1]))
    shape = column.split()[1] if column.startswith("noisy ") else "step"
    wrong = column[0] if column.endswith("off, step") else ""
    draws = [Case(shape, wrong, SEEDS * seed + k) for k in range(SEEDS)]
    if column == "noisy, no fault":
        return float(np.mean([error(entry, Case("step", "", one.seed), FREE) for one in draws]))
    return float(np.mean([error(entry, one) for one in draws]))


def results(seed: int, progress: Progress = lambda stage: None) -> list[Comparison]:
    """One table per estimator; what is not installed is a remark on the first."""
    present = [e for e in ENTRIES if e.there]
    absent = [f"{e.row} ({e.method})" for e in ENTRIES if not e.there]
    tables = []
    for entry in present:
        progress(f"{entry.row}: {entry.about}")
        rows = [
            Row(column, cell(entry, column, seed), value, *_tolerance(entry.row, column), note=_note(entry.row))
            for column, value in zip(COLUMNS, KNOWN[entry.row], strict=True)
            if value is not None
        ]
        remarks = (f"not installed, or refused: {', '.join(absent)}",) if absent and not tables else ()
        name = f"{entry.row}, {entry.about}" + (f" ({entry.method})" if entry.method else "")
        tables.append(Comparison(f"RMSE of the fault: {name}", rows, remarks))
    return tables


SMALL = 2e-5
"""RMSE of f that a reference with a fixed step of 0.02 h cannot tell from zero."""


def _tolerance(row: str, column: str) -> tuple[float, bool]:
    """What a cell is held to, and whether that is absolute."""
    if row in ("A1", "A2"):
        return 1e-4, True
    if row == "B" and column.startswith("clean"):
        return SMALL, True
    if row in ("D", "E4"):
        return 0.35, False
    if row[0] in "EF" and column.startswith("clean"):
        return 1e-4, True
    clean = {"A3": 0.16, "A4": 0.12}.get(row, 0.05)
    if column == "noisy, no fault":
        return 0.25, False  # twenty hours of an estimate that forgets in several: few independent pieces
    return (clean if column.startswith("clean") else max(clean, 0.15)), False


def _note(row: str) -> str:
    return {"A1": ZERO, "A2": ZERO, "A3": JUMPS, "A4": JUMPS, "D": TUNED, "E4": TUNED}.get(row, "")


ZERO = "f̂ stays at zero: the RMSE is the RMS of the fault"
JUMPS = (
    "readings on straight lines between samples: a jump arrives up to one sample, 0.02 h, early; these gains follow it"
    " in 0.06 h, so it shows"
)
TUNED = "the reference is tuned by sizes that are not known here; ours are those that the plant declares"


def floor() -> Comparison:
    """What two percent of d amount to, whatever the method."""
    t = Case("step").t
    least = rms(((1.0 + Case("step").f) * 0.02)[t >= ONSET])
    rows = []
    for e in ENTRIES:
        if e.there and e.row not in ("A1", "A2"):
            own = error(e, Case("step"))
            rows.append(Row(f"{e.row}: d 2 % off, no noise", error(e, Case("step", "d")), math.hypot(least, own), 0.2))
    about = f"The floor by the unit of concentration: {least:.4g}, RMS of (1 + f) δd/d, and the error without it"
    return Comparison(about, rows, (GAUGE,))


GAUGE = "(x1, x2, b, d) times s and (1 + f)/s are the same reading: every method that works meets the same floor"


def start_up(seed: int) -> Comparison:
    """f = 0.4 from the beginning, where nobody knows the state: errors in three stretches of ten hours."""
    rows = []
    for row, values in START.items():
        entry = next(e for e in ENTRIES if e.row == row)
        for k, value in enumerate(values):
            found = error(entry, Case("start", "", SEEDS * seed), (10.0 * (k + 1), 10.0 * (k + 2)))
            rows.append(Row(f"{row}: {10 * (k + 1)} to {10 * (k + 2)} h", found, value, 0.15 if k < 2 else 0.6))
    return Comparison("f = 0.4 from the start, one draw of noise", rows, (LATE,))


LATE = (
    "no method is right before about 30 h, as the limits say; the start of the filters hangs on a first variance that"
    " the references do not state, and is left out"
)


FORCED = {0.1: 0.0741, 1.0: 0.0169, 10.0: 0.0058}


def forced() -> Comparison:
    """Fault gains that the inequality does not find, with L = 0 and α = 0.05: β grows, the error falls."""
    rows = []
    for K, value in FORCED.items():
        entry = Entry("", "", None, observer=lambda K=K: by_hand((0.0, 0.0), K, 0.05))
        found = error(entry, Case("step"))
        rows.append(Row(f"K = {K:g}", found, value, 0.03 if K < 10 else 0.2, note=JUMPS if K == 10 else ""))
    return Comparison("RMSE of the fault, clean step, with K forced (β: 5.8e5, 5.1e7, 4e9)", rows)


def ranking(seed: int) -> Comparison:
    """Who beats whom, as ratios."""
    by = {e.row: e for e in ENTRIES}
    cells: dict[tuple[str, str], float] = {}

    def at(row: str, column: str) -> float:
        return cells.setdefault((row, column), cell(by[row], column, seed))

    pairs: list[tuple[str, Callable[[], float], float, float]] = [
        ("R1 over A1, clean step", lambda: at("R1", "clean step") / at("A1", "clean step"), 0.01106 / 0.39528, 0.06),
        ("B over E3, noisy ramp", lambda: at("B", "noisy ramp") / at("E3", "noisy ramp"), 0.00508 / 0.00380, 0.15),
        ("R1 over E3, noisy step", lambda: at("R1", "noisy step") / at("E3", "noisy step"), 0.01157 / 0.00571, 0.15),
        ("C1 over E3, noisy step", lambda: at("C1", "noisy step") / at("E3", "noisy step"), 0.01487 / 0.00571, 0.15),
    ]
    rows = [Row(name, ratio(), value, tol) for name, ratio, value, tol in pairs if by["E3"].there or "E3" not in name]
    return Comparison("Who is better", rows, (RANKING,))


RANKING = (
    "with a model to be trusted simulating and inverting is best without noise and passes noise on as it is; the filter"
    " with a gate is best in noise; the designs with a certificate are within a factor of four of it"
)
