"""Rig files with causes and effects: read, converted to a plant, written again, and errors."""

from __future__ import annotations

import re
import tomllib
from dataclasses import fields, replace
from pathlib import Path

import pytest

from flying_vines.physics.effects import catalogue, cause_named, setup
from flying_vines.physics.plant.effects import Effects, likely_effects
from flying_vines.physics.plant.flow import Iso6358, Ohm
from flying_vines.physics.plant.true_rig import (
    TrueRig,
    likely_sensors,
    load_true_rig,
    true_rig_from,
    true_rig_text,
)
from flying_vines.physics.plant.valve_response import ValveMotion
from flying_vines.physics.plant.volume import Pouch
from flying_vines.physics.rig import ControlVolume, Pump, Reservoir, Rig, RigError, load_rig

EVERY_CAUSE = {
    "reservoir_leak": {"flow_resistance_kPa_s_per_SL": 40_000.0},
    "cv_leak": {"flow_resistance_kPa_s_per_SL": 300.0},
    "compressible_flow": {"critical_pressure_ratio": 0.3},
    "reservoir_cooling": {"time_constant_s": 10.0},
    "cv_heating": {"time_constant_s": 1.0},
    "cv_compliance": {"per_kPa": 0.01},
    "dead_volume": {"volume_L": 0.1},
    "reservoir_volume": {"scale": 0.9},
    "evp_restriction": {"scale": 1.2},
    "evp_dead_zone": {"opening": 0.2},
    "evp_hysteresis": {"width": 0.1},
    "evp_lag": {"time_constant_s": 0.05},
    "line_delay": {"delay_s": 0.02},
    "solenoid_slow_close": {"delay_s": 0.05},
    "venturi_stall": {"supply_pressure_kPa": 300.0},
    "cv_sensor_lag": {"time_constant_s": 0.05},
    "cv_sensor_offset": {"offset_kPa": 0.7},
    "cv_sensor_gain": {"gain": 1.02},
    "reservoir_sensor_offset": {"offset_kPa": -5.0},
    "reservoir_sensor_gain": {"gain": 0.98},
    "ambient_drop": {"rate_kPa_per_s": 0.02},
    "hose": {"flow_resistance_kPa_s_per_SL": 30.0, "volume_L": 0.05},
    "pump_flow": {"scale": 1.2},
    "pump_stall": {"scale": 0.8},
    "pump_curve": {"critical_pressure_ratio": 0.25},
    "choked_outlet": {"critical_pressure_ratio": 0.4},
    "evp_heating": {"share": 0.1, "time_constant_s": 30.0},
    "cv_sensor_drift": {"rate_kPa_per_min": 1.0},
    "reservoir_sensor_drift": {"rate_kPa_per_min": -5.0},
    "viscous_leak": {"conductance_constant_kPa2_s_per_SL": 1e5},
    "reservoir_viscous_leak": {"conductance_constant_kPa2_s_per_SL": 1e7},
    "orifice_leak": {"sonic_conductance_SL_per_s_kPa": 1e-5},
    "reservoir_orifice_leak": {"sonic_conductance_SL_per_s_kPa": 1e-5},
}
EVERYTHING = """
[reservoir]
volume_L = 4.0
[cv]
volume_L = 0.2
[tolerance_percent]
"reservoir.volume_L" = 3
[causes.cv_leak]
flow_resistance_kPa_s_per_SL = 300
[causes.cv_sensor_gain]
gain = 1.03
[effects]
likely = true
without = ["cv_shape", "evp_coil"]
[effects.ambient]
kind = "recorded"
time_s = [0, 10]
pressure_kPa = [101, 100.5]
temperature_K = [293, 292]
[effects.cv_wall]
[effects.dvp_motion]
delay_s = 0.002
[effects.reservoir_leak]
kind = "iso6358"
sonic_conductance_SL_per_s_kPa = 1e-6
one_way = true
"""


def rig_of(text: str) -> TrueRig:
    return true_rig_from(tomllib.loads(text))


def test_the_table_of_causes_is_the_whole_one() -> None:
    assert set(EVERY_CAUSE) == {cause.name for cause in catalogue()}


@pytest.mark.parametrize("cause", EVERY_CAUSE)
def test_a_cause_in_a_file_is_the_cause(cause: str, tmp_path: Path) -> None:
    believed = Rig(cv=ControlVolume(0.25), pump=Pump() if "pump" in cause_named(cause).needs else None)
    rig = TrueRig(believed, causes={cause: EVERY_CAUSE[cause]})
    assert rig.setup == setup(believed, cause, **EVERY_CAUSE[cause])
    path = tmp_path / "rig.toml"
    path.write_text(true_rig_text(rig))
    assert load_true_rig(path) == rig


