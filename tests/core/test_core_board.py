"""A board that repeats its telemetry, ignores commands, or restarts again and again."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Callable, Sequence

import pytest

from firmware_link import protocol
from firmware_link.protocol import Mode, Setpoint, Telemetry, Vent
from flying_vines.config import config
from flying_vines.core.events import Action, Asked, LinkChanged, ToFirmware, ToVehicle
from flying_vines.gateway.gateway import Gateway
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.terminal.screen import event_line
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vine import intent

from .flights import HIGH, LOW, airborne, bent, decisions, run_for

Change = Callable[[Telemetry], Telemetry]

WAITING = "Vine: waiting for: switch down, then up"


def notices(actions: Sequence[Action]) -> list[Notice]:
    return [a for a in actions if isinstance(a, Notice)]


def texts_of(actions: Sequence[Action]) -> list[str]:
    """The texts that the pilot reads."""
    return [notice.text for notice in notices(actions) if notice.severity is not Severity.DEBUG]


def sent(actions: Sequence[Action], kind: type[Setpoint] | type[Vent]) -> int:
    return sum(isinstance(a, ToFirmware) and isinstance(a.message, kind) for a in actions)


def change_telemetry(flight: SimulatedFlight, change: Change) -> None:
    """Change the board's telemetry from now on."""
    decoder, encoder = protocol.Codec(), protocol.Codec()

    def changed(message: protocol.Message) -> protocol.Message:
        return change(message) if isinstance(message, Telemetry) else message

    flight.world.from_phlosar = lambda data: b"".join(
        encoder.encode(changed(message)) for message in decoder.decode(data)
    )


# Repeated telemetry.


def repeating() -> Change:
    first: list[Telemetry] = []

    def change(telemetry: Telemetry) -> Telemetry:
        first.append(telemetry)
        return first[0]

    return change


def with_clock(clock_ms: Callable[[int, int], int]) -> Change:
    """Telemetry with good pressures and counter. The clock is a function of its first time and the count."""
    times = []

    def change(telemetry: Telemetry) -> Telemetry:
        times.append(telemetry.device_time_ms)
        return dataclasses.replace(telemetry, device_time_ms=clock_ms(times[0], len(times)) & 0xFFFFFFFF)

    return change


@pytest.mark.parametrize(
    "change",
    [
        repeating(),
        with_clock(lambda first, count: first),
        with_clock(lambda first, count: first + count % 2),
        with_clock(lambda first, count: first + count),
        with_clock(lambda first, count: first + count * 900),
        with_clock(lambda first, count: first + count * 3_600_000),
    ],
    ids=["repeated", "frozen clock", "to and fro", "a tenth of the pace", "90 times the pace", "leaping"],
)
def test_telemetry_whose_clock_does_not_go_on_is_lost(change: Change) -> None:
    flight = bent()
    change_telemetry(flight, change)
    lost = run_for(flight, 0.55)
    assert "Vine: phloSAR telemetry stale, vent commanded" in texts_of(lost)
    assert flight.phlosar.cv_kPa < 20.0
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 1.0)
    flight.autopilot.set_rc(9, HIGH)
    (refused,) = [d for d in decisions(run_for(flight, 2.0)) if d.trigger == "switch"]
    assert (refused.safety, refused.reason) == ("refused", "phloSAR telemetry stale")


def test_a_counter_that_stops_while_the_clock_continues_is_no_loss() -> None:
    """The board's clock says if a frame is new. The counter only counts losses."""
    flight = bent()
    decoder = protocol.Codec()
    flight.world.from_phlosar = lambda data: b"".join(protocol.encode(m, 7) for m in decoder.decode(data))
    assert texts_of(run_for(flight, 3.0)) == []
    assert flight.phlosar.cv_kPa == pytest.approx(20.7, abs=1.0)


def test_repeated_frames_and_swapped_frames_are_no_loss() -> None:
    flight = bent()
    decoder, encoder = protocol.Codec(), protocol.Codec()
    waiting: list[protocol.Message] = []

    def swapped(data: bytes) -> bytes:
        out: list[protocol.Message] = []
        for message in decoder.decode(data):
            waiting.append(message)
            if len(waiting) == 2:
                out += [waiting[1], waiting[0], waiting[1]]
                waiting.clear()
        return b"".join(encoder.encode(message) for message in out)

    flight.world.from_phlosar = swapped
    assert texts_of(run_for(flight, 3.0)) == []
    assert flight.phlosar.cv_kPa == pytest.approx(20.7, abs=1.0)


# A board that ignores commands.


def regulating(telemetry: Telemetry) -> Telemetry:
    return dataclasses.replace(telemetry, mode=Mode.REGULATE, setpoint_kPa=20.7)


