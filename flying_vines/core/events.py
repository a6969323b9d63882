"""The core's inputs and outputs: events, actions, and a snapshot for displays and logs."""

from __future__ import annotations

import math
import traceback
from dataclasses import dataclass, field
from typing import Literal

from firmware_link import protocol
from flying_vines.supply import CyclesLeft
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vine.intent import Asker, Intent

MOST_OF_A_TRACE = 8000
"""Characters; the traceback of an endless recursion is long."""

# Events.


@dataclass(frozen=True, slots=True)
class VehicleMessage:
    """A MAVLink message of anyone on the vehicle's link."""

    t: float
    message: MavlinkMessage


@dataclass(frozen=True, slots=True)
class FirmwareMessage:
    """A message of the phloSAR's firmware."""

    t: float
    message: protocol.Message


@dataclass(frozen=True, slots=True)
class LinkChanged:
    """A link came up or went down; `why` is a sentence for people."""

    t: float
    link: Literal["vehicle", "firmware"]
    up: bool
    why: str = ""


@dataclass(frozen=True, slots=True)
class Tick:
    """Time passed."""

    t: float


@dataclass(frozen=True, slots=True)
class Said:
    """A text for people from outside the core: a file cannot be written, messages are forged."""

    t: float
    severity: Severity
    text: str


@dataclass(frozen=True, slots=True)
class Asked:
    """A person requests something that did not come over MAVLink."""

    t: float
    by: Asker
    intent: Intent
    made_at: float | None = None
    """When it was requested, by the clock of `t`; None: now."""
    seen_at: float | None = None
    """The `t` of the snapshot that the person saw: page and broker clear no fault that came later."""


@dataclass(frozen=True, slots=True)
class Stop:
    """The service ends: vent."""

    t: float


@dataclass(frozen=True, slots=True)
class Failed:
    """A part of the service raised an unexpected error."""

    t: float
    part: str
    trace: str
    """The traceback."""
    needed: bool
    """Whether the vine must not bend without it."""

    @classmethod
    def by(cls, t: float, part: str, error: BaseException, needed: bool) -> Failed:
        """By this exception."""
        trace = "".join(traceback.format_exception(error))
        return cls(t, part, trace[-MOST_OF_A_TRACE:], needed)


Event = VehicleMessage | FirmwareMessage | LinkChanged | Tick | Said | Asked | Stop | Failed


# Actions.


@dataclass(frozen=True, slots=True)
class ToVehicle:
    message: MavlinkMessage
    system_id: int


@dataclass(frozen=True, slots=True)
class ToFirmware:
    message: protocol.HostMessage


@dataclass(frozen=True, slots=True)
class Decision:
    """A trigger and the answer to it."""

    t: float
    trigger: str
    what: dict[str, object]
    intent: str | None
    safety: Literal["accepted", "limited", "refused"]
    reason: str
    setpoint_kPa: float
    """Where the motion goes first (gauge); if refused, that of the motion under way, or 0."""


@dataclass(frozen=True, slots=True)
class Measured:
    """The firmware's telemetry, for the log."""

    t: float
    telemetry: protocol.Telemetry


@dataclass(frozen=True, slots=True)
class KeepParameters:
    """The parameters that differ from the profile have changed: store them."""

    t: float
    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class KeepDisarmed:
    """The pneumatics were disarmed, or armed again: store that."""

    t: float
    disarmed: bool


@dataclass(frozen=True, slots=True)
class InternalError:
    """A part failed with this traceback, for the log."""

    t: float
    part: str
    trace: str


Action = ToVehicle | ToFirmware | Decision | Notice | Measured | KeepParameters | KeepDisarmed | InternalError


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything that a display or a log shows of one moment. Gauge kPa, degrees; NaN is unknown."""

    t: float
    vehicle: str
    mode: str
    armed: bool
    altitude_m: float
    rc: str
    switch_position: int | None
    firmware: str
    round_trip_s: float | None
    """Of the latest ping to the firmware."""
    telemetry_gaps: int
    reservoir_kPa: float
    cv_kPa: float
    command_kPa: float
    bend_deg: float
    evp_opening: float
    dvp_opening: float
    solenoid: bool | None
    cycles: CyclesLeft | None
    doing: str
    safe_state: dict[str, str] = field(default_factory=dict)
    findings: dict[str, int] = field(default_factory=dict)
    """How often each of the physics checks has found something."""
    ambient_kPa: float = math.nan
    """Absolute, as the autopilot's barometer has it."""
    pneumatics_armed: bool = True
    bench: bool = False
    """Whether the vine may be tried on the ground."""
