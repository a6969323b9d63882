"""The firmware's USB serial port, enumerated: a host made of the USB 2.0 and CDC specifications."""

from __future__ import annotations

import ctypes
import random
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from .native import FIRMWARE, library

KL26 = FIRMWARE / "boards" / "kl26"

PACKET = 64
GET_STATUS, CLEAR_FEATURE, SET_FEATURE, SET_ADDRESS, GET_DESCRIPTOR = 0, 1, 3, 5, 6
GET_CONFIGURATION, SET_CONFIGURATION, GET_INTERFACE, SET_INTERFACE = 8, 9, 10, 11
SET_LINE_CODING, GET_LINE_CODING, SET_CONTROL_LINE_STATE, SEND_BREAK = 0x20, 0x21, 0x22, 0x23
DEVICE, CONFIGURATION, STRING, QUALIFIER = 0x0100, 0x0200, 0x0300, 0x0600
NOTIFY, OUT, IN = 0x81, 0x02, 0x83

DEVICE_DESCRIPTOR = bytes.fromhex("12 01 0002 02 00 00 40 C016 8304 0001 01 02 03 01")
CONFIGURATION_DESCRIPTOR = bytes.fromhex(
    "09 02 4300 02 01 00 80 32"
    "09 04 00 00 01 02 02 01 00"
    "05 24 00 1001"
    "05 24 01 00 01"
    "04 24 02 02"
    "05 24 06 00 01"
    "07 05 81 03 1000 40"
    "09 04 01 00 02 0A 00 00 00"
    "07 05 02 02 4000 00"
    "07 05 83 02 4000 00"
)


