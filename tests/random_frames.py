"""Valid MAVLink frames with random content, and bytes that are not frames, between any components."""

from __future__ import annotations

import random
import struct
from collections.abc import Sequence
from typing import Any

from msgspec import structs
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.config.config import Config

AUTOPILOT, STATION, GIMBAL, OTHER, OURSELVES = (1, 1), (255, 190), (1, 154), (2, 1), (1, 191)
SENDERS = (AUTOPILOT, AUTOPILOT, AUTOPILOT, STATION, STATION, GIMBAL, OTHER, OURSELVES, (0, 0))
OFTEN: dict[str, Sequence[int]] = {
    "target_system": (0, 1, 1, 2),
    "target_component": (0, 1, 191, 191),
    "command": (187, 211, 217, 42600, 400, 510, 511, 512, 31010, 31011, 31012, 31013, 31014),
    "confirmation": (0, 0, 1, 2),
    "mission_type": (0, 0, 1),
    "seq": tuple(range(8)),
    "count": (0, 3, 8, 65535),
    "autopilot": (3, 3, 12, 8),
    "type": (2, 2, 6, 18),
}
"""Frequent values of fields, so that the code behind checks is reached."""
FLOATS = (float("nan"), float("inf"), float("-inf"), 3.4e38, -1.0, 0.0, 1.0, 2.0, 3.0, 30.0)
TEXTS = (b"Mission: 3 Scripting", b"Mission: 5 Gripper", b"Mission: 99999 Winch", b"Reached command #2",
         b"Radio Failsafe", b"ArduPilot Ready", b"Flight plan received")  # fmt: skip
PARAMETERS = (b"VINE_MAX_KPA", b"MIS_TOTAL", b"VINE_", b"")
EXTREMES = (b"\x00", b"\xff", b"\x7f", b"\x80")
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
KINDS: tuple[Any, ...] = tuple(mavlink.mavlink_map.values())
COMMANDS: tuple[Any, ...] = (mavlink.mavlink_map[75], mavlink.mavlink_map[76])
FLOOD_IDS = (0, 20, 21, 23, 40, 43, 44, 51, 73, 75, 76, 253)
FLOOD: tuple[Any, ...] = tuple(mavlink.mavlink_map[number] for number in FLOOD_IDS)
"""Parameters, missions, commands and texts: messages that cost work and answers."""

MAX_FRAME_SIZE = 280
"""A signed frame with 255 bytes of payload."""

_SIZES = {"float": 4, "double": 8, "char": 1}


def _offsets(kind: Any) -> dict[str, tuple[int, str, int]]:
    """Offset, type and size of each field in the payload."""
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    found, at = {}, 0
    for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        of_one = _SIZES.get(types[name]) or int(types[name].removeprefix("u")[3:-2]) // 8
        size = of_one * max(1, length)
        found[name] = (at, types[name], size)
        at += size
    assert at == kind.unpacker.size, kind.msgname
    return found


_FIELDS = {kind: _offsets(kind) for kind in KINDS}


def serving_vehicle_1() -> Config:
    """The default configuration for vehicle 1. Without a configured id the service refuses several
    autopilots, and random frames have many."""
    base = config.default()
    return structs.replace(base, vehicle=structs.replace(base.vehicle, system_id=1))


