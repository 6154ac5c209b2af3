# SPDX-License-Identifier: Apache-2.0
"""The result of one design rule."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

ERROR, WARNING, INFO = 'error', 'warning', 'info'


@dataclass(frozen=True)
class Finding:
    """Result of a design rule: level (error, warning, info), rule such as ``(18)``, a sentence.

    Attributes:
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
