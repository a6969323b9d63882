"""Runs the C++ core of the real firmware on this computer: all of it (`Firmware`), or its `Regulator` alone.

Only the board is simulated: pressures become converter counts, and duty cycles become valve openings (EVP:
inflation valve, DVP: the Venturi's supply valve). The core's `regulator.h` describes the regulator and its
tuning.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple, Protocol

from firmware_link.protocol import Fault, Mode
from flying_vines.physics.baseline import Inputs
from flying_vines.simulation.phlosar.core_library import Openings, Outputs, load

CV_SENSOR_SPAN_kPa = 206.84
"""Span of the built-in sensor, independent of the firmware's settings: 30 psi."""
RESERVOIR_SENSOR_SPAN_kPa = 1500.0
"""Span of the built-in sensor: 15 bar."""
_BUILD = b"1.1 host"
_FULL_SCALE = 65535
_SUPPLY_COUNTS = 59578
"""5 V through a 0.6 divider into a 3.3 V converter."""
_OUTPUT_BYTES = 1024

SAFE = Inputs(0.0, 0.0, True)
"""Inflation valve shut, outlet open, Venturi off."""
Settings = Mapping[str, float]
Tuning = Mapping[str, float]


class SettingRow(NamedTuple):
    """A setting that survives power cycles. Messages can change it only within `min` … `max`."""

    number: int
    standard: float
    min: float
    max: float


@cache
def setting_rows() -> dict[str, SettingRow]:
    """The firmware's settings by name, in the firmware's order."""
    library = load()
    rows: dict[str, SettingRow] = {}
    while row := library.phlosar_setting_row(len(rows)):
        found = row.contents
        rows[found.name.decode()] = SettingRow(len(rows), found.standard, found.least, found.most)
    return rows


class Board(Protocol):
    """A board with firmware. Call `step` at 1 kHz; the other methods at any time."""

    @property
    def mode(self) -> Mode: ...

    @property
    def faults(self) -> Fault: ...

    @property
    def number(self) -> int: ...

    def receive(self, data: bytes) -> None: ...

    def take_output(self) -> bytes: ...

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs: ...

    def reset(self, *, watchdog: bool = False) -> None: ...


class Firmware:
    """One board from power-up on. Call `step` at 1 kHz; `now_us` must not decrease.

    `step` takes the readings of the built-in sensors, which are out of range if a wire is broken. The board's
    memory has the standard settings with the changes of `settings`, or it has the bytes `stored`. `directly`
    bypasses converter and drivers: the firmware reads pressures, and `step` returns the openings as in
    telemetry. Settings that the host changed survive a reset. Bytes before the first step are lost, as on a
    booting board. Raises `ValueError` for unknown or invalid settings.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        boot_id: int = 1,
        *,
        directly: bool = False,
        stored: bytes | None = None,
    ) -> None:
        self.boot_id = boot_id & 0xFFFFFFFF
        self.supply_share = 1.0
        """The sensors' supply as a share of 5 V; the board measures it."""
        self._library = load()
        self._directly = directly
        self._outputs = Outputs()
        self._openings = Openings()
        self._image = ctypes.create_string_buffer(self._library.phlosar_image_size())
        self._buffer = ctypes.create_string_buffer(_OUTPUT_BYTES)
        self._memory = ctypes.create_string_buffer(self._library.phlosar_size())
        self._firmware = ctypes.addressof(self._memory)
        start = dict(settings or {})
        self._stored = self._image_of(start) if stored is None else stored
        # The duty cycles at which the simulated valves are fully open; later settings do not change these.
        self._full_evp, self._full_dvp = (
            math.floor(start.get(name, setting_rows()[name].standard) * _FULL_SCALE + 0.5)
            for name in ("evp_full_duty", "dvp_full_duty")
        )
        self._power_up(False)

    @property
    def settings(self) -> dict[str, float]:
        """The present settings; a host may have changed them."""
        setting = self._library.phlosar_setting
        return {name: setting(self._firmware, row.number) for name, row in setting_rows().items()}

    @property
    def mode(self) -> Mode:
        return Mode(self._library.phlosar_mode(self._firmware))

    @property
    def faults(self) -> Fault:
        """The latched faults."""
        return Fault(self._library.phlosar_faults(self._firmware))

    @property
    def number(self) -> int:
        """Number of the last accepted setpoint or vent; 0 before the first."""
        return int(self._library.phlosar_number(self._firmware))

    def reset(self, *, watchdog: bool = False) -> None:
        """A power cycle or watchdog reset: only stored settings survive."""
        self.boot_id = (self.boot_id + 1) & 0xFFFFFFFF
        self.store()
        self._power_up(watchdog)

    def store(self) -> bool:
        """Store the settings that a host has changed. A real board does it while it vents."""
        unsaved: bool = self._library.phlosar_unsaved(self._firmware, self._image)
        if unsaved:
            self._stored = self._image.raw
        return unsaved

    def receive(self, data: bytes) -> None:
        """Bytes from the host. They are handled at once, with the time of the last step."""
        self._library.phlosar_receive(self._firmware, data, len(data))

    def take_output(self) -> bytes:
        """The bytes to send to the host; each is returned once."""
        count = self._library.phlosar_take_output(self._firmware, self._buffer, _OUTPUT_BYTES)
        return ctypes.string_at(self._buffer, count)

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        """The valve commands for these sensor readings."""
        now_us &= 0xFFFFFFFF
        if self._directly:
            found = self._openings
            self._library.phlosar_control(self._firmware, now_us, cv_kPa, reservoir_kPa, True, found)
            return Inputs(found.evp, found.dvp, found.solenoid)
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
        # A setting that a host has raised since the start cannot open a valve further than fully.
        evp, dvp = outputs.evp_duty / self._full_evp, outputs.dvp_duty / self._full_dvp
        return Inputs(min(1.0, evp), min(1.0, dvp), outputs.solenoid)

    def _power_up(self, watchdog: bool) -> None:
        start = self._library.phlosar_start
        start(self._firmware, _BUILD, self.boot_id, watchdog, self._stored, len(self._stored))

    def _image_of(self, settings: Settings) -> bytes:
        """The bytes that store these settings."""
        library, rows = self._library, setting_rows()
        library.phlosar_start(self._firmware, _BUILD, 0, False, b"", 0)
        for name, value in settings.items():
            if name not in rows:
                raise ValueError(f"the firmware has no setting {name}")
            if not library.phlosar_set(self._firmware, rows[name].number, value):
                raise ValueError(f"the firmware does not accept {name} {value}")
        library.phlosar_image(self._firmware, self._image)
        return self._image.raw


