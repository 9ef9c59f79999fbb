# SPDX-License-Identifier: BSD-3-Clause
"""Bezzaoucha et al. 2013: the published inequality and why its fault gain is zero, what works instead, and limits.

The paper prints vertices, premise bounds and a fault interval; no a, no input, no fault, no gain and no β.  Its figures
cannot be reproduced.  The references are our own, from an independent implementation.
"""

from __future__ import annotations

import time
from pathlib import Path

from faultrecon.advise.papers._bezzaoucha2013_levels import factors, published, repaired_designs, sector_form, variants
from faultrecon.advise.papers._bezzaoucha2013_limits import gauges, information, open_loop, printed_observer
from faultrecon.advise.papers._bezzaoucha2013_table import floor, forced, ranking, results, start_up
from faultrecon.advise.reproductions import Comparison, Progress, Reproduced
from faultrecon.methods.papers import BEZZAOUCHA_2013

CLAIMS = (
    "What holds of the paper's claims.  The sector form is exact: holds, for a = 0.5, which is not printed.  Theorem 1"
    " is feasible: holds, with ten corrections, and trivially: all A_i share a decay rate with L = 0.  State and fault"
    " are estimated: does not hold.  The inequality is invariant under K_i to -K_i, so its best fault gain is zero and"
    " f̂ stays at zero; its β exceeds one, the gain of x̂ = 0, f̂ = 0.  The observer's structure works with gains that"
    " the inequality does not find, and an inequality that keeps diag(ĥ) F in the innovation finds some.  What no"
    " method removes: one percent of c, or of b and d together, is one percent of the sensor's gain; and before the"
    " substrate has fallen the fault cannot be told at all."
)


def reproduction(out: Path | None, seed: int, progress: Progress) -> Reproduced:
    """All tables, and figures into `out`.  seed: two draws of noise belong to each."""
    started = time.perf_counter()
    progress("the published inequality")
    tables: list[Comparison] = [sector_form(), published(), variants(), printed_observer()]
    progress("repaired designs and limits")
    tables += [factors(), repaired_designs(), information(), open_loop(), gauges()]
    tables += simulated(seed, progress)
    figures: tuple[Path, ...] = ()
    if out is not None:
        from faultrecon.advise.papers._bezzaoucha2013_figures import draw

        progress("figures")
        figures = draw(out, seed)
    seconds = time.perf_counter() - started
    return Reproduced("bezzaoucha2013", str(BEZZAOUCHA_2013), tables, figures, CLAIMS, seconds)


def simulated(seed: int, progress: Progress = lambda stage: None) -> list[Comparison]:
    """The table of results, the floor by a wrong constant, the start, and who is better."""
    return [*results(seed, progress), forced(), floor(), start_up(seed), ranking(seed)]
