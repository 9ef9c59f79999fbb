# SPDX-License-Identifier: BSD-3-Clause
"""What was found, why it is so, by which numbers, and what would change it.

A `Finding` is returned wherever something is diagnosed; at the edge of the library a fatal one becomes an
exception that carries it, so that a message reads the same in a report, on the command line and in a traceback.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Severity = Literal["fatal", "warning", "note"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Fact, cause, numbers, remedies, pointer: the five parts of a message somebody can act on.

    what: the fact, one sentence.  why: its cause.  evidence: the numbers behind it, by name.
    remedies: what the reader can do, each a clause.  see: paper, equation or page.
    """

    what: str
    why: str = ""
    evidence: Mapping[str, Any] = field(default_factory=dict)
    remedies: tuple[str, ...] = ()
    see: str = ""
    severity: Severity = "fatal"

    def __str__(self) -> str:
        text = self.what + (f": {self.why}" if self.why else "")
        if self.remedies:
            text += "; " + ", or ".join(self.remedies)
        return text + (f" ({self.see})" if self.see else "")

    def as_dict(self) -> dict[str, Any]:
        """The finding as plain values, for `--json`."""
        return {
            "what": self.what,
            "why": self.why,
            "evidence": dict(self.evidence),
            "remedies": list(self.remedies),
            "see": self.see,
            "severity": self.severity,
        }


class FaultreconError(Exception):
    """Base of every exception raised on purpose; `.finding` holds the parts of the message."""

    exit_code = 3

    def __init__(self, finding: Finding | str, **parts: Any) -> None:
        self.finding = finding if isinstance(finding, Finding) else Finding(finding, **parts)
        super().__init__(str(self.finding))


class InputError(FaultreconError, ValueError):
    """A file, an argument or a value is wrong: the caller can mend it."""

    exit_code = 2


class Impossible(FaultreconError):
    """A negative answer that is certain: the fault cannot be reconstructed as asked."""

    exit_code = 1


class Inconclusive(FaultreconError):
    """No answer was reached: a solver gave up, or a proof failed without a witness."""

    exit_code = 3


class MissingExtra(FaultreconError, ImportError):
    """An optional dependency is asked for and not installed."""

    exit_code = 2

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(
            f"{package} is not installed",
            why="it belongs to an optional extra",
            remedies=(f'run: pip install "faultrecon[{extra}]"',),
        )


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """'; did you mean X?' when some known word is close to the one given, else the list of known ones."""
    names = list(known)
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    if close:
        return f"did you mean '{close[0]}'?"
    return "known: " + ", ".join(names) if names else "none is declared"
