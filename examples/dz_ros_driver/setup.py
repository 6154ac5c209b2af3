# SPDX-License-Identifier: Apache-2.0
from setuptools import setup

name = 'dz_ros_driver'

setup(
    name=name,
    version='0.1.0',
    packages=[name],
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{name}']),
        (f'share/{name}', ['package.xml']),
    ],
    zip_safe=True,
    entry_points={
        # the name in configurations = where the class is
        'dz_ros.drivers': ['thruster = dz_ros_driver.thruster:Thruster'],
        'console_scripts': ['driver_node = dz_ros_driver.driver_node:main'],
    },
)
