# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of verbs: no line of progress where only the machine is slow."""

import pytest

from dz_ros.cli import progress


@pytest.fixture(autouse=True)
def patient_stages(monkeypatch):
    """Have a verb that runs in this process show no stage, however long a busy machine takes."""
    monkeypatch.setattr(progress, 'NOTICED', 1e6)
