# SPDX-License-Identifier: Apache-2.0
from setuptools import setup

name = 'dz_ros_example'

setup(
    name=name,
    version='0.1.0',
    packages=[name],
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{name}']),
        (f'share/{name}', ['package.xml']),
        (f'share/{name}/config', ['config/tank.yaml']),
    ],
    zip_safe=True,
    entry_points={  # the name in configurations = where the class is
        'dz_ros.plants': ['tank = dz_ros_example.tank:Tank'],
        'dz_ros.trajectories': ['logistic = dz_ros_example.logistic:Logistic'],
        'dz_ros.laws': ['pi = dz_ros_example.pi:Pi'],
    },
)
