# SPDX-License-Identifier: BSD-3-Clause
"""The verb `doctor`: what is installed, and whether the machinery works here."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

REQUIRED = ("numpy", "scipy", "clarabel", "python-flint", "casadi", "pyarrow", "pandas", "typer", "rich")
OPTIONAL = {"matplotlib": "plot", "plotly": "report", "control": "interop", "jsbsim": "studies", "dask": "studies"}


@dataclass(frozen=True)
class Health:
    """Versions by package (None: not installed) and checks by name with their outcome."""

    python: str
    packages: dict[str, str | None]
    checks: dict[str, str]

    @property
    def fine(self) -> bool:
        """True when every required package is there and every check passed."""
        return all(self.packages[name] for name in REQUIRED) and all(v == "fine" for v in self.checks.values())

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {"fine": self.fine, "python": self.python, "packages": self.packages, "checks": self.checks}

    def __str__(self) -> str:
        lines = [f"Python {self.python}"]
        for name, found in self.packages.items():
            need = (
                "" if found else f'  pip install "faultrecon[{OPTIONAL[name]}]"' if name in OPTIONAL else "  REQUIRED"
            )
            lines.append(f"  {name:14} {found or 'not installed'}{need}")
        lines += [f"  {name:28} {outcome}" for name, outcome in self.checks.items()]
        return "\n".join([*lines, "all is well" if self.fine else "something is missing or broken"])


def examine() -> Health:
    """Look up versions, and make and prove a small design."""
    packages = {name: _version(name) for name in (*REQUIRED, *OPTIONAL)}
    checks = {"design and proof": _design_works(), "exact integers agree": _integers_agree()}
    return Health(f"{platform.python_version()} on {platform.system()} {platform.machine()}", packages, checks)


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _design_works() -> str:
    from faultrecon.finding import FaultreconError
    from faultrecon.io.library import read_library
    from faultrecon.synthesis.pipeline import design

    try:
        found = design(read_library("lipschitz_polynomial")).verification
    except (FaultreconError, ImportError) as error:
        return f"failed: {error}"
    return "fine" if found is not None and found.sound else "failed: the proof does not hold"


def _integers_agree() -> str:
    from faultrecon.lmi.exact import DyadicAlgebra, prove_positive
    from faultrecon.lmi.prove import fast_algebra

    flat = [2.0, -1.0, 0.1, -1.0, 2.0, -1.0, 0.1, -1.0, 2.0]
    answers = [prove_positive(a.from_floats(3, 3, flat), a) for a in (DyadicAlgebra(), fast_algebra())]
    return "fine" if answers[0] == answers[1] and answers[0].verdict == "proved" else "failed: two engines disagree"
