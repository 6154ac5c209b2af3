"""Control laws, one a file; `LAWS` finds them by name."""

from dz_ros.core.laws.base import Law
from dz_ros.core.laws.pd import Pd
from dz_ros.core.laws.wang2004 import Wang2004
from dz_ros.core.registry import Registry

LAWS = Registry('law', 'controller.law', 'dz_ros.laws', Law,
                {item.name: item for item in (Wang2004, Pd)})
