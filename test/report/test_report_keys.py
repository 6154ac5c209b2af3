# SPDX-License-Identifier: Apache-2.0
"""Keys have a meaning: of every class that has some, and in the table of every report."""

import html
from pathlib import Path
import re

import pytest

import dz_ros
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.driven import DRIVERS
from dz_ros.core.laws import LAWS
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants import PLANTS
from dz_ros.core.schema import fields
from dz_ros.core.trajectories import TRAJECTORIES
from dz_ros.errors import UnknownNameError
from dz_ros.files.configurations import load_configuration
from dz_ros.report.sections import configuration
from dz_ros.report.view import View

SHIPPED = sorted((Path(dz_ros.__file__).parents[1] / 'config').glob('*.yaml'))


def classes():
    for registry, group in ((DRIVERS, 'Parameters'), (PLANTS, 'Parameters'), (LAWS, 'Gains'),
                            (TRAJECTORIES, 'Parameters')):
        for name, found in registry.all().items():
            if isinstance(found, UnknownNameError):
                assert registry is DRIVERS, found       # of a module that is not installed here
                continue
            yield pytest.param(getattr(found, group), id=f'{registry.kind} {name}')


@pytest.mark.parametrize('group', list(classes()))
def test_every_key_states_what_it_is(group):
    for item in fields(group):
        assert len(item.spec.description.split()) > 1, item.name


@pytest.mark.parametrize('path', SHIPPED, ids=lambda path: path.stem)
def test_every_key_in_a_report_has_its_meaning(path):
    c = load_configuration(path)
    for _, own in c.axes or (('', c),):     # a report is of one axis
        flat = {**own.to_flat(), 'loop.duration': 2.0 * own.loop.period}
        run = from_run(simulate(Configuration.from_flat(flat)))
        rows = [[html.unescape(cell) for cell in re.findall(r'<t[hd] [^>]*>(.*?)</t[hd]>', row)]
                for row in re.findall(r'<tr role="row">(<th scope="row".*?)</tr>',
                                      configuration(View.of(run)))]
        assert {row[0] for row in rows} >= set(own.to_flat())
        assert [row[0] for row in rows if not row[3]] == []
