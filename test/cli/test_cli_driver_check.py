# SPDX-License-Identifier: Apache-2.0
"""`dz driver check`: what is refused before anything is checked."""

import pytest

from dz_ros.cli.main import main


@pytest.mark.parametrize(('given', 'message'), [
    ((), 'give a driver, a configuration or --topics'),
    (('mock', '--topics'), 'give a driver, a configuration or --topics'),
    (('no_such',), 'no such driver'),
    (('--topics',), 'give --yes without a terminal'),
    (('mock', '--amplitude', '-1'), '--amplitude'),
    (('mock', '--amplitude', '9', '--set', 'driver.limit=5'), 'from 0 to 5'),
    (('mock', '--set', 'driver.script=[sometimes]'), 'driver.script'),
])
def test_what_cannot_be_asked_is_one_line(monkeypatch, capsys, given, message):
    monkeypatch.setattr('sys.stdin.isatty', lambda: False, raising=False)
    assert main(['driver', 'check', *given]) == 2
    printed, error = capsys.readouterr()
    assert printed == ''
    assert message in error
    assert error.count('\n') == 1
