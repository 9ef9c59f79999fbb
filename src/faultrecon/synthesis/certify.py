# SPDX-License-Identifier: BSD-3-Clause
"""From a theorem, the gains that ship and the multipliers to a certificate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.certificate import Certificate, Step, Verification
from faultrecon.finding import InputError
from faultrecon.lmi.expr import Expr, Inequality, let
from faultrecon.lmi.prove import fast_algebra, tree
from faultrecon.lmi.walk import leaves, substitute, value_of
from faultrecon.methods.base import Theorem
from faultrecon.plant.plant import Plant, exact_matrix

Array = NDArray[np.float64]


def shipped(theorem: Theorem, values: Mapping[str, Array]) -> dict[str, Array]:
    """The gains that ship, in the plant's units, as float64: this is the rounding."""
    return {unknown.name: value_of(formula, values) for unknown, formula in theorem.gains.items()}


def proof_inequalities(theorem: Theorem) -> list[Inequality]:
    """The inequalities with every gain variable replaced by the gains that ship (`Z := P L`)."""
    by = {unknown.name: let(unknown.name, formula) for unknown, formula in theorem.prove_with.items()}
    exprs = substitute([i.expr for i in theorem.inequalities], by)
    return [Inequality(e, i.sense, 0, i.label) for e, i in zip(exprs, theorem.inequalities, strict=True)]


def certificate(
    method: str, theorem: Theorem, plant: Plant, gains: Mapping[str, Array], values: Mapping[str, Array], level: float
) -> Certificate:
    """The sealed certificate of these gains with these multipliers; nothing is proved yet.

    gains: by letter, in the plant's units.  values: the multipliers by letter.  level: γ.
    """
    claims = _claims(theorem)
    exprs = [expr for _, _, expr, _ in claims]
    names = {u.name for u in theorem.gains} | {"γ"}
    data: dict[str, Any] = {}
    for name, leaf in leaves(exprs, "given").items():
        if not name.startswith("plant."):
            data[name] = exact_matrix(leaf.args[1])
    for name, leaf in leaves(exprs, "unknown").items():
        if name not in names:
            data[name] = exact_matrix(_symmetrised(leaf, values[name]))
    stored = {name: exact_matrix(np.atleast_2d(value)) for name, value in gains.items()}
    lets, steps = _definitions(exprs), _steps(theorem, claims)
    return Certificate(
        method, theorem.number, theorem.claim, theorem.scope, level, plant.to_dict(), stored, data, lets, steps
    ).sealed()


Claim = tuple[str, Literal["positive", "zero"], Expr, float]


def _claims(theorem: Theorem) -> list[Claim]:
    """Every claim about matrices: label, kind, matrix, tolerance."""
    found: list[Claim] = [(i.label, "positive", i.positive, 0.0) for i in proof_inequalities(theorem)]
    return found + [(i.label, "zero", i.expr, i.tolerance) for i in theorem.identities]


def _steps(theorem: Theorem, claims: list[Claim]) -> tuple[Step, ...]:
    steps = [Step(label, kind, tree(expr), tolerance) for label, kind, expr, tolerance in claims]
    return (*steps, *(Step(a.label, "premise", text=a.text, verdict=a.verdict) for a in theorem.premises))


def _definitions(exprs: list[Expr]) -> dict[str, Any]:
    return {name: tree(node.args[1]) for name, node in leaves(exprs, "let").items()}


def _symmetrised(leaf: Expr, value: Any) -> Array:
    array = np.asarray(value, dtype=float).reshape(leaf.shape)
    return 0.5 * (array + array.T) if leaf.args[1] else array


def prove(made: Certificate) -> Verification:
    """Prove a certificate with the fastest exact integers at hand."""
    return made.verify(fast_algebra())


def conforms(made: Certificate, theorem: Theorem) -> bool:
    """Whether a stored certificate states this theorem, and not something weaker with the same name.

    Claim, scope, definitions and steps have to be the theorem's own, and so do its given matrices (the plant's, and
    those like N and F⁺ that the observer derives again); the units T and R, coordinates that the theorem calls bases,
    multipliers, gains and the level are free, but for the sign of what the theorem calls bounds.
    """
    claims = _claims(theorem)
    exprs = [expr for _, _, expr, _ in claims]
    words = (made.theorem, made.claim, made.scope) == (theorem.number, theorem.claim, theorem.scope)
    same = made.steps == _steps(theorem, claims) and dict(made.lets) == _definitions(exprs)
    ships = {u.name: u.shape for u in theorem.gains} == {k: tuple(v["shape"]) for k, v in made.gains.items()}
    stored = {**made.data, **{f"plant.{k}": v for k, v in made.plant["matrices"].items()}}
    givens, free = leaves(exprs, "given"), {*UNITS, *theorem.bases}
    sure = all(np.all(gains_from({k: stored[k]})[k] >= 0) for k in theorem.bounds if k in stored)
    alike = all(stored.get(k) == exact_matrix(leaf.args[1]) for k, leaf in givens.items() if k not in free)
    return words and same and ships and sure and alike and made.level > 0


UNITS = ("T", "T⁻¹", "R", "R⁻¹", "U", "U⁻¹")
"""Letters of the scaling: any units serve, as long as T T⁻¹ = I, R R⁻¹ = I and U U⁻¹ = 1 hold."""


def gains_from(made: Mapping[str, Any]) -> dict[str, Array]:
    """Stored gains as arrays.  Raises InputError on damage."""
    try:
        return {
            str(name): np.array([float.fromhex(v) for v in value["hex"]]).reshape(value["shape"])
            for name, value in made.items()
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError("the stored gains are damaged", why=f"{type(error).__name__}: {error}") from error
