"""A computer at the USB port of the chip that `chip.py` models: it does one transaction at a time."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import TypeVar

import pytest

from .chip import STALL, USB0_ADDR, USB0_BDTPAGE, USB0_ENDPT0, USBRST, Chip

_OUT, _IN, _SETUP = 0x1, 0x9, 0xD
"""Tokens."""

Found = TypeVar("Found")


class Stalled(Exception):
    """The chip answered STALL."""


class UsbHost:
    """The other end of the cable."""

    def __init__(self, chip: Chip) -> None:
        self.chip = chip
        self._in_data1 = self._out_data1 = False

    def enumerate(self) -> str:
        """As a computer does it; the serial number."""
        self._reset()
        assert len(self.read(0x80, 6, 0x0100, length=64)) == 18
        self._reset()
        self.write(0x00, 5, 17)
        assert self.chip.registers[USB0_ADDR] == 17
        with pytest.raises(Stalled):
            self.read(0x80, 6, 0x0600, length=10)
        assert len(self.read(0x80, 6, 0x0200, length=67)) == 67
        number = self.read(0x80, 6, 0x0303, 0x0409)[2:].decode("utf-16-le")
        self.write(0x00, 9, 1)
        self._in_data1 = self._out_data1 = False
        self.write(0x21, 0x20, data=struct.pack("<IBBB", 115200, 0, 0, 8))
        self.write(0x21, 0x22, 3)
        return number

    def restart_in(self) -> None:
        """CLEAR_FEATURE(ENDPOINT_HALT)."""
        self.write(0x02, 1, 0, 0x83)
        self._in_data1 = False

    def read(self, kind: int, request: int, value: int = 0, index: int = 0, length: int = 255) -> bytes:
        self._setup(struct.pack("<BBHHH", kind, request, value, index, length))
        data, data1 = b"", True
        while True:
            packet = self._wait(lambda: self._in(0))
            assert packet[1] == data1
            data, data1 = data + packet[0], not data1
            if len(packet[0]) < 64 or len(data) == length:
                break
        self._wait(lambda: self._out(0, b"", True) or None)
        self.chip.run(0.3)
        return data

    def write(self, kind: int, request: int, value: int = 0, index: int = 0, data: bytes = b"") -> None:
        self._setup(struct.pack("<BBHHH", kind, request, value, index, len(data)))
        if data:
            self._wait(lambda: self._out(0, data, True) or None)
        assert self._wait(lambda: self._in(0)) == (b"", True)
        self.chip.run(0.3)

    def receive(self) -> bytes:
        """The next packet of the port, or nothing."""
        packet = self._in(3)
        if packet is None:
            return b""
        assert packet[1] == self._in_data1, "the same packet twice"
        self._in_data1 = not self._in_data1
        return packet[0]

    def send(self, data: bytes) -> None:
        for at in range(0, len(data), 64):
            self._wait(lambda at=at: self._out(2, data[at : at + 64], self._out_data1) or None)  # type: ignore[misc]
            self._out_data1 = not self._out_data1

    def _reset(self) -> None:
        self.chip.status_queue.clear()
        self.chip.turns.clear()
        self.chip.interrupts |= USBRST
        self.chip.run(1)

    def _wait(self, attempt: Callable[[], Found | None], ms: float = 100) -> Found:
        end_us = self.chip.now_us + 1000 * ms
        while self.chip.now_us < end_us:
            found = attempt()
            if found is not None:
                return found
            self.chip.run(0.1)
        raise TimeoutError("the chip does not answer")

    def _setup(self, packet: bytes) -> None:
        self._wait(lambda: self._to_chip(0, _SETUP, packet, None) or None)
        self.chip.setup_waits = True

    def _out(self, endpoint: int, packet: bytes, data1: bool) -> bool:
        self._may_stall(endpoint)
        return not self.chip.setup_waits and self._to_chip(endpoint, _OUT, packet, data1)

    def _in(self, endpoint: int) -> tuple[bytes, bool] | None:
        """A packet and whether it is DATA1; None is NAK."""
        self._may_stall(endpoint)
        word, address = self._descriptor(endpoint, True)
        if self.chip.setup_waits or not word & 0x80 or len(self.chip.status_queue) == 4:
            return None
        size = word >> 16 & 0x3FF
        data = bytes(self.chip.uc.mem_read(address, size))
        self._give_back(endpoint, True, _IN, size)
        return data, word & 0x40 != 0

    def _to_chip(self, endpoint: int, token: int, packet: bytes, data1: bool | None) -> bool:
        word, address = self._descriptor(endpoint, False)
        if not word & 0x80 or len(self.chip.status_queue) == 4:
            return False
        assert len(packet) <= word >> 16 & 0x3FF
        assert data1 is None or (word & 0x40 != 0) == data1, "the chip would drop it as a repetition"
        self.chip.uc.mem_write(address, packet)
        self._give_back(endpoint, False, token, len(packet))
        return True

    def _may_stall(self, endpoint: int) -> None:
        if self.chip.registers.get(USB0_ENDPT0 + 4 * endpoint, 0) & 0x02:
            self.chip.interrupts |= STALL
            self.chip.run(0.3)
            raise Stalled

    def _descriptor(self, endpoint: int, to_host: bool) -> tuple[int, int]:
        word, address = struct.unpack("<II", self.chip.uc.mem_read(self._at(endpoint, to_host), 8))
        return word, address

    def _give_back(self, endpoint: int, to_host: bool, token: int, size: int) -> None:
        key = (endpoint, to_host)
        turn = self.chip.turns.get(key, 0)
        self.chip.uc.mem_write(self._at(endpoint, to_host), struct.pack("<I", size << 16 | token << 2))
        self.chip.status_queue.append(endpoint << 4 | to_host << 3 | turn << 2)
        self.chip.turns[key] = turn ^ 1

    def _at(self, endpoint: int, to_host: bool) -> int:
        table = sum(self.chip.registers[page] << 8 * (i + 1) for i, page in enumerate(USB0_BDTPAGE))
        return table + 8 * (endpoint << 2 | to_host << 1 | self.chip.turns.get((endpoint, to_host), 0))
