"""An air pump that is on or off, and a valve, on a board that speaks lines of text.

To the board: `I` inflate, `H` hold, `D` deflate, `V` vent; without a line for 200 ms it vents.
From the board, 50 times a second: the pressure in kPa, and `V` if it vents or else `A`, such as `12.31 A`.
"""

import re
from collections.abc import Iterator

from firmware_link.actuator import Reading

REPORT = re.compile(rb"\n(-?[0-9]{1,3}\.[0-9]{2}) ([AV])(?=\n)")


class AirPump:
    name = "air pump"
    max_rate_kPa_per_s = 40.0
    dead_man_ms = 200
    reports_Hz = 50
    vent = b"\nV\n"  # the line break ends an incomplete line

    def __init__(self, max_kPa: float = 25.0, band_kPa: float = 0.4) -> None:
        self.max_kPa, self._band_kPa = max_kPa, band_kPa
        self._pressure_kPa, self._rest = 0.0, b"\n"

    def setpoint(self, kPa: float) -> bytes:
        error_kPa = kPa - self._pressure_kPa
        return b"I\n" if error_kPa > self._band_kPa else b"D\n" if error_kPa < -self._band_kPa else b"H\n"

    def readings(self, data: bytes) -> Iterator[Reading]:
        text = self._rest + data
        self._rest = text[max(0, text.rfind(b"\n")) :][-32:]
        for pressure, state in REPORT.findall(text):
            self._pressure_kPa = float(pressure)
            yield Reading(self._pressure_kPa, vented=state == b"V")
