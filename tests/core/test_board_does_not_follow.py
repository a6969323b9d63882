"""A board whose readings contradict the commands: the pilot reads it soon, and never in a healthy flight."""

from __future__ import annotations

import dataclasses
import math
import random

import pytest

from firmware_link import protocol
from firmware_link.protocol import Mode, Setpoint, Telemetry
from flying_vines.config.config import LimitsConfig
from flying_vines.core.board_mode import (
    SETPOINT_DELAY_S,
    SETPOINT_FOLLOWS_WITHIN_S,
    TOLERATED_KPA,
    BoardMode,
    BoardSetpoint,
)
from flying_vines.core.events import Action
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.notice import Notice, Severity

from .flights import HIGH, LOW, airborne, assert_vented, bent, configured, decisions, run_for
from .test_core_board import Change, change_telemetry

TOP_KPA = 20.7
RATE_KPA_PER_S = 2.0
TICK_S = 0.02


def warnings(actions: list[Action]) -> list[Notice]:
    return [a for a in actions if isinstance(a, Notice) and a.severity <= Severity.WARNING]


def first_warning(flight: SimulatedFlight, within_s: float) -> tuple[float, str]:
    """The time until the pilot reads the first warning, and the warning."""
    began = flight.world.now
    found = warnings(run_for(flight, within_s))
    return (found[0].t - began, found[0].text) if found else (math.inf, "")


def while_regulating(**values: float) -> Change:
    """Telemetry with these values while the board regulates; the vine's pressure has some noise."""
    chance = random.Random(1)

    def change(telemetry: Telemetry) -> Telemetry:
        if telemetry.mode is not Mode.REGULATE:
            return telemetry
        told = dict(values)
        if "cv_kPa" in told:
            told["cv_kPa"] += chance.gauss(0.0, 0.1)
        return dataclasses.replace(telemetry, **told)  # type: ignore[arg-type]

    return change


# The vine's pressure.


@pytest.mark.parametrize("cv_kPa", [0.0, 5.0, 15.0])
def test_a_vine_that_stays_below_its_setpoint_is_reported_within_2p6_s(cv_kPa: float) -> None:
    flight = airborne()
    change_telemetry(flight, while_regulating(cv_kPa=cv_kPa))
    flight.autopilot.set_rc(9, HIGH)
    after_s, text = first_warning(flight, 4.0)
    assert after_s <= 2.6
    sentence = f"Vine: vine at {cv_kPa:.0f} of 20.7 kPa for 2 s: leak, hose, valve or empty reservoir"
    assert text == sentence
    assert flight.core.snapshot(flight.world.now).safe_state == {}, "it is only a warning"


@pytest.mark.parametrize("bends_first", [False, True])
def test_a_vine_that_stays_above_its_setpoint_is_vented_within_1p3_s(bends_first: bool) -> None:
    flight = bent() if bends_first else airborne()
    change_telemetry(flight, while_regulating(cv_kPa=24.0))
    flight.autopilot.set_rc(9, HIGH)
    after_s, text = first_warning(flight, 2.0)
    assert after_s <= 1.3
    assert text.startswith("Vine: vine at 2") and "stays above its setpoint 20.7, vented" in text
    assert set(flight.core.snapshot(flight.world.now).safe_state) == {"above_setpoint"}
    run_for(flight, 1.0)
    assert_vented(flight)


@pytest.mark.parametrize("honest", [True, False])
def test_a_motion_at_ten_times_the_commanded_rate_is_vented(honest: bool) -> None:
    """The board goes to the end of a slow motion at once. If it is not honest, it reports our setpoint."""
    flight = airborne(configured(limits=LimitsConfig(max_rate_kPa_per_s=RATE_KPA_PER_S)))
    decoder, encoder = protocol.Codec(), protocol.Codec()
    commanded_kPa = [0.0]

    def faster(data: bytes) -> bytes:
        out = b""
        for message in decoder.decode(data):
            if isinstance(message, Setpoint):
                commanded_kPa[0] = message.target_kPa
                encoder._session, encoder._setpoints = message.session, message.count - 1
                message = dataclasses.replace(message, target_kPa=TOP_KPA, rate_kPa_per_s=10 * RATE_KPA_PER_S)
            out += encoder.encode(message)
        return out

    flight.world.to_phlosar = faster
    if not honest:
        change_telemetry(
            flight,
            lambda telemetry: (
                dataclasses.replace(telemetry, setpoint_kPa=commanded_kPa[0])
                if telemetry.mode is Mode.REGULATE
                else telemetry
            ),
        )
    flight.autopilot.set_rc(9, HIGH)
    after_s, _ = first_warning(flight, 3.0)
    assert after_s <= 1.5
    assert set(flight.core.snapshot(flight.world.now).safe_state) == {
        "setpoint" if honest else "above_setpoint"
    }
    run_for(flight, 1.0)
    assert_vented(flight)


