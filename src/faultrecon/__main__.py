# SPDX-License-Identifier: BSD-3-Clause
"""`python -m faultrecon`."""

from faultrecon.cli import main

main()
