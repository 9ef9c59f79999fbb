# SPDX-License-Identifier: BSD-3-Clause
"""The nouns of the domain: signals, plants, faults."""
