# SPDX-License-Identifier: Apache-2.0
import itertools

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import pytest
import yaml

from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import flat_parameters, foreign_sections, load_configuration
from dz_ros.files.parameter_sections import node_parameters, Section, sections

PARTS = st.sampled_from(['left', 'right', 'controller_node', '_x1', '*', '**'])
NAMES = st.builds(lambda slash, parts: slash + '/'.join(parts), st.sampled_from(['', '/']),
                  st.lists(PARTS, min_size=1, max_size=4))
NODES = [(f'/{"/".join(space)}', name)
         for space in ((), ('left',), ('right',), ('left', '_x1'), ('left', 'right', 'left'))
         for name in ('controller_node', 'left')]


def fail(problem):
    return ConfigurationError('file', '', problem)


def written(names, nested):
    """Return a parameter file with a section for each name, nested at its first / or not."""
    content = {}
    for number, (name, deep) in enumerate(zip(names, nested, strict=True)):
        parameters = {'ros__parameters': {'own': number, f's{number}': 1}}
        first, slash, rest = name.rpartition('/')
        if deep and first and slash:
            inner = content.setdefault(first, {})
            if 'ros__parameters' in inner or rest in inner:
                continue
            inner[rest] = parameters
        elif name not in content:
            content[name] = parameters
    return content


@pytest.mark.ros
@settings(max_examples=6 * settings.default.max_examples // 10, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(names=st.lists(NAMES, min_size=1, max_size=5), nested=st.lists(
    st.booleans(), min_size=5, max_size=5))
def test_a_node_is_given_what_rclpy_gives_it(ros_domain, tmp_path_factory, names, nested):
    import rclpy

    content = written(names, nested[:len(names)])
    file = tmp_path_factory.mktemp('sections') / 'c.yaml'
    file.write_text(yaml.safe_dump(content, sort_keys=False), encoding='utf-8')
    context = rclpy.Context()
    rclpy.init(args=['x', '--ros-args', '--params-file', str(file)], context=context)
    try:
        found = sections(content, fail)
        for namespace, name in NODES:
            node = rclpy.create_node(name, namespace=namespace, context=context)
            theirs = {key: item.value for key, item in node._parameter_overrides.items()}
            ours = node_parameters(found, [node.get_fully_qualified_name()], dict)
            node.destroy_node()
            assert ours == theirs, (content, namespace, name)
    finally:
        rclpy.shutdown(context=context)


@pytest.mark.ros
@pytest.mark.parametrize('name', ['a-b', '/a b/n', '/a*/n', '/a/n*', '/a/***', '/a//n', '/a/n/',
                                  '/', '1n', '/a/1n', '~n', 'é', '/a.b/n'])
def test_a_name_that_ros_refuses_is_refused(ros_domain, tmp_path, name):
    import rclpy

    file = tmp_path / 'c.yaml'
    file.write_text(yaml.safe_dump({name: {'ros__parameters': {'loop': {'rate': 100.0}}}},
                                   allow_unicode=True), encoding='utf-8')
    with pytest.raises(ConfigurationError, match='is no name of a node') as caught:
        flat_parameters(file)
    assert '\n' not in str(caught.value)
    context = rclpy.Context()
    try:
        with pytest.raises(Exception, match='parse params file'):
            rclpy.init(args=['x', '--ros-args', '--params-file', str(file)], context=context)
    finally:
        context.try_shutdown()


TWO = """
/left: {controller_node: {ros__parameters: {controller: {lambda: 2.0}}}}
/right: {controller_node: {ros__parameters: {controller: {lambda: 5.0}}}}
"""


def test_each_loop_of_a_file_gets_its_own_gains(tmp_path):
    file = tmp_path / 'two.yaml'
    file.write_text(TWO, encoding='utf-8')
    for namespace, gain in (('left', 2.0), ('/left', 2.0), ('/left/', 2.0), ('right', 5.0)):
        assert load_configuration(file, namespace=namespace).law.gains.lambda_ == gain
    assert foreign_sections(file, 'left') == ['/right/controller_node']
    with pytest.raises(ConfigurationError, match='no section for a node of the loop in '
                       'namespace /, only for /left/controller_node, /right/controller_node'):
        load_configuration(file)


def test_the_order_of_sections_decides_not_how_exact_a_name_is(tmp_path):
    exact, wild = ('/plant_node: {ros__parameters: {plant: {b: 0.7}}}\n',
                   '/**: {ros__parameters: {plant: {b: 0.5}}}\n')
    file = tmp_path / 'c.yaml'
    for order, b in ((exact + wild, 0.5), (wild + exact, 0.7)):
        file.write_text(order, encoding='utf-8')
        assert flat_parameters(file) == {'plant.b': b}


def test_the_node_whose_section_it_is_decides(tmp_path):
    file = tmp_path / 'c.yaml'
    parts = ['controller_node: {ros__parameters: {plant: {b: 2.0}, controller: {lambda: 3.0}}}\n',
             'plant_node: {ros__parameters: {plant: {b: 0.5}, controller: {lambda: 9.0}}}\n']
    for order in itertools.permutations(parts):
        file.write_text(''.join(order), encoding='utf-8')
        assert flat_parameters(file) == {'plant.b': 0.5, 'controller.lambda': 3.0}


def test_two_values_of_what_all_nodes_use_are_refused(tmp_path):
    file = tmp_path / 'c.yaml'
    file.write_text('/**: {ros__parameters: {loop: {rate: 100.0}}}\n'
                    'controller_node: {ros__parameters: {loop: {rate: 50.0}}}\n',
                    encoding='utf-8')
    with pytest.raises(ConfigurationError, match=r'loop.rate = 100.0 for plant_node and 50.0 for '
                       r'controller_node'):
        flat_parameters(file)


@pytest.mark.parametrize('text', ['.nan', '[.nan, 1.0]'])
def test_one_value_that_is_no_number_is_not_two(tmp_path, text):
    path = tmp_path / 'nan.yaml'
    path.write_text(f'/**:\n  ros__parameters:\n    loop: {{rate: {text}}}\n', encoding='utf-8')
    with pytest.raises(ConfigurationError, match=r'^loop.rate = .*nan.*must be a finite number'):
        load_configuration(path)


def test_sections_of_other_nodes_may_hold_anything(tmp_path):
    file = tmp_path / 'c.yaml'
    file.write_text('/camera: {ros__parameters: {loop: 3, exposure: {a: 1}}}\n'
                    'recorder_node: {ros__parameters: {directory: here}}\n'
                    '/**/controller_node: {ros__parameters: {controller: {lambda: 2.0}}}\n',
                    encoding='utf-8')
    assert flat_parameters(file) == {'controller.lambda': 2.0}
    assert foreign_sections(file) == ['/camera']


def test_many_wildcards_are_matched_at_once():
    name = '**/' * 2000
    deep = '/' + 'a/' * 200
    assert not Section(f'{name}x', ()).matches(f'{deep}y')
    assert Section(f'{name}x', ()).matches(f'{deep}x')
