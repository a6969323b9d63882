"""A flood of requests hides no fault from the pilot, and no refusal of another sender."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.core.events import Action, ToVehicle, VehicleMessage
from flying_vines.core.request_lines import (
    FIRST_PERIOD_S,
    LONGEST_PERIOD_S,
    MAX_LINES,
    MAX_SOURCES,
    OTHERS,
    RequestLines,
)
from flying_vines.gateway.gateway import Gateway
from flying_vines.simulation.phlosar.mishaps import Open
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.terminal.screen import event_line
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.notice import Notice, Severity

from .flights import HIGH, airborne, answers, bent, decisions, on_the_ground, run_for

FLOOD_HZ = 50


def line(t: float, text: str = "Vine: refused", source: str = "7/1") -> Notice:
    return Notice(t, Severity.WARNING, text, of_decision=True, source=source)


def test_the_first_lines_are_shown_and_repeats_are_counted() -> None:
    lines = RequestLines()
    assert [lines.take(line(0.1 * i)) for i in range(23)] == [True] + 22 * [False]
    assert lines.due(FIRST_PERIOD_S - 0.1) == []
    (count,) = lines.due(FIRST_PERIOD_S)
    assert (count.text, count.severity) == ("Vine: refused (23 times)", Severity.WARNING)
    assert not count.of_decision, "no display shows a decision of this moment"


def test_different_lines_of_one_source_are_counted_together() -> None:
    lines = RequestLines()
    shown = [lines.take(line(0.0, f"Vine: refused {i}")) for i in range(40)]
    assert shown == MAX_LINES * [True] + (40 - MAX_LINES) * [False]
    (count,) = lines.due(FIRST_PERIOD_S)
    assert count.text == "Vine: refused 39 (one of 40 from 7/1)"


def test_another_source_has_lines_of_its_own() -> None:
    lines = RequestLines()
    for i in range(40):
        lines.take(line(0.0, f"Vine: refused {i}"))
    assert lines.take(line(0.0, "Vine: refused bend 40°", "255/190"))


def test_a_source_that_is_quiet_for_a_period_starts_afresh() -> None:
    lines = RequestLines()
    lines.take(line(0.0))
    assert lines.due(FIRST_PERIOD_S) == []
    assert lines.take(line(FIRST_PERIOD_S))


@pytest.mark.parametrize("forged", [False, True])
def test_an_hour_of_a_flood_is_few_lines(forged: bool) -> None:
    lines, shown = RequestLines(), 0
    for i in range(20 * 3600):
        t = i / 20
        source = f"{i % 200}/{i % 99}" if forged else "7/1"
        shown += lines.take(line(t, f"Vine: refused {i}", source))
        shown += len(lines.due(t))
    per_period = MAX_LINES + 1
    assert shown <= MAX_SOURCES + per_period * (3600 / LONGEST_PERIOD_S + 5)


def test_of_too_many_senders_the_rest_are_counted_together() -> None:
    lines = RequestLines()
    shown = [lines.take(line(0.0, f"Vine: refused {i}", f"{i}/1")) for i in range(100)]
    assert sum(shown) == MAX_SOURCES + MAX_LINES
    (count,) = lines.due(FIRST_PERIOD_S)
    assert f"(one of {100 - MAX_SOURCES} from {OTHERS})" in count.text


def test_a_known_source_keeps_its_lines_when_many_others_come() -> None:
    lines = RequestLines()
    assert lines.take(line(0.0, "Vine: refused hold", "255/190"))
    for i in range(100):
        lines.take(line(0.0, f"Vine: refused {i}", f"{i}/1"))
    assert lines.take(line(0.0, "Vine: refused bend 40°", "255/190"))


# In flight.


class Flood:
    """Commands of one sender, all refused, many times a second."""

    def __init__(self, flight: SimulatedFlight, sender: tuple[int, int] = (7, 1)) -> None:
        self.flight = flight
        self._sender, self._ours = MavlinkCodec(*sender), MavlinkCodec(1, 191)
        self.angles_deg = True
        self._sent = 0

    def run(self, seconds: float, command: int = mavlink.MAV_CMD_USER_2) -> list[Action]:
        actions: list[Action] = []
        for _ in range(round(seconds * FLOOD_HZ)):
            self._sent += 1
            param1 = 20.0 + 0.01 * self._sent if self.angles_deg else 0.0
            message = mavlink.MAVLink_command_long_message(1, 191, command, 0, param1, *[0.0] * 6)
            (received,) = self._ours.decode(self._sender.encode(message, 7))
            actions += self.flight.feed(VehicleMessage(self.flight.world.now, received))
            actions += run_for(self.flight, 1.0 / FLOOD_HZ)
        return actions


def sent_texts(actions: list[Action]) -> list[str]:
    return [
        a.message.text if isinstance(a.message.text, str) else a.message.text.decode()
        for a in actions
        if isinstance(a, ToVehicle) and a.message.get_type() == "STATUSTEXT"
    ]


@pytest.mark.parametrize("after_s", [2.0, 2.1, 2.2])
def test_in_a_flood_the_ground_station_reads_a_fault_at_once(after_s: float) -> None:
    flight = bent()
    flood = Flood(flight)
    flood.run(after_s)
    flight.phlosar.inject("cv_sensor", Open())
    actions = flood.run(1.0)
    assert any("vine pressure sensor" in text for text in sent_texts(actions))


def test_in_a_flood_the_pilot_reads_why_the_switch_bends_nothing() -> None:
    flight = on_the_ground()
    flood = Flood(flight)
    flood.run(3.0)
    flight.autopilot.set_rc(9, HIGH)
    actions = flood.run(2.0)
    (refused,) = (d for d in decisions(actions) if d.trigger == "switch")
    assert refused.shown
    assert any("refused bend-full" in text for text in sent_texts(actions))


def test_a_flood_leaves_few_lines_on_page_and_terminal_and_each_command_its_answer() -> None:
    flight = airborne()
    actions = Flood(flight).run(20.0)
    assert len(decisions(actions)) == 20 * FLOOD_HZ, "the log has them all"
    assert len(answers(actions)) >= 20 * FLOOD_HZ - 10
    gateway = Gateway(config.default(), lambda *_: None, lambda _: None)  # type: ignore[arg-type]
    for action in actions:
        gateway.action(action)
    assert len(gateway._unsent) <= 4 * (MAX_LINES + 1) * 2
    lines = [event_line(action, 0.0) for action in actions]
    assert sum(shown is not None for shown in lines) <= 4 * (MAX_LINES + 1)


def test_the_vent_of_a_flooding_sender_is_carried_out_answered_and_shown() -> None:
    flight = bent()
    flood = Flood(flight)
    flood.run(1.0)
    actions = flood.run(0.1, mavlink.MAV_CMD_USER_4)
    assert all(result == mavlink.MAV_RESULT_DENIED for _, result in answers(actions)), "param1 is no number"
    flood.angles_deg = False
    actions = flood.run(0.5, mavlink.MAV_CMD_USER_4)
    assert flight.core.snapshot(flight.world.now).doing == "vented"
    vents = [d for d in decisions(actions) if d.safety == "accepted"]
    assert len(vents) == 25 and [d.shown for d in vents] == [True, *24 * [False]]
    assert len([a for a in answers(actions) if a == (mavlink.MAV_CMD_USER_4, 0)]) >= 24
