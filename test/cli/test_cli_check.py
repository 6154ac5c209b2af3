# SPDX-License-Identifier: Apache-2.0
"""`dz check`: findings as text and as JSON, and the exit code that scripts look at."""

import json

import pytest

from dz_ros.cli.check import format_findings
from dz_ros.cli.main import main
from dz_ros.core.design.finding import ERROR, Finding, INFO, WARNING
from dz_ros.files.configurations import shipped_configurations


def checked(capsys, *words):
    code = main(['check', *words])
    return code, capsys.readouterr().out


def test_the_paper_s_example(capsys):
    code, out = checked(capsys, 'wang2004')
    assert code == 0
    assert 'k* = 2.5 covers the dead-zone (rho/m_min = 1.029)' in out
    flowing = ' '.join(out.split())
    assert '|s| <= 0.02 1/s: |x̃1| <= 0.02, |x̃2| <= 0.04 1/s' in flowing
    assert 'from this initial state the sampled loop is lost above λ = 8' in out
    assert out.endswith('0 errors, 0 warnings\n')
    assert max(len(line) for line in out.splitlines()) <= 96


def test_an_error_is_exit_code_1_and_stands_last(capsys):
    code, out = checked(capsys, 'wang2004', '--quick', '--set', 'controller.k_star=1')
    assert code == 1
    block = out.split('\n\n')[-2]
    assert block.startswith('(18)\n    ERROR: k* = 1 does not cover the dead-zone')
    assert '→ raise k* to 1.029' in block
    assert out.endswith('1 error, 0 warnings\n')


def test_a_warning_is_exit_code_0(capsys):
    code, out = checked(capsys, 'wang2004', '--quick', '--disturbance', '2')
    assert code == 0
    assert 'WARNING' in out
    assert '0 errors, 1 warning\n' in out


def test_a_lambda_too_steep_is_found_by_simulation(capsys):
    words = ('wang2004', '--set', 'controller.lambda=9')
    assert checked(capsys, *words, '--quick')[0] == 0
    code, out = checked(capsys, *words)
    assert code == 1
    assert 'lost above λ = 8' in out


def test_json(capsys):
    code, out = checked(capsys, 'wang2004', '--json', '--quick', '--set', 'loop.rate=12')
    found = json.loads(out)
    assert code == 1
    assert found['worst'] == 'error'
    chatter = [item for item in found['findings'] if item['rule'] == 'chatter']
    assert [item['numbers']['delay'] for item in chatter] == [0.0, 1.0, 2.0]
    assert chatter[1]['numbers']['smallest_epsilon'] is None     # infinite


@pytest.mark.parametrize('name', shipped_configurations())
def test_shipped_configurations_may_start(name, capsys):
    assert checked(capsys, name, '--quick')[0] == 0


def test_nonsense(capsys):
    assert main(['check', 'wang2004', '--disturbance', '-1']) == 2
    assert main(['check', 'wang2004', '--disturbance', 'nan']) == 2
    assert 'must be a finite number >= 0' in capsys.readouterr().err


def test_levels_are_ordered_and_changes_indented():
    text = format_findings([Finding(ERROR, 'a', 'bad', {}, 'mend it'), Finding(INFO, 'b', 'fine'),
                            Finding(WARNING, 'c', 'so so')])
    assert text == ('b\n    fine\n\nc\n    WARNING: so so\n\na\n    ERROR: bad\n    → mend it\n\n'
                    '1 error, 1 warning')
