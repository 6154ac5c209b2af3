# SPDX-License-Identifier: Apache-2.0
"""Control laws, one a file; `LAWS` finds them by name."""

from dz_ros.core.laws.adaptive import Adaptive, Sliding
from dz_ros.core.laws.adaptive_inverse import AdaptiveInverse
from dz_ros.core.laws.base import Law
from dz_ros.core.laws.coupled_eso import CoupledEso
from dz_ros.core.laws.disturbance_observer import DisturbanceObserver
from dz_ros.core.laws.exact_inverse import ExactInverse
from dz_ros.core.laws.extended import Extended
from dz_ros.core.laws.fuzzy import Fuzzy
from dz_ros.core.laws.l1 import L1
from dz_ros.core.laws.ladrc import Ladrc
from dz_ros.core.laws.neural import Neural
from dz_ros.core.laws.pd import Pd
from dz_ros.core.laws.pid import Pid
from dz_ros.core.laws.robust import Robust
from dz_ros.core.laws.robust_eso import RobustEso
from dz_ros.core.laws.scheduled import Scheduled
from dz_ros.core.laws.sliding_integral import SlidingIntegral
from dz_ros.core.laws.super_twisting import SuperTwisting
from dz_ros.core.laws.wang2004 import Wang2004
from dz_ros.core.registry import Registry

LAWS = Registry('law', 'controller.law', 'dz_ros.laws', Law, {item.name: item for item in (
    RobustEso, Robust, Wang2004, Extended, Pd, Pid, Adaptive, Sliding, SlidingIntegral,
    ExactInverse, AdaptiveInverse, Fuzzy, Neural, Ladrc, DisturbanceObserver, SuperTwisting,
    L1, CoupledEso, Scheduled)})
