"""The host session in simulated time: handshake, repeated commands, resets, telemetry, and clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.host import (
    VENTING,
    CommandRefused,
    FirmwareReset,
    HostSession,
    Incompatible,
    Ready,
    Regulate,
    SessionState,
    TelemetryReceived,
)
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    ClearFaults,
    Fault,
    Hello,
    HostMessage,
    Message,
    Mode,
    Ping,
    Pong,
    Refusal,
    RefusalReason,
    Setpoint,
    Telemetry,
    Vent,
    Welcome,
)

BEND = Regulate(target_kPa=15.0, rate_kPa_per_s=20.0)


def welcome(nonce: int, boot_id: int = 1) -> Welcome:
    return Welcome(PROTOCOL_VERSION, nonce, boot_id, "test", 1, 30.0, 28.0, 760.0, 200.0, 300, 100)


def telemetry(time_ms: int, cv_kPa: float = 1.0) -> Telemetry:
    return Telemetry(time_ms, Mode.VENT, Fault.NONE, 0, 0.0, cv_kPa, 690.0, 0.0, 0.0, True)


def greeting_nonce(session: HostSession, t: float) -> int:
    (hello,) = session.tick(t)
    assert isinstance(hello, Hello)
    return hello.nonce


def ready(t: float = 0.0, boot_id: int = 1) -> HostSession:
    session = HostSession()
    session.opened(t)
    session.receive(t, welcome(greeting_nonce(session, t), boot_id))
    assert session.state is SessionState.READY
    return session


def commands(sent: list[HostMessage]) -> list[HostMessage]:
    return [message for message in sent if not isinstance(message, Ping)]


def test_a_closed_session_sends_and_reports_nothing() -> None:
    session = HostSession()
    assert session.tick(0.0) == []
    assert session.command(0.0, BEND) == []
    assert session.receive(0.0, telemetry(1)) == []
    assert session.telemetry_age(5.0) == math.inf


def test_hello_is_repeated_every_half_second() -> None:
    session = HostSession()
    session.opened(10.0)
    times = [tick / 100 for tick in range(1000, 1200)]
    assert [t for t in times if session.tick(t)] == [10.0, 10.5, 11.0, 11.5]


def test_the_handshake() -> None:
    session = HostSession(first_nonce=40)
    session.opened(0.0)
    assert session.tick(0.0) == [Hello(PROTOCOL_VERSION, 40)]
    assert session.receive(0.01, welcome(39)) == []
    assert session.receive(0.02, welcome(40)) == [Ready(welcome(40))]
    assert session.state is SessionState.READY
    assert session.welcome == welcome(40)


def test_each_opening_uses_a_new_nonce() -> None:
    session = HostSession()
    nonces = []
    for t in (0.0, 1.0, 2.0):
        session.opened(t)
        nonces.append(greeting_nonce(session, t))
        session.closed(t + 0.5)
    assert len(set(nonces)) == 3


def test_a_ready_session_starts_with_vent() -> None:
    session = ready()
    assert commands(session.tick(0.0)) == [Vent(1)]


def test_a_vent_precedes_even_an_immediate_command() -> None:
    session = ready()
    assert session.command(0.0, BEND) == [Vent(1), Setpoint(15.0, 20.0, 250, 2)]


def test_a_repeated_command_keeps_its_number() -> None:
    session = ready()
    session.tick(0.0)
    assert session.command(0.1, BEND) == [Setpoint(15.0, 20.0, 250, 2)]
    sent = [message for tick in range(1, 101) for message in commands(session.tick(0.1 + tick / 100))]
    assert sent == [Setpoint(15.0, 20.0, 250, 2)] * 50


def test_a_late_tick_sends_only_one_repeat() -> None:
    session = ready()
    session.tick(0.0)
    assert len(commands(session.tick(5.0))) == 1
    assert commands(session.tick(5.001)) == []


def test_a_new_command_is_sent_at_once_and_an_equal_one_is_not() -> None:
    session = ready()
    session.tick(0.0)
    assert len(session.command(0.1, BEND)) == 1
    assert session.command(0.101, Regulate(15.0, 20.0)) == []
    assert session.command(0.102, VENTING) == [Vent(3)]
    assert commands(session.tick(0.2)) == [Vent(3)]


def test_command_numbers_wrap_and_skip_zero() -> None:
    session = ready()
    session.tick(0.0)
    numbers = [
        message.number
        for count in range(70000)
        for message in session.command(0.0, Regulate(float(count % 2), 1.0))
        if isinstance(message, Setpoint)
    ]
    assert 0 not in numbers
    assert max(numbers) == 0xFFFF
    assert numbers[-1] < 10000


def test_a_closed_port_drops_the_command() -> None:
    session = ready()
    session.command(0.0, BEND)
    session.closed(1.0)
    assert session.tick(1.1) == []
    session.opened(2.0)
    assert session.command(2.0, BEND) == []
    session.receive(2.1, welcome(greeting_nonce(session, 2.0)))
    assert {type(message) for tick in range(50) for message in commands(session.tick(2.1 + tick / 100))} == {
        Vent
    }


def test_a_clock_that_runs_back_is_a_reset() -> None:
    session = ready()
    session.command(0.0, BEND)
    session.receive(0.1, telemetry(5000))
    (event,) = session.receive(0.2, telemetry(3))
    assert isinstance(event, FirmwareReset)
    assert session.state is SessionState.GREETING
    assert session.command(0.2, BEND) == []
    events = session.receive(0.4, welcome(greeting_nonce(session, 0.3), boot_id=2))
    assert [type(event) for event in events] == [FirmwareReset, Ready]
    assert commands(session.tick(0.4)) == [Vent(3)]


def test_a_clock_that_wraps_is_not_a_reset() -> None:
    session = ready()
    session.receive(0.1, telemetry(0xFFFFFFFF))
    assert session.receive(0.11, telemetry(9)) == [TelemetryReceived(telemetry(9))]
    assert session.telemetry_gaps == 0


def test_another_boot_id_is_a_reset() -> None:
    session = ready()
    nonce = session.welcome.nonce if session.welcome else 0
    assert session.receive(0.1, welcome(nonce)) == []
    (event,) = session.receive(0.2, welcome(nonce, boot_id=9))
    assert isinstance(event, FirmwareReset)
    assert session.state is SessionState.GREETING


def test_a_refusal_for_a_missing_handshake_is_a_reset() -> None:
    session = ready()
    session.command(0.0, BEND)
    (event,) = session.receive(0.1, Refusal(2, RefusalReason.NO_HANDSHAKE))
    assert isinstance(event, FirmwareReset)
    assert len(session.tick(0.1)) == 1


def test_the_current_command_refused_as_overtaken_is_a_reset() -> None:
    session = ready()
    session.command(0.0, BEND)
    older, current = session.number - 1, session.number
    assert session.receive(0.1, Refusal(older, RefusalReason.OVERTAKEN)) == []
    assert commands(session.tick(0.1)) == [Setpoint(15.0, 20.0, 250, current)]
    (event,) = session.receive(0.2, Refusal(current, RefusalReason.OVERTAKEN))
    assert isinstance(event, FirmwareReset)
    assert session.state is SessionState.GREETING


def test_a_reset_while_the_port_was_closed_is_reported() -> None:
    session = ready()
    session.closed(1.0)
    session.opened(2.0)
    events = session.receive(2.0, welcome(greeting_nonce(session, 2.0), boot_id=2))
    assert [type(event) for event in events] == [FirmwareReset, Ready]


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"protocol_version": PROTOCOL_VERSION + 1}, "update the host"),
        ({"protocol_version": PROTOCOL_VERSION - 1}, "update the firmware"),
        ({"units": 2}, "kPa gauge"),
        ({"cv_limit_kPa": math.nan}, "limits"),
        ({"rate_limit_kPa_per_s": -1.0}, "limits"),
        ({"dead_man_ms": 0}, "dead-man"),
    ],
)
def test_an_incompatible_firmware_gets_no_commands(wrong: dict[str, float], why: str) -> None:
    session = HostSession()
    session.opened(0.0)
    nonce = greeting_nonce(session, 0.0)
    other = replace(welcome(nonce), **wrong)  # type: ignore[arg-type]
    (event,) = session.receive(0.1, other)
    assert isinstance(event, Incompatible)
    assert why in event.reason
    assert event.reason.endswith(".")
    assert session.state is SessionState.INCOMPATIBLE
    assert session.command(0.1, BEND) == []
    assert session.receive(0.2, other) == []
    assert session.receive(0.2, Refusal(0, RefusalReason.VERSION)) == []
    assert session.receive(0.3, welcome(nonce)) == [Ready(welcome(nonce))]


def test_a_refused_version_is_reported_once() -> None:
    session = HostSession()
    session.opened(0.0)
    session.tick(0.0)
    refusal = Refusal(0, RefusalReason.VERSION)
    assert [type(event) for event in session.receive(0.1, refusal)] == [Incompatible]
    assert session.receive(0.2, refusal) == []


def test_a_refused_command_is_reported_once_and_then_vents() -> None:
    session = ready()
    session.command(0.0, BEND)
    refusal = Refusal(2, RefusalReason.FAULT_LATCHED)
    assert session.receive(0.1, refusal) == [CommandRefused(refusal)]
    assert session.receive(0.1, refusal) == []
    assert commands(session.tick(0.1)) == [Vent(3)]
    assert session.command(0.2, BEND) == [Setpoint(15.0, 20.0, 250, 4)]


def test_the_refusal_of_an_older_command_keeps_the_current_one() -> None:
    session = ready()
    session.command(0.0, BEND)
    session.command(0.1, Regulate(10.0, 20.0))
    assert len(session.receive(0.1, Refusal(2, RefusalReason.OUT_OF_RANGE))) == 1
    assert commands(session.tick(0.2)) == [Setpoint(10.0, 20.0, 250, 3)]


def test_refusals_of_commands_that_are_not_ours_are_reported_once_for_each_reason() -> None:
    """Another program on the line gets one for each of its commands, a hundred times a second."""
    session = ready()
    reasons = (RefusalReason.FAULT_LATCHED, RefusalReason.OUT_OF_RANGE)
    told = [session.receive(0.1, Refusal(number, reasons[number % 2])) for number in range(500, 600)]
    assert sum(map(len, told)) == 2
    session.command(0.2, BEND)
    ours = Refusal(session.number, RefusalReason.FAULT_LATCHED)
    assert session.receive(0.3, ours) == [CommandRefused(ours)]


def test_clearing_faults() -> None:
    session = HostSession()
    assert session.clear_faults(0.0, Fault.DEAD_MAN) == []
    session = ready()
    assert session.clear_faults(0.0, Fault.DEAD_MAN | Fault.CV_SENSOR) == [ClearFaults(0b1001)]
    assert session.clear_faults(0.0, ~Fault.NONE) == [ClearFaults(sum(Fault))]


def test_telemetry_and_its_age() -> None:
    session = ready()
    assert session.receive(0.1, telemetry(100)) == [TelemetryReceived(telemetry(100))]
    assert session.telemetry == telemetry(100)
    assert session.telemetry_age(0.35) == pytest.approx(0.25)


def test_telemetry_before_the_handshake_is_ignored() -> None:
    session = HostSession()
    session.opened(0.0)
    assert session.receive(0.0, telemetry(100)) == []
    assert session.telemetry is None


@pytest.mark.parametrize("field", ["setpoint_kPa", "cv_kPa", "reservoir_kPa"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_non_finite_telemetry_counts_as_lost(field: str, value: float) -> None:
    session = ready()
    session.receive(0.1, telemetry(100))
    assert session.receive(0.11, replace(telemetry(110), **{field: value})) == []  # type: ignore[arg-type]
    assert session.telemetry == telemetry(100)
    assert session.telemetry_age(0.11) == pytest.approx(0.01)
    assert session.telemetry_gaps == 1
    session.receive(0.12, telemetry(120))
    assert session.telemetry_gaps == 1


def test_missing_telemetry_is_counted() -> None:
    session = ready()
    for time_ms in (100, 110, 121, 129, 170, 180):
        session.receive(time_ms / 1000, telemetry(time_ms))
    assert session.telemetry_gaps == 3


def test_ping_gives_round_trip_and_clock() -> None:
    session = ready(t=100.0)
    for second, delay_s in enumerate((0.030, 0.002, 0.040)):
        t = 100.0 + second
        (ping,) = (message for message in session.tick(t) if isinstance(message, Ping))
        # Nearly all of the delay is on the way back.
        device_ms = round((t + 0.001 - 95.0) * 1000)
        session.receive(t + delay_s, Pong(ping.host_time_us, device_ms))
    assert session.round_trip_s == pytest.approx(0.040)
    assert session.clock_offset_s == pytest.approx(-95.0, abs=0.001)


def ping_for(
    session: HostSession,
    began: float,
    for_s: int,
    there_s: Callable[[int], float],
    back_s: Callable[[int], float],
    device_s: Callable[[float], float],
) -> float:
    """Answer a ping each second with these delays and this device clock. Return the time of the last pong."""
    t = began
    for second in range(for_s):
        asked = began + second
        (ping,) = (message for message in session.tick(asked) if isinstance(message, Ping))
        # The device's clock counts whole milliseconds, and wraps.
        device_ms = int(device_s(asked + there_s(second)) * 1000) % 2**32
        t = asked + there_s(second) + back_s(second)
        session.receive(t, Pong(ping.host_time_us, device_ms))
    return t


delays = st.lists(st.floats(0.0001, 0.2), min_size=20, max_size=20)


@given(delays, delays, st.floats(0.0, 1e6))
def test_the_clock_offset_is_off_by_half_a_round_trip_and_a_millisecond_at_most(
    there: list[float], back: list[float], device_began: float
) -> None:
    session = ready(t=100.0)
    ping_for(session, 100.0, 20, there.__getitem__, back.__getitem__, lambda t: t + device_began)
    assert session.round_trip_s == pytest.approx(there[-1] + back[-1], abs=1e-5)
    quickest = min(a + b for a, b in zip(there[4:], back[4:], strict=True))
    assert session.clock_offset_s is not None
    wrapped = (device_began - session.clock_offset_s) % (2**32 / 1000)
    assert min(wrapped, 2**32 / 1000 - wrapped) <= quickest / 2 + 0.001 + 1e-5


@pytest.mark.parametrize("drift_ppm", [-100.0, 0.0, 40.0, 200.0])
def test_the_drift_of_the_clock(drift_ppm: float) -> None:
    session = ready(t=100.0)
    # All of the delay is on the way to the device, and every seventh ping is delayed for long.
    ping_for(
        *(session, 100.0, 300),
        there_s=lambda second: 0.2 if second % 7 == 0 else 0.003,
        back_s=lambda second: 0.0001,
        device_s=lambda t: 50.0 + (t - 100.0) * (1.0 + drift_ppm / 1e6),
    )
    assert session.clock_drift_ppm == pytest.approx(drift_ppm, abs=10.0)


def test_no_drift_is_reported_in_the_first_minute() -> None:
    session = ready(t=100.0)
    ping_for(session, 100.0, 60, lambda second: 0.001, lambda second: 0.001, lambda t: t)
    assert session.clock_offset_s == pytest.approx(0.0, abs=0.002)
    assert session.clock_drift_ppm is None


def test_the_offset_survives_the_wrap_of_the_clock() -> None:
    session = ready(t=100.0)
    full_s = 2**32 / 1000
    ping_for(session, 100.0, 120, lambda second: 0.001, lambda second: 0.001, lambda t: t + full_s - 150.0)
    assert session.clock_offset_s == pytest.approx(full_s - 150.0, abs=0.002)
    assert session.clock_drift_ppm == pytest.approx(0.0, abs=20.0)


def test_out_of_order_telemetry_is_ignored() -> None:
    session = ready()
    session.receive(0.10, telemetry(5010, cv_kPa=2.0))
    assert session.receive(0.11, telemetry(5000, cv_kPa=1.0)) == []
    assert session.telemetry == telemetry(5010, cv_kPa=2.0)
    assert session.receive(0.12, telemetry(5020)) == [TelemetryReceived(telemetry(5020))]
    assert session.telemetry_gaps == 0
    assert session.state is SessionState.READY


@pytest.mark.parametrize(("before_ms", "after_ms"), [(5000, 4899), (150, 90), (50, 0), (2**31 + 7, 10)])
def test_a_larger_step_back_of_the_clock_is_a_reset(before_ms: int, after_ms: int) -> None:
    session = ready()
    session.receive(0.1, telemetry(before_ms))
    (event,) = session.receive(0.2, telemetry(after_ms))
    assert isinstance(event, FirmwareReset)


def test_pings_once_a_second() -> None:
    session = ready()
    pings = [t for t in range(301) for message in session.tick(t / 100) if isinstance(message, Ping)]
    assert pings == [0, 100, 200, 300]


def test_pongs_with_impossible_times_are_ignored() -> None:
    session = ready(t=100.0)
    session.tick(100.0)
    for host_time_us in (0, 99_900_000, 2**64 - 1):
        session.receive(100.1, Pong(host_time_us, 1))
    assert session.round_trip_s is None


@pytest.mark.parametrize(
    ("target", "rate", "ttl"),
    [
        (math.nan, 1.0, 250),
        (math.inf, 1.0, 250),
        (1e300, 1.0, 250),
        (1.0, math.nan, 250),
        (1.0, 0.0, 250),
        (1.0, -1.0, 250),
        (1.0, 1.0, 0),
        (1.0, 1.0, 65536),
    ],
)
def test_an_invalid_command_raises(target: float, rate: float, ttl: int) -> None:
    with pytest.raises(ValueError, match=r"not (a|within)"):
        Regulate(target, rate, ttl)


messages: st.SearchStrategy[Message] = st.one_of(
    st.builds(welcome, st.integers(1, 4), st.integers(1, 2)),
    st.builds(telemetry, st.integers(0, 2**32 - 1), st.floats(width=32)),
    st.builds(Refusal, st.integers(0, 5), st.sampled_from(RefusalReason)),
    st.builds(Pong, st.integers(0, 2**64 - 1), st.integers(0, 2**32 - 1)),
    st.builds(Vent, st.integers(0, 5)),
)
events = st.one_of(messages, st.sampled_from(["open", "close", "tick", "bend", "vent"]), st.floats(0.0, 0.3))


@given(st.lists(events, max_size=60))
def test_a_setpoint_is_sent_only_for_a_bend_since_the_last_handshake(
    sequence: list[Message | str | float],
) -> None:
    session = HostSession()
    t, bent = 0.0, False
    for event in sequence:
        sent: list[HostMessage] = []
        if isinstance(event, float):
            t += event
        elif event == "open":
            session.opened(t)
        elif event == "close":
            session.closed(t)
        elif event == "tick":
            sent = session.tick(t)
        elif event == "bend":
            sent = session.command(t, BEND)
            bent = session.state is SessionState.READY
        elif event == "vent":
            sent = session.command(t, VENTING)
            bent = False
        elif not isinstance(event, str):
            session.receive(t, event)
        bent = bent and session.state is SessionState.READY
        assert bent or not any(isinstance(message, Setpoint) for message in sent)
        if session.telemetry is not None:
            assert math.isfinite(session.telemetry.cv_kPa)
