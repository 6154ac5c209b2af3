# SPDX-License-Identifier: Apache-2.0
"""Every command and cell of the tutorials, in order, as a reader types them."""

import os
from pathlib import Path
import re
import subprocess
import sys

import pytest

from dz_ros.core.lateness import LATE_COUNT

ROOT = Path(__file__).resolve().parent.parent
TUTORIALS = sorted((ROOT / 'docs' / 'tutorials').glob('*.md'))
BLOCK = re.compile(r'^```sh( ros)?\n(.*?)^```', re.MULTILINE | re.DOTALL)


def blocks(path):
    """Return (starts ROS processes, commands) of a document's blocks."""
    return [(bool(ros), text) for ros, text in BLOCK.findall(path.read_text(encoding='utf-8'))]


def run(path, folder, environment, with_ros):
    script = '\n'.join(text for ros, text in blocks(path) if with_ros or not ros)
    environment = {**environment, 'PATH': f'{Path(sys.executable).parent}:{environment["PATH"]}',
                   'DZ_CONFIG': ''}
    done = subprocess.run(['bash', '-euo', 'pipefail', '-c', script], cwd=folder, env=environment,
                          capture_output=True, text=True, timeout=600, check=False)
    failed = [line for line in done.stdout.splitlines() if line.startswith('FAILED')]
    # A check that fails while the machine itself stood still is not the tutorial's fault.
    late = failed and all('the machine was late too' in line for line in failed)
    assert done.returncode == 0 or late, done.stdout[-2000:] + done.stderr[-2000:]
    assert 'Traceback' not in done.stderr
    return done.stdout


def test_there_are_tutorials():
    known = {'paper', 'motor', 'law', 'driver', 'report', 'tuning'}
    assert {path.stem for path in TUTORIALS} == known


@pytest.mark.slow
@pytest.mark.parametrize('path', TUTORIALS, ids=lambda path: path.stem)
def test_the_commands_of_a_tutorial(path, tmp_path, ros_domain):
    assert os.environ['ROS_DOMAIN_ID'] == str(ros_domain)    # dz driver check has a node as well
    out = run(path, tmp_path, dict(os.environ), with_ros=False)
    if any('dz simulate' in text for _, text in blocks(path)):
        assert 'max |x̃|' in out


@pytest.mark.ros
@pytest.mark.parametrize('path', [path for path in TUTORIALS
                                  if any(ros for ros, _ in blocks(path))],
                         ids=lambda path: path.stem)
def test_the_commands_with_nodes(path, tmp_path, ros_domain):
    assert os.environ['ROS_DOMAIN_ID'] == str(ros_domain)
    run(path, tmp_path, dict(os.environ), with_ros=True)


@pytest.mark.slow
def test_the_notebook(tmp_path):
    import nbclient
    import nbformat

    book = nbformat.read(ROOT / 'docs' / 'tutorials' / 'notebook.ipynb', as_version=4)
    code = [cell for cell in book.cells if cell.cell_type == 'code']
    assert not any(cell.outputs for cell in code)       # the site and this test make them
    nbclient.NotebookClient(book, timeout=600, kernel_name='python3',
                            resources={'metadata': {'path': str(tmp_path)}}).execute()
    outputs = {cell.id: cell.outputs for cell in code}
    assert 'wang2004 on wang2004, 4001 samples' in outputs['simulate'][-1].data['text/plain']
    assert all('image/png' in outputs[name][-1].data for name in ('plot', 'dead-zone', 'plant'))
    shares = [float(line.split('rad, ')[1].split(' %')[0])
              for line in outputs['changed'][-1].text.splitlines()]
    assert min(shares) > 99.0


def test_the_symptoms_are_printed_by_the_program():
    text = (ROOT / 'docs' / 'troubleshooting.md').read_text(encoding='utf-8')
    rows = re.findall(r'^\| `([^`]+)`', text, re.MULTILINE)
    printed = [row for row in rows if not row.startswith('dz ')]
    assert len(printed) > 5
    sources = ''.join(path.read_text(encoding='utf-8')
                      for path in sorted((ROOT / 'dz_ros').rglob('*.py')))
    sources += LATE_COUNT       # made of the limit
    reported = re.sub(r"'\s*\n\s*f?'", '', sources)      # texts that go on in the next line
    assert [row for row in printed if row.partition(': ')[0] not in reported] == []
    assert 'the device moves against the command' in reported
