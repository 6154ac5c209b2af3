# SPDX-License-Identifier: Apache-2.0
"""An actuator of one's own: as a driver class for dz_ros, and as a node without it."""
