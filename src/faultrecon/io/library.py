# SPDX-License-Identifier: BSD-3-Clause
"""The plants that come with the package: examples of the papers and a recorded airliner."""

from __future__ import annotations

from importlib.resources import files
from importlib.resources.abc import Traversable

from faultrecon.finding import InputError, did_you_mean
from faultrecon.io.plantfile import parse_plant
from faultrecon.plant.plant import Plant


def library_names() -> tuple[str, ...]:
    """The names that `library` knows, in alphabetical order."""
    return tuple(sorted(_entries()))


def read_library(name: str) -> Plant:
    """One plant of the library.  Raises InputError with a suggestion when there is none of that name."""
    entries = _entries()
    if name not in entries:
        raise InputError(f"the library has no plant '{name}'", remedies=(did_you_mean(name, sorted(entries)),))
    entry = entries[name]
    if not entry.is_file():
        raise InputError(
            f"the file of the library plant '{name}' is missing",
            why=f"{entry.name} is not in this installation",
            remedies=("install faultrecon again",),
        )
    return parse_plant(entry.read_text(encoding="utf-8"), entry.name)


def _entries() -> dict[str, Traversable]:
    """The file of each plant, by name; the airliner's lives beside its recordings."""
    package = files("faultrecon")
    library = package / "plant" / "library"
    found = {e.name.removesuffix(".toml"): e for e in library.iterdir() if e.name.endswith(".toml")}
    return found | {"airliner": package / "data" / "airliner" / "airliner.toml"}
