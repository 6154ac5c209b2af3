#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Entry point of the container: the built workspace, and dz and the nodes by their names.
set -e
. /workspace/install/setup.bash
PATH=/workspace/install/dz_ros/lib/dz_ros:$PATH exec "$@"
