# SPDX-License-Identifier: BSD-3-Clause
"""Bank files: the designs of all hypotheses in one JSON document, each as a design file holds it."""

from __future__ import annotations

import json
import os
from typing import Any

from faultrecon.certificate import DAMAGE, read_document
from faultrecon.finding import Finding, InputError
from faultrecon.io.designfile import demand_sound, design_document, design_of, target, write_document
from faultrecon.plant.plant import Plant
from faultrecon.plant.stored import plant_from_dict
from faultrecon.synthesis.bank import Bank

SCHEMA = 1
KIND = "bank"


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
        "refused": {name: finding.as_dict() for name, finding in bank.refused.items()},
    }
    write_document(json.loads(json.dumps(document, default=str)), file)


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
    """Whether a file says that it is a bank; a file that cannot be read is none."""
    try:
        with open(path, encoding="utf-8") as file:
            return f'"faultrecon-{KIND}"' in file.read(200)
    except (OSError, UnicodeDecodeError):
        return False


def _bare(plant: Plant) -> Plant:
    """The plant without its faults, which a bank chooses itself."""
    return plant.with_faults([])


def _finding(document: dict[str, Any]) -> Finding:
    return Finding(**{**document, "remedies": tuple(document["remedies"])})
