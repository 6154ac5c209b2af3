# SPDX-License-Identifier: Apache-2.0
"""Trajectories, one a file; `TRAJECTORIES` finds them by name."""

from dz_ros.core.registry import Registry
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.core.trajectories.chirp import Chirp
from dz_ros.core.trajectories.constant import Constant
from dz_ros.core.trajectories.multisine import Multisine
from dz_ros.core.trajectories.point_to_point import PointToPoint
from dz_ros.core.trajectories.reference_model import ReferenceModel
from dz_ros.core.trajectories.sinusoid import Sinusoid
from dz_ros.core.trajectories.waypoints import Waypoints

TRAJECTORIES = Registry('trajectory', 'trajectory.kind', 'dz_ros.trajectories', Trajectory, {
    item.name: item for item in (
        Sinusoid, Multisine, Chirp, Constant, PointToPoint, ReferenceModel, Waypoints)})
