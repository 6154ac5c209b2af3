# SPDX-License-Identifier: Apache-2.0
"""docs/safety.md reports what the code does: tables of states, parameters and their defaults."""

from pathlib import Path
import re

from dz_ros.core.safety.modes import LIFECYCLE, MODES
from dz_ros.core.safety.settings import SafetySettings
from dz_ros.core.schema import fields
from dz_ros.files.configurations import shipped_configurations
from dz_ros.recording import axes_cdr, cdr
from dz_ros.studies.scenarios import scenarios

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / 'docs' / 'safety.md').read_text(encoding='utf-8')


def table(name):
    """Return the rows between two marks as tuples of cells, without the head."""
    block = re.search(f'<!-- {name} -->\n(.*?)<!-- end of {name} -->', TEXT, re.DOTALL).group(1)
    return [tuple(cell.strip() for cell in line.strip('|').split('|'))
            for line in block.strip().splitlines()[2:]]


def test_the_table_of_modes_is_the_codes():
    assert table('mode table') == [
        (mode.value, event.value, following.value, action.value)
        for (mode, event), (following, action) in MODES.items()]


def test_the_table_of_the_lifecycle_is_the_codes():
    assert table('lifecycle table') == [
        (state.value, name, following.value, event.value if event else '-')
        for (state, name), (following, event) in LIFECYCLE.items()]


def test_every_parameter_is_listed_with_default_and_unit():
    listed = dict(re.findall(r'^\| `(\w+)` \| (\S+ \| [^|]*?) *\|', TEXT, re.MULTILINE))
    assert listed == {item.name: f'{item.default} | {item.spec.unit}'
                      for item in fields(SafetySettings)}


def test_each_fault_of_several_axes_has_its_tests():
    rows = table('axes table')
    assert len(rows) == 9
    for fault, answer, tests in rows:
        assert answer, fault
        named = re.findall(r'`([^`]+)::(\w+)`', tests)
        assert len(named) == tests.count('::') > 0, fault
        for file, name in named:
            text = (ROOT / file).read_text(encoding='utf-8')
            assert re.search(rf'^def {name}\(', text, re.MULTILINE), (fault, file, name)


def test_every_cause_of_a_refused_message_is_a_row():
    fault = next(cells[0] for cells in table('axes table') if cells[0].startswith('a row missing'))
    causes = {getattr(axes_cdr, name) for name in ('ROW_MISSING', 'ANOTHER_ORDER', 'OTHER_AXES',
                                                   'AXIS_TWICE', 'UNEVEN_ROWS')}
    named = {'other names': axes_cdr.OTHER_AXES, 'a name twice': axes_cdr.AXIS_TWICE,
             'another number of axes': cdr.ANOTHER_NUMBER}
    assert {named.get(item, item) for item in fault.split('; ')} == causes | {cdr.ANOTHER_NUMBER}


def test_no_false_alarm_in_any_scenario_or_shipped_configuration():
    block = re.search('<!-- false alarms: .*? -->\n(.*?)<!-- end of runaway -->', TEXT,
                      re.DOTALL).group(1)
    rows = {cells[0]: cells for line in block.strip().splitlines()[2:]
            if (cells := [cell.strip() for cell in line.strip('|').split('|')])}
    assert set(rows) == {*scenarios(), *(f'configuration {name}'
                                         for name in shipped_configurations())}
    for name, (_, runs, _, *alarms, longest, _) in rows.items():
        assert int(runs) > 0, name
        assert alarms == ['0', '0', '0'], name
        assert float(longest) < SafetySettings().runaway_time, name
