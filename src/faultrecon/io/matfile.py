# SPDX-License-Identifier: BSD-3-Clause
"""Plants in MATLAB's .mat files (version 5), both ways, to the last bit.

Variables, by name; p sensors, n states, m inputs.  Only A and C are needed, the rest has the meaning of absence:

    A B C D                   matrices; B absent: no input, D absent: zero
    Ts                        sample time in s; absent or 0: continuous time
    name, source              text
    x_names u_names y_names   cell arrays of text; absent: x1.., u1.., y1..
    x_units u_units y_units   cell arrays of text
    x_ranges u_ranges y_ranges   expected deviations, NaN where undeclared
    u_limits y_limits         lowest and highest value that each device puts out, (k, 2); infinite where there is none
    x0 u0 y0                  operating point; absent: zero
    noise                     struct: hold (s), sd (p)
    faults                    struct array: name, site, effect, size, rate, signals (cell), coefficients
    disturbances              struct array: name, role, size, into_signals (cell), into_coefficients, on_signals, on_...
    faultrecon_schema         1

A file is data and never run, yet the reader of the .mat format is not hardened against files made to harm it: open
files of people you know.
"""

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Finding, InputError, did_you_mean
from faultrecon.io.matvalues import Place, Record
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.matrices import tell
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.storage.atomic import write_bytes

SCHEMA = 1
GROUPS = ("x", "u", "y")
NUMERIC = frozenset(
    ["double", "single", "logical", "sparse", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))]
)
KINDS: Mapping[str, frozenset[str]] = {
    **dict.fromkeys(("A", "B", "C", "D", "Ts", "x0", "u0", "y0", "faultrecon_schema"), NUMERIC),
    **{f"{g}_ranges": NUMERIC for g in GROUPS},
    **{f"{g}_limits": NUMERIC for g in GROUPS},
    **{f"{g}_{what}": frozenset({"cell", "char"}) for g in GROUPS for what in ("names", "units")},
    **dict.fromkeys(("name", "source"), frozenset({"char"})),
    **dict.fromkeys(("noise", "faults", "disturbances"), frozenset({"struct"})),
}
LARGEST = 10_000_000  # numbers in one variable: 80 MB; a plant of a thousand states has a tenth
CLASSES = {"opaque": "an object", "object": "an object", "function": "a function handle", "char": "text"}


# ---------------------------------------------------------------- writing


def write_mat(plant: Plant, path: str | os.PathLike[str]) -> None:
    """Write the plant as a .mat file, whole or not at all; `read_mat` gives the same plant to the last bit.

    Raises InputError for a plant with a nonlinear part, and for text that a .mat file would change.
    """
    source = os.fspath(path)
    if plant.nonlinearity is not None or plant.known is not None:
        raise InputError(
            f"{source}: a .mat file cannot hold the nonlinear part of {plant.name}",
            remedies=("save it as .toml", "write linearised(plant, x, u), its linear plant about a point"),
        )
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, _variables(plant), oned_as="column")
    # The header of the format is free text, by custom with the time; the same plant shall give the same bytes.
    data = b"MATLAB 5.0 MAT-file, written by faultrecon".ljust(116) + stream.getvalue()[116:]
    again = _plant(_loaded(data, source), source)
    written, read = plant.to_dict(), again.to_dict()
    lost = [key for key in written if written[key] != read[key]]
    if lost or again.source != plant.source:
        raise InputError(
            f"{source}: the plant cannot be written as .mat",
            why=f"{lost[0] if lost else 'source'} would change",
            remedies=("use names without blanks at their ends or control characters", "save it as .toml"),
        )
    write_bytes(path, data)


