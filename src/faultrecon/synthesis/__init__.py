# SPDX-License-Identifier: BSD-3-Clause
"""From conditions to gains to a proof: the well-posed design problem."""
