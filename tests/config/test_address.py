"""Addresses of links: every valid form, and the errors of invalid ones."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.find import UsbBoard
from flying_vines.config.address import (
    FORMS,
    Address,
    NetworkAddress,
    SerialAddress,
    parse_address,
    who_can_command,
)


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
        ("udpin:0.0.0.0:14540?peer=192.168.4.1", NetworkAddress("udpin", "0.0.0.0", 14540, "192.168.4.1")),
        ("udpin::::14540?peer=fe80::1", NetworkAddress("udpin", "::", 14540, "fe80::1")),
        ("udp::14550", None),
        ("udp:0.0.0.0:14550", NetworkAddress("udpin", "0.0.0.0", 14550)),
        ("udpout:10.0.0.1:1", NetworkAddress("udpout", "10.0.0.1", 1)),
        ("tcp:drone.local:65535", NetworkAddress("tcp", "drone.local", 65535)),
        ("tcp:::1:5760", NetworkAddress("tcp", "::1", 5760)),
        ("tcp:[::1]:5760", NetworkAddress("tcp", "::1", 5760)),
        ("tcp:[fe80::1%eth0]:5760", NetworkAddress("tcp", "fe80::1%eth0", 5760)),
        ("udpin:[::]:14540?peer=[fe80::1]", NetworkAddress("udpin", "::", 14540, "fe80::1")),
    ],
)
def test_every_form(text: str, address: Address | None) -> None:
    if address is None:
        with pytest.raises(ValueError, match="is not a link"):
            parse_address(text)
    else:
        assert parse_address(text) == address


@pytest.mark.parametrize(
    "text",
    [
        "", ":", "serial", "serial:", "/dev/ttyACM0", "tcp", "tcp:", "tcp:host", "tcp:host:", "tcp::5760",
        "tcp:host:0", "tcp:host:65536", "tcp:host:-1", "tcp:host:+5", "tcp:host:5_760",
        "udpout:10.0.0.1:1?peer=10.0.0.1", "tcp:host:1?peer=10.0.0.1", "udpin:0.0.0.0?peer=1.2.3.4:1",
        "tcp:host:²", "tcp:host:" + "9" * 5000, "udpin:5760", "TCP:host:5760", "tcpin:host:5760", "http:a:80",
        "tcp:[::1]", "tcp:::1", "tcp:2001:db8::1", "tcp:[::1:5760", "tcp:[host]:5760", "tcp:[127.0.0.1]:5760",
        "tcp:a:b:5760", "tcp:a b:5760",
    ],
)  # fmt: skip
def test_an_invalid_link_gives_a_sentence_with_the_valid_forms(text: str) -> None:
    with pytest.raises(ValueError, match="is not a link: give ") as caught:
        parse_address(text)
    assert FORMS in str(caught.value)


@pytest.mark.parametrize(
    "query", ["", "peer", "peer=", "peer=drone.local", "peer=0.0.0.0", "peer=1.2.3.4/24", "x=1"]
)
def test_an_invalid_peer_gives_a_sentence(query: str) -> None:
    with pytest.raises(ValueError, match="is not a peer: give its IP address, as in "):
        parse_address(f"udpin:0.0.0.0:14540?{query}")


@pytest.mark.parametrize(
    ("text", "is_open"),
    [
        ("udpin:127.0.0.1:14540", False),
        ("udpin:127.0.0.9:14540", False),
        ("udpin:localhost:14540", False),
        ("udpin:::1:14540", False),
        ("udpin:0.0.0.0:14540", True),
        ("udpin::::14540", True),
        ("udpin:192.168.4.2:14540", True),
        ("udpin:drone.local:14540", True),
        ("udpin:0.0.0.0:14540?peer=192.168.4.1", False),
        ("udpout:192.168.4.1:14540", False),
        ("tcp:192.168.4.1:5760", False),
    ],
)
def test_which_links_are_open_to_anybody(text: str, is_open: bool) -> None:
    address = parse_address(text)
    assert isinstance(address, NetworkAddress)
    assert address.is_open == is_open


@pytest.mark.parametrize(
    ("text", "signed", "said"),
    [
        ("serial:/dev/ttyAMA0", False, "unsigned: every sender on this port can command the vine"),
        ("udpin:127.0.0.1:1", False, "unsigned: every program on this computer can command the vine"),
        ("udpin:0.0.0.0:1", False, "unsigned: anybody on the network can command the vine"),
        (
            "udpin:0.0.0.0:1?peer=10.0.0.7",
            False,
            "unsigned: everybody who sends from 10.0.0.7 or forges this address can command the vine",
        ),
        (
            "tcp:10.0.0.7:1",
            False,
            "unsigned: everybody who sends from 10.0.0.7 or forges this address can command the vine",
        ),
        ("udpin:0.0.0.0:1", True, "signed: only those who have the key can command the vine"),
    ],
)
def test_who_can_command_is_one_line(text: str, signed: bool, said: str) -> None:
    assert who_can_command(parse_address(text), signed) == said


def test_an_ipv6_socket_writes_ipv4_addresses_in_its_own_way() -> None:
    address = parse_address("udpin::::14540?peer=192.168.4.1")
    assert isinstance(address, NetworkAddress)
    assert address.reads("::ffff:192.168.4.1") and not address.reads("::ffff:192.168.4.2")


@pytest.mark.parametrize("text", ["usb:", "usb:teensy", "usb:16c0", "usb:16c0:483", "usb:16c0:0483:a:b"])
def test_an_invalid_board_gives_a_sentence(text: str) -> None:
    with pytest.raises(ValueError, match="is not a USB board: give usb:VENDOR"):
        parse_address(text)


@pytest.mark.parametrize(
    ("text", "bare"),
    [
        ("serial:/dev/ttyAMA0:921600 ", "serial:/dev/ttyAMA0:921600"),
        ("serial:/dev/ttyAMA0 ", "serial:/dev/ttyAMA0"),
        (" udpin: 127.0.0.1:14550", "udpin:127.0.0.1:14550"),
        ("tcp:host:5760 ", "tcp:host:5760"),
    ],
)
def test_spaces_are_named_with_what_to_write(text: str, bare: str) -> None:
    with pytest.raises(ValueError, match=f"has spaces: write {bare}$"):
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
        assert any(
            what in str(error)
            for what in (
                "is not a link",
                "is not a USB board",
                "is not a peer",
                "is no baud",
                "is no device",
                "has spaces",
            )
        )
        return
    if isinstance(address, SerialAddress):
        assert address.baud > 0
        assert address.path
    elif isinstance(address, UsbBoard):
        assert parse_address(str(address)) == address
    else:
        assert 0 < address.port < 65536
        assert address.host
