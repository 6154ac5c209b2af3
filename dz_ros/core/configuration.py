# SPDX-License-Identifier: Apache-2.0
"""A whole configuration: what runs, with every value checked, made from flat dotted keys.

    loop.rate  plant.model  plant.dead_zone.b_r  controller.lambda  trajectory.kind  …

The same keys are the ROS parameters of the nodes, the keys of the YAML files and those of
``--set``. In the sections plant, controller, trajectory and driver one key chooses a class
(`plant.model`, `controller.law`, `trajectory.kind`, `driver.name`) and the rest are that class's
own parameters. A key that only another class of the same section knows is set aside, not refused,
so that the law of a file can be changed by one word; a key no class knows is an error. Where the
plant of a file is replaced, lists of the file that do not fit the new one, as `plant.x0`, are set
aside as well.

A loop of several axes (`loop.axes`) has a whole configuration for each of them,
`Configuration.axis`: that of a loop of this axis alone. `axes.NAME.` before a key gives it for one
axis (`dz_ros.core.axes_keys`). The configuration of the machine is that of its first axis with all
of them in `Configuration.axes`.

Over 300 lines: making, checking, flattening and changing one value are one thing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from dataclasses import replace as with_values
import math
from typing import Any

from dz_ros.core import schema
from dz_ros.core.axes_alike import check_alike
from dz_ros.core.axes_keys import (
    axis_key,
    AXIS_SECTIONS,
    axis_seed,
    check_axes,
    is_machines,
    parts,
    split_keys,
)
from dz_ros.core.deadzone import DeadZone
from dz_ros.core.driven import DriverClass, DRIVERS, DriverSettings, NoParameters, Undriven
from dz_ros.core.laws import LAWS
from dz_ros.core.laws.base import Law
from dz_ros.core.plants import PLANTS
from dz_ros.core.plants.base import Plant
from dz_ros.core.plants.coupled import CoupledPlant, regressor_count
from dz_ros.core.registry import allow_import, failure, Registry
from dz_ros.core.safety.settings import SafetySettings
from dz_ros.core.section_settings import (
    ControllerSettings,
    LoopSettings,
    PlantSettings,
    ProcessSettings,
    TrajectorySettings,
)
from dz_ros.core.text import counted
from dz_ros.core.trajectories import TRAJECTORIES
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.errors import (
    ConfigurationError,
    CountError,
    DzRosError,
    suggestion,
    UnknownNameError,
)

PLANT_AXIS, LAW_AXIS = 'plant.axis', 'controller.axis'
"""Keys of plants and laws that serve all axes; their value follows from `loop.axes`."""
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

_CHOSEN: Mapping[str, tuple[Registry, str]] = {
    name: (registry, f'{name}.{SELECTORS[name]}')
    for name, (_, registry, _) in SECTIONS.items() if registry is not None}
"""Section → (registry, key that chooses from it)."""


MOST_ITEMS = 50_000
"""Longest list taken from a recording or a message; that many way-points take a second."""


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
        axes: (name, configuration of this axis alone) of each axis; empty: one without a name.
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
    driver_class: type[DriverClass]
    driver_parameters: Any
    x0: tuple[float, ...]
    noise: tuple[float, ...]
    set_aside: tuple[str, ...] = field(default=())
    axes: tuple[tuple[str, Configuration], ...] = field(default=())

    def __repr__(self) -> str:
        """Return one line: what runs, how fast, how long; `to_flat` has every key."""
        if self.axes:
            return f'<Configuration of axes {", ".join(self.axis_names)}, {self.loop.rate:g} Hz>'
        end = f'{self.loop.duration:g} s' if self.loop.duration else 'without end'
        return (f'<Configuration {self.law.name} on {self.plant.name}, {self.trajectory.name}, '
                f'{self.loop.rate:g} Hz, {end}>')

    def __getitem__(self, key: str) -> Any:
        """Return the value of a dotted key, arrays as lists.

        Raises:
            UnknownNameError: This configuration has no such key.
        """
        flat = self.to_flat()
        if key not in flat:
            raise UnknownNameError('key', key, f'is no key of this configuration'
                                   f'{suggestion(str(key), flat)}')
        return flat[key]

    def __contains__(self, key: object) -> bool:
        """Return whether this configuration has a dotted key."""
        return key in self.to_flat()

    __iter__ = None     # it is no list

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes; empty: one without a name."""
        return tuple(name for name, _ in self.axes)

    @property
    def each(self) -> tuple[Configuration, ...]:
        """Configurations of the axes, each as of a loop of this axis alone."""
        return tuple(item for _, item in self.axes) or (self,)

    def axis(self, name: str) -> Configuration:
        """Return the configuration of one axis, as of a loop of this axis alone.

        Its seed is that of the machine plus the place of the axis, so that no two axes have the
        same noise.

        Raises:
            ConfigurationError: There is no such axis.
        """
        found = dict(self.axes).get(name)
        if found is None:
            raise ConfigurationError('--axis', name, f'must be one of {", ".join(self.axis_names)}'
                                     if self.axes else 'the loop has one axis, without a name')
        return found

    @property
    def quanta(self) -> tuple[float, ...]:
        """Steps in which the simulated states are measured [state units], shape (n,); 0 = none."""
        n, settings = self.plant.order, self.plant_settings
        return (settings.resolution, *settings.derivative_resolution, *(0.0,) * n)[:n]

    @property
    def zone_numbers(self) -> tuple[float, ...]:
        """Numbers of the dead-zone for `dz_ros.core.deadzone.dead_zone`, with the schedule."""
        return self.dead_zone.numbers(self.loop.schedule)

    @property
    def pulse_samples(self) -> tuple[int, int, float]:
        """First sample of the pulse, first one after it, its acceleration [unit of x^(n)]."""
        instant, acceleration, duration = self.plant_settings.disturbance_pulse
        first, after = (math.ceil(round(end * self.loop.rate, 6))
                        for end in (instant, instant + duration))
        return (first, after, acceleration) if acceleration != 0.0 else (0, 0, 0.0)

    @property
    def simulated(self) -> bool:
        """Whether what is driven is simulated, so that the plant's section is all there is of it.

        Of a driver that was not loaded for this configuration its class is asked, if installed.
        """
        found = self._installed_driver()
        return found is not None and bool(found.lockstep)

    def _installed_driver(self) -> type[DriverClass] | None:
        """Return the driver's class, also where none was loaded; None = it is not installed."""
        if self.driver_class is not Undriven:
            return self.driver_class
        try:
            DRIVERS.check_untrusted(self.driver_settings.name)  # a recording's, most likely
            found: type[DriverClass] = DRIVERS.load(self.driver_settings.name)
        except UnknownNameError:
            return None
        return found

    def declared(self) -> dict[str, schema.Field]:
        """Return `fields`, and those of a driver that was not loaded for this configuration."""
        found, chosen = self.fields(), self._installed_driver()
        if chosen is not None:
            found.update((f'driver.{item.name}', item)
                         for item in schema.fields(chosen.Parameters))
        for axis, own in self.axes:
            found.update((axis_key(axis, key), item) for key, item in own.declared().items()
                         if not is_machines(key))
        return found

    def require_one(self) -> None:
        """Refuse a machine of several axes, where one is meant.

        Raises:
            ConfigurationError: It is one.
        """
        if len(self.axes) > 1:
            raise ConfigurationError('loop.axes', list(self.axis_names), 'must be one axis: '
                                     'choose it (--axis, Configuration.axis)')

    @classmethod
    def from_flat(cls, flat: Mapping[str, Any], driven: bool = True) -> Configuration:
        """Make a configuration from dotted keys; what is not given has its default.

        Args:
            flat: Dotted key → value, as the user gave them: a plant, law, trajectory or driver
                ``module:Class`` is imported. Keys from elsewhere: `from_untrusted`.
            driven: False where nothing is driven with it, so that its driver need not be
                installed: a controller, a recording that is looked at.

        Raises:
            ConfigurationError: Unknown key, value not allowed, parts that do not fit together.
        """
        allow_named(flat, driven)
        return cls._assemble(flat, {}, driven)

    @classmethod
    def from_changed(cls, base: Mapping[str, Any], changed: Mapping[str, Any]) -> Configuration:
        """Make a configuration from dotted keys of which some are changed.

        Where another plant, law, trajectory or driver is chosen, the keys of the one in `base` are
        set aside, also of a class that is not registered; where another plant is, lists in `base`
        that do not fit it as well.

        Raises:
            ConfigurationError: As of `from_flat`.
        """
        allow_named(base, True)
        allow_named({**base, **changed}, True)
        return cls._assemble(base, changed, True)

    @classmethod
    def _assemble(cls, base: Mapping[str, Any], changed: Mapping[str, Any],
                  driven: bool) -> Configuration:
        """Make a configuration of one axis or several from keys, some of them changed.

        What is changed for all axes does not change what an axis has of its own.

        Raises:
            ConfigurationError: As of `from_flat`; an axis that does not go with the others.
        """
        flat = {**base, **changed}
        common, own = split_keys(flat)
        if not own and not common.get('loop.axes'):
            return cls._fitting(flat, driven, _owners(_replaced(base, changed)), changed, base)
        loop = schema.build(LoopSettings, {key.partition('.')[2]: value for key, value in
                                           common.items() if key.startswith('loop.')}, 'loop.')
        check_axes(own, loop.axes)
        before = split_keys(base)
        axes = []
        for place, name in enumerate(loop.axes):
            mine = own.get(name, {})
            keys = {**common, **mine, 'loop.axes': [], 'loop.seed': axis_seed(loop.seed, place)}
            for key, several in ((PLANT_AXIS, cls._serves_several), (LAW_AXIS, cls._knows_all)):
                if several(keys):
                    _check_place(name, place, key, common, mine)
                    keys[key] = place
            replaced = {key: value for earlier in (before[1].get(name, {}), common, before[0])
                        for key, value in _replaced(earlier, keys).items() if value is not None}
            try:
                new = split_keys(changed)
                built = cls._fitting(keys, driven, _owners(replaced),
                                     {**new[0], **new[1].get(name, {})},
                                     {**before[0], **before[1].get(name, {})})
            except ConfigurationError as error:
                _name_axis(error, name, place, mine)
                raise
            axes.append((name, built))
        return cls._joined(tuple(axes), set_aside=_unused(axes, common, own))

    @classmethod
    def of_axes(cls, each: Mapping[str, Configuration]) -> Configuration:
        """Return the configuration of a machine of axes that have theirs; the loop is the first's.

        Args:
            each: Axis → configuration, as of a loop of this axis alone.

        Raises:
            ConfigurationError: One does not go with the others.
        """
        placed = []
        for place, (name, item) in enumerate(each.items()):
            keys = {key: place for key, several in (
                (PLANT_AXIS, isinstance(item.plant, CoupledPlant)), (LAW_AXIS, item.law.coupled))
                if several}
            placed.append((name, item.replace(**keys)))
        return cls._joined(tuple(placed))

    @staticmethod
    def _serves_several(keys: Mapping[str, Any]) -> bool:
        """Return whether the plant that keys choose serves several axes."""
        model = keys.get('plant.model')
        try:
            return isinstance(model, str) and issubclass(PLANTS.load(model), CoupledPlant)
        except UnknownNameError:
            return False        # an error, and a clearer one, when it is made

    @staticmethod
    def _knows_all(keys: Mapping[str, Any]) -> bool:
        """Return whether the law that keys choose is one of all axes."""
        law = keys.get('controller.law')
        try:
            return isinstance(law, str) and bool(LAWS.load(law).coupled)
        except UnknownNameError:
            return False

    @classmethod
    def _joined(cls, axes: tuple[tuple[str, Configuration], ...],
                set_aside: tuple[str, ...] = ()) -> Configuration:
        """Return the configuration of a machine of these axes.

        Raises:
            ConfigurationError: One does not go with the others.
        """
        names = tuple(name for name, _ in axes)
        first = axes[0][1]
        for name, item in axes[1:]:
            check_alike(names[0], first, name, item)
        first.law.check_axes({name: item.law for name, item in axes})
        for chosen in dict.fromkeys(item.driver_class for _, item in axes):
            check = getattr(chosen, 'check_axes', None)     # `Undriven` has none
            if check is not None:
                check({name: item for name, item in axes if item.driver_class is chosen})
        model = type(first.plant)
        if issubclass(model, CoupledPlant) and model.axes != len(axes):
            raise ConfigurationError('loop.axes', list(names), f'must have {model.axes} axes: '
                                     f'plant.model = {first.plant_settings.model!r} serves as '
                                     'many')
        return with_values(first, loop=with_values(first.loop, axes=names), axes=axes,
                           set_aside=set_aside)

    @classmethod
    def _fitting(cls, flat: Mapping[str, Any], driven: bool,
                 replaced: Mapping[str, type | None], changed: Mapping[str, Any],
                 before: Mapping[str, Any], base: Configuration | None = None) -> Configuration:
        """Make a configuration; lists for another plant are set aside where their size differs.

        Args:
            flat: Dotted key → value, `changed` included.
            driven: As of `from_flat`.
            replaced: As of `_build`.
            changed: Part of `flat` that replaces what was there; it must fit a plant it chooses.
            before: What was there.
            base: As of `_build`.
        """
        keys, key = dict(flat), f'plant.{SELECTORS["plant"]}'
        another = key in changed and changed[key] != before.get(key, PlantSettings.model)
        while True:
            try:
                built = cls._build(keys, driven, base, replaced)
            except CountError as error:
                if not another or error.key in changed or error.key not in keys:
                    raise
                del keys[error.key]
            else:
                return built if len(keys) == len(flat) else with_values(
                    built, set_aside=(*built.set_aside, *(key for key in flat if key not in keys)))

    @classmethod
    def _build(cls, flat: Mapping[str, Any], driven: bool,
               base: Configuration | None = None,
               replaced: Mapping[str, type | None] | None = None) -> Configuration:
        """Make a configuration from keys whose names are already known to be the user's.

        What no key names is as in another configuration, if one is given; of a section for which
        a class is chosen, the default. `replaced` are further classes whose keys are set aside, by
        section; None = one that cannot be loaded.
        """
        groups = {} if base is None else base._groups
        replaced = replaced or {name: group[1] for name, group in groups.items() if group[1]}
        sections: dict[str, dict[str, Any]] = {name: {} for name in SECTIONS}
        for key, value in flat.items():
            section, dot, name = key.partition('.')
            if not dot or section not in sections:
                raise schema.unknown_key(key, value, every_field())
            sections[section][name] = value
        zone_values = {name.partition('.')[2]: sections['plant'].pop(name)
                       for name in list(sections['plant']) if name.startswith('dead_zone.')}
        kept = {name: group for name, group in groups.items() if not sections[name]}
        dead_zone = schema.build(DeadZone, zone_values, 'plant.dead_zone.',
                                 base.dead_zone if base else None)
        set_aside: list[str] = []
        built = {name: kept[name] if name in kept
                 else _section(name, values, set_aside, replaced, groups.get(name))
                 if driven or name != 'driver' else _undriven(values, set_aside, groups.get(name))
                 for name, values in sections.items()}
        loop = built['loop'][0]
        settings, model, parameters = built['plant']
        plant = (base.plant if base is not None and 'plant' in kept
                 else _made('plant', settings, model, parameters))
        controller, law_class, gains = built['controller']
        if law_class.coupled:
            _check_what_it_sees(controller)
        structure = (plant.order, regressor_count(plant, law_class.coupled),
                     loop.period)
        if base is not None and 'controller' in kept and structure == (
                base.law.order, base.law.regressor_count, base.law.period):
            law = base.law
        else:
            law = _made('controller', controller, law_class, gains, *structure)
        trajectory_settings, trajectory_class, motion = built['trajectory']
        if plant.order > trajectory_class.max_order:
            raise ConfigurationError('trajectory.kind', trajectory_class.name,
                                     f'gives {trajectory_class.max_order} derivatives, the plant '
                                     f'needs {plant.order}')
        if base is not None and 'trajectory' in kept and base.trajectory.order == plant.order:
            trajectory = base.trajectory        # which may have taken long to make
        else:
            trajectory = _made('trajectory', trajectory_settings, trajectory_class, motion,
                               plant.order)
        x0 = settings.x0 or plant.default_x0
        if len(x0) != plant.order:
            raise CountError('plant.x0', list(x0), f'must have {counted(plant.order, "number")}, '
                             'one for each state')
        noise = settings.noise if len(settings.noise) > 1 else settings.noise * plant.order
        if len(settings.derivative_resolution) >= max(plant.order, 1):
            raise CountError(
                'plant.derivative_resolution', list(settings.derivative_resolution),
                f'must have at most {plant.order - 1} values for {plant.name}')
        if len(noise) != plant.order:
            allowed = f'1 or {plant.order} numbers' if plant.order > 1 else '1 number'
            raise CountError('plant.noise', list(noise), f'must have {allowed}')
        driver_settings, driver_class, driver_parameters = built['driver']
        if driver_class.order not in (0, plant.order):
            raise ConfigurationError('driver.name', driver_class.name, 'closes loops of order '
                                     f'{driver_class.order}, plant.model = {settings.model!r} has '
                                     f'order {plant.order}')
        if dead_zone.follows and not loop.schedule_values:
            raise ConfigurationError('plant.dead_zone.schedule_points',
                                     list(dead_zone.schedule_points), 'needs '
                                     'loop.schedule_values, the variable that is followed')
        if loop.timing == 'lockstep' and not driver_class.lockstep:
            raise ConfigurationError('loop.timing', loop.timing, 'must be realtime with '
                                     f'driver.name = {driver_class.name!r}, a device keeps time')
        return cls(loop, built['safety'][0], built['process'][0], settings, controller,
                   trajectory_settings, driver_settings, dead_zone, plant, law, trajectory,
                   driver_class, driver_parameters, x0, noise, tuple(set_aside))

    @classmethod
    def from_untrusted(cls, flat: Mapping[str, Any], overrides: Mapping[str, Any] | None = None,
                       driven: bool = False) -> Configuration:
        """Make a configuration from what a recording or a message holds; nothing is imported.

        Args:
            flat: Dotted key → value, of any origin.
            overrides: Dotted key → value, as the user gave them; they overrule `flat`.
            driven: As of `from_flat`.

        Raises:
            ImportRefusedError: `flat` names ``module:Class``, and `registry.allow_import` did not
                allow that module.
            ConfigurationError: As of `from_flat`, or a list of more than `MOST_ITEMS`.
        """
        given = overrides or {}
        for key, value in flat.items():
            if key not in given and isinstance(value, (list, tuple)) and len(value) > MOST_ITEMS:
                raise ConfigurationError(key, value, f'is a list of {len(value)}, at most '
                                         f'{MOST_ITEMS} are taken from a recording or a message')
        allow_named(given, driven)
        for key, value in flat.items():
            section, name = parts(key)[1].partition('.')[::2]
            if name == SELECTORS.get(section) and key not in given and (
                    driven or section != 'driver'):
                _CHOSEN[section][0].check_untrusted(value)
        return cls._assemble(flat, given, driven)

    def make_driver(self) -> Any:
        """Return the configured driver (``drivers/contract.py``); nothing is opened yet.

        Of a machine of several axes: `make_drivers`.
        """
        return self.driver_class(self.driver_parameters, self)

    def make_drivers(self) -> tuple[Any, ...]:
        """Return the drivers of all axes, in their order, nothing opened yet.

        Drivers that serve several axes of one device (a bus, a coupled plant) are made together,
        by `for_axes` of their class.
        """
        each = self.each
        if len(each) == 1:
            return (each[0].make_driver(),)
        made: dict[int, Any] = {}
        for chosen in dict.fromkeys(item.driver_class for item in each):
            places = [place for place, item in enumerate(each) if item.driver_class is chosen]
            together = getattr(chosen, 'for_axes', None)
            drivers = (together([each[place] for place in places]) if together is not None
                       else [each[place].make_driver() for place in places])
            made.update(zip(places, drivers, strict=True))
        return tuple(made[place] for place in range(len(each)))

    @property
    def misfitting(self) -> tuple[str, ...]:
        """Keys that were set aside because their lists do not fit the plant."""
        known = self.fields() if self.set_aside else {}
        return tuple(key for key in self.set_aside if key in known)

    @property
    def misfit_notes(self) -> list[str]:
        """A line about each of them."""
        return [f'{key} is set aside: the list does not fit {self.plant.name}'
                for key in self.misfitting]

    def fields(self) -> dict[str, schema.Field]:
        """Return the declaration of every key of this configuration."""
        found = {f'{prefix}.{item.name}': item for prefix, members in self._members().items()
                 for group in members for item in schema.fields(type(group))}
        for axis, own in self.axes:
            found.update((axis_key(axis, key), item) for key, item in own.fields().items()
                         if not is_machines(key))
        return found

    def _members(self) -> dict[str, tuple[Any, ...]]:
        """Return prefix of keys → parameter groups."""
        return {'loop': (self.loop,), 'safety': (self.safety,), 'process': (self.process,),
                'plant': (self.plant_settings, self.plant.parameters),
                'controller': (self.controller_settings, self.law.gains),
                'trajectory': (self.trajectory_settings, self.trajectory.parameters),
                'driver': (self.driver_settings, self.driver_parameters),
                'plant.dead_zone': (self.dead_zone,)}

    def to_flat(self, *sections: str) -> dict[str, Any]:
        """Return every key of this configuration with its value; arrays as lists.

        Of several axes: the keys of the first one, and all those of each axis as its own.

        Args:
            *sections: Only those of these sections; none = all.
        """
        flat = {f'{prefix}.{name}': value for prefix, members in self._members().items()
                if not sections or prefix.partition('.')[0] in sections
                for group in members for name, value in schema.to_dict(group).items()}
        wanted = [item for item in AXIS_SECTIONS if not sections or item in sections]
        for axis, item in self.axes if wanted else ():
            flat.update((axis_key(axis, key), value) for key, value in item.to_flat(
                *wanted).items() if not is_machines(key))
        return flat

    def replace(self, **overrides: Any) -> Configuration:
        """Return this configuration with dotted keys changed (``**{'loop.delay': 1}``).

        Sections without such a key are kept as they are, a trajectory through many way-points
        included: the time it takes does not depend on what they hold. Of several axes, a key
        without an axis changes all of them.
        """
        if not overrides:
            return self
        if self.axes or overrides.get('loop.axes'):
            return self._replace_axes(overrides)
        check_axes(split_keys(overrides)[1], ())
        chosen = {section for section, (_, key) in _CHOSEN.items() if key in overrides}
        if 'plant' in chosen:
            chosen.add('controller')        # its lists may not fit the new plant
        flat = self.to_flat(*chosen) if chosen else {}
        return self._fitting({**flat, **overrides}, self.driver_class is not Undriven,
                             _owners(_replaced(flat, overrides)), overrides, flat, self)

    def _replace_axes(self, overrides: Mapping[str, Any]) -> Configuration:
        """Return this configuration of several axes with keys changed, as `replace`."""
        if 'loop.axes' in overrides:
            flat = {key: value for key, value in self.to_flat().items()
                    if parts(key)[1] not in (PLANT_AXIS, LAW_AXIS)}
            return self._assemble(flat, overrides, self.driver_class is not Undriven)
        common, own = split_keys(overrides)
        check_axes(own, self.axis_names)
        axes = []
        for place, (name, item) in enumerate(self.axes):
            mine = own.get(name, {})
            keys = {**common, **mine}
            if 'loop.seed' in keys:
                keys['loop.seed'] = axis_seed(keys['loop.seed'], place)
            for key, several in ((PLANT_AXIS, isinstance(item.plant, CoupledPlant)),
                                 (LAW_AXIS, item.law.coupled)):
                if several and key in keys:
                    _check_place(name, place, key, common, mine)
                    keys[key] = place
            try:
                axes.append((name, item.replace(**keys)))
            except ConfigurationError as error:
                _name_axis(error, name, place, mine)
                raise
        earlier = split_keys(dict.fromkeys(self.set_aside))
        common = {**earlier[0], **dict.fromkeys(key for _, item in axes
                                                for key in item.misfitting)}
        return self._joined(tuple(axes), _unused(axes, common, earlier[1]))

    @property
    def _groups(self) -> dict[str, tuple[Any, Any, Any]]:
        """Return what `_section` returned for each section."""
        return {'loop': (self.loop, None, None), 'safety': (self.safety, None, None),
                'process': (self.process, None, None),
                'plant': (self.plant_settings, type(self.plant), self.plant.parameters),
                'controller': (self.controller_settings, type(self.law), self.law.gains),
                'trajectory': (self.trajectory_settings, type(self.trajectory),
                               self.trajectory.parameters),
                'driver': (self.driver_settings, self.driver_class, self.driver_parameters)}