class RandomFrames:
    """Frames with good checksums, of every type of the dialect.

    With `disarmed` the autopilot's heartbeats always say that the vehicle is disarmed.
    """

    def __init__(self, seed: int, *, disarmed: bool = False) -> None:
        self.dice = random.Random(seed)
        self._disarmed = disarmed
        self._sequences: dict[tuple[int, int], int] = {}

    def frame(self, kinds: Sequence[Any] = KINDS, sender: tuple[int, int] | None = None) -> bytes:
        dice = self.dice
        kind = dice.choice(kinds)
        if sender is None and dice.random() < 0.1:
            anyone = dice.randrange(256), dice.randrange(256)
            return packed(kind, self._payload(kind), anyone, dice.randrange(256))
        sender = sender or dice.choice(SENDERS)
        sequence = self._sequences[sender] = (self._sequences.get(sender, -1) + 1) & 0xFF
        return packed(kind, self._payload(kind), sender, sequence)

    def alive(self) -> bytes:
        """The normal messages of a vehicle on the ground, so that it is found among the random ones."""
        kind = mavlink.mavlink_map[mavlink.MAVLINK_MSG_ID_HEARTBEAT]
        sequence = self._sequences[AUTOPILOT] = (self._sequences.get(AUTOPILOT, -1) + 1) & 0xFF
        return packed(kind, kind.unpacker.pack(0, 2, 3, 81, 3, 3), AUTOPILOT, sequence)

    def noise(self) -> bytes:
        """Bytes that are not a frame; some begin like one."""
        head = self.dice.choice((b"", b"\xfd", b"\xfe", b"\xfd\xff\x01"))
        return head + self.dice.randbytes(self.dice.randrange(1, 300))

    def _payload(self, kind: Any) -> bytes:
        dice = self.dice
        payload = bytearray(dice.randbytes(kind.unpacker.size))
        for name, (at, what, size) in _FIELDS[kind].items():
            chance = dice.random()
            if name in OFTEN and what != "float" and chance < 0.8:
                value = dice.choice(OFTEN[name]) & (1 << 8 * size) - 1
                payload[at : at + size] = value.to_bytes(size, "little")
            elif what == "float" and size == 4 and chance < 0.6:
                payload[at : at + 4] = struct.pack("<f", dice.choice(FLOATS))
            elif what == "char" and chance < 0.7:
                payload[at : at + size] = dice.choice(TEXTS if size == 50 else PARAMETERS)[:size].ljust(
                    size, b"\0"
                )
            elif chance > 0.9:
                payload[at : at + size] = dice.choice(EXTREMES) * size
            if self._disarmed and kind.id == mavlink.MAVLINK_MSG_ID_HEARTBEAT and name == "base_mode":
                payload[at] &= ~ARMED & 0xFF
        return bytes(payload)


def packed(kind: Any, payload: bytes, sender: tuple[int, int], sequence: int) -> bytes:
    """A MAVLink 2 frame."""
    number = kind.id
    header = struct.pack(
        "<BBBBBBBHB", 0xFD, len(payload), 0, 0, sequence, *sender, number & 0xFFFF, number >> 16
    )
    crc = mavlink.x25crc(header[1:] + payload)
    crc.accumulate(bytes((kind.crc_extra,)))
    return header + payload + struct.pack("<H", crc.crc)


def largest_tables(root: object, most: int = 5) -> list[tuple[int, str]]:
    """The largest containers that our objects reference, with the path to each."""
    found: list[tuple[int, str]] = []
    seen: set[int] = set()
    pending: list[tuple[object, str]] = [(root, type(root).__name__)]
    while pending:
        thing, path = pending.pop()
        if id(thing) in seen:
            continue
        seen.add(id(thing))
        if isinstance(thing, bytes | bytearray | str):
            found.append((len(thing), path))
        elif isinstance(thing, dict):
            found.append((len(thing), path))
            pending.extend((value, f"{path}[]") for value in thing.values())
        elif isinstance(thing, list | tuple | set | frozenset) or type(thing).__name__ == "deque":
            found.append((len(thing), path))  # type: ignore[arg-type]
            pending.extend((value, f"{path}[]") for value in thing)  # type: ignore[attr-defined]
        elif type(thing).__module__.split(".")[0] in ("flying_vines", "firmware_link", "pymavlink"):
            names = [*getattr(thing, "__dict__", ()), *_slots(thing)]
            pending.extend((getattr(thing, name, None), f"{path}.{name}") for name in names)
    return sorted(found, reverse=True)[:most]


def _slots(thing: object) -> list[str]:
    return [
        name if not name.startswith("__") else f"_{kind.__name__.lstrip('_')}{name}"
        for kind in type(thing).__mro__
        for name in getattr(kind, "__slots__", ())
    ]
