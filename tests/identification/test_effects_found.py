"""A diagnosis finds each further effect in noisy readings that the plant has made with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from flying_vines.identification.case import Case, RecordedRun
from flying_vines.identification.diagnose import diagnose
from flying_vines.physics.effects import cause_named, setup
from flying_vines.physics.plant.compiled import replay
from flying_vines.physics.plant.plant import at_rest
from flying_vines.physics.rig import ControlVolume, Pump, Rig, Solenoid

EVERY_MS = 20
Valves = tuple[float, float, float, float]
"""Seconds, and the openings of inflation valve, Venturi's valve and solenoid."""


class Found(NamedTuple):
    """An effect, other possible causes, and a recording that shows it."""

    cause: str
    values: Mapping[str, float]
    suspects: Sequence[str]
    valves: Sequence[Valves]
    rig: Rig = Rig(cv=ControlVolume(0.5))
    start_kPa: tuple[float, float] = (650.0, 0.0)
    within: float = 0.1
    """Error of the first parameter, as a share of it."""


def recorded(found: Found) -> Case:
    made = setup(found.rig, found.cause, **found.values)
    openings = np.concatenate([np.tile(v[1:], (round(1000 * v[0]), 1)) for v in found.valves])
    table = replay(
        made.plant,
        openings,
        at_rest(made.plant, *found.start_kPa),
        cv_sensor=made.cv_sensor,
        reservoir_sensor=made.reservoir_sensor,
        seed=1,
        record_every=EVERY_MS,
    ).table
    evp, dvp, solenoid = openings[::EVERY_MS].T.copy()
    time_s, cv_kPa, reservoir_kPa = (
        table[name].copy() for name in ("time_s", "cv_reading_kPa", "reservoir_reading_kPa")
    )
    run = RecordedRun("run", time_s, None, evp, dvp, solenoid, cv_kPa, reservoir_kPa, None, None, False)
    return Case(Path("memory"), found.rig, (run,), ())


FILL_AND_HOLD = [(2.0, 1.0, 0.0, 0.0), (15.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (10.0, 0.0, 0.0, 0.0)]
LEAKS = ("cv_leak", "viscous_leak", "orifice_leak")
RESERVOIR_LEAKS = ("reservoir_leak", "reservoir_viscous_leak", "reservoir_orifice_leak")
DRIFTS = ("cv_sensor_drift", "reservoir_sensor_drift", "ambient_drop", "cv_sensor_offset", "cv_leak")
PUMPS = ("pump_flow", "pump_stall", "cv_leak", "dead_volume")
CHOKED = (*PUMPS, "pump_curve", "choked_outlet")
PUMPED = [(2.0, 1.0, 0.0, 0.0), (2.0, 0.0, 0.0, 1.0), (8.0, 0.7, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)]
PUMP_RIG = Rig(cv=ControlVolume(0.3), pump=Pump(0.05, 40.0))
SUPPLIED = [(0.6, 1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 1.0), (1.5, 0.5, 0.0, 0.0)] * 3
SUPPLIED_RIG = Rig(cv=ControlVolume(0.3), pump=Pump(0.8, 300.0), solenoid=Solenoid(300.0))
HELD = [(60.0, 0.0, 0.0, 0.0)]
FOUND = (
    Found("viscous_leak", {"conductance_constant_kPa2_s_per_SL": 4e5}, LEAKS, FILL_AND_HOLD),
    Found("orifice_leak", {"sonic_conductance_SL_per_s_kPa": 1e-4}, LEAKS, FILL_AND_HOLD),
    Found("reservoir_viscous_leak", {"conductance_constant_kPa2_s_per_SL": 4e6}, RESERVOIR_LEAKS, HELD),
    Found("reservoir_orifice_leak", {"sonic_conductance_SL_per_s_kPa": 2e-4}, RESERVOIR_LEAKS, HELD),
    Found("cv_sensor_drift", {"rate_kPa_per_min": 2.0}, DRIFTS, FILL_AND_HOLD),
    Found("reservoir_sensor_drift", {"rate_kPa_per_min": -15.0}, DRIFTS, FILL_AND_HOLD),
    Found(
        "evp_heating",
        {"share": 0.25, "time_constant_s": 10.0},
        ("evp_heating", "evp_restriction", "reservoir_cooling", "compressible_flow"),
        [(1.0, 0.3, 0.0, 0.0), (8.0, 1.0, 0.0, 1.0), (20.0, 0.0, 0.0, 1.0), (8.0, 0.5, 0.0, 1.0)],
    ),
    Found("pump_flow", {"scale": 0.8}, PUMPS, PUMPED, PUMP_RIG),
    Found("pump_stall", {"scale": 1.2}, PUMPS, PUMPED, PUMP_RIG),
    Found("pump_curve", {"critical_pressure_ratio": 0.4}, CHOKED, SUPPLIED, SUPPLIED_RIG),
    Found("choked_outlet", {"critical_pressure_ratio": 0.4}, CHOKED, SUPPLIED, SUPPLIED_RIG),
    Found(
        "hose",
        {"flow_resistance_kPa_s_per_SL": 60.0, "volume_L": 0.05},
        ("hose", "dead_volume", "cv_sensor_lag"),
        [(0.4, 1.0, 0.0, 0.0), (0.4, 0.0, 0.0, 0.0), (0.3, 0.0, 0.0, 1.0), (0.4, 0.0, 0.0, 0.0)] * 4,
    ),
)


@pytest.mark.long
@pytest.mark.parametrize("found", FOUND, ids=lambda found: found.cause)
def test_an_effect_is_found(found: Found) -> None:
    verdict = diagnose(recorded(found), [cause_named(name) for name in found.suspects])
    assert (verdict.cause, verdict.also) == (found.cause, ())
    (name, value), *_ = found.values.items()
    assert verdict.parameters[name].estimate == pytest.approx(value, rel=found.within)
