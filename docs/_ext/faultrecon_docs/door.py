# SPDX-License-Identifier: BSD-3-Clause
"""The page about the Python calls: everything in `faultrecon.__all__`, sorted by what it is for."""

from __future__ import annotations

import inspect

import faultrecon
from faultrecon_docs.text import page

SECTIONS = {
    "From plant to design": ("load", "save", "library", "library_names", "diagnose", "design", "optimum", "verify"),
    "Logs": ("reconstruct", "replay", "read_log", "write_log", "score"),
    "Simulation": ("simulate", "Scenario", "Run", "compare", "study", "trial"),
    "Methods": ("list_methods", "cite", "reproduce"),
    "The nouns": ("Plant", "Signals", "Channels", "Noise", "OperatingPoint", "FaultChannel", "Disturbance",
                  "Lipschitz", "Graph"),
    "Answers": ("Diagnosis", "Design", "Certificate", "Estimator", "Log", "Finding"),
    "Errors": ("FaultreconError", "InputError", "Impossible", "Inconclusive", "MissingExtra"),
}  # fmt: skip
WITHOUT_MEMBERS = {"FaultreconError", "InputError", "Impossible", "Inconclusive", "MissingExtra"}


def sections() -> dict[str, list[str]]:
    """The public names by section; what no section claims comes last, so that nothing public is left out."""
    public = [name for name in faultrecon.__all__ if not name.startswith("__")]
    found = {title: [name for name in names if name in public] for title, names in SECTIONS.items()}
    claimed = {name for names in found.values() for name in names}
    found["More"] = [name for name in public if name not in claimed]
    return {title: names for title, names in found.items() if names}


def python_page() -> str:
    """The page in Markdown, with autodoc's directives."""
    parts = ["# Python", "`import faultrecon as fr` and everything below is there. It loads on first use."]
    for title, names in sections().items():
        parts += [f"## {title}", *(directive(name) for name in names)]
    return page(*parts)


def directive(name: str) -> str:
    """What autodoc is asked for."""
    value = getattr(faultrecon, name)
    kind = "function" if inspect.isroutine(value) else "exception" if name in WITHOUT_MEMBERS else "class"
    if inspect.isclass(value) and issubclass(value, BaseException):
        kind = "exception"
    options = "\n   :members:" if kind == "class" else ""
    return f"```{{eval-rst}}\n.. auto{kind}:: faultrecon.{name}{options}\n```"
