# SPDX-License-Identifier: Apache-2.0
"""/diagnostics of a node, once a second, between two samples."""

from __future__ import annotations

from collections.abc import Callable
import socket
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from dz_ros.core.safety.health import Report

DIAGNOSTICS_PERIOD = 1.0
"""[s]"""


class Diagnostics:
    """Publishes what a node reports of itself.

    Args:
        node: The node.
        report: Returns the report of the window that ends.
    """

    def __init__(self, node: Node, report: Callable[[], Report]) -> None:
        self._node = node
        self._report = report
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._hardware = f'{socket.gethostname()}:{node.get_namespace()}'
        self._due = time.monotonic() + DIAGNOSTICS_PERIOD

    def publish_if_due(self) -> None:
        """Publish when it is time; call between two samples."""
        now = time.monotonic()
        if now >= self._due:
            self._due = max(self._due + DIAGNOSTICS_PERIOD, now + 0.5 * DIAGNOSTICS_PERIOD)
            self.publish()

    def publish(self) -> None:
        """Publish the report."""
        report = self._report()
        status = DiagnosticStatus(
            level=bytes([int(report.level)]), name=self._node.get_fully_qualified_name(),
            message=report.message, hardware_id=self._hardware,
            values=[KeyValue(key=key, value=value) for key, value in report.values.items()])
        message: Any = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
