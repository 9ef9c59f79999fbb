# SPDX-License-Identifier: BSD-3-Clause
"""A plant file to start from."""

from __future__ import annotations

from pathlib import Path

from faultrecon.finding import InputError
from faultrecon.io.library import read_library
from faultrecon.io.plantwrite import plant_text
from faultrecon.storage.atomic import write_text

TEMPLATE = """\
# A plant for faultrecon.  Matrices act on deviations from the operating point; logs carry absolute values.
schema = 1
name   = "mass on a spring with two position sensors"

[signals]                                  # "name [unit]"; a log's columns are matched by these names
x = ["position [m]", "velocity [m/s]"]
u = ["force [N]"]
y = ["position_a [m]", "position_b [m]"]
range = { position = 0.1, velocity = 0.3 } # expected deviations; they scale the design

[noise]                                    # per sensor, samples held for `hold` seconds
hold = 0.01
sd   = { position_a = 1e-3, position_b = 1e-3 }

[matrices]                                 # ẋ = A x + B u,  y = C x + D u
A = [[0.0, 1.0], [-10.0, -0.5]]
B = [[0.0], [1.0]]
C = [[1.0, 0.0], [1.0, 0.0]]

# [nonlinearity]                           # adds φ to the equations named in `into`
# into      = ["velocity"]
# phi       = ["-k3 * position**3"]
# constants = { k3 = 5.0 }
# domain    = { position = [-0.2, 0.2] }   # where the Lipschitz constant has to hold
# lipschitz = "derive"                     # proved over the domain; a number here is only assumed

[[disturbance]]                            # the level γ compares the reconstruction error with these
name = "unknown force"
into = { velocity = 1.0 }
size = 0.1                                 # the amplitude that counts as one
role = "attenuate"

[[disturbance]]
name = "noise of the healthy sensor"
on   = { position_a = 1.0 }
size = 1e-3
role = "attenuate"

[[fault]]
name   = "position_b_drift"
sensor = "position_b"
effect = "additive"
size   = 0.01
"""


def new_plant(path: Path, copy: str = "", force: bool = False) -> None:
    """Write a commented template, or a copy of the library plant `copy`.  Refuses to replace a file unless `force`."""
    if path.suffix.lower() != ".toml":
        raise InputError(f"{path}: a plant file ends in .toml")
    if path.exists() and not force:
        raise InputError(f"{path}: exists already", remedies=("choose another name", "add --force to replace it"))
    write_text(path, plant_text(read_library(copy)) if copy else TEMPLATE)
