"""A board is found by its USB id, and a missing one gives one sentence."""

from __future__ import annotations

import pytest
from serial.tools import list_ports_common

from firmware_link import find
from firmware_link.find import BoardNotFoundError, UsbBoard

TEENSY = UsbBoard(0x16C0, 0x0483)


def port(
    device: str, vid: int | None = None, pid: int | None = None, number: str | None = None, product: str = ""
) -> list_ports_common.ListPortInfo:
    there = list_ports_common.ListPortInfo(device)
    there.vid, there.pid, there.serial_number, there.product = vid, pid, number, product
    return there


CONSOLE = port("/dev/ttyS0")
GPS = port("/dev/ttyACM0", 0x1546, 0x01A8, None, "u-blox GNSS receiver")
ONE = port("/dev/ttyACM1", 0x16C0, 0x0483, "1234560", "USB Serial")
TWO = port("/dev/ttyACM2", 0x16C0, 0x0483, "7654320", "USB Serial")


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("usb:16c0:0483", TEENSY),
        ("usb:16C0:0483:1234560", UsbBoard(0x16C0, 0x0483, "1234560")),
        ("USB:0403:6001:A-b_9", UsbBoard(0x0403, 0x6001, "A-b_9")),
    ],
)
def test_a_board_is_written_as_lsusb_writes_it(text: str, board: UsbBoard) -> None:
    assert UsbBoard.parse(text) == board
    assert UsbBoard.parse(str(board)) == board


@pytest.mark.parametrize(
    "text", ["usb:", "usb:16c0", "usb:16c0:", "usb:16c0:483", "usb:16c0:0483:", "16c0:0483"]
)
def test_an_invalid_board_gets_a_sentence(text: str) -> None:
    with pytest.raises(ValueError, match="is not a USB board: give usb:VENDOR:PRODUCT"):
        UsbBoard.parse(text)


def test_it_is_found_wherever_it_is() -> None:
    assert TEENSY.find(lambda: [CONSOLE, GPS, ONE]) == "/dev/ttyACM1"
    assert UsbBoard(0x16C0, 0x0483, "7654320").find(lambda: [GPS, ONE, TWO]) == "/dev/ttyACM2"


def test_of_two_equal_ones_none_is_taken() -> None:
    with pytest.raises(BoardNotFoundError) as told:
        TEENSY.find(lambda: [TWO, ONE, GPS])
    assert str(told.value) == (
        "usb:16c0:0483 matches 2 ports: /dev/ttyACM1 (usb:16c0:0483, USB Serial, serial number 1234560), "
        "/dev/ttyACM2 (usb:16c0:0483, USB Serial, serial number 7654320); "
        "add the serial number of the right one, as in usb:16c0:0483:1234560"
    )


def test_two_boards_without_different_serial_numbers() -> None:
    nameless = [port(f"/dev/ttyUSB{at}", 0x1A86, 0x7523) for at in range(2)]
    with pytest.raises(BoardNotFoundError, match="by-path"):
        UsbBoard(0x1A86, 0x7523).find(lambda: nameless)


def test_other_boards_are_reported() -> None:
    with pytest.raises(BoardNotFoundError) as told:
        UsbBoard(0x16C0, 0x0483, "99").find(lambda: [GPS, ONE, CONSOLE])
    assert str(told.value) == (
        "usb:16c0:0483:99 is not there: is the board plugged in, powered and flashed? Present: "
        "/dev/ttyACM0 (usb:1546:01a8, u-blox GNSS receiver), "
        "/dev/ttyACM1 (usb:16c0:0483, USB Serial, serial number 1234560), /dev/ttyS0"
    )
    with pytest.raises(BoardNotFoundError, match="no serial port"):
        TEENSY.find(list)


def test_a_board_that_is_pulled_out_while_it_is_read_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    def stumble() -> list[list_ports_common.ListPortInfo]:
        raise TypeError("int() can't convert non-string with explicit base")

    monkeypatch.setattr(find, "comports", stumble)
    with pytest.raises(BoardNotFoundError):
        TEENSY.find()


def test_this_machines_ports_can_be_read() -> None:
    with pytest.raises(BoardNotFoundError):
        UsbBoard(0xFFFF, 0xFFFF, "nobody").find()
