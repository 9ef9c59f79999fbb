# SPDX-License-Identifier: BSD-3-Clause
"""Pure functions on arrays: what linear algebra can say before any plant is named."""
