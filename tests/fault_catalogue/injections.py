"""The start and the end of each fault of the catalogue, in simulated time."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link import protocol
from flying_vines.config import config
from flying_vines.core.events import LinkChanged, VehicleMessage
from flying_vines.simulation.phlosar.mishaps import (
    Blocked,
    Drifting,
    Gain,
    Glitching,
    Hanging,
    Hole,
    HoseOff,
    Kinked,
    MishapKind,
    Noisy,
    Open,
    Shorted,
    Stuck,
    StuckAt,
    Unpowered,
)
from flying_vines.simulation.simulated_world import Wire, perfect
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mission.item import AutopilotKind as AutopilotKind

from .watched import RESTED_S, Watched

Act = Callable[[Watched], None]
During = Callable[[Watched, float], None]


def nothing(flight: Watched) -> None:
    """No action: nothing begins the fault, or nothing ends it."""


@dataclass(frozen=True)
class Injection:
    """The fault begins in a phase of the flight: while the vine is inflated to its highest pressure, held
    there, or vented. It ends `lasts_s` later."""

    begin: Act
    end: Act = nothing
    lasts_s: float = 3.0
    phase: Literal["inflating", "held", "vented"] = "inflating"
    during: During = Watched.run
    kind: AutopilotKind = "ardupilot"
    rc: bool = True
    reservoir_kPa: float = 690.0
    rested_s: float = RESTED_S
    """Time in the air before the bend, for checks that compare a leak with the pressure at rest."""
    tables: Mapping[str, object] = field(default_factory=dict)


# The vehicle.


def fly_on(flight: Watched) -> None:
    flight.take_off()
    flight.run(4.0)


def without(message_id: int) -> Wire:
    """A wire that loses one type of MAVLink message."""
    return lambda frame: b"" if int.from_bytes(frame[7:10], "little") == message_id else frame


def lose_altitude(flight: Watched) -> None:
    flight.flight.from_autopilot = without(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)


def restore_vehicle_link(flight: Watched) -> None:
    flight.flight.from_autopilot = perfect


def disarm(flight: Watched) -> None:
    """Disarm, as in a crash. The altitude messages stop before, so only HEARTBEAT shows that it is
    disarmed."""
    lose_altitude(flight)
    flight.autopilot.disarm()


def arm_again(flight: Watched) -> None:
    restore_vehicle_link(flight)
    fly_on(flight)


def close_vehicle_link(flight: Watched) -> None:
    flight.flight.from_autopilot = cut
    flight.feed(LinkChanged(flight.now_s, "vehicle", False, "closed"))


def open_vehicle_link(flight: Watched) -> None:
    restore_vehicle_link(flight)
    flight.feed(LinkChanged(flight.now_s, "vehicle", True))


def run_with_a_second_autopilot(flight: Watched, seconds: float) -> None:
    """A second autopilot, disarmed on the ground, moves its switch. It must not begin or end a bend."""
    other = MavlinkCodec(2, mavlink.MAV_COMP_ID_AUTOPILOT1)
    ours = MavlinkCodec(1, 191)
    for i in range(round(seconds / 0.1)):
        us = 1000 if i % 20 < 10 else 2000
        heartbeat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 3, 3
        )
        channels = mavlink.MAVLink_rc_channels_message(0, 16, *[us] * 18, 255)
        for message in (heartbeat, channels):
            for received in ours.decode(other.encode(message, 2)):
                flight.feed(VehicleMessage(flight.now_s, received))
        flight.run(0.1)


# The serial line.


def cut(data: bytes) -> bytes:
    return b""


def corrupting(share: float, seed: int) -> Wire:
    """A wire that damages one byte in this share of all frames."""
    chance = random.Random(seed)

    def damaged(frame: bytes) -> bytes:
        if not frame or chance.random() >= share:
            return frame
        at = chance.randrange(len(frame))
        return frame[:at] + bytes([frame[at] ^ chance.randrange(1, 256)]) + frame[at + 1 :]

    return lambda data: b"\0".join(damaged(frame) for frame in data.split(b"\0"))


def corrupt(share: float) -> Act:
    def begin(flight: Watched) -> None:
        flight.flight.world.to_phlosar = corrupting(share, seed=1)
        flight.flight.world.from_phlosar = corrupting(share, seed=2)

    return begin


def restore_serial(flight: Watched) -> None:
    flight.flight.world.to_phlosar = flight.flight.world.from_phlosar = perfect


def unplug(flight: Watched) -> None:
    flight.flight.world.to_phlosar = flight.flight.world.from_phlosar = cut
    flight.feed(LinkChanged(flight.now_s, "firmware", False, "unplugged"))


def plug_in(flight: Watched) -> None:
    restore_serial(flight)
    flight.feed(LinkChanged(flight.now_s, "firmware", True))


def lose_commands(flight: Watched) -> None:
    flight.flight.world.to_phlosar = cut


def lose_telemetry(flight: Watched) -> None:
    flight.flight.world.from_phlosar = cut


def rewriting(change: Callable[[protocol.Message], protocol.Message]) -> Wire:
    """A wire that changes the board's messages."""
    decoder, encoder = protocol.Codec(), protocol.Codec()
    return lambda data: b"".join(encoder.encode(change(message)) for message in decoder.decode(data))


