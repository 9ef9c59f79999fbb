# SPDX-License-Identifier: BSD-3-Clause
"""Methods are discovered: every module of this package and every entry point of the group `faultrecon.methods`."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from importlib.metadata import entry_points

import faultrecon.methods as package
from faultrecon.finding import InputError, did_you_mean
from faultrecon.methods.base import Method

GROUP = "faultrecon.methods"


@cache
def all_methods() -> dict[str, Method]:
    """Every method by name: ours first, then those of installed third parties.

    Raises InputError when two methods claim one name or an entry point is no Method.
    """
    found: dict[str, Method] = {}
    for module in pkgutil.iter_modules(package.__path__):
        for value in vars(importlib.import_module(f"{package.__name__}.{module.name}")).values():
            if inspect.isclass(value) and issubclass(value, Method) and not inspect.isabstract(value):
                _add(found, value)
    for point in entry_points(group=GROUP):
        value = point.load()
        if not (inspect.isclass(value) and issubclass(value, Method)):
            raise InputError(f"the entry point {point.name} = {point.value} is no Method")
        _add(found, value)
    return found


def _add(found: dict[str, Method], kind: type[Method]) -> None:
    known = found.get(kind.name)
    if known is not None and type(known) is not kind:
        raise InputError(f"two methods are called '{kind.name}'", why=f"{type(known).__module__}, {kind.__module__}")
    found.setdefault(kind.name, kind())


def method(name: str) -> Method:
    """The method of that name.  Raises InputError with a suggestion."""
    known = all_methods()
    if name not in known:
        raise InputError(f"there is no method '{name}'", why=did_you_mean(name, known))
    return known[name]


def list_methods(*, variants: bool = False) -> list[str]:
    """The names of all methods, baselines among them; variants of a method only when asked for."""
    return [name for name, found in all_methods().items() if variants or found.variant_of is None]


def cite(name: str) -> str:
    """The reference of a method."""
    return str(method(name).paper)
