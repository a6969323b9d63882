"""A board with other settings than in the last flight bends nothing until a person has confirmed them.

With the standard span of 206.84 kPa, a sensor of 420 kPa shows half of the true pressure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link.protocol import PROTOCOL_VERSION, Codec, Fault, Hello, HostMessage, SetSetting
from flying_vines.config import config
from flying_vines.core.core import Core
from flying_vines.core.events import Action, Asked, KeepBoardSettings, KeepLatched, LinkChanged, StoredState
from flying_vines.core.safety import BOARD_SETTINGS
from flying_vines.physics.plant.effects import Effects
from flying_vines.simulation.phlosar.firmware import Firmware
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vine.intent import ClearLatchedFaults

from .flights import HIGH, LOW, MIDDLE, airborne, decisions, ground_command, notices, run_for

SPAN = {"cv_span_kPa": 300.0}


def remembered(actions: Sequence[Action]) -> list[int]:
    return [action.digest for action in actions if isinstance(action, KeepBoardSettings)]


def started(board: Firmware, known: int | None, latched: dict[str, str] | None = None) -> SimulatedFlight:
    """A flight whose service has just started on a board and knows these settings."""
    flight = airborne(phlosar=SimulatedPhlosar(firmware=board, effects=Effects()))
    restart(flight, known, latched)
    return flight


def restart(flight: SimulatedFlight, known: int | None, latched: dict[str, str] | None = None) -> None:
    stored = StoredState(latched=latched or {}, board_settings=known)
    flight.world.core = Core(config.default(), stored=stored)
    flight.autopilot.set_rc(9, LOW)
    for link in ("firmware", "vehicle"):
        flight.feed(LinkChanged(flight.world.now, link, True))


def digest_of(board: Firmware) -> int:
    flight = started(board, None)
    (digest,) = remembered(run_for(flight, 1.0))
    return digest


def bends(flight: SimulatedFlight) -> bool:
    for position in (MIDDLE, LOW):  # a fresh move, also after a vent by others
        flight.autopilot.set_rc(9, position)
        run_for(flight, 1.0)
    flight.autopilot.set_rc(9, MIDDLE)
    verdicts = [decision.safety for decision in decisions(run_for(flight, 1.0))]
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 1.0)
    assert len(verdicts) == 1
    return verdicts == ["accepted"]


def clear_by_ground_station(flight: SimulatedFlight) -> list[Action]:
    return ground_command(flight, mavlink.MAV_CMD_USER_5, 1.0)


def test_the_first_stored_settings_are_remembered_with_a_text() -> None:
    flight = started(Firmware(SPAN), None)
    actions = run_for(flight, 4.0)
    assert len(remembered(actions)) == 1
    assert "Vine: phloSAR settings are remembered" in notices(actions)
    assert bends(flight)
    restart(flight, remembered(actions)[0])
    actions = run_for(flight, 4.0)
    assert remembered(actions) == []
    assert not any("settings" in text for text in notices(actions))
    assert bends(flight)


BOARDS: dict[str, tuple[Callable[[], Firmware], str]] = {
    "another board": (Firmware, "phloSAR settings have changed"),
    "an erased memory": (lambda: Firmware(stored=b"\xff" * 82), "phloSAR settings are lost"),
    "a new board": (lambda: Firmware(stored=b""), "phloSAR settings are lost"),
    "a damaged memory": (lambda: Firmware(stored=b"\x00" * 82), "phloSAR settings are lost"),
}


@pytest.mark.parametrize("which", BOARDS)
def test_other_settings_bend_nothing_until_a_person_confirms_them(which: str) -> None:
    board, text = BOARDS[which]
    known = digest_of(Firmware(SPAN))
    flight = started(board(), known)
    actions = run_for(flight, 4.0)
    assert any(text in shown and "check them, then clear faults" in shown for shown in notices(actions))
    assert [set(action.faults) for action in actions if isinstance(action, KeepLatched)] == [{BOARD_SETTINGS}]
    assert not bends(flight)
    actions = clear_by_ground_station(flight)
    (new,) = remembered(actions)
    assert new != known
    if which == "a damaged memory":
        # The board's own fault stays until settings are stored.
        run_for(flight, 1.0)
        assert Fault.SETTINGS in flight.phlosar.firmware.faults
        assert not bends(flight)
        return
    assert bends(flight)
    restart(flight, new)
    run_for(flight, 4.0)
    assert bends(flight)


@pytest.mark.parametrize("stored", [b"", b"\xff" * 82])
def test_a_new_board_is_confirmed_before_the_first_flight(stored: bytes) -> None:
    flight = started(Firmware(stored=stored), None)
    actions = run_for(flight, 4.0)
    assert remembered(actions) == []
    assert not bends(flight)
    assert len(remembered(clear_by_ground_station(flight))) == 1
    assert bends(flight)


def test_an_erased_memory_with_the_known_values_is_no_fault() -> None:
    flight = started(Firmware(stored=b""), digest_of(Firmware()))
    run_for(flight, 4.0)
    assert bends(flight)


def test_no_routine_request_clears_it() -> None:
    flight = started(Firmware(), digest_of(Firmware(SPAN)))
    run_for(flight, 4.0)
    for position in (HIGH, LOW, MIDDLE, LOW):
        flight.autopilot.set_rc(9, position)
        run_for(flight, 1.0)
    ground_command(flight, mavlink.MAV_CMD_USER_4, 0.0)
    run_for(flight, 1.0)
    assert BOARD_SETTINGS in flight.core.snapshot(flight.world.now).safe_state
    assert not bends(flight)


def test_only_a_person_who_saw_it_clears_it() -> None:
    flight = started(Firmware(), digest_of(Firmware(SPAN)))
    before = flight.world.now
    run_for(flight, 4.0)
    now = flight.world.now
    for seen_at in (None, before):
        flight.feed(Asked(now, "page", ClearLatchedFaults(), now, seen_at))
        assert BOARD_SETTINGS in flight.core.snapshot(now).safe_state
    actions = flight.feed(Asked(now, "page", ClearLatchedFaults(), now, now))
    assert len(remembered(actions)) == 1
    assert flight.core.snapshot(now).safe_state == {}


def test_it_outlasts_restarts_of_service_and_board() -> None:
    known = digest_of(Firmware(SPAN))
    flight = started(Firmware(), known)
    actions = run_for(flight, 4.0)
    (latched,) = [action.faults for action in actions if isinstance(action, KeepLatched)]
    # With the stored fault, and without it.
    for stored in (latched, {}):
        restart(flight, known, stored)
        run_for(flight, 4.0)
        assert not bends(flight)
    flight.phlosar.reset_firmware()
    run_for(flight, 4.0)
    assert not bends(flight)


def test_a_clearing_before_the_board_answers_confirms_nothing() -> None:
    known = digest_of(Firmware(SPAN))
    flight = started(Firmware(), known, {BOARD_SETTINGS: "phloSAR settings have changed"})
    assert remembered(clear_by_ground_station(flight)) == []
    run_for(flight, 4.0)
    assert not bends(flight)


def test_settings_that_change_again_are_shown_again() -> None:
    flight = started(Firmware(), digest_of(Firmware(SPAN)))
    run_for(flight, 2.0)
    seen_at = flight.world.now
    run_for(flight, 1.0)
    flight.phlosar.firmware = Firmware({"cv_zero_kPa": 5.0}, boot_id=77)
    run_for(flight, 2.0)
    now = flight.world.now
    assert remembered(flight.feed(Asked(now, "page", ClearLatchedFaults(), now, seen_at))) == []
    assert BOARD_SETTINGS in flight.core.snapshot(now).safe_state


ANOTHER_HOST: dict[str, tuple[HostMessage, ...]] = {
    "before": (Hello(PROTOCOL_VERSION, 99), SetSetting(6, 206.84)),
    "after": (SetSetting(6, 206.84), Hello(PROTOCOL_VERSION, 99)),
    "never": (SetSetting(6, 206.84),),
}


@pytest.mark.parametrize("greets", ANOTHER_HOST)
def test_settings_that_another_host_changes_in_flight_bend_nothing(greets: str) -> None:
    """Without this the vine would get twice the pressure that the service shows."""
    board = Firmware({"cv_span_kPa": 413.0})
    flight = started(board, None)
    run_for(flight, 4.0)
    assert bends(flight)
    other = Codec()
    for message in ANOTHER_HOST[greets]:
        board.receive(other.encode(message))
    run_for(flight, 1.0)
    assert not bends(flight)
    assert flight.phlosar.cv_kPa < 1.0
    assert BOARD_SETTINGS in flight.core.snapshot(flight.world.now).safe_state
    clear_by_ground_station(flight)
    run_for(flight, 1.0)
    assert bends(flight)