def reflash(flight: Watched) -> None:
    """The board restarts with firmware of another version."""

    def of_another_version(message: protocol.Message) -> protocol.Message:
        if isinstance(message, protocol.Welcome):
            return dataclasses.replace(message, protocol_version=protocol.PROTOCOL_VERSION + 1)
        return message

    flight.flight.world.from_phlosar = rewriting(of_another_version)
    flight.phlosar.reset_firmware()


def jump_board_clock(by_ms: int) -> Act:
    def later(message: protocol.Message) -> protocol.Message:
        if isinstance(message, protocol.Telemetry):
            return dataclasses.replace(message, device_time_ms=(message.device_time_ms + by_ms) % (1 << 32))
        return message

    def begin(flight: Watched) -> None:
        flight.flight.world.from_phlosar = rewriting(later)

    return begin


def repeat_one_frame(flight: Watched) -> None:
    """The line repeats the same telemetry."""
    first: list[protocol.Message] = []

    def again(message: protocol.Message) -> protocol.Message:
        if not isinstance(message, protocol.Telemetry):
            return message
        first.append(message)
        return first[0]

    flight.flight.world.from_phlosar = rewriting(again)


def regulate_on(flight: Watched) -> None:
    """The board always reports that it regulates."""

    def regulating(message: protocol.Message) -> protocol.Message:
        if isinstance(message, protocol.Telemetry):
            return dataclasses.replace(message, mode=protocol.Mode.REGULATE)
        return message

    flight.flight.world.from_phlosar = rewriting(regulating)


def send_impossible_pressure(flight: Watched) -> None:
    def absurd(message: protocol.Message) -> protocol.Message:
        if isinstance(message, protocol.Telemetry):
            return dataclasses.replace(message, cv_kPa=1e30)
        return message

    flight.flight.world.from_phlosar = rewriting(absurd)


def restart_often(flight: Watched, seconds: float) -> None:
    """The board's supply fails ten times a second."""
    for _ in range(round(seconds / 0.1)):
        flight.phlosar.reset_firmware()
        flight.run(0.1)


def stall(flight: Watched, seconds: float) -> None:
    flight.take(flight.flight.stall(flight.now_s + seconds))


# The hardware.


def hardware(
    place: str,
    kind: MishapKind,
    phase: Literal["inflating", "held", "vented"] = "inflating",
    lasts_s: float = 3.0,
    during: During = Watched.run,
    rested_s: float = RESTED_S,
    repair: Act | None = None,
) -> Injection:
    """An injection of a mishap, and its repair."""
    return Injection(
        lambda flight: flight.phlosar.inject(place, kind),
        repair or (lambda flight: flight.phlosar.inject(place, None)),
        lasts_s,
        phase,
        during,
        rested_s=rested_s,
    )


def straighten(flight: Watched, seconds: float) -> None:
    """The pilot straightens the vine as soon as the fault has begun."""
    flight.straighten()
    flight.run(seconds)


def wave(flight: Watched, seconds: float) -> None:
    """The pilot bends the vine up and down."""
    for _ in range(round(seconds / 2.0)):
        flight.straighten()
        flight.run(1.0)
        flight.bend_full()
        flight.run(1.0)


def new_reservoir(flight: Watched) -> None:
    flight.phlosar.inject("reservoir", None)
    flight.phlosar.fill(690.0)


def bend(flight: Watched, seconds: float) -> None:
    """The pilot tries to bend the vine."""
    flight.bend_full()
    flight.run(seconds)


