# SPDX-License-Identifier: Apache-2.0
"""Plants in normal form, one a file; `PLANTS` finds them by name."""

from dz_ros.core.plants.axis import Axis
from dz_ros.core.plants.base import Plant
from dz_ros.core.plants.first_order import FirstOrder
from dz_ros.core.plants.pendulum import Pendulum
from dz_ros.core.plants.rov_planar import RovPlanar
from dz_ros.core.plants.servo import Servo
from dz_ros.core.plants.thruster import Thruster
from dz_ros.core.plants.two_link_arm import TwoLinkArm
from dz_ros.core.plants.valve_actuator import ValveActuator
from dz_ros.core.plants.wang2004 import Wang2004
from dz_ros.core.plants.zhang_feng1997 import ZhangFeng1997
from dz_ros.core.registry import Registry

PLANTS = Registry('plant', 'plant.model', 'dz_ros.plants', Plant, {
    item.name: item for item in (
        Wang2004, ZhangFeng1997, FirstOrder, Servo, Pendulum, ValveActuator,
        Axis, Thruster, TwoLinkArm, RovPlanar)})
