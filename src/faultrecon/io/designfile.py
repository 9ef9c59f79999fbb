# SPDX-License-Identifier: BSD-3-Clause
"""Design files: JSON with the plant, the gains and the certificate; numbers as hexadecimal floats."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from faultrecon.certificate import DAMAGE, Certificate, read_document
from faultrecon.finding import InputError
from faultrecon.methods.registry import method as method_named
from faultrecon.plant.plant import Plant, exact_matrix
from faultrecon.plant.stored import plant_from_dict
from faultrecon.storage.atomic import write_text
from faultrecon.synthesis.certify import conforms, gains_from
from faultrecon.synthesis.levels import scale
from faultrecon.synthesis.report import DesignReport
from faultrecon.synthesis.result import Design

SCHEMA = 1
REMAKE = ("make the design again from its plant file",)


def design_document(design: Design) -> dict[str, Any]:
    """A design as plain values."""
    from faultrecon import __version__

    return {
        "kind": "faultrecon-design",
        "schema": SCHEMA,
        "written_by": f"faultrecon {__version__}",
        "method": design.method,
        "plant": design.plant.to_dict(),
        "gains": {name: exact_matrix(value) for name, value in design.gains.items()},
        "optimum": design.optimum,
        "floor": design.floor,
        "details": design.details.as_dict(),
        "certificate": None if design.certificate is None else design.certificate.as_dict(),
    }


def target(path: str | os.PathLike[str]) -> Path:
    """The path of a design file to write.  Raises InputError on another extension, a folder, or a missing folder."""
    file = Path(path)
    if file.suffix.lower() != ".json":
        raise InputError(f"{file}: the extension is '{file.suffix}'", remedies=("a design file ends in .json",))
    if os.path.isdir(file) or not os.path.isdir(file.parent):  # pathlib's is_dir raises on a name that is too long
        why = "it is a folder" if os.path.isdir(file) else f"the folder {file.parent} does not exist"
        raise InputError(f"cannot write {file}", why=why)
    return file


def write_design(design: Design, path: str | os.PathLike[str]) -> None:
    """Write a design file atomically.

    Raises InputError, and writes nothing, when the certificate does not hold or the place takes no file.
    """
    file = target(path)
    demand_sound(design, str(file))
    write_document(design_document(design), file)


def demand_sound(design: Design, name: str) -> None:
    """Raises InputError when the certificate does not hold."""
    found = design.verification
    if found is not None and not found.sound:
        refuted = next(s for s in found.steps if s.verdict == "refuted")
        raise InputError(f"{name}: this design is not certified", why=str(refuted))


def write_document(document: Mapping[str, Any], file: Path) -> None:
    """Write plain values as JSON, whole or not at all.  Raises InputError when the place takes no file."""
    text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    try:
        write_text(file, text)
    except OSError as error:
        raise InputError(f"cannot write {file}", why=str(error.strerror or error)) from error


def read_design(path: str | os.PathLike[str], plant: Plant | None = None) -> Design:
    """Read a design, check that it belongs to `plant` (if given), states its method's theorem, and still holds.

    Raises InputError naming the file when it is damaged, of another plant, of a newer schema, or refuted.
    """
    source = os.fspath(path)
    return design_of(read_document(source), source, plant)


def design_of(document: Mapping[str, Any], source: str, plant: Plant | None = None) -> Design:
    """A design from plain values; as `read_design`, source being the name that errors give."""
    try:
        if document.get("schema") != SCHEMA:
            raise InputError(
                f"the design file has schema {document.get('schema')}",
                why=f"this version reads schema {SCHEMA}",
                remedies=("update faultrecon", "make the design again"),
            )
        own = plant_from_dict(document["plant"])
        if plant is not None:
            _demand_same(own, plant)
        return _checked(document, own)
    except InputError as error:
        raise InputError(f"{source}: {error.finding.what}", **_parts(error)) from error
    except KeyError as error:
        raise InputError(f"{source}: is damaged", why=f"{error} is missing", remedies=REMAKE) from error
    except DAMAGE as error:
        raise InputError(f"{source}: is damaged", why=f"{type(error).__name__}: {error}", remedies=REMAKE) from error


def _demand_same(own: Plant, plant: Plant) -> None:
    """The design's plant is this plant, or this plant with some of its faults taken as healthy."""
    names = [f.name for f in own.faults]
    if {*names} <= {f.name for f in plant.faults}:
        plant = plant.with_faults(names)
    if plant.digest() != own.digest():
        raise InputError(
            f"this is a design for '{own.name}', not for this '{plant.name}'",
            why=_difference(own.to_dict(), plant.to_dict()),
            remedies=("make the design again from the plant file you run with",),
        )


ORDER = ("signals", "names", "shape", "faults", "disturbances", "nonlinearity", "known", "noise", "A", "B", "C", "D")
"""Parts of a plant that people write, before those that follow from them."""


def _parts(error: InputError) -> dict[str, Any]:
    f = error.finding
    return {"why": f.why, "evidence": f.evidence, "remedies": f.remedies, "see": f.see}


def _checked(document: Mapping[str, Any], plant: Plant) -> Design:
    chosen = method_named(str(document["method"]))
    gains = gains_from(document["gains"])
    certificate = None if document["certificate"] is None else Certificate.from_document(document)
    details = DesignReport.from_dict(document["details"])
    level = None if certificate is None else certificate.level
    optimum, floor = (_level(document, name) for name in ("optimum", "floor"))
    design = Design(plant, chosen.name, gains, optimum, level, floor, certificate, details)
    if certificate is not None:
        if certificate.method != chosen.name or not conforms(certificate, chosen.theorem(plant, scale(plant))):
            raise InputError(
                f"the certificate does not state the theorem of {chosen.name}",
                why="its letters, definitions or claims differ from those this installation derives from the plant",
                remedies=("make the design again",),
            )
        found = design.verification
        if found is not None and not found.sound:
            raise InputError(
                "the certificate is refuted", why=str(next(s for s in found.steps if s.verdict == "refuted"))
            )
    return design


def _level(document: Mapping[str, Any], name: str) -> float | None:
    """A stored level; the certificate does not cover it, so it is only looked at for being a number."""
    value = document[name]
    if value is None or (isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value)):
        return None if value is None else float(value)
    raise InputError(f"{name} is {value!r:.40}", why="it is a number or null", remedies=REMAKE)


def _difference(a: Any, b: Any, path: str = "") -> str:
    """Where two plain values differ first, in words; what people would notice first comes first."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        if "hex" in a and a.get("shape") == b.get("shape"):
            k = next(k for k, (x, y) in enumerate(zip(a["hex"], b["hex"], strict=True)) if x != y)
            row, column = divmod(k, a["shape"][1])
            return _difference(a["hex"][k], b["hex"][k], f"{path}[{row}][{column}]")
        for key in sorted({*a, *b}, key=lambda k: (ORDER.index(k) if k in ORDER else len(ORDER), str(k))):
            if a.get(key) != b.get(key):
                return _difference(a.get(key), b.get(key), f"{path}.{key}".lstrip("."))
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            return f"{path} has {len(a)} entries in the design and {len(b)} in the plant"
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            if x != y:
                return _difference(x, y, f"{path}[{k}]")
    return f"{path} is {_shown(a)} in the design and {_shown(b)} in the plant"


def _shown(value: Any) -> str:
    if isinstance(value, str):
        try:
            return f"{float.fromhex(value):.9g}"
        except ValueError:
            return f"'{value[:40]}'"
    return str(value)[:60]
