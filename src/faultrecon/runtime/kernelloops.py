# SPDX-License-Identifier: BSD-3-Clause
"""The program text of one step of a large observer: loops over constant matrices instead of straight-line code.

Each sum runs in the order in which the general engine adds it up, so the bits agree.  Nonlinear terms, which are
usually few, stay straight-line code.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from faultrecon.graph.extract import instructions
from faultrecon.graph.source import literal, statements
from faultrecon.runtime.injecting import HUGE, TINY

if TYPE_CHECKING:
    from faultrecon.runtime.general import General
    from faultrecon.runtime.samples import Array
    from faultrecon.runtime.stepping import Stepper

# M[j] is column j of the matrix: the inner loop then runs over independent sums, which processors do side by side.
TIMES = """\
@part
def times(M, x, out):
    for i in range(out.shape[0]):
        out[i] = 0.0
    for j in range(M.shape[0]):
        for i in range(M.shape[1]):
            out[i] += M[j, i] * x[j]

@part
def add_times(M, x, out, term):
    times(M, x, term)
    for i in range(out.shape[0]):
        out[i] += term[i]

@part
def shifted(z, factor, k, out):
    for i in range(out.shape[0]):
        out[i] = z[i] + factor * k[i]
"""

SLOPE = """\
@part
def slope(z, v, t, out, term, n):
    times(A, z, out)
    add_times(B, v, out, term)
"""
SLOPE_MORE = """\
    nonlinear(z, v, t, n)
    add_times(N, n, out, term)
"""

RK4 = """\
k1, k2, k3, k4 = np.empty({nz}), np.empty({nz}), np.empty({nz}), np.empty({nz})
slope(z, start, t0, k1, term, n)
shifted(z, {half}, k1, x)
slope(x, middle, t0 + {half}, k2, term, n)
shifted(z, {half}, k2, x)
slope(x, middle, t0 + {half}, k3, term, n)
shifted(z, {h}, k3, x)
slope(x, end, t0 + {h}, k4, term, n)
for i in range({nz}):
    x[i] = z[i] + {sixth} * (((k1[i] + 2.0 * k2[i]) + 2.0 * k3[i]) + k4[i])
"""

ZOH = """\
times(Ad, z, x)
add_times(B0, start, x, term)
"""
ZOH_LINE = """\
add_times(B1, end, x, term)
"""
ZOH_MORE = """\
trial, stays = np.empty({nz}), np.empty({r})
nonlinear(z, start, t0, n)
stays[:] = n
add_times(N0, n, x, term)
for i in range({nz}):
    trial[i] = x[i]
add_times(N1, n, trial, term)
nonlinear(trial, end, t0 + {h}, n)
n[{own}:] = stays[{own}:]
add_times(N1, n, x, term)
"""

SAMPLED = """\
times(A, z, x)
add_times(B, start, x, term)
"""
SAMPLED_MORE = """\
nonlinear(z, start, t0, n)
add_times(N, n, x, term)
"""

# The rounds of `injecting.unit`, and what comes before and after them.
UNIT = """\
@part
def unit(b, knees, layer, count, x):
    r = 0.0
    for i in range(b.shape[0]):
        most = {huge} * knees[i]
        b[i] = b[i] if b[i] >= -most else -most
        b[i] = b[i] if b[i] <= most else most
    for _ in range(count):
        f, g = 0.0, 0.0
        for i in range(b.shape[0]):
            d = (r + layer) + knees[i]
            x[i] = b[i] / d
            q = x[i] * x[i]
            f, g = f + q, g + q / d
        size = math.sqrt(f)
        if layer == 0.0:
            move = (f * (size - 1.0)) / (g + {tiny})
            r = r + (move if move >= 0.0 else 0.0)
        else:
            a, c = f * (1.0 - size) - g * r, layer * (f * size)
            root = math.sqrt(a * a + 4.0 * (g * c))
            new = (2.0 * c) / (a + root + {tiny}) if a > 0.0 else (root - a) / (2.0 * g + {tiny})
            r = new if new >= r else r
    for i in range(b.shape[0]):
        x[i] = b[i] / ((r + layer) + knees[i])
"""

INJECT = """\
e_{i}, b_{i}, x_{i} = np.empty({k}), np.empty({k}), np.empty({k})
times(reads_{i}, x, e_{i})
add_times(direct_{i}, v, e_{i}, term)
times(measure_{i}, e_{i}, b_{i})
unit(b_{i}, knees_{i}, {layer}, {rounds}, x_{i})
add_times(pull_{i}, e_{i}, x, term)
add_times(push_{i}, x_{i}, x, term)
"""

READ = """\
for i in range({nz}):
    after[i] = x[i]
for i in range({k}):
    after[{nz} + i] = v[i]
shown = np.empty({q} + {n})
more = np.empty({q} + {n})
times(Rz, x, shown)
add_times(Rv, v, shown, more)
for i in range({q}):
    after[{fault} + i] = shown[i]
