"""Two discharges of a real plenum, outside the measured benchmark: the causes that a physicist expects."""

from __future__ import annotations

from pathlib import Path

import pytest

from flying_vines.identification.case import read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.importing.answers_file import answers_path, read_answers
from flying_vines.identification.importing.runs import propose, write_case
from flying_vines.identification.verdict import Verdict

MORE = Path(__file__).parents[1] / "data" / "measured" / "plenum_discharge" / "more"


def verdict_on(recording: str, folder: Path) -> Verdict:
    path = MORE / f"{recording}.csv"
    write_case([propose(path, read_answers(answers_path(path)))], folder / "case")
    return diagnose(read_case(folder / "case"))


@pytest.mark.long
def test_a_value_on_its_bound_shows_that_a_cause_is_missing(tmp_path: Path) -> None:
    """Without cooling, the critical pressure ratio is 0, which is impossible for a nozzle. CO2 has at most
    0.55."""
    verdict = verdict_on("20191129_144248", tmp_path)
    assert verdict.cause == "compressible_flow"
    assert {named.cause for named in verdict.also} == {"reservoir_cooling", "reservoir_sensor_offset"}
    (ratio,) = verdict.parameters.values()
    assert 0.2 < ratio.estimate < 0.55
    assert verdict.remainder is None


@pytest.mark.long
def test_two_causes_that_predict_much_better_may_leave_a_tenth(tmp_path: Path) -> None:
    verdict = verdict_on("20191129_144330", tmp_path)
    assert verdict.cause == "compressible_flow"
    assert [named.cause for named in verdict.also] == ["reservoir_cooling"]
    assert verdict.remainder is not None and 0.05 < verdict.remainder.share < 0.2
    assert verdict.held_out.nrmse_after < 0.5 * verdict.held_out.nrmse_before
    assert verdict.confidence < 0.7
