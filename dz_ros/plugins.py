# SPDX-License-Identifier: Apache-2.0
"""Entry points of this package's own drivers, in the form in which any package declares its own.

A driver lies in a folder above core, `joint` even in nodes, since it speaks ROS; so no folder
below can name it. `setup.py` declares this table; `core/registry.py` reads it without asking the
metadata of what is installed, so a source tree has these drivers too.
"""

DRIVERS = {
    'simulated': 'dz_ros.drivers.simulated:SimulatedActuator',
    'mock': 'dz_ros.drivers.mock:Mock',
    'cia402': 'dz_ros.drivers.cia402.driver:Cia402',
    'serial': 'dz_ros.drivers.serial.driver:Serial',
    'joint': 'dz_ros.nodes.joint_driver:Joint',
}
"""Name in configurations → ``module:Class``; group ``dz_ros.drivers``."""
