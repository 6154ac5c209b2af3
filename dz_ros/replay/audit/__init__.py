# SPDX-License-Identifier: Apache-2.0
"""The audit: every command and estimate of a run, recomputed and compared."""
