# SPDX-License-Identifier: Apache-2.0
"""Python API: what ``import dz_ros as dz`` offers to a script or a notebook.

    run = dz.simulate('wang2004', {'controller.lambda': 4})
    run.metrics.error_max, run.plot('error'), run.to_pandas()
    dz.compare(run, dz.read('runs/demo'))

Every function that runs something takes a configuration as `load` does: the name of a shipped
one, a file, a mapping of keys, nested or dotted, or a `Configuration`. A plant, a law or a
trajectory may be given as a class, a subclass of `Plant`, `Law` or `Trajectory`.
`dz_ros/__init__.py` imports this package at first use.
"""

from dz_ros.api.functions import check, compare, load, read, simulate, sweep
from dz_ros.api.python_control import from_control, to_control
from dz_ros.api.results import AxesComparison, Comparison, Findings, Run
from dz_ros.core.configuration import Configuration
from dz_ros.core.laws.base import Law
from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter
from dz_ros.core.trajectories.base import Trajectory
from dz_ros.errors import DzRosError

__all__ = ['AxesComparison', 'Comparison', 'Configuration', 'DzRosError', 'Findings', 'Law',
           'Plant', 'Run', 'Trajectory', 'check', 'compare', 'from_control', 'load', 'parameter',
           'read', 'simulate', 'sweep', 'to_control']
