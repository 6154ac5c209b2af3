# SPDX-License-Identifier: Apache-2.0
"""The reference pages made from the code leave nothing out and have a meaning for everything."""

from dataclasses import fields
from fnmatch import fnmatch
from pathlib import Path
import re
import sys

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / 'tools'))

from make_reference import pages  # noqa: E402

import dz_ros  # noqa: E402
from dz_ros.cli.verbs import VERBS  # noqa: E402
from dz_ros.core.configuration import every_field, SECTIONS  # noqa: E402
from dz_ros.core.events import KINDS  # noqa: E402
from dz_ros.core.laws import LAWS  # noqa: E402
from dz_ros.core.records import Command, Reference, State, Terms, Truth  # noqa: E402
from dz_ros.files.configurations import load_configuration, shipped_configurations  # noqa: E402
from dz_ros.recording.channels import CHANNELS  # noqa: E402


@pytest.fixture(scope='module')
def made():
    return pages()


def rows(page):
    """Return the cells of every row of every table of a page."""
    return [[cell.strip() for cell in re.split(r'(?<!\\)\|', line)[1:-1]]
            for line in page.splitlines() if line.startswith('| `')]


def test_every_key_has_type_default_range_and_meaning(made):
    found = rows(made['keys'])
    assert set(every_field()) == {row[0].strip('`') for row in found}
    for row in found:
        assert len(row) == 7
        assert all(row[place] for place in range(1, 6)), row


def test_every_number_has_a_unit():
    scale = {'process.priority'}    # of the scheduler, whose numbers are ranks
    assert scale == {key for key, field in every_field().items()
                     if field.kind in ('float', 'floats', 'int', 'ints') and not field.spec.unit}


def test_every_key_that_a_document_names_is_one():
    documents = [*ROOT.glob('*.md'), *(ROOT / 'examples').glob('*/*.md'),
                 *(path for path in sorted((ROOT / 'docs').rglob('*.md'))
                   if path.parent.name != 'reference')]
    key = re.compile(rf'`((?:{"|".join(SECTIONS)})\.[a-z_*0-9.]+)[`=:]')
    named = {(path.name, name) for path in documents
             for name in key.findall(path.read_text(encoding='utf-8'))}
    assert len(named) > 100
    known = {*every_field(), 'plant.dead_zone'}
    assert [(path, name) for path, name in sorted(named)
            if not any(fnmatch(item, name) for item in known)] == []


def test_every_verb_has_its_help(made):
    for path, verb in VERBS.items():
        part = made['verbs'].split(f'\n### dz {" ".join(path)}\n')
        assert len(part) == 2, path
        assert f'usage: dz {" ".join(path)}' in part[1].split('\n### ')[0]
        assert verb.summary[:20] in part[1]


def test_every_channel_and_field_has_unit_and_meaning(made):
    page = made['messages']
    assert {row[0].strip('`') for row in rows(page.split('\n## ')[0])} == set(CHANNELS)
    sections = {part.partition('\n')[0]: part for part in page.split('\n## ')[1:]}
    for topic, wanted in {'reference': Reference.labels(2), 'state': State.labels(2),
                          'command': Command.labels(), 'terms': Terms.labels(()),
                          'truth': Truth.labels()}.items():
        found = rows(sections[topic])
        assert tuple(row[0].strip('`') for row in found) == wanted
        assert all(row[1] and row[2] for row in found)


def test_every_other_topic_and_service_is_in_the_document_on_topics():
    text = (ROOT / 'docs' / 'topics.md').read_text(encoding='utf-8')
    text += (ROOT / 'docs' / 'replay.md').read_text(encoding='utf-8')
    found = set()
    for path in (ROOT / 'dz_ros' / 'nodes').rglob('*.py'):
        found |= set(re.findall(r"create_(?:publisher|subscription|service)\(\s*[\w.\[\]']+,\s*"
                                r"'([^']+)'", path.read_text(encoding='utf-8')))
    assert {'/diagnostics', '/clock', '~/estop', '~/reset'} <= found
    assert [name for name in sorted(found) if name.removeprefix('~') not in text] == []


def test_every_event_and_field_has_a_meaning(made):
    sections = {part.partition('\n')[0]: part for part in made['events'].split('\n## ')[1:]}
    assert set(sections) == {name for name in KINDS if name}
    for name, kind in KINDS.items():
        found = {row[0].strip('`'): row[1] for row in rows(sections[name])}
        assert set(found) == {item.name for item in fields(kind)} - {'more'}
        assert all(found.values()), (name, found)


def test_every_signal_of_every_law_has_unit_and_meaning(made):
    sections = {part.partition('\n')[0]: part for part in made['signals'].split('\n## ')[1:]}
    assert set(sections) == {'Every law', *LAWS.all()}
    for name in shipped_configurations():
        for c in load_configuration(name).each:
            listed = {row[0].strip('`') for row in rows(sections[c.law.name])}
            own = {re.sub(r'\d+', '', item) for item in c.law.signal_names}
            assert own <= {re.sub(r'\d+', '', item) for item in listed}, (name, own - listed)
    assert all(all(row[place] for place in (2, 3, 4)) for row in rows(made['signals']))


def test_the_api_has_every_public_name(made):
    assert re.findall(r'auto(?:class|function):: dz_ros\.(\w+)', made['api']) == dz_ros.__all__
