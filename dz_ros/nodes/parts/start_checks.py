# SPDX-License-Identifier: Apache-2.0
"""The design rules at the start of the controller: findings are logged, errors refuse.

One line with the assumptions that are met and what k* covers, and one for each warning; `dz
check` has the rest. Of λ one run is simulated, with the λ configured, in about 0.1 s; `dz check`
computes the distance to the limit. Gains set while the loop runs are judged by the rules that need
no simulation.
"""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.node import Node

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import ERROR, Finding, INFO
from dz_ros.core.design.robust_gain import RobustGain
from dz_ros.core.design.rules import check
from dz_ros.core.design.stability import lost_from_start
from dz_ros.errors import ConfigurationError

Line = tuple[bool, str]
"""Whether it is a warning, and its text."""


class DesignLog:
    """Logs the findings of the design rules on a node's configuration that are new."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lines: list[Line] = []
        self._warned: dict[str, str] = {}

    def judge(self, configuration: Configuration, starting: bool = True) -> None:
        """Apply the rules, as `refuse_bad_design`; `log` then logs the findings."""
        self._lines = refuse_bad_design(configuration, starting)

    def log(self) -> None:
        """Log what was not logged before; of a rule that warned already, other numbers as info."""
        warned = {_rule(text): text for warns, text in self._lines if warns}
        lines = [(warns and _rule(text) not in self._warned, text)
                 for warns, text in self._lines if text not in self._warned.values()]
        log(self._node, lines)
        self._lines, self._warned = [], warned


def refuse_bad_design(configuration: Configuration, starting: bool = True) -> list[Line]:
    """Return the findings of the design rules on every axis, to be logged; refuse errors.

    Args:
        configuration: What is to run. `controller.override_checks` turns refusal into a warning;
            it is part of the configuration, so a recording shows it.
        starting: False where the loop runs already: nothing is simulated, and only complaints
            are returned.

    Raises:
        ConfigurationError: A rule finds an error and nothing overrides it.
    """
    if not configuration.axes:
        return _axis_lines(configuration, starting)
    lines = []
    for name, item in configuration.axes:
        try:
            lines += [(warns, f'axis {name}: {text}')
                      for warns, text in _axis_lines(item, starting)]
        except ConfigurationError as error:
            error.args = (f'axis {name}: {error}',)
            raise
    return lines


def _axis_lines(configuration: Configuration, starting: bool) -> list[Line]:
    """Return what `refuse_bad_design` does of one axis.

    Raises:
        ConfigurationError: A rule finds an error and nothing overrides it.
    """
    override = configuration.controller_settings.override_checks
    findings = check(configuration, lost=lost_from_start(configuration) if starting else None,
                     complaints=not starting)
    for finding in findings:
        if finding.level == ERROR and not override:
            raise ConfigurationError(
                'controller.law', configuration.law.name,
                f'design rule {finding.rule}: {finding.words}; {finding.change}; or start it all '
                'the same with controller.override_checks: true')
    warnings = [(True, _line(finding)) for finding in findings if finding.level != INFO]
    if not starting:
        return warnings
    gain = RobustGain.of(configuration)
    parts = [f'design rules, assumptions: {_assumptions(findings)}', 'details: dz check']
    if gain is not None and not any(gain.words in text for _, text in warnings):
        parts.insert(1, gain.words)
    return [(False, '; '.join(parts)), *warnings]


def _rule(text: str) -> str:
    """Return what a line is about: a rule, on an axis."""
    return ':'.join(text.split(':')[:1 + text.startswith('axis ')])


def log(node: Node, lines: Iterable[Line]) -> None:
    """Log findings."""
    for warns, text in lines:
        if warns:       # two places: rclpy allows each one severity
            node.get_logger().warning(text)
        else:
            node.get_logger().info(text)


def _verdict(finding: Finding) -> str:
    """Return the word for an assumption that is met; empty = the finding is something else."""
    word = finding.words.partition(':')[0]
    return word if finding.level == INFO and word in ('holds', 'stated') else ''


def _assumptions(findings: Iterable[Finding]) -> str:
    names: dict[str, list[str]] = {}
    for finding in findings:
        if word := _verdict(finding):
            names.setdefault(word, []).append(finding.rule)
    return '; '.join(f'{word}: {", ".join(rules)}' for word, rules in names.items())


def _line(finding: Finding) -> str:
    change = f'; {finding.change}' if finding.change else ''
    overridden = ' (overridden error)' if finding.level == ERROR else ''
    return f'design rule {finding.rule}{overridden}: {finding.words}{change}'
