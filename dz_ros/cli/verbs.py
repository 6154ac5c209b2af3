# SPDX-License-Identifier: Apache-2.0
"""The table of the verbs of ``dz``: words, module, summary, example; a new verb is a row here."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Verb:
    """One verb of ``dz``.

    Attributes:
        module: Module with ``add_arguments(parser)`` and ``run(arguments) -> int``.
        summary: One line for ``--help``.
        example: Arguments after the verb, as one would type them.
    """

    module: str
    summary: str
    example: str = ''


GROUPS: dict[str, dict[tuple[str, ...], Verb]] = {
    'running loops': {
        ('run',): Verb('run', 'run the loop as ROS 2 nodes, each a process, in real time',
                       'wang2004 --duration 20 --record runs/a --live'),
        ('status',): Verb('status', 'show the diagnostics of running loops, live', '--once'),
        ('estop',): Verb('operator', 'stop a loop: the safe command at both ends, until reset',
                         '--namespace left'),
        ('reset',): Verb('operator', 'release e-stop and faults of a loop, the actuator first',
                         '--namespace left'),
        ('doctor',): Verb('doctor', 'measure what this machine permits a loop, and the gain'),
    },
    'configurations and simulation': {
        ('list',): Verb('listing', 'list plants, laws, trajectories, drivers, configurations, '
                        'keys', 'laws'),
        ('show',): Verb('show', 'print a whole configuration: values, units, sources',
                        'pendulum --set controller.lambda=2'),
        ('check',): Verb('check', 'print what a configuration promises and what it does not',
                         'robust_eso'),
        ('certify',): Verb('certify', 'prove bounds on the error of the sampled, delayed loop',
                           'robust_eso'),
        ('simulate',): Verb('simulate', 'run the loop offline, as fast as the machine goes',
                            'pendulum --csv pendulum.csv'),
        ('tune',): Verb('tune', 'propose gains from bounds, rate, delay and effort',
                        'robust --effort 20 --out tuned.yaml'),
        ('sweep',): Verb('sweep', 'run thousands of loops over keys of a configuration; draw them',
                         'robust --over controller.lambda=1:10:20 --out sweep.csv'),
        ('arena',): Verb('arena', 'compare every law in every scenario', '--laws robust_eso,pid'),
    },
    'recorded runs': {
        ('report',): Verb('report', "make a run's report: figures, timing, table of metrics",
                          'runs/a'),
        ('bag', 'info'): Verb('bag.info', 'print what a recorded run holds', 'runs/a'),
        ('bag', 'import'): Verb('bag.import_', "make a run of another tool's log: CSV or any bag",
                                "log.csv --out runs/log --config axis --map 'stamp=t,x0=x,v=u'"),
        ('bag', 'export'): Verb('bag.export', 'write a run as a table for MATLAB, pandas, '
                                'spreadsheets', 'runs/a --csv'),
        ('bag', 'compare'): Verb('bag.compare', 'put runs side by side: metrics and figures',
                                 'runs/a runs/b'),
        ('bag', 'whatif'): Verb('bag.whatif', 'run a recorded loop again with something changed',
                                'runs/a --set controller.epsilon=0.01'),
        ('bag', 'predict'): Verb('bag.predict', "simulate a plant by a run's commands alone: what "
                                 'it explains', 'runs/b --config identified/identified.yaml'),
        ('bag', 'audit'): Verb('bag.audit', 'recompute a run and compare it bit for bit',
                               'runs/a'),
        ('bag', 'replay'): Verb('bag.replay', 'publish a run again, or feed it to a controller',
                                'runs/a --rate 2'),
        ('bag', 'recover'): Verb('bag.recover', 'make a readable run of one that was cut off',
                                 'runs/a'),
    },
    'actuators': {
        ('driver', 'list'): Verb('driver.list', 'list the drivers, and why one cannot load'),
        ('driver', 'check'): Verb('driver.check', "verify a driver's contract, check by check",
                                  'mock'),
        ('driver', 'emulate'): Verb('driver.emulate', 'be a device, to try its driver without it',
                                    'serial'),
        ('driver', 'commission'): Verb('driver.commission', 'go from a new device to a running '
                                       'loop, step by step', 'serial --out servo-first'),
        ('driver', 'identify'): Verb('driver.identify', 'move a device to find its dead-zone, or '
                                     'read it from a run', '--from runs/a'),
    },
    'the shell': {
        ('completion',): Verb('completion', 'print the code that completes dz in a shell',
                              'bash >> ~/.bashrc'),
    },
}
"""Heading → words → verb; two words are a noun and its verb, as ``ros2`` groups its own."""
VERBS = {path: verb for group in GROUPS.values() for path, verb in group.items()}

NOUNS = {'bag': 'recorded runs', 'driver': 'actuators'}
"""Noun → the subject of its verbs."""
