"""The paper's own data, diagnosed: what its measurements say the baseline gets wrong, and how surely.

diagnosis = diagnose_paper()
diagnosis.discharges    Fig. 3: every set of causes that was tried, with its evidence
diagnosis.proposal      the minute at the bench that would settle what is open
diagnosis.responses     Fig. 5: which cause would account for the gains
verdict.findings(diagnosis)     all of it in plain words
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flying_vines.studies.paper.compare import HIGH_RESISTANCE_RATIO
from flying_vines.studies.paper.diagnosis.discharge import Discharges, analyse
from flying_vines.studies.paper.diagnosis.experiment import ExperimentProposal, propose
from flying_vines.studies.paper.diagnosis.flow_law import FlowLawFit, flow_laws
from flying_vines.studies.paper.diagnosis.response import Responses, account_for

__all__ = ["PaperDiagnosis", "diagnose_paper"]


@dataclass(frozen=True)
class PaperDiagnosis:
    """What the paper's measurements say."""

    discharges: Discharges
    flow_laws: tuple[FlowLawFit, FlowLawFit]
    """At the ratio of the valve's settings that the paper uses, and at another."""
    proposal: ExperimentProposal
    responses: Responses


def diagnose_paper(progress: Callable[[str], None] = lambda step: None) -> PaperDiagnosis:
    """Confront all that the paper measured with the baseline and its possible causes (half a minute).

    Args:
        progress: is told what is being done.
    """
    discharges = analyse(progress)
    progress("flow laws")
    laws = flow_laws(discharges, HIGH_RESISTANCE_RATIO)
    return PaperDiagnosis(discharges, laws, propose(discharges, progress), account_for(progress))
