"""Does the valve choke? The answer hangs on a number of the paper that nothing else supports.

Its series at high R_v was made with the valve in another setting, said to resist 1.303 times as much. Choked
flow needs another ratio to come near all three series, and which one was measured the paper does not tell. So
both laws, with heat in both, are held against the readings at the paper's ratio and at the one that is best
for choked flow.
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
"""Ratio of the two settings at which choked flow leaves least, to 0.02."""


@dataclass(frozen=True)
class FlowLawFit:
    """Both laws at one ratio of the valve's settings."""

    settings_ratio: float
    ohm: DischargeModel
    choked: DischargeModel

    @property
    def choked_above(self) -> tuple[float, ...]:
        """−2 ln of the evidence of choked flow, above that of Ohm's law, by kind of noise."""
        return tuple(
            b.minus_2_ln - a.minus_2_ln for a, b in zip(self.ohm.worths, self.choked.worths, strict=True)
        )


def flow_laws(found: Discharges, papers_ratio: float) -> tuple[FlowLawFit, FlowLawFit]:
    """At the paper's ratio, as found, and at the other."""
    as_found = FlowLawFit(papers_ratio, found.of(*OHM), found.of(*CHOKED))
    return as_found, at_ratio(BEST_FOR_CHOKED, found.kinds)


def at_ratio(settings_ratio: float, kinds: tuple[Noise, ...]) -> FlowLawFit:
    """Both laws fitted to the series with this ratio."""
    known, case = causes(), paper_case(settings_ratio)
    with threadpool_limits(1):
        ohm, choked = (candidate(case, kinds, [known[name] for name in names]) for names in (OHM, CHOKED))
    return FlowLawFit(settings_ratio, ohm, choked)
