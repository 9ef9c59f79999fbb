# SPDX-License-Identifier: BSD-3-Clause
"""The page about the command line, written from the program itself."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from typing import Any

from typer.main import get_command

from faultrecon import cli
from faultrecon.cli.app import app
from faultrecon_docs.text import code, page, prose, table

EXIT = {0: "fine", 1: "a negative finding", 2: "wrong usage or file", 3: "inconclusive or internal"}


def verbs() -> dict[str, Any]:
    """The commands by name, in the order in which they register."""
    for module in pkgutil.iter_modules(cli.__path__):
        import_module(f"{cli.__name__}.{module.name}")
    return dict(get_command(app).commands)  # type: ignore[attr-defined]  # a group has commands


def command_line_page() -> str:
    """Every verb with its arguments and options."""
    rows = [[f"[`{name}`](#faultrecon-{name})", prose(command.help or "")] for name, command in verbs().items()]
    codes = [[str(number), meaning] for number, meaning in EXIT.items()]
    return page(
        "# The command line",
        prose(app.info.help or ""),
        "One verb per question. `--json` on each prints the same answer as JSON; messages go to the error stream.",
        table(["verb", "what it answers or does"], rows),
        "(exit-codes)=\n## Exit codes",
        table(["code", "meaning"], codes),
        "130 is an interrupt from the keyboard; nothing half-written is left behind then.",
        *(_verb(name, command) for name, command in verbs().items()),
    )


def _verb(name: str, command: Any) -> str:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and "--help" not in p.opts]
    usage = " ".join(_usage(p) for p in arguments)
    rows = [[code(_title(p)), _default(p), prose(p.help or "")] for p in arguments]
    rows += [[code(", ".join([*p.opts, *p.secondary_opts])), _default(p), prose(p.help or "")] for p in options]
    return page(
        f"## faultrecon {name}",
        prose(command.help or ""),
        f"```text\n{' '.join(filter(None, ('faultrecon', name, usage, '[options]')))}\n```",
        table(["argument or option", "default", "meaning"], rows),
    )


def _title(parameter: Any) -> str:
    return (parameter.metavar or parameter.name).upper()


def _usage(parameter: Any) -> str:
    return _title(parameter) if parameter.required else f"[{_title(parameter)}]"


def _default(parameter: Any) -> str:
    if parameter.required:
        return "required"
    flag = getattr(parameter, "is_flag", False)
    return "" if flag or parameter.default in (None, "", ()) else code(str(parameter.default))
