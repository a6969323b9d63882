"""The mission protocol's vehicle side: uploads and downloads on any link."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot.agenda import Agenda, AgendaEntry
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.autopilots.ardupilot import whole_centimetres
from flying_vines.vehicle.mission.item import MissionItem, has_place
from flying_vines.vehicle.mission.reference_vehicle import Home
from flying_vines.vehicle.mission.storage import (
    ACCEPTED,
    CANCELLED,
    CAPACITY,
    ERROR,
    INVALID_SEQUENCE,
    NO_SPACE,
    AutopilotKind,
    MissionRefused,
)

_ASK_AGAIN_S = 1.0
_GIVE_UP_S = 8.0
_TRANSFER_S = 5.0
_WRITTEN_EVERY_S = 0.008
"""As recorded, an item of an upload on ArduPilot."""
_CRITICAL, _INFO = 2, 6
_UNEXPECTED = b"WPM: REJ. CMD: Req. WP was unexpected\t"


@dataclass(slots=True)
class _Upload:
    link: str
    system: int
    component: int
    count: int
    deadline_s: float
    entry: AgendaEntry | None = None
    next_seq: int = 0


@dataclass(slots=True)
class _Download:
    """Of PX4: to whom, which item is next, and when it was last asked."""

    partner: tuple[int, int]
    next_seq: int
    heard_s: float


class MissionStorage:
    """The items the autopilot has, and the conversation that changes and reads them.

    ArduPilot writes item by item, so that a refused upload leaves a mixed mission; PX4 keeps the old mission
    until the new one is complete. `mission_id` is a checksum of the items, 0 without any; only PX4 tells it.
    """

    def __init__(
        self,
        kind: AutopilotKind,
        home: Home,
        agenda: Agenda,
        send: Callable[[str, Any], None],
        changed: Callable[[], None],
    ) -> None:
        """`changed()` is called after each change of `items`."""
        self.items: list[MissionItem] = []
        self.mission_id = 0
        self._kind = kind
        self._home = home
        self._agenda = agenda
        self._send = send
        self._changed = changed
        self._upload: _Upload | None = None
        self._incoming: list[MissionItem] = []
        self._download: _Download | None = None

    def load(self, items: Sequence[MissionItem]) -> None:
        """Put a whole mission in place; MissionRefused if the autopilot would not take an item."""
        self.items = [self._kept(replace(item, seq=seq)) for seq, item in enumerate(items)]
        self._change()

    def replace(self, link: str, items: Sequence[MissionItem]) -> None:
        """What somebody else's upload on `link` does; MissionRefused if an item is not taken."""
        kept = [self._kept(replace(item, seq=seq)) for seq, item in enumerate(items)]
        upload = _Upload(link, 0, 0, len(kept), math.inf)
        if self._kind == "ardupilot":
            if len(self.items) > len(kept):
                del self.items[len(kept) :]
                self._change()
            for item in kept:
                self._agenda.after((item.seq + 1) * _WRITTEN_EVERY_S, partial(self._write, item))
        else:
            self._incoming = kept
        self._agenda.after((len(kept) + 1) * _WRITTEN_EVERY_S, lambda: self._finish(upload))

    def reboot(self) -> None:
        self._upload = self._download = None
        self._incoming = []

    def handle(self, link: str, message: Any, has_space: bool) -> None:
        """A message of the mission protocol that is for the autopilot."""
        if getattr(message, "mission_type", 0):
            self._handle_other_type(link, message)
            return
        match message.get_type():
            case "MISSION_COUNT":
                self._begin(link, message, has_space)
            case "MISSION_ITEM" | "MISSION_ITEM_INT":
                self._take(link, message)
            case "MISSION_REQUEST_LIST":
                self._download = _Download(_reply(message), 0, self._agenda.now_s)
                self._send(link, mavlink.MAVLink_mission_count_message(*_reply(message), len(self.items)))
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT":
                if self._kind == "ardupilot" or self._in_turn(link, message):
                    self._give(link, message)
            case "MISSION_CLEAR_ALL":
                self.items = []
                self._change()
                self._ack(link, *_reply(message), ACCEPTED)
            case "MISSION_ACK":
                self._heed(link, message)

    def _handle_other_type(self, link: str, message: Any) -> None:
        """Fences and rally points: none, and none can be stored."""
        to, kind = _reply(message), message.mission_type
        if message.get_type() == "MISSION_REQUEST_LIST":
            self._send(link, mavlink.MAVLink_mission_count_message(*to, 0, mission_type=kind))
        elif message.get_type() == "MISSION_COUNT":
            result = NO_SPACE if message.count else ACCEPTED
            self._send(link, mavlink.MAVLink_mission_ack_message(*to, result, mission_type=kind))
        elif message.get_type() == "MISSION_CLEAR_ALL":
            self._send(link, mavlink.MAVLink_mission_ack_message(*to, ACCEPTED, mission_type=kind))

    def _change(self) -> None:
        self.mission_id = zlib.crc32(repr(self.items).encode()) if self.items else 0
        self._changed()

    def _ack(self, link: str, system: int, component: int, result: int) -> None:
        self._send(link, mavlink.MAVLink_mission_ack_message(system, component, result))

    def _begin(self, link: str, message: Any, has_space: bool) -> None:
        system, component = _reply(message)
        if message.count > CAPACITY or not has_space:
            self._ack(link, system, component, NO_SPACE)
            return
        self._stop()
        if self._kind == "ardupilot" and len(self.items) > message.count:
            del self.items[message.count :]
            self._change()
        self._incoming = []
        self._upload = _Upload(link, system, component, message.count, self._agenda.now_s + _GIVE_UP_S)
        if message.count == 0:
            self._finish(self._upload)
        else:
            self._ask()

    def _heed(self, link: str, message: Any) -> None:
        """Whoever uploads may give up; ArduPilot does not listen and goes on asking."""
        upload = self._upload
        if upload is None or self._kind == "ardupilot" or message.type != CANCELLED:
            return
        if (upload.link, upload.system, upload.component) == (link, *_reply(message)):
            self._stop()

    def _ask(self) -> None:
        upload = self._upload
        if upload is None:
            return
        to = upload.system, upload.component, upload.next_seq
        if self._kind == "ardupilot":
            self._send(upload.link, mavlink.MAVLink_mission_request_message(*to))
        else:
            self._send(upload.link, mavlink.MAVLink_mission_request_int_message(*to))
        upload.entry = self._agenda.after(_ASK_AGAIN_S, self._ask_again)

    def _ask_again(self) -> None:
        upload = self._upload
        if upload is None:
            return
        if self._agenda.now_s >= upload.deadline_s:
            self._stop()
            self._ack(upload.link, upload.system, upload.component, CANCELLED)
        else:
            self._ask()

    def _stop(self) -> None:
        if self._upload is not None and self._upload.entry is not None:
            self._upload.entry.cancel()
        self._upload = None

    def _take(self, link: str, message: Any) -> None:
        upload = self._upload
        if upload is None:
            self._ack(link, *_reply(message), ERROR)
            return
        if message.seq != upload.next_seq:
            if message.seq > upload.next_seq:
                self._ack(link, *_reply(message), INVALID_SEQUENCE)
            return
        try:
            item = self._kept(_item_of(message))
        except MissionRefused as refused:
            self._stop()
            self._ack(link, upload.system, upload.component, refused.result)
            return
        self._write(item)
        upload.next_seq += 1
        upload.deadline_s = self._agenda.now_s + _GIVE_UP_S
        if upload.entry is not None:
            upload.entry.cancel()
        if upload.next_seq == upload.count:
            self._finish(upload)
        else:
            self._ask()

    def _write(self, item: MissionItem) -> None:
        if self._kind == "px4":
            self._incoming.append(item)
            return
        if item.seq < len(self.items):
            self.items[item.seq] = item
        else:
            self.items.append(item)
        self._change()

    def _finish(self, upload: _Upload) -> None:
        self._stop()
        if self._kind == "px4":
            self.items = self._incoming
            self._change()
        else:
            # Only the one that uploaded hears it.
            self._send(upload.link, mavlink.MAVLink_statustext_message(_INFO, b"Flight plan received"))
        self._ack(upload.link, upload.system, upload.component, ACCEPTED)

    def _kept(self, item: MissionItem) -> MissionItem:
        if self._kind == "ardupilot" and item.seq == 0:
            home = self._home
            place = home.latitude_deg, home.longitude_deg, whole_centimetres(home.altitude_amsl_m)
            return MissionItem(0, 16, (0.0, 0.0, 0.0, 0.0, *place))
        return AUTOPILOTS[self._kind].store(item)

    def _in_turn(self, link: str, message: Any) -> bool:
        """PX4 gives the next item or the last one again; any other request ends the transfer."""
        now_s, transfer = self._agenda.now_s, self._download
        if transfer is None or now_s - transfer.heard_s > _TRANSFER_S or transfer.partner != _reply(message):
            return False
        transfer.heard_s = now_s
        if message.seq == transfer.next_seq:
            transfer.next_seq += 1
        elif message.seq != transfer.next_seq - 1:
            self._download = None
            self._ack(link, *_reply(message), ERROR)
            self._send(link, mavlink.MAVLink_statustext_message(_CRITICAL, _UNEXPECTED))
            return False
        return True

    def _give(self, link: str, message: Any) -> None:
        to = _reply(message)
        if message.seq >= len(self.items):
            self._ack(link, *to, INVALID_SEQUENCE)
            return
        item = self.items[message.seq]
        p1, p2, p3, p4, x, y, z = item.params
        head = (*to, item.seq, item.frame, item.command, int(item.current), int(item.autocontinue))
        if message.get_type() == "MISSION_REQUEST":
            reply = mavlink.MAVLink_mission_item_message(*head, p1, p2, p3, p4, x, y, z)
        else:
            x_int, y_int = _to_int(item, x), _to_int(item, y)
            reply = mavlink.MAVLink_mission_item_int_message(*head, p1, p2, p3, p4, x_int, y_int, z)
        self._send(link, reply)


def _reply(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _scale(command: int, frame: int) -> float:
    return 1e7 if has_place(command, frame) else 1.0


def _to_int(item: MissionItem, value: float) -> int:
    if not math.isfinite(value):
        return 0
    return max(-(1 << 31), min((1 << 31) - 1, round(value * _scale(item.command, item.frame))))


def _item_of(message: Any) -> MissionItem:
    x, y = float(message.x), float(message.y)
    if message.get_type() == "MISSION_ITEM_INT":
        scale = _scale(message.command, message.frame)
        x, y = x / scale, y / scale
    first_four = message.param1, message.param2, message.param3, message.param4
    return MissionItem(
        message.seq,
        message.command,
        (*first_four, x, y, message.z),
        message.frame,
        bool(message.current),
        bool(message.autocontinue),
    )
