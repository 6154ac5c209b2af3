# SPDX-License-Identifier: Apache-2.0
# dz_ros on the official ROS 2 Jazzy image:
#   docker build -t dz_ros . && docker run --rm --net=host dz_ros dz run --duration 20
FROM ros:jazzy-ros-base-noble
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# rosdep installs two packages with pip, which Ubuntu's Python refuses by default.
ENV PIP_BREAK_SYSTEM_PACKAGES=1
WORKDIR /workspace/src/dz_ros
COPY package.xml ./
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-pip python3-venv \
    && rosdep update --rosdistro jazzy \
    && rosdep install -y --from-paths . --ignore-src \
    && rm -rf /var/lib/apt/lists/*
COPY . .
WORKDIR /workspace
RUN . /opt/ros/jazzy/setup.bash && colcon build --packages-select dz_ros
COPY tools/entrypoint.sh /entrypoint.sh
ENTRYPOINT ["/entrypoint.sh"]
CMD ["dz", "--help"]