def allow_named(flat: Mapping[str, Any], driven: bool = False) -> None:
    """Allow the modules that a configuration of the user's names, its driver's if it drives."""
    for key, value in flat.items():
        section, name = parts(key)[1].partition('.')[::2]
        if (name == SELECTORS.get(section) and isinstance(value, str) and ':' in value
                and (driven or section != 'driver')):
            allow_import(value)


def _check_what_it_sees(controller: ControllerSettings) -> None:
    """Check that a law that knows all axes is to see them as they are measured.

    Raises:
        ConfigurationError: It is not.
    """
    for key, usual in (('error_band', 0.0), ('regressors_at', 'measured')):
        value = getattr(controller, key)
        if value != usual:
            raise ConfigurationError(f'controller.{key}', value, f'must be {usual!r}: the law '
                                     f'{controller.law} takes all axes as they are measured')


def _name_axis(error: ConfigurationError, axis: str, place: int,
               mine: Mapping[str, Any]) -> None:
    """Name the axis in an error of its configuration, by its key where it has it of its own."""
    if error.key in mine:
        error.key = axis_key(axis, error.key)
        error.args = (f'axes.{axis}.{error}',)
    elif place > 0:     # what suits the first axis may not suit this one
        error.args = (f'{error} (axis {axis})',)


