# SPDX-License-Identifier: Apache-2.0
"""The activity of the controller manager in its own type, which no wheel has: it is made here.

Definitions: controller_manager_msgs of ros2_control, branch jazzy, without their comments.
"""

import importlib.util
import os
from pathlib import Path
import shutil
import subprocess
import sys
import sysconfig

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = 'controller_manager_msgs'
DEFINITIONS = {
    'NamedLifecycleState': 'string name\nlifecycle_msgs/State state\n',
    'ControllerManagerActivity': 'std_msgs/Header header\nNamedLifecycleState[] controllers\n'
                                 'NamedLifecycleState[] hardware_components\n'}
NEEDED = ('std_msgs', 'lifecycle_msgs', 'builtin_interfaces')
TYPESUPPORTS = ('rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_introspection_c')


def generate(folder, prefix, monkeypatch):
    """Write the sources of the message package; return those of each library."""
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport
    monkeypatch.setenv('AMENT_PREFIX_PATH', os.pathsep.join(
        [str(prefix), *filter(None, [os.environ.get('AMENT_PREFIX_PATH')])]))
    (folder / 'msg').mkdir(parents=True)
    files = []
    for name, text in DEFINITIONS.items():
        (folder / 'msg' / f'{name}.msg').write_text(text)
        convert_msg_to_idl(folder, PACKAGE, Path('msg') / f'{name}.msg', folder / 'msg')
        files.append(f'{folder}:msg/{name}.idl')
    known = files, [str(prefix / 'share' / name) for name in NEEDED], folder

    def made(generator, **more):
        return [str(path) for path in generator.generate(PACKAGE, *known, **more)
                if str(path).endswith(('.c', '.cpp'))]

    hashes = HashTypeDescription('').generate_type_hashes(PACKAGE, *known)
    fast, introspection = TYPESUPPORTS
    main = 'rosidl_typesupport_c'
    return {
        f'lib{PACKAGE}__{fast}.so': made(GenerateC(''), type_description_files=hashes)
        + made(GenerateFastRTPSCTypesupport('')),
        f'lib{PACKAGE}__{introspection}.so': made(GenerateIntrospectionCTypesupport('')),
        f'{PACKAGE}_s__{main}.so':
            made(GenerateCTypesupport('', typesupport_implementations=list(TYPESUPPORTS)))
            + made(GeneratePython('', typesupport_implementations=[main]))}


def build(folder, prefix, libraries):
    """Compile the libraries, each with those before it."""
    include = [prefix / 'include', *sorted((prefix / 'include').iterdir()), folder.parent,
               np.get_include(), sysconfig.get_path('include')]
    common = [f'-l{name}__{kind}' for name in NEEDED for kind in (
        'rosidl_generator_c', 'rosidl_generator_py', 'rosidl_typesupport_c', *TYPESUPPORTS)]
    common += [f'-l{name}' for name in (
        'rosidl_runtime_c', 'rosidl_typesupport_c', *TYPESUPPORTS,
        'rosidl_typesupport_fastrtps_cpp', 'fastcdr', 'rcutils', 'rmw')]
    before = []
    for name, sources in libraries.items():
        words = ['g++', '-shared', '-fPIC', '-w', f'-Wl,-soname,{name}', '-Wl,--no-as-needed',
                 *(f'-I{path}' for path in include), '-o', str(folder / name)]
        for source in sources:
            words += ['-x', 'c++' if source.endswith('.cpp') else 'c', source]
        words += ['-x', 'none', f'-L{prefix / "lib"}', f'-Wl,-rpath,$ORIGIN:{prefix / "lib"}',
                  *before, *common]
        done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
        before.append(str(folder / name))


@pytest.fixture(scope='module')
def messages(tmp_path_factory):
    """PYTHONPATH on which controller_manager_msgs is found; made unless it is installed."""
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    if importlib.util.find_spec(PACKAGE) is not None:
        return str(ROOT)
    prefix = Path(sys.prefix)
    if shutil.which('g++') is None or not (prefix / 'include' / 'rosidl_runtime_c').is_dir():
        pytest.skip(f'{PACKAGE} is not installed, and making it needs g++ and the wheels of '
                    'rosidl with their headers')
    folder = tmp_path_factory.mktemp('messages') / PACKAGE
    with pytest.MonkeyPatch.context() as patch:
        build(folder, prefix, generate(folder, prefix, patch))
    return os.pathsep.join([str(folder.parent), str(ROOT)])


@pytest.mark.ros
def test_a_controller_that_leaves_active_is_known_from_the_manager_alone(
        messages, robot, watcher):
    # The emulator sends no transition event, and the error has no limit: nothing else reports.
    nodes = robot.start(options=['activity=1'], path=messages)
    watcher.running()
    watcher.wait(lambda: abs(robot.held) > 0.3)
    robot.do('deactivate')
    watcher.wait_for_mode(actuator_node='fault')
    inactive = 'the controller /effort_controller is inactive: it takes no commands'
    assert watcher.modes()['actuator_node'][1] == inactive
    assert not watcher.call('actuator_node/reset').success
    robot.do('activate')
    watcher.wait(watcher.recovered)
    watcher.running()
    robot.do('unload')
    watcher.wait_for_mode(actuator_node='fault')
    assert 'is not loaded' in watcher.modes()['actuator_node'][1]
    assert nodes['actuator_node'].interrupt() == 0
    assert 'Traceback' not in nodes['actuator_node'].output


@pytest.mark.ros
def test_a_controller_that_was_never_activated_is_known_from_the_manager(
        messages, robot, watcher):
    robot.start('-p', 'driver.patience:=3.0', options=['activity=1'], active=False, path=messages)
    watcher.wait_for_mode(actuator_node='fault')
    assert watcher.modes()['actuator_node'][1] == (
        'the controller /effort_controller is inactive: it takes no commands')
    watcher.wait(lambda: robot.interface)
    assert {held for _, held, *_ in robot.interface} == {0.0}
