# SPDX-License-Identifier: Apache-2.0
"""One schema for every value: types, ranges, names, sections that fit, errors as text.

Over 300 lines: a table of refused values takes a third.
"""

from dataclasses import dataclass
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration, MOST_ITEMS
from dz_ros.core.laws import LAWS
from dz_ros.core.plants import PLANTS
from dz_ros.core.schema import parameter
from dz_ros.core.trajectories import TRAJECTORIES
from dz_ros.errors import ConfigurationError, DzRosError, UnknownNameError


@dataclass(frozen=True)
class Group:
    """One of each kind."""

    number: float = parameter(1.0, 'm', 'a length', minimum=0.0, maximum=10.0, open_minimum=True)
    count: int = parameter(2, '1', 'a count', minimum=0)
    flag: bool = parameter(False, '', 'a flag')
    mode: str = parameter('a', '', 'a choice', choices=('a', 'b'))
    text: str = parameter('', '', 'any text')
    pair: tuple[float, ...] = parameter((1.0, 2.0), 'm', 'two numbers', length=2)
    names: tuple[str, ...] = parameter((), '', 'some names')
    lambda_: float = parameter(1.0, '1/s', 'a keyword of Python')


def refused(values):
    with pytest.raises(ConfigurationError) as caught:
        schema.build(Group, values, 'plant.')
    message = str(caught.value)
    assert '\n' not in message
    assert message.startswith(f'plant.{next(iter(values))} = ')
    return message


def test_values_are_converted_to_their_kind():
    made = schema.build(Group, {'number': 3, 'count': 4.0, 'flag': True, 'mode': 'b',
                                'pair': [1, 2.5], 'names': ['x'], 'lambda': 2})
    assert made == Group(3.0, 4, True, 'b', '', (1.0, 2.5), ('x',), 2.0)
    assert [type(item) for item in (made.number, made.count, made.pair[0])] == [float, int, float]
    assert schema.build(Group, {'pair': np.array([1.0, 2.0])}).pair == (1.0, 2.0)
    assert schema.build(Group, {}) == Group()


def test_written_and_read_again_is_the_same():
    made = schema.build(Group, {'number': 3.5, 'pair': [3.0, 4.0], 'names': ['x', 'y']})
    flat = schema.to_dict(made)
    assert flat['lambda'] == 1.0
    assert flat['pair'] == [3.0, 4.0]
    assert schema.build(Group, flat) == made


@pytest.mark.parametrize('value', [0.0, -1.0, 10.1, math.nan, math.inf, -math.inf, 'three', True,
                                   None, [1.0], 10 ** 400])
def test_refuses_a_number(value):
    message = refused({'number': value})
    assert 'must be a finite number > 0 and <= 10 [m]' in message


@pytest.mark.parametrize('value', [-1, 1.5, True, '2', math.nan, math.inf, None])
def test_refuses_a_count(value):
    assert 'must be an integer >= 0' in refused({'count': value})


@pytest.mark.parametrize('value', [1, 0, 'true', None, 1.0])
def test_refuses_a_flag(value):
    assert 'must be true or false' in refused({'flag': value})


@pytest.mark.parametrize('value', ['c', '', 1, None, ['a']])
def test_refuses_a_choice(value):
    assert 'must be one of a, b' in refused({'mode': value})


@pytest.mark.parametrize('value', [[1.0], [1.0, 2.0, 3.0], [], [1.0, math.nan], 1.0, 'ab',
                                   [1.0, 'b'], [1.0, True], {'a': 1.0, 'b': 2.0}, None])
def test_refuses_a_list(value):
    assert 'list of' in refused({'pair': value})


@pytest.mark.parametrize('value', ['x', [1], 3])
def test_refuses_a_list_of_texts(value):
    assert 'must be a list of texts' in refused({'names': value})


@pytest.mark.slow
@given(st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(),
                 st.lists(st.floats()), st.dictionaries(st.text(), st.integers())),
       st.sampled_from([item.name for item in schema.fields(Group)]))
def test_any_nonsense_is_taken_or_refused_in_one_line(value, name):
    caught = None
    try:
        made = schema.build(Group, {name: value})
    except ConfigurationError as error:
        caught = error
    if caught is None:
        assert schema.build(Group, schema.to_dict(made)) == made
    else:
        assert (caught.key, caught.value) == (name, value)
        assert '\n' not in str(caught)


def test_unknown_names_point_to_the_nearest():
    assert 'did you mean plant.number?' in refused({'numbr': 1.0})
    assert 'known: ' in refused({'qqqq': 1.0})


