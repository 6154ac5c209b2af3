"""The design rules at the start of the controller: warnings are logged, errors refuse.

Only the rules that need no simulation; `dz check` also finds the stability limit on λ.
"""

from __future__ import annotations

from rclpy.node import Node

from dz_ros.core.configuration import Configuration
from dz_ros.core.design_rules import check
from dz_ros.core.finding import ERROR, INFO
from dz_ros.errors import ConfigurationError


def refuse_bad_design(node: Node, configuration: Configuration) -> None:
    """Log what the design rules complain of; refuse what they call an error.

    Args:
        node: Logs the findings.
        configuration: What is to run. `controller.override_checks` turns refusal into a warning;
            it is part of the configuration, so a recording says so.

    Raises:
        ConfigurationError: A rule finds an error and nothing overrides it.
    """
    override = configuration.controller_settings.override_checks
    for finding in check(configuration):
        if finding.level == INFO:
            continue
        if finding.level == ERROR and not override:
            raise ConfigurationError(
                'controller.law', configuration.law.name,
                f'design rule {finding.rule}: {finding.words}; {finding.change}; or start it all '
                'the same with controller.override_checks: true')
        change = f'; {finding.change}' if finding.change else ''
        overridden = ' (overridden error)' if finding.level == ERROR else ''
        node.get_logger().warning(
            f'design rule {finding.rule}{overridden}: {finding.words}{change}')
