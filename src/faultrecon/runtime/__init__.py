# SPDX-License-Identifier: BSD-3-Clause
"""Where time passes: estimators, step by step or over a whole log."""