def test_errors_are_also_those_of_the_standard_library():
    assert issubclass(ConfigurationError, ValueError)
    assert issubclass(UnknownNameError, LookupError)
    assert issubclass(UnknownNameError, ConfigurationError)
    assert issubclass(ConfigurationError, DzRosError)


def test_defaults_are_the_paper_s_example():
    c = Configuration.from_flat({})
    assert (c.plant.name, c.law.name, c.trajectory.name) == ('wang2004', 'wang2004', 'sinusoid')
    assert (c.loop.period, c.loop.samples) == (0.005, 4000)
    assert c.x0 == (-2.5, 3.5)
    assert c.noise == (0.0, 0.0)
    assert c.law.initial_memory() == (0.85, 0.85, 0.85)
    assert c.dead_zone.constants[1:5] == (1.0, 1.0, 0.5, -0.6)


@pytest.mark.parametrize('model', PLANTS.builtin)
@pytest.mark.parametrize('kind', [name for name in TRAJECTORIES.builtin if name != 'waypoints'])
@pytest.mark.parametrize('law', ['wang2004', 'pd'])
def test_flat_and_back_is_the_same_for_every_combination(model, kind, law):
    c = Configuration.from_flat({'plant.model': model, 'trajectory.kind': kind,
                                 'controller.law': law})
    flat = c.to_flat()
    again = Configuration.from_flat(flat)
    assert again.to_flat() == flat
    assert again.set_aside == ()
    assert (flat['plant.model'], flat['trajectory.kind'], flat['controller.law']) == (
        model, kind, law)
    assert again.plant.constants == c.plant.constants
    assert again.law.constants == c.law.constants
    assert again.trajectory.constants == c.trajectory.constants
    assert len(c.x0) == c.plant.order == c.trajectory.order == c.law.order


def test_replace_changes_what_it_is_given_and_nothing_else():
    c = Configuration.from_flat({'controller.lambda': 2.0})
    changed = c.replace(**{'loop.delay': 1, 'plant.dead_zone.b_r': 0.3})
    assert changed.loop.delay == 1
    assert changed.dead_zone.b_r == 0.3
    same = {key: value for key, value in changed.to_flat().items()
            if key not in ('loop.delay', 'plant.dead_zone.b_r')}
    assert same.items() <= c.to_flat().items()
    assert c.loop.delay == 0


OTHERS = {'float': (0.3, 2.0, 11.0, -1.0, math.nan, 'text'), 'int': (0, 1, 3, -1, 2.5),
          'bool': (True, False, 1), 'strings': (['x'], [], 3),
          'str': ('robust', 'pd', 'chirp', 'friction', 'lockstep', 'nothing', 1),
          'floats': ([], [0.1], [0.1, 0.2], [0.5, 0.5, 0.5], [math.inf], 1.0)}
"""Values by kind, some of which each key refuses."""
FULL = {'plant.dead_zone.m_r': 1.3, 'plant.b': 1.1, 'controller.law': 'robust',
        'controller.k_star': 2.5, 'trajectory.frequency': 0.7, 'safety.command_limit': 30.0,
        'loop.seed': 7, 'process.priority': 0, 'driver.name': 'simulated'}


@pytest.mark.parametrize('key', list(Configuration.from_flat(FULL).fields()))
def test_a_replaced_key_gives_what_all_keys_together_give(key):
    c = Configuration.from_flat(FULL)

    def made(change):
        try:
            found = change()
        except DzRosError as error:
            return str(error)
        return (found.to_flat(), found.set_aside, found.x0, found.noise, found.zone_numbers,
                found.law.constants, found.plant.constants, found.trajectory.constants)

    field = c.fields()[key]
    for value in (*OTHERS[field.kind], *field.spec.choices):
        assert made(lambda value=value: c.replace(**{key: value})) == made(
            lambda value=value: Configuration.from_changed(c.to_flat(), {key: value}))


def test_keys_of_another_class_are_set_aside_so_that_a_law_is_changed_by_one_word():
    c = Configuration.from_flat({'controller.law': 'pd', 'controller.k_star': 2.5,
                                 'plant.mass': 11.0, 'trajectory.bandwidth': 3.0})
    assert set(c.set_aside) == {'controller.k_star', 'plant.mass', 'trajectory.bandwidth'}


BASE = {'plant.model': 'wang2004', 'plant.x0': [-2.5, 3.5], 'plant.noise': [0.0, 0.01],
        'controller.theta_0': [0.1, 0.2], 'controller.lambda': 2.0}


