# SPDX-License-Identifier: BSD-3-Clause
"""The command line: one question per verb."""

from __future__ import annotations


def main() -> None:
    """The `faultrecon` command."""
    from faultrecon.cli.app import run_app

    run_app()
