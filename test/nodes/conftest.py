"""Fixtures of the tests of nodes."""

from dataclasses import replace

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop import simulate
from dz_ros.recording.save import save_run


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    """One second of the loop, simulated; samples 5 ms apart."""
    path = tmp_path_factory.mktemp('replay') / 'run'
    data = from_run(simulate(Configuration.from_flat({'loop.duration': 1.0})), 10 ** 18)
    events = ((10 ** 18 + 7, '/plant_node', '{"event": "started"}'),)
    save_run(replace(data, events=events), path)
    return path