def _check_place(axis: str, place: int, key: str, common: Mapping[str, Any],
                 mine: Mapping[str, Any]) -> None:
    """Check that a key which follows from the place of an axis was not given another value.

    Raises:
        ConfigurationError: It was.
    """
    given = mine if key in mine else common
    if key in given and given[key] != (place if given is mine else 0):
        raise ConfigurationError(axis_key(axis, key) if given is mine else key, given[key],
                                 f'is the place of the axis in loop.axes, {place} of {axis}: '
                                 'leave it out')


def _unused(axes: list[tuple[str, Configuration]], common: Mapping[str, Any],
            own: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    """Return the keys that are set aside: common ones by every axis, and an axis' own.

    A list of all axes that does not fit the plant of one is one of that axis.
    """
    found = [key for key in common if all(key in item.set_aside for _, item in axes)]
    for name, item in axes:
        misfits = {*item.misfitting}.difference(found)
        found += [axis_key(name, key) for key in item.set_aside
                  if key in own.get(name, ()) or key in misfits]
    return tuple(found)


def _made(section: str, settings: Any, chosen: Any, *arguments: Any) -> Any:
    """Return an instance of a chosen class.

    Raises:
        ConfigurationError: The class, which may be a user's own, raised something.
    """
    try:
        return chosen(*arguments)
    except (DzRosError, KeyboardInterrupt):
        raise
    except BaseException as error:
        name = SELECTORS[section]
        raise ConfigurationError(f'{section}.{name}', getattr(settings, name),
                                 f'cannot be made: {failure(error)}') from error


def _section(name: str, values: Mapping[str, Any], set_aside: list[str],
             replaced: Mapping[str, type | None],
             base: tuple[Any, Any, Any] | None) -> tuple[Any, Any, Any]:
    """Return (settings, chosen class, its parameter group) of one section.

    What no key names is as in `base`, if there is one, unless a key chooses the class.
    """
    settings_class, registry, group_name = SECTIONS[name]
    if registry is None:
        return schema.build(settings_class, values, f'{name}.', base[0] if base else None), \
            None, None
    before, chosen, parameters = base if base and SELECTORS[name] not in values else (None,) * 3
    common = schema.names(settings_class)
    settings: Any = schema.build(settings_class, {
        key: value for key, value in values.items() if key in common}, f'{name}.', before)
    if chosen is None:
        chosen = registry.load(getattr(settings, SELECTORS[name]))
    own = schema.names(getattr(chosen, group_name))
    given = {}
    for key, value in values.items():
        if key in common:
            continue
        if key in own:
            given[key] = value
        elif ((name in replaced and _has(replaced[name], group_name, key))
              or _known_elsewhere(registry, group_name, key)):
            set_aside.append(f'{name}.{key}')
        else:
            raise schema.unknown_key(f'{name}.{key}', value,
                                     (f'{name}.{item}' for item in {*common, *own}))
    return settings, chosen, schema.build(getattr(chosen, group_name), given, f'{name}.',
                                          parameters)


def _undriven(values: Mapping[str, Any], set_aside: list[str],
              base: tuple[Any, Any, Any] | None) -> tuple[Any, Any, Any]:
    """Return what `_section` does for the section `driver`, without its class."""
    common = schema.names(DriverSettings)
    set_aside += [f'driver.{key}' for key in values if key not in common]
    settings = schema.build(DriverSettings, {
        key: value for key, value in values.items() if key in common}, 'driver.',
        base[0] if base and SELECTORS['driver'] not in values else None)
    return settings, Undriven, NoParameters()


def _known_elsewhere(registry: Registry, group_name: str, key: str) -> bool:
    """Return whether another installed class of the registry has such a parameter."""
    return any(_has(found, group_name, key) for found in registry.all().values()
               if not isinstance(found, UnknownNameError))


def _has(found: Any, group_name: str, key: str) -> bool:
    """Return whether a class has such a parameter; True for None, which cannot be asked."""
    return found is None or key in schema.names(getattr(found, group_name))


def _replaced(base: Mapping[str, Any], changed: Mapping[str, Any]) -> dict[str, Any]:
    """Return selecting key → name in `base` where `changed` has another one."""
    return {key: base.get(key) for _, key in _CHOSEN.values()
            if key in changed and base.get(key) != changed[key]}


def _owners(names: Mapping[str, Any]) -> dict[str, type | None]:
    """Return section → class, None where it cannot be loaded, of selecting keys and names."""
    found: dict[str, type | None] = {}
    for section, (registry, key) in _CHOSEN.items():
        if isinstance(names.get(key), str):
            try:
                registry.check_untrusted(names[key])
                found[section] = registry.load(names[key])
            except UnknownNameError:
                found[section] = None
    return found


def every_field() -> dict[str, schema.Field]:
    """Return the declaration of every key that some configuration may have, by dotted key."""
    found = {f'plant.dead_zone.{item.name}': item for item in schema.fields(DeadZone)}
    for section, (settings, registry, group_name) in SECTIONS.items():
        groups = [settings]
        if registry is not None:
            groups += [getattr(item, group_name) for item in registry.all().values()
                       if not isinstance(item, UnknownNameError)]
        for group in groups:
            for item in schema.fields(group):
                found.setdefault(f'{section}.{item.name}', item)
    return dict(sorted(found.items()))
