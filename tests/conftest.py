# SPDX-License-Identifier: BSD-3-Clause
"""Tests leave the user's folders alone: compiled kernels stay in memory."""

import os

os.environ.setdefault("FAULTRECON_CACHE", "")