def _variables(plant: Plant) -> dict[str, Any]:
    out: dict[str, Any] = {"faultrecon_schema": float(SCHEMA), "name": plant.name, "source": plant.source}
    out |= {letter: getattr(plant, letter) for letter in "ABCD"}
    if plant.sample_time is not None:
        out["Ts"] = plant.sample_time
    for group in GROUPS:
        channels: Channels = getattr(plant.signals, group)
        out[f"{group}_names"], out[f"{group}_units"] = _cells(channels.names), _cells(channels.units)
        out[f"{group}_ranges"] = np.array(channels.ranges, dtype=float).reshape(-1, 1)
        if channels.limited():
            out[f"{group}_limits"] = np.array(channels.limits, dtype=float)
        out[f"{group}0"] = np.array(getattr(plant.point, group), dtype=float).reshape(-1, 1)
    if plant.noise is not None:
        out["noise"] = {"hold": plant.noise.hold, "sd": np.array(plant.noise.sd).reshape(-1, 1)}
    if plant.faults:
        out["faults"] = _structs(
            {"name": f.name, "site": f.site, "effect": f.effect, "size": float(f.size), "rate": float(f.rate)}
            | {"signals": _cells(f.on), "coefficients": _numbers(f.on)}
            for f in plant.faults
        )
    if plant.disturbances:
        out["disturbances"] = _structs(
            {"name": d.name, "role": d.role, "size": float(d.size)}
            | {"into_signals": _cells(d.into), "into_coefficients": _numbers(d.into)}
            | {"on_signals": _cells(d.on), "on_coefficients": _numbers(d.on)}
            for d in plant.disturbances
        )
    return {name: value for name, value in out.items() if not (isinstance(value, str) and value == "")}


def _cells(texts: Any) -> NDArray[np.object_]:
    """A column of text: a cell array."""
    column = np.empty((len(texts), 1), dtype=object)
    column[:, 0] = list(texts)
    return column


def _numbers(table: Mapping[str, float]) -> NDArray[np.float64]:
    return np.array(list(table.values()), dtype=float).reshape(-1, 1)


def _structs(rows: Any) -> NDArray[Any]:
    """A column of records: a struct array."""
    records = list(rows)
    out = np.empty((len(records), 1), dtype=[(field, object) for field in records[0]])
    for k, record in enumerate(records):
        for field, value in record.items():
            out[field][k, 0] = value
    return out


# ---------------------------------------------------------------- reading


def read_mat(path: str | os.PathLike[str]) -> Plant:
    """The plant in a .mat file, ours or anybody's that holds A and C.

    Warns with a `FindingWarning` of variables it has no use for.  Raises InputError with file, variable, value, remedy.
    """
    source = os.fspath(path)
    file = Path(path)
    if file.is_dir():
        raise InputError(f"{source}: is a folder, not a file", remedies=("name a file in it",))
    try:
        data = file.read_bytes()
    except OSError as error:
        raise InputError(f"{source}: cannot be read", why=error.strerror or str(error)) from error
    variables = _loaded(data, source)
    unused = sorted(set(variables) - set(KINDS))
    if unused:
        near = [f"'{name}': {hint}" for name in unused if (hint := did_you_mean(name, KINDS)).startswith("did you")]
        what = f"{source}: variables without a meaning here are not read: {', '.join(unused)}"
        tell([Finding(what, remedies=tuple(near), severity="warning")])
    return _plant(variables, source)


def _loaded(data: bytes, source: str) -> dict[str, Any]:
    """The variables of a file that have a meaning here, and None for the others.  Raises InputError."""
    from scipy.io import loadmat, whosmat

    if data[:10] == b"MATLAB 7.3" or data[:8] == b"\x89HDF\r\n\x1a\n":
        raise InputError(
            f"{source}: is a version 7.3 (HDF5) file",
            why="version 5 is read here",
            remedies=("in MATLAB: save('plant.mat', 'A', 'B', 'C', 'D', '-v7')", "in Octave: save -v7 plant.mat"),
        )
    if len(data) < 128 and not data[:4].strip(b"\0"):
        raise InputError(f"{source}: is empty or no .mat file", remedies=("write it again: save('plant.mat', '-v7')",))
    try:
        listed = whosmat(io.BytesIO(data))
    except Exception as error:  # the reader raises whatever a damaged file makes it stumble over
        _damaged(source, error)
    for name, shape, kind in listed:
        _check_kind(name, shape, kind, source)
    try:
        known = [name for name, _, _ in listed if name in KINDS]
        found = loadmat(io.BytesIO(data), variable_names=known) if known else {}
    except Exception as error:  # as above
        _damaged(source, error)
    structs = {name: kind for name, _, kind in listed if kind in ("struct", "opaque", "object")}
    if "A" not in found:
        _no_matrix(source, "A", [name for name, _, _ in listed], structs)
    return {name: found.get(name) for name, _, _ in listed}


