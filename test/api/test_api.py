# SPDX-License-Identifier: Apache-2.0
"""The Python API as a script uses it.

Over 300 lines: all public names, on runs that are made once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import os
from pathlib import Path
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import dz_ros as dz
from dz_ros.core.dataset import from_runs
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants.servo import Servo
from dz_ros.errors import (
    ConfigurationError,
    DivergedError,
    RecordingError,
    RunExistsError,
    UnknownNameError,
)
from dz_ros.files.configurations import find_configuration, load_configuration
from dz_ros.studies.sweep import run_sweep

SHORT = {'loop.duration': 2.0}


@dataclass(frozen=True)
class MassParameters:
    """Parameters of the mass."""

    b: float = dz.parameter(2.0, 'm/s² per N', 'input gain', minimum=0.0, open_minimum=True)


class Mass(dz.Plant):
    """A mass with drag, of a script."""

    name = 'mass_of_a_script'
    summary = 'a mass'
    order = 2
    regressor_count = 1
    state_units = ('m', 'm/s')
    actuator_unit = 'N'
    default_x0 = (0.0, 0.0)
    Parameters = MassParameters
    a = (0.5,)

    @property
    def b(self) -> float:
        """Return the input gain."""
        return float(self.parameters.b)

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:
        """Write the velocity."""
        y[0] = x[1]


class Swing(type(dz.load('wang2004').trajectory)):
    """A sinusoid of a script."""

    name = 'swing_of_a_script'


def test_importing_loads_neither_numpy_nor_ros_and_every_name_is_there():
    code = ('import sys, dz_ros; assert not {"numpy", "rclpy"} & set(sys.modules); '
            'assert set(dz_ros.__all__) <= set(dir(dz_ros)); '
            'assert all(getattr(dz_ros, name).__doc__ for name in dz_ros.__all__)')
    subprocess.run([sys.executable, '-c', code], check=True, timeout=120)
    with pytest.raises(AttributeError, match='no attribute'):
        dz.nothing


def test_a_configuration_by_name_file_mapping_and_itself_is_the_same():
    wanted = load_configuration('wang2004', ['controller.lambda=2']).to_flat()
    file = find_configuration('wang2004')
    for source in ('wang2004', file, str(file), dz.load('wang2004')):
        assert dz.load(source, {'controller.lambda': 2}).to_flat() == wanted
        assert dz.load(source, **{'controller.lambda': 2}).to_flat() == wanted
    assert dz.load({'controller': {'lambda': 2}, 'loop.rate': 100}).loop.rate == 100.0
    assert dz.load().to_flat() == dz.load({}).to_flat()


@pytest.mark.parametrize(('source', 'keys', 'words'), [
    ('no_such_name', {}, 'no such file'),
    ('wang2004', {'controller.lamda': 2}, 'did you mean controller.lambda'),
    ('wang2004', {'controller.lambda': -1.0}, 'controller.lambda'),
    ('wang2004', {'plant.model': dict}, 'is not a Plant'),
    (3, {}, 'must be a name, a file, a mapping'),
    (['wang2004'], {}, 'must be a name, a file, a mapping'),
])
def test_what_cannot_be_loaded_is_named(source, keys, words):
    with pytest.raises(ConfigurationError, match=words):
        dz.load(source, keys)


def test_a_simulation_is_the_loop_bit_for_bit_compiled_or_not():
    pytest.importorskip('numba')
    run = dz.simulate('wang2004', SHORT)
    plain = simulate(dz.load('wang2004', SHORT))
    assert np.array_equal(run.x, plain.x_measured)
    assert np.array_equal(run.v, plain.v)
    assert np.array_equal(dz.simulate('wang2004', SHORT, compiled=True).v, run.v)
    assert len(run) == len(plain.t)
    assert np.array_equal(run.error, run.x - run.x_d[:, :2])


def test_a_run_reports_what_it_is():
    run = dz.simulate('servo', SHORT)
    assert repr(run).startswith('<Run ')
    assert 'servo' in repr(run)
    assert 'rad' in repr(run)
    assert re.fullmatch(r'<Run wang2004 on wang2004, 401 samples, 2 s, max\|x̃\| [\d.]+>',
                        repr(dz.simulate('wang2004', SHORT)))      # x has no unit
    assert repr(dz.load('servo', SHORT)) == (
        '<Configuration robust_eso on servo, point_to_point, 200 Hz, 2 s>')
    assert run.units['x1'] == 'rad/s'
    assert run.units['v'] == 'A'
    assert run.units['t'] == 's'
    assert set(run.units) == set(run.columns)
    assert run.configuration.plant.name == 'servo'
    assert repr(run.metrics).startswith('<Metrics of 1 to 2 s: error_max 0.')
    assert 'None' not in repr(run.metrics)
    assert run.metric_units['error_max'] == 'rad'
    assert run.metric_units['v_variation'] == 'A/s'
    assert run.metric_units['omega_share'] == ''
    assert dz.simulate('wang2004', SHORT).metric_units['error_max'] == ''
    assert run.metrics.error_max == pytest.approx(np.abs(run.error[run.t >= 1.0, 0]).max())


def test_tables_for_pandas():
    pandas = pytest.importorskip('pandas')
    runs = [dz.simulate('wang2004', SHORT | {'controller.lambda': value}) for value in (1, 2)]
    frame = runs[0].to_pandas()
    assert frame.index.name == 't'
    assert np.array_equal(frame['v'], runs[0].v)
    assert frame.attrs['units']['t'] == 's'
    table = dz.compare(*runs, names=('one', 'two')).to_pandas()
    assert list(table.index) == ['one', 'two']
    assert isinstance(table, pandas.DataFrame)


def test_figures_by_name():
    pytest.importorskip('matplotlib')
    run = dz.simulate('wang2004', SHORT)
    assert {'tracking', 'error', 'command'} <= set(run.plot())
    assert run.plot('tracking').axes
    assert set(run.plot('tracking', 'error')) == {'tracking', 'error'}
    with pytest.raises(ConfigurationError, match='must be one of tracking'):
        run.plot('nothing')


def test_a_run_is_saved_read_and_never_overwritten(tmp_path: Path):
    run = dz.simulate('wang2004', SHORT)
    again = dz.read(run.save(tmp_path / 'run'))
    assert again.name == 'run'
    assert np.array_equal(again.v, run.v)
    assert again.metrics == run.metrics
    with pytest.raises(RunExistsError):
        run.save(tmp_path / 'run')


def test_a_comparison_names_what_differs():
    runs = [dz.simulate('wang2004', SHORT | {'controller.lambda': value}) for value in (1, 2)]
    found = dz.compare(*runs)
    assert found.differences == [['controller.lambda', '1.0', '2.0']]
    assert 'run 1' in repr(found)
    assert 'max |x̃|' in repr(found)
    for wrong in ((runs[0],), ()):
        with pytest.raises(ConfigurationError, match='at least two'):
            dz.compare(*wrong)
    with pytest.raises(ConfigurationError, match='2 different names'):
        dz.compare(*runs, names=('one', 'one'))
    with pytest.raises(ConfigurationError, match='must be a run, as simulate and read'):
        dz.compare(runs[0], 3)


@pytest.mark.slow
def test_the_rules_report_what_they_find():
    assert dz.check('wang2004').worst == 'info'
    found = dz.check('wang2004', {'controller.k_star': 0.1})
    assert found.worst == 'error'
    assert repr(found).splitlines()[-1].startswith('error')


def test_a_sweep_is_rows():
    rows = dz.sweep(dz.load('wang2004', SHORT), {'controller.lambda': [1, 2],
                                                 'loop.delay': np.arange(2)}, jobs=1)
    assert [(row['controller.lambda'], row['loop.delay']) for row in rows] == [
        (1, 0), (1, 1), (2, 0), (2, 1)]
    assert rows[0]['error_max'] == dz.simulate('wang2004', SHORT).metrics.error_max
    rows = dz.sweep(dz.load('wang2004', SHORT), {'controller.lambda': (1.0, 2.0)}, samples=4,
                    jobs=1)
    assert len({row['controller.lambda'] for row in rows}) == 4


@pytest.mark.parametrize(('values', 'samples', 'words'), [
    ((1, 2, 3), 4, 'two ends'), (('pd', 'pid'), 4, 'two ends'), ([], 0, 'at least one value'),
    (2.0, 0, 'a list of values'), ('pd', 0, 'a list of values')])
def test_a_sweep_over_no_values_is_refused_by_its_key(values, samples, words):
    with pytest.raises(ConfigurationError, match=f'controller.lambda = .*{words}'):
        dz.sweep('wang2004', {'controller.lambda': values}, samples=samples)


def test_of_several_axes_a_key_without_axis_changes_all_and_one_is_chosen():
    machine = dz.load({'loop.axes': ['a', 'b'], 'axes.b.controller.lambda': 2.0})
    changed = dz.load(machine, {'controller.lambda': 4.0, 'axes.a.controller.lambda': 3.0})
    assert [item.law.gains.lambda_ for item in changed.each] == [3.0, 4.0]
    assert dz.load(machine).to_flat() == machine.to_flat()
    for work in (lambda: dz.sweep(machine, {'controller.lambda': [1.0, 2.0]}, jobs=1),
                 lambda: dz.check(machine)):
        with pytest.raises(ConfigurationError, match='must be one axis'):
            work()
    assert dz.simulate(machine.axis('b'), SHORT).configuration.law.gains.lambda_ == 2.0


@pytest.mark.slow
def test_recordings_of_several_axes_are_compared_axis_by_axis(tmp_path):
    for name, delay in (('a', 0), ('b', 1)):
        c = dz.load('rov_planar', {'loop.duration': 0.5, 'loop.delay': delay})
        dz.Run(from_runs(simulate_axes(c), c)).save(tmp_path / name)
    a, b = dz.read(tmp_path / 'a'), dz.read(tmp_path / 'b')
    assert a.axes == ('surge', 'sway', 'yaw')
    first, *rest = repr(a).splitlines()
    assert first == '<Run a: axes surge, sway, yaw'
    assert len(rest) == 3
    assert rest[2].startswith('  <Run a yaw: ')
    table = a.to_pandas()
    assert set(table.columns.get_level_values('axis')) == {'surge', 'sway', 'yaw'}
    assert np.array_equal(table['yaw']['v'], a.axis('yaw').v)
    assert table.attrs['units']['yaw'] == a.axis('yaw').units
    assert set(a.plot('error')) == {'surge', 'sway', 'yaw'}
    assert len(a) == len(a.axis('yaw')) == 101
    assert not a.axis('yaw').axes
    with pytest.raises(RecordingError, match=r'choose one with axis\(\)'):
        _ = a.metrics
    with pytest.raises(RecordingError, match=r'has no axis jaw.*did you mean yaw'):
        a.axis('jaw')
    found = dz.compare(a, b)
    assert isinstance(found, dz.AxesComparison)
    assert list(found) == list(a.axes)
    one = dz.compare(dz.read(tmp_path / 'a', axis='yaw'), dz.read(tmp_path / 'b', axis='yaw'))
    assert found['yaw'].rows == one.rows
    assert found['yaw'].differences == [['loop.delay', '0', '1']]
    assert repr(found).count('max |x̃|') == 3
    assert f'axis yaw\n{one!r}' in repr(found)
    with pytest.raises(RecordingError, match=(
            'a has axes surge, sway, yaw, other has axis yaw alone; choose it with --axis yaw')):
        dz.compare(a, b.axis('yaw'), names=('a', 'other'))
    with pytest.raises(ConfigurationError, match='at least two'):
        dz.compare(a)
    table = pytest.importorskip('pandas') and found.to_pandas()
    assert table.index.names == ['axis', 'run']
    assert table.loc[('yaw', 'b'), 'error_max'] == b.axis('yaw').metrics.error_max


def test_a_class_of_a_script_is_a_plant():
    run = dz.simulate({'plant.model': Mass, 'controller.b_bounds': [1.5, 2.5]}, SHORT)
    assert run.configuration.plant.name == Mass.name
    assert run.metrics.error_max < 0.1
    dz.load({'plant.model': Mass})      # again
    c = dz.load('six_axes', {'axes.yaw.trajectory.kind': Swing})
    assert c.axis('yaw').trajectory.name == Swing.name
    assert c.axis('roll').trajectory.name != Swing.name
    assert dz.load({'plant.model': Servo}).plant.name == 'servo'    # one of the package

    with pytest.raises(UnknownNameError, match='another plant'):
        dz.load({'plant.model': type('Other', (Mass,), {'name': 'servo'})})


def test_plants_to_and_from_python_control():
    control = pytest.importorskip('control')
    system = control.nlsys(lambda t, x, u, p: [x[1], -0.5 * x[1] + 2.0 * u[0]], None, inputs=1,
                           states=2, name='mass')
    plant = dz.from_control(system, state_units=('m', 'm/s'), actuator_unit='N')
    assert plant().b == pytest.approx(2.0)
    assert plant.state_units == ('m', 'm/s')
    keys = {'controller.b_bounds': [1.5, 2.5]} | SHORT
    ours, theirs = (dz.simulate({'plant.model': item}, keys) for item in (Mass, plant))
    assert theirs.metrics.error_max < 0.1
    assert ours.t.shape == theirs.t.shape

    configuration = dz.load('servo')
    with_zone, bare = dz.to_control(configuration), dz.to_control(configuration.plant)
    x = np.array([0.3, 0.0])
    inside = 0.5 * configuration.dead_zone.b_r
    assert np.array_equal(with_zone.dynamics(0.0, x, [inside]), bare.dynamics(0.0, x, [0.0]))
    assert with_zone.dynamics(0.0, x, [inside])[1] != bare.dynamics(0.0, x, [inside])[1]


def test_another_plant_is_one_word_here_too():
    with pytest.warns(UserWarning, match='does not fit valve_actuator'):
        c = dz.load('wang2004', {'plant.model': 'valve_actuator', **SHORT})
    assert {'plant.x0', 'controller.theta_0'} <= set(c.set_aside)
    assert dz.simulate(c).x.shape == (401, 3)
    with pytest.warns(UserWarning, match='theta_0 is set aside'):
        assert dz.load('wang2004', {'plant.model': Mass})['plant.model'] == Mass.name
    with pytest.raises(ConfigurationError, match=r'must have 1 number$'):
        dz.load('wang2004', {'plant.model': Mass, 'controller.theta_0': [1.0, 2.0]})


def test_values_are_read_by_key_and_objects_show_what_they_are():
    c = dz.load('servo', {'controller.lambda': 4.0})
    assert c['controller.lambda'] == 4.0
    assert c['plant.x0'] == list(c.x0)
    with pytest.raises(ConfigurationError, match=r'did you mean controller\.lambda'):
        c['controller.lamda']
    assert repr(c.plant).startswith('<Servo inertia=')
    assert repr(c.trajectory).startswith('<')
    assert 'at 0x' not in repr(c.trajectory) + repr(c.law)
    assert repr(c.law).endswith('…>')
    assert repr(dz.load({'controller.law': 'pd'}).law).startswith('<Pd for order 2, 200 Hz: ')
    times = [0.1 * k for k in range(300)]
    way = dz.load({'trajectory.kind': 'waypoints', 'trajectory.times': times,
                   'trajectory.positions': times}).trajectory
    assert '[300 numbers]' in repr(way)
    assert len(repr(way)) < 200
    assert 'plant.x0' in c
    assert 'plant' not in c
    with pytest.raises(TypeError):
        list(c)


def test_recordings_are_compared_by_path(tmp_path):
    for name, law in (('a', 'pd'), ('b', 'robust')):
        dz.simulate('wang2004', {'controller.law': law, **SHORT}).save(tmp_path / name)
    found = dz.compare(tmp_path / 'a', str(tmp_path / 'b'))
    assert list(found.comparison.views) == ['a', 'b']
    with pytest.raises(ConfigurationError, match='or the path of one'):
        dz.compare(3, 4)


def test_a_small_sweep_needs_no_processes_and_has_the_same_rows(monkeypatch):
    source, over = dz.load('wang2004', SHORT), {'plant.b': [0.9, 1.0, 1.1]}
    with_processes = dz.sweep(source, over, jobs=2)
    jobs = []

    def noted(plan, file, count):
        jobs.append(count)
        return run_sweep(plan, file, 1)

    monkeypatch.setattr('dz_ros.studies.sweep.run_sweep', noted)
    assert dz.sweep(source, over) == with_processes
    dz.sweep(dz.load('wang2004', {'loop.duration': 300.0}), {'plant.b': [0.9, 1.0]})
    assert jobs == [1, 0]


@pytest.mark.slow
def test_another_plant_in_a_sweep_refuses_lists_that_do_not_fit():
    rows = dz.sweep(dz.load('wang2004', SHORT), {'plant.model': ['pendulum', 'valve_actuator']})
    assert rows[0]['lost'] == 0
    assert rows[1]['reason'].startswith('refused: ')
    assert 'does not fit valve_actuator' in rows[1]['reason']


def test_what_is_no_system_of_python_control_is_refused():
    with pytest.raises(ConfigurationError, match='system of python-control'):
        dz.from_control(3)
    with pytest.raises(ConfigurationError, match='must be a plant or a configuration'):
        dz.to_control(3)
    with pytest.raises(ConfigurationError, match='must be one axis'):
        dz.to_control(dz.load({'loop.axes': ['a', 'b']}))


@pytest.mark.parametrize(('rates', 'words'), [
    (lambda x, u: [x[1] + u[0], u[0]], 'chain form'),
    (lambda x, u: [x[1], u[0] ** 3], 'affine'),
    (lambda x, u: [x[1], -u[0]], 'constant input gain'),
    (lambda x, u: [x[1], (1.0 + x[0] ** 2) * u[0]], 'constant input gain'),
])
def test_systems_that_are_no_such_plant_are_refused(rates, words):
    control = pytest.importorskip('control')
    system = control.nlsys(lambda t, x, u, p: rates(x, u), None, inputs=1, states=2, name='s')
    with pytest.raises(ConfigurationError, match=words):
        dz.from_control(system)


@pytest.mark.slow
def test_a_script_that_sweeps_without_a_guard_is_refused_with_the_cure(tmp_path):
    script = tmp_path / 'script.py'
    script.write_text(f"""
