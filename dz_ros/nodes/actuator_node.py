"""An actuator of your own as a node: the host with the driver that `driver.name` chooses.

Publishes `state`, subscribes `command`; see ``clockwork.py`` and ``hosting.py``. Its sections are
loop, safety, driver and of the plant what the driver needs: all of it where the actuator is
simulated, else the model and its parameters. docs/drivers.md tells how to write a driver.
"""

from __future__ import annotations

from dz_ros.nodes.clockwork import ActuatorHost


class ActuatorNode(ActuatorHost):
    """Any actuator."""

    def __init__(self) -> None:
        super().__init__('actuator_node', 'loop', 'device', 'safety', 'driver')
