# SPDX-License-Identifier: Apache-2.0
"""docs/safety.md reports what the code does: tables of states, parameters and their defaults."""

from pathlib import Path
import re

from dz_ros.core.safety.modes import LIFECYCLE, MODES
from dz_ros.core.safety.settings import SafetySettings
from dz_ros.core.schema import fields
from dz_ros.files.configurations import shipped_configurations
from dz_ros.studies.scenarios import scenarios

TEXT = (Path(__file__).parents[1] / 'docs' / 'safety.md').read_text(encoding='utf-8')


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
