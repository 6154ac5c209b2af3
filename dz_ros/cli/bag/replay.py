# SPDX-License-Identifier: Apache-2.0
"""``dz bag replay RUN``: publish a run again as recorded, or feed it to a live controller."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from dz_ros.cli.interrupt import INTERRUPTED
from dz_ros.cli.options import add_allow_import
from dz_ros.cli.processes import check_rclpy, Nodes, ParameterFiles
from dz_ros.errors import ConfigurationError
from dz_ros.recording.run_source import open_source

CLOCK_RATE = 40.0
"""Default rate of /clock, that of rosbag2 [Hz]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('run', type=Path, metavar='RUN',
                        help='directory of a run, or its .mcap; any rosbag2 bag')
    parser.add_argument('--rate', type=float, default=1.0, metavar='R',
                        help='how many times faster than recorded (default: 1)')
    parser.add_argument('--start', type=float, default=0.0, metavar='S',
                        help='where to begin, from the first message on [s]')
    parser.add_argument('--duration', type=float, default=0.0, metavar='S',
                        help='how much to play, in recorded time [s] (default: to the end)')
    parser.add_argument('--loop', action='store_true', help='begin again at the end')
    parser.add_argument('--topics', nargs='+', default=[], metavar='TOPIC',
                        help='play these alone (default: all)')
    parser.add_argument('--clock', type=float, nargs='?', const=CLOCK_RATE, default=0.0,
                        metavar='HZ', help='publish the time of the recording on /clock for nodes '
                        f'with use_sim_time, at this rate (default: {CLOCK_RATE:g})')
    parser.add_argument('--paused', action='store_true',
                        help='begin paused: /replay_node/resume and play_next go on')
    parser.add_argument('--wait-for', nargs='+', default=[], metavar='TOPIC',
                        help='begin when each of these has a subscriber')
    parser.add_argument('--namespace', metavar='NS', help='publish below this namespace '
                        '(default: the names as recorded)')
    parser.add_argument('--remap', action='append', default=[], metavar='FROM:=TO',
                        help='publish a topic by another name; may be repeated')
    shadow = parser.add_argument_group('shadow controller')
    shadow.add_argument('--into', choices=('controller',),
                        help='feed recorded states and references to a live controller_node '
                             'instead, with the configuration of the run, and print how its '
                             'commands differ from the recorded ones')
    shadow.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                        dest='overrides', help='change one key of its configuration')
    shadow.add_argument('--config', metavar='CONFIG',
                        help='its configuration, where the run has none')
    shadow.add_argument('--of', metavar='NS',
                        help='whose topics to feed, where the run holds several loops')
    shadow.add_argument('--paced', action='store_true',
                        help='feed it in real time, spaced as recorded, instead of sample by '
                             'sample as fast as it answers')
    shadow.add_argument('--tolerance', type=float, default=0.0, metavar='D',
                        help='largest |difference| that passes (default: 0)')
    shadow.add_argument('--record', type=Path, metavar='DIR',
                        help='keep what the live controller answered as a run')
    add_allow_import(parser)
    shadow.add_argument('--json', action='store_true', help='the comparison for programs')


def run(arguments: argparse.Namespace) -> int:
    """Play; return 0, 130 after Ctrl-C, or the code of the node that failed."""
    _check(arguments)
    source = open_source(arguments.run)
    check_rclpy()
    if arguments.into is not None:
        from dz_ros.cli.shadow import run_shadow

        return run_shadow(arguments)
    parameters: dict[str, Any] = {
        'run': str(source.path.absolute()), 'rate': arguments.rate, 'start': arguments.start,
        'duration': arguments.duration, 'loop': arguments.loop, 'clock': arguments.clock,
        'paused': arguments.paused}
    if arguments.topics:
        parameters['topics'] = arguments.topics
    if arguments.wait_for:
        parameters['wait_for'] = arguments.wait_for
    words = [word for rule in arguments.remap for word in ('-r', rule)]
    if arguments.namespace:
        words += ['-r', f'__ns:=/{arguments.namespace.strip("/")}']
    with ParameterFiles() as files, Nodes() as nodes:
        nodes.start({'replay_node': ['--params-file', files.add_parameters(parameters), *words]})
        code = nodes.wait('replay_node')
        if nodes.interrupted and code == 0 and not arguments.loop:
            return INTERRUPTED
        return code if code >= 0 else 1


def _check(arguments: argparse.Namespace) -> None:
    """Refuse options that belong to the other use of the verb."""
    plain = ('start', 'duration', 'loop', 'topics', 'clock', 'paused', 'wait_for', 'remap')
    shadow = ('overrides', 'config', 'of', 'paced', 'tolerance', 'record', 'json')
    for name in shadow if arguments.into is None else plain:
        if getattr(arguments, name):
            option = {'overrides': '--set'}.get(name, f'--{name.replace("_", "-")}')
            raise ConfigurationError(option, getattr(arguments, name),
                                     'is for --into controller only' if arguments.into is None
                                     else f'cannot be used with --into {arguments.into}')
