# SPDX-License-Identifier: BSD-3-Clause
"""Equations stated once as expression graphs, and read many ways."""
