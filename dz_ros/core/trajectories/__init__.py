"""Trajectories, one a file; `TRAJECTORIES` finds them by name."""

from dz_ros.core.registry import Registry
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.core.trajectories.sinusoid import Sinusoid

TRAJECTORIES = Registry('trajectory', 'trajectory.kind', 'dz_ros.trajectories', Trajectory,
                        {item.name: item for item in (Sinusoid,)})
