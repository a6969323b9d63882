"""All differences between autopilots. No other code in this package asks for the kind of autopilot.

Clock and streams are the same for all: every autopilot stamps its messages with the time since boot, and
sends a stream after SET_MESSAGE_INTERVAL.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.clock import AutopilotClock
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import Execution, MissionItem, is_nav
from flying_vines.vehicle.mission.mission_cache import MissionCache

LOSS_SHOWN_WITHIN_S = 2.0
"""If a loss of RC is reported later than this, a false move of the switch may count as the pilot's."""


class MissionWatch:
    """Detects mission items that ran. This base class detects only items that arrive as commands."""

    publishes_items = True
    """True: the autopilot sends mission items as commands to component 0. False: ignore commands to component
    0; an ArduPilot sends such commands to a camera."""

    def __init__(
        self, cache: MissionCache, commands: Container[int] = (), clock: AutopilotClock | None = None
    ) -> None:
        """`commands` are the command numbers of items for the vine."""
        self._cache = cache
        self._commands = commands
        self._clock = clock or AutopilotClock()

    def handle(self, t: float, message: MavlinkMessage) -> None:
        """Take in a message of the autopilot, after the cache and the clock have handled it."""

    @property
    def idle(self) -> bool:
        """True if `due` and `asks` return nothing until the next `handle`."""
        return True

    def due(self, t: float) -> list[Execution]:
        """The executions that have become certain."""
        return []

    def asks(self, t: float) -> list[int]:
        """The seqs of the items to request from the autopilot now."""
        return []

    def command(
        self, t: float, command: int, params: tuple[float, ...], confirmation: int
    ) -> Execution | None:
        """The execution behind a command of the autopilot; None if it was handled already."""
        return Execution(command, None, None, params)

    def forget(self, t: float) -> None:
        """Drop older items: a person has made a request, or we have just begun to listen."""

    def restarted(self) -> None:
        """The autopilot rebooted."""


class Autopilot:
    """An unknown autopilot. There is a subclass for each known autopilot. The objects have no state."""

    kind = "other"
    """Its name in configurations, missions and on the command line."""
    title = "the autopilot"
    mav_autopilot: int = mavlink.MAV_AUTOPILOT_GENERIC

    rc_parameters: tuple[str, ...] = ()
    """Its parameters that affect whether a loss of RC can be detected."""
    mode_channel_parameter = ""
    """Its parameter for the RC channel of the flight mode."""
    other_uses: tuple[str, ...] = ()
    """Its parameters that give an RC channel another use. The value of one with {} is the use of the channel
    of this number; the value of the others is the number of the channel."""
    needs_rc_status = False
    """RC counts only after SYS_STATUS has shown a good receiver, or if rssi shows that it comes from a ground
    station. RC_CHANNELS alone may hold the receiver's failsafe values."""

    mission_watch: type[MissionWatch] = MissionWatch
    """Detects which mission items ran."""
    begins_with_home = False
    """Item 0 of a mission is the home position."""
    item_commands: tuple[str, ...] = ()
    """Mission commands that can carry a vine action, best first. The best ones move nothing but the vine."""
    item_match = ""
    """An extra match for an `[[items]]` rule. With it `item_commands[0]` moves nothing but the vine."""
    gives_items_in_any_order = False
    """It answers a request for any item at any time."""
    own_rates_Hz: ClassVar[Mapping[str, float]] = {}
    """Messages with a fixed rate, which cannot be requested."""
    rc_remedies: ClassVar[Mapping[str, str]] = {}
    """What to do about each parameter that hides a loss of RC."""
    unseen_loss_remedy = (
        "if you switched off this vehicle's transmitter: set the receiver's failsafe to no pulses"
    )
    """What to do if a loss of RC is not detected."""
    hides_our_parameters = False
    """QGroundControl loads this autopilot's parameters as a file. Then it requests no parameters of other
    components."""

    def mode_name(self, custom_mode: int) -> str:
        """The flight mode in HEARTBEAT."""
        return f"MODE {custom_mode}"

    def parameter_value(self, message: MavlinkMessage) -> float:
        """The number in a PARAM_VALUE."""
        return float(message.param_value)

    def other_use(self, channel: int, values: Mapping[str, float]) -> str:
        """The parameter, with its value, that gives this RC channel another use; empty if there is none."""
        for pattern in self.other_uses:
            name, value = pattern.format(channel), values.get(pattern.format(channel), 0.0)
            if value and ("{" in pattern or value == channel):
                return f"{name} is {value:g}"
        return ""

    def hides_rc_loss(self, values: Mapping[str, float]) -> str:
        """The parameter, with its value, that makes a loss of RC undetectable; empty if there is none."""
        return ""

    def rc_loss_shows_within_s(self, values: Mapping[str, float]) -> float:
        """Maximum delay until SYS_STATUS reports a loss of RC; 0 if RC_CHANNELS shows it at once."""
        return 0.0

    def override_lasts_s(self, values: Mapping[str, float]) -> float:
        """Time until an RC override expires; 0 if overrides are refused, or if their end causes no step."""
        return 0.0

    def how_to_set_stream(self, message: str, rate_Hz: int) -> str:
        """What to set on the autopilot if a requested message does not arrive."""
        return f"have it send {message} {rate_Hz} times a second"

    def store(self, item: MissionItem) -> MissionItem:
        """The item as the autopilot would store and return it. Raises `MissionRefused` for a refused item."""
        return item

    def waits_for(self, item: MissionItem) -> bool:
        """True if the mission continues only after this item is done."""
        return is_nav(item.command)
