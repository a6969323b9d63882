"""What the doctor derives from messages: rates, silences, times of its requests, and readings at rest."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.config import config
from flying_vines.doctor.firmware import FirmwareFacts, with_readings
from flying_vines.doctor.vehicle_probe import SETTLE_S, VehicleProbe
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.radio.rc import RC_BIT


class Feed:
    """A probe, and an autopilot's messages for it."""

    def __init__(self) -> None:
        self.probe = VehicleProbe(config.default())
        self._decoder = MavlinkCodec(0, 0)
        self._out = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)

    def take(self, t: float, message: Any) -> None:
        self._out.seq = (self._out.seq + 1) % 256
        for received in self._decoder.decode(message.pack(self._out)):
            self.probe.take(t, 1_795_000_000.0 + t, received)

    def heartbeat(self, t: float, autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA) -> None:
        self.take(t, mavlink.MAVLink_heartbeat_message(2, autopilot, 0, 5, 4, 3))

    def rc(self, t: float, pulse_us: int) -> None:
        channels = [1500, 1500, 1100, 1500, 1500, 1500, 1500, 1500, pulse_us, *[0] * 9]
        self.take(t, mavlink.MAVLink_rc_channels_message(0, 16, *channels, 200))

    def stream_Hz(self, t: float, name: str) -> float:
        (stream,) = [stream for stream in self.probe.facts(t).streams if stream.name == name]
        return stream.rate_Hz


def test_a_rate_is_that_of_the_stream_once_it_has_settled() -> None:
    feed = Feed()
    feed.heartbeat(0.0)
    for i in range(15):
        feed.rc(0.1 * i, 1000)  # before anybody requested another rate
    for i in range(25):
        feed.rc(SETTLE_S + 0.2 * i, 1000)
    assert feed.stream_Hz(SETTLE_S + 4.8, "RC_CHANNELS") == pytest.approx(5.0)
    assert feed.stream_Hz(SETTLE_S + 4.8, "SYS_STATUS") == 0.0
    assert feed.stream_Hz(SETTLE_S + 7.0, "RC_CHANNELS") == 0.0, "it has stopped"


def test_of_a_slow_stream_few_messages_are_no_reproach() -> None:
    feed = Feed()
    feed.heartbeat(0.0)
    for t in (0.9, 1.9, 2.9):
        feed.take(t, mavlink.MAVLink_system_time_message(1_795_000_000_000_000, 1000))
    assert feed.stream_Hz(3.5, "SYSTEM_TIME") == 1.0


def test_the_longest_silence_counts_to_the_end() -> None:
    feed = Feed()
    for t in (0.0, 1.0, 3.5, 4.0):
        feed.heartbeat(t)
    assert feed.probe.facts(4.5).longest_silence_s == 2.5
    assert feed.probe.facts(8.0).longest_silence_s == 4.0


def test_any_message_ends_a_silence_but_heartbeats_may_be_missing() -> None:
    feed = Feed()
    feed.heartbeat(0.0)
    for i in range(1, 13):
        feed.rc(0.5 * i, 1000)
    facts = feed.probe.facts(6.1)
    assert (facts.longest_silence_s, facts.heartbeat_missing) == (0.5, True)
    feed.heartbeat(6.2)
    assert not feed.probe.facts(6.3).heartbeat_missing


@pytest.mark.parametrize(("target", "answers"), [((1, 191), True), ((255, 190), False)])
def test_an_answer_shows_that_our_messages_arrive(target: tuple[int, int], answers: bool) -> None:
    feed = Feed()
    feed.heartbeat(0.0)
    feed.take(0.1, mavlink.MAVLink_command_ack_message(511, 0, 0, 0, *target))
    assert feed.probe.facts(0.2).answers is answers


def test_the_clocks_are_compared_when_the_autopilot_knows_the_time() -> None:
    feed = Feed()
    feed.heartbeat(0.0)
    feed.take(1.0, mavlink.MAVLink_system_time_message(0, 1000))
    assert feed.probe.facts(1.0).ahead_s is None
    feed.take(2.0, mavlink.MAVLink_system_time_message(1_794_999_990_000_000, 2000))
    assert feed.probe.facts(2.0).ahead_s == pytest.approx(12.0)


