# SPDX-License-Identifier: BSD-3-Clause
"""Matrix inequalities: stated once, then solved, proved and evaluated."""
