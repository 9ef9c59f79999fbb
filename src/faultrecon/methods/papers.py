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

ALWI_2009 = Paper(
    "alwi2009",
    "Alwi, H.; Edwards, C.; Tan, C. P.",
    2009,
    "Sliding mode estimation schemes for incipient sensor faults",
    "Automatica 45, 1679-1685",
    "10.1016/j.automatica.2009.02.031",
)

BEZZAOUCHA_2013 = Paper(
    "bezzaoucha2013",
    "Bezzaoucha, S.; Marx, B.; Maquin, D.; Ragot, J.",
    2013,
    "State and multiplicative sensor fault estimation for nonlinear systems",
    "2nd International Conference on Control and Fault-Tolerant Systems (SysTol), Nice",
)

TAN_2003 = Paper(
    "tan2003",
    "Tan, C. P.; Edwards, C.",
    2003,
    "Sliding mode observers for robust detection and reconstruction of actuator and sensor faults",
    "International Journal of Robust and Nonlinear Control 13(5), 443-463",
    "10.1002/rnc.723",
)

TAN_2002 = Paper(
    "tan2002",
    "Tan, C. P.; Edwards, C.",
    2002,
    "Sliding mode observers for detection and reconstruction of sensor faults",
    "Automatica 38(10), 1815-1821",
    "10.1016/S0005-1098(02)00098-5",
)

JIA_2015 = Paper(
    "jia2015",
    "Jia, Q.; Chen, W.; Zhang, Y.; Jiang, Y.",
    2015,
    "Robust fault reconstruction in discrete-time Lipschitz nonlinear systems via Euler-approximate proportional "
    "integral observers",
    "Mathematical Problems in Engineering 2015, 741702",
    "10.1155/2015/741702",
)

JAZWINSKI_1970 = Paper(
    "jazwinski1970",
    "Jazwinski, A. H.",
    1970,
    "Stochastic processes and filtering theory",
    "Academic Press, New York",
)

JULIER_2004 = Paper(
    "julier2004",
    "Julier, S. J.; Uhlmann, J. K.",
    2004,
    "Unscented filtering and nonlinear estimation",
    "Proceedings of the IEEE 92(3), 401-422",
    "10.1109/JPROC.2003.823141",
)

HUANG_2024 = Paper(
    "huang2024",
    "Huang; Gao; Liu",
    2024,
    "Sensor fault reconstruction using robustly adaptive unknown-input observers",
    "Sensors 24(10), 3224",
    "10.3390/s24103224",
)