def test_all_causes_at_once() -> None:
    causes = {name: own for name, own in EVERY_CAUSE.items() if "pump" not in cause_named(name).needs}
    rig = TrueRig(causes=causes)
    made = rig.setup
    assert made.plant.effects.evp_motion == ValveMotion(0.02, 0.1, 0.2, 0.05, 0.1, 30.0)
    assert made.plant.rig.evp.flow_resistance_kPa_s_per_SL == pytest.approx(1.2 * 2042.0)
    assert made.plant.rig.cv == ControlVolume(0.2)
    assert (made.cv_sensor.gain, made.cv_sensor.offset_kPa) == (1.02, 0.7)
    assert made.cv_sensor.time_constant_s == 0.05
    law = made.plant.effects.evp_law
    assert isinstance(law, Iso6358)
    alone = setup(Rig(), "compressible_flow", critical_pressure_ratio=0.3).plant.effects.evp_law
    assert isinstance(alone, Iso6358)
    ratio = alone.sonic_conductance_SL_per_s_kPa / law.sonic_conductance_SL_per_s_kPa
    assert ratio == pytest.approx(1.2)
    assert rig_of(true_rig_text(rig)) == rig


def test_causes_change_what_is_likely() -> None:
    likely = likely_effects()
    made = TrueRig(
        likely=True,
        causes={name: EVERY_CAUSE[name] for name in ("evp_dead_zone", "cv_compliance", "evp_restriction")},
    ).setup.plant.effects
    assert likely.evp_motion
    assert made.evp_motion == ValveMotion(
        likely.evp_motion.delay_s, likely.evp_motion.backlash_width, 0.2, likely.evp_motion.time_constant_s
    )
    # The shape stays a pouch.
    assert made.cv_shape == Pouch(0.01, per_kPa=0.01)
    assert isinstance(made.evp_law, Iso6358)
    assert isinstance(likely.evp_law, Iso6358)
    assert made.evp_law.sonic_conductance_SL_per_s_kPa == pytest.approx(
        likely.evp_law.sonic_conductance_SL_per_s_kPa / 1.2
    )
    untouched = {f.name for f in fields(Effects)} - {"evp_motion", "cv_shape", "evp_law"}
    assert all(getattr(made, name) == getattr(likely, name) for name in untouched)


@pytest.mark.parametrize(
    ("cause", "numbers", "effect", "changed"),
    [
        ("evp_lag", {"time_constant_s": 0.0}, "evp_motion", {"time_constant_s": 0.0}),
        ("evp_hysteresis", {"width": 0.0}, "evp_motion", {"backlash_width": 0.0}),
        ("cv_compliance", {"per_kPa": 0.0}, "cv_shape", {"per_kPa": 0.0}),
        ("solenoid_slow_close", {"delay_s": 0.0}, "solenoid_timing", {"closing_s": 0.0}),
    ],
)
def test_a_cause_without_effect_changes_what_is_likely(
    cause: str, numbers: dict[str, float], effect: str, changed: dict[str, float]
) -> None:
    made = TrueRig(likely=True, causes={cause: numbers}).setup.plant.effects
    assert getattr(made, effect) == replace(getattr(likely_effects(), effect), **changed)


@pytest.mark.parametrize(
    ("cause", "numbers", "effect"),
    [
        ("cv_heating", {"time_constant_s": 0.0}, "cv_wall"),
        ("reservoir_cooling", {"time_constant_s": 0.0}, "reservoir_wall"),
        ("orifice_leak", {"sonic_conductance_SL_per_s_kPa": 0.0}, "cv_orifice_leak"),
        ("reservoir_orifice_leak", {"sonic_conductance_SL_per_s_kPa": 0.0}, "reservoir_orifice_leak"),
    ],
)
def test_a_cause_without_effect_removes_the_effect(
    cause: str, numbers: dict[str, float], effect: str
) -> None:
    effects = Effects(cv_orifice_leak=Iso6358(1e-6), reservoir_orifice_leak=Iso6358(1e-6))
    made = TrueRig(likely=True, effects=effects, causes={cause: numbers}).setup.plant.effects
    assert getattr(made, effect) is None


def test_a_law_of_a_cause_replaces_the_whole_law() -> None:
    effects = Effects(evp_law=Iso6358(1e-3, 0.5, subsonic_index=0.6))
    number = {"critical_pressure_ratio": 0.3}
    made = TrueRig(effects=effects, causes={"compressible_flow": number}).setup.plant.effects
    assert made == setup(Rig(), "compressible_flow", **number).plant.effects


def test_everything_is_read_and_written_again() -> None:
    rig = rig_of(EVERYTHING)
    assert rig.nominal == Rig(
        Reservoir(4.0), ControlVolume(0.2), tolerance_percent={"reservoir.volume_L": 3.0}
    )
    effects = rig.setup.plant.effects
    assert effects.cv_shape is None
    assert effects.evp_coil is None
    assert effects.dvp_motion == ValveMotion(delay_s=0.002)
    assert effects.evp_law == likely_effects().evp_law
    assert isinstance(effects.reservoir_leak, Iso6358)
    assert effects.reservoir_leak.one_way
    assert effects.cv_leak == Ohm(300.0)
    assert rig.setup.cv_sensor.adc == likely_sensors(Rig().sensors)[0].adc
    assert rig.setup.cv_sensor.gain == 1.03
    assert rig_of(true_rig_text(rig)) == rig


