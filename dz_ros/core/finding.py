"""What a design rule says of a configuration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

ERROR, WARNING, INFO = 'error', 'warning', 'info'


@dataclass(frozen=True)
class Finding:
    """What one rule says of a configuration.

    Attributes:
        level: error, warning or info.
        rule: Short name of the rule, e.g. ``(18)``.
        words: One sentence.
        numbers: Name → value, those the sentence is about.
        change: What to change; empty where nothing has to.
    """

    level: str
    rule: str
    words: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    change: str = ''


def worst(findings: Iterable[Finding]) -> str:
    """Return the gravest level among findings."""
    levels = {finding.level for finding in findings}
    return ERROR if ERROR in levels else WARNING if WARNING in levels else INFO
