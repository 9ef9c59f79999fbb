# SPDX-License-Identifier: BSD-3-Clause
"""Loading and saving whatever the package reads and writes, chosen by the file's extension."""

from __future__ import annotations

import os
from pathlib import Path

from faultrecon.finding import InputError
from faultrecon.io.bankfile import is_bank, read_bank, write_bank
from faultrecon.io.designfile import read_design, write_design
from faultrecon.io.library import read_library
from faultrecon.io.matfile import read_mat, write_mat
from faultrecon.io.plantfile import read_plant
from faultrecon.io.plantwrite import write_plant
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.bank import Bank
from faultrecon.synthesis.result import Design


def load(path: str | os.PathLike[str], *, plant: Plant | None = None) -> Plant | Design | Bank:
    """A plant from a .toml or .mat file, or a design or a bank of designs from a .json file.

    plant: for a design or a bank, the plant it has to belong to.  Certificates are proved again before it is returned.
    Raises InputError with file, place, value and remedy.
    """
    kind = Path(path).suffix.lower()
    if kind == ".toml":
        return read_plant(path)
    if kind == ".mat":
        return read_mat(path)
    if kind == ".json":
        return read_bank(path, plant) if is_bank(path) else read_design(path, plant)
    raise InputError(
        f"{os.fspath(path)}: unknown kind of file", remedies=("plants are .toml or .mat, designs and banks are .json",)
    )


def save(thing: Plant | Design | Bank, path: str | os.PathLike[str]) -> None:
    """Write a plant as .toml or .mat, or a design or a bank as .json, whole or not at all.

    A refuted design is not written.
    """
    kind = Path(path).suffix.lower()
    if isinstance(thing, Plant) and kind == ".toml":
        write_plant(thing, path)
    elif isinstance(thing, Plant) and kind == ".mat":
        write_mat(thing, path)
    elif isinstance(thing, Design) and kind == ".json":
        write_design(thing, path)
    elif isinstance(thing, Bank) and kind == ".json":
        write_bank(thing, path)
    else:
        raise InputError(
            f"{os.fspath(path)}: cannot hold a {type(thing).__name__}",
            remedies=("save a Plant as .toml or .mat, a Design or a Bank as .json",),
        )


def library(name: str) -> Plant:
    """A plant of the library, by one of `library_names`.  Raises InputError with a suggestion."""
    return read_library(name)
