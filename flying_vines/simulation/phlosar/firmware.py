"""The emulated firmware: a model of what the microcontroller runs, for machines without a C++ compiler.

The rules are those of `docs/serial-protocol.md`; the original is `firmware_link/firmware/phlosar/src/core`,
and tests hold the two together, step for step. No clock, no port: bytes, pressures and the time come in,
bytes and valve openings go out.
"""

from __future__ import annotations

import math

from firmware_link.protocol import (
    PROTOCOL_VERSION,
    ClearFaults,
    Codec,
    DeviceMessage,
    Fault,
    GetSetting,
    Hello,
    Message,
    Mode,
    Ping,
    Pong,
    Refusal,
    RefusalReason,
    Setpoint,
    SetSetting,
    Setting,
    Telemetry,
    Units,
    Vent,
    Welcome,
)
from flying_vines.simulation.phlosar.firmware_settings import (
    SETTING_ROWS,
    CV_SENSOR_SPAN_kPa,
    FirmwareSettings,
    RESERVOIR_SENSOR_SPAN_kPa,
    value_of,
    with_value,
    within_sensor,
)
from flying_vines.simulation.phlosar.regulator import (
    SAFE,
    Drive,
    RegulatorMemory,
    RegulatorSettings,
    begin,
    regulate,
)

__all__ = ["SAFE", "Drive", "Firmware", "FirmwareSettings", "RegulatorSettings"]

STEP_S = 0.001
"""From one control step to the next, by design: the regulator does not follow a jittering clock."""
_MAX_OUTPUT_BYTES = 1024
"""As the microcontroller's: what nobody fetches is lost, frame by frame, and the frames' numbers tell."""
_BUILD = "emulated"
_MOST_RELIEF = 1000
"""Steps. A sensor that lies would else empty the bottle, and suck the vine flat."""
_IN_A_ROW = 3
"""Readings. A glitch does not end a flight, and 3 ms are soon enough."""


class _Lasting:
    """A condition that counts once it was there so many readings in a row."""

    def __init__(self) -> None:
        self._count = 0

    def see(self, now: bool) -> None:
        self._count = min(_IN_A_ROW, self._count + 1) if now else 0

    @property
    def there(self) -> bool:
        return self._count == _IN_A_ROW


