# SPDX-License-Identifier: BSD-3-Clause
"""The program text of one complete, regular sample, and of a loop over many.

Small observers become straight-line code: the very instructions that the general engine runs, in the same order, so the
results are the same bits as long as both use the same mathematical library.  For large ones, where straight-line code
takes long to compile, linear parts are loops over constant matrices; they add up in the same order, so the bits agree.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from faultrecon.graph.compiled import Program
from faultrecon.graph.extract import instructions, used
from faultrecon.graph.source import literal, statements
from faultrecon.runtime.general import REGULAR, General
from faultrecon.runtime.kernelloops import looped
from faultrecon.runtime.samples import Array, Mask
from faultrecon.runtime.stepping import Stepper

UNROLLED = (
    2000  # instructions of a step up to which straight-line code compiles as fast as loops do, 1.9 s, and runs faster
)

HEAD = """\
@part
def advance(before, t, after):
    t0 = before[{t}]
    if not (before[{samples}] > 0.0 and abs(t - t0 - {T}) <= {tolerance} + 2.0 * np.spacing(abs(t))):
        return 1
"""

TAIL = """\
    after[{t}] = t
    after[{samples}] = before[{samples}] + 1.0
    after[{gaps}] = before[{gaps}]
    for i in range({missing.start}, {missing.stop}):
        after[i] = 0.0
    for i in range({ok.start}, {ok.stop}):
        after[i] = 1.0
    return 0

@part
def note(u, y, after):
    for i in range({m}):
        after[{sample.start} + i] = u[i]
    for i in range({p}):
        after[{sample.start} + {m} + i] = y[i]

@kernel(int64(row, float64, vector, vector, row))
def one(before, t, u, y, after):
    if before.shape[0] != {width} or after.shape[0] != {width} or u.shape[0] != {m} or y.shape[0] != {p}:
        return 1
    note(u, y, after)
    return advance(before, t, after)

@kernel(int64(row, float64, vector, vector))
def over(place, t, u, y):
    if place.shape[0] != {width} or u.shape[0] != {m} or y.shape[0] != {p}:
        return 1
    note(u, y, place)
    return advance(place, t, place)

@kernel(int64(row, vector, table, table, int64, int64, into, into, into), nogil=True)
def many(place, t, u, y, first, last, fault, state, corrected):
    for k in range(first, last):
        for i in range({m}):
            place[{sample.start} + i] = u[k, i]
        for i in range({p}):
            place[{sample.start} + {m} + i] = y[k, i]
        if advance(place, t[k], place) != 0:
            return k
        for i in range({q}):
            fault[k, i] = place[{fault.start} + i]
        for i in range({n}):
            state[k, i] = place[{state.start} + i]
        for i in range({p}):
            corrected[k, i] = place[{corrected.start} + i]
    return last
"""


def program(general: General) -> Program:
    """What to compile for an observer.

    `one(before, t, u, y, after)` writes the row that follows `before` into `after` and returns 0.  It returns 1 when
    the sample is not plain: the first one, one with gaps, at an odd time or of another shape; `after` then holds
    nothing of use.  `over(place, t, u, y)` is the same in place; when it returns 1, only the copy of the sample has
    changed.  `many(place, t, u, y, first, last, fault, state, corrected)` takes the rows first to last of a log as far
    as they are plain, and returns how far it came.
    """
    lay, o = general.layout, general.observer
    complete: Mask = np.zeros(lay.p, dtype=bool)
    stepper = general.stepper(complete, complete)
    # v in the row before, u and y as they come, and what becomes of them
    measured = [f"u{i}" for i in range(lay.m)] + [f"y{i}" for i in range(lay.p)]
    rest = [*o.u0, *o.y0]
    lines = [f"{name} = after[{lay.sample.start + i}]" for i, name in enumerate(measured)]
    lines += [f"if not math.isfinite({name}):\n        return 1" for name in measured]
    if general.hold == "left":  # while time passed the older sample was read
        lines += [f"if before[{i}] != 0.0:\n        return 1" for i in range(lay.missing.start, lay.missing.stop)]
    lines += [f"v{i} = {name} - {literal(offset)}" for i, (name, offset) in enumerate(zip(measured, rest, strict=True))]
    plain = not o.scales and o.readout is None  # loops read f̂ and the corrected y off matrices alone
    limit = UNROLLED if plain else math.inf
    straight = o.A.size + o.B.size <= limit and _unrolled(general, stepper, limit)
    body, helpers, constants = straight or looped(general, stepper)
    places = {
        name: getattr(lay, name) for name in ("fault", "state", "corrected", "missing", "ok", "sample", "t", "width")
    }
    places |= {"samples": lay.t + 1, "gaps": lay.t + 2, "m": lay.m, "p": lay.p, "n": lay.n, "q": lay.q}
    step = literal(general.sample_time), literal(REGULAR * general.sample_time)
    head = HEAD.format(T=step[0], tolerance=step[1], **places)
    text = "\n".join([*helpers, head + _indented(lines + body), TAIL.format(**places)])
    return Program(text, constants)


def _unrolled(
    general: General, stepper: Stepper, limit: float
) -> tuple[list[str], list[str], Mapping[str, Array]] | None:
    """Straight-line code; None when it would be too long."""
    lay = general.layout
    nz, k = lay.nz, lay.m + lay.p
    nodes, outputs = instructions(stepper.regular)
    reading, results = instructions(general.reader)
    reading, results = used(reading, results[: lay.q + lay.n + lay.p])
    if len(nodes) + len(reading) > limit:
        return None
    after = [f"z{i}" for i in range(nz)] + [f"w{i}" for i in range(k)]
    before = [f"s{i}" for i in range(nz + k)]
    lines = [f"s{i} = before[{i}]" for i in range(nz + k)]
    lines += statements(nodes, outputs, [before, ["t0", *(f"v{i}" for i in range(k))]], after, "a")
    out = [f"r{i}" for i in range(lay.q + lay.n + lay.p)]
    lines += statements(reading, results, [[*after, *(f"y{i}" for i in range(lay.p))]], out, "b")
    lines += [f"after[{i}] = {name}" for i, name in enumerate(after)]
    lines += [f"after[{lay.fault.start + i}] = {name}" for i, name in enumerate(out)]
    return lines, [], {}


def _indented(lines: list[str]) -> str:
    return "".join(f"    {line}\n" for line in lines)
