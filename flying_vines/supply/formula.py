"""The paper's equations for the reservoir, with the numbers of the profile."""

from __future__ import annotations

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics import paper


def n_cycles(p: PneumaticsConfig, reservoir_kPa: float) -> float:
    """Cycles left by the paper's Eq. 8, for gauge reservoir pressure; not below 0."""
    by_paper = paper.n_cycles(
        reservoir_kPa,
        reservoir_volume_L=p.reservoir_volume_L,
        cv_volume_L=p.cv_volume_L,
        swing_kPa=p.cycle_swing_kPa,
        rate_kPa_per_s=p.cycle_rate_kPa_per_s,
        flow_resistance_kPa_s_per_SL=p.evp_flow_resistance_kPa_s_per_SL,
    )
    return max(0.0, by_paper)


def floor_kPa(p: PneumaticsConfig, rate_kPa_per_s: float) -> float:
    """Minimum gauge pressure of a reservoir that fills a CV at `rate_kPa_per_s`."""
    return paper.min_reservoir_kPa(rate_kPa_per_s, p.evp_flow_resistance_kPa_s_per_SL, p.cv_volume_L)