def _damaged(source: str, error: Exception) -> NoReturn:
    raise InputError(
        f"{source}: cannot be read as a .mat file",
        why=f"it is damaged or of another kind ({type(error).__name__}: {str(error)[:80]})",
        remedies=("write it again: save('plant.mat', 'A', 'B', 'C', 'D', '-v7')",),
    ) from error


def _check_kind(name: str, shape: tuple[int, ...], kind: str, source: str) -> None:
    wanted = KINDS.get(name)
    if wanted is None:
        return
    if kind not in wanted:
        expected = "numbers" if wanted is NUMERIC else " or ".join(sorted(wanted))
        raise InputError(
            f"{source}: the variable {name} is {CLASSES.get(kind, f'a {kind}')}",
            why=f"it holds {expected} here",
            remedies=("rename it", f"give {name} as {expected}"),
        )
    if math.prod(shape) > LARGEST:
        raise InputError(f"{source}: the variable {name} has {math.prod(shape)} entries", why=f"{LARGEST} at most")


def _no_matrix(source: str, letter: str, names: Sequence[str], structs: Mapping[str, str]) -> NoReturn:
    remedies = [f"add it: save('{Path(source).name}', '{letter}', '-append')"]
    if letter.lower() in names:
        remedies = [f"rename the variable {letter.lower()} to {letter}"]
    for name, kind in structs.items():
        way = f"save('plant.mat', '-struct', '{name}', '-v7')" if kind == "struct" else f"[A,B,C,D] = ssdata({name})"
        remedies.append(f"unpack {name} first: {way}")
    listed = ", ".join(names) or "nothing"
    raise InputError(f"{source}: there is no variable {letter}", why=f"it holds {listed}", remedies=tuple(remedies))


def _plant(variables: Mapping[str, Any], source: str) -> Plant:
    at = {name: Place(source, name, value) for name, value in variables.items()}
    schema = at["faultrecon_schema"].scalar() if "faultrecon_schema" in at else float(SCHEMA)
    if schema > SCHEMA:
        why = f"this release reads {SCHEMA}"
        at["faultrecon_schema"].refuse(f"is {schema:g}", why, "use a newer release of faultrecon")
    matrices = _matrices(at, source)
    sizes = dict(zip(GROUPS, (matrices["A"].shape[0], matrices["B"].shape[1], matrices["C"].shape[0]), strict=True))
    point = None
    if any(f"{g}0" in at for g in GROUPS):
        values = [at[f"{g}0"].vector(size) if f"{g}0" in at else (0.0,) * size for g, size in sizes.items()]
        point = OperatingPoint(*values)
    try:
        return Plant(
            name=_title(at, source),
            signals=Signals(*(_channels(at, group, size) for group, size in sizes.items())),
            A=matrices["A"],
            B=matrices["B"],
            C=matrices["C"],
            D=matrices["D"],
            faults=tuple(map(_fault, at["faults"].records())) if "faults" in at else (),
            disturbances=tuple(map(_disturbance, at["disturbances"].records())) if "disturbances" in at else (),
            noise=_noise(at["noise"], sizes["y"]) if "noise" in at else None,
            operating_point=point,
            sample_time=(at["Ts"].scalar() if "Ts" in at else 0.0) or None,
            source=at["source"].text() if "source" in at else "",
        )
    except InputError as error:
        f = error.finding
        if f.what.startswith(f"{source}:"):
            raise
        raise InputError(f"{source}: {f.what}", why=f.why, remedies=f.remedies, see=f.see) from error


