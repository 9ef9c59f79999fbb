# SPDX-License-Identifier: BSD-3-Clause
"""A certificate and its checker; standard library alone.

A certificate holds the plant's numbers, the gains that ship, the multipliers, and every claim as an expression tree
over their letters.  `verify` trusts no verdict and no matrix in the file: it rebuilds each matrix exactly from the
numbers and proves each claim anew.  Verdicts: proved (exact arithmetic), checked (floating point), assumed (somebody
said so), refuted (a witness is shown).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Literal

from faultrecon.finding import InputError
from faultrecon.lmi.exact import (
    Dyadic,
    DyadicAlgebra,
    ExactError,
    IntMatrix,
    largest,
    letters_from,
    prove_positive,
    read_tree,
)
from faultrecon.storage.hashing import canonical_digest

Verdict = Literal["proved", "checked", "assumed", "refuted"]
STRENGTH: dict[str, int] = {"refuted": 0, "assumed": 1, "checked": 2, "proved": 3}
SCHEMA = 1
DAMAGE = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError)
"""What reading a file that is not what it should be can raise; ExactError is a ValueError."""


@dataclass(frozen=True)
class Step:
    """One claim.  kind "positive": the matrix of `tree` is positive definite; "zero": its entries vanish up to
    `tolerance`; "premise": `text` is taken from elsewhere with the verdict it has there."""

    label: str
    kind: Literal["positive", "zero", "premise"]
    tree: Any = None
    tolerance: float = 0.0
    text: str = ""
    verdict: Verdict = "assumed"

    def as_dict(self) -> dict[str, Any]:
        """Plain values; the verdict of a proof is not stored, only that of a premise."""
        if self.kind == "premise":
            return {"label": self.label, "kind": self.kind, "text": self.text, "verdict": self.verdict}
        tolerance = {"tolerance": float(self.tolerance).hex()} if self.kind == "zero" else {}
        return {"label": self.label, "kind": self.kind, "tree": self.tree, **tolerance}

    @staticmethod
    def from_dict(stored: Mapping[str, Any]) -> Step:
        """Read a stored step."""
        kind = stored["kind"]
        if kind == "premise":
            if stored["verdict"] not in ("assumed", "checked", "proved"):
                raise ExactError(f"a premise cannot be '{stored['verdict']}'")
            return Step(stored["label"], kind, text=stored["text"], verdict=stored["verdict"])
        if kind not in ("positive", "zero"):
            raise ExactError(f"no such kind of step: '{kind}'")
        tolerance = float.fromhex(stored["tolerance"]) if kind == "zero" else 0.0
        return Step(stored["label"], kind, stored["tree"], tolerance)


@dataclass(frozen=True)
class Checked:
    """What became of one step: its verdict, how it was reached, the margin or the witness."""

    label: str
    verdict: Verdict
    how: str
    margin: float | None = None
    witness: tuple[int, ...] = ()

    def __str__(self) -> str:
        margin = "" if self.margin is None else f", margin {self.margin:.3g}"
        return f"{self.verdict:8} {self.label}: {self.how}{margin}"


@dataclass(frozen=True)
class Verification:
    """The verdict on a whole certificate: refuted if any step is, else as strong as its weakest step."""

    steps: tuple[Checked, ...]

    @property
    def verdict(self) -> Verdict:
        """The weakest of the steps."""
        if not self.steps:
            return "refuted"
        return min((s.verdict for s in self.steps), key=STRENGTH.__getitem__)

    @property
    def sound(self) -> bool:
        """True unless something is refuted."""
        return self.verdict != "refuted"

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        steps = [
            {"label": s.label, "verdict": s.verdict, "how": s.how, "margin": s.margin, "witness": list(s.witness)}
            for s in self.steps
        ]
        return {"verdict": self.verdict, "steps": steps}

    def __str__(self) -> str:
        return "\n".join([f"verdict: {self.verdict}", *(f"  {s}" for s in self.steps)])


@dataclass(frozen=True)
class Certificate:
    """Claim, scope and steps over stored numbers.

    plant: `Plant.to_dict()`.  gains: what ships, by letter.  data: multipliers and scalings, by letter; every matrix as
    {"shape": [r, c], "hex": [...]}.  lets: named expressions in order.  digests: of plant, gains and statement.
    """

    method: str
    theorem: str
    claim: str
    scope: str
    level: float
    plant: Mapping[str, Any]
    gains: Mapping[str, Any]
    data: Mapping[str, Any]
    lets: Mapping[str, Any]
    steps: tuple[Step, ...]
    digests: Mapping[str, str] = field(default_factory=dict)

    def statement(self) -> dict[str, Any]:
        """What is claimed, without the numbers: definitions and steps.  Two designs of one method share it."""
        return {"theorem": self.theorem, "lets": dict(self.lets), "steps": [s.as_dict() for s in self.steps]}

    def current_digests(self) -> dict[str, str]:
        """The digests of what is stored now."""
        return {
            "plant": canonical_digest(self.plant),
            "gains": canonical_digest({"gains": self.gains, "level": float(self.level).hex()}),
            "statement": canonical_digest(self.statement()),
        }

    def sealed(self) -> Certificate:
        """The same certificate with its digests written down."""
        return Certificate(**{**self.__dict__, "digests": self.current_digests()})

    def verify(self, algebra: DyadicAlgebra | None = None) -> Verification:
        """Rebuild every matrix from the stored numbers and prove every claim again.

        algebra: exact integers to compute with; Python's own by default, `lmi.prove.fast_algebra()` for speed.
        """
        algebra = algebra or DyadicAlgebra(IntMatrix)
        checked = [self._identity()]
        try:
            letters = letters_from(self._numbers(algebra), self.lets, algebra)
        except DAMAGE as error:
            return Verification((*checked, Checked("statement", "refuted", f"it cannot be rebuilt: {error}")))
        checked += [_check(step, letters, algebra) for step in self.steps]
        if not any(step.kind == "positive" for step in self.steps):
            checked.append(Checked("statement", "refuted", "it claims no inequality"))
        return Verification(tuple(checked))

    def _identity(self) -> Checked:
        try:
            now = self.current_digests()
        except DAMAGE as error:
            return Checked("identity", "refuted", f"it cannot be read: {error}")
        changed = [key for key, value in now.items() if self.digests.get(key) != value]
        if changed:
            what = " and ".join("gains or γ" if key == "gains" else key for key in changed)
            return Checked("identity", "refuted", f"{what} changed after the certificate was made")
        return Checked("identity", "proved", "plant, gains and statement are the ones that were certified")

    def _numbers(self, algebra: DyadicAlgebra) -> dict[str, Dyadic]:
        numbers = {f"plant.{name}": read_matrix(value, algebra) for name, value in self.plant["matrices"].items()}
        for source in (self.gains, self.data):
            for name, value in source.items():
                if name in numbers or name == "γ":
                    raise ExactError(f"the letter {name} is stored twice")
                numbers[name] = read_matrix(value, algebra)
        return {**numbers, "γ": algebra.number(self.level)}

    def as_dict(self) -> dict[str, Any]:
        """The certificate as plain values, without plant and gains, which the design file holds beside it."""
        return {
            "schema": SCHEMA,
            "method": self.method,
            "theorem": self.theorem,
            "claim": self.claim,
            "scope": self.scope,
            "level": float(self.level).hex(),
            "data": dict(self.data),
            "lets": dict(self.lets),
            "steps": [s.as_dict() for s in self.steps],
            "digests": dict(self.digests),
        }

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> Certificate:
        """The certificate of a design document.  Raises InputError when a part is missing or malformed."""
        try:
            own = document["certificate"]
            if own is None:
                raise InputError("this design carries no certificate", why="it was made without a proof")
            if own["schema"] != SCHEMA:
                raise InputError(
                    f"the certificate has schema {own['schema']}",
                    why=f"this version reads schema {SCHEMA}",
                    remedies=("use the version of faultrecon that wrote it",),
                )
            return Certificate(
                str(own["method"]),
                str(own["theorem"]),
                str(own["claim"]),
                str(own["scope"]),
                float.fromhex(own["level"]),
                dict(document["plant"]),
                dict(document["gains"]),
                dict(own["data"]),
                dict(own["lets"]),
                tuple(Step.from_dict(s) for s in own["steps"]),
                {str(k): str(v) for k, v in own["digests"].items()},
            )
        except DAMAGE as error:
            if isinstance(error, InputError):
                raise
            raise InputError("the certificate is damaged", why=f"{type(error).__name__}: {error}") from error


def read_matrix(stored: Mapping[str, Any], algebra: DyadicAlgebra) -> Dyadic:
    """A stored matrix, exactly."""
    rows, columns = stored["shape"]
    return algebra.from_floats(rows, columns, [float.fromhex(v) for v in stored["hex"]])


def _check(step: Step, letters: Mapping[str, Dyadic], algebra: DyadicAlgebra) -> Checked:
    if step.kind == "premise":
        return Checked(step.label, step.verdict, step.text)

    def look(name: str) -> Dyadic:
        if name not in letters:
            raise ExactError(f"the letter {name} is not defined")
        return letters[name]

    try:
        value = read_tree(step.tree, look, algebra)
        if step.kind == "zero":
            top = largest(value)
            if top > Fraction(step.tolerance):
                return Checked(step.label, "refuted", f"an entry is {float(top):.3g}, allowed {step.tolerance:.3g}")
            return Checked(step.label, "proved", "exactly" if top == 0 else f"entries up to {float(top):.3g}")
        found = prove_positive(value, algebra)
    except DAMAGE as error:
        return Checked(step.label, "refuted", f"it cannot be rebuilt: {error}")
    return Checked(
        step.label, found.verdict, found.how, found.margin if found.verdict == "proved" else None, found.witness
    )


def read_document(path: str, kind: str = "design") -> dict[str, Any]:
    """A design file (or one of another kind) as plain values.  Raises InputError on a file that is not one."""
    try:
        with open(path, encoding="utf-8") as file:
            document = json.load(file)
    except OSError as error:
        raise InputError(f"{path}: cannot be read", why=str(error.strerror or error)) from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(
            f"{path}: is no {kind} file", why=f"it is no JSON: {error}", remedies=("write one: faultrecon design",)
        ) from error
    if not isinstance(document, dict) or document.get("kind") != f"faultrecon-{kind}":
        raise InputError(
            f"{path}: is no {kind} file",
            why=f'its "kind" is not "faultrecon-{kind}"',
            remedies=("write one: faultrecon design",),
        )
    return document


def load_certificate(path: str) -> Certificate:
    """The certificate in a design file.  Raises InputError on a file that is not one."""
    document = read_document(path)
    try:
        return Certificate.from_document(document)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def verify(path: str) -> Verification:
    """Prove the certificate in a design file again with the standard library alone.

    Raises InputError when the file is no design file.  The verdict is about the statement in the file; whether that is
    the theorem of its method is checked when the design is loaded.
    """
    return load_certificate(path).verify()