def test_a_plain_file_is_the_nominal_rig(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[cv]\nvolume_L = 0.5\n")
    rig = load_true_rig(path)
    assert rig == TrueRig(load_rig(path))
    assert rig.setup == setup(load_rig(path))
    path.write_text(true_rig_text(rig))
    # Its file is a plain rig file again.
    assert load_rig(path) == rig.nominal
    assert rig_of("") == TrueRig(Rig(cv=None))
    assert rig_of(true_rig_text(TrueRig(Rig(cv=None)))) == TrueRig(Rig(cv=None))


def test_a_reader_of_the_nominal_rig_does_not_get_the_true_one(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(EVERYTHING)
    with pytest.raises(RigError, match="unknown table 'causes' of a rig"):
        load_rig(path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[cv]\n[causes.cv_leek]", "causes.cv_leek is not a cause: the causes are none, ambient_drop,"),
        ("[cv]\n[causes.cv_leak]", "causes.cv_leak.flow_resistance_kPa_s_per_SL is missing."),
        ("[cv]\n[causes.cv_leak]\nR = 3", "causes.cv_leak.R is not a parameter: the parameters are flow_"),
        ("[cv]\n[causes.none]\nR = 3", "causes.none.R is not a parameter: there are none."),
        (
            "[cv]\n[causes.cv_leak]\nflow_resistance_kPa_s_per_SL = -1",
            "causes.cv_leak.flow_resistance_kPa_s_per_SL must be a number from 0.001 to 1e+12, not -1.",
        ),
        (
            "[cv]\n[causes.cv_leak]\nflow_resistance_kPa_s_per_SL = 'much'",
            "causes.cv_leak.flow_resistance_kPa_s_per_SL must be a number, not 'much'.",
        ),
        ("[causes.cv_heating]\ntime_constant_s = 1", "causes.cv_heating needs a control volume, and the rig"),
        ("[cv]\n[causes.evp_restriction]\nscale = 0", "causes.evp_restriction.scale is 0, and must be above"),
        (
            "[cv]\n[causes.dead_volume]\nvolume_L = -5",
            "causes.dead_volume.volume_L must be a number from 1e-09 to 20000, not -5.",
        ),
        ("[cv]\n[causes.evp_dead_zone]\nopening = 2", "causes.evp_dead_zone: a dead zone must be in 0…1."),
        ("[causes]\ncv_leak = 3", "causes.cv_leak must be a table."),
        ("effects = 1", "effects must be a table."),
        ("[effects]\nlikly = true", "effects.likly is not an effect: the effects are evp_law,"),
        ("[effects]\nlikely = 1", "effects.likely must be true or false."),
        ("[effects]\nlikely = true\nwithout = ['coil']", "effects.without must be a list of effects: evp"),
        ("[effects]\nlikely = true\nwithout = [[]]", "effects.without must be a list of effects: evp_law,"),
        ("[effects]\nwithout = ['tubing']", "effects.without removes likely effects"),
        ("[effects]\ntubing = 1", "effects.tubing must be a table."),
        ("[effects.tubing]\nlength_m = 1", "effects.tubing.length_m is not a parameter: the parameters are"),
        (
            "[effects.tubing]\nvolume_L = -1",
            "effects.tubing.volume_L must be a number from 1e-09 to 50, not -1.",
        ),
        ("[effects.evp_law]\nC = 1", "effects.evp_law.kind must be one of ohm, iso6358."),
        ("[effects.evp_law]\nkind = []", "effects.evp_law.kind must be one of ohm, iso6358."),
        ("[effects.evp_law]\nkind = 'ohm'", "effects.evp_law.flow_resistance_kPa_s_per_SL is missing."),
        (
            "[effects.evp_law]\nkind = 'ohm'\nflow_resistance_kPa_s_per_SL = 'x'",
            "effects.evp_law.flow_resistance_kPa_s_per_SL must be a number, not 'x'.",
        ),
        (
            "[effects.cv_wall]\ntime_constant_s = nan",
            "effects.cv_wall.time_constant_s is nan, which is not",
        ),
        (
            "[effects.ejector]\nnozzle_conductance_SL_per_s_kPa = 1.0",
            "effects: a nozzle in series needs a supply valve that follows ISO 6358.",
        ),
        (
            "[cv]\nvolume_L = 0.005\n[effects]\nlikely = true",
            "effects: a pouch's flat volume must be",
        ),
        ("[reservoir]\nvolume_L = 0", "reservoir.volume_L must be a number from 0.001 to 1000, not 0."),
        ("[tank]", "unknown table 'tank' of a rig"),
    ],
)
def test_an_error_gives_one_line(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(RigError) as caught:
        load_true_rig(path)
    assert re.sub(r"toml:\d+:", "toml:", str(caught.value)).startswith(f"{path}: {says}")
    assert "\n" not in str(caught.value)
