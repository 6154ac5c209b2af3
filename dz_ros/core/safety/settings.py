# SPDX-License-Identifier: Apache-2.0
"""Limits and watchdogs of both ends of the loop, the section ``safety`` of a configuration (ours).

All of them are off, or far from a healthy loop, by default: a healthy run is the same with and
without them. Limits in samples are counts of the period T.
"""

from __future__ import annotations

from dataclasses import dataclass

from dz_ros.core.schema import parameter
from dz_ros.errors import ConfigurationError


@dataclass(frozen=True)
class SafetySettings:
    """Limits and watchdogs; 0 = off unless stated otherwise."""

    safe_command: float = parameter(0.0, 'actuator unit', 'command where the law must not act')
    command_limit: float = parameter(0.0, 'actuator unit', 'largest |v| that leaves the '
                                     'controller or reaches the actuator; 0 = off', minimum=0.0)
    rate_limit: float = parameter(0.0, 'actuator unit/s', "largest |v'|, except on the way to the "
                                  'safe command; 0 = off', minimum=0.0)
    ramp: float = parameter(0.0, 's', 'time in which the command goes over from the safe one to '
                            "the law's, whenever the law takes over; 0 = at once", minimum=0.0)
    error_limit: float = parameter(0.0, 'unit of x', 'a larger |x - x_d| is a fault; 0 = off',
                                   minimum=0.0)
    theta_limit: float = parameter(0.0, 'actuator unit per unit of Y_i', 'a larger '
                                   'estimate |theta_i| is a fault; 0 = off', minimum=0.0)
    phi_limit: float = parameter(0.0, 'actuator unit per unit of x^(n)', 'a larger '
                                 'estimate |phi| is a fault; 0 = off', minimum=0.0)
    runaway_time: float = parameter(0.5, 's', 'a device that gains speed against the command for '
                                    'longer is a fault; 0 = off', minimum=0.0)
    command_hold: int = parameter(3, 'samples', 'the actuator holds the last command that long, '
                                  'then takes the safe one; 0 = for ever', minimum=0,
                                  maximum=100000)
    state_hold: int = parameter(3, 'samples', 'without a state for that long the controller sends '
                                'the safe command, without a measurement the actuator '
                                'is in fault; 0 = never', minimum=0, maximum=100000)
    reference_hold: int = parameter(20, 'samples', 'a reference is extrapolated for that long, '
                                    'then the safe command is sent; 0 = for ever', minimum=0,
                                    maximum=100000)
    echo_limit: int = parameter(20, 'samples', 'a command that answers an older state is not '
                                'taken, nor a loop trusted that answers so late; 0 = off',
                                minimum=0, maximum=100000)
    fault_after: int = parameter(200, 'samples', 'input that stays away that long is a fault; '
                                 '0 = never', minimum=0, maximum=1000000)
    estimates: str = parameter('keep', '', 'estimates when the law takes over again: as they are, '
                               'as configured, or as they were 1 to 2 s before it was stopped',
                               choices=('keep', 'reset', 'restore'))

    def check(self, prefix: str) -> None:
        """Check what spans several values.

        Raises:
            ConfigurationError: The safe command is beyond the limit, or a fault comes before the
                safe command.
        """
        if 0.0 < self.command_limit < abs(self.safe_command):
            raise ConfigurationError(f'{prefix}safe_command', self.safe_command,
                                     'must not exceed safety.command_limit = '
                                     f'{self.command_limit:g}')
        for name in ('command_hold', 'state_hold', 'reference_hold'):
            if 0 < self.fault_after < getattr(self, name):
                raise ConfigurationError(f'{prefix}fault_after', self.fault_after,
                                         f'must not be less than safety.{name} = '
                                         f'{getattr(self, name)}')
