# SPDX-License-Identifier: Apache-2.0
"""The entrants of the comparison: our laws, their rivals, variants worth a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

IDEAL = 'exact_inverse'
"""The law that has the true break points, which are unknown in practice, so no rival."""


@dataclass(frozen=True)
class Entrant:
    """A law with its gains.

    Attributes:
        name: Its name.
        summary: What it is.
        changes: Keys of the configuration that make it.
    """

    name: str
    summary: str
    changes: Mapping[str, Any]


def entrants() -> dict[str, Entrant]:
    """Return name → entrant: every law that comes with the package, and variants worth a row."""
    found = [
        Entrant('robust_eso', 'the recommended law', {'controller.law': 'robust_eso'}),
        Entrant('robust', 'the law with an integral in the layer', {'controller.law': 'robust'}),
        Entrant('wang2004', "the paper's law", {'controller.law': 'wang2004'}),
        Entrant('extended', "the paper's law with projection and the bounded integral",
                {'controller.law': 'extended', 'controller.projection': True,
                 'controller.integral': True}),
        *(Entrant(name, summary, {'controller.law': name}) for name, summary in (
            ('pd', 'PD'), ('pid', 'PID'), ('adaptive', 'adaptive without a robust term'),
            ('sliding', 'adaptive sliding, after Slotine and Coetsee'),
            ('sliding_integral', 'the same with an integral in the surface'))),
        *(Entrant(f'{IDEAL} k={k:g}', 'knows b_r and b_l of the example: an ideal, not a rival',
                  {'controller.law': IDEAL, 'controller.k': k})
          for k in (0.0, 1.47, 2.5)),
        *(Entrant(name, summary, {'controller.law': name}) for name, summary in (
            ('adaptive_inverse', 'adaptive inverse, after Tao and Kokotović'),
            ('fuzzy', 'fuzzy compensation, after Lewis et al.'),
            ('neural', 'neural compensation, after Selmic and Lewis'),
            ('ladrc', 'active disturbance rejection, after Gao, one extended state'))),
        Entrant('ladrc 2', 'the same with two extended states',
                {'controller.law': 'ladrc', 'controller.extended_states': 2}),
        *(Entrant(name, summary, {'controller.law': name}) for name, summary in (
            ('disturbance_observer', 'nominal model and disturbance observer, after Chen et al.'),
            ('super_twisting', 'adaptive-gain super-twisting, after Shtessel et al.'),
            ('l1', 'L1 adaptive control, after Hovakimyan and Cao'))),
    ]
    return {item.name: item for item in found}
