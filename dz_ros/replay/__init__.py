# SPDX-License-Identifier: Apache-2.0
"""Recorded runs computed again: audit, what-if, shadow."""
