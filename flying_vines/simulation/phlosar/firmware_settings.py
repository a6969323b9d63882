"""What is set in a phloSAR's firmware: the same rows, in the same order, as its `core/settings.cpp`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

from flying_vines.simulation.phlosar.regulator import RegulatorSettings

CV_SENSOR_SPAN_kPa = 206.84
"""Of the sensor that is soldered in, whatever the firmware is told: 30 psi."""
RESERVOIR_SENSOR_SPAN_kPa = 1500.0
"""15 bar."""
SENSOR_BEYOND_SPAN = 0.10625
"""A sensor ends at 2.5 and 97.5 % of its supply; what is below 1.5 or above 98.5 % is its wiring."""


@dataclass(frozen=True)
class FirmwareSettings:
    """What a firmware starts with. Pressures are kPa gauge."""

    build: str = ""
    """What it calls itself; else what it is."""
    cv_limit_kPa: float = 30.0
    """Above it the CV is vented and the fault latches."""
    setpoint_margin_kPa: float = 2.0
    """How far below the limit setpoints must stay, so that an overshoot is not a fault."""
    reservoir_limit_kPa: float = 760.0
    rate_limit_kPa_per_s: float = 200.0
    dead_man_ms: int = 300
    telemetry_Hz: int = 100
    cv_span_kPa: float = CV_SENSOR_SPAN_kPa
    cv_zero_kPa: float = 0.0
    """Added to what the sensor says."""
    reservoir_span_kPa: float = RESERVOIR_SENSOR_SPAN_kPa
    reservoir_zero_kPa: float = 0.0
    evp_dead_band: float = 0.0
    """Fraction of the full current below which nothing flows, as far as it is known; openings are lifted
    over it."""
    evp_full_duty: float = 0.48
    """Duty cycle of the full current: a 5 V coil on 12 V less 1.5 V of the driver."""
    dvp_dead_band: float = 0.0
    dvp_full_duty: float = 0.95
    """A 10 V coil, likewise."""
    sensor_beyond_span: float = SENSOR_BEYOND_SPAN
    """How far beyond its span a reading is believed, as a share of it."""
    regulator: RegulatorSettings = field(default_factory=RegulatorSettings)

    @property
    def setpoint_most_kPa(self) -> float:
        return self.cv_limit_kPa - self.setpoint_margin_kPa


class SettingRow(NamedTuple):
    """A setting that is kept over power cycles. No message gets it beyond `least` … `most`."""

    name: str
    least: float
    most: float


SETTING_ROWS = (
    SettingRow("cv_limit_kPa", 5.0, 60.0),
    SettingRow("setpoint_margin_kPa", 0.5, 4.0),
    SettingRow("reservoir_limit_kPa", 50.0, 830.0),
    SettingRow("rate_limit_kPa_per_s", 1.0, 500.0),
    SettingRow("dead_man_ms", 50.0, 300.0),
    SettingRow("telemetry_Hz", 10.0, 1000.0),
    SettingRow("cv_span_kPa", 100.0, 420.0),
    SettingRow("cv_zero_kPa", -10.0, 10.0),
    SettingRow("reservoir_span_kPa", 700.0, 2000.0),
    SettingRow("reservoir_zero_kPa", -50.0, 50.0),
    SettingRow("evp_dead_band", 0.0, 0.6),
    SettingRow("evp_full_duty", 0.05, 1.0),
    SettingRow("dvp_dead_band", 0.0, 0.6),
    SettingRow("dvp_full_duty", 0.05, 1.0),
    SettingRow("on_off_error_kPa", 0.2, 10.0),
    SettingRow("filling_lead_s", 0.0, 0.2),
    SettingRow("proportional_per_kPa", 0.0, 1.0),
    SettingRow("integral_per_kPa_s", 0.0, 20.0),
    SettingRow("venting_lead_s", 0.0, 0.2),
)


def value_of(settings: FirmwareSettings, name: str) -> float:
    """Of the setting with the row's name; the regulator's are rows as well."""
    owner = settings.regulator if name in RegulatorSettings._fields else settings
    return float(getattr(owner, name))


def with_value(settings: FirmwareSettings, row: SettingRow, value: float) -> FirmwareSettings | None:
    """The settings with another value in one row; None when it is beyond the row's range."""
    if not row.least <= value <= row.most:
        return None
    if row.name in RegulatorSettings._fields:
        return replace(settings, regulator=settings.regulator._replace(**{row.name: value}))
    whole = row.name in ("dead_man_ms", "telemetry_Hz")
    changes: dict[str, float] = {row.name: int(value) if whole else value}
    return replace(settings, **changes)  # type: ignore[arg-type]


def within_sensor(kPa: float, span_kPa: float, zero_kPa: float, beyond_span: float) -> bool:
    """Whether a sensor can say so. False for NaN."""
    beyond_kPa = span_kPa * beyond_span
    return zero_kPa - beyond_kPa <= kPa <= zero_kPa + span_kPa + beyond_kPa