def test_a_board_that_regulates_on_after_a_vent_is_reported_and_is_a_fault() -> None:
    flight = bent()
    change_telemetry(flight, regulating)
    flight.autopilot.set_rc(9, LOW)
    actions = run_for(flight, 0.5)
    began = next(a.t for a in decisions(actions) if a.intent == "straight")
    # The motion down must end first: until then the board gets setpoints.
    actions += run_for(flight, 3.0)
    ended = max(
        i for i, a in enumerate(actions) if isinstance(a, ToFirmware) and isinstance(a.message, Setpoint)
    )
    (fault,) = [a for a in notices(actions) if "does not vent" in a.text]
    assert fault.text == "Vine: phloSAR does not vent, vent commanded"
    assert fault.t - began < 1.5
    assert sent(actions[ended + 1 :], Vent) > 50, "the vent is repeated"
    flight.autopilot.set_rc(9, HIGH)
    (refused,) = decisions(run_for(flight, 1.0))
    assert (refused.safety, refused.reason) == ("refused", "phloSAR does not vent")
    flight.world.from_phlosar = lambda data: data
    run_for(flight, 1.0)
    assert "regulates" in flight.core.snapshot(flight.world.now).safe_state, "a person clears it"
    flight.autopilot.set_rc(9, LOW)
    assert "Vine: cleared: phloSAR does not vent" in texts_of(run_for(flight, 1.0))


def test_a_board_that_regulates_on_is_found_within_0p35_s_of_a_vent() -> None:
    flight = bent()
    change_telemetry(flight, regulating)
    flight.autopilot.lose_rc("jump")
    actions = run_for(flight, 2.0)
    vented_at = next(d.t for d in decisions(actions) if d.what.get("loss") == "rc")
    fault_at = next(d.t for d in decisions(actions) if d.what.get("loss") == "regulates")
    assert 0.29 < fault_at - vented_at < 0.36


def in_every_frame_but(nth: int) -> Change:
    """The board regulates on, but says VENT in every nth frame: two programs command it."""
    frames = itertools.count(1)
    return lambda told: told if next(frames) % nth == 0 else regulating(told)


def with_valves(evp_opening: float, solenoid: bool) -> Change:
    """The board says VENT, but also that its valves do not vent."""

    def change(told: Telemetry) -> Telemetry:
        if told.mode is Mode.REGULATE:
            return told
        return dataclasses.replace(told, evp_opening=evp_opening, solenoid=solenoid)

    return change


@pytest.mark.parametrize(
    "change",
    [in_every_frame_but(2), in_every_frame_but(20), with_valves(0.0, False), with_valves(0.4, True)],
    ids=["VENT in every 2nd frame", "VENT in every 20th frame", "outlet shut", "inflation valve open"],
)
def test_a_board_that_contradicts_its_vent_is_a_fault_within_1_s(change: Change) -> None:
    flight = bent()
    change_telemetry(flight, change)
    flight.autopilot.lose_rc("jump")
    actions = run_for(flight, 3.0)
    vented_at = next(d.t for d in decisions(actions) if d.what.get("loss") == "rc")
    fault_at = next(d.t for d in decisions(actions) if d.what.get("loss") == "regulates")
    assert fault_at - vented_at < 1.0


def test_two_late_answers_in_a_row_are_no_fault() -> None:
    """Each answer is late by less than the limit. Only both times together exceed it."""
    flight = bent()
    change_telemetry(flight, lambda telemetry: dataclasses.replace(telemetry, mode=Mode.VENT))
    actions = run_for(flight, 0.25)
    actions += flight.feed(Asked(flight.world.now, "page", intent.VentVine()))
    change_telemetry(flight, regulating)
    actions += run_for(flight, 0.25)
    flight.world.from_phlosar = lambda data: data
    actions += run_for(flight, 1.0)
    assert texts_of(actions) == [f"{WAITING} within 2 s"]


@pytest.mark.parametrize(
    ("bends", "notice"), [(False, []), (True, ["Vine: phloSAR gets no commands, vented", WAITING])]
)
def test_a_board_in_a_fault_that_it_does_not_name_vents_and_does_not_bend(
    bends: bool, notice: list[str]
) -> None:
    flight = bent() if bends else airborne()
    change_telemetry(flight, lambda telemetry: dataclasses.replace(telemetry, mode=Mode.FAULT))
    assert texts_of(run_for(flight, 2.0)) == notice


