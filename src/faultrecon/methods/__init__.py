# SPDX-License-Identifier: BSD-3-Clause
"""One file per published method."""
