# SPDX-License-Identifier: BSD-3-Clause
"""Run in the kernel of every page: shell cells whose output comes in one piece, and sharp figures."""

import subprocess

from IPython.core.error import UsageError
from IPython.core.getipython import get_ipython
from IPython.core.magic import register_cell_magic


@register_cell_magic
def bash(line: str, cell: str) -> None:
    """Run a cell as a shell script.  Unlike IPython's own magic, what it prints is not cut into pieces on the way."""
    done = subprocess.run(["bash", "-c", cell], capture_output=True, text=True, encoding="utf-8", check=False)  # noqa: S603, S607 - our own pages
    print(done.stdout + done.stderr, end="")
    if done.returncode and "--no-raise-error" not in line:
        raise UsageError(f"the cell ended with exit code {done.returncode}")


shell = get_ipython()
if shell is not None:
    shell.config.InlineBackend.figure_formats = {"svg"}
