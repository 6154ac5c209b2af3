# SPDX-License-Identifier: Apache-2.0
"""A plant, a trajectory and a law of one's own for dz_ros."""
