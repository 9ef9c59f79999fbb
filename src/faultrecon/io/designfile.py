# SPDX-License-Identifier: BSD-3-Clause
"""Design files: JSON with the plant, the gains and the certificate; numbers as hexadecimal floats."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

from faultrecon.certificate import Certificate, read_document
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


def write_design(design: Design, path: str | os.PathLike[str]) -> None:
    """Write a design file atomically.  Raises InputError, and writes nothing, when the certificate does not hold."""
    found = design.verification
    if found is not None and not found.sound:
        refuted = next(s for s in found.steps if s.verdict == "refuted")
        raise InputError(f"{os.fspath(path)}: this design is not certified", why=str(refuted))
    write_text(path, json.dumps(design_document(design), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def read_design(path: str | os.PathLike[str], plant: Plant | None = None) -> Design:
    """Read a design, check that it belongs to `plant` (if given), states its method's theorem, and still holds.

    Raises InputError naming the file when it is damaged, of another plant, of a newer schema, or refuted.
    """
    source = os.fspath(path)
    document = read_document(source)
    try:
        if document.get("schema") != SCHEMA:
            raise InputError(
                f"the design file has schema {document.get('schema')}",
                why=f"this version reads schema {SCHEMA}",
                remedies=("update faultrecon", "make the design again"),
            )
        own = plant_from_dict(document["plant"])
        if plant is not None and plant.digest() != own.digest():
            raise InputError(
                f"this is a design for '{own.name}', not for this '{plant.name}'",
                why=_difference(own.to_dict(), plant.to_dict()),
                remedies=("make the design again from the plant file you run with",),
            )
        return _checked(document, own)
    except KeyError as error:
        raise InputError(f"{source}: is damaged", why=f"{error} is missing") from error
    except InputError as error:
        raise InputError(f"{source}: {error.finding.what}", **_parts(error)) from error


def _parts(error: InputError) -> dict[str, Any]:
    f = error.finding
    return {"why": f.why, "evidence": f.evidence, "remedies": f.remedies, "see": f.see}


def _checked(document: Mapping[str, Any], plant: Plant) -> Design:
    chosen = method_named(document["method"])
    gains = gains_from(document["gains"])
    certificate = None if document["certificate"] is None else Certificate.from_document(document)
    details = DesignReport.from_dict(document["details"])
    level = None if certificate is None else certificate.level
    design = Design(plant, chosen.name, gains, document["optimum"], level, document["floor"], certificate, details)
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


def _difference(a: Any, b: Any, path: str = "") -> str:
    """Where two plain values differ first, in words."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in sorted({*a, *b}, key=str):
            if a.get(key) != b.get(key):
                return _difference(a.get(key), b.get(key), f"{path}.{key}".lstrip("."))
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
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
