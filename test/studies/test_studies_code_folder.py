# SPDX-License-Identifier: Apache-2.0
"""The folder of compiled code: private or unused, damaged files and full folders are no errors."""

from pathlib import Path

import pytest

from dz_ros.studies import code_folder
from dz_ros.studies.code_folder import CodeFolder, VARIABLE


def test_what_is_saved_is_found_again(tmp_path):
    folder = CodeFolder(tmp_path / 'a' / 'b')
    assert folder.load('key') is None
    folder.save('key', b'code')
    assert CodeFolder(tmp_path / 'a' / 'b').load('key') == b'code'
    assert folder.load('another') is None
    assert (tmp_path / 'a' / 'b').stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize('damage', [lambda data: data[:-1], lambda data: b'', lambda data:
                                    data[:-1] + b'X'])
def test_a_damaged_file_is_none(tmp_path, damage):
    folder = CodeFolder(tmp_path / 'own')
    folder.save('key', b'code')
    file, = (tmp_path / 'own').iterdir()
    file.write_bytes(damage(file.read_bytes()))
    assert folder.load('key') is None


@pytest.mark.parametrize('mode', [0o770, 0o707, 0o777])
def test_a_folder_that_others_may_write_to_is_not_used(tmp_path, mode):
    own = tmp_path / 'own'
    folder = CodeFolder(own)
    folder.save('key', b'code')
    own.chmod(mode)
    folder.save('second', b'code')
    assert folder.load('key') is None
    own.chmod(0o700)
    assert folder.load('key') == b'code'
    assert folder.load('second') is None


def test_a_link_to_a_folder_is_not_used(tmp_path):
    (tmp_path / 'real').mkdir(mode=0o700)
    (tmp_path / 'link').symlink_to(tmp_path / 'real')
    CodeFolder(tmp_path / 'link').save('key', b'code')
    assert not list((tmp_path / 'real').iterdir())


def test_a_file_in_its_place_is_no_error(tmp_path):
    (tmp_path / 'file').write_text('')
    folder = CodeFolder(tmp_path / 'file')
    folder.save('key', b'code')
    assert folder.load('key') is None


def test_only_what_was_used_last_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(code_folder, 'LARGEST_COUNT', 2)
    folder = CodeFolder(tmp_path / 'own')
    for number in range(4):
        folder.save(str(number), b'code')
    assert len(list((tmp_path / 'own').iterdir())) == 2
    assert folder.load('3') == b'code'


def test_which_folder_it_is(monkeypatch, tmp_path):
    monkeypatch.delenv('NUMBA_DISABLE_JIT', raising=False)
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    CodeFolder.of_user().save('key', b'code')
    assert CodeFolder(tmp_path / 'dz_ros').load('key') == b'code'
    monkeypatch.setenv(VARIABLE, str(tmp_path / 'other'))
    assert CodeFolder.of_user().load('key') is None
    monkeypatch.setenv(VARIABLE, 'off')
    assert CodeFolder.of_user() is None
    monkeypatch.delenv(VARIABLE)
    monkeypatch.delenv('XDG_CACHE_HOME')
    monkeypatch.setattr(Path, 'home', lambda: tmp_path)
    CodeFolder.of_user().save('key', b'home')
    assert CodeFolder(tmp_path / '.cache' / 'dz_ros').load('key') == b'home'
