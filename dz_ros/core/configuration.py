"""A whole configuration: what runs, with every value checked, made from flat dotted keys.

    loop.rate  plant.model  plant.dead_zone.b_r  controller.lambda  trajectory.kind  …

The same keys are the ROS parameters of the nodes, the keys of the YAML files and those of
``--set``. In the sections plant, controller, trajectory and driver one key chooses a class
(`plant.model`, `controller.law`, `trajectory.kind`, `driver.name`) and the rest are that class's
own parameters. A key that only
another class of the same section knows is set aside, not refused, so that the law of a file can
be changed by one word; a key nobody knows is an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from typing import Any

from dz_ros.core import schema
from dz_ros.core.deadzone import DeadZone
from dz_ros.core.driver import Driver, DRIVERS, DriverSettings, NoParameters, Undriven
from dz_ros.core.laws import LAWS
from dz_ros.core.laws.base import Law
from dz_ros.core.plants import PLANTS
from dz_ros.core.plants.base import Plant
from dz_ros.core.registry import Registry
from dz_ros.core.safety.settings import SafetySettings
from dz_ros.core.settings import (
    ControllerSettings,
    LoopSettings,
    PlantSettings,
    ProcessSettings,
    TrajectorySettings,
)
from dz_ros.core.trajectories import TRAJECTORIES
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.errors import ConfigurationError, UnknownNameError

SECTIONS: Mapping[str, tuple[type, Registry | None, str]] = {
    'loop': (LoopSettings, None, ''),
    'safety': (SafetySettings, None, ''),
    'process': (ProcessSettings, None, ''),
    'plant': (PlantSettings, PLANTS, 'Parameters'),
    'controller': (ControllerSettings, LAWS, 'Gains'),
    'trajectory': (TrajectorySettings, TRAJECTORIES, 'Parameters'),
    'driver': (DriverSettings, DRIVERS, 'Parameters'),
}
"""Section → (its settings, registry of the classes it chooses from, their parameter group)."""

SELECTORS = {'plant': 'model', 'controller': 'law', 'trajectory': 'kind', 'driver': 'name'}


@dataclass(frozen=True)
class Configuration:
    """A checked configuration, ready to run.

    Attributes:
        loop, safety, process, plant_settings, controller_settings, trajectory_settings,
            driver_settings: Common settings.
        dead_zone: The actuator's dead-zone.
        plant: The plant.
        law: The law, for this plant's structure and this rate.
        trajectory: The trajectory, for this plant's order.
        driver_class, driver_parameters: What `make_driver` makes.
        x0: Initial state, shape (n,).
        noise: Standard deviations of the measurement noise, shape (n,).
        set_aside: Keys given that belong to another class of their section.
    """

    loop: LoopSettings
    safety: SafetySettings
    process: ProcessSettings
    plant_settings: PlantSettings
    controller_settings: ControllerSettings
    trajectory_settings: TrajectorySettings
    driver_settings: DriverSettings
    dead_zone: DeadZone
    plant: Plant
    law: Law
    trajectory: Trajectory
    driver_class: type[Driver]
    driver_parameters: Any
    x0: tuple[float, ...]
    noise: tuple[float, ...]
    set_aside: tuple[str, ...] = field(default=())

    @property
    def kick_samples(self) -> tuple[int, int, float]:
        """First sample of the kick, first one after it, its acceleration [unit of x^(n)]."""
        instant, acceleration, duration = self.plant_settings.kick
        first, after = (math.ceil(round(end * self.loop.rate, 6))
                        for end in (instant, instant + duration))
        return (first, after, acceleration) if acceleration != 0.0 else (0, 0, 0.0)

    @property
    def simulated(self) -> bool:
        """Whether what is driven is simulated, so that the plant's section is all there is of it.

        Of a driver that was not loaded for this configuration its class is asked, if installed.
        """
        try:
            driver = (DRIVERS.load(self.driver_settings.name)
                      if self.driver_class is Undriven else self.driver_class)
        except UnknownNameError:
            return False
        return bool(driver.lockstep)

    @classmethod
    def from_flat(cls, flat: Mapping[str, Any], driven: bool = True) -> Configuration:
        """Make a configuration from dotted keys; what is not given has its default.

        Args:
            flat: Dotted key → value.
            driven: False where nothing is driven with it, so that its driver need not be
                installed: a controller, a recording that is looked at.

        Raises:
            ConfigurationError: Unknown key, value not allowed, parts that do not fit together.
        """
        sections: dict[str, dict[str, Any]] = {name: {} for name in SECTIONS}
        for key, value in flat.items():
            section, dot, name = key.partition('.')
            if not dot or section not in sections:
                raise schema.unknown_key(key, value, (f'{item}.…' for item in SECTIONS))
            sections[section][name] = value
        zone_values = {name.partition('.')[2]: sections['plant'].pop(name)
                       for name in list(sections['plant']) if name.startswith('dead_zone.')}
        dead_zone = schema.build(DeadZone, zone_values, 'plant.dead_zone.')
        set_aside: list[str] = []
        built = {name: _section(name, values, set_aside) if driven or name != 'driver'
                 else _undriven(values, set_aside) for name, values in sections.items()}
        loop = built['loop'][0]
        settings, model, parameters = built['plant']
        plant = model(parameters)
        controller, law_class, gains = built['controller']
        law = law_class(gains, plant.order, plant.regressor_count, loop.period)
        trajectory_settings, trajectory_class, motion = built['trajectory']
        if plant.order > trajectory_class.max_order:
            raise ConfigurationError('trajectory.kind', trajectory_class.name,
                                     f'gives {trajectory_class.max_order} derivatives, the plant '
                                     f'needs {plant.order}')
        trajectory = trajectory_class(motion, plant.order)
        x0 = settings.x0 or plant.default_x0
        if len(x0) != plant.order:
            raise ConfigurationError('plant.x0', list(x0), f'must have {plant.order} numbers, one '
                                     'for each state')
        noise = settings.noise if len(settings.noise) > 1 else settings.noise * plant.order
        if len(noise) != plant.order:
            raise ConfigurationError('plant.noise', list(noise), 'must have 1 or '
                                     f'{plant.order} numbers')
        driver_settings, driver_class, driver_parameters = built['driver']
        if driver_class.order not in (0, plant.order):
            raise ConfigurationError('driver.name', driver_class.name, 'closes loops of order '
                                     f'{driver_class.order}, plant.model = {settings.model!r} has '
                                     f'order {plant.order}')
        if loop.timing == 'lockstep' and not driver_class.lockstep:
            raise ConfigurationError('loop.timing', loop.timing, 'must be realtime with '
                                     f'driver.name = {driver_class.name!r}, a device keeps time')
        return cls(loop, built['safety'][0], built['process'][0], settings, controller,
                   trajectory_settings, driver_settings, dead_zone, plant, law, trajectory,
                   driver_class, driver_parameters, x0, noise, tuple(set_aside))

    def make_driver(self) -> Driver:
        """Return the configured driver; nothing is opened yet."""
        return self.driver_class(self.driver_parameters, self)

    def to_flat(self) -> dict[str, Any]:
        """Return every key of this configuration with its value; arrays as lists."""
        groups = {'loop': (self.loop,), 'safety': (self.safety,), 'process': (self.process,),
                  'plant': (self.plant_settings, self.plant.parameters),
                  'controller': (self.controller_settings, self.law.gains),
                  'trajectory': (self.trajectory_settings, self.trajectory.parameters),
                  'driver': (self.driver_settings, self.driver_parameters),
                  'plant.dead_zone': (self.dead_zone,)}
        return {f'{prefix}.{name}': value for prefix, members in groups.items()
                for group in members for name, value in schema.to_dict(group).items()}

    def replace(self, **overrides: Any) -> Configuration:
        """Return this configuration with dotted keys changed (``**{'loop.delay': 1}``)."""
        return self.from_flat({**self.to_flat(), **overrides}, self.driver_class is not Undriven)


def _section(name: str, values: Mapping[str, Any],
             set_aside: list[str]) -> tuple[Any, Any, Any]:
    """Return (settings, chosen class, its parameter group) of one section."""
    settings_class, registry, group_name = SECTIONS[name]
    common = {item.name: item for item in schema.fields(settings_class)}
    settings: Any = schema.build(settings_class, {key: value for key, value in values.items()
                                             if key in common or registry is None}, f'{name}.')
    if registry is None:
        return settings, None, None
    chosen = registry.load(getattr(settings, SELECTORS[name]))
    own = {item.name for item in schema.fields(getattr(chosen, group_name))}
    given = {}
    for key, value in values.items():
        if key in common:
            continue
        if key in own:
            given[key] = value
        elif _known_elsewhere(registry, group_name, key):
            set_aside.append(f'{name}.{key}')
        else:
            raise schema.unknown_key(f'{name}.{key}', value,
                                     (f'{name}.{item}' for item in {*common, *own}))
    return settings, chosen, schema.build(getattr(chosen, group_name), given, f'{name}.')


def _undriven(values: Mapping[str, Any], set_aside: list[str]) -> tuple[Any, Any, Any]:
    """Return what `_section` does for the section `driver`, without its class."""
    common = {item.name for item in schema.fields(DriverSettings)}
    set_aside += [f'driver.{key}' for key in values if key not in common]
    settings = schema.build(DriverSettings, {key: value for key, value in values.items()
                                             if key in common}, 'driver.')
    return settings, Undriven, NoParameters()


def _known_elsewhere(registry: Registry, group_name: str, key: str) -> bool:
    """Return whether another installed class of the registry has such a parameter."""
    return any(key in {item.name for item in schema.fields(getattr(found, group_name))}
               for found in registry.all().values() if not isinstance(found, UnknownNameError))
