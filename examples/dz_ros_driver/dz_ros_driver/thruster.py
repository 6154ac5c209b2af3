# SPDX-License-Identifier: Apache-2.0
"""The bench as a driver class: what dz_ros' host needs to run it, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dz_ros.core.schema import parameter
from dz_ros.drivers.contract import Driver
from dz_ros.drivers.feeder import Feeder, Order
from dz_ros_driver.bench import Bench


@dataclass(frozen=True)
class ThrusterParameters:
    """Parameters of the thruster."""

    delay: float = parameter(0.002, 's', 'time that one exchange with the device takes',
                             minimum=0.0, maximum=1.0)
    thrust_limit: float = parameter(60.0, 'N', 'largest thrust it takes', minimum=0.0,
                                    open_minimum=True)


class Thruster(Driver):
    """A slow device, so a thread talks to it."""

    name = 'thruster'
    summary = 'an example: a thruster with a dead-zone on a bench'
    order = 1
    state_units = ('m/s',)
    command_unit = 'N'
    Parameters = ThrusterParameters

    def __init__(self, parameters: Any, configuration: Any) -> None:
        super().__init__(parameters, configuration)
        self._bench: Bench | None = None
        self._feeder = Feeder(self._exchange, configuration.loop.period, fresh=0.05)

    @property
    def limit(self) -> float:
        """Largest thrust it takes [N]."""
        return float(self.parameters.thrust_limit)

    def open(self) -> None:
        """Find the device, start the thread."""
        self._bench = Bench(self.parameters.delay)
        self._feeder.start()

    def close(self) -> None:
        """End the thread."""
        self._feeder.stop()

    def command(self, v: float, t: float) -> None:
        """Leave it to the thread."""
        self._feeder.put(v, t)

    def safe(self, v: float, t: float) -> None:
        """No thrust, whatever else is asked."""
        self._feeder.put(v, t, safe=True)

    def measure(self) -> tuple[float, ...] | None:
        """Return the newest speed."""
        return self._feeder.newest()

    def fault(self) -> str:
        """Return what the thread ran into."""
        return self._feeder.fault()

    def recover(self) -> None:
        """Try again."""
        self._feeder.forgive()

    def applied_command(self) -> float | None:
        """Return the thrust commanded last [N]."""
        return None if self._bench is None else self._bench.v

    def _exchange(self, order: Order | None) -> tuple[float, ...]:
        """Talk to the device; in the thread, where it may take its time."""
        assert self._bench is not None
        if order is not None:
            self._bench.write(order.v)
        return (self._bench.read(),)
