# SPDX-License-Identifier: BSD-3-Clause
"""Files: plants, designs, logs."""