# The board's setpoint.


@pytest.mark.parametrize("setpoint_kPa", [400.0, 25.0, 19.0])
def test_a_setpoint_that_nobody_commanded_is_a_fault_that_a_person_clears(setpoint_kPa: float) -> None:
    flight = bent()
    change_telemetry(flight, while_regulating(setpoint_kPa=setpoint_kPa))
    after_s, text = first_warning(flight, 3.0)
    assert after_s <= 1.1
    assert text == f"Vine: phloSAR setpoint is {setpoint_kPa:.1f} kPa, commanded 20.7, vent commanded"
    assert_vented(flight)
    flight.autopilot.set_rc(9, LOW)
    cleared = [a.text for a in run_for(flight, 1.0) if isinstance(a, Notice) and "cleared" in a.text]
    assert cleared == [f"Vine: cleared: phloSAR setpoint is {setpoint_kPa:.1f} kPa, commanded 20.7"]


class Told:
    """The commands and the board's reports, tick by tick."""

    def __init__(self) -> None:
        self.compared = BoardSetpoint()
        self.t = 0.0

    def run(self, seconds: float, commanded_kPa: float, begin_kPa: float, rate_kPa_per_s: float) -> float:
        """The board moves at this rate. Returns its setpoint at the end."""
        for _ in range(round(seconds / TICK_S)):
            self.t += TICK_S
            begin_kPa += rate_kPa_per_s * TICK_S
            self.compared.command(self.t, commanded_kPa)
            self.compared.note(self.t, begin_kPa, 10.0)
        return begin_kPa


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_board_that_stands_still_or_goes_away_is_found_after_a_second(side: float) -> None:
    for rate in (0.0, 4.0 * side, 30.0 * side):
        told = Told()
        told.run(SETPOINT_FOLLOWS_WITHIN_S - 0.04, 50.0, 50.0 + 15.0 * side, rate)
        assert told.compared.wrong is None
        told.run(0.1, 50.0, 50.0 + 15.0 * side + rate, rate)
        assert told.compared.wrong is not None and told.compared.wrong[1] == 50.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_board_that_comes_nearer_at_half_the_rate_is_not_wrong(side: float) -> None:
    told = Told()
    told.run(5.0, 50.0, 50.0 + 26.0 * side, -5.1 * side)
    assert told.compared.wrong is None


@pytest.mark.parametrize("off_kPa", [0.9 * TOLERATED_KPA, -0.9 * TOLERATED_KPA])
def test_a_small_difference_is_tolerated(off_kPa: float) -> None:
    told = Told()
    told.run(5.0, 20.0, 20.0 + off_kPa, 0.0)
    assert told.compared.wrong is None


def test_a_board_that_follows_each_command_late_is_not_wrong() -> None:
    compared = BoardSetpoint()
    for tick in range(500):
        t = tick * TICK_S
        compared.command(t, 10.0 + 10.0 * math.sin(6.0 * t))
        late = t - 0.9 * SETPOINT_DELAY_S
        compared.note(t, 10.0 + 10.0 * math.sin(6.0 * max(0.0, late)), 60.0)
        assert compared.wrong is None


def test_after_a_restart_nothing_is_compared_before_a_command() -> None:
    told = Told()
    told.run(2.0, 20.0, 400.0, 0.0)
    assert told.compared.wrong is not None
    told.compared.restart()
    assert told.compared.wrong is None
    for tick in range(100):
        told.compared.note(10.0 + tick * TICK_S, 400.0, 10.0)
    assert told.compared.wrong is None


def test_a_bend_that_begins_while_the_vine_vents_is_not_wrong() -> None:
    """The board begins at a lower pressure than we read, and stays behind during the whole slow motion."""
    phlosar = SimulatedPhlosar(Rig(cv=ControlVolume(0.19)))
    flight = airborne(configured(limits=LimitsConfig(max_rate_kPa_per_s=4.0)), phlosar=phlosar)
    flight.autopilot.set_rc(9, HIGH)
    run_for(flight, 6.0)
    assert flight.phlosar.cv_kPa > 19.0
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 0.5)
    flight.autopilot.set_rc(9, HIGH)
    assert warnings(run_for(flight, 8.0)) == []


