# SPDX-License-Identifier: Apache-2.0
"""Runs: history of configurations, joined tables, the rule of sequences, metrics, timing."""
