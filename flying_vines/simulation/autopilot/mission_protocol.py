"""The vehicle side of the mission protocol: uploads and downloads on any link."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot.scheduler import ScheduledCallback, Scheduler
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.autopilots.ardupilot import whole_centimetres
from flying_vines.vehicle.mission.item import (
    ACCEPTED,
    CANCELLED,
    CAPACITY,
    DENIED,
    ERROR,
    INVALID_SEQUENCE,
    NO_SPACE,
    AutopilotKind,
    MissionItem,
    MissionRefused,
    has_place,
)
from flying_vines.vehicle.mission.mission_cache import item_of
from missions.home import Home

_REQUEST_AGAIN_S = 1.0
_GIVE_UP_S = 8.0
_TRANSFER_S = 5.0
_WRITE_PERIOD_S = 0.008
"""Time per uploaded item on ArduPilot, as recorded."""
_CRITICAL, _INFO = 2, 6
_UNEXPECTED = b"WPM: REJ. CMD: Req. WP was unexpected\t"
_MISMATCH = b"REJ. MIS ITEM: partner id mismatch\t"


_Address = tuple[int, int]
"""System and component."""


@dataclass(slots=True)
class _Upload:
    link: str
    sender: _Address
    count: int
    deadline_s: float
    entry: ScheduledCallback | None = None
    next_seq: int = 0


@dataclass(slots=True)
class _Download:
    """A download from PX4: its receiver, the next item, and the time of the last request."""

    partner: _Address
    next_seq: int
    requested_s: float


class MissionStorage:
    """The autopilot's mission items, and the protocol that changes and reads them.

    ArduPilot writes each item at once, so a refused upload leaves a mix of old and new items. PX4 replaces
    the mission when the upload is complete. `mission_id` is a checksum of the items, 0 without items; only
    PX4 sends it.
    """

    def __init__(
        self,
        kind: AutopilotKind,
        home: Home,
        scheduler: Scheduler,
        send: Callable[[str, Any], None],
        changed: Callable[[], None],
    ) -> None:
        """`changed()` is called after each change of `items`."""
        self.items: list[MissionItem] = []
        self.mission_id = 0
        self._kind = kind
        self._home = home
        self._scheduler = scheduler
        self._send = send
        self._changed = changed
        self._upload: _Upload | None = None
        self._incoming: list[MissionItem] = []
        self._download: _Download | None = None

    def load(self, items: Sequence[MissionItem]) -> None:
        """Store a whole mission. Raises `MissionRefused` if the autopilot would refuse an item."""
        self.items = self._all_stored(items)
        self._change()

    def replace(self, link: str, items: Sequence[MissionItem]) -> None:
        """Simulate an upload by another sender on `link`. Raises `MissionRefused` if an item is refused."""
        stored = self._all_stored(items)
        upload = _Upload(link, (0, 0), len(stored), math.inf)
        if self._kind == "ardupilot":
            if len(self.items) > len(stored):
                del self.items[len(stored) :]
                self._change()
            for item in stored:
                self._scheduler.after((item.seq + 1) * _WRITE_PERIOD_S, partial(self._write, item))
        else:
            self._incoming = stored
        self._scheduler.after((len(stored) + 1) * _WRITE_PERIOD_S, partial(self._finish, upload))

    def reboot(self) -> None:
        self._upload = self._download = None
        self._incoming = []

    def handle(self, link: str, message: Any, has_space: bool) -> None:
        """Handle a message of the mission protocol to the autopilot."""
        if getattr(message, "mission_type", 0):
            self._handle_other_type(link, message)
            return
        match message.get_type():
            case "MISSION_COUNT":
                self._begin(link, message, has_space)
            case "MISSION_ITEM" | "MISSION_ITEM_INT":
                self._take(link, message)
            case "MISSION_REQUEST_LIST":
                self._download = _Download(_sender(message), 0, self._scheduler.now_s)
                self._send(link, mavlink.MAVLink_mission_count_message(*_sender(message), len(self.items)))
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT":
                if self._kind == "ardupilot" or self._is_expected(link, message):
                    self._give(link, message)
            case "MISSION_CLEAR_ALL":
                self.items = []
                self._change()
                self._ack(link, _sender(message), ACCEPTED)
            case "MISSION_ACK":
                self._handle_ack(link, message)

    def _handle_other_type(self, link: str, message: Any) -> None:
        """Fences and rally points: there are none, and none can be stored."""
        to, kind = _sender(message), message.mission_type
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

    def _ack(self, link: str, to: _Address, result: int) -> None:
        self._send(link, mavlink.MAVLink_mission_ack_message(*to, result))

    def _begin(self, link: str, message: Any, has_space: bool) -> None:
        sender = _sender(message)
        if self._upload is not None and not self._is_uploader(self._upload, link, message):
            self._ack(link, sender, DENIED if self._kind == "ardupilot" else ERROR)
            return
        if message.count > CAPACITY or not has_space:
            self._ack(link, sender, NO_SPACE)
            return
        self._stop()
        if self._kind == "ardupilot" and len(self.items) > message.count:
            del self.items[message.count :]
            self._change()
        self._incoming = []
        deadline_s = self._scheduler.now_s + _GIVE_UP_S
        self._upload = upload = _Upload(link, sender, message.count, deadline_s)
        self._request_or_finish(upload)

    def _handle_ack(self, link: str, message: Any) -> None:
        """The uploader may cancel. ArduPilot ignores the cancellation and continues its requests."""
        cancels = self._kind == "px4" and message.type == CANCELLED
        if cancels and self._upload is not None and self._is_uploader(self._upload, link, message):
            self._stop()

    def _is_uploader(self, upload: _Upload, link: str, message: Any) -> bool:
        """True if the sender of this message is the one that uploads. ArduPilot does not look at the link."""
        same_link = self._kind == "ardupilot" or upload.link == link
        return same_link and upload.sender == _sender(message)

    def _request_or_finish(self, upload: _Upload) -> None:
        if upload.next_seq == upload.count:
            self._finish(upload)
        else:
            self._request_item(upload)

    def _request_item(self, upload: _Upload) -> None:
        make = (
            mavlink.MAVLink_mission_request_message
            if self._kind == "ardupilot"
            else mavlink.MAVLink_mission_request_int_message
        )
        self._send(upload.link, make(*upload.sender, upload.next_seq))
        upload.entry = self._scheduler.after(_REQUEST_AGAIN_S, partial(self._request_again, upload))

    def _request_again(self, upload: _Upload) -> None:
        if self._scheduler.now_s >= upload.deadline_s:
            self._stop()
            self._ack(upload.link, upload.sender, CANCELLED)
        else:
            self._request_item(upload)

    def _stop(self) -> None:
        if self._upload is not None and self._upload.entry is not None:
            self._upload.entry.cancel()
        self._upload = None

    def _take(self, link: str, message: Any) -> None:
        upload = self._upload
        if upload is None:
            self._ack(link, _sender(message), ERROR)
            return
        uploader = self._is_uploader(upload, link, message)
        if self._kind == "px4" and not uploader:
            self._send(link, mavlink.MAVLink_statustext_message(_CRITICAL, _MISMATCH))
            return
        # ArduPilot answers on the upload's link, wherever the item came from.
        if message.seq != upload.next_seq:
            if message.seq > upload.next_seq:
                self._ack(upload.link, _sender(message), INVALID_SEQUENCE)
            return
        if not uploader:
            self._ack(upload.link, _sender(message), DENIED)
            return
        try:
            item = self._stored(item_of(message))
        except MissionRefused as refused:
            self._stop()
            self._ack(upload.link, upload.sender, refused.result)
            return
        self._write(item)
        upload.next_seq += 1
        upload.deadline_s = self._scheduler.now_s + _GIVE_UP_S
        if upload.entry is not None:
            upload.entry.cancel()
        self._request_or_finish(upload)

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
            # ArduPilot sends this text only to the uploader.
            self._send(upload.link, mavlink.MAVLink_statustext_message(_INFO, b"Flight plan received"))
        self._ack(upload.link, upload.sender, ACCEPTED)

    def _all_stored(self, items: Sequence[MissionItem]) -> list[MissionItem]:
        return [self._stored(replace(item, seq=seq)) for seq, item in enumerate(items)]

    def _stored(self, item: MissionItem) -> MissionItem:
        if self._kind == "ardupilot" and item.seq == 0:
            home = self._home
            place = home.latitude_deg, home.longitude_deg, whole_centimetres(home.altitude_amsl_m)
            return MissionItem(0, 16, (0.0, 0.0, 0.0, 0.0, *place))
        return AUTOPILOTS[self._kind].store(item)

    def _is_expected(self, link: str, message: Any) -> bool:
        """True if PX4 answers this request: it is for the next item, or again for the last one.

        A request for any other item ends the transfer.
        """
        now_s, transfer = self._scheduler.now_s, self._download
        if (
            transfer is None
            or now_s - transfer.requested_s > _TRANSFER_S
            or transfer.partner != _sender(message)
        ):
            return False
        transfer.requested_s = now_s
        if message.seq == transfer.next_seq:
            transfer.next_seq += 1
        elif message.seq != transfer.next_seq - 1:
            self._download = None
            self._ack(link, _sender(message), ERROR)
            self._send(link, mavlink.MAVLink_statustext_message(_CRITICAL, _UNEXPECTED))
            return False
        return True

    def _give(self, link: str, message: Any) -> None:
        to = _sender(message)
        if message.seq >= len(self.items):
            self._ack(link, to, INVALID_SEQUENCE)
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


def _sender(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _to_int(item: MissionItem, value: float) -> int:
    if not math.isfinite(value):
        return 0
    scale = 1e7 if has_place(item.command, item.frame) else 1.0
    return max(-(1 << 31), min((1 << 31) - 1, round(value * scale)))
