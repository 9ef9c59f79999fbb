# SPDX-License-Identifier: BSD-3-Clause
"""Nonlinear functions: stated once, then evaluated, differentiated, bounded and stored."""
