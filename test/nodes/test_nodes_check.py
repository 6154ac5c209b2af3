# SPDX-License-Identifier: Apache-2.0
"""The kit through topics: the example's node passes, one broken node for each check fails it."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from dz_ros.files.configurations import format_parameters, load_configuration

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / 'examples' / 'dz_ros_driver'
DZ = ('-m', 'dz_ros', 'driver', 'check')
NAMES = ['order and labels', 'seq', 'stamps', 'echo', 'rate', 'latency', 'bad messages refused',
         'saturation', 'stale command', 'commander restarts', 'e-stop', 'reset',
         'disconnect and reconnect']
TIME_OUT = 180.0
LATE = {'rate', 'latency', 'answers at once', 'measurement', 'no fault', 'echo', 'seq'}
"""Checks that a busy machine may fail."""
EXCUSED = ('the machine was late too', 'commands come too late to show')
"""What the kit reports where a process that only waits stood still as well."""


def failed(found):
    """Return the checks that failed, or were not made, although the machine was in time."""
    return {name for name, item in found.items() if item['passed'] is not True
            and name.split(': ')[-1] not in LATE
            and not any(text in item['words'] for text in EXCUSED)}


@pytest.fixture
def path():
    """PYTHONPATH with dz_ros and the example's package, as if both were installed."""
    return os.pathsep.join([str(ROOT), str(EXAMPLE), os.environ.get('PYTHONPATH', '')])


def results(process):
    """Return check → result from the JSON lines of the kit."""
    found = [json.loads(line) for line in process.output.splitlines() if line.startswith('{')]
    return {item['name']: item for item in found}


def words(found):
    return json.dumps(found, indent=1, ensure_ascii=False)


def test_the_example_s_node_passes_from_outside(processes, path):
    node = processes('-m', 'dz_ros_driver.driver_node', PYTHONPATH=path)
    kit = processes(*DZ, '--topics', '--config', 'first_order', '--yes', '--json',
                    PYTHONPATH=path)
    code, found = kit.wait(TIME_OUT), results(kit)
    assert list(found) == NAMES, kit.output
    assert failed(found) <= {'saturation'}, words(found)
    assert code == (1 if any(item['passed'] is False for item in found.values()) else 0)
    assert found['saturation']['passed'] is None
    assert node.interrupt() == 0, node.output
    assert 'Traceback' not in node.output


@pytest.mark.parametrize(('flaw', 'name'), [
    ('labels', 'order and labels'), ('seq', 'seq'), ('stamps', 'stamps'), ('echo', 'echo'),
    ('rate', 'rate'), ('latency', 'latency'), ('made-up latency', 'latency'),
    ('bad messages', 'bad messages refused'),
    ('saturation', 'saturation'), ('stale', 'stale command'), ('restart', 'commander restarts'),
    ('e-stop', 'e-stop'), ('reset', 'reset'), ('disconnect', 'disconnect and reconnect')])
def test_a_broken_node_fails_the_check_that_is_for_it(processes, path, flaw, name):
    processes(Path(__file__).with_name('broken_driver.py'), flaw, PYTHONPATH=path)
    kit = processes(*DZ, '--topics', '--config', 'first_order', '--yes', '--json', '--saturate',
                    '--set', 'safety.command_limit=30', PYTHONPATH=path)
    code, found = kit.wait(TIME_OUT), results(kit)
    assert name in found, kit.output
    assert found[name]['passed'] is False, words(found)
    assert found[name]['words']
    assert code == 1


def test_every_axis_of_a_node_passes_from_outside(processes, tmp_path):
    config = tmp_path / 'two.yaml'
    config.write_text('loop: {axes: [left, right], peers: [], duration: 0.0}\n'
                      'plant: {model: first_order}\ndriver: {name: simulated}\n', encoding='utf-8')
    files = tmp_path / 'parameters.yaml'
    files.write_text(format_parameters(load_configuration(str(config), [], '')), encoding='utf-8')
    processes('-m', 'dz_ros.nodes.main', 'actuator_node', '--ros-args', '--params-file', files)
    kit = processes(*DZ, '--topics', '--config', config, '--yes', '--json')
    code, found = kit.wait(2 * TIME_OUT), results(kit)
    assert list(found) == [f'{axis}: {name}' for axis in ('left', 'right') for name in NAMES], (
        kit.output)
    for axis in ('left', 'right'):
        own = {name: found[f'{axis}: {name}'] for name in NAMES}
        assert failed(own) <= {'saturation'}, words(own)
        assert own['bad messages refused']['limit'] == '10', words(own)
    assert code == (1 if any(item['passed'] is False for item in found.values()) else 0)


