"""Diagnoses the paper's data: finds the causes of the difference between its measurements and the baseline.

diagnosis = diagnose_paper()
diagnosis.discharges    Fig. 3: the verdict of `identification` on the three discharges
diagnosis.responses     Fig. 5: the causes that reduce the distance to the measured gains
findings(diagnosis)     everything in words
"""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.identification.search import Progress, silent
from flying_vines.studies.paper.diagnosis.discharge import Discharges, analyse
from flying_vines.studies.paper.diagnosis.response import Responses, explain

__all__ = ["PaperDiagnosis", "diagnose_paper"]


@dataclass(frozen=True)
class PaperDiagnosis:
    """The results of the diagnosis."""

    discharges: Discharges
    responses: Responses


def diagnose_paper(progress: Progress = silent) -> PaperDiagnosis:
    """Diagnose the paper's measurements (takes half a minute).

    Args:
        progress: called with the current step, and the share of the work that is done.
    """
    discharges = analyse(lambda step, share: progress(step, 0.5 * share))
    return PaperDiagnosis(discharges, explain(lambda step, share: progress(step, 0.5 + 0.5 * share)))
