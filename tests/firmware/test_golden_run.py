"""The core repeats the golden run on this computer, and the run covers what it should."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest

from firmware_link.framing import FrameDecoder
from firmware_link.protocol import (
    ClearFaults,
    DeviceMessage,
    Fault,
    GetSetting,
    Hello,
    Message,
    Mode,
    Ping,
    Pong,
    ProtocolError,
    Refusal,
    RefusalReason,
    Setpoint,
    SetSetting,
    Setting,
    Telemetry,
    Vent,
    Welcome,
    decode,
)

from .golden_frames import VECTORS, answers_in, frames, of_host_frame, to_device_frame
from .golden_run import FULL_EVP_DUTY, GOLDEN_RUN, Part, PowerUp, difference, on_host, read, write

PARTS = read()
STEPS = [(step, done) for part in PARTS for step, done in zip(part.steps, part.done, strict=True)]


def messages_in(data: bytes) -> list[Message]:
    messages = []
    for payload in FrameDecoder().feed(data):
        try:
            messages.append(decode(payload)[0])
        except ProtocolError:
            continue
    return messages


def telemetry() -> list[Telemetry]:
    return [m for _, done in STEPS for m in messages_in(done.sent) if isinstance(m, Telemetry)]


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_the_core_does_on_this_machine_what_it_did(part: Part) -> None:
    assert difference(part, on_host(part.inputs)) == ""


@pytest.mark.parametrize("vector", VECTORS["frames"], ids=lambda vector: vector["message"])
def test_a_board_answers_the_hosts_golden_frames_and_sends_the_devices(vector: dict[str, str]) -> None:
    frame = bytes.fromhex(vector["frame_hex"])
    is_hosts = vector["message"] not in {
        kind.__name__ for kind in (Welcome, Telemetry, Refusal, Pong, Setting)
    }
    conversation = of_host_frame(frame) if is_hosts else to_device_frame(frame)
    if conversation is None:
        assert vector["message"] in ("Telemetry", "Setting")
        return
    *_, done = on_host(conversation.inputs)
    assert frames(answers_in(done)) == frames(conversation.answers)


def test_it_is_some_thousand_steps_in_less_than_200_kB() -> None:
    assert 5_000 < len(STEPS) < 20_000
    assert GOLDEN_RUN.stat().st_size < 200_000


def test_it_reaches_every_mode_and_every_fault() -> None:
    assert {done.mode for _, done in STEPS} == set(Mode)
    assert {fault for fault in Fault for _, done in STEPS if fault & done.faults} == set(Fault)


def test_it_reaches_every_message_and_every_refusal() -> None:
    said = [message for step, _ in STEPS for message in messages_in(step.received)]
    assert {type(m) for m in said} >= {Hello, Setpoint, Vent, ClearFaults, Ping, GetSetting, SetSetting}
    told = [message for _, done in STEPS for message in messages_in(done.sent)]
    assert {type(m) for m in told} == set(DeviceMessage.__args__)
    assert {m.reason for m in told if isinstance(m, Refusal)} == set(RefusalReason)


def test_it_reaches_all_that_the_valves_do() -> None:
    # Far from the setpoint, near it, without and with the Venturi, and the safe state.
    regulated = [done for _, done in STEPS if done.mode == Mode.REGULATE]
    evp = [done.evp_duty for done in regulated]
    assert evp.count(FULL_EVP_DUTY) > 20 and sum(0 < duty < FULL_EVP_DUTY for duty in evp) > 500
    outlets = {(done.dvp_duty > 0, done.solenoid) for done in regulated}
    assert outlets == {(False, False), (False, True), (True, True)}
    vented = [done for _, done in STEPS if done.mode != Mode.REGULATE]
    assert {(done.evp_duty, done.solenoid) for done in vented} == {(0, True)}
    # Above the limit the Venturi helps.
    helped = [done for done in vented if done.dvp_duty]
    assert 10 < len(helped) < len(vented) / 2
    assert all(Fault.CV_OVERPRESSURE in Fault(done.faults) for done in helped)


def test_it_reaches_odd_times() -> None:
    """The clock wraps while regulating, steps are late, and telemetry falls on every possible step."""
    pairs = [pair for part in PARTS for pair in itertools.pairwise(part.steps)]
    assert any(b.now_us < a.now_us for a, b in pairs)
    assert max((b.now_us - a.now_us) & 0xFFFFFFFF for a, b in pairs) > 300_000
    times = [message.device_time_ms for message in telemetry()]
    assert sum(b - a == 1 for a, b in itertools.pairwise(times)) > 400
    assert sum(b - a == 10 for a, b in itertools.pairwise(times)) > 400


def test_it_reaches_what_boards_keep() -> None:
    power_ups = [one for part in PARTS for one in part.inputs if isinstance(one, PowerUp)]
    assert {one.by_watchdog for one in power_ups} == {False, True}
    assert any(done.kept for _, done in STEPS)
    assert {len(one.stored) for one in power_ups} >= {0, 1, 81, 82}


def test_a_difference_is_found_and_named() -> None:
    part = next(part for part in PARTS if part.name == "inflation")
    changed = list(part.done)
    changed[17] = changed[17]._replace(evp_duty=changed[17].evp_duty + 1)
    told = difference(part, changed)
    assert re.fullmatch(r"inflation, step 17 Step\(.*: evp_duty is \d+, in the golden run \d+", told)
    assert difference(part, changed[:17]) == f"inflation: 17 steps, in the golden run {len(part.done)}"


def test_a_written_run_is_read_back(tmp_path: Path) -> None:
    write(tmp_path / "copy", PARTS)
    assert read(tmp_path / "copy") == PARTS
