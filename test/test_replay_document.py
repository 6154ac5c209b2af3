# SPDX-License-Identifier: Apache-2.0
"""The worked examples of docs/replay.md report what the commands print."""

from pathlib import Path
import re
import shlex

import pytest

from dz_ros.cli.main import main
from dz_ros.version import version

DOCUMENT = Path(__file__).parent.parent / 'docs' / 'replay.md'
SECTIONS = ('Audit', 'What-if', 'Compare')


def blocks():
    """Yield the console blocks of the sections in order."""
    for part in re.split(r'^## ', DOCUMENT.read_text(encoding='utf-8'), flags=re.MULTILINE)[1:]:
        if part.splitlines()[0] in SECTIONS:
            yield from re.findall(r'^```console\n(.*?)^```', part, re.DOTALL | re.MULTILINE)


def plain(text):
    """Return the lines of an output without what differs from one machine or version to another.

    Numbers keep three digits: another mathematics library rounds the last ones otherwise.
    """
    text = text.replace(f'dz_ros {version()}', 'dz_ros VERSION')
    text = re.sub(r'dz_ros \d+\.\d+\.\d+', 'dz_ros VERSION', text)
    text = re.sub(r's of loop in .*', 's of loop', text)
    text = re.sub(r'\d+\.\d{3,}(e-?\d+)?', lambda found: f'{float(found[0]):.3g}', text)
    return [' '.join(line.split()) for line in text.splitlines()]


def test_there_are_examples():
    assert sum(block.count('$ dz ') for block in blocks()) >= 7


@pytest.mark.slow
def test_examples_print_what_the_document_reports(tmp_path, monkeypatch, capsys):
    pytest.importorskip('matplotlib')
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    for block in blocks():
        for example in re.split(r'^\$ dz ', block, flags=re.MULTILINE)[1:]:
            command, _, expected = example.partition('\n')
            main(shlex.split(command))
            printed = capsys.readouterr()
            assert plain(printed.out + printed.err) == plain(expected), command
