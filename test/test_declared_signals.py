# SPDX-License-Identifier: Apache-2.0
"""What a law declares appears everywhere: report, live page, layouts, CSV; recordings stay valid.

Nothing but a declaration and a kernel is written here.
"""

import csv
import importlib.util
import json
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.core.loop.offline import simulate
from dz_ros.live.columns import Layout
from dz_ros.live.node_configurations import labels_of
from dz_ros.report import plots_law
from dz_ros.report.view import View

ROOT = Path(__file__).parents[1]
LAW = '''
"""A PD law that also reports the heat of the winding, the integral of v²."""
from dz_ros.core.laws.pd import Pd
from dz_ros.core.signals import places, Role, S, Signal, STATUS, TERMS
from dz_ros.core.tracking import filtered_error

HEAT = Signal('heat', 'v^2 s', 'integral of v²', symbol='Q_w')
KNOWN = any(item.name == 'v_work' for item in TERMS)
(WORK,) = places(TERMS, 'v_work' if KNOWN else 's')


class Warm(Pd):
    name = 'warm'
    summary = 'PD and the heat of the winding'

    @property
    def signals(self):
        return (HEAT,)

    def initial_memory(self):
        return (0.0,)

    @staticmethod
    def kernel(c, memory, x_d, x, y, dt, new_memory, terms):
        s = filtered_error(c, 2, x_d, x)
        v = -c[0] * s
        new_memory[0] = memory[0] + dt * v * v
        terms[WORK] = v
        terms[S] = s
        terms[STATUS] = 0.0
        terms[STATUS + 1] = memory[0]
        return v
'''
FLAT = {'controller.law': 'warm_law:Warm', 'plant.model': 'servo', 'loop.duration': 2.0}


@pytest.fixture
def law(tmp_path, monkeypatch):
    """Put the module of a user's law where it can be imported; return its folder."""
    (tmp_path / 'warm_law.py').write_text(LAW, encoding='utf-8')
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop('warm_law', None)


def layouts(c):
    spec = importlib.util.spec_from_file_location('make_layouts', ROOT / 'tools/make_layouts.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.layouts(c)


@pytest.mark.slow
def test_a_signal_with_a_unit_is_seen_wherever_signals_are_shown(law, capsys):
    c = Configuration.from_flat(FLAT)
    run = simulate(c)
    assert np.array_equal(simulate_fast(c).terms, run.terms)
    picture = plots_law.estimates(View.of(from_run(run)))
    assert picture.figure.axes[0].get_ylabel() == '$Q_{w}$  [A² s]'
    columns = {item['name']: item for item in Layout(labels_of(c)).describe(c)}
    assert columns['heat'] == {'name': 'heat', 'unit': 'A² s', 'label': 'Q_w', 'role': 'other',
                               'meaning': 'integral of v²'}
    made = layouts(c)
    titles = {panel.get('title'): [path['label'] for path in panel['paths']]
              for panel in json.loads(made['foxglove.json'])['configById'].values()
              if 'paths' in panel}
    assert titles['Signals of the law [A² s]'] == ['heat']
    assert b'name="Signals of the law [A\xc2\xb2 s]"' in made['plotjuggler_mcap.xml']
    assert main(['simulate', 'servo', '--set', 'controller.law=warm_law:Warm', '--duration', '0.1',
                 '--csv', str(law / 'run.csv')]) == 0
    with (law / 'run.csv').open(newline='', encoding='ascii') as file:
        assert 'heat' in next(csv.reader(file))


WITH_ANOTHER_TERM = '''
import json, pathlib, sys, types
import dz_ros.core
root, folder = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
sys.path[:0] = [str(folder), str(root / 'tools')]
path = root / 'dz_ros/core/signals.py'
source = path.read_text(encoding='utf-8')
changed = source.replace("""'v_extra'),
)""", """'v_extra'),
    Signal('v_work', 'v', 'work', Role.TERM),
)""")
assert changed != source
module = sys.modules['dz_ros.core.signals'] = types.ModuleType('dz_ros.core.signals')
dz_ros.core.signals = module
exec(compile(changed, str(path), 'exec'), vars(module))

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.core.loop.offline import simulate
from dz_ros.live.columns import Layout
from dz_ros.live.node_configurations import labels_of
from dz_ros.recording.save import save_run, state_configuration
from dz_ros.report import plots_law
from dz_ros.report.view import View
import make_layouts

c = Configuration.from_flat(json.loads(sys.argv[3]))
run = simulate(c)
assert (simulate_fast(c).terms == run.terms).all()
data = from_run(run)
assert (data.channels['terms']['v_work'] == run.v).all()
assert plots_law.parts(View.of(data)).caption.endswith('sum of: work.')
column = next(item for item in Layout(labels_of(c)).describe(c) if item['name'] == 'v_work')
assert (column['unit'], column['role'], column['label']) == ('A', 'term of v', 'work'), column
made = make_layouts.layouts(c)
assert all(b'v_work' in contents for contents in made.values())
save_run(state_configuration(data, c.law.initial_memory()), folder / 'more')
assert main(['bag', 'audit', str(folder / 'more'), '--allow-import', 'warm_law']) == 0
for name in ('robust', 'wang2004'):
    assert main(['bag', 'audit', str(root / 'test/data/recordings' / name)]) == 0
'''


@pytest.mark.slow
def test_a_field_of_terms_needs_its_declaration_and_a_kernel(law, capfd):
    done = subprocess.run([sys.executable, '-c', WITH_ANOTHER_TERM, ROOT, law, json.dumps(FLAT)],
                          cwd=law, capture_output=True, text=True, timeout=300, check=False,
                          env={'PYTHONPATH': str(ROOT), 'PATH': '/usr/bin:/bin'})
    assert done.returncode == 0, done.stdout + done.stderr
    # Recorded with a field that this version does not declare.
    assert main(['bag', 'audit', str(law / 'more'), '--allow-import', 'warm_law', '--json']) == 0
    assert 'terms.v_work' not in json.loads(capfd.readouterr().out)['fields']
