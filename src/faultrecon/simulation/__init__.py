# SPDX-License-Identifier: BSD-3-Clause
"""Runs and how they are scored."""
