"""The firmware that a lab flashes: its C++ core, run on this machine.

Only the board is not there: pressures become the counts of its converter, duty cycles the openings of its
valves.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

from firmware_link.protocol import Fault, Mode
from flying_vines.simulation.phlosar.core_library import Openings, Outputs, load
from flying_vines.simulation.phlosar.regulator import Drive

CV_SENSOR_SPAN_kPa = 206.84
"""Of the sensor that is soldered in, whatever the firmware is told: 30 psi."""
RESERVOIR_SENSOR_SPAN_kPa = 1500.0
"""15 bar."""
_BUILD = "1.0 host"
_FULL_SCALE = 65535
_SUPPLY_COUNTS = 59578
"""5 V through the divider of 0.6 into the converter of 3.3 V."""
_OUTPUT_BYTES = 1024

Settings = Mapping[str, float]


class SettingRow(NamedTuple):
    """A setting that is kept over power cycles. No message gets it beyond `least` … `most`."""

    number: int
    standard: float
    least: float
    most: float


@cache
def setting_rows() -> dict[str, SettingRow]:
    """The settings of the firmware by their names, in their order."""
    library = load()
    rows: dict[str, SettingRow] = {}
    while row := library.phlosar_setting_row(len(rows)):
        told = row.contents
        rows[told.name.decode()] = SettingRow(len(rows), told.standard, told.least, told.most)
    return rows


class Firmware:
    """One board, from power-up on. Call `step` a thousand times a second; `now_us` never goes back.

    `step` takes what the sensors that are soldered in say: out of their range where a wire is broken.
    `settings` has what differs from the standard. `directly` goes past converter and drivers: the firmware
    reads the pressures themselves, and `step` returns the openings of its telemetry.
    Settings that the host changed outlive a reset. Bytes that arrive before the first step are lost, as on a
    board that is still booting. ValueError for settings that the firmware does not have, or does not take.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        boot_id: int = 1,
        *,
        build: str = _BUILD,
        directly: bool = False,
        stored: bytes = b"",
    ) -> None:
        self.boot_id = boot_id & 0xFFFFFFFF
        self.supply_share = 1.0
        """Of the sensors' 5 V; what the board measures of it."""
        self._start = dict(settings or {})
        self._library = load()
        self._directly = directly
        self._stored = stored
        self._build = build.encode("ascii")
        self._outputs = Outputs()
        self._openings = Openings()
        self._image = ctypes.create_string_buffer(self._library.phlosar_image_size())
        self._buffer = ctypes.create_string_buffer(_OUTPUT_BYTES)
        self._memory = ctypes.create_string_buffer(self._library.phlosar_size())
        self._firmware = ctypes.addressof(self._memory)
        self._power_up(False)

    @property
    def settings(self) -> dict[str, float]:
        """As they are now: a host may have changed them."""
        setting = self._library.phlosar_setting
        return {name: setting(self._firmware, row.number) for name, row in setting_rows().items()}

    @property
    def mode(self) -> Mode:
        return Mode(self._library.phlosar_mode(self._firmware))

    @property
    def faults(self) -> Fault:
        """The latched ones."""
        return Fault(self._library.phlosar_faults(self._firmware))

    @property
    def number(self) -> int:
        """Of the last setpoint or vent accepted; 0 before the first."""
        return int(self._library.phlosar_number(self._firmware))

    def reset(self, *, watchdog: bool = False) -> None:
        """A power cycle, or a watchdog's reset: everything but the kept settings is forgotten."""
        self.boot_id = (self.boot_id + 1) & 0xFFFFFFFF
        if self._library.phlosar_unsaved(self._firmware, self._image):
            self._stored = self._image.raw
        self._power_up(watchdog)

    def receive(self, data: bytes) -> None:
        """Bytes from the host. Acted upon at once, as of the last step's time."""
        self._library.phlosar_receive(self._firmware, data, len(data))

    def take_output(self) -> bytes:
        """What is to be sent to the host, once."""
        count = self._library.phlosar_take_output(self._firmware, self._buffer, _OUTPUT_BYTES)
        return ctypes.string_at(self._buffer, count)

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Drive:
        """What the valves are told from now on, given what the sensors say."""
        now_us &= 0xFFFFFFFF
        if self._directly:
            told = self._openings
            self._library.phlosar_control(self._firmware, now_us, cv_kPa, reservoir_kPa, True, told)
            return Drive(told.evp, told.dvp, told.solenoid)
        supply = self.supply_share * _SUPPLY_COUNTS
        outputs = self._outputs
        self._library.phlosar_step(
            self._firmware,
            now_us,
            _counts(cv_kPa, CV_SENSOR_SPAN_kPa, supply),
            _counts(reservoir_kPa, RESERVOIR_SENSOR_SPAN_kPa, supply),
            min(_FULL_SCALE, round(supply)),
            outputs,
        )
        return Drive(outputs.evp_duty / self._full_evp, outputs.dvp_duty / self._full_dvp, outputs.solenoid)

    def _power_up(self, watchdog: bool) -> None:
        library, rows = self._library, setting_rows()
        library.phlosar_start(
            self._firmware, self._build, self.boot_id, watchdog, self._stored, len(self._stored)
        )
        for name, value in self._start.items():
            if name not in rows:
                raise ValueError(f"the firmware has no setting {name}")
            if not self._stored and not library.phlosar_set(self._firmware, rows[name].number, value):
                raise ValueError(f"the firmware does not take {name} {value}")
        # What the valves are wired for: a duty that the host sets later changes their currents.
        self._full_evp, self._full_dvp = (
            math.floor(self._start.get(name, rows[name].standard) * _FULL_SCALE + 0.5)
            for name in ("evp_full_duty", "dvp_full_duty")
        )


def _counts(kPa: float, span_kPa: float, supply: float) -> int:
    """What the board's converter makes of a ratiometric sensor: 10 … 90 % of its supply over the span."""
    if not math.isfinite(kPa):
        return 0 if not kPa > 0.0 else _FULL_SCALE
    counts = round((0.1 + 0.8 * kPa / span_kPa) * supply)
    return min(_FULL_SCALE, max(0, counts))
