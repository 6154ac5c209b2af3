# SPDX-License-Identifier: Apache-2.0
"""Many closed loops offline: scenarios, the comparison of laws, sweeps, tuning."""