def test_px4_without_a_receiver_since_its_boot_is_reported() -> None:
    feed = Feed()
    feed.heartbeat(0.0, mavlink.MAV_AUTOPILOT_PX4)
    enabled_alone = mavlink.MAVLink_sys_status_message(0, RC_BIT, 0, 0, 12000, -1, -1, 0, 0, 0, 0, 0, 0)
    feed.take(0.1, enabled_alone)
    feed.rc(0.2, 1000)
    assert feed.probe.radio(0.2).problem == "the autopilot reports no receiver"


def test_positions_count_only_while_rc_is_good() -> None:
    feed = Feed()
    feed.heartbeat(0.0)
    for i in range(60):
        feed.rc(0.05 * i, 1000)
    for i in range(60):
        feed.rc(3.0 + 0.05 * i, 2000)
    assert feed.probe.radio(6.0).seen == {0, 2}
    feed.take(6.0, mavlink.MAVLink_statustext_message(2, b"Radio Failsafe"))
    for i in range(60):
        feed.rc(6.0 + 0.05 * i, 1500)
    radio = feed.probe.radio(9.0)
    assert (radio.problem, radio.position) == ("radio failsafe", None)
    assert radio.seen == {0, 2}


def kinds(messages: list[Any]) -> list[str]:
    return [message.get_type() for message in messages]


def test_without_an_autopilot_only_heartbeats_are_sent() -> None:
    feed = Feed()
    assert feed.probe.due(0.0) == []
    assert feed.probe.due(1.4) == []
    assert kinds(feed.probe.due(1.6)) == ["HEARTBEAT"]
    assert feed.probe.due(1.7) == []


def test_with_two_autopilots_nothing_is_sent() -> None:
    feed = Feed()
    feed.probe.due(0.0)
    feed.heartbeat(0.0)
    feed._out.srcSystem = 7
    feed.heartbeat(0.5)
    assert feed.probe.facts(1.0).rivals == (1, 7)
    assert feed.probe.due(5.0) == []


def test_one_thing_is_asked_for_at_a_time() -> None:
    feed = Feed()
    feed.heartbeat(0.0)
    said = [kinds(feed.probe.due(0.02 * i)) for i in range(200)]
    assert max(map(len, said)) <= 2
    asked = [kind for now in said for kind in now]
    assert asked.count("COMMAND_LONG") >= 6
    assert asked.count("HEARTBEAT") == 4
    assert "MISSION_REQUEST_LIST" in asked


def telemetry(
    t: float, cv_kPa: float, reservoir_kPa: float, faults: Fault = Fault.NONE
) -> tuple[float, Telemetry]:
    return t, Telemetry(round(1000 * t), Mode.VENT, faults, 0, 0.0, cv_kPa, reservoir_kPa, 0.0, 0.0, True)


def test_what_is_read_is_what_comes_to_rest() -> None:
    received = [telemetry(0.01 * i, 10.0 if i < 200 else 0.5, 600.0 - 0.02 * i) for i in range(501)]
    facts = with_readings(FirmwareFacts(), received, None)
    assert facts.telemetry_Hz == pytest.approx(100.0)
    assert facts.cv_kPa == pytest.approx(0.5)
    assert facts.reservoir_kPa == pytest.approx(591.0, abs=0.1)
    assert facts.reservoir_falls_kPa_per_s == pytest.approx(2.0, rel=0.01)


def test_faults_are_those_of_the_end() -> None:
    received = [telemetry(0.0, 0.0, 600.0, Fault.DEAD_MAN), telemetry(1.0, 0.0, 600.0, Fault.SUPPLY)]
    assert with_readings(FirmwareFacts(), received, None).faults is Fault.SUPPLY


def test_without_telemetry_nothing_is_read() -> None:
    facts = with_readings(FirmwareFacts(), [], None)
    assert facts.telemetry_Hz == 0.0
    assert math.isnan(facts.cv_kPa)
