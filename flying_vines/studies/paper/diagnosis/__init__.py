"""Diagnoses the paper's data: finds the causes of the difference between its measurements and the baseline.

diagnosis = diagnose_paper()
diagnosis.discharges    Fig. 3: every tested set of causes, with its evidence
diagnosis.proposal      an experiment of one minute that separates the remaining explanations
diagnosis.responses     Fig. 5: the causes that can explain the gains
verdict.findings(diagnosis)     everything in words
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
    """The results of the diagnosis."""

    discharges: Discharges
    flow_laws: tuple[FlowLawFit, FlowLawFit]
    """With the paper's ratio of the valve's settings, and with another ratio."""
    proposal: ExperimentProposal
    responses: Responses


def diagnose_paper(progress: Callable[[str], None] = lambda step: None) -> PaperDiagnosis:
    """Diagnose the paper's measurements (takes half a minute); `progress` is called with each step."""
    discharges = analyse(progress)
    progress("flow laws")
    laws = flow_laws(discharges, HIGH_RESISTANCE_RATIO)
    return PaperDiagnosis(discharges, laws, propose(discharges, progress), account_for(progress))
