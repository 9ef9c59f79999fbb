# SPDX-License-Identifier: BSD-3-Clause
"""One module per paper: its numbered results computed again, with what it printed and what we hold to be right."""