for i in range({n}):
    after[{state} + i] = x0[i] + shown[{q} + i]
taken = np.empty({p})
times(F, shown[:{q}], taken)
for i in range({p}):
    after[{corrected} + i] = after[{sample} + i] - taken[i]
"""


def looped(general: General, stepper: Stepper) -> tuple[list[str], list[str], Mapping[str, Array]]:
    """The body of `advance` from u, y and v1..vk on, the functions it calls, and the matrices it reads."""
    lay, o, h = general.layout, general.observer, general.sample_time
    k, r = lay.m + lay.p, stepper.N.shape[1]
    sizes = {"nz": lay.nz, "k": k, "p": lay.p, "n": lay.n, "q": lay.q, "r": r, "own": r - stepper.frozen}
    places = {"fault": lay.fault.start, "state": lay.state.start, "corrected": lay.corrected.start}
    places["sample"] = lay.sample.start + lay.m
    steps = {"h": literal(h), "half": literal(0.5 * h), "sixth": literal(h / 6.0)}
    constants = {"Rz": _columns(o.Cf, o.Cx), "Rv": _columns(o.Df, o.Dx), "F": o.F.T, "x0": o.x0}
    nonlinear = [_nonlinear(stepper)] if r else []
    if general.scheme == "rk4":
        constants |= {"A": stepper.A.T, "B": stepper.B.T, "N": stepper.N.T}
        helpers = [TIMES, *nonlinear, SLOPE + (SLOPE_MORE if r else "")]
        step = RK4
    elif general.scheme == "sampled":
        constants |= {"A": stepper.A.T, "B": stepper.B.T, "N": stepper.N.T}
        helpers = [TIMES, *nonlinear]
        step = SAMPLED + (SAMPLED_MORE if r else "")
    else:
        named = zip(("Ad", "B0", "B1", "N0", "N1"), stepper.matrices(h), strict=True)
        constants |= {name: matrix.T for name, matrix in named}
        helpers = [TIMES, *nonlinear]
        step = ZOH + (ZOH_LINE if general.hold == "linear" else "") + (ZOH_MORE if r else "")
        if stepper.moves:
            helpers.append(UNIT.format(huge=literal(HUGE), tiny=literal(TINY)))
            injected, more = _injections(stepper)
            step, constants = step + injected, constants | more
    lines = [f"z, v, older, n = np.empty({lay.nz}), np.empty({k}), np.empty({k}), np.empty({r})"]
    lines += [f"x, term, middle = np.empty({lay.nz}), np.empty({lay.nz}), np.empty({k})"]
    lines += [f"for i in range({lay.nz}):", "    z[i] = before[i]"]
    lines += [f"v[{i}] = v{i}" for i in range(k)]
    lines += [
        f"for i in range({k}):",
        f"    older[i] = before[{lay.nz} + i]",
        "    middle[i] = 0.5 * (older[i] + v[i])",
    ]
    held = {"left": "older, older, older", "midpoint": "middle, middle, middle", "linear": "older, middle, v"}[
        general.hold
    ]
    lines += [f"start, middle, end = {held}"]
    lines += (step + READ).format(**sizes, **places, **steps).splitlines()
    return lines, helpers, constants


def _nonlinear(stepper: Stepper) -> str:
    """φ and g at one instant as a function that fills n."""
    import casadi as ca

    nz, k = stepper.B.shape
    z, v, t = ca.SX.sym("z", nz), ca.SX.sym("v", k), ca.SX.sym("t")
    nodes, outputs = instructions(ca.Function("nonlinear", [z, v, t], [ca.densify(stepper.nonlinear(z, v, t))]))
    inputs = [[f"z[{i}]" for i in range(nz)], [f"v[{i}]" for i in range(k)], ["t"]]
    lines = statements(nodes, outputs, inputs, [f"n[{i}]" for i in range(len(outputs))], "a")
    return "@part\ndef nonlinear(z, v, t, n):\n" + "".join(f"    {line}\n" for line in lines)


def _injections(stepper: Stepper) -> tuple[str, dict[str, Array]]:
    """The implicit injections, one after the other, and the matrices they read."""
    text, constants = "", {}
    for i, (one, (act, rounds)) in enumerate(zip(stepper.observer.injections, stepper.moves, strict=True)):
        text += INJECT.format(i=i, k=len(one.reads), layer=literal(one.layer), rounds=rounds)
        named = {"reads": one.reads.T, "direct": one.direct.T, "measure": act.measure.T, "knees": act.knees}
        named |= {"pull": act.pull.T, "push": act.push.T}
        constants |= {f"{name}_{i}": matrix for name, matrix in named.items()}
    return text, constants


def _columns(upper: Array, lower: Array) -> Array:
    """Two matrices, one below the other, transposed."""
    import numpy as np

    return np.vstack([upper, lower]).T
