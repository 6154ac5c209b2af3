"""Adaptive sliding control, made without the dead-zone in mind [slotine_coetsee1986], any order n.

    v = −k_d s + φ̂ u_fd + Yᵀθ̂ − k sat(s/ε),   θ̂_i' = −γ Y_i s_ε,   φ̂' = −η u_fd s_ε

The form is that of (14)–(16) of [wang2004]; what differs is k, made for the disturbance alone:
k ≥ |disturbance|/(b m). Proven for a plant without dead-zone: s → the layer. With one, nothing is
proven unless k happens to exceed ρ/m_min + disturbance.
"""

from __future__ import annotations

from dz_ros.core.laws.adaptive import Adaptive, SwitchingGains


class Sliding(Adaptive):
    """(14)–(16) with k for the disturbance only."""

    name = 'sliding'
    summary = 'adaptive sliding control after Slotine and Coetsee 1986, unaware of the dead-zone'
    Gains = SwitchingGains
