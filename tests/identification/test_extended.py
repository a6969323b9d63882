"""The rig file of a verdict, written and read again."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from typing import Any

from flying_vines.identification.verdict import (
    NONE,
    UNEXPLAINED,
    Named,
    ParameterEstimate,
    Verdict,
    extended_rig,
)
from flying_vines.physics.plant.true_rig import TrueRig, true_rig_from, true_rig_text
from flying_vines.physics.rig import ControlVolume, Reservoir, Rig

BELIEVED = Rig(Reservoir(2.0), ControlVolume(0.5), tolerance_percent={"cv.volume_L": 2.5})


def verdict(cause: str, **said: Any) -> Verdict:
    """A verdict with only these values."""
    nothing = {field.name: () for field in fields(Verdict)}
    return Verdict(**{**nothing, "cause": cause, "parameters": {}, "numbers": {}, **said})


def written(said: Verdict) -> TrueRig:
    rig = extended_rig(BELIEVED, said)
    assert true_rig_from(tomllib.loads(true_rig_text(rig))) == rig
    return rig


def test_causes_and_fitted_numbers_are_in_the_file() -> None:
    rig = written(
        verdict(
            "cv_leak",
            parameters={"flow_resistance_kPa_s_per_SL": ParameterEstimate(304.0, 296.0, 312.0)},
            also=(Named("evp_lag", {"time_constant_s": ParameterEstimate(0.02, 0.018, 0.022)}),),
            numbers={"cv.volume_L": 0.507, "reservoir.volume_L": 1.99},
        )
    )
    assert rig.causes == {
        "cv_leak": {"flow_resistance_kPa_s_per_SL": 304.0},
        "evp_lag": {"time_constant_s": 0.02},
    }
    assert rig.nominal.cv == ControlVolume(0.507) and rig.nominal.reservoir == Reservoir(1.99)
    assert rig.nominal.tolerance_percent == BELIEVED.tolerance_percent
    assert rig.complete and not rig.none_found


def test_that_nothing_else_is_there_is_in_the_file_too() -> None:
    rig = written(verdict(NONE, numbers={"cv.volume_L": 0.495}))
    assert rig.complete and not rig.causes
    assert rig.nominal.cv == ControlVolume(0.495)


def test_an_unexplained_case_keeps_its_nominal_rig() -> None:
    rig = written(verdict(UNEXPLAINED))
    assert rig.nominal == BELIEVED
    assert not rig.complete