@pytest.mark.parametrize('driver', ['simulated', 'mock'])
def test_our_own_drivers_pass_in_process_and_as_nodes(processes, driver):
    kit = processes(*DZ, driver, '--json', '--saturate', '--set', 'plant.command_limit=5.0')
    code, found = kit.wait(TIME_OUT), results(kit)
    assert [name for name in found if name in NAMES] == NAMES, kit.output
    assert 'killed and started again' in found
    assert failed(found) == set(), words(found)
    assert code == (0 if all(item['passed'] for item in found.values()) else 1)


def test_the_example_s_class_passes(processes, path):
    kit = processes(*DZ, 'dz_ros_driver.thruster:Thruster', '--config', 'first_order', '--yes',
                    '--json', '--saturate', PYTHONPATH=path)
    kit.wait(TIME_OUT)
    found = results(kit)
    assert failed(found) == set(), words(found)
    assert set(NAMES) <= set(found)


LOCKED = '''
import os
from pathlib import Path
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.errors import DriverError

LOCK = Path(__file__).with_name('lock')


class Locked(SimulatedActuator):
    """Leaves a lock behind where it is killed."""

    name = 'locked'

    def open(self):
        super().open()
        try:
            os.close(os.open(LOCK, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            raise DriverError('the device is in use') from None
        self.mine = True

    def close(self):
        super().close()
        if getattr(self, 'mine', False):
            self.mine = False
            LOCK.unlink()
'''


def test_a_driver_that_does_not_come_back_after_it_was_killed_fails_that_check(processes,
                                                                               tmp_path):
    (tmp_path / 'locked.py').write_text(LOCKED, encoding='utf-8')
    kit = processes(*DZ, 'locked:Locked', '--yes', '--json', PYTHONPATH=os.pathsep.join(
        [str(ROOT), str(tmp_path)]))
    assert kit.wait(TIME_OUT) == 1, kit.output
    found = results(kit)
    assert {name for name in failed(found) if found[name]['passed'] is False} == {
        'killed and started again'}, words(found)
    assert 'the device is in use' in found['killed and started again']['words']
    assert list(found)[-1] == 'killed and started again'


def test_a_driver_that_dies_as_a_node_is_reported_in_one_line(processes, tmp_path):
    (tmp_path / 'dying.py').write_text(
        'import os\nfrom dz_ros.drivers.simulated import SimulatedActuator\n\n'
        'class Dying(SimulatedActuator):\n    name = "dying"\n'
        '    def attach(self, node):\n        self.node = node\n'
        '    def advance(self, t, seq):\n'
        '        if hasattr(self, "node") and t > 0.5:\n            os._exit(3)\n'
        '        return super().advance(t, seq)\n', encoding='utf-8')
    kit = processes(*DZ, 'dying:Dying', '--yes', '--json', PYTHONPATH=os.pathsep.join(
        [str(ROOT), str(tmp_path)]))
    assert kit.wait(TIME_OUT) == 1, kit.output
    assert 'Traceback' not in kit.output
    found = results(kit)
    assert 'disconnect and reconnect' not in found or not found['disconnect and reconnect'][
        'passed']
    dead = found.get('host') or found['as a node']
    assert dead['passed'] is False
    assert list(found)[-1] == dead['name']


def test_no_loop_there_is_one_line(processes):
    kit = processes(*DZ, '--topics', '--yes')
    assert kit.wait(TIME_OUT) == 2
    assert 'no state on /state within' in kit.output
    assert kit.output.count('\n') == 0
