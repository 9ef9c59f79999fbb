# SPDX-License-Identifier: BSD-3-Clause
"""What a sensor and its rates of change say about the state: derivatives of an output along the equations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

LARGEST = 60_000
"""Instructions up to which the next derivative is written out: a nonlinear one is a few times as long as the last."""


def lie_derivatives(h: Any, f: Any, x: Any, order: int, *, t: Any = None) -> list[Any]:
    """h, L h, L² h, ... up to the order asked for, with L = f·∂/∂x + ∂/∂t: columns of CasADi expressions.

    h: (m, 1) expression of x (n, 1), of time t where given, and of anything that does not move; f: (n, 1), the right
    side of ẋ = f.  Fewer come back where they grow beyond `LARGEST` instructions.
    """
    import casadi as ca

    def derived(last: Any) -> Any:
        along = ca.jtimes(last, x, f)
        return along if t is None else along + ca.jacobian(last, t)

    return _ladder(h, derived, order)


def shifted_outputs(h: Any, f: Any, x: Any, order: int, *, t: Any = None, step: float = 1.0) -> list[Any]:
    """h(x), h(f(x)), h(f(f(x))), ...: the same for x⁺ = f(x), t⁺ = t + step."""
    import casadi as ca

    def next_one(last: Any) -> Any:
        return (
            ca.substitute(last, x, f) if t is None else ca.substitute(last, ca.vertcat(x, t), ca.vertcat(f, t + step))
        )

    return _ladder(h, next_one, order)


def _ladder(first: Any, following: Callable[[Any], Any], order: int) -> list[Any]:
    import casadi as ca

    found = [first]
    while len(found) <= order:
        another = following(found[-1])
        symbols = ca.symvar(another)
        if symbols and ca.Function("size", symbols, [another]).n_instructions() > LARGEST:
            break
        found.append(another)
    return found
