# SPDX-License-Identifier: Apache-2.0
"""Files that tools of the ecosystem read: in form, and in agreement with package.xml."""

from itertools import pairwise
import json
from pathlib import Path
import re
import xml.etree.ElementTree as ET

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
pytestmark = pytest.mark.skipif(not (ROOT / 'package.xml').is_file(),
                                reason='needs the source tree')


@pytest.fixture(scope='module')
def manifest():
    return ET.parse(ROOT / 'package.xml').getroot()


def sources():
    return [path for folder in ('dz_ros', 'test', 'tools', 'benchmarks', 'launch', 'examples')
            for path in sorted((ROOT / folder).rglob('*.py'))
            if not {'build', '.venv'} & set(path.parts)]


PROGRAMS = ('*.js', '*.css', '*.html', '*.c', '*.h', '*.sh')


def test_every_source_file_names_its_licence(manifest):
    line = f'SPDX-License-Identifier: {manifest.findtext("license")}'
    others = [path for folder in ('dz_ros', 'benchmarks', 'tools', 'examples')
              for pattern in PROGRAMS for path in sorted((ROOT / folder).rglob(pattern))
              if not {'build', '.venv', 'vendor'} & set(path.parts)]
    assert {path.suffix for path in others} == {pattern[1:] for pattern in PROGRAMS}
    files = [*sources(), *others, *(ROOT / name for name in (
        'setup.py', 'docs/conf.py', 'scripts/dz', '.ci/run', 'Makefile', 'Dockerfile'))]
    bare = [str(path.relative_to(ROOT)) for path in files
            if path.stat().st_size and line not in path.read_text(encoding='utf-8')[:200]]
    assert bare == []


def test_fewer_examples_by_the_profile_are_fewer_in_every_test():
    fixed = [f'{path.relative_to(ROOT)}: {found[0]}' for path in sources()
             if 'test' in path.parts and path.name != 'conftest.py'
             for found in [re.findall(r'max_examples=\d+[,)]', path.read_text(encoding='utf-8'))]
             if found]
    assert fixed == []      # a part of settings.default.max_examples instead


def test_tests_of_a_file_are_run_by_one_worker(request):
    """Which xdist does by the end of a test's name: it must be there."""
    if not request.config.getoption('loadgroup', False):
        pytest.skip('not run by pytest-xdist with --dist loadgroup')
    assert request.node.nodeid.endswith('@test/test_conventions.py')


def test_the_changelog_is_one_that_bloom_reads(manifest):
    text = (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')
    rule, title, again, *rest = text.splitlines()
    assert title == f'Changelog for package {manifest.findtext("name")}'
    assert rule == again == '^' * len(title)
    heads = [above for above, below in pairwise(rest)
             if below and set(below) == {'-'} and len(below) >= len(above) > 0]
    version = manifest.findtext('version')
    assert heads[0] == 'Forthcoming' or re.fullmatch(rf'{version} \(\d{{4}}-\d\d-\d\d\)', heads[0])
    changelog = pytest.importorskip('catkin_pkg.changelog')
    changelog.populate_changelog_from_rst(changelog.Changelog(manifest.findtext('name')), text)


def test_pixi_names_what_setup_requires():
    tomllib = pytest.importorskip('tomllib', reason='Python 3.10 has no tomllib')
    pixi = tomllib.loads((ROOT / 'pixi.toml').read_text(encoding='utf-8'))
    assert {'linux-64', 'linux-aarch64'} == set(pixi['workspace']['platforms'])
    named = {*pixi['dependencies'], *pixi['pypi-dependencies']}
    text = (ROOT / 'setup.py').read_text(encoding='utf-8')
    required = text.partition('install_requires=[')[2].partition(']')[0]
    assert set(re.findall(r"'(\w+)[><=]", required)) <= named


def test_the_workflow_calls_parts_of_ci_that_exist():
    flow = yaml.safe_load((ROOT / '.github' / 'workflows' / 'ci.yml').read_text(encoding='utf-8'))
    targets = set(re.findall(r'^([a-z-]+):', (ROOT / 'Makefile').read_text(encoding='utf-8'),
                             re.MULTILINE))
    steps = [step['run'] for job in flow['jobs'].values() for step in job['steps']
             if 'run' in step]
    called = {word for step in steps if step.startswith('make ') for word in step.split()[1:]}
    assert called
    assert called <= targets
    pythons = flow['jobs']['quick']['strategy']['matrix']['python']
    assert pythons == ['3.10', '3.11', '3.12', '3.13']


def test_the_container_of_editors_is_json():
    container = json.loads((ROOT / '.devcontainer' / 'devcontainer.json').read_text())
    assert (ROOT / '.devcontainer' / container['build']['dockerfile']).resolve().is_file()


def test_rosdoc2_takes_the_site():
    parts = list(yaml.safe_load_all((ROOT / 'rosdoc2.yaml').read_text(encoding='utf-8')))
    folder = parts[1]['builders'][0]['sphinx']['sphinx_sourcedir']
    assert (ROOT / folder / 'conf.py').is_file()
