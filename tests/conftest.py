# SPDX-License-Identifier: BSD-3-Clause
"""Tests leave the user's folders alone (compiled kernels stay in memory), and share one way to run a command line."""

import os

import pytest

os.environ.setdefault("FAULTRECON_CACHE", "")


@pytest.fixture
def cli(capsys):
    """Runs a command line here; gives exit code, output and messages."""
    from faultrecon.cli.app import app

    def run(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            app([str(a) for a in arguments])
        return left.value.code or 0, *capsys.readouterr()

    return run
