"""Tests the promises of an actuator with a model of its device. Your own tests call it:

    assert broken_promises(OurPump, ModelOfOurPump) == []

A model shows only that the protocol is right. To check that the real device vents by itself, pull its cable
while the vine is bent.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from firmware_link.actuator import Actuator, ActuatorLine
from firmware_link.host import VENTING, HostSession, Regulate, SessionState
from firmware_link.protocol import Mode, Setpoint

STEP_S = 0.02
STRAIGHT_KPA = 1.0
ANSWERS_WITHIN_S = 2.0
REPORTS_WITHIN_S = 0.2
NOISE = bytes(range(256)) * 4


class Device(Protocol):
    """A model of the device at the other end of the line."""

    @property
    def pressure_kPa(self) -> float:
        """The true pressure in the vine, gauge."""

    def receive(self, data: bytes) -> None:
        """Take bytes that the host sent."""

    def advance(self, t: float) -> bytes:
        """Simulate until `t` (seconds, from 0). Returns the bytes that the device sends until then."""


class _Trial:
    """One actuator with its device, from power-up on."""

    def __init__(self, actuator: Actuator, device: Device) -> None:
        self.device, self.line, self.session = device, ActuatorLine(actuator), HostSession(STEP_S)
        self.t = 0.0
        self.cut = False
        """The wire to the device is cut."""
        self.highest_kPa = 0.0
        self.session.opened(self.t)

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Returns True as soon as `until` holds, False after `seconds`."""
        for _ in range(round(seconds / STEP_S)):
            self.t += STEP_S
            for message in self.line.decode(self.t, self.device.advance(self.t)):
                self.session.receive(self.t, message)
            self.highest_kPa = max(self.highest_kPa, self.device.pressure_kPa)
            for message in self.session.tick(self.t):
                data = self.line.encode(message)
                if not self.cut:
                    self.device.receive(data)
            if until():
                return True
        return False

    def command(self, kPa: float | None) -> None:
        """Go to a pressure, or vent."""
        command = VENTING if kPa is None else Regulate(kPa, self.session.welcome.rate_limit_kPa_per_s)  # type: ignore[union-attr]
        for message in self.session.command(self.t, command):
            self.device.receive(self.line.encode(message))

    def reports(self, mode: Mode) -> bool:
        telemetry, age_s = self.session.telemetry, self.session.telemetry_age(self.t)
        return telemetry is not None and telemetry.mode is mode and age_s < REPORTS_WITHIN_S

    def straight(self) -> bool:
        return self.device.pressure_kPa < STRAIGHT_KPA and self.reports(Mode.VENT)


def broken_promises(
    actuator: Callable[[], Actuator], device: Callable[[], Device], moves_within_s: float = 5.0
) -> list[str]:
    """One sentence for each promise of `Actuator` that is broken; empty if it keeps them all.

    Args:
        actuator: makes the actuator.
        device: makes a model of the device after power-up.
        moves_within_s: the longest time of a bend and of a vent.
    """
    try:
        trial = _Trial(actuator(), device())
    except Exception as error:
        return [f"it cannot be used: {error}"]
    if not trial.run(ANSWERS_WITHIN_S, lambda: trial.session.state is SessionState.READY):
        return [f"it sends no reading within {ANSWERS_WITHIN_S:g} s of power-up"]
    broken = [] if trial.reports(Mode.VENT) else ["it does not report that it is vented after power-up"]
    limit_kPa = actuator().max_kPa
    dead_man_s = actuator().dead_man_ms / 1000.0

    def bent() -> _Trial:
        trial = _Trial(actuator(), device())
        trial.run(ANSWERS_WITHIN_S, lambda: trial.session.state is SessionState.READY)
        trial.command(limit_kPa)
        trial.run(moves_within_s, lambda: trial.device.pressure_kPa > 0.9 * limit_kPa)
        return trial

    trial = bent()
    if not trial.device.pressure_kPa > 0.9 * limit_kPa or not trial.reports(Mode.REGULATE):
        return [
            *broken,
            f"it does not reach max_kPa within {moves_within_s:g} s, or does not report that it regulates",
        ]
    trial.run(1.0)
    if trial.highest_kPa > 1.1 * limit_kPa:
        broken.append(f"it reaches {trial.highest_kPa:.1f} kPa, but max_kPa is {limit_kPa:g}")
    trial.command(limit_kPa / 2.0)
    if not trial.run(moves_within_s, lambda: trial.device.pressure_kPa < 0.6 * limit_kPa):
        broken.append("it does not go down to a lower setpoint")
    trial.command(None)
    if not trial.run(moves_within_s, trial.straight):
        broken.append("the vent command does not vent it, or it does not report the vent")

    trial = bent()
    trial.cut = True
    if not trial.run(dead_man_s + REPORTS_WITHIN_S, lambda: trial.reports(Mode.VENT)):
        broken.append("it does not report a vent within dead_man_ms of the last message")
    if not trial.run(moves_within_s, trial.straight):
        broken.append("it does not vent when no message comes for dead_man_ms")

    setpoint = ActuatorLine(actuator()).encode(Setpoint(limit_kPa, 1.0, 250, 1))
    for length in range(1, len(setpoint)):
        trial = bent()
        trial.device.receive(setpoint[:length])
        trial.command(None)
        trial.cut = True  # one vent must be enough
        if not trial.run(dead_man_s / 2.0, lambda trial=trial: trial.reports(Mode.VENT)):  # type: ignore[misc]
            broken.append(f"the vent command does not vent it after the first {length} bytes of a setpoint")
            break
    return broken + _misread(actuator, device)


def _misread(actuator: Callable[[], Actuator], device: Callable[[], Device]) -> list[str]:
    """The broken promises of `readings`."""
    sent = device().advance(1.0)
    whole, pieces = actuator(), actuator()
    broken = []
    try:
        at_once = list(whole.readings(sent))
        if at_once != [reading for byte in sent for reading in pieces.readings(bytes((byte,)))]:
            broken.append("readings differ if their bytes come one by one")
        if list(whole.readings(b"")):
            broken.append("it makes up readings that the device has not sent")
        list(whole.readings(NOISE))
        if not list(whole.readings(sent)):
            broken.append("it reads nothing after noise on the line")
    except Exception as error:
        broken.append(f"readings raises {type(error).__name__} for noise or incomplete readings")
    return broken
