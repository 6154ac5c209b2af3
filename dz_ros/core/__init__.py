# SPDX-License-Identifier: Apache-2.0
"""Numbers: dead-zone, plants, trajectories, laws, closed loop. No ROS, file, clock, thread."""