@pytest.fixture(scope="module")
def usb(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    built = library(
        tmp_path_factory.mktemp("usb"), Path(__file__).with_name("usb_shim.cpp"), KL26 / "usb_control.cpp"
    )
    built.usb_create.restype = ctypes.c_void_p
    for name in ("stalled", "configured", "port_open", "halted", "take_restart", "bootloader_asked"):
        getattr(built, f"usb_{name}").restype = ctypes.c_bool
    built.usb_address.restype = ctypes.c_uint8
    return built


class Stalled(Exception):
    """The device answered STALL."""


class Host:
    """Does whole control transfers, and holds the device to what the specification says of each packet."""

    def __init__(self, usb: ctypes.CDLL, serial_number: int = 1234560) -> None:
        self._usb = usb
        self._device = ctypes.c_void_p(usb.usb_create(ctypes.c_uint32(serial_number)))
        usb.usb_reset(self._device)

    def close(self) -> None:
        self._usb.usb_destroy(self._device)

    def reset(self) -> None:
        self._usb.usb_reset(self._device)

    def setup(self, packet: bytes) -> None:
        self._usb.usb_setup(self._device, packet, len(packet))

    def out(self, packet: bytes) -> None:
        self._usb.usb_out(self._device, packet, len(packet))

    def take_in(self) -> tuple[bytes, bool] | None:
        """A packet that the device would send, and whether it is DATA1. It is not acknowledged yet."""
        buffer = ctypes.create_string_buffer(PACKET)
        size = self._usb.usb_next_in(self._device, buffer)
        return None if size < 0 else (buffer.raw[: size & 0xFF], size >= 256)

    def acknowledge(self) -> None:
        self._usb.usb_in_done(self._device)

    @property
    def stalled(self) -> bool:
        return bool(self._usb.usb_stalled(self._device))

    @property
    def address(self) -> int:
        return int(self._usb.usb_address(self._device))

    @property
    def configured(self) -> bool:
        return bool(self._usb.usb_configured(self._device))

    @property
    def port_open(self) -> bool:
        return bool(self._usb.usb_port_open(self._device))

    @property
    def bootloader_asked(self) -> bool:
        return bool(self._usb.usb_bootloader_asked(self._device))

    def halted(self, endpoint: int) -> bool:
        return bool(self._usb.usb_halted(self._device, endpoint & 0x7F))

    def restarts(self) -> set[int]:
        """The endpoints that are to begin again at DATA0, each told once."""
        numbers = (n for n in (1, 2, 3) if self._usb.usb_take_restart(self._device, n))
        return set(numbers)

    def read(self, kind: int, request: int, value: int = 0, index: int = 0, length: int = 255) -> bytes:
        self.setup(struct.pack("<BBHHH", kind, request, value, index, length))
        data, expected_data1 = b"", True
        while True:
            if self.stalled:
                self._usb.usb_stall_sent(self._device)
                raise Stalled
            taken = self.take_in()
            assert taken is not None, "the device has nothing to say in its data stage"
            packet, data1 = taken
            assert data1 == expected_data1
            expected_data1 = not expected_data1
            data += packet
            self.acknowledge()
            assert len(data) <= length
            if len(packet) < PACKET or len(data) == length:
                break
        assert self.take_in() is None
        self.out(b"")
        assert not self.stalled
        return data

    def write(self, kind: int, request: int, value: int = 0, index: int = 0, data: bytes = b"") -> None:
        self.setup(struct.pack("<BBHHH", kind, request, value, index, len(data)))
        if data and not self.stalled:
            assert self.take_in() is None, "the status stage comes after the data"
            self.out(data)
        if self.stalled:
            self._usb.usb_stall_sent(self._device)
            raise Stalled
        assert self.take_in() == (b"", True), "the status of a request is an empty DATA1 packet"
        self.acknowledge()

    def enumerate(self) -> None:
        self.write(0x00, SET_ADDRESS, 9)
        self.write(0x00, SET_CONFIGURATION, 1)
        self.restarts()


@pytest.fixture
def host(usb: ctypes.CDLL) -> Iterator[Host]:
    one = Host(usb)
    yield one
    one.close()


def text_of(descriptor: bytes) -> str:
    assert descriptor[:2] == bytes([len(descriptor), 3])
    return descriptor[2:].decode("utf-16-le")


def test_enumeration_as_linux_does_it(host: Host) -> None:
    assert host.read(0x80, GET_DESCRIPTOR, DEVICE, length=64) == DEVICE_DESCRIPTOR
    host.reset()
    host.write(0x00, SET_ADDRESS, 9)
    assert host.address == 9
    assert host.read(0x80, GET_DESCRIPTOR, DEVICE, length=18) == DEVICE_DESCRIPTOR
    with pytest.raises(Stalled):
        host.read(0x80, GET_DESCRIPTOR, QUALIFIER, length=10)  # only of a high-speed device
    assert host.read(0x80, GET_DESCRIPTOR, CONFIGURATION, length=9) == CONFIGURATION_DESCRIPTOR[:9]
    whole = host.read(0x80, GET_DESCRIPTOR, CONFIGURATION, length=67)
    assert whole == CONFIGURATION_DESCRIPTOR
    assert host.read(0x80, GET_DESCRIPTOR, STRING) == bytes.fromhex("04 03 0904")
    assert text_of(host.read(0x80, GET_DESCRIPTOR, STRING | 1, 0x0409)) == "Flying Vines"
    assert text_of(host.read(0x80, GET_DESCRIPTOR, STRING | 2, 0x0409)) == "phloSAR"
    assert text_of(host.read(0x80, GET_DESCRIPTOR, STRING | 3, 0x0409)) == "1234560"
    assert not host.configured
    host.write(0x00, SET_CONFIGURATION, 1)
    assert host.configured
    assert host.restarts() == {1, 2, 3}
    host.write(0x21, SET_LINE_CODING, data=bytes.fromhex("00C20100 00 00 08"))
    host.write(0x21, SET_CONTROL_LINE_STATE, 3)
    assert host.port_open


def test_the_configuration_descriptor_is_of_one_piece() -> None:
    """Each descriptor's first byte is its length; together they are as long as the first one says."""
    at, kinds = 0, []
    while at < len(CONFIGURATION_DESCRIPTOR):
        kinds.append(CONFIGURATION_DESCRIPTOR[at + 1])
        at += CONFIGURATION_DESCRIPTOR[at]
    assert at == len(CONFIGURATION_DESCRIPTOR) == int.from_bytes(CONFIGURATION_DESCRIPTOR[2:4], "little")
    assert kinds == [2, 4, 0x24, 0x24, 0x24, 0x24, 5, 4, 5, 5]


def test_an_address_counts_only_after_its_status_stage(host: Host) -> None:
    host.setup(struct.pack("<BBHHH", 0x00, SET_ADDRESS, 77, 0, 0))
    assert host.address == 0
    assert host.take_in() == (b"", True)
    assert host.address == 0
    host.acknowledge()
    assert host.address == 77


def test_an_address_is_forgotten_when_another_setup_comes_first(host: Host) -> None:
    host.setup(struct.pack("<BBHHH", 0x00, SET_ADDRESS, 77, 0, 0))
    assert host.read(0x80, GET_DESCRIPTOR, DEVICE, length=18) == DEVICE_DESCRIPTOR
    host.write(0x00, SET_CONFIGURATION, 1)
    assert host.address == 0


@pytest.mark.parametrize("length", [1, 8, 17, 18, 19, 64, 255, 0xFFFF])
def test_never_more_than_was_asked_for(host: Host, length: int) -> None:
    assert host.read(0x80, GET_DESCRIPTOR, DEVICE, length=length) == DEVICE_DESCRIPTOR[:length]
    whole = host.read(0x80, GET_DESCRIPTOR, CONFIGURATION, length=length)
    assert whole == CONFIGURATION_DESCRIPTOR[:length]


def test_a_reading_of_nothing_has_a_status_stage_alone(host: Host) -> None:
    host.setup(struct.pack("<BBHHH", 0x80, GET_DESCRIPTOR, DEVICE, 0, 0))
    assert host.take_in() == (b"", True)


def test_a_host_may_end_a_data_stage_early(host: Host) -> None:
    host.setup(struct.pack("<BBHHH", 0x80, GET_DESCRIPTOR, CONFIGURATION, 0, 67))
    assert host.take_in() == (CONFIGURATION_DESCRIPTOR[:64], True)
    host.acknowledge()
    host.out(b"")
    assert host.take_in() is None
    assert host.read(0x80, GET_CONFIGURATION, length=1) == b"\x00"


def test_status_of_device_interfaces_and_endpoints(host: Host) -> None:
    assert host.read(0x80, GET_STATUS, length=2) == b"\x00\x00"
    assert host.read(0x82, GET_STATUS, index=0x80, length=2) == b"\x00\x00"
    with pytest.raises(Stalled):
        host.read(0x81, GET_STATUS, index=0, length=2)  # there is none before the configuration
    host.enumerate()
    assert host.read(0x80, GET_CONFIGURATION, length=1) == b"\x01"
    assert host.read(0x81, GET_STATUS, index=1, length=2) == b"\x00\x00"
    assert host.read(0x81, GET_INTERFACE, index=1, length=1) == b"\x00"
    host.write(0x01, SET_INTERFACE, 0, 1)
    assert host.restarts() == {2, 3}
    with pytest.raises(Stalled):
        host.write(0x01, SET_INTERFACE, 1, 1)


@pytest.mark.parametrize("endpoint", [NOTIFY, OUT, IN])
def test_an_endpoint_is_halted_and_begins_again_at_data0(host: Host, endpoint: int) -> None:
    host.enumerate()
    host.write(0x02, SET_FEATURE, 0, endpoint)
    assert host.halted(endpoint)
    assert [e for e in (NOTIFY, OUT, IN) if host.halted(e)] == [endpoint]
    assert host.read(0x82, GET_STATUS, index=endpoint, length=2) == b"\x01\x00"
    assert host.restarts() == set()
    host.write(0x02, CLEAR_FEATURE, 0, endpoint)
    assert not host.halted(endpoint)
    assert host.restarts() == {endpoint & 0x7F}
    # Also of one that is not halted (USB 2.0, 9.4.5).
    host.write(0x02, CLEAR_FEATURE, 0, endpoint)
    assert host.restarts() == {endpoint & 0x7F}


def test_line_coding_is_kept_and_told(host: Host) -> None:
    host.enumerate()
    assert host.read(0xA1, GET_LINE_CODING, length=7) == struct.pack("<IBBB", 115200, 0, 0, 8)
    coding = struct.pack("<IBBB", 57600, 0, 0, 8)
    host.write(0x21, SET_LINE_CODING, data=coding)
    assert host.read(0xA1, GET_LINE_CODING, length=7) == coding
    assert not host.bootloader_asked
    host.write(0x21, SET_LINE_CODING, data=struct.pack("<IBBB", 134, 0, 0, 8))
    assert host.bootloader_asked


def test_a_port_is_open_while_dtr_is_on(host: Host) -> None:
    host.enumerate()
    assert not host.port_open
    host.write(0x21, SET_CONTROL_LINE_STATE, 0b10)  # RTS alone
    assert not host.port_open
    host.write(0x21, SET_CONTROL_LINE_STATE, 0b11)
    assert host.port_open
    host.write(0x00, SET_CONFIGURATION, 0)
    assert not host.port_open


def test_a_reset_of_the_bus_forgets_all_but_the_line_coding(host: Host) -> None:
    host.enumerate()
    host.write(0x21, SET_CONTROL_LINE_STATE, 3)
    host.write(0x02, SET_FEATURE, 0, IN)
    host.reset()
    assert (host.address, host.configured, host.port_open, host.halted(IN)) == (0, False, False, False)
    assert host.restarts() == {1, 2, 3}


@pytest.mark.parametrize(
    "packet",
    [
        b"",
        b"\x80\x06\x00",
        struct.pack("<BBHHH", 0x80, GET_DESCRIPTOR, DEVICE, 0, 18) + b"\x00",
        struct.pack("<BBHHH", 0x80, GET_DESCRIPTOR, 0x0400, 0, 9),  # INTERFACE cannot be asked for by itself
        struct.pack("<BBHHH", 0x80, GET_DESCRIPTOR, STRING | 4, 0x0409, 255),
        struct.pack("<BBHHH", 0x80, GET_DESCRIPTOR, CONFIGURATION | 1, 0, 255),
        struct.pack("<BBHHH", 0x00, SET_ADDRESS, 128, 0, 0),
        struct.pack("<BBHHH", 0x00, SET_CONFIGURATION, 2, 0, 0),
        struct.pack("<BBHHH", 0x00, SET_CONFIGURATION, 1, 0, 1),
        struct.pack("<BBHHH", 0x00, SET_FEATURE, 1, 0, 0),  # remote wake-up
        struct.pack("<BBHHH", 0x02, SET_FEATURE, 0, 0x84, 0),
        struct.pack("<BBHHH", 0x02, SET_FEATURE, 0, 0x03, 0),  # of an IN endpoint, as if it were OUT
        struct.pack("<BBHHH", 0x82, 12, 0, IN, 2),  # SYNCH_FRAME
        struct.pack("<BBHHH", 0x21, SET_LINE_CODING, 0, 0, 6),
        struct.pack("<BBHHH", 0x21, SET_LINE_CODING, 0, 1, 7),
        struct.pack("<BBHHH", 0x21, SEND_BREAK, 0xFFFF, 0, 0),  # not among its capabilities
        struct.pack("<BBHHH", 0xC0, 1, 0, 0, 16),  # a vendor's
        struct.pack("<BBHHH", 0xFF, 0xFF, 0xFFFF, 0xFFFF, 0xFFFF),
    ],
)
def test_what_is_not_understood_is_stalled_and_changes_nothing(host: Host, packet: bytes) -> None:
    host.enumerate()
    host.setup(packet)
    assert host.stalled
    assert host.take_in() is None
    assert (host.address, host.configured, host.restarts()) == (9, True, set())
    assert host.read(0x80, GET_DESCRIPTOR, DEVICE, length=18) == DEVICE_DESCRIPTOR


def test_line_coding_of_a_wrong_size_is_stalled(host: Host) -> None:
    host.enumerate()
    for size in (0, 6, 8, 64):
        host.setup(struct.pack("<BBHHH", 0x21, SET_LINE_CODING, 0, 0, 7))
        host.out(bytes(size))
        assert host.stalled
    assert host.read(0xA1, GET_LINE_CODING, length=7) == struct.pack("<IBBB", 115200, 0, 0, 8)


@pytest.mark.parametrize("number", [0, 9, 10, 1234560, 2**32 - 1])
def test_any_serial_number_has_its_string(usb: ctypes.CDLL, number: int) -> None:
    host = Host(usb, number)
    assert text_of(host.read(0x80, GET_DESCRIPTOR, STRING | 3, 0x0409)) == str(number)
    host.close()


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32))
def test_nothing_that_a_host_sends_wedges_it(usb: ctypes.CDLL, seed: int) -> None:
    """The library is built to end the process at undefined behaviour."""
    random_of = random.Random(seed)
    host = Host(usb)
    for _ in range(60):
        match random_of.randrange(6):
            case 0 | 1:
                kind = random_of.choice(
                    [0x00, 0x80, 0x01, 0x81, 0x02, 0x82, 0x21, 0xA1, random_of.randrange(256)]
                )
                request = random_of.choice([*range(13), 0x20, 0x21, 0x22, 0x23, random_of.randrange(256)])
                value = random_of.choice([0, 1, 0x100, 0x200, 0x301, 0x303, random_of.randrange(65536)])
                index = random_of.choice([0, 1, 0x81, 0x02, 0x83, 0x0409, random_of.randrange(65536)])
                length = random_of.choice([0, 1, 2, 7, 64, 67, 65535])
                host.setup(struct.pack("<BBHHH", kind, request, value, index, length))
            case 2:
                host.setup(random_of.randbytes(random_of.choice([0, 7, 8, 9, 64])))
            case 3:
                host.out(random_of.randbytes(random_of.choice([0, 7, 64])))
            case 4:
                host.acknowledge()
            case _:
                taken = host.take_in()
                assert taken is None or len(taken[0]) <= PACKET
    host.reset()
    assert host.read(0x80, GET_DESCRIPTOR, DEVICE, length=64) == DEVICE_DESCRIPTOR
    host.enumerate()
    assert host.configured
    host.close()
