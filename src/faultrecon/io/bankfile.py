# SPDX-License-Identifier: BSD-3-Clause
"""Bank files: the designs of all hypotheses in one JSON document, each as a design file holds it."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from faultrecon.certificate import DAMAGE, read_document
from faultrecon.finding import Finding, InputError
from faultrecon.io.designfile import demand_sound, design_document, design_of, target, write_document
from faultrecon.plant.plant import Plant
from faultrecon.plant.stored import plant_from_dict
from faultrecon.synthesis.bank import Bank

SCHEMA = 1
KIND = "bank"
LARGEST = 1 << 28  # bytes: a design of a plant with a hundred states takes some 2 MB


def write_bank(bank: Bank, path: str | os.PathLike[str]) -> None:
    """Write a bank file atomically.

    Raises InputError, and writes nothing, when a certificate does not hold or the place takes no file.
    """
    file = target(path)
    for name, design in bank.designs.items():
        demand_sound(design, f"{file}: {name}")
    from faultrecon import __version__

    document = {
        "kind": f"faultrecon-{KIND}",
        "schema": SCHEMA,
        "written_by": f"faultrecon {__version__}",
        "plant": bank.plant.to_dict(),
        "designs": {name: design_document(design) for name, design in bank.designs.items()},
        "refused": {n: _plain(finding.as_dict(), f"{file}: refused: {n}") for n, finding in bank.refused.items()},
    }
    write_document(document, file)


def read_bank(path: str | os.PathLike[str], plant: Plant | None = None) -> Bank:
    """Read a bank, check each design as `read_design` does, and that it belongs to `plant` (if given).

    Raises InputError naming the file and the hypothesis.
    """
    source = os.fspath(path)
    document = read_document(source, KIND)
    if document.get("schema") != SCHEMA:
        raise InputError(
            f"{source}: the bank file has schema {document.get('schema')}",
            why=f"this version reads schema {SCHEMA}",
            remedies=("update faultrecon", "make the bank again"),
        )
    try:
        own = plant_from_dict(document["plant"])
        if plant is not None and _bare(plant).digest() != _bare(own).digest():
            raise InputError(
                f"{source}: is a bank for '{own.name}', not for this '{plant.name}'",
                remedies=("make the bank again from the plant file you run with",),
            )
        designs = {str(name): design_of(one, f"{source}: {name}") for name, one in document["designs"].items()}
        refused = {str(name): _finding(one) for name, one in document["refused"].items()}
    except KeyError as error:
        raise InputError(f"{source}: is damaged", why=f"{error} is missing", remedies=("make it again",)) from error
    except DAMAGE as error:
        why = f"{type(error).__name__}: {error}"
        raise InputError(f"{source}: is damaged", why=why, remedies=("make it again",)) from error
    if not designs:
        raise InputError(f"{source}: holds no design", remedies=("make the bank again",))
    return Bank(own, designs, refused)


def is_bank(path: str | os.PathLike[str]) -> bool:
    """Whether a file says that it is a bank; one that cannot be read, is no JSON or larger than `LARGEST` is none."""
    try:
        with open(path, encoding="utf-8") as file:
            if file.read(64).lstrip()[:1] != "{" or os.path.getsize(path) > LARGEST:
                return False  # most other files are known by their first character, and need not be read
            file.seek(0)
            document = json.load(file)
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, dict) and document.get("kind") == f"faultrecon-{KIND}"


def _bare(plant: Plant) -> Plant:
    """The plant without its faults, which a bank chooses itself."""
    return plant.with_faults([])


def _plain(value: Any, where: str) -> Any:
    """A value as JSON holds it, what is not finite as null.  Raises InputError on what it cannot hold."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): _plain(v, f"{where}: {k}") for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v, where) for v in value]
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist(), where)
    raise InputError(
        f"{where}: a {type(value).__name__} cannot be written",
        why="a bank file holds numbers, texts, lists and tables",
        remedies=("give the evidence of the finding as numbers or texts",),
    )


def _finding(document: dict[str, Any]) -> Finding:
    return Finding(**{**document, "remedies": tuple(document["remedies"])})
