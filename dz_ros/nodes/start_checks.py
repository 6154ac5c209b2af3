"""The design rules at the start of the controller: what they say is logged, errors refuse.

A line a finding, the assumptions that are met on one; `dz check` has words and numbers of each.
Every rule of `dz check` applies. Of λ one run is simulated, with the λ configured, in about 0.1 s;
how far it is from the limit takes `dz check`. Gains set while the loop runs are judged by the
rules that need no simulation: the initial state is behind it then, and the loop must not wait.
"""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.node import Node

from dz_ros.core.configuration import Configuration
from dz_ros.core.design_rules import check
from dz_ros.core.finding import ERROR, Finding, INFO
from dz_ros.core.stability import lost_from_start
from dz_ros.errors import ConfigurationError

Line = tuple[bool, str]
"""Whether it is a warning, and what it says."""


def refuse_bad_design(configuration: Configuration, starting: bool = True) -> list[Line]:
    """Return what the design rules say, to be logged; refuse what they call an error.

    Args:
        configuration: What is to run. `controller.override_checks` turns refusal into a warning;
            it is part of the configuration, so a recording says so.
        starting: False where the loop runs already: nothing is simulated, and only what has to
            be complained of is said.

    Raises:
        ConfigurationError: A rule finds an error and nothing overrides it.
    """
    override = configuration.controller_settings.override_checks
    findings = check(configuration, lost=lost_from_start(configuration) if starting else None)
    for finding in findings:
        if finding.level == ERROR and not override:
            raise ConfigurationError(
                'controller.law', configuration.law.name,
                f'design rule {finding.rule}: {finding.words}; {finding.change}; or start it all '
                'the same with controller.override_checks: true')
    lines = [(False, f'design rules, assumptions: {_assumptions(findings)}')] if starting else []
    return lines + [(finding.level != INFO, _line(finding)) for finding in findings
                    if finding.level != INFO or (starting and not _verdict(finding))]


def log(node: Node, lines: Iterable[Line]) -> None:
    """Log what was said."""
    for warns, text in lines:
        if warns:
            node.get_logger().warning(text)
        else:
            node.get_logger().info(text)


def _verdict(finding: Finding) -> str:
    """Return the word for an assumption that is met; empty = the finding is something else."""
    word = finding.words.partition(':')[0]
    return word if finding.level == INFO and word in ('holds', 'stated') else ''


def _assumptions(findings: Iterable[Finding]) -> str:
    """Return the names of the assumptions that are met, on one line."""
    names: dict[str, list[str]] = {}
    for finding in findings:
        if word := _verdict(finding):
            names.setdefault(word, []).append(finding.rule)
    return '; '.join(f'{word}: {", ".join(rules)}' for word, rules in names.items())


def _line(finding: Finding) -> str:
    """Return a finding as a line of the log."""
    change = f'; {finding.change}' if finding.change else ''
    overridden = ' (overridden error)' if finding.level == ERROR else ''
    return f'design rule {finding.rule}{overridden}: {finding.words}{change}'
