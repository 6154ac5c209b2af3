# SPDX-License-Identifier: Apache-2.0
"""Time and process: deadlines, process set-up, claims. Standard library only."""
