# SPDX-License-Identifier: Apache-2.0
"""The simulated plant behind its dead-zone as a node: an actuator's node without a driver section.

Publishes `state` and `truth`, subscribes `command`. Its sections are loop, plant and safety. The
driver is ``drivers/simulated.py``.
"""

from __future__ import annotations

from dz_ros.errors import ConfigurationError
from dz_ros.nodes.actuator_node import ActuatorNode


def make_plant_node() -> ActuatorNode:
    """Return the node.

    Raises:
        ConfigurationError: The configuration is that of another driver.
    """
    node = ActuatorNode('plant_node', 'loop', 'plant', 'safety')
    for item in node.configuration.each:
        name = item.driver_settings.name
        if name != 'simulated':
            raise ConfigurationError('driver.name', name, 'plant_node simulates: start '
                                     'actuator_node, or set driver.name to simulated')
    return node
