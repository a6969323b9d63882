"""Tests whether the valve chokes. The answer depends on one unsupported number of the paper.

The paper's series at high R_v has another valve setting, with 1.303 times the resistance. Choked flow needs
another ratio to fit all three series, and the paper does not say how the ratio was measured. So both laws,
each with heat, are compared with the readings at the paper's ratio, and at the best ratio for choked flow.
"""

from __future__ import annotations

from dataclasses import dataclass

from threadpoolctl import threadpool_limits

from flying_vines.studies.paper.diagnosis.discharge import (
    DischargeModel,
    Discharges,
    candidate,
    causes,
    paper_case,
)
from flying_vines.studies.paper.diagnosis.evidence import Noise

OHM = ("evp_restriction", "reservoir_wall")
CHOKED = (*OHM, "compressible_flow")
BEST_FOR_CHOKED = 1.24
"""Ratio of the two settings with the lowest residuals for choked flow, to 0.02."""


@dataclass(frozen=True)
class FlowLawFit:
    """Both laws at one ratio of the valve's settings."""

    settings_ratio: float
    ohm: DischargeModel
    choked: DischargeModel

    @property
    def choked_above(self) -> tuple[float, ...]:
        """−2 ln of the evidence: choked flow minus Ohm's law, for each kind of noise."""
        return tuple(
            b.minus_2_ln - a.minus_2_ln for a, b in zip(self.ohm.worths, self.choked.worths, strict=True)
        )


def flow_laws(found: Discharges, papers_ratio: float) -> tuple[FlowLawFit, FlowLawFit]:
    """Both laws at the paper's ratio, and at the best ratio for choked flow."""
    as_found = FlowLawFit(papers_ratio, found.of(*OHM), found.of(*CHOKED))
    return as_found, at_ratio(BEST_FOR_CHOKED, found.kinds)


def at_ratio(settings_ratio: float, kinds: tuple[Noise, ...]) -> FlowLawFit:
    """Both laws, fitted to the series with this ratio."""
    known, case = causes(), paper_case(settings_ratio)
    with threadpool_limits(1):
        ohm, choked = (candidate(case, kinds, [known[name] for name in names]) for names in (OHM, CHOKED))
    return FlowLawFit(settings_ratio, ohm, choked)