class Firmware:
    """One board, from power-up on. Call `step` a thousand times a second; `now_us` never goes back.

    `step` takes what the sensors that are soldered in say: out of their range where a wire is broken.
    Settings that the host changed outlive a reset. Bytes that arrive before the first step are lost, as on a
    board that is still booting.
    """

    def __init__(self, settings: FirmwareSettings | None = None, boot_id: int = 1) -> None:
        self.settings = settings or FirmwareSettings()
        self.boot_id = boot_id & 0xFFFFFFFF
        self._now_us: int | None = None
        self._power_up(Fault.NONE)

    @property
    def mode(self) -> Mode:
        if self._faults:
            return Mode.FAULT
        return Mode.VENT if self._regulation is None else Mode.REGULATE

    @property
    def faults(self) -> Fault:
        """The latched ones."""
        return self._faults

    @property
    def number(self) -> int:
        """Of the last setpoint or vent accepted; 0 before the first."""
        return self._number

    def reset(self, *, watchdog: bool = False) -> None:
        """A power cycle, or a watchdog's reset, which latches its fault: everything is forgotten."""
        self.boot_id = (self.boot_id + 1) & 0xFFFFFFFF
        self._power_up(Fault.WATCHDOG_RESET if watchdog else Fault.NONE)

    def receive(self, data: bytes) -> None:
        """Bytes from the host. Acted upon at once, as of the last step's time."""
        if self._now_us is None:
            return
        for message in self._codec.decode(data):
            self._handle(message)

    def take_output(self) -> bytes:
        """What is to be sent to the host, once."""
        output = bytes(self._output)
        self._output.clear()
        return output

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Drive:
        """What the valves are told from now on, given what the sensors read."""
        if self._now_us is None:
            self._boot_us = self._telemetry_us = now_us
        self._now_us = now_us
        settings = self.settings
        self._look(
            cv_kPa * (settings.cv_span_kPa / CV_SENSOR_SPAN_kPa) + settings.cv_zero_kPa,
            reservoir_kPa * (settings.reservoir_span_kPa / RESERVOIR_SENSOR_SPAN_kPa)
            + settings.reservoir_zero_kPa,
        )
        if self._regulation is not None and now_us >= self._deadline_us:
            self._latch(Fault.DEAD_MAN)
        drive = self._regulate()
        if now_us >= self._telemetry_us:
            self._send_telemetry(now_us, drive)
        return drive

    def _power_up(self, faults: Fault) -> None:
        self._faults = faults
        self._present = Fault.NONE
        self._regulation: RegulatorMemory | None = None
        self._aim = (0.0, 0.0)
        self._deadline_us = 0
        self._greeted = False
        self._number = 0
        self._newest: int | None = None
        self._relief_steps = 0
        self._cv_kPa = 0.0
        self._reservoir_kPa = 0.0
        self._lasting = {
            fault: _Lasting()
            for fault in (
                Fault.CV_SENSOR,
                Fault.RESERVOIR_SENSOR,
                Fault.CV_OVERPRESSURE,
                Fault.RESERVOIR_OVERPRESSURE,
            )
        }
        self._codec = Codec()
        self._output = bytearray()
        self._now_us = None
        self._boot_us = 0
        self._telemetry_us = 0

    def _look(self, cv_kPa: float, reservoir_kPa: float) -> None:
        """Keep readings that can be believed, latch what is wrong with them."""
        settings = self.settings
        beyond = settings.sensor_beyond_span
        cv_good = within_sensor(cv_kPa, settings.cv_span_kPa, settings.cv_zero_kPa, beyond)
        reservoir_good = within_sensor(
            reservoir_kPa, settings.reservoir_span_kPa, settings.reservoir_zero_kPa, beyond
        )
        if cv_good:
            self._cv_kPa = cv_kPa
        if reservoir_good:
            self._reservoir_kPa = reservoir_kPa
        self._lasting[Fault.CV_SENSOR].see(not cv_good)
        self._lasting[Fault.RESERVOIR_SENSOR].see(not reservoir_good)
        # A reading that cannot be believed says nothing of a limit, not that it is kept.
        if cv_good:
            self._lasting[Fault.CV_OVERPRESSURE].see(cv_kPa > settings.cv_limit_kPa)
        if reservoir_good:
            self._lasting[Fault.RESERVOIR_OVERPRESSURE].see(reservoir_kPa > settings.reservoir_limit_kPa)
        present = Fault.NONE
        for fault, lasting in self._lasting.items():
            if lasting.there:
                present |= fault
        self._present = present
        if present:
            self._latch(present)

    def _regulate(self) -> Drive:
        relief = self._relief()
        if self._regulation is None:
            return SAFE._replace(dvp=relief)
        target_kPa, rate_kPa_per_s = self._aim
        settings = self.settings
        self._regulation, wanted = regulate(
            settings.regulator,
            self._regulation,
            target_kPa,
            rate_kPa_per_s,
            STEP_S,
            self._cv_kPa,
            self._reservoir_kPa,
        )
        return Drive(
            _lifted(wanted.evp, settings.evp_dead_band),
            _lifted(wanted.dvp, settings.dvp_dead_band),
            wanted.solenoid,
        )

    def _relief(self) -> float:
        """The Venturi over the limit: a valve that is stuck open may bring more than leaves by itself."""
        lasting = self._lasting
        if not lasting[Fault.CV_OVERPRESSURE].there or lasting[Fault.CV_SENSOR].there:
            self._relief_steps = 0
        elif (
            self._relief_steps < _MOST_RELIEF
            and self._reservoir_kPa >= self.settings.regulator.venturi_least_supply_kPa
        ):
            self._relief_steps += 1
            return 1.0
        return 0.0

    def _latch(self, fault: Fault) -> None:
        self._faults |= fault
        self._regulation = None

    def _handle(self, message: Message) -> None:
        match message:
            case Hello():
                self._on_hello(message)
            case Setpoint():
                self._on_setpoint(message)
            case Vent(number):
                self._regulation = None
                self._accept(number)
            case ClearFaults(mask):
                if self._greeted:
                    self._faults &= ~(Fault(mask) & ~self._present)
                else:
                    self._send(Refusal(0, RefusalReason.NO_HANDSHAKE))
            case Ping(host_time_us):
                self._send(Pong(host_time_us, self._device_time_ms()))
            case GetSetting(setting):
                self._tell_setting(setting)
            case SetSetting():
                self._on_set_setting(message)

    def _on_hello(self, hello: Hello) -> None:
        settings = self.settings
        self._regulation = None
        self._newest = None
        self._greeted = hello.protocol_version == PROTOCOL_VERSION
        self._send(
            Welcome(
                protocol_version=PROTOCOL_VERSION,
                nonce=hello.nonce,
                boot_id=self.boot_id,
                firmware_build=settings.build or _BUILD,
                units=Units.KPA_GAUGE,
                cv_limit_kPa=settings.cv_limit_kPa,
                setpoint_limit_kPa=settings.setpoint_most_kPa,
                reservoir_limit_kPa=settings.reservoir_limit_kPa,
                rate_limit_kPa_per_s=settings.rate_limit_kPa_per_s,
                dead_man_ms=settings.dead_man_ms,
                telemetry_Hz=settings.telemetry_Hz,
            )
        )
        if not self._greeted:
            self._send(Refusal(0, RefusalReason.VERSION))

    def _on_setpoint(self, setpoint: Setpoint) -> None:
        reason = self._why_refused(setpoint)
        if reason is not None:
            self._send(Refusal(setpoint.number, reason))
            return
        assert self._now_us is not None
        settings = self.settings
        if self._regulation is None:
            self._regulation = begin(self._cv_kPa)
        # Where to go, and how fast at most.
        self._aim = setpoint.target_kPa, min(setpoint.rate_kPa_per_s, settings.rate_limit_kPa_per_s)
        self._deadline_us = self._now_us + 1000 * min(setpoint.ttl_ms, settings.dead_man_ms)
        self._accept(setpoint.number)

    def _accept(self, number: int) -> None:
        self._number = number
        if not self._overtaken(number):
            self._newest = number

    def _overtaken(self, number: int) -> bool:
        """Whether a newer command came before it: a line may deliver in another order."""
        return self._newest is not None and (number - self._newest) & 0xFFFF >= 0x8000

    def _why_refused(self, setpoint: Setpoint) -> RefusalReason | None:
        if not self._greeted:
            return RefusalReason.NO_HANDSHAKE
        if not (math.isfinite(setpoint.target_kPa) and math.isfinite(setpoint.rate_kPa_per_s)):
            return RefusalReason.NOT_A_NUMBER
        within = 0.0 <= setpoint.target_kPa <= self.settings.setpoint_most_kPa
        if not within or setpoint.rate_kPa_per_s <= 0.0 or setpoint.ttl_ms == 0:
            return RefusalReason.OUT_OF_RANGE
        if self._faults:
            return RefusalReason.FAULT_LATCHED
        return RefusalReason.OVERTAKEN if self._overtaken(setpoint.number) else None

    def _on_set_setting(self, message: SetSetting) -> None:
        if not self._greeted:
            self._send(Refusal(0, RefusalReason.NO_HANDSHAKE))
        elif not math.isfinite(message.value):
            self._send(Refusal(0, RefusalReason.NOT_A_NUMBER))
        elif self._regulation is not None:
            # A limit must not move under a vine that is bent.
            self._send(Refusal(0, RefusalReason.REGULATING))
        elif message.id >= len(SETTING_ROWS) or not (
            changed := with_value(self.settings, SETTING_ROWS[message.id], message.value)
        ):
            self._send(Refusal(0, RefusalReason.OUT_OF_RANGE))
        else:
            self.settings = changed
            self._tell_setting(message.id)

    def _tell_setting(self, setting: int) -> None:
        if setting >= len(SETTING_ROWS):
            self._send(Refusal(0, RefusalReason.OUT_OF_RANGE))
            return
        row = SETTING_ROWS[setting]
        self._send(
            Setting(
                id=setting,
                count=len(SETTING_ROWS),
                name=row.name,
                value=value_of(self.settings, row.name),
                least=row.least,
                most=row.most,
                standard=value_of(FirmwareSettings(), row.name),
            )
        )

    def _send_telemetry(self, now_us: int, drive: Drive) -> None:
        period_us = 1_000_000 // self.settings.telemetry_Hz
        self._telemetry_us += period_us
        if self._telemetry_us <= now_us:
            self._telemetry_us = now_us + period_us
        self._send(
            Telemetry(
                device_time_ms=self._device_time_ms(),
                mode=self.mode,
                faults=self._faults,
                number=self._number,
                setpoint_kPa=0.0 if self._regulation is None else self._regulation.setpoint_kPa,
                cv_kPa=self._cv_kPa,
                reservoir_kPa=self._reservoir_kPa,
                evp_opening=drive.evp,
                dvp_opening=drive.dvp,
                solenoid=drive.solenoid,
            )
        )

    def _device_time_ms(self) -> int:
        assert self._now_us is not None
        return ((self._now_us - self._boot_us) // 1000) & 0xFFFFFFFF

    def _send(self, message: DeviceMessage) -> None:
        frame = self._codec.encode(message)
        if len(self._output) + len(frame) <= _MAX_OUTPUT_BYTES:
            self._output += frame


def _lifted(opening: float, dead_band: float) -> float:
    """Over the currents at which the valve does not open yet."""
    return dead_band + (1.0 - dead_band) * opening if opening > 0.0 else 0.0