@pytest.mark.parametrize('change', ['from_changed', 'replace'])
def test_lists_of_another_plant_that_do_not_fit_are_set_aside(change):
    def with_(**overrides):
        return (Configuration.from_changed(BASE, overrides) if change == 'from_changed'
                else Configuration.from_flat(BASE).replace(**overrides))

    c = with_(**{'plant.model': 'valve_actuator'})
    assert c.x0 == c.plant.default_x0
    assert c.noise == (0.0, 0.0, 0.0)
    assert c.law.regressor_count == 3
    assert 'controller.theta_0' in c.fields()
    assert c.to_flat()['controller.theta_0'] != [0.1, 0.2]
    assert c.to_flat()['controller.lambda'] == 2.0
    lists = {'plant.x0', 'plant.noise', 'controller.theta_0'}
    assert {key for key in c.set_aside if key in c.misfitting} == lists
    c = with_(**{'plant.model': 'pendulum'})
    assert c.x0 == (-2.5, 3.5)
    assert 'plant.x0' not in c.misfitting
    with pytest.raises(ConfigurationError, match=r'plant\.x0') as caught:
        with_(**{'plant.model': 'valve_actuator', 'plant.x0': [1.0, 2.0]})
    assert caught.value.value == [1.0, 2.0]
    with pytest.raises(ConfigurationError, match=r'plant\.x0'):
        with_(**{'plant.x0': [1.0]})
    default = {'plant.x0': [-2.5, 3.5]}     # names no plant
    c = Configuration.from_changed(default, {'plant.model': 'valve_actuator'})
    assert 'plant.x0' in c.misfitting


@pytest.mark.parametrize(('base', 'changed', 'reports'), [
    ({'plant.model': 'servo', 'plant.x0': [1.0]}, {'plant.model': 'servo'}, r'plant\.x0'),
    ({'plant.x0': [1.0]}, {'plant.model': 'wang2004'}, r'plant\.x0'),      # that by default
    ({'plant.model': 'servo', 'controller.b_r_bounds': [0.9, 0.1]}, {'plant.model': 'pendulum'},
     'b_r_bounds'),
    ({'plant.model': 'servo', 'plant.noise': [-1.0]}, {'plant.model': 'pendulum'}, 'noise'),
    ({'plant.model': 'servo', 'plant.x0': ['a', 'b']}, {'plant.model': 'pendulum'}, 'x0'),
    ({'plant.model': 'servo', 'plant.disturbance_pulse': [1.0, 2.0]}, {'plant.model': 'pendulum'},
     'disturbance_pulse')])
def test_a_list_that_is_wrong_otherwise_is_refused_beside_another_plant(base, changed, reports):
    with pytest.raises(ConfigurationError, match=reports):
        Configuration.from_changed(base, changed)


def test_a_list_of_all_axes_that_does_not_fit_one_is_noted_with_that_axis():
    base = {'loop.axes': ['a', 'b'], 'plant.noise': [0.0, 0.1], 'axes.a.plant.noise': [0.2]}
    c = Configuration.from_changed(base, {'plant.model': 'valve_actuator'})
    assert [key for key in c.set_aside if key in c.misfitting] == ['axes.b.plant.noise']
    machine = Configuration.from_flat({'loop.axes': ['a', 'b'], 'plant.x0': [1.0, 2.0]})
    other = machine.replace(**{'plant.model': 'valve_actuator'})
    assert [key for key in other.set_aside if key in other.misfitting] == ['plant.x0']
    again = other.replace(**{'plant.x0': [0.1, 0.2, 0.3]})
    assert 'plant.x0' not in again.misfitting
    assert again.axis('b').x0 == (0.1, 0.2, 0.3)


def test_axes_with_another_plant_set_their_lists_aside():
    base = {**BASE, 'loop.axes': ['a', 'b'], 'axes.b.plant.x0': [1.0, 2.0]}
    c = Configuration.from_changed(base, {'plant.model': 'valve_actuator'})
    lists = {'plant.x0', 'plant.noise', 'controller.theta_0', 'axes.b.plant.x0'}
    assert {key for key in c.set_aside if key in c.misfitting} == lists
    assert c.axis('a').x0 == c.axis('b').x0 == c.plant.default_x0


