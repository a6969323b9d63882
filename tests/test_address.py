"""Where a link goes: every form, and everything that is none."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.find import UsbBoard
from flying_vines.address import FORMS, Address, NetworkAddress, SerialAddress, parse_address


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("serial:/dev/ttyACM0", SerialAddress("/dev/ttyACM0", 115200)),
        ("serial:/dev/ttyAMA0:921600", SerialAddress("/dev/ttyAMA0", 921600)),
        ("serial:COM7:57600", SerialAddress("COM7", 57600)),
        (
            "serial:/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0",
            SerialAddress("/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0", 115200),
        ),
        ("usb:16c0:0483", UsbBoard(0x16C0, 0x0483)),
        ("usb:16C0:0483:1234560", UsbBoard(0x16C0, 0x0483, "1234560")),
        ("udpin:0.0.0.0:14540", NetworkAddress("udpin", "0.0.0.0", 14540)),
        ("udp::14550", None),
        ("udp:0.0.0.0:14550", NetworkAddress("udpin", "0.0.0.0", 14550)),
        ("udpout:10.0.0.1:1", NetworkAddress("udpout", "10.0.0.1", 1)),
        ("tcp:drone.local:65535", NetworkAddress("tcp", "drone.local", 65535)),
        ("tcp:::1:5760", NetworkAddress("tcp", "::1", 5760)),
    ],
)
def test_every_form(text: str, address: Address | None) -> None:
    if address is None:
        with pytest.raises(ValueError, match="is no link"):
            parse_address(text)
    else:
        assert parse_address(text) == address


@pytest.mark.parametrize(
    "text",
    [
        "", ":", "serial", "serial:", "/dev/ttyACM0", "tcp", "tcp:", "tcp:host", "tcp:host:", "tcp::5760",
        "tcp:host:0", "tcp:host:65536", "tcp:host:-1", "tcp:host:+5", "tcp:host:5760 ", "tcp:host:5_760",
        "tcp:host:²", "tcp:host:" + "9" * 5000, "udpin:5760", "TCP:host:5760", "tcpin:host:5760", "http:a:80",
    ],
)  # fmt: skip
def test_what_is_no_link_gives_a_sentence_with_the_forms(text: str) -> None:
    with pytest.raises(ValueError, match="is no link: give ") as caught:
        parse_address(text)
    assert FORMS in str(caught.value)


@pytest.mark.parametrize("text", ["usb:", "usb:teensy", "usb:16c0", "usb:16c0:483", "usb:16c0:0483:a:b"])
def test_what_is_no_board_gives_a_sentence(text: str) -> None:
    with pytest.raises(ValueError, match="is no board: give usb:VENDOR"):
        parse_address(text)


texts = st.one_of(
    st.text(),
    st.from_regex(r"(serial|udpin|udpout|tcp):[^:]*(:[^:]*)?", fullmatch=True),
    st.from_regex(r"usb:[0-9a-f]{3,5}:[0-9a-f]{4}(:[^:]*)?", fullmatch=True),
)


@given(texts)
def test_any_text_is_a_link_or_is_refused_with_a_sentence(text: str) -> None:
    try:
        address = parse_address(text)
    except ValueError as error:
        assert "is no link" in str(error) or "is no board" in str(error)
        return
    if isinstance(address, SerialAddress):
        assert address.baud > 0
        assert address.path
    elif isinstance(address, UsbBoard):
        assert parse_address(str(address)) == address
    else:
        assert 0 < address.port < 65536
        assert address.host