def _counts(kPa: float, span_kPa: float, supply: float) -> int:
    """Converter counts of a ratiometric sensor: 10 … 90 % of its supply over the span."""
    if not math.isfinite(kPa):
        return 0 if not kPa > 0.0 else _FULL_SCALE
    counts = round((0.1 + 0.8 * kPa / span_kPa) * supply)
    return min(_FULL_SCALE, max(0, counts))


@cache
def _standard() -> dict[str, float]:
    library = load()
    values = (ctypes.c_double * library.phlosar_tuning_count())()
    library.phlosar_standard_tuning(values)
    names = [library.phlosar_tuning_name(index).decode() for index in range(len(values))]
    return dict(zip(names, values, strict=True))


def standard_tuning() -> dict[str, float]:
    """The standard tuning. It suits vines of 0.05 to 1 L and supplies of 100 to 690 kPa."""
    return dict(_standard())


class Regulator:
    """One regulator, in double precision. Call `step` every millisecond with the present pressures.

    `tuning` has the values that differ from the standard; raises `ValueError` for an unknown name. `address`
    is for loops compiled by numba: see `closed_loop`.
    """

    def __init__(self, tuning: Tuning | None = None, *, cv_kPa: float = 0.0) -> None:
        self.tuning = standard_tuning() | dict(tuning or {})
        if unknown := self.tuning.keys() - _standard().keys():
            raise ValueError(f"the regulator has no tuning value {', '.join(sorted(unknown))}")
        self._library = load()
        self._memory = ctypes.create_string_buffer(self._library.phlosar_regulator_size())
        self.address = ctypes.addressof(self._memory)
        self._outputs = (ctypes.c_double * 4)()
        values = (ctypes.c_double * len(self.tuning))(*self.tuning.values())
        self._library.phlosar_regulator_start(self.address, values)
        self.begin(cv_kPa)

    @property
    def setpoint_kPa(self) -> float:
        """The setpoint of the last step, on its way to the target."""
        return self._outputs[3]

    def begin(self, cv_kPa: float) -> None:
        """Start at the measured pressure, so that the setpoint does not jump."""
        self._library.phlosar_regulator_begin(self.address, cv_kPa)

    def step(self, target_kPa: float, rate_kPa_per_s: float, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        """Valve commands for the next millisecond; the setpoint moves to the target at this rate."""
        outputs = self._outputs
        self._library.phlosar_regulator_step(
            self.address, target_kPa, rate_kPa_per_s, cv_kPa, reservoir_kPa, outputs
        )
        return Inputs(outputs[0], outputs[1], outputs[2] > 0.0)
