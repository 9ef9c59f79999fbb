# SPDX-License-Identifier: BSD-3-Clause
"""From a theorem, the gains that ship and the multipliers to a certificate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

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
    claims = [(i.label, "positive", i.positive, 0.0) for i in proof_inequalities(theorem)]
    claims += [(i.label, "zero", i.expr, i.tolerance) for i in theorem.identities]
    exprs = [expr for _, _, expr, _ in claims]
    names = {u.name for u in theorem.gains} | {"γ"}
    data: dict[str, Any] = {}
    for name, leaf in leaves(exprs, "given").items():
        if not name.startswith("plant."):
            data[name] = exact_matrix(leaf.args[1])
    for name, leaf in leaves(exprs, "unknown").items():
        if name not in names:
            data[name] = exact_matrix(_symmetrised(leaf, values[name]))
    steps = [
        Step(label, "positive" if kind == "positive" else "zero", tree(expr), tolerance)
        for label, kind, expr, tolerance in claims
    ]
    steps += [Step(a.label, "premise", text=a.text, verdict=a.verdict) for a in theorem.premises]
    lets = {name: tree(node.args[1]) for name, node in leaves(exprs, "let").items()}
    stored = {name: exact_matrix(np.atleast_2d(value)) for name, value in gains.items()}
    return Certificate(
        method, theorem.number, theorem.claim, theorem.scope, level, plant.to_dict(), stored, data, lets, tuple(steps)
    ).sealed()


def _symmetrised(leaf: Expr, value: Any) -> Array:
    array = np.asarray(value, dtype=float).reshape(leaf.shape)
    return 0.5 * (array + array.T) if leaf.args[1] else array


def prove(made: Certificate) -> Verification:
    """Prove a certificate with the fastest exact integers at hand."""
    return made.verify(fast_algebra())


def conforms(made: Certificate, theorem: Theorem) -> bool:
    """Whether a stored certificate states this theorem, and not something weaker with the same name.

    Letters, definitions and steps have to be the theorem's own; only numbers may differ.
    """
    exprs = [i.positive for i in proof_inequalities(theorem)] + [i.expr for i in theorem.identities]
    stored = {s.label: s for s in made.steps}
    labels = [i.label for i in theorem.inequalities] + [i.label for i in theorem.identities]
    for label, expr in zip(labels, exprs, strict=True):
        if label not in stored or stored[label].tree != tree(expr):
            return False
    for identity in theorem.identities:
        if stored[identity.label].tolerance > identity.tolerance:
            return False
    return all(made.lets.get(k) == tree(node.args[1]) for k, node in leaves(exprs, "let").items())


def gains_from(made: Mapping[str, Any]) -> dict[str, Array]:
    """Stored gains as arrays.  Raises InputError on damage."""
    try:
        return {
            str(name): np.array([float.fromhex(v) for v in value["hex"]]).reshape(value["shape"])
            for name, value in made.items()
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError("the stored gains are damaged", why=f"{type(error).__name__}: {error}") from error