@pytest.mark.parametrize(('flat', 'key', 'reports'), [
    ({'controller.lamda': 1.0}, 'controller.lamda', 'did you mean controller.lambda?'),
    ({'lambda': 1.0}, 'lambda', 'did you mean controller.lambda?'),
    ({'motor.speed': 1.0}, 'motor.speed', 'see dz list keys'),
    ({'loop': {'rate': 200.0}}, 'loop', 'unknown key'),
    ({'loop.rat': 200.0}, 'loop.rat', 'did you mean loop.rate?'),
    ({'plant.dead_zone.m': 1.0}, 'plant.dead_zone.m', 'unknown key'),
    ({'plant.dead_zone': 1.0}, 'plant.dead_zone', 'unknown key'),
    ({'loop.rate': 0.0}, 'loop.rate', '>= 1'),
    ({'loop.delay': -1}, 'loop.delay', '>= 0'),
    ({'loop.timing': 'soon'}, 'loop.timing', 'one of'),
    ({'loop.duration': -1.0}, 'loop.duration', '>= 0'),
    ({'plant.substeps': 0}, 'plant.substeps', '>= 1'),
    ({'plant.b': 0.0}, 'plant.b', '> 0'),
    ({'plant.x0': [1.0]}, 'plant.x0', '2 numbers'),
    ({'plant.model': 'first_order', 'plant.x0': [1.0, 2.0]}, 'plant.x0', '1 number'),
    ({'plant.noise': [1.0, 1.0, 1.0]}, 'plant.noise', '1 or 2'),
    ({'plant.noise': []}, 'plant.noise', '1 or 2'),
    ({'plant.noise': [-1.0]}, 'plant.noise', '>= 0'),
    ({'plant.command_limit': -1.0}, 'plant.command_limit', '>= 0'),
    ({'plant.model': 'wang2005'}, 'plant.model', 'known: wang2004'),
    ({'controller.law': 'lqr'}, 'controller.law', 'no such law'),
    ({'trajectory.kind': 'circle'}, 'trajectory.kind', 'no such trajectory'),
    ({'plant.model': 'no_such_module:Plant'}, 'plant.model', 'cannot be loaded'),
    ({'plant.model': 'math:Plant'}, 'plant.model', 'cannot be loaded'),
    ({'plant.model': 'math:pi'}, 'plant.model', 'is not a Plant'),
    ({'plant.model': ':'}, 'plant.model', 'cannot be loaded'),
    ({'plant.model': 'dz_ros.core.laws.pd:Pd'}, 'plant.model', 'is not a Plant'),
    ({'controller.theta_0': [1.0, 2.0, 3.0]}, 'controller.theta_0', '1 or 2'),
    ({'controller.b_r_bounds': [0.6, 0.1]}, 'controller.b_r_bounds', 'lower bound'),
    ({'controller.m_bounds': [0.0, 1.0]}, 'controller.m_bounds', '> 0'),
    ({'controller.b_l_bounds': [-0.1, 0.1]}, 'controller.b_l_bounds', '<= 0'),
    ({'trajectory.kind': 'waypoints'}, 'trajectory.times', 'at least 2'),
    ({'plant.dead_zone.b_r': -0.5}, 'plant.dead_zone.b_r', '>= 0'),
])
def test_refuses_and_reports_what_is_allowed(flat, key, reports):
    with pytest.raises(ConfigurationError) as caught:
        Configuration.from_flat(flat)
    assert caught.value.key == key
    assert reports in str(caught.value)
    assert '\n' not in str(caught.value)


def test_a_trajectory_that_is_not_smooth_enough_is_refused():
    plant = type('Fifth', (PLANTS.load('valve_actuator'),), {'order': 5, 'default_x0': (0.0,) * 5})
    globals()['Fifth'] = plant
    with pytest.raises(ConfigurationError, match='gives 4 derivatives, the plant needs 5'):
        Configuration.from_flat({'plant.model': f'{__name__}:Fifth',
                                 'trajectory.kind': 'point_to_point'})


