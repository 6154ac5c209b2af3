"""The simulated plant behind its dead-zone as a node: the host with the simulated driver.

Publishes `state` and `truth`, subscribes `command`; see ``clockwork.py`` and ``hosting.py``. Its
sections are loop, plant and safety: it needs no `driver`. The driver is ``drivers/simulated.py``.
"""

from __future__ import annotations

from dz_ros.errors import ConfigurationError
from dz_ros.nodes.clockwork import ActuatorHost


class PlantNode(ActuatorHost):
    """Simulated actuator and plant.

    Raises:
        ConfigurationError: The configuration is that of another driver.
    """

    def __init__(self) -> None:
        super().__init__('plant_node', 'loop', 'plant', 'safety')
        name = self.configuration.driver_settings.name
        if name != 'simulated':
            raise ConfigurationError('driver.name', name, 'plant_node simulates: start '
                                     'actuator_node, or set driver.name to simulated')
