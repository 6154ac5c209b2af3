# SPDX-License-Identifier: Apache-2.0
"""What a check of the conformance kit found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """The result of one check.

    Attributes:
        name: The check.
        passed: None where it could not be seen or was not asked for.
        figure: What was found, as text with unit.
        limit: What it had to be.
        words: Why it failed, or could not be seen; '' where it passed.
    """

    name: str
    passed: bool | None
    figure: str
    limit: str
    words: str = ''