INJECTIONS: dict[str, Injection] = {
    "rc_lost": Injection(lambda f: f.autopilot.lose_rc(), lambda f: f.autopilot.return_rc(), kind="px4"),
    "rc_frozen": Injection(lambda f: f.autopilot.lose_rc("frozen"), lambda f: f.autopilot.return_rc()),
    "rc_jumps": Injection(lambda f: f.autopilot.lose_rc("jump"), lambda f: f.autopilot.return_rc()),
    "rc_frozen_untold": Injection(
        nothing, lasts_s=10.5, tables={"limits": config.LimitsConfig(max_bent_s=10.0)}
    ),
    "autopilot_silent": Injection(lambda f: f.autopilot.mute(5.0), lasts_s=5.0),
    "autopilot_silent_without_rc": Injection(lambda f: f.autopilot.mute(5.0), lasts_s=5.0, rc=False),
    "autopilot_rebooted": Injection(lambda f: f.autopilot.reboot(), fly_on, lasts_s=8.0),
    "vehicle_link_closed": Injection(close_vehicle_link, open_vehicle_link),
    "second_autopilot": Injection(nothing, during=run_with_a_second_autopilot),
    "disarmed": Injection(disarm, arm_again, lasts_s=1.5),
    "altitude_unknown": Injection(lose_altitude, restore_vehicle_link),
    "serial_unplugged": Injection(unplug, plug_in),
    "commands_lost": Injection(lose_commands, restore_serial),
    "commands_lost_at_rest": Injection(lose_commands, restore_serial, phase="vented", during=bend),
    "telemetry_lost": Injection(lose_telemetry, restore_serial),
    "frames_corrupted": Injection(corrupt(0.2), restore_serial),
    "line_all_noise": Injection(corrupt(1.0), restore_serial),
    "board_reset": Injection(lambda f: f.phlosar.reset_firmware()),
    "board_watchdog": Injection(lambda f: f.phlosar.reset_firmware(watchdog=True)),
    "board_of_another_version": Injection(reflash, restore_serial),
    "board_clock_back": Injection(jump_board_clock(-3000), restore_serial),
    "board_repeats": Injection(repeat_one_frame, restore_serial),
    "board_regulates_on": Injection(regulate_on, restore_serial, phase="held", during=straighten),
    "board_restarts_often": Injection(nothing, lambda f: f.run(8.0), lasts_s=5.0, during=restart_often),
    "board_clock_ahead": Injection(jump_board_clock(3_600_000)),
    "telemetry_absurd": Injection(send_impossible_pressure, restore_serial),
    "companion_stutters": Injection(nothing, during=stall, lasts_s=0.2),
    "companion_stalled": Injection(nothing, during=stall, lasts_s=2.0),
    "board_hangs": hardware("board", Hanging()),
    "board_unpowered": hardware("board", Unpowered()),
    "vine_over_pressure": hardware("cv_sensor", Gain(2.0), "held"),
    "vine_sensor_stuck": hardware("cv_sensor", Stuck()),
    "vine_sensor_stuck_held": hardware("cv_sensor", Stuck(), "held", during=straighten),
    "vine_sensor_drifts_up": hardware("cv_sensor", Drifting(4.0), "held", 10.0),
    "vine_sensor_drifts_down": hardware("cv_sensor", Drifting(-4.0), "held", 10.0),
    "vine_sensor_off_at_rest": hardware("cv_sensor", Drifting(2.0), "vented", 6.0),
    "vine_sensor_open": hardware("cv_sensor", Open()),
    "vine_sensor_shorted": hardware("cv_sensor", Shorted()),
    "vine_sensor_noisy": hardware("cv_sensor", Noisy(5.0)),
    "vine_sensor_glitches": hardware("cv_sensor", Glitching(200.0, 100.0)),
    "reservoir_sensor_stuck": hardware(
        "reservoir_sensor", Stuck(), lasts_s=12.0, during=wave, repair=nothing
    ),
    "reservoir_sensor_drifts": hardware("reservoir_sensor", Drifting(-20.0), "held"),
    "reservoir_sensor_open": hardware("reservoir_sensor", Open()),
    "reservoir_sensor_shorted": hardware("reservoir_sensor", Shorted()),
    "evp_stuck_open": hardware("evp", StuckAt(1.0)),
    "evp_stuck_open_vented": hardware("evp", StuckAt(1.0), "vented"),
    "evp_stuck_ajar": hardware("evp", StuckAt(0.3), "held", 10.0),
    "evp_stuck_closed": hardware("evp", StuckAt(0.0)),
    "dvp_stuck_open": hardware("dvp", StuckAt(1.0), "held"),
    "dvp_stuck_closed": hardware("dvp", StuckAt(0.0), "held", during=straighten),
    "venturi_blocked": hardware("venturi", Blocked(), "held", during=straighten),
    "solenoid_stuck_closed": hardware("solenoid", StuckAt(0.0), "held", during=straighten),
    "solenoid_stuck_open": hardware("solenoid", StuckAt(1.0), "held", 10.0),
    "hose_off": hardware("hose", HoseOff()),
    "hose_off_held": hardware("hose", HoseOff(), "held"),
    "hose_kinked": hardware("hose", Kinked()),
    "hose_kinked_held": hardware("hose", Kinked(), "held", during=straighten),
    "actuator_burst": hardware("actuator", Hole(5.0)),
    "actuator_burst_held": hardware("actuator", Hole(5.0), "held"),
    "actuator_leaks": hardware("actuator", Hole(0.5), "held", 12.0, rested_s=12.0),
    "reservoir_leaks": hardware("reservoir", Hole(0.5), "held", 10.0),
    "reservoir_bursts": hardware("reservoir", Hole(5.0), "held", repair=new_reservoir),
    "reservoir_low": Injection(
        nothing, lambda f: f.phlosar.fill(690.0), phase="vented", during=bend, reservoir_kPa=58.0
    ),
    "reservoir_emptied": Injection(lambda f: f.phlosar.fill(30.0), lambda f: f.phlosar.fill(690.0)),
    "reservoir_over_pressure": Injection(lambda f: f.phlosar.fill(800.0), lambda f: f.phlosar.fill(690.0)),
    "reservoir_hot": Injection(lambda f: f.phlosar.heat_reservoir(40.0), lambda f: f.phlosar.fill(690.0)),
}
