"""Valid MAVLink messages of every type with random content, random bytes, and hostile firmware messages."""

from __future__ import annotations

import math
import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from random_frames import (
    AUTOPILOT,
    COMMANDS,
    FLOOD,
    KINDS,
    STATION,
    RandomFrames,
    largest_tables,
    serving_vehicle_1,
)

from firmware_link import protocol
from flying_vines.config import config
from flying_vines.core.core import Core
from flying_vines.core.events import (
    Action,
    Event,
    FirmwareMessage,
    LinkChanged,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.simulation.simulated_world import SimulatedWorld
from flying_vines.vehicle.mavlink.codec import MavlinkCodec

MESSAGES = 16_000
ODD_FLOATS = [float("nan"), float("inf"), float("-inf"), 3e38, -1.0, 0.0, 1.0]
MOST_SENT_HZ = 2 / 0.02
"""Two frames every 20 ms: the capacity of the smallest forward buffer of the autopilots."""
LARGEST_TABLE = 5001
"""Maximum number of stored mission items; all other tables are much smaller."""


def setpoints(actions: list[Action]) -> list[protocol.Setpoint]:
    messages = [action.message for action in actions if isinstance(action, ToFirmware)]
    return [message for message in messages if isinstance(message, protocol.Setpoint)]


def sent(actions: list[Action], out: MavlinkCodec) -> int:
    """Number of frames to the vehicle. Checks that each can be encoded."""
    frames = [out.encode(a.message, a.system_id) for a in actions if isinstance(a, ToVehicle)]
    assert all(frames)
    return len(frames)


def test_while_the_phlosar_is_not_ready_no_message_moves_anything() -> None:
    frames, core = RandomFrames(20), Core(serving_vehicle_1())
    codec, out = MavlinkCodec(0, 191), MavlinkCodec(0, 191)
    core.handle(LinkChanged(0.0, "firmware", True))
    decoded = 0
    for i in range(MESSAGES):
        t = i * 0.004
        data = frames.frame() if i % 20 else frames.noise() + frames.frame() + frames.alive()
        events: list[Event] = [VehicleMessage(t, message) for message in codec.decode(data)]
        decoded += len(events)
        for event in [*events, Tick(t)]:
            actions = core.handle(event)
            sent(actions, out)
            assert setpoints(actions) == []
    assert decoded > 0.8 * MESSAGES
    assert core.snapshot(MESSAGES * 0.004).doing == "not known"
    assert largest_tables(core)[0][0] <= LARGEST_TABLE
    assert largest_tables(codec)[0][0] <= LARGEST_TABLE


def test_while_the_vehicle_is_disarmed_no_message_moves_anything() -> None:
    frames, world, codec = (
        RandomFrames(21, disarmed=True),
        SimulatedWorld(serving_vehicle_1()),
        MavlinkCodec(0, 191),
    )
    ready = False
    for i in range(MESSAGES // 2):
        t = i * 0.002
        actions = list(world.advance(t))
        for message in codec.decode(frames.frame() + (b"" if i % 250 else frames.alive())):
            actions.extend(world.feed(VehicleMessage(t, message)))
        assert [setpoint for setpoint in setpoints(actions) if setpoint.target_kPa != 0.0] == []
        ready = ready or world.core.snapshot(t).firmware == "ready"
    assert ready
    assert world.core.snapshot(1.0).vehicle.endswith(" 1")


def test_every_movement_stays_within_the_limits() -> None:
    frames, world, codec = RandomFrames(22), SimulatedWorld(serving_vehicle_1()), MavlinkCodec(0, 191)
    autopilot, station = MavlinkCodec(1, 1), MavlinkCodec(*STATION)
    limits = config.default().limits
    moved = 0
    for i in range(MESSAGES // 2):
        t = i * 0.002
        actions = list(world.advance(t))
        kinds = COMMANDS if i % 4 == 1 else KINDS
        data = frames.frame(kinds, AUTOPILOT if i % 100 == 0 else STATION)
        if i % 100 == 50:  # between the random messages, those of a flying autopilot
            data += autopilot.encode(mavlink.MAVLink_heartbeat_message(2, 3, 217, 4, 4, 3), 1)
            place = mavlink.MAVLink_global_position_int_message(round(t * 1000), 0, 0, 0, 10_000, 0, 0, 0, 0)
            data += autopilot.encode(place, 1)
            # A random command may have disarmed the pneumatics.
            data += station.encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 255)
            arm = mavlink.MAVLink_command_long_message(1, 191, mavlink.MAV_CMD_USER_4, 0, 3, 0, 0, 0, 0, 0, 0)
            data += station.encode(arm, 255)
        for message in codec.decode(data):
            actions.extend(world.feed(VehicleMessage(t, message)))
        for setpoint in setpoints(actions):
            moved += setpoint.target_kPa > 0.0
            assert 0.0 <= setpoint.target_kPa <= limits.max_kPa + 1e-6
            assert 0.0 < setpoint.rate_kPa_per_s <= limits.max_rate_kPa_per_s + 1e-6
    assert moved > 50


@pytest.mark.parametrize("sender", [AUTOPILOT, (255, 190), None])
def test_a_flood_of_requests_gets_few_answers_and_stores_few(sender: tuple[int, int] | None) -> None:
    frames, core, codec, out = (
        RandomFrames(23),
        Core(serving_vehicle_1()),
        MavlinkCodec(0, 191),
        MavlinkCodec(0, 191),
    )
    answers, received, seconds = 0, 0, 4.0
    heartbeat = [kind for kind in KINDS if kind.id == 0]
    for i in range(round(seconds * 2000)):
        t = i / 2000
        frame = frames.frame(heartbeat, AUTOPILOT) if i % 2000 == 0 else frames.frame(FLOOD, sender)
        events: list[Event] = [VehicleMessage(t, message) for message in codec.decode(frame)]
        received += len(events)
        for event in events if i % 40 else [*events, Tick(t)]:
            answers += sent(core.handle(event), out)
    assert received > 0.9 * seconds * 2000
    assert answers <= MOST_SENT_HZ * seconds
    assert largest_tables(core)[0][0] <= LARGEST_TABLE


def test_absurd_telemetry_moves_nothing() -> None:
    dice = random.Random(3)
    core = Core(serving_vehicle_1())
    core.handle(LinkChanged(0.0, "firmware", True))

    def odd() -> float:
        return dice.choice([*ODD_FLOATS, dice.uniform(-1e3, 1e3)])

    for i in range(5_000):
        t = i * 0.01
        nonce = dice.choice((1, dice.getrandbits(32)))
        welcome = protocol.Welcome(1, nonce, dice.randrange(3), "x", 1, odd(), odd(), odd(), odd(), 300, 100)
        telemetry = protocol.Telemetry(
            dice.getrandbits(32), protocol.Mode.VENT, protocol.Fault(dice.getrandbits(16)), 0,
            odd(), odd(), odd(), 0.0, 0.0, False,
        )  # fmt: skip
        for message in (welcome, telemetry):
            assert setpoints(core.handle(FirmwareMessage(t, message))) == []
        core.handle(Tick(t))
    assert core.snapshot(50.0).doing == "not known"
    assert math.isfinite(core.snapshot(50.0).command_kPa)
