# SPDX-License-Identifier: Apache-2.0
"""What axes of one loop must have in common to share messages, plant and law (ours).

Each error names the axis by its key, and states what the first axis has.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dz_ros.core import schema
from dz_ros.core.axes_keys import axis_key
from dz_ros.core.plants.coupled import CoupledPlant
from dz_ros.errors import ConfigurationError

if TYPE_CHECKING:
    from dz_ros.core.configuration import Configuration


def check_alike(first_name: str, first: Configuration, name: str, item: Configuration) -> None:
    """Check that an axis has the order and the structure of the first one.

    Raises:
        ConfigurationError: It has not, so that its messages would have other fields.
    """
    two = '; axes of one loop have the same fields: make them two loops, in two namespaces'
    if item.plant.order != first.plant.order:
        raise ConfigurationError(axis_key(name, 'plant.model'), item.plant_settings.model,
                                 f'has order {item.plant.order}, axis {first_name} order '
                                 f'{first.plant.order}{two}')
    if (item.law.coupled or first.law.coupled) and type(item.law) is not type(first.law):
        raise ConfigurationError(axis_key(name, 'controller.law'),
                                 item.controller_settings.law, f'axis {first_name} has '
                                 f'{first.controller_settings.law}: a law that knows all '
                                 'axes must be the law of all')
    if item.law.signal_names != first.law.signal_names or len(item.law.initial_memory()) != len(
            first.law.initial_memory()):
        raise ConfigurationError(
            axis_key(name, 'controller.law'), item.controller_settings.law,
            f'publishes {", ".join(item.law.signal_names) or "no signals"}, axis {first_name} '
            f'{", ".join(first.law.signal_names) or "none"}{two}')
    if item.driver_class.lockstep != first.driver_class.lockstep:
        raise ConfigurationError(axis_key(name, 'driver.name'), item.driver_settings.name,
                                 f'axis {first_name} has {first.driver_settings.name}: the '
                                 'devices of one loop are all simulated or all real')
    if any(isinstance(each.plant, CoupledPlant) for each in (first, item)):
        _check_same_plant(first_name, first, name, item)
    if (isinstance(first.plant, CoupledPlant) or first.law.coupled) and (
            item.plant_settings.substeps != first.plant_settings.substeps):
        raise ConfigurationError(axis_key(name, 'plant.substeps'), item.plant_settings.substeps,
                                 f'must be {first.plant_settings.substeps} as of axis '
                                 f'{first_name}: plant or law couple the axes, which are '
                                 'therefore simulated together')


def _check_same_plant(first_name: str, first: Configuration, name: str,
                      item: Configuration) -> None:
    """Check that a plant of several axes is the same, and moved together, in two of them.

    Raises:
        ConfigurationError: It is not.
    """
    same = 'must be the same for all axes, '
    together = f' as of axis {first_name}: the plant serves them together'
    if type(first.plant) is not type(item.plant):
        raise ConfigurationError(axis_key(name, 'plant.model'), item.plant_settings.model,
                                 f'{same}{first.plant_settings.model}{together}')
    wanted = schema.to_dict(first.plant.parameters)
    for key, value in schema.to_dict(item.plant.parameters).items():
        if key != 'axis' and value != wanted[key]:
            raise ConfigurationError(axis_key(name, f'plant.{key}'), value,
                                     f'{same}{wanted[key]}{together}')
    if first.simulated and item.driver_class is not first.driver_class:
        raise ConfigurationError(axis_key(name, 'driver.name'), item.driver_settings.name,
                                 f'{same}{first.driver_settings.name}{together}')
