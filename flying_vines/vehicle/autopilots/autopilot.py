"""Everything that differs from one autopilot to the next. Nothing else in this package asks which one it is.

The clock and the streams are not here: both autopilots stamp their messages with the time since boot, and
send a stream when SET_MESSAGE_INTERVAL asks for it.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.clock import AutopilotClock
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.book import MissionBook
from flying_vines.vehicle.mission.execution import Execution
from flying_vines.vehicle.mission.item import MissionItem, is_nav
from flying_vines.vehicle.mission.reference_vehicle import Home

LOSS_SHOWN_WITHIN_S = 2.0
"""A loss of RC that shows later than this can hide a move of the switch."""


class MissionWatch:
    """Sees that mission items ran. This one knows only the items that the autopilot sends as commands."""

    publishes_items = True
    """Items are sent as commands to no component in particular. Where they are told in another way, a command
    to no component (ArduPilot's to a camera) is not for us."""

    def __init__(
        self, book: MissionBook, commands: Container[int] = (), clock: AutopilotClock | None = None
    ) -> None:
        """`commands` are those of items for the vine."""
        self._book = book
        self._commands = commands
        self._clock = clock or AutopilotClock()

    def handle(self, t: float, message: MavlinkMessage) -> None:
        """Read a message of the autopilot, after the book and the clock have read it."""

    @property
    def idle(self) -> bool:
        """Whether nothing can be due or asked for before the next `handle`."""
        return True

    def due(self, t: float) -> list[Execution]:
        """The executions that are certain by now."""
        return []

    def asks(self, t: float) -> list[int]:
        """The numbers of the items that the autopilot shall be asked for now."""
        return []

    def command(
        self, t: float, command: int, params: tuple[float, ...], confirmation: int
    ) -> Execution | None:
        """The item behind a command of the autopilot; None where that item was acted on already."""
        return Execution(command, None, None, params)

    def forget(self, t: float) -> None:
        """Drop older items: a person has requested something, or we have just begun to listen."""

    def restarted(self) -> None:
        """The autopilot has booted again."""


class Autopilot:
    """An autopilot that we do not know. Subclasses know one; none of them has a state."""

    kind = "other"
    """Its name in profiles, missions and on the command line."""
    title = "the autopilot"
    mav_autopilot: int = mavlink.MAV_AUTOPILOT_GENERIC
    simulator_home: Home
    """Where its simulator is switched on."""

    rc_parameters: tuple[str, ...] = ()
    """Its parameters that say whether a lost transmitter shows."""
    needs_rc_status = False
    """RC counts only after SYS_STATUS has shown a good receiver, or when rssi says that it comes from a
    ground station. RC_CHANNELS alone may be what a receiver made up."""

    mission_watch: type[MissionWatch] = MissionWatch
    """Detects which mission items ran."""
    begins_with_home = False
    """Item 0 of a mission is the home position."""
    carriers: tuple[str, ...] = ()
    """Which mission items carry an action of ours best: those first that move nothing but the vine."""
    carrier_match = ""
    """What an `[[items]]` rule has to match, too, so that the first of them moves nothing else."""
    gives_items_in_any_order = False
    """It answers a request for any item at any time."""
    own_rates_Hz: ClassVar[Mapping[str, float]] = {}
    """Messages that it sends at a rate of its own, and cannot be asked for."""
    rc_remedies: ClassVar[Mapping[str, str]] = {}
    """What to do about each parameter that hides a lost transmitter."""
    unseen_loss_remedy = "was it this transmitter? Then set the receiver's failsafe to no pulses"
    """What to do where nothing tells of a lost transmitter."""
    hides_our_parameters = False
    """QGroundControl reads its parameters as a file, and then asks no other component for its own."""

    def mode_name(self, custom_mode: int) -> str:
        """The flight mode in HEARTBEAT."""
        return f"MODE {custom_mode}"

    def parameter_value(self, message: MavlinkMessage) -> float:
        """The number in a PARAM_VALUE."""
        return float(message.param_value)

    def hides_rc_loss(self, values: Mapping[str, float]) -> str:
        """Which of its parameters hides a lost transmitter; empty if none is known to."""
        return ""

    def rc_loss_shows_within_s(self, values: Mapping[str, float]) -> float:
        """By when SYS_STATUS has told of a lost transmitter; 0 where RC_CHANNELS shows it at once."""
        return 0.0

    def override_lasts_s(self, values: Mapping[str, float]) -> float:
        """How long a ground station's RC override holds; 0 if it takes none, or drops it without a jump."""
        return 0.0

    def how_to_set_stream(self, message: str, rate_Hz: int) -> str:
        """What to set on it where a message does not come although it is asked for."""
        return f"have it send {message} {rate_Hz} times a second"

    def store(self, item: MissionItem) -> MissionItem:
        """The item as the autopilot would give it back; MissionRefused if it would not take it."""
        return item

    def waits_for(self, item: MissionItem) -> bool:
        """Whether the mission goes on only when this item is done."""
        return is_nav(item.command)