@pytest.mark.parametrize(('source', 'reports'), [
    ('class Mine(', 'SyntaxError'),
    ('raise RuntimeError("two\\nlines")', 'RuntimeError: two lines'),
    ('import no_such_module', 'ModuleNotFoundError'),
    ('Mine = 3', 'is not a Plant'),
    ('from dz_ros.core.plants.base import Plant\nclass Mine(Plant):\n    order = 1',
     'does not define Parameters, actuator_unit, default_x0, name, regressor_count'),
    ('from dz_ros.core.plants.servo import Servo\nfrom dz_ros.core.plants.base import Plant\n'
     'class Mine(Servo):\n    a = Plant.a', 'does not define a'),
])
def test_a_user_s_broken_module_is_one_line(source, reports, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    module = f'broken_{abs(hash(source))}'
    (tmp_path / f'{module}.py').write_text(source, encoding='utf-8')
    with pytest.raises(UnknownNameError) as caught:
        PLANTS.load(f'{module}:Mine')
    assert reports in str(caught.value)
    assert '\n' not in str(caught.value)


def test_samples_of_a_duration_that_is_no_multiple_of_the_period():
    assert Configuration.from_flat({'loop.duration': 0.0124}).loop.samples == 2
    assert Configuration.from_flat({'loop.duration': 0.0}).loop.samples == 0
    assert Configuration.from_flat({'loop.rate': 30.0, 'loop.duration': 1.0}).loop.samples == 30


@pytest.mark.parametrize('registry', [PLANTS, LAWS, TRAJECTORIES])
def test_registries_list_what_there_is(registry):
    found = registry.all()
    assert registry.builtin.items() <= found.items()
    for name, item in registry.builtin.items():
        assert registry.load(name) is item
        assert item.name == name
        assert registry.load(f'{item.__module__}:{item.__name__}') is item


def test_every_parameter_of_every_class_reports_unit_and_meaning():
    for registry, group in ((PLANTS, 'Parameters'), (LAWS, 'Gains'),
                            (TRAJECTORIES, 'Parameters')):
        for item in registry.builtin.values():
            for found in schema.fields(getattr(item, group)):
                assert found.spec.description
                assert found.spec.unit or found.kind in ('bool', 'str', 'strings')
                schema.check_value(found, found.default, found.name)


@pytest.mark.parametrize(('text', 'cores'), [
    ('', set()), ('1', {1}), ('0,2-3', {0, 2, 3}), ('3-1', set())])
def test_cores_are_read_as_taskset_reads_them(text, cores):
    found = Configuration.from_flat({'process.cores': text})
    assert found.process.core_numbers == cores
    assert found.replace().process == found.process


@pytest.mark.parametrize('text', ['a', '1,', '-1', '1--2', '99999', '1 2'])
def test_cores_that_are_none_are_refused(text):
    with pytest.raises(ConfigurationError, match=r'process\.cores'):
        Configuration.from_flat({'process.cores': text})


WAYPOINTS = {'trajectory.kind': 'waypoints', 'trajectory.times': [0.5 * k for k in range(400)],
             'trajectory.positions': [float(k % 7) for k in range(400)]}


def test_a_change_elsewhere_keeps_a_trajectory_through_many_points():
    c = Configuration.from_flat(WAYPOINTS)
    for key, value in (('controller.lambda', 1.5), ('plant.b', 1.1), ('plant.dead_zone.b_r', 0.4),
                       ('safety.command_limit', 20.0), ('loop.rate', 100.0)):
        changed = c.replace(**{key: value})
        assert changed.trajectory is c.trajectory
        assert changed.to_flat() == {**c.to_flat(), key: value}
        assert changed.to_flat() == Configuration.from_flat(changed.to_flat()).to_flat()
    assert c.replace(**{'trajectory.repeat': False}).trajectory is not c.trajectory
    assert c.replace(**{'plant.model': 'first_order'}).trajectory is not c.trajectory


def test_design_rules_follow_a_trajectory_once(monkeypatch):
    from dz_ros.core.design.rules import check

    c = Configuration.from_flat({**WAYPOINTS, 'plant.a3': 1.0})
    first = check(c)
    calls = []
    original = type(c.trajectory).evaluate
    monkeypatch.setattr(type(c.trajectory), 'evaluate', staticmethod(
        lambda *numbers: calls.append(1) or original(*numbers)))
    assert check(c.replace(**{'controller.lambda': 1.01}))
    assert check(c) == first
    assert not calls


@pytest.mark.parametrize('value', ['9' * 10_000, [0.5] * 10_000, 10 ** 4000, 1 << 100_000,
                                   {'a': ['b' * 1000]}], ids=lambda value: type(value).__name__)
def test_what_an_error_shows_is_bounded(value):
    for key in ('plant.x0', 'plant.' + 'x' * 10_000):
        with pytest.raises(ConfigurationError) as refused:
            Configuration.from_flat({key: value})
        assert len(str(refused.value)) < 1000


def test_lists_of_recordings_are_bounded():
    points = {'trajectory.times': [float(k) for k in range(MOST_ITEMS + 1)],
              'trajectory.positions': [0.0, 1.0], 'trajectory.kind': 'waypoints'}
    with pytest.raises(ConfigurationError, match=f'at most {MOST_ITEMS} are taken from'):
        Configuration.from_untrusted(points)
    with pytest.raises(ConfigurationError, match='must have 50001 numbers'):    # a user's own
        Configuration.from_flat(points)
    assert Configuration.from_untrusted(points, {
        'trajectory.times': [0.0, 1.0]}).trajectory.name == 'waypoints'