def _title(at: Mapping[str, Place], source: str) -> str:
    """What the file says; a stranger's plant that says nothing is called as its file is."""
    told = at["name"].text() if "name" in at else ""
    return told if told or "faultrecon_schema" in at else Path(source).stem


def _matrices(at: Mapping[str, Place], source: str) -> dict[str, NDArray[np.float64]]:
    if "C" not in at:
        _no_matrix(source, "C", list(at), {})
    A, C = at["A"].matrix(), at["C"].matrix()
    n, p = A.shape[0], C.shape[0]
    B = at["B"].matrix() if "B" in at else np.zeros((n, 0))
    B = B if B.size else np.zeros((n, 0))  # MATLAB's [] is 0 by 0 whatever stands beside it
    m = B.shape[1]
    D = at["D"].matrix() if "D" in at else np.zeros((p, m))
    D = D if D.size else np.zeros((p, m))
    found = {"A": A, "B": B, "C": C, "D": D}
    for letter, wanted in {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}.items():
        if found[letter].shape != wanted:
            why = f"{n} rows of A, {m} columns of B and {p} rows of C ask for {wanted}"
            at[letter].refuse(f"is {found[letter].shape}", why, f"check {letter}")
    return found


def _channels(at: Mapping[str, Place], group: str, size: int) -> Channels:
    def given(what: str) -> Place | None:
        return at.get(f"{group}_{what}")

    names, units, ranges, limits = (given(what) for what in ("names", "units", "ranges", "limits"))
    texts = tuple(f"{group}{k + 1}" for k in range(size)) if names is None else names.texts(size)
    if names is not None and units is None:  # "theta [rad]" says both
        plain = Channels.declared(texts)
    else:
        plain = Channels(texts, () if units is None else units.texts(size))
    return replace(
        plain,
        ranges=() if ranges is None else ranges.vector(size, finite=False),
        limits=() if limits is None else _limits(limits, size),
    )


def _limits(place: Place, size: int) -> tuple[tuple[float, float], ...]:
    """The lowest and the highest value of each signal."""
    pairs = place.matrix(finite=False)
    if pairs.shape != (size, 2):
        place.refuse(f"is {pairs.shape}", f"it has a row for each of {size} signals: [low, high]")
    return tuple((float(low), float(high)) for low, high in pairs)


def _noise(place: Place, sensors: int) -> Noise:
    rows = place.records()
    if len(rows) != 1:
        place.refuse(f"has {len(rows)} entries", "it is one struct with hold and sd")
    row = rows[0].only(("hold", "sd"))
    return Noise(row["hold"].scalar(), row["sd"].vector(sensors))


def _fault(row: Record) -> FaultChannel:
    row.only(("name", "site", "effect", "size", "rate", "signals", "coefficients"))
    return FaultChannel(
        row["name"].text(),
        row.table("signals", "coefficients"),
        site=cast(Any, row["site"].text() if "site" in row else "sensor"),
        effect=cast(Any, row["effect"].text() if "effect" in row else "additive"),
        size=row["size"].scalar() if "size" in row else 1.0,
        rate=row["rate"].scalar(finite=False) if "rate" in row else math.inf,
    )


def _disturbance(row: Record) -> Disturbance:
    coefficients = [f"{where}_{what}" for where in ("into", "on") for what in ("signals", "coefficients")]
    row.only(("name", "role", "size", *coefficients))
    return Disturbance(
        row["name"].text(),
        row.table("into_signals", "into_coefficients"),
        row.table("on_signals", "on_coefficients"),
        role=cast(Any, row["role"].text() if "role" in row else "attenuate"),
        size=row["size"].scalar() if "size" in row else 1.0,
    )
