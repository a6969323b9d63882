"""The core's inputs and outputs: events and actions."""

from __future__ import annotations

import traceback
from dataclasses import dataclass, field
from typing import Literal

from firmware_link import protocol
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vine.intent import Asker, Intent

MAX_TRACE_LENGTH = 8000
"""In characters. The traceback of an endless recursion is long."""

# Events.


@dataclass(frozen=True, slots=True)
class VehicleMessage:
    """A MAVLink message of any sender on the vehicle's link."""

    t: float
    message: MavlinkMessage


@dataclass(frozen=True, slots=True)
class FirmwareMessage:
    """A message of the actuator's firmware."""

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
    """A notice from outside the core, such as "cannot write the log" or "forged messages arrive"."""

    t: float
    severity: Severity
    text: str


@dataclass(frozen=True, slots=True)
class Asked:
    """A request by page, broker or calibration, not over MAVLink."""

    t: float
    by: Asker
    intent: Intent
    made_at: float | None = None
    """When it was requested, on the same clock as `t`; None: at `t`."""
    seen_at: float | None = None
    """The `t` of the snapshot that the person saw. Page and broker clear no fault that appeared later."""


@dataclass(frozen=True, slots=True)
class Stop:
    """The service ends: vent."""

    t: float


@dataclass(frozen=True, slots=True)
class Failed:
    """A part of the program raised an unexpected error."""

    t: float
    part: str
    trace: str
    """The traceback."""
    needed: bool
    """The vine must not bend without this part."""

    @classmethod
    def by(cls, t: float, part: str, error: BaseException, needed: bool) -> Failed:
        """Make a `Failed` from an exception."""
        trace = "".join(traceback.format_exception(error))
        return cls(t, part, trace[-MAX_TRACE_LENGTH:], needed)


Event = VehicleMessage | FirmwareMessage | LinkChanged | Tick | Said | Asked | Stop | Failed


# Actions.


@dataclass(frozen=True, slots=True)
class ToVehicle:
    message: MavlinkMessage
    system_id: int


@dataclass(frozen=True, slots=True)
class ToFirmware:
    message: protocol.HostMessage


UNREQUESTED = ("failsafe", "link")
"""The triggers that nobody requested. They vent or hold the vine."""


def carried_out_unrequested(trigger: str, safety: str) -> bool:
    """True if the vine was vented or held without a request. Displays do not show this decision in green."""
    return trigger in UNREQUESTED and safety == "accepted"


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
    """First target (gauge) of the motion that runs after this decision; 0 if none runs."""
    shown: bool = True
    """False: displays leave it out, because its source has many. A notice gives their number."""


@dataclass(frozen=True, slots=True)
class Measured:
    """The firmware's telemetry, for a calibration. The log has it as a `FirmwareMessage`."""

    t: float
    telemetry: protocol.Telemetry


@dataclass(frozen=True, slots=True)
class KeepParameters:
    """The parameters that differ from the configuration have changed: store them."""

    t: float
    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class KeepDisarmed:
    """The pneumatics were disarmed, or armed again: store the new state."""

    t: float
    disarmed: bool


@dataclass(frozen=True, slots=True)
class KeepLearned:
    """Store what was learned about the rig's air."""

    t: float
    text: str
    """The file's text."""


@dataclass(frozen=True, slots=True)
class KeepLatched:
    """A fault has latched, or a person has cleared one: store the faults that are latched now."""

    t: float
    faults: dict[str, str]
    """A sentence for each fault, by the fault's name."""


@dataclass(frozen=True, slots=True)
class KeepBoardSettings:
    """Remember these settings of the board: the rig's, or a person has confirmed them."""

    t: float
    digest: int
    """Of all settings, as in `Welcome`."""


@dataclass(frozen=True, slots=True)
class StoredState:
    """The state that the core of the last run stored, for the core of this run."""

    parameters: dict[str, float] = field(default_factory=dict)
    """The parameters that a pilot has set."""
    disarmed: bool = False
    """The pneumatics were disarmed. They stay so until a person arms them."""
    learned: str = ""
    """The text of the last `KeepLearned`."""
    latched: dict[str, str] = field(default_factory=dict)
    """The faults that nobody has cleared, by name."""
    board_settings: int | None = None
    """The digest of the last `KeepBoardSettings`; None if there was none."""


@dataclass(frozen=True, slots=True)
class InternalError:
    """A part failed with this traceback, for the log."""

    t: float
    part: str
    trace: str


Action = (
    ToVehicle
    | ToFirmware
    | Decision
    | Notice
    | Measured
    | KeepParameters
    | KeepDisarmed
    | KeepLearned
    | KeepLatched
    | KeepBoardSettings
    | InternalError
)