def test_a_vent_that_arrives_late_is_no_fault() -> None:
    flight = bent()
    flight.autopilot.lose_rc("jump")
    lost_until = flight.world.now + 0.35
    perfect = flight.world.to_phlosar
    flight.world.to_phlosar = lambda data: b"" if flight.world.now < lost_until else perfect(data)
    assert not any("does not vent" in text for text in texts_of(run_for(flight, 2.0)))


# A board that restarts again and again.


def rebooting(flight: SimulatedFlight, every_s: float, for_s: float) -> list[Action]:
    actions: list[Action] = []
    for _ in range(round(for_s / every_s)):
        flight.phlosar.reset_firmware()
        actions += run_for(flight, every_s)
    return actions


@pytest.mark.long
@pytest.mark.parametrize("every_s", [0.1, 2.5])
def test_a_loop_of_restarts_is_reported_at_once_and_then_counted(every_s: float) -> None:
    flight = bent()
    actions = rebooting(flight, every_s, 30.0)
    actions += run_for(flight, 11.0)
    texts = texts_of(actions)
    assert texts[0] == "Vine: phloSAR restarted: its clock went back to 0 ms, vented"
    assert len(texts) <= 8
    count = round(30.0 / every_s)
    counts = [int(number) for text in texts for number in re.findall(r"unstable: (\d+) losses", text)]
    assert counts == sorted(counts) and counts[-1] == count, texts
    logged = [n for n in notices(actions) if "restarted" in n.text and n.severity is Severity.DEBUG]
    assert len(logged) >= count - 1, "the log has each restart"
    assert all(event_line(notice, 0.0) is None for notice in logged)
    gateway = Gateway(config.default(), ask=lambda *_: pytest.fail("nobody asks"), say=pytest.fail)
    for notice in logged:
        gateway.action(notice)
    assert not gateway._unsent
    assert sum(decision.shown for decision in decisions(actions)) <= 3
    radioed = [a.message for a in actions if isinstance(a, ToVehicle)]
    assert sum(message.get_type() == "STATUSTEXT" for message in radioed) <= 10


def test_while_the_board_restarts_again_and_again_no_person_clears_it_and_nothing_bends() -> None:
    flight = airborne()
    positions = itertools.cycle((HIGH, LOW))
    actions: list[Action] = []
    for _ in range(8):
        flight.autopilot.set_rc(9, next(positions))
        actions += rebooting(flight, 0.8, 1.6)
    bends = [d for d in decisions(actions) if d.intent and d.intent.startswith("bend")]
    assert {d.safety for d in bends} == {"refused"}
    assert any("phloSAR restarted" in d.reason and "times in" in d.reason for d in bends)
    assert sent(actions, Setpoint) == 0
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 11.0)
    flight.autopilot.set_rc(9, HIGH)
    (still,) = decisions(run_for(flight, 1.0))
    assert still.safety == "refused", "latched until a person clears it"
    flight.autopilot.set_rc(9, LOW)
    (cleared,) = (text for text in texts_of(run_for(flight, 1.0)) if "cleared" in text)
    assert re.fullmatch(r"Vine: cleared: phloSAR restarted \d+ times in \d+ s", cleared)
    flight.autopilot.set_rc(9, HIGH)
    (bends_again,) = decisions(run_for(flight, 1.0))
    assert bends_again.safety == "accepted"


def test_a_person_clears_a_single_restart() -> None:
    flight = bent()
    flight.phlosar.reset_firmware()
    run_for(flight, 0.5)
    flight.autopilot.set_rc(9, LOW)
    assert "Vine: cleared: phloSAR restarted: its clock went back to 0 ms" in texts_of(run_for(flight, 1.0))


def test_a_restart_has_no_text_about_the_switch() -> None:
    flight = bent()
    flight.phlosar.reset_firmware()
    run_for(flight, 0.3)
    assert flight.core.snapshot(flight.world.now).switch_position == 2


def test_a_repeated_welcome_does_not_disturb_a_bend() -> None:
    flight = airborne()
    encoder, decoder = protocol.Codec(), protocol.Codec()
    told: list[protocol.Welcome] = []
    again: list[bytes] = []

    def line(data: bytes) -> bytes:
        told.extend(m for m in decoder.decode(data) if isinstance(m, protocol.Welcome))
        return data + (again.pop() if again else b"")

    flight.world.from_phlosar = line
    for opened in (False, True):
        flight.feed(LinkChanged(flight.world.now, "firmware", opened))
        run_for(flight, 2.0)
    flight.autopilot.set_rc(9, HIGH)
    run_for(flight, 2.0)
    assert flight.phlosar.cv_kPa > 19.0
    again.append(encoder.encode(told[-1]))
    assert texts_of(run_for(flight, 2.0)) == []
    assert flight.phlosar.cv_kPa > 19.0
