"""Diagnoses the recording of a calibration, starting from a rig file with the measured numbers.

Needs the extra `analysis`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from flying_vines.config.config import PneumaticsConfig
from flying_vines.identification.case import Case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.from_log import read_flight
from flying_vines.identification.report import write_report
from flying_vines.identification.search import Progress
from flying_vines.identification.verdict import Verdict, extended_rig
from flying_vines.physics.plant.true_rig import true_rig_text
from flying_vines.supply.rig_file_prior import load_rig_file_prior

BEGINNING_S = 20.0
"""Duration of the diagnosed part. With many effects, diagnosing some minutes of data takes an hour."""
EXTENDED, REPORT = "rig.toml", "diagnosis"


@dataclass(frozen=True)
class CalibrationDiagnosis:
    verdict: Verdict
    report: Path
    rig: Path | None
    """The rig file with the causes found; None if none was found."""
    helps: bool
    """True if the causes improve the estimate of the cycles left: they lower the error on unseen data, and
    they change the air that a cycle takes."""


def diagnosed(
    flight: Path, rig_file: Path, numbers: PneumaticsConfig, progress: Progress
) -> CalibrationDiagnosis:
    """Diagnose, and write report and rig to the folder of `rig_file`.

    Raises `CaseError` if nothing in the flight can be diagnosed.
    """
    case = _beginning(read_flight(flight, rig_file))
    verdict = diagnose(case, progress=progress)
    report = write_report(verdict, case, rig_file.parent / REPORT)[0]
    if not verdict.named:
        return CalibrationDiagnosis(verdict, report, None, False)
    rig = rig_file.parent / EXTENDED
    rig.write_text(true_rig_text(extended_rig(case.rig, verdict)), encoding="utf-8")
    useful = verdict.held_out.gain[0] > 0.0 and bool(load_rig_file_prior(rig, numbers).used)
    return CalibrationDiagnosis(verdict, report, rig, useful)


def _beginning(case: Case) -> Case:
    """The first `BEGINNING_S` of the first run, with a remark."""
    run = case.runs[0]
    rows = int(np.searchsorted(run.time_s, BEGINNING_S))
    columns: dict[str, Any] = {
        field.name: value[:rows]
        for field in fields(run)
        if isinstance(value := getattr(run, field.name), np.ndarray)
    }
    remark = f"only the first {BEGINNING_S:g} s of movement are diagnosed"
    return replace(case, runs=(replace(run, **columns),), remarks=(*case.remarks, remark))
