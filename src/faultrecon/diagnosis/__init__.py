# SPDX-License-Identifier: BSD-3-Clause
"""What can be reconstructed at all, and how well anyone could do it."""
