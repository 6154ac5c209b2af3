# SPDX-License-Identifier: Apache-2.0
"""The experiment on a device that shows its dead-zone."""
