# SPDX-License-Identifier: BSD-3-Clause
"""Pictures for Bezzaoucha et al. 2013: the fault by every kind of estimator, and what the window allows.

The paper's own figures cannot be drawn: input, gains, fault and length are not printed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from faultrecon.advise.papers._bezzaoucha2013_limits import CRLB, WINDOWS, bounds
from faultrecon.advise.papers._bezzaoucha2013_runs import ONSET, STEP, Case, dilution, estimated, states, times
from faultrecon.advise.papers._bezzaoucha2013_table import ENTRIES
from faultrecon.plot.figures import ALARM, CORRECTED, ESTIMATE, PLAIN, TRUTH, save
from faultrecon.plot.gallery import Trace, powers_figure, traces_figure

SHOWN = {
    "A1": "published optimum",
    "B": "simulate and invert",
    "R1": "repaired inequality",
    "C1": "mean-value polytope",
    "E3": "Kalman filter with gate",
}
COLOURS = (ALARM, PLAIN, CORRECTED, ESTIMATE, TRUTH)


def draw(out: Path, seed: int) -> tuple[Path, ...]:
    """Fault and estimates for each shape in noise, the start, and the bounds."""
    t = times()
    after = t >= ONSET - 10.0
    made = [
        (f"figure_{k}.png", traces_figure(t[after], traces(Case(shape, "", seed), after), title=f"Fault: {shape}"))
        for k, shape in enumerate(("step", "ramp", "sine"), start=1)
    ]
    start = Case("start", "", seed)
    early = t < 60.0
    made.append(("figure_4.png", traces_figure(t[early], traces(start, early), title="f = 0.4 from the start")))
    lines = {}
    for (begin, _), colour in zip(CRLB.items(), COLOURS, strict=True):
        x = states()[round(begin / STEP)]
        lines[f"from {begin:g} h"] = (bounds(x, begin, dilution), colour)
    across, up = "length of the window [h]", "least standard deviation of f"
    made.append(("figure_5.png", powers_figure(WINDOWS, lines, across=across, up=up)))
    for _, figure in made[:-1]:
        figure.axes[-1].set_xlabel("time [h]")
    return tuple(save(figure, out / name) for name, figure in made)


def traces(case: Case, where: NDArray[np.bool_]) -> list[Trace]:
    """One row per estimator: the true fault and its estimate."""
    rows = []
    for entry in ENTRIES:
        if entry.row in SHOWN and entry.there:
            found = estimated(entry, case)[0][where].clip(-1.0, 1.5)
            lines = {"true fault": (case.f[where], TRUTH), "estimate": (found, ESTIMATE)}
            rows.append(Trace(f"{entry.row}: {SHOWN[entry.row]}", "", lines))
    return rows