import dz_ros as dz
dz.sweep(dz.load('wang2004', {SHORT!r}), {{'controller.lambda': [1, 2, 4]}}, jobs=2)
""")
    environment = {**os.environ, 'PYTHONPATH': str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False,
                          env=environment)
    assert done.returncode == 1
    assert "which needs if __name__ == '__main__' or jobs=1" in done.stderr


@pytest.mark.slow
def test_the_first_example_of_the_page_is_a_script(tmp_path):
    page = (Path(__file__).parents[2] / 'docs' / 'python.md').read_text(encoding='utf-8')
    script = tmp_path / 'script.py'
    script.write_text(page.partition('```python')[2].partition('```')[0], encoding='utf-8')
    environment = {**os.environ, 'PYTHONPATH': str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False,
                          env=environment, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, '')
    assert done.stdout.count('<Run wang2004 on wang2004') == 1
    assert len(dz.read(tmp_path / 'runs' / 'from_python')) == 4001


@pytest.mark.parametrize('compiled', [None, True])
def test_a_loop_that_diverges_is_one_error_with_the_time(compiled):
    with pytest.raises(DivergedError, match=r'^the loop diverged, .* at t = 0\.03 s$') as found:
        dz.simulate('wang2004', {'controller.lambda': 50}, compiled=compiled)
    assert isinstance(found.value, dz.DzRosError)
    machine = dz.load({'loop.axes': ['a', 'b'], **SHORT, 'axes.b.controller.lambda': 50.0})
    with pytest.raises(DivergedError, match='axis b: the loop diverged'):
        dz.simulate(machine, compiled=compiled)


def test_a_mistake_in_a_class_is_no_divergence():
    class Broken(Servo):
        """Cannot be evaluated at all."""

        name = 'broken'

        @staticmethod
        def regressors(x, p, out):
            """Fail."""
            raise ValueError('a mistake')

    with pytest.raises(ValueError, match='a mistake'):
        dz.simulate({'plant.model': Broken, **SHORT})


def test_a_mistake_in_a_class_later_on_keeps_its_text():
    class Late(Servo):
        """Cannot be evaluated beyond a position."""

        name = 'late'

        @staticmethod
        def regressors(x, p, out):
            """Fail."""
            if x[0] > 0.01:
                raise ValueError('the table ends at 0.01')
            out[0], out[1] = x[1], 0.0

    with pytest.raises(ValueError, match='the table ends'):
        dz.simulate({'plant.model': Late, **SHORT})


def test_a_run_that_diverged_shows_that_it_failed():
    run = dz.simulate('wang2004', SHORT)
    values = run.data.channels['state'].values.copy()
    values[100:, 2] = np.nan
    state = replace(run.data.channels['state'], values=values)
    broken = dz.Run(replace(run.data, channels={**run.data.channels, 'state': state}))
    assert ('FAILED: the loop diverged, its numbers are no longer finite at t = 0.5 s'
            in repr(broken))
    assert 'FAILED' not in repr(run)


@pytest.mark.parametrize('name', ['six_axes', 'two_link_arm'])
def test_a_machine_is_simulated_as_its_axes(name):
    run = dz.simulate(name, {'loop.duration': 0.5})
    apart = simulate_axes(dz.load(name, {'loop.duration': 0.5}))
    for axis in run.axes:
        assert np.array_equal(run.axis(axis).v, apart[axis].v)
