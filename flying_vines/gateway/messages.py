"""Messages between service and gateway: one JSON object per packet of a socket pair."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, get_args

import msgspec

from flying_vines.config.config import Config
from flying_vines.vine.intent import COMMAND_OF, Asker, BendTo, CommandName, Intent, SetPressure, StartProfile

if TYPE_CHECKING:
    # Imported only for type checks, because the gateway must start fast.
    from flying_vines.core.events import Action
    from flying_vines.core.snapshot import Snapshot

COMMANDS: tuple[CommandName, ...] = get_args(CommandName)
ALIVE_EVERY_S = 0.5


class _Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind"):
    pass


# From the service.


class GatewayStart(_Message, frozen=True, tag="profile"):
    """The first message: the vehicle's configuration."""

    config: Config
    version: str
    page_token: str = ""
    """The token that opens the page from the network."""
    flights: str = ""
    """The folder of the flight logs; empty: none are offered for download."""


class SnapshotMessage(_Message, frozen=True, tag="snapshot"):
    """A `Snapshot`; null is unknown. Its `t` is the time on this computer's monotonic clock."""

    snapshot: msgspec.Raw


class Happened(_Message, frozen=True, tag="happened"):
    """An event, such as `Decision` or `Notice`: the name of its type, and its fields."""

    what: str
    fields: msgspec.Raw


class Answered(_Message, frozen=True, tag="answered"):
    """The result of a `Request`."""

    number: int
    safety: Literal["accepted", "limited", "refused"]
    reason: str = ""


ToGateway = GatewayStart | SnapshotMessage | Happened | Answered


# From the gateway.


class Request(_Message, frozen=True, tag="ask"):
    """A request from the page or the broker. `value`: an angle or a pressure. `name`: a profile's name."""

    number: int
    by: Asker
    command: CommandName
    value: float | None = None
    name: str | None = None
    made_at: float | None = None
    """Time of the request, on the monotonic clock; None: now."""
    seen_at: float | None = None
    """The `t` of the snapshot that the person saw."""

    def __post_init__(self) -> None:
        needs_value, needs_name = self.command in ("bend", "pressure"), self.command == "profile"
        if needs_value != (self.value is not None) or needs_name != (self.name is not None):
            raise ValueError(f"'{self.command}' {_NEEDS.get(self.command, 'takes no value and no name')}")
        if self.name is not None and not self.name.isprintable():
            # Terminals show the name, and would carry out its control characters.
            raise ValueError("the name has characters that cannot be printed")
        if self.value is not None and not math.isfinite(self.value):
            raise ValueError("the value is not a finite number")

    @property
    def intent(self) -> Intent:
        match self.command:
            case "bend":
                return BendTo(self.value or 0.0)
            case "pressure":
                return SetPressure(self.value or 0.0)
            case "profile":
                return StartProfile(self.name or "")
        return _PLAIN[self.command]()


class Trouble(_Message, frozen=True, tag="trouble"):
    """A text for the crew, e.g. a port in use or a broker that refuses the connection."""

    text: str


class Alive(_Message, frozen=True, tag="alive"):
    """The gateway's loop runs. Sent every `ALIVE_EVERY_S`."""


FromGateway = Request | Trouble | Alive

_NEEDS = {"bend": "takes a value", "pressure": "takes a value", "profile": "takes a name"}
_PLAIN: dict[str, Callable[[], Intent]] = {name: kind for kind, name in COMMAND_OF.items()}


def raw(thing: Snapshot | Action) -> msgspec.Raw:
    """As JSON; NaN becomes null."""
    return msgspec.Raw(msgspec.json.encode(thing))


packet = msgspec.json.encode
"""A message as bytes."""
read_to_gateway: Callable[[bytes], ToGateway] = msgspec.json.Decoder(ToGateway).decode
"""Raises `msgspec.DecodeError`."""
read_from_gateway: Callable[[bytes], FromGateway] = msgspec.json.Decoder(FromGateway).decode
"""Raises `msgspec.DecodeError`."""
