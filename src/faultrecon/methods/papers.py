# SPDX-License-Identifier: BSD-3-Clause
"""The papers that methods and baselines come from: one entry each, so that a reference is written once."""

from __future__ import annotations

from faultrecon.methods.base import Paper

KHOSROWJERDI_2011 = Paper(
    "khosrowjerdi2011",
    "Khosrowjerdi, M. J.",
    2011,
    "Robust sensor fault reconstruction for Lipschitz nonlinear systems",
    "Mathematical Problems in Engineering 2011, 146038",
    "10.1155/2011/146038",
)

HUANG_2024 = Paper(
    "huang2024",
    "Huang, J., Gao, Z. and Liu, Y.",
    2024,
    "Sensor fault reconstruction using adaptive unknown-input observers",
    "Sensors 24, 3224",
)
