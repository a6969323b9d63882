"""Host and firmware on lines with losses, errors, copies and cuts: always safe, and quickly back."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from faulty_line import CLEAN, Exchange, Faults
from hypothesis import given, settings
from hypothesis import strategies as st
from wrapped_board import WrappedBoard

from firmware_link.host import (
    VENTING,
    FirmwareReset,
    HostEvent,
    Incompatible,
    SessionState,
    TelemetryReceived,
)
from firmware_link.protocol import PROTOCOL_VERSION, Codec, Fault, Mode, Welcome
from flying_vines.simulation.phlosar.firmware import Firmware

HELLO_MS = 500
REPEAT_MS = 20
TELEMETRY_MS = 10
WAY_MS = 2
"""Round trip on a clean line, one millisecond each way."""

often = st.floats(0.0, 0.5)
lines = st.builds(
    Faults,
    lost=often,
    corrupted=often,
    duplicated=often,
    swapped=often,
    truncated=often,
    garbage=often,
    delay_ms=st.integers(0, 30),
    bytewise=st.booleans(),
)
seeds = st.integers(0, 2**32)

# One damaged frame in 65536 has the right CRC by chance. Derandomized, so that this does not happen.
derandomized = settings(derandomize=True, max_examples=150)


def ready(seed: int = 1) -> Exchange:
    """A conversation on a clean line, with nothing latched."""
    exchange = Exchange(CLEAN, seed)
    exchange.run_until_ready(100)
    exchange.run(50)
    return exchange


def over(exchange: Exchange) -> None:
    """The line is good again, and all damaged frames have arrived."""
    exchange.clean()
    exchange.run(40)


@derandomized
@given(lines, seeds, st.lists(st.floats(0.0, 25.0), min_size=1, max_size=6))
def test_on_any_line_nothing_moves_without_a_command(faults: Faults, seed: int, targets: list[float]) -> None:
    exchange = Exchange(faults, seed)
    for target_kPa in targets:
        exchange.run(200)
        exchange.command(target_kPa)
    exchange.send(exchange.session.command(exchange.t, VENTING))
    over(exchange)
    exchange.run_until_ready(HELLO_MS + 2 * exchange.to_host.faults.delay_ms + 60)
    exchange.run(REPEAT_MS + WAY_MS + TELEMETRY_MS)
    assert exchange.firmware.mode is not Mode.REGULATE


@derandomized
@given(lines, seeds)
def test_when_the_line_is_good_again_so_is_the_link(faults: Faults, seed: int) -> None:
    exchange = ready(seed)
    exchange.to_device.faults = exchange.to_host.faults = faults
    exchange.command(10.0)
    exchange.run(300)
    over(exchange)
    exchange.run_until_ready(HELLO_MS + WAY_MS + 10)
    exchange.send(exchange.session.clear_faults(exchange.t, Fault(0xFFFF)))
    exchange.run(WAY_MS)
    exchange.command(12.0)
    exchange.run(REPEAT_MS + 10 + WAY_MS)
    assert exchange.in_step
    assert exchange.firmware.mode is Mode.REGULATE
    assert exchange.session.telemetry is not None
    assert exchange.session.telemetry_age(exchange.t) <= (TELEMETRY_MS + WAY_MS) / 1e3


garbage = st.binary(min_size=1, max_size=400)


@derandomized
@given(garbage, garbage, seeds)
def test_garbage_costs_one_frame_and_a_command_gets_through_with_its_repeat(
    to_device: bytes, to_host: bytes, seed: int
) -> None:
    exchange = ready(seed)
    exchange.to_device.send(exchange.now_ms, to_device)
    exchange.to_host.send(exchange.now_ms, to_host)
    exchange.run(WAY_MS)
    began_ms, lost_before = exchange.now_ms, exchange.codec.lost_frames
    exchange.command(10.0)
    exchange.run(REPEAT_MS + 10 + WAY_MS)
    assert exchange.in_step
    came = [ms for ms, event in exchange.events if isinstance(event, TelemetryReceived) and ms > began_ms]
    # The frame after the garbage may be lost; the next one is read.
    assert came[0] - began_ms <= 2 * TELEMETRY_MS
    assert exchange.codec.lost_frames - lost_before <= 1
    assert exchange.session.telemetry_gaps <= 1


def test_every_frame_that_is_lost_is_counted() -> None:
    exchange = ready()
    good_before, sent_before = exchange.codec.good_frames, exchange.frames_sent
    exchange.to_host.faults = Faults(lost=0.3)
    exchange.run(3000)
    over(exchange)
    sent = exchange.frames_sent - sent_before
    lost = sent - (exchange.codec.good_frames - good_before)
    assert lost == pytest.approx(0.3 * sent, rel=0.2)
    assert exchange.codec.lost_frames == lost
    # Three of the lost frames were pongs, not telemetry.
    assert lost - 3 <= exchange.session.telemetry_gaps <= lost


def test_telemetry_that_was_overtaken_is_no_reset() -> None:
    exchange = ready()
    exchange.run(200)
    exchange.command(10.0)
    exchange.to_host.faults = Faults(swapped=0.5)
    exchange.run(2000)
    assert not [event for _, event in exchange.events if isinstance(event, FirmwareReset)]
    assert exchange.firmware.mode is Mode.REGULATE


def test_a_setpoint_outlives_eleven_lost_repeats_and_no_more() -> None:
    exchange = ready()
    exchange.command(10.0)
    exchange.run(100)
    exchange.to_device.faults = Faults(lost=1.0)
    exchange.run(220)
    assert exchange.firmware.mode is Mode.REGULATE
    exchange.run(50)
    assert exchange.firmware.faults == Fault.DEAD_MAN


def test_one_byte_at_a_time_is_as_good_as_all_at_once() -> None:
    slow, quick = (Exchange(Faults(bytewise=bytewise)) for bytewise in (True, False))
    for exchange in (slow, quick):
        exchange.run_until_ready(100)
        exchange.command(10.0)
        exchange.run(1000)
    assert slow.events == quick.events
    assert slow.codec.bad_frames == 0


def test_a_restart_on_a_bad_line_ends_in_vent_and_ready() -> None:
    for seed in range(20):
        exchange = ready(seed)
        exchange.run(random.Random(seed).randint(100, 400))
        exchange.command(10.0)
        exchange.run(50)
        exchange.to_device.faults = exchange.to_host.faults = Faults(lost=0.3, corrupted=0.1)
        exchange.firmware.reset()
        exchange.run(400)
        over(exchange)
        exchange.run_until_ready(HELLO_MS + WAY_MS + 10)
        exchange.run(100)
        assert _resets(exchange) >= 1, seed
        assert exchange.in_step
        assert exchange.firmware.mode is Mode.VENT


def _resets(exchange: Exchange) -> int:
    events: list[HostEvent] = [event for _, event in exchange.events]
    return sum(isinstance(event, FirmwareReset) for event in events)


class OlderFirmware(WrappedBoard):
    """Reports the previous protocol version."""

    def __init__(self) -> None:
        super().__init__(Firmware())
        self._decoder, self._encoder = Codec(), Codec()

    def take_output(self) -> bytes:
        said = b""
        for message in self._decoder.decode(super().take_output()):
            if isinstance(message, Welcome):
                message = replace(message, protocol_version=PROTOCOL_VERSION - 1)
            said += self._encoder.encode(message)
        return said


def test_a_peer_of_another_version_is_never_commanded_and_taken_once_it_is_flashed() -> None:
    exchange = Exchange(Faults(lost=0.2, corrupted=0.2), board=OlderFirmware())
    exchange.run(3000)
    assert exchange.session.state is SessionState.INCOMPATIBLE
    exchange.command(10.0)
    exchange.run(200)
    assert exchange.firmware.number == 0
    assert [type(event) for _, event in exchange.events] == [Incompatible]
    exchange.firmware = Firmware(boot_id=2)
    over(exchange)
    exchange.run_until_ready(HELLO_MS + WAY_MS + 10)
