# SPDX-License-Identifier: Apache-2.0
"""Estimation of a plant and its dead-zone from samples."""
