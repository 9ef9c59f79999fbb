# SPDX-License-Identifier: BSD-3-Clause
"""The program itself and what its verbs share: options, and plants by file or by name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(
    name="faultrecon",
    help="Reconstruct the waveform of sensor faults, with a proof of what the observer guarantees.",
    epilog="Exit code 0: fine, 1: a negative finding, 2: wrong usage or file, 3: inconclusive or internal.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

Json = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]
PlantName = Annotated[
    str, typer.Argument(metavar="PLANT", help="A plant file (.toml, .mat) or the name of a library plant.")
]
Faults = Annotated[
    list[str] | None,
    typer.Option("--fault", help="Reconstruct only this fault; repeat for several. All by default."),
]


def plant_named(name: str) -> Any:
    """The plant of a file, or of the library."""
    from faultrecon.finding import InputError, did_you_mean
    from faultrecon.io.library import library_names, read_library
    from faultrecon.io.matfile import read_mat
    from faultrecon.io.plantfile import read_plant

    if name.endswith(".toml") or Path(name).exists():
        return read_mat(name) if name.lower().endswith(".mat") else read_plant(name)
    if name not in library_names():
        raise InputError(
            f"{name}: is neither a plant file nor a library plant", why=did_you_mean(name, library_names())
        )
    return read_library(name)
