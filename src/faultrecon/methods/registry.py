# SPDX-License-Identifier: BSD-3-Clause
"""Methods are discovered: every module of this package and every entry point of the group `faultrecon.methods`.

A third party's entry point that cannot be used (its import fails, it is no Method, its name is taken) takes only itself
out: the rest goes on, a warning says what is missing, and asking for it by name raises with the reason.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points

import faultrecon.methods as package
from faultrecon.finding import Finding, InputError, did_you_mean
from faultrecon.methods.base import Method

GROUP = "faultrecon.methods"


def all_methods() -> dict[str, Method]:
    """Every method by name: ours first, then those of installed third parties.

    Raises InputError when two methods of this package claim one name.
    """
    return _discovered()[0]


def refused_methods() -> dict[str, Finding]:
    """What third parties offer and cannot be used, by the name of the entry point, and why."""
    return dict(_discovered()[1])


@contextmanager
def offered(added: Method) -> Iterator[Method]:
    """For the time of a block a method is found under its name, installed or not: to try it before it is packaged."""
    known = all_methods()
    before = known.get(added.name)
    known[added.name] = added
    try:
        yield added
    finally:
        if before is None:
            del known[added.name]
        else:
            known[added.name] = before


@cache
def _discovered() -> tuple[dict[str, Method], dict[str, Finding]]:
    found: dict[str, Method] = {}
    for module in pkgutil.iter_modules(package.__path__):
        for value in vars(importlib.import_module(f"{package.__name__}.{module.name}")).values():
            if inspect.isclass(value) and issubclass(value, Method) and not inspect.isabstract(value):
                _add(found, value)
    refused: dict[str, Finding] = {}
    # Sorted, so that which of two third parties comes first does not depend on the order of installation.
    for point in sorted(entry_points(group=GROUP), key=lambda p: (p.name, p.value)):
        try:
            added = _loaded(point, found)
            found[added.name] = added
        except InputError as error:
            refused[point.name] = error.finding
            warnings.warn(str(error), stacklevel=2)
    return found, refused


def _add(found: dict[str, Method], kind: type[Method]) -> None:
    known = found.get(kind.name)
    if known is not None and type(known) is not kind:
        raise InputError(f"two methods are called '{kind.name}'", why=f"{type(known).__module__}, {kind.__module__}")
    found.setdefault(kind.name, kind())


def _loaded(point: EntryPoint, found: Mapping[str, Method]) -> Method:
    """The method of an entry point.  Raises InputError that names the entry point and who brought it."""
    brought = f" of {point.dist.name} {point.dist.version}" if point.dist is not None else ""
    where = f"the entry point {point.name} = {point.value}{brought}"
    remedies = ("report it to whoever publishes that package", "uninstall it")
    try:
        value = point.load()
    except (Exception, SystemExit) as error:  # whatever a stranger's module does concerns its method alone
        why = f"{type(error).__name__}: {error}"
        raise InputError(f"{where} cannot be imported", why=why, remedies=remedies) from error
    if not (inspect.isclass(value) and issubclass(value, Method)):
        raise InputError(f"{where} is no Method", why=f"it is {value!r:.60}", remedies=remedies)
    missing = sorted(getattr(value, "__abstractmethods__", ())) + [
        name for name in ("name", "summary", "paper") if not hasattr(value, name)
    ]
    if missing:
        raise InputError(f"{where} is not complete", why=f"it lacks {', '.join(missing)}", remedies=remedies)
    known = found.get(value.name)
    if known is not None and type(known) is not value:
        why = f"two methods are called '{value.name}', and {type(known).__module__} was there before"
        raise InputError(f"{where} is left out", why=why, remedies=remedies)
    return known or value()


def method(name: str) -> Method:
    """The method of that name.  Raises InputError with a suggestion, or with why a third party's cannot be used."""
    known = all_methods()
    if name not in known:
        refused = refused_methods()
        if name in refused:
            raise InputError(refused[name])
        raise InputError(f"there is no method '{name}'", why=did_you_mean(name, known))
    return known[name]


def list_methods(*, variants: bool = False) -> list[str]:
    """The names of all methods, baselines among them; variants of a method only when asked for."""
    return [name for name, found in all_methods().items() if variants or found.variant_of is None]


def cite(name: str) -> str:
    """The reference of a method."""
    return str(method(name).paper)
