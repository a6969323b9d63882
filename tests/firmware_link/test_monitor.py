"""The monitor reads every byte and never sends a command."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from firmware_link.framing import FRAME_END, encode_frame
from firmware_link.host import FirmwareReset, Ready, SessionState
from firmware_link.monitor import Monitor, SeenFrame, Tap
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    Codec,
    Fault,
    GetSetting,
    Hello,
    Message,
    Mode,
    Ping,
    Pong,
    Setpoint,
    Telemetry,
    Vent,
    Welcome,
)
from firmware_link.settings import SettingsExchange
from flying_vines.simulation.phlosar.firmware import Firmware


def watch(monitor: Monitor, firmware: Firmware, for_ms: int, began_ms: int = 0) -> list[SeenFrame]:
    """Run both on a perfect line."""
    seen = []
    for ms in range(began_ms, began_ms + for_ms):
        firmware.step(ms * 1000, 0.0, 690.0)
        seen += monitor.receive(ms / 1e3, firmware.take_output())[0]
        if ms % 10 == 0:
            data, sent = monitor.tick(ms / 1e3)
            seen += sent
            firmware.receive(data)
    return seen


def sent_kinds(seen: list[SeenFrame]) -> set[type[Message]]:
    return {type(each.message) for each in seen if each.sent and each.message is not None}


def test_it_greets_and_pings_and_no_more() -> None:
    monitor, firmware = Monitor(), Firmware()
    monitor.opened(0.0)
    seen = watch(monitor, firmware, 3000)
    assert monitor.session.state is SessionState.READY
    assert sent_kinds(seen) == {Hello, Ping}
    assert firmware.number == 0
    came = [type(each.message) for each in seen if not each.sent]
    assert set(came) == {Welcome, Telemetry, Pong}
    assert came.count(Telemetry) == 300
    now = monitor.statistics(3.0, 0)
    assert (now.good_frames, now.bad_frames, now.lost_frames, now.telemetry_gaps) == (len(came), 0, 0, 0)


def test_it_leaves_what_is_latched() -> None:
    monitor, firmware = Monitor(), Firmware()
    firmware.reset(watchdog=True)
    monitor.opened(0.0)
    watch(monitor, firmware, 1000)
    assert firmware.faults == Fault.WATCHDOG_RESET


def test_a_hello_vents_a_board_without_commands() -> None:
    monitor, firmware = Monitor(), Firmware()
    firmware.step(0, 5.0, 690.0)
    other = Codec()
    firmware.receive(other.encode(Hello(PROTOCOL_VERSION, 9)))
    other.decode(firmware.take_output())
    firmware.receive(other.encode(Setpoint(9.0, 50.0, 250, 1)))
    assert firmware.number == 1
    monitor.opened(0.0)
    watch(monitor, firmware, 50, began_ms=1)
    assert firmware.mode is Mode.VENT
    assert not firmware.faults


def test_settings_are_asked_for_once_it_is_ready() -> None:
    exchange = SettingsExchange()
    monitor, firmware = Monitor(exchange), Firmware()
    monitor.opened(0.0)
    seen = watch(monitor, firmware, 3000)
    assert exchange.done
    assert sent_kinds(seen) == {Hello, Ping, GetSetting}


def test_events_come_with_what_they_are_read_from() -> None:
    monitor, firmware = Monitor(), Firmware()
    monitor.opened(0.0)
    firmware.step(0, 0.0, 690.0)
    firmware.receive(monitor.tick(0.0)[0])
    _, events = monitor.receive(0.001, firmware.take_output())
    assert [type(event) for event in events][-1] is Ready
    firmware.step(500_000, 0.0, 690.0)
    monitor.receive(0.5, firmware.take_output())
    firmware.reset()
    firmware.step(501_000, 0.0, 690.0)
    _, events = monitor.receive(0.501, firmware.take_output())
    assert [type(event) for event in events] == [FirmwareReset]


def test_every_frame_is_seen_good_or_not() -> None:
    good = Codec().encode(Vent(3))
    data = good + b"\x05abc\x00" + encode_frame(b"\x70\x01") + FRAME_END + b"\xff" * 300 + FRAME_END + good
    seen = Tap(sent=False).read(1.5, data)
    assert [each.message for each in seen] == [Vent(3), None, None, None, Vent(3)]
    assert [each.problem.partition(",")[0] for each in seen] == [
        "",
        "not a frame",
        f"message type 0x70 is not known to version {PROTOCOL_VERSION}",
        "not a frame",
        "",
    ]
    assert seen[0].wire + FRAME_END == good
    assert {each.t for each in seen} == {1.5}


@given(st.lists(st.binary(max_size=80)))
def test_any_bytes_are_survived(pieces: list[bytes]) -> None:
    monitor = Monitor()
    monitor.opened(0.0)
    for at, data in enumerate(pieces):
        seen, _ = monitor.receive(at / 10, data)
        assert all(each.wire is not None for each in seen)
    assert monitor.statistics(9.0, 0).received_bytes == sum(map(len, pieces))