# Single readings, and every second one.


def test_not_a_number_in_every_second_frame_is_a_fault_at_once() -> None:
    flight = bent()
    frames = [0]

    def change(telemetry: Telemetry) -> Telemetry:
        frames[0] += 1
        return dataclasses.replace(telemetry, cv_kPa=math.nan) if frames[0] % 2 else telemetry

    change_telemetry(flight, change)
    after_s, text = first_warning(flight, 1.0)
    assert (after_s <= 0.15, text) == (True, "Vine: vine sensor reads not a number, vented")
    flight.autopilot.set_rc(9, LOW)
    assert not any(isinstance(a, Notice) and "cleared" in a.text for a in run_for(flight, 1.0)), (
        "still present"
    )
    change_telemetry(flight, lambda telemetry: telemetry)
    run_for(flight, 0.5)
    assert_vented(flight)


@pytest.mark.parametrize("reservoir_kPa", [2000.0, -200.0])
@pytest.mark.parametrize("bends", [False, True])
def test_one_impossible_reading_of_the_reservoir_changes_nothing(reservoir_kPa: float, bends: bool) -> None:
    flight = bent() if bends else airborne()
    frames = [0]

    def change(telemetry: Telemetry) -> Telemetry:
        frames[0] += 1
        spoiled = frames[0] % 40 == 20
        return dataclasses.replace(telemetry, reservoir_kPa=reservoir_kPa) if spoiled else telemetry

    change_telemetry(flight, change)
    actions = run_for(flight, 5.0)
    assert warnings(actions) == [] and decisions(actions) == []


# Healthy flights.


@pytest.mark.parametrize("cv_volume_L", [0.06, 0.1, 0.19])
@pytest.mark.parametrize("reservoir_kPa", [690.0, 130.0])
@pytest.mark.parametrize("rate_kPa_per_s", [60.0, 2.0])
def test_normal_bends_give_no_warning(
    cv_volume_L: float, reservoir_kPa: float, rate_kPa_per_s: float
) -> None:
    phlosar = SimulatedPhlosar(Rig(cv=ControlVolume(cv_volume_L)), reservoir_kPa=reservoir_kPa)
    flight = airborne(configured(limits=LimitsConfig(max_rate_kPa_per_s=rate_kPa_per_s)), phlosar=phlosar)
    actions: list[Action] = []
    for position in (HIGH, 1500, HIGH, LOW, HIGH):
        flight.autopilot.set_rc(9, position)
        actions += run_for(flight, 4.0)
    assert [w.text for w in warnings(actions) if "reservoir low" not in w.text] == []
    assert [d.safety for d in decisions(actions) if d.safety == "refused"] == []


def test_messages_from_before_a_command_say_nothing_about_it() -> None:
    """A process that was stalled for 0.4 s commands a vent, and then reads what the board said meanwhile."""
    mode = BoardMode()
    regulates = Telemetry(1, Mode.REGULATE, protocol.Fault.NONE, 0, 20.0, 20.0, 690.0, 0.1, 0.0, False)
    for made_at in (9.6 + 0.01 * i for i in range(40)):
        mode.note(10.0, made_at, regulates, Mode.VENT)
    assert mode.mismatch_s(Mode.VENT) == 0.0
    mode.note(10.2, 10.2, regulates, Mode.VENT)
    assert mode.mismatch_s(Mode.VENT) == pytest.approx(0.2)


def test_a_setpoint_that_stops_half_way_is_found_a_second_later() -> None:
    compared = BoardSetpoint()
    for tick in range(110):
        t = tick * TICK_S
        compared.command(t, TOP_KPA)
        compared.note(t, min(10.0 * t, 12.0), 10.0)
        if t < 1.9:
            assert compared.wrong is None
    assert compared.wrong is not None


def test_a_board_that_follows_a_ramp_late_is_not_wrong() -> None:
    compared = BoardSetpoint()
    for tick in range(120):
        t = tick * TICK_S
        compared.command(t, 8.0 * t)
        compared.note(t, 8.0 * max(0.0, t - 0.9 * SETPOINT_DELAY_S), 20.0)
        assert compared.wrong is None
