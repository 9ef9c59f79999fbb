# SPDX-License-Identifier: BSD-3-Clause
"""Files written whole, and content hashes."""
